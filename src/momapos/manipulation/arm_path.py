"""One continuous arm path over the waypoints: all branches, a graph over them, a dense check."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.compiled import B1, F1, F2, F3, I1, entry
from momapos.geometry.transforms import invert, pose_planar
from momapos.kinematics.chain import chain_arrays, chain_limits
from momapos.kinematics.collision import FREE
from momapos.kinematics.ik import EXACT
from momapos.kinematics.newton import newton
from momapos.kinematics.records import ChainArrays, JointLimits
from momapos.kinematics.world import CollisionWorld, check
from momapos.manipulation.layers import (
    CUT_OFF,
    MAX_STEP,
    NOWHERE,
    Layer,
    full_turns,
    joint_scale,
    joint_step,
    solve_layer,
)
from momapos.manipulation.motion import TaskMotion
from momapos.robots.robot import Robot

if TYPE_CHECKING:
    from jaxtyping import Float, Int

UNREACHABLE, HIT, BROKEN, FOUND = 0, 1, 2, 3
MAX_DENSE_STEP = 0.25
"""Largest joint step between states [rad]; see `SLIDE` for sliding joints."""


@dataclass(frozen=True)
class ArmPath:
    """What came of one grasp at one base pose."""

    status: int
    """UNREACHABLE, HIT, BROKEN (no continuous branch) or FOUND."""
    waypoint: int
    """The waypoint at which it failed; the number of waypoints when it did not."""
    passed: int
    """How many waypoints had a free configuration before that."""
    obstacle: int
    """What was hit, a code of the world; FREE where nothing was."""
    q: Float[np.ndarray, "d n"] | None = None
    """Arm states at every step of the motion."""


def find_paths(
    robot: Robot,
    world: CollisionWorld,
    motion: TaskMotion,
    bases: Float[np.ndarray, "j 3"],
    grasps: Int[np.ndarray, " j"],
) -> list[ArmPath]:
    """Look for an arm path for each pair of base pose and grasp.

    The ends and the middle of the motion are looked at first, since they fail most; a pair
    that fails at one waypoint is not carried on.
    """
    count = len(motion.waypoint_steps)
    paths: list[ArmPath | None] = [None] * len(grasps)
    layers: list[Layer] = []
    alive = np.arange(len(grasps))
    for passed, w in enumerate(_ends_first(count)):
        layer = solve_layer(robot, world, motion, bases, grasps, alive, w, layers)
        failed = layer.counts == 0
        for j, code in zip(alive[failed].tolist(), layer.codes[failed].tolist(), strict=True):
            paths[j] = _failure(code, w, passed)
        alive = alive[~failed]
        layers.append(layer)
        if not len(alive):
            break
    layers.sort(key=lambda layer: layer.waypoint)
    for j in alive:
        nodes = [layer.nodes(int(j)) for layer in layers]
        paths[j] = _connect(robot, world, motion, bases[j], int(grasps[j]), nodes)
    return [path for path in paths if path is not None]


def _failure(code: int, waypoint: int, passed: int) -> ArmPath:
    """What a layer without configurations means for a job."""
    if code == CUT_OFF:
        return ArmPath(BROKEN, waypoint, passed, FREE)
    return ArmPath(UNREACHABLE if code == NOWHERE else HIT, waypoint, passed, code)


def _ends_first(count: int) -> list[int]:
    """All of range(count): the grasp, last, first, then ever finer between them."""
    order, stride = [1, count - 1, 0], count - 1
    order = list(dict.fromkeys(order))
    while stride > 1:
        stride = (stride + 1) // 2
        order += [i for i in range(0, count, stride) if i not in order]
    return order


def _connect(
    robot: Robot,
    world: CollisionWorld,
    motion: TaskMotion,
    base: np.ndarray,
    grasp: int,
    nodes: list[Float[np.ndarray, "_ n"]],
) -> ArmPath:
    """Shortest path through the layers of one job, then every state between, checked."""
    start = np.cumsum([0, *(len(k) for k in nodes)])
    stacked = np.concatenate(nodes)
    chain = robot.chain
    full_turn, scale = full_turns(chain), joint_scale(chain)
    banned = np.zeros(len(stacked), bool)
    targets = invert(pose_planar(base)) @ motion.Ts_world_tool[grasp]
    count = len(nodes)
    worst = ArmPath(BROKEN, 0, count, FREE)
    for _ in range(4):
        chosen = np.full(count, -1)
        reached = _shortest(stacked, start, banned, full_turn, scale, chosen)
        if reached < count:
            return worst if worst.obstacle != FREE else ArmPath(BROKEN, reached, count, FREE)
        q = _unwrap(stacked[chosen], full_turn, chain.lower, chain.upper)
        dense = np.empty((len(motion.object_q), chain.size))
        bad = _track(
            q,
            motion.waypoint_steps,
            targets,
            robot.ik.active,
            chain_arrays(chain),
            chain_limits(chain),
            scale,
            dense,
        )
        if bad < 0:
            codes = check(
                world,
                chain,
                robot.spheres,
                dense,
                np.tile(base, (len(dense), 1)),
                motion.value,
                motion.holding,
            )
            hit = np.flatnonzero(codes != FREE)
            if not len(hit):
                return ArmPath(FOUND, count, count, FREE, dense)
            bad = int(hit[0])
            step = int(np.searchsorted(motion.waypoint_steps, bad))
            worst = ArmPath(HIT, step, count, int(codes[bad]))
        # Without the node after the failure the next path must take another way.
        banned[chosen[min(int(np.searchsorted(motion.waypoint_steps, bad)), count - 1)]] = True
    return worst


@entry
def _shortest(
    q: F2,
    start: I1,
    banned: B1,
    full_turn: B1,
    scale: F1,
    chosen: I1,
) -> int:
    """Path with the smallest sum of steps through the layers; returns the layers reached."""
    count, layers = len(q), len(start) - 1
    cost, parent = np.full(count, np.inf), np.full(count, -1)
    for i in range(start[0], start[1]):
        if not banned[i]:
            cost[i] = 0.0
    for w in range(1, layers):
        any_reached = False
        for i in range(start[w], start[w + 1]):
            if banned[i]:
                continue
            for j in range(start[w - 1], start[w]):
                if cost[j] >= cost[i]:
                    continue
                d = joint_step(q[j], q[i], full_turn, scale, MAX_STEP)
                if d < MAX_STEP and cost[j] + d < cost[i]:
                    cost[i], parent[i] = cost[j] + d, j
                    any_reached = True
        if not any_reached:
            return w
    best = -1
    for i in range(start[layers - 1], start[layers]):
        if cost[i] < np.inf and (best < 0 or cost[i] < cost[best]):
            best = i
    if best < 0:
        return layers - 1
    for w in range(layers - 1, -1, -1):
        chosen[w] = best
        best = parent[best]
    return layers


def _unwrap(
    q: np.ndarray, full_turn: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> np.ndarray:
    """Follow joints that turn fully across the cut at pi, inside their limits if possible."""
    out = q.copy()
    out[:, full_turn] = np.unwrap(q[:, full_turn], axis=0)
    turn = 2 * np.pi
    for k in np.flatnonzero(full_turn & np.isfinite(upper)):
        over = max(0.0, out[:, k].max() - upper[k])
        under = max(0.0, lower[k] - out[:, k].min())
        out[:, k] -= turn * np.ceil(over / turn) - turn * np.ceil(under / turn)
    return out


@entry
def _track(
    q: F2,
    coarse: I1,
    targets: F3,
    active: I1,
    chain: ChainArrays,
    limits: JointLimits,
    scale: F1,
    dense: F2,
) -> int:
    """Fill the states between waypoints by Newton steps; returns the step that fails, or -1."""
    n = q.shape[1]
    most = np.int64(8)  # a literal would have Newton compiled once more
    lower, upper = limits
    R, p = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3))
    for w in range(len(coarse)):
        first = coarse[w - 1] + 1 if w > 0 else 0
        for s in range(first, coarse[w] + 1):
            t = (s - coarse[w - 1]) / (coarse[w] - coarse[w - 1]) if w > 0 else 1.0
            for k in range(n):
                dense[s, k] = (1.0 - t) * q[max(w - 1, 0), k] + t * q[w, k]
            residual = newton(
                dense[s],
                active,
                chain,
                targets[s, :3, :3],
                targets[s, :3, 3],
                most,
                1e-6,
                EXACT,
                (R, p),
            )
            if residual > 1e-9:
                return s
            for k in range(n):
                if dense[s, k] < lower[k] - 1e-6 or dense[s, k] > upper[k] + 1e-6:
                    return s
                if s > 0 and abs(dense[s, k] - dense[s - 1, k]) * scale[k] > MAX_DENSE_STEP:
                    return s
    return -1
