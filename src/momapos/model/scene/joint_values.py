"""Set joints to other values than in the scene file, for example to open doors."""

from __future__ import annotations

import math
from collections.abc import Sequence

from momapos.core import Quantity, SceneError, parse_quantity
from momapos.model.urdf import Joint

from .scene import Scene


def joint_value(joint: Joint, quantity: Quantity, what: str) -> float:
    """Return a quantity as a joint value [rad] or [m].

    Args:
        joint: The joint.
        quantity: The quantity.
        what: Name of the argument, for messages.

    Raises:
        TaskError: The unit does not fit the kind of joint.
    """
    return quantity.length(what) if joint.kind == "prismatic" else quantity.angle(what)


def set_joints(scene: Scene, words: Sequence[str]) -> Scene:
    """Return the scene with other joint values.

    Args:
        scene: The room.
        words: For example "fridge/door_hinge=60deg".

    Raises:
        SceneError: The syntax is wrong, or a value is outside the joint's limits.
        TaskError: A value has the wrong unit.
        UnknownNameError: An object or joint does not exist.
    """
    for text in words:
        target, found, value = text.partition("=")
        name, _, joint = target.partition("/")
        if not (found and joint):
            raise SceneError(f"joint {text!r} is not OBJECT/JOINT=VALUE, like fridge/door=60deg")
        record = scene.object(name).joint(joint)
        number = joint_value(record, parse_quantity(value), f"joint {target}:")
        if not math.isfinite(number):
            raise SceneError(f"joint {target}: {value} must be finite")
        scene = scene.with_joints({name: {joint: number}})
    return scene
