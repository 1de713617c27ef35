"""Find a continuous arm path over the waypoints: all IK branches, a graph search, a dense check."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from momapos.core.compiled import F1, F2, F3, I1, entry
from momapos.core.geometry import invert, pose_planar
from momapos.model.collision import FREE, CollisionWorld, check
from momapos.model.kinematics import (
    EXACT,
    ArmArrays,
    NewtonRule,
    arm_arrays,
    newton,
    newton_scratch,
)
from momapos.model.records import PoseOutcome
from momapos.planning.grasps import TaskMotion

from .arm_models import ArmModel, hand_poses, robot_of, split_states, standing_arm
from .hand_clearance import arm_spheres, hand_hits_along
from .ik_layers import (
    CUT_OFF,
    NOWHERE,
    Layers,
    full_turns,
    joint_scale,
    solve_layers,
)
from .ik_layers import OVERLOADED as OVERLOADED_LAYER
from .path_graph import PathGraph
from .task_loads import TaskLoads

if TYPE_CHECKING:
    from jaxtyping import Float, Int

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
