"""Free arm configurations at one waypoint, for many pairs of base pose and grasp at a time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from momapos.compiled import B1, F1, F2, F3, I1, entry, kernel
from momapos.geometry.transforms import invert, pose_planar
from momapos.kinematics.chain import Chain
from momapos.kinematics.closed_forms import MAX_BRANCHES
from momapos.kinematics.collision import FREE, scratch_of
from momapos.kinematics.ik import (
    COARSE,
    arm_arrays,
    begin_pose,
    ik_scratch,
    max_solutions,
    sample_count,
    solve_sample,
)
from momapos.kinematics.records import ArmArrays, CollisionArrays, TaskState
from momapos.kinematics.world import CollisionWorld, check_one, collision_arrays
from momapos.manipulation.hand_room import arm_spheres
from momapos.manipulation.motion import TaskMotion
from momapos.manipulation.turning_arm import Arm, robot_of

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

MAX_STEP = 0.8
"""Largest joint step between waypoints [rad]."""
SLIDE = 4.0
"""Radians that a meter of a sliding joint counts as [rad/m]."""
NOWHERE, CUT_OFF = FREE, FREE - 10
"""Why a layer is empty where nothing is hit: out of reach, or too far from its neighbors."""


@dataclass(frozen=True)
class Layer:
    """The free configurations of all living jobs at one waypoint."""

    waypoint: int
    jobs: Int[np.ndarray, " a"]
    q: Float[np.ndarray, "a b n"]
    """Free configurations first; beyond the count there is nothing of meaning."""
    counts: Int[np.ndarray, " a"]
    codes: Int[np.ndarray, " a"]
    """What the first configuration hit, else NOWHERE or CUT_OFF; of use where the count is 0."""
    grasps: Int[np.ndarray, "a b"]
    """The grasp of each configuration."""

    def nodes(self, job: int) -> tuple[Float[np.ndarray, "k n"], Int[np.ndarray, " k"]]:
        """The configurations of one job, and their grasps."""
        row = int(np.searchsorted(self.jobs, job))
        return self.q[row, : self.counts[row]], self.grasps[row, : self.counts[row]]


class JointSteps(NamedTuple):
    """How steps of n joints are measured."""

    full_turn: B1
    """Which joints turn fully, so that a step is taken the short way round."""
    scale: F1
    """What a step of each counts as [rad/rad] or [rad/m]."""
    locked: F1
    """The same of the joints that inverse kinematics does not solve for, 0 of the others."""


class Neighbor(NamedTuple):
    """A known layer as the kernel takes it."""

    states: F3
    counts: I1
    rows: I1
    """Row of each job in the states."""
    limit: float
    """Largest joint step to it [rad]; infinite where there is no layer."""


class Neighbors(NamedTuple):
    """The known layers next to a waypoint."""

    before: Neighbor
    after: Neighbor


def joint_scale(chain: Chain) -> Float[np.ndarray, " n"]:
    """What a step of each joint counts as [rad/rad] or [rad/m]."""
    return np.where(chain.prismatic, SLIDE, 1.0)


def full_turns(chain: Chain) -> Bool[np.ndarray, " n"]:
    """Which joints turn fully, so that a step is taken the short way round."""
    return ~chain.prismatic & (chain.upper - chain.lower > 2 * np.pi + 0.1)


def solve_layer(
    robot: Arm,
    world: CollisionWorld,
    motion: TaskMotion,
    bases: Float[np.ndarray, "j 3"],
    grasps: Int[np.ndarray, "j k"],
    alive: Int[np.ndarray, " a"],
    waypoint: int,
    known: Sequence[Layer],
) -> Layer:
    """Find the free configurations at a waypoint that known layers can be joined to.

    A configuration that is farther from all those of the nearest layer on either side than
    `MAX_STEP` a waypoint is on no path, and is dropped before it is checked.

    Args:
        robot, world, motion: Whose arm, in which room, for what.
        bases: Base pose of each job.
        grasps: Grasps that each job may have at this waypoint, -1 where it has fewer.
        alive: Indices of the jobs to be solved.
        waypoint: Index into the coarse waypoints.
        known: Layers that have been solved, for these jobs at least.
    """
    step, chain, ik = motion.waypoint_steps[waypoint], robot.chain, robot.ik
    job, column = np.nonzero(grasps[alive] >= 0)
    row, grasp = alive[job], grasps[alive[job], column]
    poses = invert(pose_planar(bases[row])) @ motion.Ts_world_tool[grasp, step]
    before = max((k for k in known if k.waypoint < waypoint), key=_waypoint, default=None)
    after = min((k for k in known if k.waypoint > waypoint), key=_waypoint, default=None)
    scale = joint_scale(chain)
    locked = scale.copy()
    locked[ik.active] = 0.0
    around = Neighbors(
        _neighbor(before, row, waypoint, chain.size),
        _neighbor(after, row, waypoint, chain.size),
    )
    q, counts, codes = _solve_layer(
        np.ascontiguousarray(poses),
        bases[row],
        TaskState(int(motion.value[step]), bool(motion.holding[step])),
        arm_arrays(chain, ik),
        collision_arrays(arm_spheres(robot_of(robot)), world),
        JointSteps(full_turns(chain), scale, locked),
        around,
    )
    if grasps.shape[1] == 1:
        return Layer(waypoint, alive, q, counts, codes, np.tile(grasp[:, None], (1, q.shape[1])))
    return _merged(waypoint, alive, job, grasp, q, counts, codes)


def _merged(
    waypoint: int,
    alive: Int[np.ndarray, " a"],
    job: Int[np.ndarray, " r"],
    grasp: Int[np.ndarray, " r"],
    q: Float[np.ndarray, "r b n"],
    counts: Int[np.ndarray, " r"],
    codes: Int[np.ndarray, " r"],
) -> Layer:
    """One layer of what was found for every grasp of every job; `job` is sorted."""
    total = np.bincount(job, counts, len(alive)).astype(np.int64)
    row = np.repeat(np.arange(len(job)), counts)
    within = np.arange(len(row)) - np.repeat(np.cumsum(counts) - counts, counts)
    place = np.arange(len(row)) - (np.cumsum(total) - total)[job[row]]
    states = np.empty((len(alive), int(total.max(initial=0)), q.shape[2]))
    grasps = np.full(states.shape[:2], -1)
    states[job[row], place], grasps[job[row], place] = q[row, within], grasp[row]
    worst = np.full(len(alive), CUT_OFF)
    np.maximum.at(worst, job, codes)
    return Layer(waypoint, alive, states, total, worst, grasps)


def _waypoint(layer: Layer) -> int:
    return layer.waypoint


def _neighbor(layer: Layer | None, jobs: np.ndarray, waypoint: int, n: int) -> Neighbor:
    """A known layer as the kernel takes it; the limit is infinite where there is none."""
    if layer is None:
        none = np.empty(0, np.int64)
        return Neighbor(np.empty((0, 0, n)), none, none, np.inf)
    limit = MAX_STEP * abs(waypoint - layer.waypoint)
    return Neighbor(layer.q, layer.counts, np.searchsorted(layer.jobs, jobs), float(limit))


@kernel
def joint_step(a, b, full_turn, scale, limit):
    """Largest joint difference, the short way round; it stops at the first beyond the limit."""
    worst = 0.0
    for k in range(len(a)):
        d = b[k] - a[k]
        if full_turn[k]:
            d -= 2.0 * np.pi * np.floor(d / (2.0 * np.pi) + 0.5)
        worst = max(worst, abs(d) * scale[k])
        if worst > limit:
            break
    return worst


@kernel
def _joined(q, job, around, full_turn, scale):
    """Whether some configuration of each neighboring layer is near enough."""
    return _near(q, job, around.before, full_turn, scale) and _near(
        q, job, around.after, full_turn, scale
    )


@kernel
def _near(q, job, neighbor, full_turn, scale):
    """Whether some configuration of a neighboring layer is near enough."""
    states, counts, rows, limit = neighbor
    if limit == np.inf:
        return True
    row = rows[job]
    for i in range(counts[row]):
        if joint_step(q, states[row, i], full_turn, scale, limit) <= limit:
            return True
    return False


@entry
def _solve_layer(
    poses: F3,
    bases: F2,
    state: TaskState,
    arm: ArmArrays,
    room: CollisionArrays,
    steps: JointSteps,
    around: Neighbors,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    chain, samples = arm.chain, arm.ik.samples
    full_turn, n = steps.full_turn, len(steps.full_turn)
    scratch, placed = ik_scratch(arm), scratch_of(len(chain.slides), room.spheres)
    solutions = np.empty((MAX_BRANCHES, n))
    out = np.empty((len(poses), max_solutions(arm.ik), n))
    counts, codes = np.zeros(len(poses), np.int64), np.full(len(poses), NOWHERE)
    for j in range(len(poses)):
        R, p = poses[j, :3, :3], poses[j, :3, 3]
        begin_pose(scratch)
        for s in range(sample_count(arm.ik)):
            # Locked joints are known beforehand, so most samples need no inverse kinematics.
            if s < len(samples) and not _joined(samples[s], j, around, full_turn, steps.locked):
                continue
            found = solve_sample(s, R, p, arm, COARSE, solutions, scratch)
            for b in range(found):
                q = solutions[b]
                if not _joined(q, j, around, full_turn, steps.scale):
                    if codes[j] == NOWHERE:
                        codes[j] = CUT_OFF
                    continue
                code = check_one(q, bases[j], state, chain, room, placed)
                if code == FREE:
                    for k in range(n):
                        out[j, counts[j], k] = q[k]
                    counts[j] += 1
                elif codes[j] == NOWHERE or codes[j] == CUT_OFF:
                    codes[j] = code
    return out, counts, codes
