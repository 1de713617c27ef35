"""Fill ROS messages from the dictionaries of momapos' export, which have the same field names."""

from __future__ import annotations

import math
from collections.abc import Mapping
from importlib import import_module
from typing import Any


def fill(message: Any, members: Mapping[str, Any]) -> Any:
    """Set fields of a message and of the messages in it; other fields stay unchanged."""
    for name, value in members.items():
        if isinstance(value, Mapping):
            fill(getattr(message, name), value)
        elif isinstance(value, list) and value and isinstance(value[0], Mapping):
            element = _element(message, name)
            setattr(message, name, [fill(element(), item) for item in value])
        else:
            setattr(message, name, value)
    return message


def _element(message: Any, name: str) -> Any:
    """Return the message class of a sequence field, such as sequence<geometry_msgs/PoseStamped>."""
    kind = message.get_fields_and_field_types()[name]
    package, _, element = (
        kind.removeprefix("sequence<").rstrip(">").partition(",")[0].partition("/")
    )
    return getattr(import_module(f"{package}.msg"), element)


def planar(pose: Any) -> tuple[float, float, float]:
    """Return x [m], y [m] and yaw [rad] of a geometry_msgs/Pose."""
    q = pose.orientation
    yaw = math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y * q.y + q.z * q.z))
    return pose.position.x, pose.position.y, yaw
