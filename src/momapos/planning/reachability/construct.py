"""Build the map of a robot: frame, grid, reachability masks, signed distances."""

from __future__ import annotations

import logging
import math
import time
from dataclasses import replace

import numpy as np

from momapos.core import RobotError, blocks_in_threads
from momapos.model.collision import Spheres
from momapos.model.kinematics import (
    ArmArrays,
    Chain,
    IkArrays,
    IkModel,
    SphereArrays,
    bounded,
    build_ik,
    chain_arrays,
    chain_limits,
    ik_arrays,
)
from momapos.model.robots import Robot
from momapos.model.urdf import Boxes

from .arm_axes import ArmAxes, arm_frame, is_flooded
from .flood import flooded_map
from .grid import STORED_TURNS, grid_points, pack_shape
from .map_kernels import (
    AZIMUTHS,
    EVERY,
    FirstJointArm,
    ShoulderSamples,
    Tool,
    arc_mask,
    line_masks,
    standing_table,
)
from .reach_map import MAX_VALUES, Progress, ReachConfig, ReachMap, silent
from .signed_distance import close_seam, deepen, near_signed_distances, nearby, uneven_edges

Samples = tuple[IkArrays, ShoulderSamples]
MAX_SAMPLES = 100_000
"""Largest number of IK samples; never reached, so that the samples form a full grid [-]."""
HALVINGS = 2
"""How often the spacing of the first joint's values is halved where they disagree [-]."""


def locked_samples(chain: Chain, frame: ArmAxes, count: int, heights: int) -> Samples:
    """Build the IK model of the freed arm, with its samples in the order of trying them.

    If IK locks the first joint of a redundant arm, the locked value determines which azimuths a
    sample can serve. Straight ahead comes first, then the values farthest to the sides; values
    between two that agree add nothing. Then values in between are tried where the result changes,
    at half the spacing each time.

    Args:
        chain: The arm with its first turning joint freed.
        frame: Its first and last axis.
        count: Number of values of a redundant turning joint that are always tried [-].
        heights: Number of values of a torso [-].

    Returns:
        The IK model for the kernels, and the value at which each sample locks the first joint.
    """
    first = frame.first
    # So many values of a turning joint give `heights` values of a torso.
    ik = build_ik(chain, samples_per_joint=2 * heights - 1, max_samples=MAX_SAMPLES)
    if first in ik.active:
        # A map needs only one solution: seeds are not tried.
        ik = replace(build_ik(chain, samples_per_joint=count), tries=0)
        zero = np.zeros(len(ik.samples), np.int64)
        return ik_arrays(ik), ShoulderSamples(zero.astype(np.uint64), zero, zero)
    values = count << HALVINGS
    # Straight ahead is 0. The spacing at which a value first appears decides when it is tried.
    offset = np.arange(values) - values // 2
    step = np.where(offset % (1 << HALVINGS) == 0, 0, offset & -offset)
    pan = offset * (2 * np.pi / values)
    order = np.lexsort((pan, np.where(offset == 0, -np.inf, -np.abs(pan)), -step, step > 0))
    ik, repeat = _turned(replace(ik, tries=0), frame, pan[order])
    order = np.repeat(order, repeat)
    return ik_arrays(ik), ShoulderSamples(
        _arcs(pan[order], frame, np.pi / values), order, step[order]
    )


def _turned(ik: IkModel, frame: ArmAxes, pan: np.ndarray) -> tuple[IkModel, int]:
    """Turn the samples at one value of the first joint to other values; return also their number.

    Turning the model is a hundred times faster than deriving it at every value.
    """
    held = ik.samples[:, frame.first]
    one = np.flatnonzero(held == held.min())
    angle = frame.turn * (pan - held.min())
    c, s, zero = np.cos(angle), np.sin(angle), np.zeros(len(pan))
    R = np.array([[c, -s, zero], [s, c, zero], [zero, zero, zero + 1]]).transpose(2, 0, 1)
    samples = np.tile(ik.samples[one], (len(pan), 1, 1))
    samples[..., frame.first] = pan[:, None]

    def point(p: np.ndarray) -> np.ndarray:
        return np.einsum("vij,s...j->vs...i", R, p - frame.axis) + frame.axis

    turned = {
        "samples": samples,
        "h": np.einsum("vij,saj->vsai", R, ik.h[one]),
        "o": point(ik.o[one]),
        "wrist": point(ik.wrist[one]),
        "R_tool": np.einsum("vij,sjk->vsik", R, ik.R_tool[one]),
        "p_tool": point(ik.p_tool[one]),
    }
    flat = {name: a.reshape(-1, *a.shape[2:]) for name, a in turned.items()}
    return replace(ik, **flat), len(one)


def _arcs(pan: np.ndarray, frame: ArmAxes, slack: float) -> np.ndarray:
    """Return the azimuths that values of the first joint can serve, with half a step of slack.

    On average, the last value that works is half a step before the last one that would work.
    """
    lower, upper = frame.limits[0] - slack, frame.limits[1] + slack
    return np.array([arc_mask(q, float(frame.turn), lower, upper) for q in pan], np.uint64)


log = logging.getLogger(__name__)
BLOCK = 256
"""Lines per block of work of a thread [-]."""
MIN_DIFFERING_AZIMUTHS = 6
"""An edge is refined if its ends differ in at least this many of the 64 azimuths [-]."""
AZIMUTH_SPREAD = 3
"""Azimuths (of 64) to both sides of reachable ones that are retried with all samples [-]."""
MAX_AZIMUTH_DEPENDENT = 0.005
"""Largest share of lines that depend on the azimuth if the map omits the azimuth [-]."""
MANY_JOINTS = 8
"""Arms with more degrees of freedom get coarser flooded maps [-]."""


def default_config(robot: Robot) -> ReachConfig:
    """Return the resolution that balances accuracy and build time for a robot.

    A redundant arm takes thirty times longer per line and depends less on the direction. Its
    reachable set is rounded outwards too: one of two spins suffices, and the first joint has half a
    step of tolerance. The threshold of a flooded map prefers false positives: a missed line can
    cost a solution, a false one only costs time. If the last joint turns fully, half of all tool
    turns must be free, which rounds the set inwards. An arm with many redundant joints reaches more
    lines, with a smoother boundary. An arm of several meters gets larger cells, to stay within
    `MAX_VALUES`.
    """
    frame = arm_frame(robot.chain, robot.approach_axis)
    if is_flooded(robot, frame):
        many = robot.chain.size > MANY_JOINTS
        config = ReachConfig(
            cell=0.06 if many else 0.05,
            directions=13,
            azimuths=16 if many else 32,
            threshold=-1.5 if frame.full_roll else -1.0,
        )
    elif robot.chain.size > 6:
        config = ReachConfig(cell=0.05, directions=13, spins=2, threshold=0.0)
    else:
        config = ReachConfig()
    return _within_memory(robot, frame, config)


def build_map(
    robot: Robot,
    config: ReachConfig | None = None,
    *,
    progress: Progress | None = None,
    key: str = "",
) -> ReachMap:
    """Build the map of a robot.

    Args:
        robot: The robot; only collisions with itself and the floor count.
        config: Resolution; None for the default.
        progress: Called with the completed share, in [0, 1].
        key: Content key to store in the map.

    Raises:
        RobotError: The configuration is invalid, or the map would be too large.
    """
    config = config or default_config(robot)
    began = time.perf_counter()
    if config.azimuths < 1 or AZIMUTHS % config.azimuths or config.directions % 2 == 0:
        raise RobotError(
            f"reach: azimuths must divide {AZIMUTHS}, not {config.azimuths}, and directions must "
            f"be odd, not {config.directions}"
        )
    chain = robot.chain
    frame = arm_frame(chain, robot.approach_axis)
    low, shape = _grid(_extent(chain, frame), config)
    floods = is_flooded(robot, frame)
    count = _value_count(shape, floods)
    if count > MAX_VALUES:
        raise RobotError(
            f"reach: cells of {config.cell:g} m give a map of {count:,} values, more than "
            f"{MAX_VALUES:,}; choose larger cells or fewer directions"
        )
    if floods:
        return flooded_map(robot, frame, (low, shape), config, progress or silent, key)
    evaluate = _Evaluator(robot, frame, config, progress or silent)
    zs, rs, us, vs = grid_points(shape, low, config.cell)
    points = np.stack(np.meshgrid(zs, rs, us, vs, indexing="ij"), -1).reshape(-1, 4)
    every = np.full(len(points), EVERY)
    if evaluate.coarse is None:
        masks = evaluate(points, every, 0.0, 0.5)
    else:
        masks = evaluate(points, every, 0.0, 0.25, evaluate.coarse)
        _retry_with_all_samples(masks, points, shape, evaluate)
    if shape[4] > 1 and _azimuth_free(masks):
        shape = (*shape[:4], 1)
    if shape[4] == 1:
        masks = np.where(np.bitwise_count(masks) * 2 > AZIMUTHS, EVERY, np.uint64(0))
    rows, interior = _refine_edges(masks, points, shape, config, evaluate)
    values, packed = np.empty((len(points), shape[4]), np.int8), pack_shape(shape)

    def distances(lo: int, hi: int) -> None:
        near_signed_distances(lo, hi, masks, packed, rows, interior, values)

    blocks_in_threads(distances, len(points), 32 * BLOCK)
    grid = values.reshape(shape)
    close_seam(grid)
    deepen(grid.reshape(-1), packed)
    evaluate.progress(1.0)
    seconds = time.perf_counter() - began
    log.debug("%s: %d lines, %d edges in %.1f s", robot.name, len(points), len(interior), seconds)
    line = np.stack([frame.tool[0], frame.tool[3]])
    axis = frame.axis[:2]
    return ReachMap(grid, low, config.cell, axis, line, config.threshold, key, seconds)


Extent = tuple[float, float, float]
"""Lowest and highest reachable point, and the largest distance from the first axis [m]."""


def _extent(chain: Chain, frame: ArmAxes) -> Extent:
    """Estimate the extent of the reachable points of the last axis from random arm states."""
    rng = np.random.default_rng(0)
    T = chain.tool_poses(rng.uniform(*bounded(chain), (100_000, chain.size)))
    points = T[:, :3, :3] @ frame.tool[3] + T[:, :3, 3] - frame.axis
    r = float(np.hypot(points[:, 0], points[:, 1]).max())
    return float(points[:, 2].min()), float(points[:, 2].max()), r


def _grid(extent: Extent, config: ReachConfig) -> tuple[float, tuple[int, int, int, int, int]]:
    """Return the lowest height [m] and the shape of a grid that contains every line."""
    bottom, top, r = extent
    # Random states do not quite reach the stretched arm.
    slack = 0.03 * r + config.cell
    low = max(bottom - slack, -config.cell)
    nz, nr = int(np.ceil((top + slack - low) / config.cell)) + 1, int((r + slack) / config.cell) + 2
    return low, (nz, nr, config.directions, config.directions, config.azimuths)


def _value_count(shape: tuple[int, ...], floods: bool) -> int:
    """Count the values of a map; those of a flooded map include all tool turns."""
    return math.prod(shape) * (STORED_TURNS if floods else 1)


def _within_memory(robot: Robot, frame: ArmAxes, config: ReachConfig) -> ReachConfig:
    """Enlarge the cells until the map has at most `MAX_VALUES` values."""
    chain, first, floods = robot.chain, frame.first, is_flooded(robot, frame)
    below = chain.middle[:first] @ chain.h[:first], chain.half_travel[:first].sum()
    far = robot.reach + float(np.linalg.norm(frame.tool[3]) + np.linalg.norm(below[0]) + below[1])
    height = float(chain.d[: first + 1, 2].sum())
    # The sum of all lengths bounds the extent from above; the extent itself takes long to sample.
    if _value_count(_grid((height - far, height + far, far), config)[1], floods) <= MAX_VALUES:
        return config
    extent = _extent(chain, frame)
    while (count := _value_count(_grid(extent, config)[1], floods)) > MAX_VALUES:
        config = replace(config, cell=config.cell * max(1.01, math.sqrt(count / MAX_VALUES)))
    return config


class _Evaluator:
    """Computes the reachable azimuths of lines, on two threads."""

    def __init__(
        self, robot: Robot, frame: ArmAxes, config: ReachConfig, progress: Progress
    ) -> None:
        chain, first = robot.chain, frame.first
        free = replace(
            chain,
            lower=np.where(np.arange(chain.size) == first, -np.inf, chain.lower),
            upper=np.where(np.arange(chain.size) == first, np.inf, chain.upper),
        )
        self.fine = locked_samples(free, frame, config.samples, config.heights)
        self.coarse: Samples | None = None
        if self.fine[1][0].any():
            # Few values of the locked first joint show where many are worth trying.
            heights = (config.heights + 1) // 2
            self.coarse = locked_samples(free, frame, config.samples // 2, heights)
        self.progress = progress
        # Every second spin gets half a turn more. That spreads them evenly for any tool, and also
        # for one that looks the same after half a turn, as grippers do.
        k = np.arange(config.spins)
        spins = np.pi * (k / len(k) + k % 2)
        lower, upper = map(float, frame.limits)
        table = standing_table(robot.spheres, chain.d, first)
        turning = _turning(robot.spheres, first)
        self.arm = FirstJointArm(first, float(frame.turn), lower, upper, frame.axis, turning, table)
        self.chain, self.limits = chain_arrays(free), chain_limits(free)
        self.tool = Tool(np.ascontiguousarray(frame.tool), spins)

    def __call__(
        self,
        lines: np.ndarray,
        wanted: np.ndarray,
        begin: float,
        end: float,
        samples: Samples | None = None,
    ) -> np.ndarray:
        """Return masks of the wanted azimuths (m,) at which lines (m, 4) can be reached."""
        ik, shoulder_samples = samples or self.fine
        fixed = self.tool, self.arm, ArmArrays(self.chain, self.limits, ik), shoulder_samples
        masks = np.empty(len(lines), np.uint64)

        def block(lo: int, hi: int) -> None:
            line_masks(lines[lo:hi], wanted[lo:hi], *fixed, masks[lo:hi])

        blocks_in_threads(
            block, len(lines), BLOCK, lambda share: self.progress(begin + share * (end - begin))
        )
        return masks


def _turning(spheres: Spheres, first: int) -> SphereArrays:
    """Keep only pairs of spheres that both turn with the first joint, and drop the base."""
    stays = spheres.segment <= first
    kept = ~stays[spheres.pairs].any(1)
    nothing = Boxes(np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3)))
    no_pairs = np.zeros((len(stays), 0), bool)
    return replace(
        spheres,
        pairs=spheres.pairs[kept],
        exact=spheres.exact[kept],
        base=nothing,
        base_pairs=no_pairs,
        base_exact=no_pairs,
    ).arrays


def _azimuth_free(masks: np.ndarray) -> bool:
    """Check whether the azimuth makes no difference: neither first joint nor base limits it."""
    count = np.bitwise_count(masks)
    some = (count > 0) & (count < AZIMUTHS)
    return bool(some.sum() <= MAX_AZIMUTH_DEPENDENT * max(1, (count > 0).sum()))


def _retry_with_all_samples(
    masks: np.ndarray, points: np.ndarray, shape: tuple[int, ...], evaluate: _Evaluator
) -> None:
    """Retry azimuths near those that a point or a neighbor has with all samples, in place.

    Few samples miss thin parts of the reachable set, but nearly always find a neighboring point.
    """
    wanted = nearby(masks.reshape(shape[:4]), AZIMUTH_SPREAD).reshape(-1) & ~masks
    odd = np.flatnonzero(wanted)
    masks[odd] |= evaluate(points[odd], wanted[odd], 0.25, 0.5)


def _refine_edges(
    masks: np.ndarray,
    points: np.ndarray,
    shape: tuple[int, ...],
    config: ReachConfig,
    evaluate: _Evaluator,
) -> tuple[np.ndarray, np.ndarray]:
    """Evaluate points on the edges whose ends disagree.

    The middle comes first, then the quarter on the side where the mask changes. Only the azimuths
    that change are evaluated.

    Returns:
        For each axis and point the row of its edge, -1 for none; and the masks on each edge.
    """
    least = 1 if shape[4] == 1 else MIN_DIFFERING_AZIMUTHS
    edges = uneven_edges(masks.reshape(shape[:4]), least)
    step = np.diag([config.cell, config.cell, 2 / (shape[2] - 1), 2 / (shape[3] - 1)])
    strides = np.array([np.prod(shape[a + 1 : 4], dtype=int) for a in range(4)])
    rows = np.full((4, len(points)), -1)
    start = np.concatenate(edges)
    axis = np.repeat(np.arange(4), [len(e) for e in edges])
    rows[axis, start] = np.arange(len(start))
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
