"""Check straight motions of an arm at one base pose: for collisions, and for what motors bear.

Spheres find the pairs of a link and a box that may touch; for these the link's hulls decide.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from momapos.core.compiled import F1, F2, LANES, entry, kernel
from momapos.model.kinematics import (
    ArmScratch,
    Chain,
    ChainArrays,
    CollisionArrays,
    LoadArrays,
    LoadScratch,
    TaskState,
    chain_arrays,
    load_excess,
    load_scratch,
    state_loads,
)

from .arm_collision import (
    FINGER,
    HIT,
    KNOWN,
    PALM,
    SELF,
    EightStates,
    box_gap,
    collisions,
    eight_states,
    hit_self,
    place_arm,
    scratch_of,
    set_states,
)
from .collision_world import CollisionWorld, bucket_at, collision_arrays, static_gap
from .link_hulls import hull_meets_box, moved
from .spheres import Spheres

if TYPE_CHECKING:
    from jaxtyping import Float


@kernel
def hulls_hit(R, p, bounds, state, room):
    """Return whether a link hits a box, at a configuration whose spheres may hit one.

    Args:
        R, p, bounds: From `place_arm`.
        state: `TaskState`.
        room: `CollisionArrays`.
    """
    spheres, world, margin = room
    for g in range(len(spheres.segment)):
        if spheres.gripper[g] != KNOWN and (
            _hits_moving(R, p, bounds, g, state, spheres, world, margin)
            or _hits_static(R, p, g, spheres, world, margin)
        ):
            return True
    return False


@kernel
def _hits_moving(R, p, bounds, g, state, spheres, world, margin):
    role = spheres.gripper[g]
    if state.holding and role == FINGER:
        return False
    center, rotation = world.moving_center[state.value], world.moving_rotation[state.value]
    half = world.moving_half[state.value]
    bound = (bounds[g, 0], bounds[g, 1], bounds[g, 2])
    for b in range(len(center)):
        if state.holding and role == PALM and world.grasped[b]:
            continue
        if box_gap(bound, spheres.bound_radius[g] + margin, center, rotation, half, b) > 0.0:
            continue
        for s in range(spheres.start[g], spheres.start[g + 1]):
            m = moved(R, p, spheres.segment[g], spheres.center[s])
            if box_gap(m, spheres.radius[s] + margin, center, rotation, half, b) < 0.0:
                boxes = center, rotation, half
                if not _apart(R, p, spheres.hulls, g, boxes, b, False, margin):
                    return True
                break
    return False


@kernel
def _hits_static(R, p, g, spheres, world, margin):
    known = -1
    for s in range(spheres.start[g], spheres.start[g + 1]):
        m = moved(R, p, spheres.segment[g], spheres.center[s])
        cell, r = bucket_at(m, world), spheres.radius[s] + margin
        if cell < 0:
            continue
        for at in range(world.grid_start[cell], world.grid_start[cell + 1]):
            b = world.grid_index[at]
            if b == known or static_gap(m, r, world, b) >= 0.0:
                continue
            boxes = world.center, world.rotation, world.half
            if not _apart(R, p, spheres.hulls, g, boxes, b, world.cylinder[b], margin):
                return True
            known = b
    return False


@kernel
def _apart(R, p, hulls, g, boxes, b, cylinder, margin):
    """Return whether box b is separate from all hulls of a group."""
    first, last = hulls.of_group[g], hulls.of_group[g + 1]
    if first == last:
        return False
    gap = margin + hulls.margin
    for h in range(first, last):
        if hull_meets_box(R, p, hulls, h, boxes, b, cylinder, gap):
            return False
    return True


class HandLoad(NamedTuple):
    """What the arm bears in a free motion."""

    limits: LoadArrays
    force: F1
    """Force on what the hand holds, in the base frame [N]; zero for an empty hand."""
    in_tool: F1
    """Where it acts, in the tool frame [m]."""


class Upright(NamedTuple):
    """How upright the hand stays."""

    axis: F1
    """Direction in the frame of the last moved link that points up where the hand is upright."""
    cosine: float
    """Least cosine of its tilt; -1 for any tilt."""


ANY_TILT = -1.0
"""The least cosine, with which no tilt is too large [-]."""


class MotionArrays(NamedTuple):
    """`StraightMotions`."""

    base: F1
    state: TaskState
    step: float
    chain: ChainArrays
    room: CollisionArrays
    load: HandLoad
    upright: Upright
    fine: bool


class MotionScratch(NamedTuple):
    """Scratch memory of `motion_hit`."""

    q: F1
    step: F1
    arm: ArmScratch
    loads: LoadScratch
    point: F1
    eight: EightStates


@kernel
def motion_scratch(motion, joints):
    """Allocate the scratch memory of `motion_hit` for n joints."""
    moved = len(motion.chain.slides)
    return MotionScratch(
        np.empty(joints),
        np.empty(joints),
        scratch_of(moved, motion.room.spheres),
        load_scratch(moved, joints),
        np.empty(3),
        eight_states(moved, len(motion.room.spheres.segment), len(motion.room.world.blocks) // 6),
    )


@kernel
def _overloaded(q, motion, scratch):
    """Return whether a motor or the base does not bear a state."""
    chain, load, R, p = motion.chain, motion.load, scratch.arm.R, scratch.arm.p
    last, R0 = len(chain.slides), scratch.arm.R[0]
    # The arm is placed in the world; the point is needed in the base frame.
    for k in range(3):
        scratch.point[k] = p[last, k] - p[0, k]
        for i in range(3):
            local = chain.tool_offset[i]
            for j in range(3):
                local += chain.tool_rotation[i, j] * load.in_tool[j]
            scratch.point[k] += R[last, k, i] * local
    x, y = scratch.point[0], scratch.point[1]
    scratch.point[0] = R0[0, 0] * x + R0[1, 0] * y
    scratch.point[1] = R0[0, 1] * x + R0[1, 1] * y
    stability = state_loads(q, chain, load.limits, load.force, scratch.point, scratch.loads)
    excess, _ = load_excess(scratch.loads.efforts, stability, load.limits)
    return excess > 0.0


@kernel
def up_of(R, upright):
    """Return where the upright direction points in the world, for rotations from `place_arm`."""
    last = R[len(R) - 1]
    x, y, z = 0.0, 0.0, 0.0
    for k in range(3):
        x += last[0, k] * upright.axis[k]
        y += last[1, k] * upright.axis[k]
        z += last[2, k] * upright.axis[k]
    return x, y, z


@kernel
def motion_hit(a, b, motion, known, scratch):
    """Return whether the straight motion from a to b collides, tilts or overloads the robot.

    Args:
        a, b: Configurations (n,).
        motion: `MotionArrays`.
        known: Whether a is known to be free.
        scratch: From `motion_scratch`.
    """
    longest = 0.0
    for k in range(len(a)):
        longest = max(longest, abs(b[k] - a[k]))
    steps = max(int(np.ceil(longest / motion.step - 1e-9)), 1)
    # Rounds of eight states, evenly spaced, where each has every n-th one from the end: collisions
    # are found early.
    spare = 0 if known else 1
    rounds = (steps + spare + LANES - 1) // LANES
    steps = rounds * LANES - spare
    for first in range(rounds):  # noqa: SIM110, numba has no generators here
        if _round_hit(a, b, motion, steps, first, rounds, scratch):
            return True
    return False


@kernel
def _round_hit(a, b, motion, steps, first, rounds, scratch):
    """Check eight states, every n-th one back from the end."""
    q, step = scratch.q, scratch.step
    for k in range(len(q)):
        step[k] = (a[k] - b[k]) * (rounds / steps)
    _interpolate(a, b, steps, first, q)
    set_states(q, step, motion.chain, scratch.eight)
    chain, room = motion.chain, motion.room
    doubt, near = collisions(motion.base, motion.state, chain, room, motion.fine, scratch.eight)
    if doubt == HIT:
        return True
    loaded = len(motion.load.limits.limit) > 0
    level = motion.upright.cosine > ANY_TILT
    for lane in range(LANES):
        self_near, box_near = (doubt >> lane) & 1, (near >> lane) & 1
        if not (loaded or level or self_near or box_near):
            continue
        _interpolate(a, b, steps, first + rounds * lane, q)
        place_arm(q, motion.base, chain, room.spheres, scratch.arm)
        R, p, bounds = scratch.arm
        if level and up_of(R, motion.upright)[2] < motion.upright.cosine:
            return True
        if box_near and hulls_hit(R, p, bounds, motion.state, room):
            return True
        if self_near and hit_self(R, p, bounds, room.spheres) == SELF:
            return True
        if loaded and _overloaded(q, motion, scratch):
            return True
    return False


@kernel
def _interpolate(a, b, steps, back, out):
    """Write the state that is `back` steps before the end."""
    t = back / steps
    for k in range(len(out)):
        out[k] = b[k] + (a[k] - b[k]) * t


@entry
def _path_hit(states: F2, motion: MotionArrays) -> bool:
    """Return whether one of the straight motions between states collides."""
    scratch = motion_scratch(motion, states.shape[1])
    for i in range(1, len(states)):
        if motion_hit(states[i - 1], states[i], motion, i > 1, scratch):
            return True
    return False


@dataclass(frozen=True, eq=False)
class StraightMotions:
    """A check of straight motions of the arm between two configurations."""

    arrays: MotionArrays

    def __call__(self, a: Float[np.ndarray, " n"], b: Float[np.ndarray, " n"]) -> bool:
        """Return whether the straight motion is free, including its ends."""
        return self.along(np.stack([a, b]))

    def along(self, states: Float[np.ndarray, "m n"]) -> bool:
        """Return whether all straight motions from state to state are free."""
        return not _path_hit(np.ascontiguousarray(states, float), self.arrays)


def build_motions(
    world: CollisionWorld,
    chain: Chain,
    spheres: Spheres,
    base: Float[np.ndarray, "3"],
    *,
    value: int,
    holding: bool,
    step: float,
    load: HandLoad | None = None,
    upright: Upright | None = None,
    extra_clearance: float = 0.0,
    fine: bool = False,
) -> StraightMotions:
    """Build the check of straight motions of an arm at one base pose.

    Args:
        world: The obstacles.
        chain, spheres: The arm.
        base: Base pose (x, y, yaw).
        value: Index of the object's joint value.
        holding: Whether the gripper may touch the grasped part.
        step: Largest joint step between checked states [rad] or [m].
        load: What the motors and the base have to bear; None if they bear anything.
        upright: How upright the hand stays; None for any tilt.
        extra_clearance: Clearance in addition to that of the world, also from itself [m].
        fine: Whether hulls decide where spheres hit a box, which takes longer. Spheres protrude by
            up to two centimeters.
    """
    if load is None:
        none = np.zeros(0)
        unlimited = LoadArrays(none, np.zeros((0, 3)), none, np.zeros((0, 2)), none, 0.0)
        load = HandLoad(unlimited, np.zeros(3), np.zeros(3))
    grown = spheres.grown(extra_clearance) if extra_clearance else spheres
    return StraightMotions(
        MotionArrays(
            np.array(base, float), TaskState(value, holding), step, chain_arrays(chain),
            collision_arrays(grown, world), load,
            upright or Upright(np.array([0.0, 0.0, 1.0]), ANY_TILT), fine,
        )
    )  # fmt: skip
