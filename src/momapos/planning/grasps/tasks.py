"""What may be asked of an object: verbs, joints and values."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, get_args

import numpy as np

from momapos.core import ANGLES, LENGTHS, MAX, Quantity, TaskError, parse_quantity
from momapos.model.records import Task, Verb
from momapos.model.scene import Scene, SceneObject, joint_value
from momapos.model.urdf import Articulated, Joint, opening_of

from .handles import handle_path, has_handle, opening_direction

if TYPE_CHECKING:
    from jaxtyping import Float

WIDE_OPEN = math.pi / 2
"""How far a hinge is opened when nothing is said, as in the paper [rad]."""
STAND_OFF = 1.5
"""A robot that nobody places starts about so far from doors and drawers [m]."""
KNOB = 0.1
"""What a joint turns that is nowhere larger than this is a knob or a button [m]."""
ROUNDED = 1e-3
"""What lies outside a limit by no more is that limit, written with fewer digits [rad] or [m]."""

LONGEST_TURN, LONGEST_SLIDE = 2 * math.pi, 10.0
"""No task moves a part farther: the model's limits are wrong, or the unit is [rad], [m]."""


def make_task(
    scene: Scene,
    verb: str,
    object_name: str,
    joint: str | None = None,
    to: float | str | None = None,
) -> Task:
    """Check a request against the scene and fill in what it leaves out.

    Args:
        scene: The room.
        verb: open, close, pick or place.
        object_name: Which object.
        joint: Which of its joints; may be left out where only one part has a handle.
        to: Value to reach, as a number [rad] or [m] or as a text with its unit such as "90deg" or
            "30cm"; a quarter turn or the whole slide by default. "max" to open it as far as it
            can be opened: the answer says to which value.

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
    record = target.joint(joint) if joint else _only_joint(target)
    start = target.values()[record.name]
    farthest = isinstance(to, str) and to.strip() == MAX
    if farthest:
        goal = _limit(target, record, verb, start)
    elif to is None:
        goal = _goal(target.model, record, verb, start)
    else:
        goal = _within_limits(f"{target.name}/{record.name}", record, to)
    _check_goal(target, record, verb, start, goal)
    return Task(verb, object_name, record.name, goal, farthest)  # type: ignore[arg-type]


def openable(scene: Scene) -> list[tuple[str, str]]:
    """Every (object, joint) whose moving part has a handle, in the scene's order."""
    return [
        (item.name, joint)
        for item in scene.objects
        for joint in item.model.joints
        if has_handle(item.model, joint)
    ]


def in_front_of_parts(scene: Scene) -> Float[np.ndarray, "2"]:
    """A point on the floor before the doors and drawers of a room, on the side to which they open.

    Without any, the middle of everything [m].
    """
    points = [
        point[:2] + STAND_OFF * direction[:2]
        for name, joint in openable(scene)
        for point, direction in [opening_direction(scene.object(name), joint)]
    ]
    if points:
        return np.mean(points, axis=0)
    return np.mean([item.bounds[:, :2].mean(0) for item in scene.objects], axis=0)


def slides(scene: Scene, task: Task) -> bool:
    """Whether a task moves a part along a line, and does not turn it."""
    if task.joint is None:
        return False
    return scene.object(task.object).joint(task.joint).kind == "prismatic"


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
        return item.box_proxy.T_world_object[None, :3, 3]
    goals = [
        _goal(item.model, item.joint(name), "open", item.values()[name]) if to is None else to
        for name in joints
    ]
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
            + _by_size(target, choice)
        )
    return target.model.joints[choice[0]]


def _by_size(target: SceneObject, joints: list[str]) -> str:
    """Names of joints, with the knobs apart from the doors and drawers."""
    knobs = [j for j in joints if _turns_a_knob(target, j)]
    parts = [j for j in joints if j not in knobs]
    words = [", ".join(parts)] if parts else []
    return "; ".join([*words, *([f"knobs: {', '.join(knobs)}"] if knobs else [])])


def _turns_a_knob(target: SceneObject, joint: str) -> bool:
    """Whether a joint moves a small thing that is held anywhere, and no door or drawer."""
    model = target.model
    points = [h.vertices for name in model.moved_by(joint) for h in model.hulls[name]]
    extent = max((float(np.ptp(p, axis=0).max()) for p in points), default=0.0)
    return extent < KNOB


def _goal(model: Articulated, joint: Joint, verb: str, start: float) -> float:
    """Where a part goes when nobody says how far."""
    way = opening_of(model, joint.name)
    if verb == "close":
        return way.closed
    wide = way.closed + way.sign * WIDE_OPEN
    if joint.kind == "prismatic" or way.sign * (way.wide - wide) < 0:
        return way.wide
    return wide if way.sign * (wide - start) > ROUNDED or not math.isfinite(way.wide) else way.wide


def _limit(target: SceneObject, joint: Joint, verb: str, start: float) -> float:
    """The value at which a part is wide open, or as far as a task may move it from here."""
    if verb == "close":
        raise TaskError(
            f"{target.name}/{joint.name}: --to {MAX} opens a part as far as it goes; "
            "close shuts it all the way, leave --to out"
        )
    way = opening_of(target.model, joint.name)
    longest = LONGEST_SLIDE if joint.kind == "prismatic" else LONGEST_TURN
    return way.wide if abs(way.wide - start) <= longest else start + way.sign * longest


def _within_limits(where: str, joint: Joint, to: float | str) -> float:
    """The value that is asked for, moved onto a limit that it only misses by rounding."""
    quantity = parse_quantity(to) if isinstance(to, str) else Quantity(float(to), "", f"{to:g}")
    value = joint_value(joint, quantity, f"{where}: --to")
    if not math.isfinite(value):
        raise TaskError(f"{where}: --to must be a finite number, or an angle such as 90deg")
    if not joint.lower - ROUNDED <= value <= joint.upper + ROUNDED:
        asked = f"{value:g} {_unit(joint)}" + ("" if quantity.unit else _meant(joint, value))
        raise TaskError(f"{where}: --to {asked} is outside its limits {limits_of(joint)}")
    return min(max(value, joint.lower), joint.upper)


def _meant(joint: Joint, value: float) -> str:
    """The unit that a number without one may have been meant in."""
    units = LENGTHS if joint.kind == "prismatic" else ANGLES
    fits = [u for u, factor in units.items() if joint.lower <= factor * value <= joint.upper]
    return f" (did you mean {value:g}{fits[0]}?)" if fits else ""


def limits_of(joint: Joint) -> str:
    """The limits of a joint in words."""
    text = f"{joint.lower:.4g} to {joint.upper:.4g} {_unit(joint)}"
    if joint.kind == "prismatic":
        return text
    return f"{text} ({math.degrees(joint.lower):.4g} to {math.degrees(joint.upper):.4g} deg)"


def _unit(joint: Joint) -> str:
    return "m" if joint.kind == "prismatic" else "rad"


def _check_goal(target: SceneObject, joint: Joint, verb: str, start: float, goal: float) -> None:
    where, unit = f"{target.name}/{joint.name}", _unit(joint)
    if abs(goal - start) < ROUNDED:
        raise TaskError(f"{where}: already at {goal:g} {unit}; nothing to {verb}")
    longest = LONGEST_SLIDE if joint.kind == "prismatic" else LONGEST_TURN
    if abs(goal - start) > longest + ROUNDED:
        raise TaskError(
            f"{where}: from {start:g} to {goal:g} {unit} is too far; a part moves at most "
            f"{longest:.4g} {unit}" + ("" if joint.kind == "prismatic" else " (a full turn)")
        )
    opens = (goal - start) * opening_of(target.model, joint.name).sign > 0
    if opens != (verb == "open"):
        word = "open" if opens else "close"
        raise TaskError(f"{where}: from {start:g} to {goal:g} {unit} means to {word} it")
