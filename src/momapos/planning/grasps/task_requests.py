"""Check tasks against a scene: verbs, objects, joints and values."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, get_args

import numpy as np

from momapos.core import (
    ANGLES,
    LENGTHS,
    MAX,
    Quantity,
    TaskDoneError,
    TaskError,
    UrdfError,
    expect,
    finite_number,
    parse_quantity,
)
from momapos.core.geometry import apply
from momapos.model.records import JointVerb, PoseVerb, Task, Verb
from momapos.model.scene import (
    ResistanceConfig,
    Scene,
    SceneObject,
    joint_value,
    latch_to_turn,
    resistance_along,
)
from momapos.model.urdf import Articulated, Joint, JointOpening, opening_of
from momapos.verification import meets_floor_at

from .handle_shapes import CarriedPart, is_handle_joint
from .handles import Handle, find_handle, handle_path, has_handle, opening_direction
from .part_motion import lever_arms, levers_along

if TYPE_CHECKING:
    from jaxtyping import Float


WIDE_OPEN = math.pi / 2
"""Default opening angle of a hinge, as in the paper [rad]."""
START_DISTANCE = 1.5
"""Default distance of the start from doors and drawers [m]."""
MAX_KNOB_SIZE = 0.1
"""Maximum size of a knob or button [m]."""
LIMIT_TOLERANCE = 1e-3
"""Values that exceed a limit by less are rounded versions of that limit [rad] or [m]."""
MAX_GRASP_TURN, GRASP_TURN = math.pi, math.pi / 2
"""A part without limits that turns farther is turned by several grasps, by so much each [rad]: six
robots of the library turn a hand wheel by 90 degrees with one grasp."""
MAX_TURN, MAX_SLIDE = 2 * math.pi, 10.0
"""Maximum motion of a task; a larger one has a wrong limit or unit [rad], [m]."""


def make_task(
    scene: Scene,
    verb: str,
    object_name: str,
    joint: str | None = None,
    to: float | str | None = None,
) -> Task:
    """Check a request against the scene and fill in what it leaves out.

    Args:
        scene: The scene.
        verb: open, close, press, pick or place.
        object_name: The object, or object and joint as in "fridge/door_hinge".
        joint: The joint; optional if only one part has a handle. A mimic joint stands for its
            leader, whose limits then count.
        to: Value to reach, as a number [rad] or [m] or a text with a unit such as "90deg" or
            "30cm"; a quarter turn or the whole slide by default, or less if the part meets the
            floor; to press, the limit that is farther away. "max" opens the part as far as
            possible; the plan contains the value.

    Raises:
        TaskDoneError: The part is already where the task would move it.
        TaskError: The request does not fit the object; the message says what would.
        UnknownNameError: There is no such object or joint.
    """
    expect("scene", scene, Scene, "load_scene reads one")
    expect("object_name", object_name, str)
    if joint is None and "/" in object_name and object_name not in {o.name for o in scene.objects}:
        object_name, _, joint = object_name.partition("/")
    if joint is not None:
        expect("joint", joint, str)
    verbs = [one for one in get_args(Verb) if one not in get_args(PoseVerb)]
    if not isinstance(verb, str) or verb not in verbs:
        raise TaskError(f"no verb {verb!r}; it must be one of {', '.join(verbs)}")
    target = scene.object(object_name)
    if verb not in get_args(JointVerb):
        if joint is not None or to is not None:
            raise TaskError(f"{verb} moves a whole object; leave out joint and to")
        if target.model.joints:
            raise TaskError(f"{object_name!r} has joints; {verb} is for rigid objects")
        if target.wall is not None:
            raise TaskError(f"{object_name!r} is a wall of the room, which nothing can {verb}")
        return Task(verb, object_name)  # type: ignore[arg-type]
    named = target.joint(joint) if joint else _only_joint(target)
    record = named if named.mimic is None else target.joint(named.mimic.joint)
    start = target.values()[record.name]
    farthest = isinstance(to, str) and to.strip() == MAX
    if farthest:
        goal = _above_floor(target, record, verb, _limit(target, record, verb, start))
    elif to is None:
        goal = _above_floor(target, record, verb, _goal(target.model, record, verb, start))
    else:
        goal = _within_limits(f"{target.name}/{record.name}", record, to)
    _check_goal(target, record, verb, start, goal)
    follower = "" if named is record else named.name
    return Task(verb, object_name, record.name, goal, farthest, follower)  # type: ignore[arg-type]


def turns_to(
    scene: Scene,
    verb: str,
    object_name: str,
    joint: str | None,
    to: float | str | None,
    start: float | None = None,
) -> tuple[str, list[float]] | None:
    """Return how a wheel or a valve is turned by several grasps; None if one may do.

    Args:
        scene: The scene.
        verb, object_name, joint, to: The request, see `make_task`.
        start: Value of the joint before, if it is not that of the scene [rad].

    Returns:
        The joint, and the value after each grasp, `GRASP_TURN` apart at most [rad].
    """
    names = isinstance(object_name, str) and isinstance(joint, str | None)
    if not names or verb not in ("open", "close"):
        return None
    if object_name not in {o.name for o in scene.objects}:
        return None
    target = scene.object(object_name)
    if not target.model.joints or (isinstance(to, str) and to.strip() == MAX):
        return None
    record = target.joint(joint) if joint else _only_joint(target)
    if record.kind == "prismatic" or record.mimic is not None or np.isfinite(record.upper):
        return None
    begin = target.values()[record.name] if start is None else start
    if to is not None:
        goal = _within_limits(f"{target.name}/{record.name}", record, to)
    elif verb == "close":
        goal = opening_of(target.model, record.name).closed
    else:
        return None
    if abs(goal - begin) <= MAX_GRASP_TURN:
        return None
    count = math.ceil(abs(goal - begin) / GRASP_TURN - 1e-9)
    return record.name, np.linspace(begin, goal, count + 1)[1:].tolist()


def openable(scene: Scene) -> list[tuple[str, str]]:
    """Return every (object, joint) whose moving part has a handle, in the scene's order."""
    expect("scene", scene, Scene, "load_scene reads one")
    return [
        (item.name, joint)
        for item in scene.objects
        for joint in parts_of(item)
        if has_handle(item.model, joint)
    ]


def parts_of(item: SceneObject) -> list[str]:
    """Return the joints that move a part of their own: no mimic joints, no handles or latches."""
    joints = item.model.joints.values()
    latch = "" if item.latch is None else item.latch.joint
    return [
        j.name
        for j in joints
        if j.mimic is None and j.name != latch and not is_handle_joint(item.model, j)
    ]


def in_front_of_parts(scene: Scene) -> Float[np.ndarray, "2"]:
    """Return a floor point in front of a scene's doors and drawers, or else its middle [m]."""
    points = [
        point[:2] + START_DISTANCE * direction[:2]
        for name, joint in openable(scene)
        for point, direction in [opening_direction(scene.object(name), joint)]
    ]
    if points:
        return np.mean(points, axis=0)
    return np.mean([item.bounds[:, :2].mean(0) for item in scene.objects], axis=0)


def slides(scene: Scene, task: Task) -> bool:
    """Check whether a task moves a part along a line instead of turning it."""
    if task.joint is None:
        return False
    return scene.object(task.object).joint(task.joint).kind == "prismatic"


def hand_path(
    scene: Scene, object_name: str, joint: str | None = None, to: float | None = None
) -> Float[np.ndarray, "k 3"]:
    """Return the path of the hand that opens or grasps an object, in the world [m].

    Args:
        scene: The scene.
        object_name: The object.
        joint: Its joint; by default all joints with a handle. Without any, the path is the middle
            of the object.
        to: Value of the joint at the end [rad] or [m]; wide open by default.

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
    if not target.model.joints:
        raise TaskError(f"{target.name!r} has no movable joint; it can only be picked or placed")
    joints = parts_of(target) or list(target.model.joints)
    handled = [name for name in joints if has_handle(target.model, name)]
    choice = handled or joints
    if len(choice) > 1:
        raise TaskError(
            f"{target.name!r} has several moving parts; name one as {target.name}/JOINT: "
            + _by_size(target, choice)
        )
    return target.model.joints[choice[0]]


def _by_size(target: SceneObject, joints: list[str]) -> str:
    """List joints in words, knobs separately from doors and drawers."""
    knobs = [j for j in joints if _is_knob(target, j)]
    parts = [j for j in joints if j not in knobs]
    words = [", ".join(parts)] if parts else []
    return "; ".join([*words, *([f"knobs: {', '.join(knobs)}"] if knobs else [])])


def _is_knob(target: SceneObject, joint: str) -> bool:
    model = target.model
    points = [h.vertices for name in model.moved_by(joint) for h in model.hulls[name]]
    extent = max((float(np.ptp(p, axis=0).max()) for p in points), default=0.0)
    return extent < MAX_KNOB_SIZE


def _goal(model: Articulated, joint: Joint, verb: str, start: float) -> float:
    opening = opening_of(model, joint.name)
    if verb == "press":
        ends = (joint.lower, joint.upper)
        if not np.isfinite(ends).all():
            raise TaskError(f"{joint.name} has no limits; give how far to press it with to")
        return max(ends, key=lambda end: (round(abs(end - start), 6), end))
    if verb == "close":
        return opening.closed
    goal = opening.closed + opening.sign * WIDE_OPEN
    if joint.kind == "prismatic" or opening.sign * (opening.wide - goal) < 0:
        return opening.wide
    is_ahead = opening.sign * (goal - start) > LIMIT_TOLERANCE
    return goal if is_ahead or not math.isfinite(opening.wide) else opening.wide


def _limit(target: SceneObject, joint: Joint, verb: str, start: float) -> float:
    """Return the value at which a part is wide open, or as far as a task may move it."""
    if verb != "open":
        raise TaskError(
            f"{target.name}/{joint.name}: to={MAX} is only for open; leave out to, since {verb} "
            f"always {verb}{'s' if verb == 'close' else 'es'} a part completely"
        )
    opening, most = opening_of(target.model, joint.name), _longest(joint)
    return opening.wide if abs(opening.wide - start) <= most else start + opening.sign * most


def _above_floor(target: SceneObject, joint: Joint, verb: str, goal: float) -> float:
    """Return the goal, or the last whole degree or centimeter before the part meets the floor.

    A part that meets the floor at once keeps its goal, so that the answer says so.
    """
    start = target.values()[joint.name]
    contact = meets_floor_at(target, joint.name, goal) if verb == "open" else None
    if contact is None:
        return goal
    unit = 0.01 if joint.kind == "prismatic" else math.radians(1.0)
    before = unit * (math.floor if contact > start else math.ceil)(contact / unit)
    moved = (before - start) * math.copysign(1.0, contact - start)
    return before if moved > LIMIT_TOLERANCE else goal


def _within_limits(where: str, joint: Joint, to: float | str) -> float:
    """Return a requested value in the joint's unit; correct rounding beyond a limit."""
    if not isinstance(to, str):
        to = finite_number("to", to)
    quantity = parse_quantity(to) if isinstance(to, str) else Quantity(to, "", f"{to:g}")
    value = joint_value(joint, quantity, f"{where}: to")
    if not math.isfinite(value):
        raise TaskError(f"{where}: to must be a finite number, or an angle such as 90deg")
    if not joint.lower - LIMIT_TOLERANCE <= value <= joint.upper + LIMIT_TOLERANCE:
        given = f"{value:g} {_unit(joint)}" + ("" if quantity.unit else _unit_hint(joint, value))
        raise TaskError(f"{where}: to {given} is outside its limits {limits_of(joint)}")
    return min(max(value, joint.lower), joint.upper)


def _unit_hint(joint: Joint, value: float) -> str:
    """Suggest a unit in which a number without a unit would be within the limits."""
    units = LENGTHS if joint.kind == "prismatic" else ANGLES
    fits = [u for u, factor in units.items() if joint.lower <= factor * value <= joint.upper]
    return f" (did you mean {value:g}{fits[0]}?)" if fits else ""


def limits_of(joint: Joint) -> str:
    """Return the limits of a joint in words."""
    text = f"{joint.lower:.4g} to {joint.upper:.4g} {_unit(joint)}"
    if joint.kind == "prismatic":
        return text
    return f"{text} ({math.degrees(joint.lower):.4g} to {math.degrees(joint.upper):.4g} deg)"


def _unit(joint: Joint) -> str:
    return "m" if joint.kind == "prismatic" else "rad"


def _longest(joint: Joint) -> float:
    return MAX_SLIDE if joint.kind == "prismatic" else MAX_TURN


def _check_goal(target: SceneObject, joint: Joint, verb: str, start: float, goal: float) -> None:
    where, unit = f"{target.name}/{joint.name}", _unit(joint)
    closed = opening_of(target.model, joint.name).closed
    opens = abs(goal - closed) > abs(start - closed)
    if abs(goal - start) < LIMIT_TOLERANCE:
        state = "closed" if abs(goal - closed) < LIMIT_TOLERANCE else "open"
        state = "pressed" if verb == "press" else state
        small = verb == "close" and _is_knob(target, joint.name)
        advice = "; press pushes a button or a switch" if small else ""
        raise TaskDoneError(f"{where}: already {state}, at {_in_words(joint, goal)}{advice}")
    longest = _longest(joint)
    if abs(goal - start) > longest + LIMIT_TOLERANCE:
        raise TaskError(
            f"{where}: from {start:g} to {goal:g} {unit} is too far; a part moves at most "
            f"{longest:.4g} {unit}"
            + (
                ""
                if joint.kind == "prismatic"
                else " (a full turn); a tour turns a part without limits by several grasps"
            )
        )
    if verb != "press" and opens != (verb == "open"):
        word = "open" if opens else "close"
        raise TaskError(f"{where}: from {start:g} to {goal:g} {unit} means to {word} it")


def _in_words(joint: Joint, value: float) -> str:
    if joint.kind == "prismatic":
        return f"{100 * value:.4g} cm"
    return f"{math.degrees(value):.4g} deg"


_VALUES = 19
"""Joint values at which the resistance is evaluated: every 5 degrees up to 90 [-]."""
_MIN_LEVER = 1e-3
"""Lever arm below which no pull at the handle is stated [m]."""


@dataclass(frozen=True, eq=False)
class PartFacts:
    """What is known about the part that a joint moves."""

    opening: JointOpening
    follows: str
    """The joint that a mimic joint follows; "" for other joints."""
    is_handle: bool
    """Whether the joint moves nothing but the handle of another part."""
    handle: Handle | None
    """Where a hand holds the part; None for a mimic joint, and if there is a problem."""
    handle_world: Float[np.ndarray, "3"] | None
    """Its middle in the world [m]."""
    pull: float | None
    """Largest pull at the handle on the way from closed to open [N]; up to 90 degrees."""
    problem: str = ""
    """Why no handle could be looked for."""


def _latch_link(item: SceneObject, joint: str) -> str | None:
    """Return the link of the latch that a hand must hold to open a part; None if there is none."""
    latch = latch_to_turn(item, joint)
    return None if latch is None else item.joint(latch.joint).child


def part_facts_of(
    item: SceneObject, joint: str, config: ResistanceConfig | None = None
) -> PartFacts:
    """Describe the part that a joint of an object moves.

    Args:
        item: The object.
        joint: One of its movable joints.
        config: Assumed resistances.
    """
    record, opening = item.joint(joint), opening_of(item.model, joint)
    if record.mimic is not None:
        return PartFacts(opening, record.mimic.joint, False, None, None, None)
    alone = is_handle_joint(item.model, record)
    try:
        handle = find_handle(item.posed_model(joint), joint, opening.sign, _latch_link(item, joint))
    except (TaskError, UrdfError) as error:  # no geometry, or a mesh without readable faces
        return PartFacts(opening, "", alone, None, None, None, str(error))
    center = apply(item.link_poses()[handle.carrier], handle.center[None])[0]
    part = CarriedPart(item.posed_model(joint), joint, handle.carrier)
    pull = None
    if lever_arms(part, handle.center[None])[0] > _MIN_LEVER:
        reach = abs(opening.wide - opening.closed)
        reach = reach if record.kind == "prismatic" else min(reach, WIDE_OPEN)
        values = opening.closed + opening.sign * np.linspace(0.0, reach, _VALUES)
        lever = levers_along(part, handle.center[None], values)[:, 0]
        resistance = resistance_along(item, joint, values, lever, config or ResistanceConfig())
        pull = float((resistance.total / lever).max())
    return PartFacts(opening, "", alone, handle, center, pull)
