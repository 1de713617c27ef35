"""Put a map together for a robot: frame, grid, answers, margins."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from momapos.errors import RobotError
from momapos.geometry.transforms import orthonormal
from momapos.kinematics.chain import Chain
from momapos.kinematics.ik import NUMERIC, IkModel, build_ik, chain_arrays, ik_arrays
from momapos.kinematics.spheres import Spheres
from momapos.reachability.build import EVERY, arc_mask, line_masks
from momapos.reachability.grid import grid_points, pack_shape
from momapos.reachability.map import ReachConfig, ReachMap
from momapos.reachability.margin import close_seam, deepen, near_margins, uneven_edges
from momapos.reachability.standing import BEARINGS, standing_table
from momapos.robots.robot import Robot

log = logging.getLogger(__name__)
Progress = Callable[[float], None]
BLOCK = 1024
"""Lines a thread takes at once."""
UNEVEN = 6
"""Bearings of 64 in which the ends of an edge must differ for the edge to be looked at."""
FEW = 0.005
"""Share of lines that may depend on the bearing while it counts as making no difference [-]."""
ROLLS = 8
"""Rolls of the tool that must all be reachable where the last joint does not turn fully."""
FULL_TURN = 0.95 * 2 * np.pi
"""A last joint with this range counts as turning fully [rad]."""


@dataclass(frozen=True)
class Frame:
    """Where the first and the last axis of an arm are."""

    first: int
    """Index of the first revolute joint; only vertical prismatic joints come before it."""
    turn: float
    """1 where the first joint turns anticlockwise seen from above, else -1."""
    limits: tuple[float, float]
    """Of the first joint [rad]."""
    axis: Float[np.ndarray, "3"]
    """Foot of the first axis in the base frame [m]."""
    tool: Float[np.ndarray, "4 3"]
    """Direction of the last axis, two vectors across it and a point on it, in the tool frame."""
    full_roll: bool
    """Whether the last joint turns fully."""


def arm_frame(chain: Chain, approach_axis: Float[np.ndarray, "3"]) -> Frame:
    """Find the first and the last axis of an arm.

    Raises:
        RobotError: The arm's first turning axis is not vertical.
    """
    origin = np.cumsum(chain.d, axis=0)
    first = int(np.argmin(chain.prismatic))
    if np.abs(chain.h[: first + 1, 2]).min() < 1 - 1e-4:
        raise RobotError(
            f"the first axis of the arm, {chain.names[first]!r}, is not vertical; a reachability "
            "map needs an upright arm"
        )
    last = chain.size - 1
    p_tool = origin[last] + chain.tool_offset
    axis, point, full = chain.h[last], origin[last], False
    if chain.prismatic[last]:
        axis, point = chain.tool_rotation @ approach_axis, p_tool
    else:
        full = bool(chain.upper[last] - chain.lower[last] >= FULL_TURN)
        point = _nearest(origin[last], axis, origin[last - 1], chain.h[last - 1])
    across = orthonormal(axis)
    rows = np.stack([axis, across, np.cross(axis, across), point - p_tool])
    foot = np.array([origin[first, 0], origin[first, 1], 0.0])
    turn = float(np.sign(chain.h[first, 2]))
    limits = float(chain.lower[first]), float(chain.upper[first])
    return Frame(first, turn, limits, foot, rows @ chain.tool_rotation, full)


def _nearest(o: np.ndarray, h: np.ndarray, other: np.ndarray, k: np.ndarray) -> np.ndarray:
    """Point of the line (o, h) that is nearest to the line (other, k)."""
    w, c = o - other, float(h @ k)
    if 1 - c * c < 1e-4:
        return o
    return o + h * (c * float(k @ w) - float(h @ w)) / (1 - c * c)


def default_config(robot: Robot) -> ReachConfig:
    """Resolution at which a map is true enough and quickly built.

    Longer arms cost ten times more per line, and direction matters less to them.
    """
    longer = robot.chain.size > 6
    return ReachConfig(directions=13, spins=1) if longer else ReachConfig()


def build_map(
    robot: Robot,
    config: ReachConfig | None = None,
    *,
    progress: Progress | None = None,
    key: str = "",
) -> ReachMap:
    """Build the map of a robot.

    Args:
        robot: The robot; self-collision and the floor count, other things do not.
        config: How finely.
        progress: Called with the share that is done, in [0, 1].
        key: Content key to be kept in the map.
    """
    config = config or default_config(robot)
    began = time.perf_counter()
    if config.bearings < 1 or BEARINGS % config.bearings or config.directions % 2 == 0:
        raise RobotError("reach: bearings must divide 64 and directions must be odd")
    chain = robot.chain
    frame = arm_frame(chain, robot.approach_axis)
    low, shape = _extent(chain, frame, config)
    evaluate = _Evaluator(robot, frame, config, progress or _silent)
    zs, rs, us, vs = grid_points(shape, low, config.cell)
    points = np.stack(np.meshgrid(zs, rs, us, vs, indexing="ij"), -1).reshape(-1, 4)
    masks = evaluate(points, np.full(len(points), EVERY), 0.0, 0.5)
    if shape[4] > 1 and _bearing_free(masks):
        shape = (*shape[:4], 1)
    if shape[4] == 1:
        masks = np.where(np.bitwise_count(masks) * 2 > BEARINGS, EVERY, np.uint64(0))
    t1 = time.perf_counter()
    rows, interior = _look_between(masks, points, shape, config, evaluate)
    t2 = time.perf_counter()
    values = np.empty((len(points), shape[4]), np.int8)
    _threaded(
        lambda lo, hi: near_margins(lo, hi, masks, pack_shape(shape), rows, interior, values),
        len(points),
        8 * BLOCK,
        _silent,
    )
    values = values.reshape(shape)
    close_seam(values)
    deepen(values.reshape(-1), pack_shape(shape))
    evaluate.progress(1.0)
    seconds = time.perf_counter() - began
    log.debug(
        "%s: %d lines in %.1f s, %d answers between in %.1f s, all in %.1f s",
        robot.name,
        len(points),
        t1 - began,
        interior.size,
        t2 - t1,
        seconds,
    )
    line = np.stack([frame.tool[0], frame.tool[3]])
    return ReachMap(values, low, config.cell, frame.axis[:2], line, key, seconds)


def _extent(
    chain: Chain, frame: Frame, config: ReachConfig
) -> tuple[float, tuple[int, int, int, int, int]]:
    """Lowest height and shape of a grid that holds every line, by random arm states."""
    rng = np.random.default_rng(0)
    lower = np.where(np.isfinite(chain.lower), chain.lower, -np.pi)
    upper = np.where(np.isfinite(chain.upper), chain.upper, np.pi)
    T = chain.tool_poses(rng.uniform(lower, upper, (100_000, chain.size)))
    points = T[:, :3, :3] @ frame.tool[3] + T[:, :3, 3] - frame.axis
    r = float(np.hypot(points[:, 0], points[:, 1]).max())
    bottom, top = float(points[:, 2].min()), float(points[:, 2].max())
    # Random states stop a little short of a stretched arm.
    slack = 0.03 * r + config.cell
    low = max(bottom - slack, -config.cell)
    nz, nr = int(np.ceil((top + slack - low) / config.cell)) + 1, int((r + slack) / config.cell) + 2
    return low, (nz, nr, config.directions, config.directions, config.bearings)


class _Evaluator:
    """Answers for lines, on two threads."""

    def __init__(self, robot: Robot, frame: Frame, config: ReachConfig, progress: Progress) -> None:
        chain, first = robot.chain, frame.first
        free = replace(
            chain,
            lower=np.where(np.arange(chain.size) == first, -np.inf, chain.lower),
            upper=np.where(np.arange(chain.size) == first, np.inf, chain.upper),
        )
        ik, pans = _samples(free, frame, config)
        self.progress = progress
        # A tool whose last joint turns fully reaches all rolls or none, but for what it touches.
        self.rolls = np.zeros(1) if frame.full_roll else 2 * np.pi / ROLLS * np.arange(ROLLS)
        # Every second one is turned by half a turn more: spread evenly for any tool, and for one
        # that looks the same after half a turn, as grippers do.
        k = np.arange(config.spins if frame.full_roll else 1)
        self.spins = np.pi * (k / len(k) + k % 2)
        arm = (
            first,
            frame.turn,
            *frame.limits,
            frame.axis,
            _turning(robot.spheres, first),
            standing_table(robot.spheres, chain.d, first),
        )
        self.arguments = (
            np.ascontiguousarray(frame.tool),
            arm,
            chain_arrays(free),
            (free.lower, free.upper),
            ik_arrays(ik),
            pans,
        )

    def __call__(
        self, lines: np.ndarray, wanted: np.ndarray, begin: float, end: float
    ) -> np.ndarray:
        """Which of the wanted bearings (m,) lines (m, 4) serve; progress goes from begin to end."""
        masks = np.empty(len(lines), np.uint64)

        def block(lo: int, hi: int) -> None:
            line_masks(
                lines[lo:hi], wanted[lo:hi], self.rolls, self.spins, *self.arguments, masks[lo:hi]
            )

        _threaded(
            block, len(lines), BLOCK, lambda share: self.progress(begin + share * (end - begin))
        )
        return masks


def _samples(
    chain: Chain, frame: Frame, config: ReachConfig
) -> tuple[IkModel, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """How the freed arm is inverted, and its samples in the order in which they are tried.

    Where a longer arm is inverted with its first joint locked, the values of that joint tell which
    bearings a sample can serve. Straight ahead comes first, then the values farthest to the sides:
    what lies between them adds nothing. Then the values between are tried where it changes.

    Returns:
        The model, and for each sample what `line_masks` calls pans.
    """
    first = frame.first
    ik = build_ik(chain, samples_per_joint=config.samples)
    if ik.kind == NUMERIC or first in ik.active:
        zero = np.zeros(len(ik.samples), np.int64)
        return ik, (zero.astype(np.uint64), zero, zero)
    values = 2 * config.samples
    ik = build_ik(chain, samples_per_joint=values)
    keep = np.ones(len(ik.samples), bool)
    for joint in set(range(chain.size)) - {first, *ik.active.tolist()}:
        held = np.unique(ik.samples[:, joint])
        count = min(len(held), config.heights)
        chosen = held[np.round(np.linspace(0, len(held) - 1, count)).astype(int)]
        keep &= np.isin(ik.samples[:, joint], chosen)
    pan = ik.samples[:, first]
    value = np.round((pan + np.pi) / (2 * np.pi) * values).astype(np.int64) % values
    step = np.where(value % 2 == values // 2 % 2, 0, 1)
    ahead = np.where(np.abs(pan) < 1e-9, -np.inf, -np.abs(pan))
    rest = np.delete(ik.samples, first, axis=1)
    order = np.lexsort((*rest.T, pan, ahead, -step, step > 0))
    order = order[keep[order]]
    names = ("samples", "h", "o", "wrist", "R_tool", "p_tool")
    return replace(ik, **{name: getattr(ik, name)[order] for name in names}), (
        _arcs(pan[order], frame, np.pi / values),
        value[order],
        step[order],
    )


def _arcs(pan: np.ndarray, frame: Frame, slack: float) -> np.ndarray:
    """Bearings that values of the first joint can serve; half a step more at both ends, since
    the last value that works lies half a step, on average, before the last that would."""
    lower, upper = frame.limits[0] - slack, frame.limits[1] + slack
    return np.array([arc_mask(q, frame.turn, lower, upper) for q in pan], np.uint64)


def _turning(spheres: Spheres, first: int) -> tuple:  # type: ignore[type-arg]
    """The spheres with only those pairs that both turn with the first joint, and no base."""
    stays = spheres.segment <= first
    pairs = spheres.pairs[~stays[spheres.pairs].any(1)]
    none = (np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3)))
    return (*spheres.arrays()[:7], pairs, *none, np.zeros((len(stays), 0), bool))


def _silent(_share: float) -> None:
    """Nobody wants to know."""


def _threaded(work: Callable[[int, int], None], count: int, block: int, done: Progress) -> None:
    """Run work(lo, hi) over blocks on two threads; the kernels hold no lock."""
    ranges = [(lo, min(lo + block, count)) for lo in range(0, count, block)]
    with ThreadPoolExecutor(min(2, os.cpu_count() or 1)) as pool:
        for i, _ in enumerate(pool.map(lambda r: work(*r), ranges)):
            done((i + 1) / len(ranges))


def _bearing_free(masks: np.ndarray) -> bool:
    """Whether the bearing makes no difference: neither first joint nor base are in the way."""
    count = np.bitwise_count(masks)
    return bool(((count > 0) & (count < BEARINGS)).sum() <= FEW * max(1, (count > 0).sum()))


def _look_between(
    masks: np.ndarray,
    points: np.ndarray,
    shape: tuple[int, ...],
    config: ReachConfig,
    evaluate: _Evaluator,
) -> tuple[np.ndarray, np.ndarray]:
    """Answers on the edges whose ends disagree, and for each edge its row among them.

    The middle first, then the quarters on the side where the answer changes; only for the bearings
    in which it does.
    """
    least = 1 if shape[4] == 1 else UNEVEN
    edges = uneven_edges(masks.reshape(shape[:4]), least)
    step = np.diag([config.cell, config.cell, 2 / (shape[2] - 1), 2 / (shape[3] - 1)])
    strides = np.array([np.prod(shape[a + 1 : 4], dtype=int) for a in range(4)])
    rows = np.full((4, len(points)), -1, np.int32)
    start = np.concatenate(edges)
    axis = np.repeat(np.arange(4), [len(e) for e in edges])
    rows[axis, start] = np.arange(len(start), dtype=np.int32)
    origin, along = points[start], step[axis]
    near, far = masks[start], masks[start + strides[axis]]
    middle = evaluate(origin + 0.5 * along, near ^ far, 0.5, 0.7) | near & far
    interior = np.stack([near, middle, middle], axis=1)
    for column, end, share, begin in ((0, near, 0.25, 0.7), (2, far, 0.75, 0.83)):
        odd = np.flatnonzero(np.bitwise_count(end ^ middle) >= least)
        differ, same = (end ^ middle)[odd], (end & middle)[odd]
        between = origin[odd] + share * along[odd]
        interior[odd, column] = evaluate(between, differ, begin, begin + 0.13) | same
    return rows, interior
