"""Find a continuous arm path over the waypoints: all IK branches, a graph search, a dense check.

Most configurations end up on no path. The search takes unchecked configurations for free and checks
those of its path. If one collides, it checks all others and searches again, which is faster than to
search after every collision.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

from momapos.core.compiled import B1, F1, F2, F3, I1, I2, entry, kernel
from momapos.core.geometry import invert, pose_planar
from momapos.model.collision import (
    FREE,
    CollisionWorld,
    check,
    check_one,
    collision_arrays,
    scratch_of,
)
from momapos.model.kinematics import (
    EXACT,
    ArmArrays,
    ChainArrays,
    CollisionArrays,
    NewtonRule,
    TaskState,
    arm_arrays,
    chain_arrays,
    newton,
    newton_scratch,
)
from momapos.model.records import PoseOutcome
from momapos.planning.grasps import TaskMotion

from .hand_clearance import arm_spheres, hand_hits_along
from .ik_layers import (
    CUT_OFF,
    MAX_STEP,
    NOWHERE,
    ArmModel,
    Layers,
    TaskLoads,
    full_turns,
    hand_poses,
    joint_scale,
    joint_step,
    robot_of,
    solve_layers,
    split_states,
    standing_arm,
)
from .ik_layers import OVERLOADED as OVERLOADED_LAYER

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int


MAX_TURN = float(np.radians(25.0))
"""Largest turn of the hand about a bar between waypoints [rad]."""


class _Nodes(NamedTuple):
    """The configurations of a job, waypoint by waypoint."""

    states: F2
    """Joint values, and the turn of the hand as one more joint."""
    q: F2
    """Values of all degrees of freedom, slides of the base first."""
    bases: F2
    arm_q: F2
    """The base pose at each, and the state of the arm on it."""
    first: I1
    """First index of each waypoint's nodes, and their number."""
    lane: I2
    row: I1
    """See `TaskMotion.lanes`."""
    checked: B1
    """Which nodes were checked for collision; updated."""
    banned: B1
    """Which nodes are excluded; updated."""


class _Steps(NamedTuple):
    """How to measure steps between states, see `joint_step`."""

    full_turn: B1
    scale: F1


class _Moments(NamedTuple):
    """The state of the task at each waypoint."""

    value: I1
    holding: B1


@dataclass(frozen=True, eq=False)
class PathGraph:
    """The configurations of one job: a grasp mode at a base pose."""

    nodes: _Nodes
    grasps: Int[np.ndarray, " m"]
    """The grasp of each node."""
    steps: _Steps
    moments: _Moments
    chain: ChainArrays
    room: CollisionArrays

    @classmethod
    def of(
        cls,
        robot: ArmModel,
        world: CollisionWorld,
        motion: TaskMotion,
        base: Float[np.ndarray, "*d 3"],
        layers: Layers,
        job: int,
    ) -> PathGraph:
        """Return the graph of a job with configurations at all waypoints.

        Args:
            robot, world, motion: Arm, obstacles and task motion.
            base: Base pose x [m], y [m], yaw [rad], or one at every step of the motion.
            layers: The configurations of all jobs.
            job: The index of this one.
        """
        layer_of, (lanes, row) = motion.layer_of, motion.lanes
        counts = layers.counts[job, layer_of]
        first = np.append(0, np.cumsum(counts))
        begin = layers.first[job, layer_of] - first[:-1]
        which = np.arange(first[-1]) + np.repeat(begin, counts)
        q, grasps, checked = (x[which] for x in (layers.q, layers.grasps, layers.checked))
        chain, step = robot.chain, motion.waypoint_steps
        at = base if base.ndim == 1 else base[np.repeat(step, counts)]
        bases, arm_q = map(np.ascontiguousarray, split_states(robot, at, q))
        return cls(
            _Nodes(
                np.column_stack([q, motion.turning.angles[grasps]]), q, bases, arm_q, first,
                np.ascontiguousarray(lanes[:, grasps]), row, checked, np.zeros(len(q), bool),
            ),
            grasps,
            _Steps(
                np.append(full_turns(chain), False),
                np.append(joint_scale(chain), MAX_STEP / MAX_TURN),
            ),
            _Moments(motion.value[step], motion.holding[step]),
            chain_arrays(standing_arm(robot).chain),
            collision_arrays(arm_spheres(robot_of(robot)), world),
        )  # fmt: skip

    @property
    def banned(self) -> Bool[np.ndarray, " m"]:
        """Nodes that are on no path; may be extended."""
        return self.nodes.banned

    def shortest_free_path(self) -> tuple[int, Int[np.ndarray, " w"]]:
        """Return the number of waypoints reached and, if that is all, the node at each."""
        chosen = np.full(len(self.moments.value), -1)
        args = self.nodes, self.steps, self.moments, self.chain, self.room, chosen
        return int(_shortest_free_path(*args)), chosen


@kernel
def _extend(nodes, steps, begin, cost, parent):
    """Search the path with the smallest sum of steps to each node of the layers from one on.

    A step connects states of the same lane, by the lanes in the layer's row. Return the number of
    layers reached.
    """
    start, banned, lane, row = nodes.first, nodes.banned, nodes.lane, nodes.row
    for i in range(start[begin], len(cost)):
        cost[i], parent[i] = np.inf, -1
        if i < start[1] and not banned[i]:
            cost[i] = 0.0
    for w in range(max(begin, 1), len(start) - 1):
        any_reached = False
        for i in range(start[w], start[w + 1]):
            if banned[i]:
                continue
            for j in range(start[w - 1], start[w]):
                if cost[j] >= cost[i] or lane[row[w], i] != lane[row[w], j]:
                    continue
                d = joint_step(
                    nodes.states[j], nodes.states[i], steps.full_turn, steps.scale, MAX_STEP
                )
                if d < MAX_STEP and cost[j] + d < cost[i]:
                    cost[i], parent[i] = cost[j] + d, j
                    any_reached = True
        if not any_reached:
            return w
    return len(start) - 1


@kernel
def _trace(start, cost, parent, chosen):
    """Fill in the nodes of the cheapest path to the last layer."""
    layers = len(start) - 1
    best = start[layers - 1]
    for i in range(start[layers - 1], start[layers]):
        if cost[i] < cost[best]:
            best = i
    for w in range(layers - 1, -1, -1):
        chosen[w] = best
        best = parent[best]


@kernel
def _collides(i, w, nodes, moments, chain, room, scratch):
    """Check a node of a layer, if it was not checked before; ban it if it collides."""
    if nodes.checked[i]:
        return False
    nodes.checked[i] = True
    state = TaskState(moments.value[w], moments.holding[w])
    if check_one(nodes.arm_q[i], nodes.bases[i], state, chain, room, scratch) == FREE:
        return False
    nodes.banned[i] = True
    return True


@entry
def _shortest_free_path(
    nodes: _Nodes,
    steps: _Steps,
    moments: _Moments,
    chain: ChainArrays,
    room: CollisionArrays,
    chosen: I1,
) -> int:
    """Fill in the nodes of the path; return the number of layers reached."""
    start, layers = nodes.first, len(nodes.first) - 1
    cost, parent = np.empty(len(nodes.q)), np.empty(len(nodes.q), np.int64)
    reached = _extend(nodes, steps, 0, cost, parent)
    if reached < layers:
        return reached
    _trace(start, cost, parent, chosen)
    scratch, begin = scratch_of(len(chain.slides), room.spheres), layers
    for w in range(layers):
        if _collides(chosen[w], w, nodes, moments, chain, room, scratch):
            begin = min(begin, w)
    if begin == layers:
        return layers
    for w in range(layers):
        for i in range(start[w], start[w + 1]):
            if _collides(i, w, nodes, moments, chain, room, scratch):
                begin = min(begin, w)
    reached = _extend(nodes, steps, begin, cost, parent)
    if reached == layers:
        _trace(start, cost, parent, chosen)
    return reached


BaseCodes: TypeAlias = "Callable[[Float[np.ndarray, 'd 3'], Int[np.ndarray, ' d']], np.ndarray]"
"""Returns what the base hits at poses, given the index of the part's value at each, as a code."""
HandCodes: TypeAlias = "dict[int, Int[np.ndarray, ' d']]"
"""Collision codes of the hand at every step of a motion, by grasp; for grasps that do not turn."""
UNREACHABLE, HIT, BROKEN, FOUND, OVERLOADED = 0, 1, 2, 3, 4
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


def find_paths(
    robot: ArmModel,
    world: CollisionWorld,
    motion: TaskMotion,
    bases: Float[np.ndarray, "j *d 3"],
    modes: Int[np.ndarray, " j"],
    hand: HandCodes,
    stands: BaseCodes | None = None,
) -> list[ArmPath]:
    """Search an arm path for each pair of base pose, or base path, and grasp mode.

    A grasp mode is the index of a grasp or, after those, of a group of grasps between which the
    hand turns. Waypoints that fail most, the ends and the middle, are solved first; a pair ends at
    its first failure.

    Args:
        robot, world, motion: Arm, obstacles and task motion.
        bases: Base poses, each for the whole motion or one for every step of it.
        modes: The grasp mode at each.
        hand: Cache of the hand's collision codes, which is extended.
        stands: What a base that moves hits; None for base poses that stand clear.
    """
    waypoint_of = np.unique(motion.layer_of, return_index=True)[1]
    order = np.array(_ends_first(len(waypoint_of)))
    layers = solve_layers(
        robot, world, motion, bases, motion.turning.members(modes), waypoint_of, order
    )
    loads = TaskLoads(robot_of(robot), motion)
    return [
        _connect(
            robot,
            world,
            loads,
            bases[j],
            PathGraph.of(robot, world, motion, bases[j], layers, j),
            hand,
            stands,
        )
        if passed == len(order)
        else _failure(layers, j, int(order[passed]), loads)
        for j, passed in enumerate(layers.passed.tolist())
    ]


def _failure(layers: Layers, job: int, waypoint: int, loads: TaskLoads) -> ArmPath:
    """Return the failure of a job that has no configuration at a waypoint."""
    code, passed = int(layers.codes[job]), int(layers.passed[job])
    if code == CUT_OFF:
        return ArmPath(BROKEN, waypoint, passed, FREE)
    if code == OVERLOADED_LAYER:
        where, excess = int(layers.where[job]), float(layers.excess[job])
        overload = loads.limits.outcome(where, excess, waypoint_name(waypoint))
        return ArmPath(OVERLOADED, waypoint, passed, FREE, overload=overload)
    return ArmPath(UNREACHABLE if code == NOWHERE else HIT, waypoint, passed, code)


def _ends_first(count: int) -> list[int]:
    """Order range(count): grasp, last, first, then by bisection."""
    order, stride = [1, count - 1, 0], count - 1
    order = list(dict.fromkeys(order))
    while stride > 1:
        stride = (stride + 1) // 2
        order += [i for i in range(0, count, stride) if i not in order]
    return order


def _connect(
    robot: ArmModel,
    world: CollisionWorld,
    loads: TaskLoads,
    base: np.ndarray,
    graph: PathGraph,
    hand: HandCodes,
    stands: BaseCodes | None,
) -> ArmPath:
    """Find the shortest path through the waypoints of one job, fill it densely, and check it."""
    chain, grasps, motion = robot.chain, graph.grasps, loads.motion
    standing = standing_arm(robot)
    full_turn, scale = full_turns(chain), joint_scale(chain)
    count, number = len(motion.layer_of), motion.layer_of
    worst = ArmPath(BROKEN, 0, count, FREE)
    for _ in range(4):
        reached, chosen = graph.shortest_free_path()
        if reached < count:
            if worst.status != BROKEN:
                return worst
            return ArmPath(BROKEN, int(number[reached]), count, FREE)
        q = _unwrap(graph.nodes.q[chosen], full_turn, chain.lower, chain.upper)
        tools = motion.tool_poses(grasps[chosen])
        targets = invert(pose_planar(base)) @ tools
        dense = np.empty((len(motion.object_q), chain.size))
        arm = arm_arrays(chain, robot.ik)
        bad = _track(q, motion.waypoint_steps, targets, arm, scale, dense)
        if bad < 0:
            here, own = split_states(robot, base, dense)
            codes = check(
                world, standing.chain, arm_spheres(robot_of(robot)), own, here,
                motion.value, motion.holding,
            )  # fmt: skip
            if (codes == FREE).all():
                codes = _hand_codes(robot, world, motion, here, own, tools, grasps[chosen], hand)
            base_hits = stands is not None and bool((codes == FREE).all())
            if stands is not None and base_hits:
                codes = stands(here, motion.value)
            borne = loads.at(here, own, int(grasps[chosen[0]]), np.arange(len(dense)))
            bad_states = np.flatnonzero((codes != FREE) | borne.refused)
            if not len(bad_states):
                moved = None if stands is None else here
                return ArmPath(FOUND, count, count, FREE, own, moved)
            bad = int(bad_states[0])
            waypoint = int(number[np.searchsorted(motion.waypoint_steps, bad)])
            if codes[bad] != FREE:
                worst = ArmPath(HIT, waypoint, count, int(codes[bad]), base_hits=base_hits)
            else:
                overload = loads.limits.worst(borne, waypoint_name(waypoint))
                worst = ArmPath(OVERLOADED, waypoint, count, FREE, overload=overload)
        # Banning the node after the failure forces another path.
        at = min(int(np.searchsorted(motion.waypoint_steps, bad)), count - 1)
        graph.banned[chosen[at]] = True
    return worst


def waypoint_name(waypoint: int) -> str:
    """Return the words for a waypoint in reasons."""
    return "the pre-grasp" if waypoint == 0 else f"waypoint {waypoint}"


def _hand_codes(
    robot: ArmModel,
    world: CollisionWorld,
    motion: TaskMotion,
    bases: Float[np.ndarray, "d 3"],
    states: Float[np.ndarray, "d n"],
    tools: Float[np.ndarray, "d 4 4"],
    grasps: Int[np.ndarray, " w"],
    known: HandCodes,
) -> Int[np.ndarray, " d"]:
    """Return the hand's collision codes at every step, see `hand_hits_along`.

    Codes of a hand that does not turn about its grasp are cached: they are the same from every
    base pose.
    """
    grasp = int(grasps[0])
    standing = standing_arm(robot)
    still = standing is robot_of(robot) and bool((grasps == grasp).all())
    if still and grasp in known:
        return known[grasp]
    codes = hand_hits_along(
        robot_of(robot), world, motion, hand_poses(standing, bases, states, tools),
        np.arange(len(states)), np.full(len(states), motion.grasps.width[grasp]),
    )  # fmt: skip
    if still:
        known[grasp] = codes
    return codes


def _unwrap(
    q: np.ndarray, full_turn: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> np.ndarray:
    """Unwrap joints that turn fully, within their limits if possible."""
    out = q.copy()
    out[:, full_turn] = np.unwrap(q[:, full_turn], axis=0)
    turn = 2 * np.pi
    for k in np.flatnonzero(full_turn & np.isfinite(upper)):
        over = max(0.0, out[:, k].max() - upper[k])
        under = max(0.0, lower[k] - out[:, k].min())
        out[:, k] -= turn * np.ceil(over / turn) - turn * np.ceil(under / turn)
    return out


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
