"""Check the hand alone for collision: which grasps are free, and what encloses them.

The task fixes the tool poses, so the hand's collisions depend on the grasp and not on the base
pose. Spheres find what is near; if a sphere of the gripper touches, its boxes decide, so that
fingers fit between a bar and a carcass. The arm's kernels then skip the hand.

At the pre-grasp the arm connects the hand with the base outside. A flood fill of the space around
the hand shows whether anything as thick as the thinnest link gets out, before arms are checked.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from momapos.core import owner_cache
from momapos.core.compiled import B1, F1, F2, F3, I1, entry, kernel
from momapos.core.geometry import invert
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
"""Rigid groups: the palm, and the fingers on each side of the closing axis."""
MIN_TRAVEL = 5e-4
"""Fingers that close by less count as at rest [m]."""
GAP = 1e-3
"""Clearance of the gripper's boxes [m]; smaller than that of its spheres, since 1 cm handles leave
a finger 2 mm to the carcass behind them."""


class HandArrays(NamedTuple):
    """A hand at rest in its tool frame, for the kernel."""

    spheres: SphereArrays
    boxes: BoxArrays
    start: I1
    """Boxes of group g are start[g]:start[g + 1]; for a group without boxes, its spheres decide."""
    closing: F1


class _Query(NamedTuple):
    """Obstacles for a hand at one pose."""

    boxes: BoxArrays
    cleared: I1
    """For each box, the last query of a group that found it clear."""
    margin: float
    exact: bool


class _Placed(NamedTuple):
    """Poses of the parts of a hand."""

    R: F3
    p: F2
    bounds: F2


@kernel
def _place_hand(T, travel, closing, R, p):
    """Fill in the poses of palm and fingers, each finger closed by a travel."""
    for k in range(3):
        along = T[k, 0] * closing[0] + T[k, 1] * closing[1] + T[k, 2] * closing[2]
        for s in range(3):
            R[s, k, 0], R[s, k, 1], R[s, k, 2] = T[k, 0], T[k, 1], T[k, 2]
        p[0, k] = T[k, 3]
        p[1, k] = T[k, 3] - travel * along
        p[2, k] = T[k, 3] + travel * along


@kernel
def _box_of(k, segment, hand, placed, margin, out):
    """Fill in box k of the hand at the pose of its segment, grown by a margin."""
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
    """Check by its boxes whether a group, one of whose spheres touches box b, touches it."""
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
    """Return the first moving box that the hand hits, or FREE; a holding hand may touch some."""
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
    """Return the first static box that the hand hits, or FREE."""
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


@kernel
def _dips(hand, placed, exact):
    """Return whether the gripper extends below z = 0, by its boxes or else by its spheres.

    The arm's kernels check all other links.
    """
    spheres, (center, rotation, half) = hand.spheres, hand.boxes
    for g in range(len(spheres.segment)):
        if spheres.gripper[g] == OTHER:
            continue
        down, height = placed.R[spheres.segment[g], 2], placed.p[spheres.segment[g], 2]
        if exact:
            for k in range(hand.start[g], hand.start[g + 1]):
                low = height
                for i in range(3):
                    along = 0.0
                    for j in range(3):
                        along += down[j] * rotation[k, j, i]
                    low += down[i] * center[k, i] - abs(along) * half[k, i]
                if low < 0.0:
                    return True
        else:
            for s in range(spheres.start[g], spheres.start[g + 1]):
                low = height - spheres.radius[s]
                for i in range(3):
                    low += down[i] * spheres.center[s, i]
                if low < 0.0:
                    return True
    return False


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
        if out[i] == FREE and _dips(hand, placed, exact[i]):
            out[i] = FLOOR
    return out


@owner_cache()
def arm_spheres(robot: Robot) -> Spheres:
    """Return the robot's spheres for checks that skip the hand, except against the robot itself."""
    spheres = robot.spheres.by_hulls
    known = (spheres.segment == _last_segment(robot)) & (spheres.gripper != OTHER)
    return replace(spheres, gripper=np.where(known, KNOWN, spheres.gripper))


@owner_cache()
def _hand_arrays(robot: Robot) -> HandArrays:
    """Return the gripper and all other links that the arm's last joint moves."""
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
    every = Boxes.join(boxes)
    return HandArrays(
        arrays,
        BoxArrays(every.center, every.rotation, every.half),
        np.cumsum([0, *map(len, boxes)]),
        np.ascontiguousarray(robot.closing_axis, float),
    )


def _last_segment(robot: Robot) -> int:
    return robot.segments.of_link[robot.tool_link]


def _in_tool(robot: Robot, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Transform points of the last segment to the tool frame."""
    return np.ascontiguousarray((points - robot.chain.tool_offset) @ robot.chain.tool_rotation)


def _boxes_of(robot: Robot, group: int) -> Boxes:
    """Return the boxes of a gripper's link in the tool frame; none for other links."""
    if robot.spheres.gripper[group] == OTHER:
        return Boxes.join([])
    link, poses = robot.spheres.links[group], robot.model.rest_poses
    T = invert(poses[robot.tool_link]) @ poses[link]
    return Boxes.join(boxes.moved(T) for boxes in robot.model.boxes[link])


def hand_hits(
    robot: Robot,
    world: CollisionWorld,
    Ts_world_tool: Float[np.ndarray, "m 4 4"],
    value: Int[np.ndarray, " m"],
    holding: Bool[np.ndarray, " m"],
    exact: Bool[np.ndarray, " m"],
    travel: Float[np.ndarray, " m"] | None = None,
) -> Int[np.ndarray, " m"]:
    """Check the hand alone for collision at tool poses.

    Args:
        robot: The robot.
        world: Static and moving obstacles.
        Ts_world_tool: Tool poses.
        value: Index of the object's joint value at each.
        holding: Whether the gripper may touch the grasped part.
        exact: Whether the gripper's boxes decide if a sphere touches; otherwise the spheres do.
        travel: Distance by which each finger has closed from rest [m]; 0 by default.

    Returns:
        FREE, FLOOR or an index into the labels.
    """
    hand = _hand_arrays(robot)
    if len(hand.start) == 1:
        return np.full(len(Ts_world_tool), FREE)
    travel = np.zeros(len(Ts_world_tool)) if travel is None else np.ascontiguousarray(travel, float)
    return np.asarray(_hand_hits(
        np.ascontiguousarray(Ts_world_tool),
        travel,
        np.ascontiguousarray(value),
        np.ascontiguousarray(holding),
        np.ascontiguousarray(exact),
        hand,
        world.arrays,
        world.clearance,
    ))  # fmt: skip


def hits_while_closing(
    robot: Robot,
    world: CollisionWorld,
    Ts_world_tool: Float[np.ndarray, "m 4 4"],
    value: Int[np.ndarray, " m"],
    holding: Bool[np.ndarray, " m"],
    exact: Bool[np.ndarray, " m"],
    travel: Float[np.ndarray, " m"],
) -> Int[np.ndarray, " m"]:
    """Check fingers between open and closed; arguments are those of `hand_hits`.

    Open fingers may span an obstacle that closed ones pass: the edge of a carcass, a neighboring
    handle.
    """
    # Steps of a finger's thickness miss nothing.
    count = max(2, int(np.ceil(travel.max(initial=0.0) / hand_of(robot).thickness)))
    between = np.arange(1, count) / count
    rows = np.repeat(np.arange(len(travel)), len(between))
    codes = hand_hits(
        robot, world, Ts_world_tool[rows], value[rows], holding[rows], exact[rows],
        np.outer(travel, between).ravel(),
    ).reshape(len(travel), len(between))  # fmt: skip
    return codes[np.arange(len(travel)), np.argmax(codes != FREE, axis=1)]


def hand_hits_along(
    robot: Robot,
    world: CollisionWorld,
    motion: TaskMotion,
    Ts_world_tool: Float[np.ndarray, "m 4 4"],
    steps: Int[np.ndarray, " m"],
    width: Float[np.ndarray, " m"],
) -> Int[np.ndarray, " m"]:
    """Check the hand at steps of a motion: with open fingers, closed ones, and while they close.

    At the ends of the arm's free motion the spheres decide, as they do during that motion.

    Args:
        robot, world, motion: Robot, obstacles and task motion.
        Ts_world_tool: Tool poses.
        steps: The step of the motion at each.
        width: Distance between the fingers when they hold, at each [m].

    Returns:
        FREE, FLOOR or an index into the labels.
    """
    value, holding = motion.value[steps], motion.holding[steps]
    exact = ~np.isin(steps, motion.free_ends)
    codes = hand_hits(robot, world, Ts_world_tool, value, holding, exact)
    travel = hand_of(robot).closed_to(width)
    # A grasp of unknown width (NaN) holds nothing.
    rows = np.flatnonzero((codes == FREE) & motion.closed[steps] & (np.abs(travel) > MIN_TRAVEL))
    codes[rows] = hand_hits(
        robot, world, Ts_world_tool[rows], value[rows], holding[rows], exact[rows], travel[rows]
    )
    rows = rows[(codes[rows] == FREE) & motion.closes[steps[rows]] & (travel[rows] > MIN_TRAVEL)]
    codes[rows] = hits_while_closing(
        robot, world, Ts_world_tool[rows], value[rows], holding[rows], exact[rows], travel[rows]
    )
    return codes


def collision_free_grasps(
    robot: Robot, world: CollisionWorld, motion: TaskMotion
) -> tuple[Bool[np.ndarray, " g"], str]:
    """Find the grasps whose hand is free at every waypoint, for any base pose.

    Returns:
        A mask over the grasps, and the name of the most frequent obstacle of the others.
    """
    alive, hits = np.arange(len(motion.Ts_world_tool)), []
    # Most failures occur at the grasp itself: check it first.
    for steps in (motion.waypoint_steps[1:2], np.delete(motion.waypoint_steps, slice(1, 2))):
        Ts = motion.Ts_world_tool[alive[:, None], steps].reshape(-1, 4, 4)
        width = np.repeat(motion.grasps.width[alive], len(steps))
        codes = hand_hits_along(robot, world, motion, Ts, np.tile(steps, len(alive)), width)
        hits.append(codes[codes != FREE])
        alive = alive[(codes.reshape(len(alive), len(steps)) == FREE).all(1)]
    free = np.isin(np.arange(len(motion.Ts_world_tool)), alive)
    counts = np.bincount(np.concatenate(hits) - FLOOR)
    obstacle = world.reason(int(counts.argmax()) + FLOOR) if len(counts) else ""
    return free, obstacle


OUTSIDE = 1.2
"""A hand that gets this far from all pre-grasps is outside; more than half a tall fridge [m]."""
CELLS = (0.04, 0.01)
"""Edge lengths of the cells of the fills: a quick one of free cells only, and the exact one [m]."""
THINNEST = 0.018
"""Radius of a tube inside of every arm: spheres of this radius cover the thinnest link of the
library's robots, the wrist of Stretch. Nothing is said about arms with thinner links [m]."""
MAX_RAYS = 16
"""Number of grasps whose hands are tested for a free ray before the fill [-]."""
MAX_NAMES = 3
"""Number of links that are named, those with the largest faces first [-]."""
_FREE, _CLOSED, _FILLED = 0, 1, 2


def enclosed_by(robot: Robot, world: CollisionWorld, motion: TaskMotion) -> tuple[str, ...]:
    """Return the names of what encloses the hand in every grasp; none if the arm may get in.

    Args:
        robot: The robot.
        world: Static obstacles, and the moving part.
        motion: The task's motion, with grasps in which the hand is free.
    """
    palm = _palm_center(robot)
    if palm is None or _thinnest_link(robot) < THINNEST:
        return ()
    Ts = motion.Ts_world_tool[:, 0]
    hands = np.einsum("gij,j->gi", Ts[:, :3, :3], palm) + Ts[:, :3, 3]
    boxes, labels = _obstacles(world, motion)
    back = -Ts[:, :3, :3] @ robot.approach_axis
    for rows in (slice(0, 1), slice(1, None, 1 + len(hands) // MAX_RAYS)):
        if _any_way_out(hands[rows], back[rows], boxes):
            return ()
    low, high = hands.min(0) - OUTSIDE, hands.max(0) + OUTSIDE
    low[2] = max(low[2], 0.0)
    # A tube passes through no cell whose center is nearer to a box than the tube's radius less half
    # the cell's diagonal, so gaps up to 18 mm are closed. Cells farther away than the sum are free.
    for cell, sign in zip(CELLS, (1.0, -1.0), strict=True):
        reach = THINNEST + sign * cell * np.sqrt(3.0) / 2
        shape = np.ceil((high - low) / cell).astype(np.int64)
        cells = np.floor((hands - low) / cell).astype(np.int64)
        seeds = np.unique(np.ravel_multi_index(tuple(cells.T), tuple(shape.tolist()), mode="clip"))
        faces = _enclosing(seeds, boxes.center, boxes.rotation, boxes.half, low, shape, cell, reach)
        if faces[-1] < 0.0:
            return ()
    return _names(faces[:-1], labels)


def _names(faces: Float[np.ndarray, " b"], labels: tuple[str, ...]) -> tuple[str, ...]:
    """Return the links with the largest sums."""
    total: dict[str, float] = {}
    for label, face in zip(labels, faces.tolist(), strict=True):
        name = "/".join(label.split("/")[:2])
        total[name] = total.get(name, 0.0) + face
    found = sorted((name for name in total if total[name]), key=lambda name: -total[name])
    return tuple(found[:MAX_NAMES])


def _palm_center(robot: Robot) -> Float[np.ndarray, "3"] | None:
    """Return the center of the hand's largest sphere in the tool frame; None without one."""
    spheres, chain = robot.spheres, robot.chain
    last = robot.segments.of_link[robot.tool_link]
    group = np.repeat(np.arange(len(spheres.segment)), np.diff(spheres.start))
    rows = np.flatnonzero((spheres.segment == last)[group] & (spheres.gripper != FINGER)[group])
    if not len(rows):
        return None
    center = spheres.center[rows[spheres.radius[rows].argmax()]]
    return np.asarray((center - chain.tool_offset) @ chain.tool_rotation)


def _thinnest_link(robot: Robot) -> float:
    """Return the smallest radius, over the arm's links, of the largest sphere in its cover [m]."""
    spheres = robot.spheres
    largest = np.maximum.reduceat(spheres.radius, spheres.start[:-1])
    return float(largest[(spheres.segment > 0) & (spheres.gripper == OTHER)].min(initial=np.inf))


def _obstacles(world: CollisionWorld, motion: TaskMotion) -> tuple[Boxes, tuple[str, ...]]:
    """Return what stands around the pre-grasps; an object that is carried does not count."""
    if motion.task.joint is None:
        return world.static, world.labels[: len(world.static)]
    return Boxes.join([world.static, world.moving.at(0)]), world.labels


def _any_way_out(
    points: Float[np.ndarray, "n 3"], back: Float[np.ndarray, "n 3"], boxes: Boxes
) -> bool:
    """Return whether some point sees the outside, straight back from the grasp or up."""
    up = np.broadcast_to([0.0, 0.0, 1.0], back.shape)
    start, along = np.concatenate([points, points]), OUTSIDE * np.concatenate([back, up])
    return bool((~_blocked(start, along, boxes)).any())


def _blocked(
    start: Float[np.ndarray, "n 3"], along: Float[np.ndarray, "n 3"], boxes: Boxes
) -> Bool[np.ndarray, " n"]:
    """Return which segments meet a box, grown by `THINNEST`, or the floor."""
    p = np.einsum("nbi,bik->nbk", start[:, None] - boxes.center, boxes.rotation)
    d = np.einsum("ni,bik->nbk", along, boxes.rotation)
    half = boxes.half + THINNEST
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.stack([(-half - p) / d, (half - p) / d])
    parallel = np.abs(d) < 1e-9
    within = np.abs(p) <= half
    enters = np.where(parallel, np.where(within, -np.inf, np.inf), t.min(0)).max(2)
    leaves = np.where(parallel, np.where(within, np.inf, -np.inf), t.max(0)).min(2)
    hits = (enters <= leaves) & (leaves >= 0.0) & (enters <= 1.0)
    return np.asarray(hits.any(1) | (start[:, 2] + along[:, 2] <= 0.0))


@kernel
def _range(b, boxes, low, shape, cell, reach, first, last):
    """Fill in the first and last cell along each axis that box b can touch."""
    center, rotation, half = boxes
    for k in range(3):
        extent = reach
        for a in range(3):
            extent += abs(rotation[b, k, a]) * half[b, a]
        first[k] = max(0, int(np.floor((center[b, k] - extent - low[k]) / cell)))
        last[k] = min(shape[k] - 1, int(np.floor((center[b, k] + extent - low[k]) / cell)))


@kernel
def _count_or_close(b, boxes, low, shape, cell, reach, state, close):
    """Close the cells near box b, or count the filled ones."""
    center, rotation, half = boxes
    first, last = np.empty(3, np.int64), np.empty(3, np.int64)
    _range(b, boxes, low, shape, cell, reach, first, last)
    count = 0
    for i in range(first[0], last[0] + 1):
        for j in range(first[1], last[1] + 1):
            for k in range(first[2], last[2] + 1):
                at = (i * shape[1] + j) * shape[2] + k
                if state[at] != (_FREE if close else _FILLED):
                    continue
                point = (
                    low[0] + (i + 0.5) * cell,
                    low[1] + (j + 0.5) * cell,
                    low[2] + (k + 0.5) * cell,
                )
                if box_gap(point, reach, center, rotation, half, b) < 0.0:
                    count += 1
                    if close:
                        state[at] = _CLOSED
    return count


@entry
def _enclosing(
    seeds: I1,
    center: F2,
    rotation: F3,
    half: F2,
    low: F1,
    shape: I1,
    cell: float,
    reach: float,
) -> np.ndarray:
    """Fill the cells from the seeds, except those with a box within reach of their centers.

    Returns how many filled cells each box bounds. The last entry is the number of filled cells, or
    -1 if the fill gets to the border, where it ends. The lower border may be the floor.
    """
    boxes = (center, rotation, half)
    state = np.zeros(shape[0] * shape[1] * shape[2], np.int8)
    faces = np.zeros(len(center) + 1)
    for b in range(len(center)):
        _count_or_close(b, boxes, low, shape, cell, reach, state, True)
    stack = np.empty(len(state), np.int64)
    size, filled = 0, 0
    for at in seeds:
        if state[at] == _FREE:
            state[at] = _FILLED
            stack[size] = at
            size += 1
    while size > 0:
        size -= 1
        filled += 1
        at = stack[size]
        k = at % shape[2]
        j = (at // shape[2]) % shape[1]
        i = at // (shape[1] * shape[2])
        side = i == 0 or j == 0 or i == shape[0] - 1 or j == shape[1] - 1
        if side or k == shape[2] - 1 or (k == 0 and low[2] > 0.0):
            faces[-1] = -1.0
            return faces
        # A curve gets from cell to cell through their faces.
        for step in (shape[1] * shape[2], shape[2], 1):
            for other in (at - step, at + step):
                if (step > 1 or k > 0 or other > at) and state[other] == _FREE:
                    state[other] = _FILLED
                    stack[size] = other
                    size += 1
    for b in range(len(center)):
        near = reach + 2.0 * cell
        faces[b] = _count_or_close(b, boxes, low, shape, cell, near, state, False)
    faces[-1] = filled
    return faces
