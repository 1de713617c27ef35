"""Hands that do not come fully open, and compliant fingertips.

Flexible strips, linkages and soft cups keep compliant fingertips facing each other. Planning
rotates them accordingly, and the simulation adds a joint that does it.

A hand that is open to a width is the same robot with other rest values of its finger joints. Arm,
inverse kinematics and reachability map stay, and everything that reads a robot needs nothing new.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import RobotError, owner_cache
from momapos.core.geometry import apply, invert, rotation_of
from momapos.model.collision import FINGER, reposed
from momapos.model.kinematics import build_chain
from momapos.model.urdf import Boxes

from .fingers import Stroke, facing, jaws, narrower, widest
from .robot import Grip, Robot

if TYPE_CHECKING:
    from jaxtyping import Float


FACING_COSINE = 0.9999
"""Cosine to the closing axis above which a tip already faces the object [-]."""
MIN_FACING_COSINE = 0.7
"""Cosine to the closing axis below which no axis of a tip is meant to face the object [-]."""
PARALLEL_COSINE = 0.98
"""Minimum cosine between the axes of a finger and its tip that count as parallel [-]."""


@dataclass(frozen=True, eq=False)
class Pivot:
    """Rotation of a fingertip link on its finger, so that it faces the other side."""

    link: str
    """The link; its joint has the `name` below."""
    center: Float[np.ndarray, "3"]
    """Point on the axis, in the link frame [m]."""
    axis: Float[np.ndarray, "3"]
    """Unit vector in the link frame; parallel to a rotating finger's own axis."""
    joint: str
    """Joint of the finger."""
    ratio: float
    """-1 for a rotating finger, whose rotation the tip reverses; 0 for a sliding one [-]."""
    offset: float
    """Rotation of the tip when the finger joint is at zero [rad]."""

    @property
    def name(self) -> str:
        """Name of the joint that it represents; URDF names do not look like this."""
        return f"{self.link} pivot"


def finger_links(robot: Robot) -> set[str]:
    """Return the finger links of a gripper: links with a shape that non-arm joints move."""
    spheres, model = robot.spheres, robot.model
    arm = {model.joint(name).child for name in robot.moved_joints}
    moved = {
        link
        for joint in model.joints.values()
        if joint.child in robot.gripper_links and joint.child not in arm
        for link in model.links_below(joint.child)
    }
    roles = zip(spheres.links, spheres.gripper, strict=True)
    return {link for link, role in roles if role == FINGER and link in moved}


def facing_pose(robot: Robot, fingers: set[str]) -> tuple[dict[str, float], float | None]:
    """Find the joint values at which the pads of rotating fingers face each other.

    Returns:
        The values, and the gap of the pads at rest [m]; nothing for sliding fingers, whose pads
        always face each other, and for fingers that do not form two sides.
    """
    model = robot.model
    joints = [joint for joint in model.joints.values() if joint.child in fingers]
    turning = any(j.kind != "prismatic" and j.mimic is None and j.upper > j.lower for j in joints)
    sides = opposed(robot, fingers) if turning else None
    if sides is None:
        return {}, None
    axes = np.stack([robot.closing_axis, robot.approach_axis])
    return facing(model, robot.tool_link, sides, axes)


def opposed(robot: Robot, fingers: set[str]) -> tuple[tuple[str, ...], tuple[str, ...]] | None:
    """Return the first links of the fingers on each side; None if they do not form two sides."""
    joints = [joint for joint in robot.model.joints.values() if joint.child in fingers]
    roots = [joint.child for joint in joints if joint.parent not in fingers]
    if len(roots) < 2:
        return None
    sides = jaws(robot.model, robot.tool_link, roots, robot.closing_axis)
    return sides if all(sides) else None


def widest_stroke(robot: Robot) -> Stroke | None:
    """Return the widest gap between the fingertips; None if they do not form two sides."""
    sides = opposed(robot, finger_links(robot))
    if sides is None:
        return None
    axes = np.stack([robot.closing_axis, robot.approach_axis])
    return widest(robot.model, robot.tool_link, sides, axes)


def tips_of(
    robot: Robot, Ts_tool_link: Mapping[str, Float[np.ndarray, "4 4"]]
) -> set[tuple[str, int]]:
    """Return the shapes that reach farthest along the approach on each side: link and index."""
    reach: dict[bool, tuple[float, tuple[str, int]]] = {}
    for link, T in Ts_tool_link.items():
        for index, hull in enumerate(robot.model.hulls[link]):
            points = apply(T, hull.vertices)
            side = bool(points.mean(0) @ robot.closing_axis >= 0)
            found = float((points @ robot.approach_axis).max()), (link, index)
            reach[side] = max(reach.get(side, found), found)
    return {shape for _, shape in reach.values()}


def squaring_turn(
    boxes: Boxes, closing: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]] | None:
    """Return the rotation that makes a fingertip face the object; None if it already does.

    Returns:
        A point on the axis [m], and the axis times the angle [rad].
    """
    along = np.einsum("bij,i->bj", boxes.rotation, closing)
    nearest = np.abs(along).max(1)
    if not ((nearest > MIN_FACING_COSINE) & (nearest < FACING_COSINE)).any():
        return None
    b = int(np.argmax(boxes.half.prod(1)))
    column = int(np.argmax(np.abs(along[b])))
    axis = boxes.rotation[b, :, column] * np.sign(along[b, column])
    turn = np.cross(axis, closing)
    sine = np.linalg.norm(turn)
    return boxes.center[b], turn / sine * np.arctan2(sine, axis @ closing)


def squared(boxes: Boxes, closing: Float[np.ndarray, "3"]) -> Boxes | None:
    """Return the boxes of a fingertip, rotated to face the object; None if they already do."""
    turn = squaring_turn(boxes, closing)
    if turn is None:
        return None
    middle, R = turn[0], rotation_of(turn[1])
    return Boxes((boxes.center - middle) @ R.T + middle, R @ boxes.rotation, boxes.half)


def pivots(robot: Robot) -> tuple[Pivot, ...]:
    """Find the rotating tips of a gripper: separate links, fixed to a finger with a joint.

    A tip in the same link as its finger leans with it.
    """
    model, fingers = robot.model, finger_links(robot)
    values, _ = facing_pose(robot, fingers)
    poses = model.link_poses(values)
    T_tool_root = invert(poses[robot.tool_link])
    Ts = {link: T_tool_root @ poses[link] for link in fingers}
    found = []
    for link, index in sorted(tips_of(robot, Ts)):
        joint = next(j for j in model.urdf.joints if j.child == link)
        driver = next((j for j in model.joints.values() if j.child == joint.parent), None)
        if joint.movable or driver is None or driver.mimic:
            continue
        boxes, T = model.boxes[link][index], Ts[link]
        placed = Boxes(apply(T, boxes.center), T[:3, :3] @ boxes.rotation, boxes.half)
        turn = squaring_turn(placed, robot.closing_axis)
        if turn is None:
            continue
        center = apply(invert(T), turn[0][None])[0]
        angle = float(np.linalg.norm(turn[1]))
        axis, ratio, offset = turn[1] / angle, 0.0, angle
        if driver.kind != "prismatic":
            axis = (T_tool_root @ poses[driver.child])[:3, :3] @ driver.axis
            if abs(axis @ turn[1]) < PARALLEL_COSINE * angle:
                continue
            value = values.get(driver.name, model.rest[driver.name])
            ratio, offset = -1.0, float(axis @ turn[1]) + value
        found.append(Pivot(link, center, T[:3, :3].T @ axis, driver.name, ratio, offset))
    return tuple(found)


_DIGITS = 6
"""Decimals of the values of finger joints in plans [-]."""
SAME_VALUE = 1e-4
"""Difference below which finger joints count as at the same value [rad] or [m]."""


@owner_cache()
def opened_to(robot: Robot, width: float) -> Robot | None:
    """Return a robot whose hand is open to a width; None if it cannot be.

    The fingers close from their widest gap, all joints together, until the gap of the tips is the
    width. Joints that follow others do so.

    Args:
        robot: The robot.
        width: Distance between the pads [m], less than the opening of the robot.
    """
    whole = robot.fully_open or robot
    names, states, gaps = _closing(whole)
    if not len(gaps) or not gaps[-1] <= width < min(float(gaps[0]), whole.opening):
        return None
    values = [np.interp(width, gaps[::-1], column[::-1]) for column in states.T]
    at = dict(zip(names, np.round(values, _DIGITS).tolist(), strict=True))
    return _resting(whole, at, width)


def with_closed_hand(robot: Robot) -> Robot:
    """Return a robot whose fingers are closed; the same one if they do not close."""
    _, _, gaps = _closing(robot.fully_open or robot)
    return (opened_to(robot, max(float(gaps[-1]), 0.0)) if len(gaps) else None) or robot


def opened_as(robot: Robot, rest: Mapping[str, float]) -> Robot:
    """Return a robot with its hand as open as a plan says.

    Args:
        robot: The robot as its file describes it.
        rest: Rest values of joints in the plan [rad] or [m]; joints that it does not name rest at
            zero.

    Raises:
        RobotError: The plan rests a joint beyond its limits.
    """
    _check_within(robot, rest)
    joints = {name: robot.model.joint(name) for name in _finger_joints(robot)}
    at = {n: float(np.clip(rest.get(n, 0.0), j.lower, j.upper)) for n, j in joints.items()}
    if not rest.keys() & at.keys() or all(
        abs(at[name] - robot.model.rest[name]) < SAME_VALUE for name in at
    ):
        return robot
    names, states, gaps = _closing(robot)
    if not len(gaps) or not at.keys() >= set(names):
        return robot
    # All joints close together, so the one with the largest travel tells where they are.
    k = int(np.ptp(states, axis=0).argmax())
    order = np.argsort(states[:, k])
    width = float(np.interp(at[names[k]], states[order, k], gaps[order]))
    width = round(width, 4)
    return _resting(robot, at, width) if width < robot.opening else robot


def _check_within(robot: Robot, rest: Mapping[str, float]) -> None:
    for name, value in rest.items():
        joint = robot.model.joints.get(name)
        if joint is not None and not joint.lower - SAME_VALUE <= value <= joint.upper + SAME_VALUE:
            raise RobotError(
                f"{robot.name}: {name} rests at {value:g} in the plan; its limits are "
                f"{joint.lower:g} to {joint.upper:g}"
            )


def _finger_joints(robot: Robot) -> tuple[str, ...]:
    """Return the joints that move fingers, but not the tool, and follow no other."""
    fingers, model = finger_links(robot), robot.model
    moved = {j.name: set(model.moved_by(j.name)) for j in model.joints.values() if not j.mimic}
    return tuple(
        n for n, links in moved.items() if links & fingers and robot.tool_link not in links
    )


@owner_cache()
def _closing(
    robot: Robot,
) -> tuple[tuple[str, ...], Float[np.ndarray, "m n"], Float[np.ndarray, " m"]]:
    """Return how the fingers close, see `narrower`; no states if the fingers are unknown."""
    unknown: tuple[tuple[str, ...], np.ndarray, np.ndarray] = ((), np.zeros((0, 0)), np.zeros(0))
    sides = opposed(robot, finger_links(robot)) if robot.grips is Grip.FINGERS else None
    if sides is None:
        return unknown
    axes = np.stack([robot.closing_axis, robot.approach_axis])
    return narrower(robot.model, robot.tool_link, sides, axes)


def _resting(whole: Robot, values: Mapping[str, float], width: float) -> Robot:
    """Return a robot with other rest values of its finger joints; it shares what stays the same."""
    model = whole.model.changed(held={**whole.model.held, **values})
    robot = replace(whole, model=model, opening=width, fully_open=whole)
    _, segments = build_chain(model, whole.base_link, whole.tool_link, whole.arm_joints)
    spheres = reposed(whole.spheres, model, whole.segments, segments)
    vars(robot).update(_parts=(whole.chain, segments), ik=whole.ik, spheres=spheres)
    return robot
