"""Arm configurations at the waypoints, for many pairs of base pose and grasp at a time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from momapos.core.compiled import B1, F1, F2, F4, I1, I2, entry, kernel
from momapos.model.collision import FREE, CollisionWorld, check_one, collision_arrays, scratch_of
from momapos.model.kinematics import (
    COARSE,
    MAX_BRANCHES,
    ArmArrays,
    Chain,
    CollisionArrays,
    TaskState,
    arm_arrays,
    begin_pose,
    ik_scratch,
    max_solutions,
    sample_count,
    solve_sample,
)
from momapos.planning.grasps import TaskMotion

from .hand_clearance import arm_spheres
from .turning_arm import Arm, robot_of

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

MAX_STEP = 0.8
"""Largest joint step between waypoints [rad]."""
SLIDE = 4.0
"""Radians that a meter of a sliding joint counts as [rad/m]."""
NOWHERE, CUT_OFF = FREE, FREE - 10
"""Why there is none where nothing is hit: out of reach, or too far from its neighbors."""


@dataclass(frozen=True)
class Layers:
    """Configurations of jobs at the waypoints, those of each one after the other."""

    q: Float[np.ndarray, "m n"]
    grasps: Int[np.ndarray, " m"]
    """The grasp of each configuration."""
    checked: Bool[np.ndarray, " m"]
    """Whether it is known to be free; at every waypoint with configurations one is."""
    first: Int[np.ndarray, "j l"]
    """Where the configurations of each job at each waypoint begin."""
    counts: Int[np.ndarray, "j l"]
    """How many there are; 0 as well where none was looked for."""
    passed: Int[np.ndarray, " j"]
    """How many waypoints had some, in the order in which they were looked at."""
    codes: Int[np.ndarray, " j"]
    """What the first configuration hit where there was none, else NOWHERE or CUT_OFF."""


class JointSteps(NamedTuple):
    """How steps of n joints are measured."""

    full_turn: B1
    """Which joints turn fully, so that a step is taken the short way round."""
    scale: F1
    """What a step of each counts as [rad/rad] or [rad/m]."""
    locked: F1
    """The same of the joints that inverse kinematics does not solve for, 0 of the others."""


class Jobs(NamedTuple):
    """Pairs of base pose and way of holding."""

    bases: F2
    """Base pose of each: x [m], y [m], yaw [rad]."""
    grasps: I2
    """Grasps that each may have at a waypoint, -1 where it has fewer."""


class Waypoints(NamedTuple):
    """The waypoints of a motion."""

    order: I1
    """The order in which they are looked at."""
    place: I1
    """How far each is along the motion, counted in waypoints."""
    step: I1
    """The step of the motion at each."""
    value: I1
    """The same for the configuration of the moved part."""
    holding: B1
    """Whether the hand holds the part there."""
    Ts_world_tool: F4
    """Tool pose of each grasp at every step."""


class Found(NamedTuple):
    """Configurations as the kernel fills them in, see `Layers`."""

    q: F2
    grasps: I1
    checked: B1
    first: I2
    counts: I2


def joint_scale(chain: Chain) -> Float[np.ndarray, " n"]:
    """What a step of each joint counts as [rad/rad] or [rad/m]."""
    return np.where(chain.prismatic, SLIDE, 1.0)


def full_turns(chain: Chain) -> Bool[np.ndarray, " n"]:
    """Which joints turn fully, so that a step is taken the short way round."""
    return ~chain.prismatic & (chain.upper - chain.lower > 2 * np.pi + 0.1)


def solve_layers(
    robot: Arm,
    world: CollisionWorld,
    motion: TaskMotion,
    bases: Float[np.ndarray, "j 3"],
    grasps: Int[np.ndarray, "j k"],
    waypoints: Int[np.ndarray, " l"],
    order: Int[np.ndarray, " o"],
) -> Layers:
    """Find configurations of each job at some waypoints, until none is free at one.

    Most are on no path in the end, so that no more are checked at a waypoint than it takes to find
    one that is free; those that are found to hit something are left out.
    A configuration that is farther from all those of the nearest waypoint on either side that has
    been looked at than `MAX_STEP` a waypoint is on no path, and is dropped before it is checked.

    Args:
        robot, world, motion: Whose arm, in which room, for what.
        bases: Base pose of each job.
        grasps: Grasps that each job may have at a waypoint, -1 where it has fewer.
        waypoints: Indices into the coarse waypoints, ascending.
        order: Indices into these: which are looked at, one after the other.
    """
    step, chain, ik = motion.waypoint_steps[waypoints], robot.chain, robot.ik
    scale = joint_scale(chain)
    locked = scale.copy()
    locked[ik.active] = 0.0
    return Layers(*_solve_layers(
        Jobs(np.ascontiguousarray(bases), np.ascontiguousarray(grasps)),
        Waypoints(
            order, waypoints, step, motion.value[step], motion.holding[step],
            np.ascontiguousarray(motion.Ts_world_tool),
        ),
        arm_arrays(chain, ik),
        collision_arrays(arm_spheres(robot_of(robot)), world),
        JointSteps(full_turns(chain), scale, locked),
    ))  # fmt: skip


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
def _near(q, limit, states, full_turn, scale):
    """Whether some of the states at another waypoint is near enough."""
    for i in range(len(states)):
        if joint_step(q, states[i], full_turn, scale, limit) <= limit:
            return True
    return False


@kernel
def _joined(q, limits, before, after, full_turn, scale):
    """Whether some state of the waypoint looked at on either side is near enough."""
    return (limits[0] == np.inf or _near(q, limits[0], before, full_turn, scale)) and (
        limits[1] == np.inf or _near(q, limits[1], after, full_turn, scale)
    )


@kernel
def _around(at, order, looked, place):
    """The waypoints next to one, on either side, of those looked at; -1 where there is none."""
    before, after = -1, -1
    for i in range(looked):
        other = order[i]
        if place[other] < place[at] and (before < 0 or place[other] > place[before]):
            before = other
        if place[other] > place[at] and (after < 0 or place[other] < place[after]):
            after = other
    return before, after


@kernel
def _tool_in_base(T, base, R, p):
    """A tool pose relative to a base pose: rotation and position, filled in."""
    c, s = np.cos(base[2]), np.sin(base[2])
    for k in range(3):
        R[0, k] = c * T[0, k] + s * T[1, k]
        R[1, k] = c * T[1, k] - s * T[0, k]
        R[2, k] = T[2, k]
    p[0] = c * T[0, 3] + s * T[1, 3] - (c * base[0] + s * base[1])
    p[1] = c * T[1, 3] - s * T[0, 3] - (c * base[1] - s * base[0])
    p[2] = T[2, 3]


@kernel
def _solve_layer(j, looked, used, jobs, path, arm, room, steps, found, scratch, placed, memory):
    """Fill in the configurations of a job at one waypoint; returns how many, and a code."""
    R, p, solutions, limits = memory
    base, w = jobs.bases[j], path.order[looked]
    full_turn, n, samples = steps.full_turn, len(steps.full_turn), arm.ik.samples
    state = TaskState(path.value[w], path.holding[w])
    low, high = _around(w, path.order, looked, path.place)
    limits[0] = limits[1] = np.inf
    before, after = found.q[:0], found.q[:0]
    if low >= 0:
        limits[0] = MAX_STEP * (path.place[w] - path.place[low])
        before = found.q[found.first[j, low] : found.first[j, low] + found.counts[j, low]]
    if high >= 0:
        limits[1] = MAX_STEP * (path.place[high] - path.place[w])
        after = found.q[found.first[j, high] : found.first[j, high] + found.counts[j, high]]
    count, worst = 0, CUT_OFF
    for column in range(jobs.grasps.shape[1]):
        grasp, code = jobs.grasps[j, column], NOWHERE
        if grasp < 0:
            break
        _tool_in_base(path.Ts_world_tool[grasp, path.step[w]], base, R, p)
        begin_pose(scratch)
        for s in range(sample_count(arm.ik)):
            # Locked joints are known beforehand, so most samples need no inverse kinematics.
            if s < len(samples) and not _joined(
                samples[s], limits, before, after, full_turn, steps.locked
            ):
                continue
            for b in range(solve_sample(s, R, p, arm, COARSE, solutions, scratch)):
                q = solutions[b]
                if not _joined(q, limits, before, after, full_turn, steps.scale):
                    if code == NOWHERE:
                        code = CUT_OFF
                    continue
                known = count == 0
                hit = check_one(q, base, state, arm.chain, room, placed) if known else FREE
                if hit == FREE:
                    for k in range(n):
                        found.q[used + count, k] = q[k]
                    found.grasps[used + count], found.checked[used + count] = grasp, known
                    count += 1
                elif code in (NOWHERE, CUT_OFF):
                    code = hit
        worst = max(worst, code)
    return count, worst


@entry
def _solve_layers(
    jobs: Jobs,
    path: Waypoints,
    arm: ArmArrays,
    room: CollisionArrays,
    steps: JointSteps,
) -> tuple[np.ndarray, ...]:
    count, n = len(jobs.bases), len(steps.full_turn)
    first = np.zeros((count, len(path.place)), np.int64)
    counts, passed, codes = (
        np.zeros_like(first),
        np.zeros(count, np.int64),
        np.zeros(count, np.int64),
    )
    scratch, placed = ik_scratch(arm), scratch_of(len(arm.chain.slides), room.spheres)
    memory = np.empty((3, 3)), np.empty(3), np.empty((MAX_BRANCHES, n)), np.empty(2)
    # Those of one job at one waypoint always find room.
    most, used = jobs.grasps.shape[1] * max_solutions(arm.ik), 0
    q, grasps = np.empty((4 * most, n)), np.empty(4 * most, np.int64)
    checked = np.empty(4 * most, np.bool_)
    for j in range(count):
        for looked in range(len(path.order)):
            if used + most > len(q):
                q, grasps = np.concatenate((q, np.empty_like(q))), np.append(grasps, grasps)
                checked = np.append(checked, checked)
            found = Found(q, grasps, checked, first, counts)
            added, code = _solve_layer(
                j, looked, used, jobs, path, arm, room, steps, found, scratch, placed, memory
            )
            if added == 0:
                codes[j] = code
                break
            first[j, path.order[looked]], counts[j, path.order[looked]] = used, added
            used, passed[j] = used + added, looked + 1
    return q[:used], grasps[:used], checked[:used], first, counts, passed, codes
