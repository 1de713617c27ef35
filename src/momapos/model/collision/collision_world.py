"""The obstacles of an arm: static boxes and cylinders, and boxes that the task moves.

Static boxes are in a bucket grid: each cell lists the boxes that a robot sphere centered in it
could touch. Moving boxes are few and are tested directly, at each joint value of the motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import owner_cache
from momapos.core.compiled import B1, F1, F2, F3, I1, LANES, entry, kernel
from momapos.model.kinematics import (
    Chain,
    ChainArrays,
    CollisionArrays,
    ObstacleArrays,
    TaskState,
    WorldArrays,
    chain_arrays,
)
from momapos.model.urdf import Boxes, MovingBoxes

from .arm_collision import (
    FLOOR,
    FREE,
    KNOWN,
    SELF,
    box_gap,
    cylinder_gap,
    hit_boxes,
    hit_floor,
    hit_self,
    place_arm,
    scratch_of,
)
from .link_hulls import moved
from .spheres import Spheres

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Float32, Int

CELL = 0.1
"""Edge length of a bucket [m]."""


@dataclass(frozen=True, eq=False)
class CollisionWorld:
    """The obstacles of one robot's arm during one task."""

    static: Boxes
    cylinder: Bool[np.ndarray, " b"]
    """Static boxes that stand for the cylinder in them, about their third axis."""
    labels: tuple[str, ...]
    """Name of each static box, then of each moving box."""
    moving: MovingBoxes
    grasped: Bool[np.ndarray, " m"]
    """Moving boxes that the gripper may touch."""
    clearance: float
    """Clearance of robot spheres [m]."""
    grid_origin: Float[np.ndarray, "3"]
    grid_shape: Int[np.ndarray, "3"]
    grid_start: Int[np.ndarray, " cells_plus_1"]
    grid_index: Int[np.ndarray, " entries"]
    filled: Int[np.ndarray, "x_plus_1 y_plus_1 z_plus_1"]
    """Summed-area table of the buckets that list a box."""

    def reason(self, code: int) -> str:
        """Describe a code of `check`."""
        if code == FREE:
            return "free"
        if code == SELF:
            return "the robot itself"
        return "the floor" if code == FLOOR else self.labels[code]

    @cached_property
    def arrays(self) -> WorldArrays:
        """Return the world as an argument of kernels."""
        static, moving = self.static, self.moving
        return WorldArrays(
            static.center, static.rotation, static.half, self.cylinder, moving.center,
            moving.rotation, moving.half, self.grasped, self.grid_origin, self.grid_shape,
            self.grid_start, self.grid_index, self.filled, self._blocks,
        )  # fmt: skip

    @property
    def _blocks(self) -> Float32[np.ndarray, "rows 8"]:
        """Return the bounds of the static boxes in blocks of eight, see `WorldArrays`."""
        extent = self.static.extent
        bounds = np.full((-(-len(extent) // LANES) * LANES, 6), np.inf, np.float32)
        bounds[: len(extent), :3] = self.static.center - extent
        bounds[: len(extent), 3:] = -(self.static.center + extent)
        return np.ascontiguousarray(bounds.reshape(-1, LANES, 6).swapaxes(1, 2)).reshape(-1, LANES)


def build_world(
    static: Boxes,
    moving: MovingBoxes,
    grasped: Bool[np.ndarray, " m"],
    labels: Sequence[str],
    spheres: Spheres,
    *,
    clearance: float,
    cylinder: Bool[np.ndarray, " b"] | None = None,
) -> CollisionWorld:
    """Build a world, with the static boxes sorted into buckets for one robot.

    Args:
        static: Static boxes in the world frame.
        moving: Moving boxes at every value of the joint.
        grasped: Which moving boxes the gripper may touch.
        labels: Names of the static boxes, then of the moving ones.
        spheres: The robot.
        clearance: Clearance of robot spheres [m].
        cylinder: Which static boxes stand for the cylinder in them, about their third axis; their
            other two edges are equal. None for none.
    """
    if cylinder is None:
        cylinder = np.zeros(len(static), bool)
    buckets = _buckets(static, float(spheres.radius.max()) + clearance)
    return CollisionWorld(static, cylinder, tuple(labels), moving, grasped, clearance, *buckets)


@owner_cache(8)
def _buckets(static: Boxes, reach: float) -> tuple[np.ndarray, ...]:
    """Sort static boxes into buckets for spheres of up to a radius [m], cached: all motions in one
    version of a scene share them.

    Returns:
        `grid_origin` to `filled` of `CollisionWorld`.
    """
    corners = np.einsum("bij,bj->bij", static.rotation, static.half)
    extent = np.abs(corners).sum(2)
    if len(static):
        low = (static.center - extent).min(0) - reach
        high = (static.center + extent).max(0) + reach
    else:
        low, high = np.zeros(3), np.full(3, CELL)
    shape = np.maximum(1, np.ceil((high - low) / CELL)).astype(np.int64)
    start, index = _fill_buckets(static.center, static.rotation, static.half, low, shape, reach)
    filled = np.zeros(shape + 1, np.int32)
    sums = (np.diff(start) > 0).reshape(shape).astype(np.int32)
    filled[1:, 1:, 1:] = sums.cumsum(0).cumsum(1).cumsum(2)
    return low, shape, start, index, filled


@entry
def _fill_buckets(
    center: F2, rotation: F3, half: F2, low: F1, shape: I1, reach: float
) -> tuple[np.ndarray, np.ndarray]:
    """List the boxes that a sphere of radius `reach` in each cell could touch (CSR)."""
    cells = shape[0] * shape[1] * shape[2]
    counts = np.zeros(cells + 1, np.int64)
    index = np.empty(0, np.int64)
    inflated = reach + CELL * np.sqrt(3.0) / 2
    for fill in range(2):
        if fill == 1:
            for c in range(cells):
                counts[c + 1] += counts[c]
            index = np.empty(counts[cells], np.int64)
            cursor = counts.copy()
        for b in range(len(center)):
            lo = np.empty(3, np.int64)
            hi = np.empty(3, np.int64)
            for k in range(3):
                extent = inflated
                for a in range(3):
                    extent += abs(rotation[b, k, a]) * half[b, a]
                lo[k] = max(0, int((center[b, k] - extent - low[k]) / CELL))
                hi[k] = min(shape[k] - 1, int((center[b, k] + extent - low[k]) / CELL))
            for i in range(lo[0], hi[0] + 1):
                for j in range(lo[1], hi[1] + 1):
                    for k in range(lo[2], hi[2] + 1):
                        point = (
                            low[0] + (i + 0.5) * CELL,
                            low[1] + (j + 0.5) * CELL,
                            low[2] + (k + 0.5) * CELL,
                        )
                        if box_gap(point, inflated, center, rotation, half, b) > 0.0:
                            continue
                        cell = (i * shape[1] + j) * shape[2] + k
                        if fill == 0:
                            counts[cell + 1] += 1
                        else:
                            index[cursor[cell]] = b
                            cursor[cell] += 1
    return counts, index


@kernel
def any_filled(c, r, low, shape, filled):
    """Return whether any bucket that overlaps a link's bounding sphere lists a box."""
    i0 = min(max(int(np.floor((c[0] - r - low[0]) / CELL)), 0), shape[0])
    i1 = min(max(int(np.floor((c[0] + r - low[0]) / CELL)) + 1, 0), shape[0])
    j0 = min(max(int(np.floor((c[1] - r - low[1]) / CELL)), 0), shape[1])
    j1 = min(max(int(np.floor((c[1] + r - low[1]) / CELL)) + 1, 0), shape[1])
    k0 = min(max(int(np.floor((c[2] - r - low[2]) / CELL)), 0), shape[2])
    k1 = min(max(int(np.floor((c[2] + r - low[2]) / CELL)) + 1, 0), shape[2])
    count = (
        filled[i1, j1, k1] - filled[i0, j1, k1] - filled[i1, j0, k1] - filled[i1, j1, k0]
        + filled[i0, j0, k1] + filled[i0, j1, k0] + filled[i1, j0, k0] - filled[i0, j0, k0]
    )  # fmt: skip
    return count > 0


@kernel
def bucket_at(m, world):
    """Return the bucket that holds a point, or -1 outside the grid."""
    low, shape = world.grid_origin, world.grid_shape
    i = int(np.floor((m[0] - low[0]) / CELL))
    j = int(np.floor((m[1] - low[1]) / CELL))
    k = int(np.floor((m[2] - low[2]) / CELL))
    if not (0 <= i < shape[0] and 0 <= j < shape[1] and 0 <= k < shape[2]):
        return -1
    return (i * shape[1] + j) * shape[2] + k


@kernel
def static_gap(c, r, world, b):
    """Return the squared distance of a sphere's center from static shape b minus r squared."""
    if world.cylinder[b]:
        return cylinder_gap(c, r, world.center, world.rotation, world.half, b)
    return box_gap(c, r, world.center, world.rotation, world.half, b)


@kernel
def _hit_static(R, p, bounds, spheres, world, margin):
    center, radius, start = spheres.center, spheres.radius, spheres.start
    segment, bound_radius = spheres.segment, spheres.bound_radius
    low, shape = world.grid_origin, world.grid_shape
    grid_start, grid_index = world.grid_start, world.grid_index
    for g in range(len(segment)):
        if spheres.gripper[g] == KNOWN:
            continue
        if not any_filled(bounds[g], bound_radius[g], low, shape, world.filled):
            continue
        for s in range(start[g], start[g + 1]):
            m = moved(R, p, segment[g], center[s])
            cell = bucket_at(m, world)
            if cell < 0:
                continue
            for at in range(grid_start[cell], grid_start[cell + 1]):
                b = grid_index[at]
                if static_gap(m, radius[s] + margin, world, b) < 0.0:
                    return b
    return FREE


@kernel
def _hit_moving(R, p, bounds, state, room):
    spheres, world, margin = room
    boxes = ObstacleArrays(
        world.moving_center[state.value],
        world.moving_rotation[state.value],
        world.moving_half[state.value],
        world.grasped,
    )
    return hit_boxes(R, p, bounds, spheres, boxes, state.holding, margin)


@kernel
def check_one(q, base, state, chain, room, scratch):
    """Return the code of the first collision of a configuration; scratch is `scratch_of(...)`."""
    R, p, bounds = scratch
    spheres, world, margin = room
    place_arm(q, base, chain, spheres, scratch)
    if hit_floor(R, p, bounds, spheres) != FREE:
        return FLOOR
    code = _hit_moving(R, p, bounds, state, room)
    if code != FREE:
        return code + len(world.center)
    code = _hit_static(R, p, bounds, spheres, world, margin)
    return code if code != FREE else hit_self(R, p, bounds, spheres)


@entry
def _state_hits(
    q: F2,
    bases: F2,
    value: I1,
    holding: B1,
    chain: ChainArrays,
    room: CollisionArrays,
) -> np.ndarray:
    """Return the code of the first collision of each configuration, or FREE."""
    scratch, out = scratch_of(len(chain.slides), room.spheres), np.empty(len(q), np.int64)
    for m in range(len(q)):
        state = TaskState(value[m], holding[m])
        out[m] = check_one(q[m], bases[m], state, chain, room, scratch)
    return out


@owner_cache(8)
def collision_arrays(spheres: Spheres, world: CollisionWorld) -> CollisionArrays:
    """Return the arguments of an arm's collision check."""
    return CollisionArrays(spheres.arrays, world.arrays, world.clearance)


def check(
    world: CollisionWorld,
    chain: Chain,
    spheres: Spheres,
    q: Float[np.ndarray, "m n"],
    bases: Float[np.ndarray, "m 3"],
    value: Int[np.ndarray, " m"],
    holding: Bool[np.ndarray, " m"],
) -> Int[np.ndarray, " m"]:
    """Return what each configuration hits first: FREE, FLOOR, SELF or an index into the labels.

    Args:
        world: The obstacles.
        chain, spheres: The arm.
        q: Arm configurations.
        bases: Base pose (x, y, yaw) of each configuration.
        value: Index of the object's joint value at each configuration.
        holding: Whether the gripper may touch the grasped part at each configuration.
    """
    arrays = (np.ascontiguousarray(array) for array in (q, bases, value, holding))
    return _state_hits(*arrays, chain_arrays(chain), collision_arrays(spheres, world))
