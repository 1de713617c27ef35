"""What may be asked of an object: verbs, joints and values."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, get_args

import numpy as np

from momapos.errors import TaskError
from momapos.kinematics.urdf import Joint
from momapos.manipulation.handles import closed_value, handle_path, has_handle, opening_sign
from momapos.scene.scene import Scene, SceneObject
from momapos.types import Task, Verb

if TYPE_CHECKING:
    from jaxtyping import Float

WIDE_OPEN = math.pi / 2
"""How far a hinge is opened when nothing is said, as in the paper [rad]."""
_SAME = 1e-6


def make_task(
    scene: Scene, verb: str, object_name: str, joint: str | None = None, to: float | None = None
) -> Task:
    """Check a request against the scene and fill in what it leaves out.

    Args:
        scene: The room.
        verb: open, close, pick or place.
        object_name: Which object.
        joint: Which of its joints; may be left out where only one part has a handle.
        to: Value to reach [rad] or [m]; a quarter turn or the whole slide by default.

    Raises:
        TaskError: The request makes no sense here; the message says what would.
        UnknownNameError: There is no such object or joint.
    """
    if verb not in get_args(Verb):
        raise TaskError(f"no verb {verb!r}; it must be one of {', '.join(get_args(Verb))}")
    target = scene.object(object_name)
    if verb in ("pick", "place"):
        if joint is not None or to is not None:
            raise TaskError(f"{verb} moves a whole object; leave out the joint and --to")
        if target.model.joints:
            raise TaskError(f"{object_name!r} has joints; {verb} is for rigid objects")
        return Task(verb, object_name)  # type: ignore[arg-type]
    record = target.model.joint(joint) if joint else _only_joint(target)
    start = target.values()[record.name]
    goal = _goal(record, verb) if to is None else float(to)
    _check_goal(target, record, verb, start, goal)
    return Task(verb, object_name, record.name, goal)  # type: ignore[arg-type]


def openable(scene: Scene) -> list[tuple[str, str]]:
    """Every (object, joint) whose moving part has a handle, in the scene's order."""
    return [
        (item.name, joint)
        for item in scene.objects
        for joint in item.model.joints
        if has_handle(item.model, joint)
    ]


def hand_path(
    scene: Scene, object_name: str, joint: str | None = None, to: float | None = None
) -> Float[np.ndarray, "k 3"]:
    """Where a hand goes that opens or holds an object, in the world [m].

    Args:
        scene: The room.
        object_name: Which object.
        joint: Which of its joints; all that have a handle by default. Without any, the path is the
            middle of the object.
        to: Value the joint goes to [rad] or [m]; wide open by default.

    Raises:
        UnknownNameError: There is no such object or joint.
    """
    item = scene.object(object_name)
    joints = [joint] if joint else [name for o, name in openable(scene) if o == object_name]
    if not joints:
        return item.boxed.T_world_object[None, :3, 3]
    goals = [_goal(item.model.joint(name), "open") if to is None else to for name in joints]
    paths = [handle_path(item, name, goal) for name, goal in zip(joints, goals, strict=True)]
    return np.concatenate(paths)


def _only_joint(target: SceneObject) -> Joint:
    joints = list(target.model.joints)
    if not joints:
        raise TaskError(f"{target.name!r} has no movable joint; it can only be picked or placed")
    handled = [name for name in joints if has_handle(target.model, name)]
    choice = handled or joints
    if len(choice) > 1:
        raise TaskError(
            f"{target.name!r} has several moving parts; say {target.name}/JOINT with one of "
            + ", ".join(choice)
        )
    return target.model.joints[choice[0]]


def _goal(joint: Joint, verb: str) -> float:
    closed, sign = closed_value(joint), opening_sign(joint)
    if verb == "close":
        return closed
    limit = joint.upper if sign > 0 else joint.lower
    wide = closed + sign * WIDE_OPEN if joint.kind != "prismatic" else limit
    return max(limit, wide) if sign < 0 else min(limit, wide)


def _check_goal(target: SceneObject, joint: Joint, verb: str, start: float, goal: float) -> None:
    where = f"{target.name}/{joint.name}"
    unit = "m" if joint.kind == "prismatic" else "rad"
    if not math.isfinite(goal):
        raise TaskError(f"{where}: --to must be a finite number, or an angle such as 90deg")
    if not joint.lower - _SAME <= goal <= joint.upper + _SAME:
        degrees = (
            ""
            if unit == "m"
            else f" ({math.degrees(joint.lower):.0f} to {math.degrees(joint.upper):.0f} deg)"
        )
        raise TaskError(
            f"{where}: --to {goal:g} {unit} is outside its limits {joint.lower:g} to "
            f"{joint.upper:g} {unit}{degrees}"
        )
    if abs(goal - start) < 1e-3:
        raise TaskError(f"{where}: already at {goal:g} {unit}; nothing to {verb}")
    opens = (goal - start) * opening_sign(joint) > 0
    if opens != (verb == "open"):
        word = "open" if opens else "close"
        raise TaskError(f"{where}: from {start:g} to {goal:g} {unit} means to {word} it")
