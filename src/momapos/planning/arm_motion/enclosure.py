"""Find what encloses the hand, such as the closed doors of a cabinet around its content.

At the pre-grasp the arm connects the hand with the base outside. A flood fill of the space around
the hand shows whether anything as thick as the thinnest link gets out, before arms are checked.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from momapos.core.compiled import F1, F2, F3, I1, entry, kernel
from momapos.model.collision import FINGER, OTHER, CollisionWorld, box_gap
from momapos.model.robots import Robot
from momapos.model.urdf import Boxes
from momapos.planning.grasps import TaskMotion

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

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
