"""Find a continuous arm path over the waypoints: all IK branches, a graph search, a dense check.

Most configurations end up on no path. The search takes unchecked configurations for free and checks
those of its path. If one collides, it checks all others that are reached and searches again, which
is faster than to search after every collision.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

from momapos.core.compiled import B1, F1, F2, F3, F4, I1, I2, entry, kernel
from momapos.core.geometry import invert, pose_planar
from momapos.model.collision import FREE, CollisionWorld, check_one, scratch_of
from momapos.model.kinematics import (
    EXACT,
    ArmArrays,
    ArmScratch,
    NewtonRule,
    TaskState,
    arm_arrays,
    load_excess,
    load_scratch,
    newton,
    newton_scratch,
    state_loads,
)
from momapos.model.records import PoseOutcome
from momapos.model.robots import RobotLoads, robot_loads
from momapos.planning.grasps import TaskMotion

from .hand_clearance import hand_hits_along
from .ik_layers import (
    CUT_OFF,
    MAX_STEP,
    NOWHERE,
    ArmModel,
    Jobs,
    Layers,
    TaskArrays,
    hand_poses,
    joint_scale,
    joint_step,
    layer_jobs,
    load_in_base,
    robot_of,
    slide,
    solve_layers,
    split_states,
    standing_arm,
    task_arrays,
)
from .ik_layers import OVERLOADED as OVERLOADED_LAYER

if TYPE_CHECKING:
    from jaxtyping import Float, Int


MAX_TURN = float(np.radians(25.0))
"""Largest turn of the hand about a bar between waypoints [rad]."""
_TURN_SCALE = MAX_STEP / MAX_TURN
"""Weight of that turn in a step [rad/rad]."""
_ROUNDING = 1e-9
"""More than the rounding errors of sums of steps [rad]."""


UNCHECKED, CHECKED, BANNED = 0, 1, 2
"""States of a configuration at a waypoint: not checked for collision, free, or on no path."""


class _Graph(NamedTuple):
    """The search in the configurations of one job, waypoint by waypoint."""

    start: I1
    """First node of each waypoint, and the number of nodes."""
    row: I1
    """The configuration of the first node of each waypoint."""
    cost: F1
    """Smallest sum of steps from the first waypoint to each node."""
    parent: I1
    """The node before it on that path, or -1."""
    here: F1
    """Scratch: a base pose."""
    scratch: ArmScratch


@kernel
def _graph_of(j, layers, task):
    """Return the graph of a job, not searched."""
    layer = task.course.layer
    start, row = np.zeros(len(layer) + 1, np.int64), np.empty(len(layer), np.int64)
    for w in range(len(layer)):
        start[w + 1] = start[w] + layers.counts[j, layer[w]]
        row[w] = layers.first[j, layer[w]]
    scratch = scratch_of(len(task.standing.chain.slides), task.room.spheres)
    cost, parent = np.empty(start[-1]), np.empty(start[-1], np.int64)
    return _Graph(start, row, cost, parent, np.empty(3), scratch)


@kernel
def _extend(graph, begin, layers, task, states):
    """Search the path with the smallest sum of steps to each node of the waypoints from one on.

    A step connects states of the same lane, by the lanes in the waypoint's row. Return the number
    of waypoints reached.
    """
    start, row, cost, parent = graph.start, graph.row, graph.cost, graph.parent
    course, steps, grasps = task.course, task.steps, layers.grasps
    for i in range(start[begin], len(cost)):
        cost[i], parent[i] = np.inf, -1
    if begin == 0:
        for i in range(start[1]):
            if states[course.again[0], row[0] + i] != BANNED:
                cost[i] = 0.0
    for w in range(max(begin, 1), len(row)):
        any_reached = False
        lane, offset = course.lanes[course.row[w]], row[w - 1] - start[w - 1]
        for i in range(start[w], start[w + 1]):
            one = row[w] + i - start[w]
            if states[course.again[w], one] == BANNED:
                continue
            grasp, best, before = grasps[one], np.inf, -1
            for j in range(start[w - 1], start[w]):
                # A longer step is not better, up to rounding.
                most = min(MAX_STEP, best - cost[j] + _ROUNDING)
                if most <= 0.0:
                    continue
                other = grasps[j + offset]
                d = 0.0
                if other != grasp:
                    if lane[grasp] != lane[other]:
                        continue
                    d = _TURN_SCALE * abs(course.angles[grasp] - course.angles[other])
                if d < most:
                    q = layers.q[j + offset]
                    d = max(d, joint_step(q, layers.q[one], steps.full_turn, steps.scale, most))
                    if d < MAX_STEP and cost[j] + d < best:
                        best, before = cost[j] + d, j
            cost[i], parent[i] = best, before
            any_reached |= before >= 0
        if not any_reached:
            return w
    return len(row)


@kernel
def _trace(graph, chosen):
    """Fill in the configurations of the cheapest path to the last waypoint."""
    start, cost = graph.start, graph.cost
    last = len(graph.row) - 1
    best = start[last]
    for i in range(start[last], start[last + 1]):
        if cost[i] < cost[best]:
            best = i
    for w in range(last, -1, -1):
        chosen[w] = graph.row[w] + best - start[w]
        best = graph.parent[best]


@kernel
def _collides(graph, w, row, base, layers, task, states):
    """Check a configuration at a waypoint, if it was not checked before; ban it if it collides."""
    course, standing = task.course, task.standing
    if states[course.again[w], row] != UNCHECKED:
        return False
    states[course.again[w], row] = CHECKED
    step, q = course.waypoints[w], layers.q[row]
    slide(q, base[min(step, len(base) - 1)], standing, graph.here)
    state, own = TaskState(course.value[step], course.holding[step]), q[len(standing.slides) :]
    if check_one(own, graph.here, state, standing.chain, task.room, graph.scratch) == FREE:
        return False
    states[course.again[w], row] = BANNED
    return True


@kernel
def _shortest_path(j, base, layers, task, states, collided, chosen):
    """Fill in the configurations of a job's path; return the number of waypoints reached."""
    graph = _graph_of(j, layers, task)
    count = len(graph.row)
    reached = begin = _extend(graph, 0, layers, task, states)
    if reached == count:
        _trace(graph, chosen)
        for w in range(count):
            if _collides(graph, w, chosen[w], base, layers, task, states):
                begin, collided[j] = min(begin, w), True
    if begin < count and collided[j]:
        begin = min(begin, _check_reached(graph, base, layers, task, states))
        reached = _extend(graph, begin, layers, task, states)
        if reached == count:
            _trace(graph, chosen)
    return reached


@kernel
def _check_reached(graph, base, layers, task, states):
    """Check all configurations with a path to them; return the first waypoint of a collision."""
    begin = len(graph.row)
    for w in range(len(graph.row)):
        for i in range(graph.start[w], graph.start[w + 1]):
            one = graph.row[w] + i - graph.start[w]
            if graph.cost[i] < np.inf and _collides(graph, w, one, base, layers, task, states):
                begin = min(begin, w)
    return begin


@entry
def _shortest_paths(
    left: I1, jobs: Jobs, layers: Layers, task: TaskArrays, states: I2, collided: B1
) -> tuple[np.ndarray, np.ndarray]:
    """Find the shortest free path of some jobs that have configurations in all layers.

    Args:
        left: Indices of these jobs (k,).
        jobs, layers, task: All jobs.
        states: State of each configuration at each of its waypoints; updated.
        collided: Whether a path of each job collided; updated.

    Returns:
        The number of waypoints reached (k,) and, if that is all, the configuration at each (k, w).
    """
    reached = np.empty(len(left), np.int64)
    chosen = np.full((len(left), len(task.course.waypoints)), -1)
    for i in range(len(left)):
        j = left[i]
        reached[i] = _shortest_path(j, jobs.bases[j], layers, task, states, collided, chosen[i])
    return reached, chosen


BaseCodes: TypeAlias = "Callable[[Float[np.ndarray, 'd 3'], Int[np.ndarray, ' d']], np.ndarray]"
"""Returns what the base hits at poses, given the index of the part's value at each, as a code."""
StateAtStep: TypeAlias = "tuple[Float[np.ndarray, '3'], Float[np.ndarray, ' n'], int]"
"""A base pose, an arm configuration, and the step of the motion."""
HandHits: TypeAlias = "dict[int, tuple[int, int]]"
"""The first step of a motion at which the hand hits something, and its code, by grasp; for grasps
that do not turn."""
UNREACHABLE, HIT, BROKEN, FOUND, OVERLOADED = 0, 1, 2, 3, 4
TRIES = 4
"""Number of paths of a job that are filled densely and checked [-]."""
MAX_DENSE_STEP = 0.25
"""Largest joint step between states [rad]; see `PRISMATIC_SCALE` for prismatic joints."""


@dataclass(frozen=True, eq=False)
class ArmPath:
    """The result of the path search for one grasp mode at one base pose."""

    status: int
    """UNREACHABLE, HIT, BROKEN (no continuous branch), OVERLOADED or FOUND."""
    waypoint: int
    """Waypoint of the failure; the number of waypoints if there was none."""
    passed: int
    """Number of waypoints with a free configuration before the failure."""
    obstacle: int
    """Code of the obstacle that was hit, or FREE."""
    q: Float[np.ndarray, "d n"] | None = None
    """Arm states at every step of the motion."""
    bases: Float[np.ndarray, "d 3"] | None = None
    """Base pose at every step; None if the base stands."""
    base_hits: bool = False
    """Whether it is the base that hits the obstacle, and not the arm."""
    overload: PoseOutcome | None = None
    """What a motor or the base would have to bear, if OVERLOADED."""
    hit: StateAtStep | None = None
    """A state that hits the obstacle, if HIT."""


def find_paths(
    robot: ArmModel,
    world: CollisionWorld,
    motion: TaskMotion,
    bases: Float[np.ndarray, "j *d 3"],
    modes: Int[np.ndarray, " j"],
    hand: HandHits,
    stands: BaseCodes | None = None,
) -> list[ArmPath]:
    """Search an arm path for each pair of base pose, or base path, and grasp mode.

    A grasp mode is the index of a grasp or, after those, of a group of grasps between which the
    hand turns. A pair ends at its first layer without configurations. Otherwise its shortest path
    through the waypoints is filled densely and checked, up to `TRIES` times.

    Args:
        robot, world, motion: Arm, obstacles and task motion.
        bases: Base poses, each for the whole motion or one for every step of it.
        modes: The grasp mode at each.
        hand: Cache of the hand's first hits, which is extended.
        stands: What a base that moves hits; None for base poses that stand clear.
    """
    task, jobs = task_arrays(motion, robot, world), layer_jobs(robot, motion, bases, modes)
    layers, course = solve_layers(jobs, task), task.course
    number, count = course.layer, len(course.layer)
    loads = robot_loads(robot_of(robot))
    last = len(course.order)
    paths = [
        ArmPath(BROKEN, 0, count, FREE)
        if passed == last
        else _failure(layers, j, motion, int(course.order[passed]), loads)
        for j, passed in enumerate(layers.passed.tolist())
    ]
    left = np.flatnonzero(layers.passed == last)
    if not len(left):
        return paths
    states = np.tile(layers.checked.astype(np.int64), (course.again.max() + 1, 1))
    collided, Ts_base_world = np.zeros(len(paths), bool), invert(pose_planar(jobs.bases))
    for _ in range(TRIES):
        reached, chosen = _shortest_paths(left, jobs, layers, task, states, collided)
        for j, waypoints in zip(left.tolist(), reached.tolist(), strict=True):
            if waypoints < count and paths[j].status == BROKEN:
                paths[j] = ArmPath(BROKEN, int(number[waypoints]), count, FREE)
        left, chosen = left[reached == count], chosen[reached == count]
        if not len(left):
            break
        grasps = layers.grasps[chosen]
        tools = np.stack([motion.tool_poses(one) for one in grasps])
        dense, failed, hits, codes, refused, excess, where = _fill_paths(
            left, chosen, Ts_base_world[left] @ tools, jobs, layers, task
        )
        again = []
        for i, j in enumerate(left.tolist()):
            bad = int(failed[i])
            if bad < 0:
                filled = _Filled(robot, world, motion, bases[j], dense[i], tools[i], grasps[i])
                hit, code = int(hits[i]), int(codes[i])
                base_hits = False
                if hit == len(dense[i]):
                    hit, code = filled.hand_hit(hand)
                if hit == len(dense[i]) and stands is not None:
                    base_hits = True
                    hit, code = _first_hit(stands(filled.split[0], motion.value))
                bad = min(hit, int(refused[i]))
                if bad == len(dense[i]):
                    moved = None if stands is None else filled.split[0]
                    paths[j] = ArmPath(FOUND, count, count, FREE, filled.split[1], moved)
                    continue
                waypoint = int(number[np.searchsorted(course.waypoints, bad)])
                if bad == hit:
                    bases_of, states_of = filled.split
                    state = bases_of[bad], states_of[bad], bad
                    paths[j] = ArmPath(HIT, waypoint, count, code, base_hits=base_hits, hit=state)
                else:
                    overload = loads.outcome(
                        int(where[i]), float(excess[i]), waypoint_name(waypoint)
                    )
                    paths[j] = ArmPath(OVERLOADED, waypoint, count, FREE, overload=overload)
            # Banning the configuration after the failure forces another path.
            at = min(int(np.searchsorted(course.waypoints, bad)), count - 1)
            states[course.again[at], chosen[i, at]] = BANNED
            again.append(j)
        if not again:
            break
        left = np.array(again)
    return paths


def _failure(
    layers: Layers, job: int, motion: TaskMotion, layer: int, loads: RobotLoads
) -> ArmPath:
    """Return the failure of a job that has no configuration in a layer."""
    code, passed = int(layers.codes[job]), int(layers.passed[job])
    if code == CUT_OFF:
        return ArmPath(BROKEN, layer, passed, FREE)
    if code == OVERLOADED_LAYER:
        where, excess = int(layers.where[job]), float(layers.excess[job])
        overload = loads.outcome(where, excess, waypoint_name(layer))
        return ArmPath(OVERLOADED, layer, passed, FREE, overload=overload)
    if code == NOWHERE:
        return ArmPath(UNREACHABLE, layer, passed, code)
    step = int(motion.waypoint_steps[int(np.argmax(np.array(motion.layer_of) == layer))])
    n = loads.robot.chain.size
    state = layers.hit[job, :3], layers.hit[job, 3 : 3 + n], step
    return ArmPath(HIT, layer, passed, code, hit=state)


def waypoint_name(waypoint: int) -> str:
    """Return the words for a waypoint in reasons."""
    return "the pre-grasp" if waypoint == 0 else f"waypoint {waypoint}"


@dataclass(frozen=True, eq=False)
class _Filled:
    """A path of one job with a state at every step of the motion."""

    robot: ArmModel
    world: CollisionWorld
    motion: TaskMotion
    base: Float[np.ndarray, "*d 3"]
    q: Float[np.ndarray, "d n"]
    Ts_world_tool: Float[np.ndarray, "d 4 4"]
    grasps: Int[np.ndarray, " w"]

    @cached_property
    def split(self) -> tuple[Float[np.ndarray, "d 3"], Float[np.ndarray, "d m"]]:
        """Return the base pose at each step, and the states of the arm on it."""
        return split_states(self.robot, self.base, self.q)

    def hand_hit(self, known: HandHits) -> tuple[int, int]:
        """Return the first step at which the hand hits something and its code, see `_first_hit`.

        The result for a hand that does not turn about its grasp is cached: it is the same from
        every base pose.
        """
        grasp, standing = int(self.grasps[0]), standing_arm(self.robot)
        still = standing is robot_of(self.robot) and bool((self.grasps == grasp).all())
        if still and grasp in known:
            return known[grasp]
        Ts = hand_poses(standing, *self.split, self.Ts_world_tool)
        steps = np.arange(len(self.q))
        width = np.full(len(self.q), self.motion.grasps.width[grasp])
        codes = hand_hits_along(robot_of(self.robot), self.world, self.motion, Ts, steps, width)
        found = _first_hit(codes)
        if still:
            known[grasp] = found
        return found


def _first_hit(codes: Int[np.ndarray, " d"]) -> tuple[int, int]:
    """Return the first step that is not free, and its code; the number of steps if all are."""
    hits = np.flatnonzero(codes != FREE)
    return (int(hits[0]), int(codes[hits[0]])) if len(hits) else (len(codes), FREE)


@kernel
def _unwrap(q, full_turn, limits):
    """Unwrap joints that turn fully along a path, within their limits if possible."""
    turn = 2.0 * np.pi
    for k in range(q.shape[1]):
        if not full_turn[k]:
            continue
        before, shift, low, high = q[0, k], 0.0, q[0, k], q[0, k]
        for w in range(1, len(q)):
            step = q[w, k] - before
            before = q[w, k]
            if abs(step) >= np.pi:
                shorter = (step + np.pi) % turn - np.pi
                if shorter == -np.pi and step > 0.0:
                    shorter = np.pi
                shift += shorter - step
            q[w, k] += shift
            low, high = min(low, q[w, k]), max(high, q[w, k])
        if np.isfinite(limits.upper[k]):
            over, under = max(0.0, high - limits.upper[k]), max(0.0, limits.lower[k] - low)
            back = turn * np.ceil(over / turn) - turn * np.ceil(under / turn)
            for w in range(len(q)):
                q[w, k] -= back


@entry
def _fill_paths(
    left: I1, chosen: I2, targets: F4, jobs: Jobs, layers: Layers, task: TaskArrays
) -> tuple[np.ndarray, ...]:
    """Fill the states between the waypoints of some jobs' paths, and check them.

    Args:
        left: Indices of these jobs (k,).
        chosen: Index of their configuration at each waypoint (k, w).
        targets: Tool poses at every step in the frame of the base without slides (k, d, 4, 4).
        jobs, layers, task: All jobs.

    Returns:
        States (k, d, n), the step that Newton does not reach, or -1 (k,); the first step at which
        the arm hits something, or d, and its code; the first step that motors or base do not bear,
        or d, the largest excess, and where it is (k,).
    """
    arm, standing, course, lead = task.arm, task.standing, task.course, len(task.standing.slides)
    count, steps, n = len(left), len(course.value), len(arm.limits.lower)
    dense, failed = np.empty((count, steps, n)), np.empty(count, np.int64)
    hits, codes = np.full(count, steps), np.full(count, FREE)
    refused, excess = np.full(count, steps), np.full(count, -np.inf)
    where, q = np.zeros(count, np.int64), np.empty((chosen.shape[1], n))
    here, load = np.empty(3), np.empty((2, 3))
    joints = len(standing.chain.slides)
    placed, bearing = scratch_of(joints, task.room.spheres), load_scratch(joints, n - lead)
    for i in range(count):
        base, grasp = jobs.bases[left[i]], layers.grasps[chosen[i, 0]]
        for w in range(len(q)):
            q[w] = layers.q[chosen[i, w]]
        _unwrap(q, task.steps.full_turn, arm.limits)
        failed[i] = _track(q, course.waypoints, targets[i], arm, task.steps.scale, dense[i])
        if failed[i] >= 0:
            continue
        for s in range(steps):
            own = dense[i, s, lead:]
            slide(dense[i, s], base[min(s, len(base) - 1)], standing, here)
            if hits[i] == steps:
                state = TaskState(course.value[s], course.holding[s])
                code = check_one(own, here, state, standing.chain, task.room, placed)
                if code != FREE:
                    hits[i], codes[i] = s, code
            load_in_base(course.force[grasp, s], course.point[grasp, s], here, load)
            stability = state_loads(own, standing.chain, task.robot, load[0], load[1], bearing)
            worst, at = load_excess(bearing.efforts, stability, task.robot)
            if worst > excess[i]:
                excess[i], where[i] = worst, at
            if worst > 0.0:
                refused[i] = min(refused[i], s)
    return dense, failed, hits, codes, refused, excess, where


def follow(
    arm: ArmModel, states: Float[np.ndarray, "d n"], targets: Float[np.ndarray, "d 4 4"]
) -> Float[np.ndarray, "d n"] | None:
    """Solve for arm states with the tool at given poses, from nearby states.

    Args:
        arm: The arm.
        states: Arm states with the tool near those poses.
        targets: Tool poses in the base frame.

    Returns:
        The states, or None if the arm does not get there within its limits and in small steps.
    """
    chain, near = arm.chain, np.ascontiguousarray(states)
    found = np.empty_like(near)
    bad = _track(
        near, np.arange(len(near)), np.ascontiguousarray(targets), arm_arrays(chain, arm.ik),
        joint_scale(chain), found,
    )  # fmt: skip
    return found if bad < 0 else None


@entry
def _track(
    q: F2,
    coarse: I1,
    targets: F3,
    arm: ArmArrays,
    scale: F1,
    dense: F2,
) -> int:
    """Fill the states between waypoints by Newton steps; return the step that fails, or -1."""
    n = q.shape[1]
    # A literal would make Newton compile once more.
    rule = NewtonRule(np.int64(8), 1e-6, EXACT, False)  # type: ignore[arg-type]
    lower, upper = arm.limits
    scratch = newton_scratch(arm.chain, n)
    for w in range(len(coarse)):
        first = coarse[w - 1] + 1 if w > 0 else 0
        for s in range(first, coarse[w] + 1):
            t = (s - coarse[w - 1]) / (coarse[w] - coarse[w - 1]) if w > 0 else 1.0
            for k in range(n):
                dense[s, k] = (1.0 - t) * q[max(w - 1, 0), k] + t * q[w, k]
            residual = newton(
                dense[s],
                arm.ik.active,
                arm.chain,
                arm.limits,
                targets[s, :3, :3],
                targets[s, :3, 3],
                rule,
                scratch,
            )
            if residual > 1e-9:
                return s
            for k in range(n):
                if dense[s, k] < lower[k] - 1e-6 or dense[s, k] > upper[k] + 1e-6:
                    return s
                if s > 0 and abs(dense[s, k] - dense[s - 1, k]) * scale[k] > MAX_DENSE_STEP:
                    return s
    return -1
