"""One continuous arm path over the waypoints: all branches, a graph over them, a dense check."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numba import njit

from momapos.geometry.transforms import invert, pose_planar
from momapos.kinematics.chain import chain_arrays
from momapos.kinematics.collision import FREE
from momapos.kinematics.ik import solve_ik
from momapos.kinematics.newton import newton
from momapos.kinematics.world import World, check
from momapos.manipulation.motion import TaskMotion
from momapos.robots.robot import Robot

UNREACHABLE, HIT, BROKEN, FOUND = 0, 1, 2, 3
MAX_STEP = 0.8
"""Largest joint step between waypoints [rad] or [m]."""
MAX_DENSE_STEP = 0.25
"""Largest joint step between states [rad] or [m]."""


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
    world: World,
    motion: TaskMotion,
    bases: Float[np.ndarray, "j 3"],
    grasps: Int[np.ndarray, " j"],
) -> list[ArmPath]:
    """Look for an arm path for each pair of base pose and grasp.

    The ends and the middle of the motion are looked at first, since they fail most; a pair
    that fails at one waypoint is not carried on.
    """
    count = len(motion.coarse)
    paths: list[ArmPath | None] = [None] * len(grasps)
    layers: list[_Layer | None] = [None] * count
    alive = np.arange(len(grasps))
    for passed, w in enumerate(_ends_first(count)):
        layer = _solve_layer(robot, world, motion, bases, grasps, alive, w)
        for j, code in zip(
            layer.jobs[layer.counts == 0], layer.codes[layer.counts == 0], strict=True
        ):
            status = UNREACHABLE if code == FREE else HIT
            paths[j] = ArmPath(status, w, passed, int(code))
        alive = layer.jobs[layer.counts > 0]
        layers[w] = layer
        if not len(alive):
            break
    for j in alive:
        nodes = [layer.nodes(int(j)) for layer in layers if layer is not None]
        paths[j] = _connect(robot, world, motion, bases[j], int(grasps[j]), nodes)
    return [path for path in paths if path is not None]


def _ends_first(count: int) -> list[int]:
    """All of range(count): the grasp, last, first, then ever finer between them."""
    order, stride = [1, count - 1, 0], count - 1
    order = list(dict.fromkeys(order))
    while stride > 1:
        stride = (stride + 1) // 2
        order += [i for i in range(0, count, stride) if i not in order]
    return order


@dataclass(frozen=True)
class _Layer:
    """The free configurations of all living jobs at one waypoint."""

    jobs: Int[np.ndarray, " a"]
    q: Float[np.ndarray, "a b n"]
    """Free configurations first, NaN beyond the count."""
    counts: Int[np.ndarray, " a"]
    codes: Int[np.ndarray, " a"]
    """What the first configuration hit, FREE where there was none at all."""

    def nodes(self, job: int) -> Float[np.ndarray, "k n"]:
        row = int(np.searchsorted(self.jobs, job))
        return self.q[row, : self.counts[row]]


def _solve_layer(
    robot: Robot,
    world: World,
    motion: TaskMotion,
    bases: np.ndarray,
    grasps: np.ndarray,
    alive: np.ndarray,
    w: int,
) -> _Layer:
    step = motion.coarse[w]
    T_base_world = invert(pose_planar(bases[alive]))
    poses = T_base_world @ motion.Ts_world_tool[grasps[alive], step]
    q, counts = solve_ik(robot.chain, robot.ik, poses)
    n, width = robot.chain.size, q.shape[1]
    given = np.arange(width) < counts[:, None]
    flat = q[given]
    owner = np.repeat(np.arange(len(alive)), counts)
    codes = check(
        world,
        robot.chain,
        robot.spheres,
        flat,
        bases[alive][owner],
        np.full(len(flat), motion.value[step]),
        np.full(len(flat), motion.holding[step]),
    )
    free = codes == FREE
    kept = np.bincount(owner[free], minlength=len(alive))
    out = np.full((len(alive), int(kept.max(initial=1)), n), np.nan)
    slot = np.concatenate([np.arange(k) for k in kept]) if len(kept) else np.zeros(0, int)
    out[owner[free], slot.astype(int)] = flat[free]
    first = np.full(len(alive), FREE, np.int64)
    if len(owner):
        heads, at = np.unique(owner, return_index=True)
        first[heads] = codes[at]
    return _Layer(alive, out, kept, first)


def _connect(
    robot: Robot,
    world: World,
    motion: TaskMotion,
    base: np.ndarray,
    grasp: int,
    nodes: list[Float[np.ndarray, "k n"]],
) -> ArmPath:
    """Shortest path through the layers of one job, then every state between, checked."""
    start = np.cumsum([0, *(len(k) for k in nodes)])
    stacked = np.concatenate(nodes)
    chain = robot.chain
    full_turn = ~chain.prismatic & (chain.upper - chain.lower > 2 * np.pi + 0.1)
    banned = np.zeros(len(stacked), bool)
    targets = invert(pose_planar(base)) @ motion.Ts_world_tool[grasp]
    count = len(nodes)
    worst = ArmPath(BROKEN, 0, count, FREE)
    for _ in range(4):
        chosen = np.full(count, -1)
        reached = _shortest(stacked, start, banned, full_turn, chosen)
        if reached < count:
            return worst if worst.obstacle != FREE else ArmPath(BROKEN, reached, count, FREE)
        q = _unwrap(stacked[chosen], full_turn, chain.lower, chain.upper)
        dense = np.empty((len(motion.object_q), chain.size))
        bad = _track(
            q,
            motion.coarse,
            targets,
            robot.ik.active,
            chain_arrays(chain),
            (chain.lower, chain.upper),
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
            step = int(np.searchsorted(motion.coarse, bad))
            worst = ArmPath(HIT, step, count, int(codes[bad]))
        # Without the node after the failure the next path must take another way.
        banned[chosen[min(int(np.searchsorted(motion.coarse, bad)), count - 1)]] = True
    return worst


@njit(cache=True, nogil=True)
def _step(a, b, full_turn):
    """Largest joint difference, the short way round where a joint turns fully."""
    worst = 0.0
    for k in range(len(a)):
        d = b[k] - a[k]
        if full_turn[k]:
            d -= 2.0 * np.pi * np.round(d / (2.0 * np.pi))
        worst = max(worst, abs(d))
    return worst


@njit(cache=True, nogil=True)
def _shortest(q, start, banned, full_turn, chosen):
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
                d = _step(q[j], q[i], full_turn)
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


@njit(cache=True, nogil=True)
def _track(q, coarse, targets, active, chain, limits, dense):
    """Fill the states between waypoints by Newton steps; returns the step that fails, or -1."""
    n = q.shape[1]
    lower, upper = limits
    R, p = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3))
    for w in range(len(coarse)):
        first = coarse[w - 1] + 1 if w > 0 else 0
        for s in range(first, coarse[w] + 1):
            t = (s - coarse[w - 1]) / (coarse[w] - coarse[w - 1]) if w > 0 else 1.0
            for k in range(n):
                dense[s, k] = (1.0 - t) * q[max(w - 1, 0), k] + t * q[w, k]
            residual = newton(
                dense[s], active, chain, targets[s, :3, :3], targets[s, :3, 3], 8, 1e-6, (R, p)
            )
            if residual > 1e-9:
                return s
            for k in range(n):
                if dense[s, k] < lower[k] - 1e-6 or dense[s, k] > upper[k] + 1e-6:
                    return s
                if s > 0 and abs(dense[s, k] - dense[s - 1, k]) > MAX_DENSE_STEP:
                    return s
    return -1
