"""Where the hand alone has room, whatever arm and base are behind it.

The tool's poses are those of the task, so what the hand meets on its way depends on the grasp and
not on where the base stands. Spheres find what is near; where a sphere of the gripper touches, its
boxes decide, so that fingers fit behind a bar beside a carcass. The kernels of the arm need not
look at the hand again.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from momapos.core.compiled import B1, F1, F2, F3, I1, entry, kernel
from momapos.core.geometry import apply, invert
from momapos.model.collision import (
    CELL,
    FINGER,
    FLOOR,
    FREE,
    KNOWN,
    OTHER,
    PALM,
    BoxBetween,
    CollisionWorld,
    OrientedBox,
    Spheres,
    any_filled,
    box_gap,
    boxes_apart,
    moved,
    place_bounds,
)
from momapos.model.kinematics import BoxArrays, SphereArrays, WorldArrays
from momapos.model.robots import Robot, finger_links
from momapos.model.urdf import Boxes
from momapos.planning.grasps import TaskMotion, hand_of

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

_PALM, _SIDES = 0, (1, 2)
"""What moves as one: the palm, and the fingers on each side of the closing axis."""
SLIGHT = 5e-4
"""Fingers that close by less are where they are at rest [m]."""
GAP = 1e-3
"""Distance that the gripper's boxes keep [m]; less than what its spheres keep, which are no shape
of it: handles of 1 cm leave a finger 2 mm before the carcass behind them."""


class HandArrays(NamedTuple):
    """A hand at rest in the frame of its tool, as the kernel takes it."""

    spheres: SphereArrays
    boxes: BoxArrays
    start: I1
    """Boxes of group g are start[g]:start[g + 1]; of a group without any its spheres decide."""
    closing: F1


class _Query(NamedTuple):
    """What a hand at one pose is checked against."""

    boxes: BoxArrays
    cleared: I1
    """Of each box, the last query of a group that found it clear."""
    margin: float
    exact: bool


class _Placed(NamedTuple):
    """Where the parts of a hand are."""

    R: F3
    p: F2
    bounds: F2


@kernel
def _place_hand(T, travel, closing, R, p):
    """Poses of palm and fingers, which have closed by a travel each."""
    for k in range(3):
        along = T[k, 0] * closing[0] + T[k, 1] * closing[1] + T[k, 2] * closing[2]
        for s in range(3):
            R[s, k, 0], R[s, k, 1], R[s, k, 2] = T[k, 0], T[k, 1], T[k, 2]
        p[0, k] = T[k, 3]
        p[1, k] = T[k, 3] - travel * along
        p[2, k] = T[k, 3] + travel * along


@kernel
def _box_of(k, segment, hand, placed, margin, out):
    """Put box k of the hand, with a margin, where its segment is."""
    R, p = placed.R[segment], placed.p[segment]
    center, rotation, half = hand.boxes
    for i in range(3):
        out.center[i] = p[i]
        for j in range(3):
            out.center[i] += R[i, j] * center[k, j]
            out.rotation[i, j] = (
                R[i, 0] * rotation[k, 0, j]
                + R[i, 1] * rotation[k, 1, j]
                + R[i, 2] * rotation[k, 2, j]
            )
        out.half[i] = half[k, i] + margin


@kernel
def _touches(g, b, hand, placed, query, memory):
    """Whether a group whose sphere touches box b really does."""
    part, between = memory
    if not query.exact or hand.start[g] == hand.start[g + 1]:
        return True
    for k in range(hand.start[g], hand.start[g + 1]):
        _box_of(k, hand.spheres.segment[g], hand, placed, GAP, part)
        if not boxes_apart(part, query.boxes, b, between):
            return True
    return False


@kernel
def _hits_moving(hand, placed, query, memory, grasped, holding):
    """First moving box that the hand hits, or FREE; while it holds it may touch some."""
    spheres = hand.spheres
    center, rotation, half = query.boxes
    for g in range(len(spheres.segment)):
        role, segment = spheres.gripper[g], spheres.segment[g]
        bound = (placed.bounds[g, 0], placed.bounds[g, 1], placed.bounds[g, 2])
        for b in range(len(center)):
            if holding and (role == FINGER or (role == PALM and grasped[b])):
                continue
            far = spheres.bound_radius[g] + query.margin
            if box_gap(bound, far, center, rotation, half, b) > 0.0:
                continue
            for s in range(spheres.start[g], spheres.start[g + 1]):
                m = moved(placed.R, placed.p, segment, spheres.center[s])
                r = spheres.radius[s] + query.margin
                if box_gap(m, r, center, rotation, half, b) < 0.0:
                    if _touches(g, b, hand, placed, query, memory):
                        return b
                    break
    return FREE


@kernel
def _hits_static(hand, placed, query, memory, world, stamp):
    """First standing box that the hand hits, or FREE."""
    spheres = hand.spheres
    center, rotation, half = query.boxes
    low, shape = world.grid_origin, world.grid_shape
    for g in range(len(spheres.segment)):
        if not any_filled(placed.bounds[g], spheres.bound_radius[g], low, shape, world.filled):
            continue
        mark = stamp * len(spheres.segment) + g
        for s in range(spheres.start[g], spheres.start[g + 1]):
            m = moved(placed.R, placed.p, spheres.segment[g], spheres.center[s])
            i = int(np.floor((m[0] - low[0]) / CELL))
            j = int(np.floor((m[1] - low[1]) / CELL))
            k = int(np.floor((m[2] - low[2]) / CELL))
            if not (0 <= i < shape[0] and 0 <= j < shape[1] and 0 <= k < shape[2]):
                continue
            cell = (i * shape[1] + j) * shape[2] + k
            for at in range(world.grid_start[cell], world.grid_start[cell + 1]):
                b = world.grid_index[at]
                if query.cleared[b] == mark:
                    continue
                r = spheres.radius[s] + query.margin
                if box_gap(m, r, center, rotation, half, b) < 0.0:
                    if _touches(g, b, hand, placed, query, memory):
                        return b
                    query.cleared[b] = mark
    return FREE


@entry
def _hand_hits(
    Ts: F3,
    travel: F1,
    value: I1,
    holding: B1,
    exact: B1,
    hand: HandArrays,
    world: WorldArrays,
    margin: float,
) -> np.ndarray:
    out = np.empty(len(Ts), np.int64)
    placed = _Placed(np.empty((3, 3, 3)), np.empty((3, 3)), np.empty((len(hand.start) - 1, 3)))
    memory = (
        OrientedBox(np.empty(3), np.empty((3, 3)), np.empty(3)),
        BoxBetween(np.empty(3), np.empty((3, 3)), np.empty((3, 3))),
    )
    cleared = np.full(len(world.center), -1)
    standing = BoxArrays(world.center, world.rotation, world.half)
    for i in range(len(Ts)):
        _place_hand(Ts[i], travel[i], hand.closing, placed.R, placed.p)
        place_bounds(placed.R, placed.p, hand.spheres, placed.bounds)
        v = value[i]
        boxes = BoxArrays(world.moving_center[v], world.moving_rotation[v], world.moving_half[v])
        query = _Query(boxes, cleared, margin, exact[i])
        out[i] = _hits_moving(hand, placed, query, memory, world.grasped, holding[i])
        if out[i] != FREE:
            out[i] += len(world.center)
            continue
        query = _Query(standing, cleared, margin, exact[i])
        out[i] = _hits_static(hand, placed, query, memory, world, i)
    return out


@lru_cache(maxsize=64)
def arm_spheres(robot: Robot) -> Spheres:
    """The robot's spheres for arms whose hand is known to have room: it is not looked at again.

    Whether hand and arm touch each other is.
    """
    spheres = robot.spheres
    known = (spheres.segment == _last_segment(robot)) & (spheres.gripper != OTHER)
    return replace(spheres, gripper=np.where(known, KNOWN, spheres.gripper))


@lru_cache(maxsize=64)
def _hand_arrays(robot: Robot) -> HandArrays:
    """The gripper, and what else the arm's last joint moves."""
    spheres = robot.spheres
    groups = np.flatnonzero(spheres.segment == _last_segment(robot))
    boxes = [_boxes_of(robot, int(g)) for g in groups]
    aside = np.array([(b.center @ robot.closing_axis).sum() for b in boxes])
    moves = np.isin(np.array(spheres.links)[groups], [*finger_links(robot)])
    segment = np.where(moves, np.where((-hand_of(robot).fixed or aside) >= 0, *_SIDES), _PALM)
    rows = [np.arange(spheres.start[g], spheres.start[g + 1]) for g in groups]
    index = np.concatenate([np.zeros(0, np.int64), *rows])
    arrays = spheres.arrays._replace(
        center=_in_tool(robot, spheres.center[index]),
        radius=spheres.radius[index],
        start=np.cumsum([0, *map(len, rows)]),
        segment=segment.astype(np.int64),
        bound_center=_in_tool(robot, spheres.bound_center[groups]),
        bound_radius=spheres.bound_radius[groups],
        gripper=spheres.gripper[groups],
    )
    none = Boxes(np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3)))
    together = (
        np.concatenate([getattr(b, name) for b in (none, *boxes)]) for name in BoxArrays._fields
    )
    return HandArrays(
        arrays,
        BoxArrays(*together),
        np.cumsum([0, *map(len, boxes)]),
        np.ascontiguousarray(robot.closing_axis, float),
    )


def _last_segment(robot: Robot) -> int:
    """The segment that the tool belongs to."""
    return robot.segments.of_link[robot.tool_link]


def _in_tool(robot: Robot, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Points of the last segment in the frame of the tool."""
    return np.ascontiguousarray((points - robot.chain.tool_offset) @ robot.chain.tool_rotation)


def _boxes_of(robot: Robot, group: int) -> Boxes:
    """Boxes of a link in the frame of the tool; none of a link that is no gripper."""
    center, rotation, half = [np.zeros((0, 3))], [np.zeros((0, 3, 3))], [np.zeros((0, 3))]
    if robot.spheres.gripper[group] != OTHER:
        link, poses = robot.spheres.links[group], robot.model.rest_poses
        T = invert(poses[robot.tool_link]) @ poses[link]
        for boxes in robot.model.boxes[link]:
            center.append(apply(T, boxes.center))
            rotation.append(T[:3, :3] @ boxes.rotation)
            half.append(boxes.half)
    return Boxes(np.concatenate(center), np.concatenate(rotation), np.concatenate(half))


def hand_hits(
    robot: Robot,
    world: CollisionWorld,
    Ts_world_tool: Float[np.ndarray, "m 4 4"],
    value: Int[np.ndarray, " m"],
    holding: Bool[np.ndarray, " m"],
    exact: Bool[np.ndarray, " m"],
    travel: Float[np.ndarray, " m"] | None = None,
) -> Int[np.ndarray, " m"]:
    """What the hand alone hits at tool poses, whatever arm and base are behind it.

    Args:
        robot: Whose hand.
        world: The room, and what moves.
        Ts_world_tool: Where the tool is.
        value: Index of the object's joint value at each.
        holding: Whether the gripper may touch what is grasped.
        exact: Whether the gripper's boxes decide where a sphere touches; else the spheres do.
        travel: How far each finger has closed from where it is at rest [m]; not at all by default.

    Returns:
        FREE, FLOOR or an index into the labels.
    """
    hand = _hand_arrays(robot)
    if len(hand.start) == 1:
        return np.full(len(Ts_world_tool), FREE)
    travel = np.zeros(len(Ts_world_tool)) if travel is None else np.ascontiguousarray(travel, float)
    codes = _hand_hits(
        np.ascontiguousarray(Ts_world_tool),
        travel,
        np.ascontiguousarray(value),
        np.ascontiguousarray(holding),
        np.ascontiguousarray(exact),
        hand,
        world.arrays,
        world.clearance,
    )
    low = np.where(exact, *_lowest(hand, Ts_world_tool, travel))
    codes[(codes == FREE) & (low < 0.0)] = FLOOR
    return codes


def _lowest(
    hand: HandArrays, Ts_world_tool: Float[np.ndarray, "m 4 4"], travel: Float[np.ndarray, " m"]
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """How high the lowest points of the gripper's boxes and of its spheres are over the floor [m].

    What is no gripper belongs to the arm, for which the arm's kernels ask.
    """
    down, height = Ts_world_tool[:, 2, :3], Ts_world_tool[:, 2, 3, None]
    inward = (travel * (down @ hand.closing))[:, None] * np.array([0.0, -1.0, 1.0])
    spheres, (center, rotation, half) = hand.spheres, hand.boxes
    gripper = spheres.gripper != OTHER
    side = np.repeat(spheres.segment, np.diff(hand.start))
    reach = np.einsum("mij,ij->mi", np.abs(np.einsum("mk,ikj->mij", down, rotation)), half)
    boxes = down @ center.T + inward[:, side] - reach
    count = np.diff(spheres.start)
    mine = np.repeat(gripper, count)
    side = np.repeat(spheres.segment, count)[mine]
    balls = down @ spheres.center[mine].T + inward[:, side] - spheres.radius[mine]
    return (height + boxes).min(1, initial=np.inf), (height + balls).min(1, initial=np.inf)


def hits_while_closing(
    robot: Robot,
    world: CollisionWorld,
    Ts_world_tool: Float[np.ndarray, "m 4 4"],
    value: Int[np.ndarray, " m"],
    holding: Bool[np.ndarray, " m"],
    exact: Bool[np.ndarray, " m"],
    travel: Float[np.ndarray, " m"],
) -> Int[np.ndarray, " m"]:
    """What fingers hit between open and closed; arguments are those of `hand_hits`.

    Open fingers may stand astride what closed ones are beside: the edge of a carcass, a neighbor's
    handle.
    """
    # Steps of a finger's thickness leave nothing out.
    count = max(2, int(np.ceil(travel.max(initial=0.0) / hand_of(robot).thickness)))
    between = np.arange(1, count) / count
    rows = np.repeat(np.arange(len(travel)), len(between))
    codes = hand_hits(
        robot, world, Ts_world_tool[rows], value[rows], holding[rows], exact[rows],
        np.outer(travel, between).ravel(),
    ).reshape(len(travel), len(between))  # fmt: skip
    return codes[np.arange(len(travel)), np.argmax(codes != FREE, axis=1)]


def hits_on_the_way(
    robot: Robot,
    world: CollisionWorld,
    motion: TaskMotion,
    Ts_world_tool: Float[np.ndarray, "m 4 4"],
    steps: Int[np.ndarray, " m"],
    width: Float[np.ndarray, " m"],
) -> Int[np.ndarray, " m"]:
    """What the hand hits at steps of a motion, its fingers open, and closed while they hold.

    Where they close and where they let go they are looked at on their way as well. Where the arm's
    free motion begins or ends the spheres decide, as they do on that motion.

    Args:
        robot, world, motion: Whose hand, in which room, for what.
        Ts_world_tool: Where the tool is.
        steps: The step of the motion at each.
        width: Between the fingers where they hold, at each [m].

    Returns:
        FREE, FLOOR or an index into the labels.
    """
    value, holding = motion.value[steps], motion.holding[steps]
    exact = ~np.isin(steps, motion.free_ends)
    codes = hand_hits(robot, world, Ts_world_tool, value, holding, exact)
    travel = hand_of(robot).closed_to(width)
    # A grasp of unknown width is one that holds nothing.
    rows = np.flatnonzero((codes == FREE) & motion.closed[steps] & (np.abs(travel) > SLIGHT))
    codes[rows] = hand_hits(
        robot, world, Ts_world_tool[rows], value[rows], holding[rows], exact[rows], travel[rows]
    )
    rows = rows[(codes[rows] == FREE) & motion.closes[steps[rows]] & (travel[rows] > SLIGHT)]
    codes[rows] = hits_while_closing(
        robot, world, Ts_world_tool[rows], value[rows], holding[rows], exact[rows], travel[rows]
    )
    return codes
