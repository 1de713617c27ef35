"""Doors that stand open: joints set to other values than the scene's file has."""

from __future__ import annotations

import math
from collections.abc import Sequence

from momapos.core import Quantity, SceneError, parse_quantity
from momapos.model.urdf import Joint

from .scene import Scene


def joint_value(joint: Joint, quantity: Quantity, what: str) -> float:
    """A quantity as a value of a joint [rad] or [m].

    Args:
        joint: The joint.
        quantity: What was written.
        what: What it was written for, for the message.

    Raises:
        TaskError: Its unit is not one of this kind of joint.
    """
    return quantity.length(what) if joint.kind == "prismatic" else quantity.angle(what)


def set_joints(scene: Scene, words: Sequence[str]) -> Scene:
    """The same scene with joints at other values.

    Args:
        scene: The room.
        words: Such as "fridge/door_hinge=60deg".

    Raises:
        SceneError: It is not written so, or outside the joint's limits.
        TaskError: The value has the wrong unit.
        UnknownNameError: There is no such object or joint.
    """
    for text in words:
        target, found, value = text.partition("=")
        name, _, joint = target.partition("/")
        if not (found and joint):
            raise SceneError(f"--joint {text!r} is not OBJECT/JOINT=VALUE, as fridge/door=60deg")
        record = scene.object(name).joint(joint)
        number = joint_value(record, parse_quantity(value), f"--joint {target}:")
        if not math.isfinite(number):
            raise SceneError(f"--joint {target}: {value} is no finite number")
        scene = scene.with_joints({name: {joint: number}})
    return scene
