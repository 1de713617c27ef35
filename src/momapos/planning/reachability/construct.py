"""Put a map together for a robot: frame, grid, answers, signed distances."""

from __future__ import annotations

import logging
import math
import time
from dataclasses import replace

import numpy as np

from momapos.core import RobotError
from momapos.model.collision import Spheres
from momapos.model.kinematics import (
    ArmArrays,
    Chain,
    SphereArrays,
    bounded,
    chain_arrays,
    chain_limits,
)
from momapos.model.robots import Robot
from momapos.model.urdf import Boxes

from .arm_axes import ArmAxes, arm_frame, is_flooded
from .base_contact import BEARINGS, standing_table
from .general_map import flooded_map
from .grid import TOLD_APART, grid_points, pack_shape
from .locked_values import Samples, locked_samples
from .map_kernels import EVERY, Arm, Tool, line_masks
from .reach_map import MAX_VALUES, ReachConfig, ReachMap
from .signed_distance import close_seam, deepen, near_signed_distances, nearby, uneven_edges
from .threads import Progress, in_threads, silent

log = logging.getLogger(__name__)
BLOCK = 1024
"""Lines a thread takes at once."""
UNEVEN = 6
"""Azimuths of 64 in which the ends of an edge must differ for the edge to be looked at."""
SPREAD = 3
"""Azimuths of 64 to both sides at which a finer look is taken."""
FEW = 0.005
"""Share of lines that may depend on the azimuth while it counts as making no difference [-]."""
ROLLS = 8
"""Rolls of the tool that must all be reachable where the last joint does not turn fully."""

MANY = 8
"""An arm of more degrees of freedom has several to spare [-]."""


def default_config(robot: Robot) -> ReachConfig:
    """Resolution at which a map is true enough and quickly built.

    Longer arms cost thirty times more per line, and direction matters less to them. Their set is
    rounded outwards as well, where either of two spins and half a step of the first joint count.
    A map that is flooded errs on the side of what is reached: a line that is missed costs an
    answer, one that is invented costs time. Where the last joint turns fully, half of all turns of
    the tool must be free, which rounds its set inwards. The more joints an arm has to spare, the
    more lines it reaches, and the smoother is their boundary.
    An arm of several meters has larger cells, so that the map keeps within `MAX_VALUES`.
    """
    frame = arm_frame(robot.chain, robot.approach_axis)
    if is_flooded(robot, frame):
        many = robot.chain.size > MANY
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
        robot: The robot; self-collision and the floor count, other things do not.
        config: How finely.
        progress: Called with the share that is done, in [0, 1].
        key: Content key to be kept in the map.
    """
    config = config or default_config(robot)
    began = time.perf_counter()
    if config.azimuths < 1 or BEARINGS % config.azimuths or config.directions % 2 == 0:
        raise RobotError("reach: azimuths must divide 64 and directions must be odd")
    chain = robot.chain
    frame = arm_frame(chain, robot.approach_axis)
    low, shape = _grid(_extent(chain, frame), config)
    floods = is_flooded(robot, frame)
    count = _value_count(shape, floods)
    if count > MAX_VALUES:
        raise RobotError(
            f"reach: cells of {config.cell:g} m make a map of {count:,} values, more than "
            f"{MAX_VALUES:,}; choose larger cells or fewer directions"
        )
    if floods:
        return flooded_map(robot, frame, (low, shape), config, progress or silent, key)
    evaluate = _Evaluator(robot, frame, config, progress or silent)
    zs, rs, us, vs = grid_points(shape, low, config.cell)
    points = np.stack(np.meshgrid(zs, rs, us, vs, indexing="ij"), -1).reshape(-1, 4)
    every = np.full(len(points), EVERY)
    if evaluate.waypoint_steps is None:
        masks = evaluate(points, every, 0.0, 0.5)
    else:
        masks = evaluate(points, every, 0.0, 0.25, evaluate.waypoint_steps)
        _look_closer(masks, points, shape, evaluate)
    if shape[4] > 1 and _bearing_free(masks):
        shape = (*shape[:4], 1)
    if shape[4] == 1:
        masks = np.where(np.bitwise_count(masks) * 2 > BEARINGS, EVERY, np.uint64(0))
    t1 = time.perf_counter()
    rows, interior = _look_between(masks, points, shape, config, evaluate)
    t2 = time.perf_counter()
    values = np.empty((len(points), shape[4]), np.int8)
    in_threads(
        lambda lo, hi: near_signed_distances(
            lo, hi, masks, pack_shape(shape), rows, interior, values
        ),
        len(points),
        8 * BLOCK,
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
    axis = frame.axis[:2]
    return ReachMap(values, low, config.cell, axis, line, config.threshold, key, seconds)


Extent = tuple[float, float, float]
"""Lowest and highest point of what an arm can reach, and its distance from the axis [m]."""


def _extent(chain: Chain, frame: ArmAxes) -> Extent:
    """Where the points are that an arm can bring its last axis to, by random arm states."""
    rng = np.random.default_rng(0)
    T = chain.tool_poses(rng.uniform(*bounded(chain), (100_000, chain.size)))
    points = T[:, :3, :3] @ frame.tool[3] + T[:, :3, 3] - frame.axis
    r = float(np.hypot(points[:, 0], points[:, 1]).max())
    return float(points[:, 2].min()), float(points[:, 2].max()), r


def _grid(extent: Extent, config: ReachConfig) -> tuple[float, tuple[int, int, int, int, int]]:
    """Lowest height and shape of a grid that holds every line."""
    bottom, top, r = extent
    # Random states stop a little short of a stretched arm.
    slack = 0.03 * r + config.cell
    low = max(bottom - slack, -config.cell)
    nz, nr = int(np.ceil((top + slack - low) / config.cell)) + 1, int((r + slack) / config.cell) + 2
    return low, (nz, nr, config.directions, config.directions, config.azimuths)


def _value_count(shape: tuple[int, ...], floods: bool) -> int:
    """Values of a map; of one that is flooded, those of all turns of the tool."""
    return math.prod(shape) * (TOLD_APART if floods else 1)


def _within_memory(robot: Robot, frame: ArmAxes, config: ReachConfig) -> ReachConfig:
    """The same resolution with cells so large that the map has no more than `MAX_VALUES`."""
    chain, first, floods = robot.chain, frame.first, is_flooded(robot, frame)
    below = chain.middle[:first] @ chain.h[:first], chain.half_travel[:first].sum()
    far = robot.reach + float(np.linalg.norm(frame.tool[3]) + np.linalg.norm(below[0]) + below[1])
    height = float(chain.d[: first + 1, 2].sum())
    # The sum of all lengths is no less than the extent, which takes many states to tell.
    if _value_count(_grid((height - far, height + far, far), config)[1], floods) <= MAX_VALUES:
        return config
    extent = _extent(chain, frame)
    while (count := _value_count(_grid(extent, config)[1], floods)) > MAX_VALUES:
        config = replace(config, cell=config.cell * max(1.01, math.sqrt(count / MAX_VALUES)))
    return config


class _Evaluator:
    """Answers for lines, on two threads."""

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
        self.waypoint_steps: Samples | None = None
        if self.fine[1][0].any():
            # A first joint locked at few values shows where it is worth trying many.
            heights = (config.heights + 1) // 2
            self.waypoint_steps = locked_samples(free, frame, config.samples // 2, heights)
        self.progress = progress
        # A tool whose last joint turns fully reaches all rolls or none, but for what it touches.
        rolls = np.zeros(1) if frame.full_roll else 2 * np.pi / ROLLS * np.arange(ROLLS)
        # Every second one is turned by half a turn more: spread evenly for any tool, and for one
        # that looks the same after half a turn, as grippers do.
        k = np.arange(config.spins if frame.full_roll else 1)
        spins = np.pi * (k / len(k) + k % 2)
        arm = Arm(
            first,
            float(frame.turn),
            float(frame.limits[0]),
            float(frame.limits[1]),
            frame.axis,
            _turning(robot.spheres, first),
            standing_table(robot.spheres, chain.d, first),
        )
        self.arm, self.chain, self.limits = arm, chain_arrays(free), chain_limits(free)
        self.tool = Tool(np.ascontiguousarray(frame.tool), rolls, spins)

    def __call__(
        self,
        lines: np.ndarray,
        wanted: np.ndarray,
        begin: float,
        end: float,
        samples: Samples | None = None,
    ) -> np.ndarray:
        """Which of the wanted azimuths (m,) lines (m, 4) serve; progress goes from begin to end."""
        ik, shoulder_samples = samples or self.fine
        fixed = self.tool, self.arm, ArmArrays(self.chain, self.limits, ik), shoulder_samples
        masks = np.empty(len(lines), np.uint64)

        def block(lo: int, hi: int) -> None:
            line_masks(lines[lo:hi], wanted[lo:hi], *fixed, masks[lo:hi])

        in_threads(
            block, len(lines), BLOCK, lambda share: self.progress(begin + share * (end - begin))
        )
        return masks


def _turning(spheres: Spheres, first: int) -> SphereArrays:
    """The spheres with only those pairs that both turn with the first joint, and no base."""
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


def _bearing_free(masks: np.ndarray) -> bool:
    """Whether the azimuth makes no difference: neither first joint nor base are in the way."""
    count = np.bitwise_count(masks)
    return bool(((count > 0) & (count < BEARINGS)).sum() <= FEW * max(1, (count > 0).sum()))


def _look_closer(
    masks: np.ndarray, points: np.ndarray, shape: tuple[int, ...], evaluate: _Evaluator
) -> None:
    """Try many samples for the azimuths next to those that a point or a neighbor has, in place.

    Thin parts of the reachable set fall between few samples, but nearly always next to a point
    that has some of them.
    """
    wanted = nearby(masks.reshape(shape[:4]), SPREAD).reshape(-1) & ~masks
    odd = np.flatnonzero(wanted)
    masks[odd] |= evaluate(points[odd], wanted[odd], 0.25, 0.5)


def _look_between(
    masks: np.ndarray,
    points: np.ndarray,
    shape: tuple[int, ...],
    config: ReachConfig,
    evaluate: _Evaluator,
) -> tuple[np.ndarray, np.ndarray]:
    """Answers on the edges whose ends disagree, and for each edge its row among them.

    The middle first, then the quarters on the side where the answer changes; only for the azimuths
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
