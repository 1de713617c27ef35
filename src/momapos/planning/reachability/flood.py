"""Build a map for any arm by flooding the grid of lines of its last axis with states.

Random arm states give the first lines. From there, every line is tried from the states on
neighboring lines, a few Newton steps away, until nothing new is found. The first axis need not be
vertical, and no closed-form IK is needed. The idea is from Zacharias et al., Capturing robot
workspace structure (IROS 2007), with neighbors' states instead of inverse kinematics.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import blocks_in_threads
from momapos.model.collision import KNOWN
from momapos.model.kinematics import (
    Chain,
    JointLimits,
    SphereArrays,
    bounded,
    chain_arrays,
    chain_limits,
)
from momapos.model.robots import Robot

from .aim import (
    ALL,
    AZIMUTH,
    GROUPS,
    AimedArm,
    LineGrid,
    LineStates,
    LineTool,
    add,
    aim_all,
    aim_beside,
    aim_between,
    lines_of,
)
from .arm_axes import FULL_TURN, ArmAxes
from .grid import FIRST_TURN, STORED_TURNS, TURNS, GridShape, pack_shape
from .reach_map import Progress, ReachConfig, ReachMap
from .signed_distance import close_seam, deepen, flood_signed_distances

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int, Int8, UInt64


FLOOD_VERSION = 4
"""Version of the flooding method, part of the map's key."""
STATES_PER_DRAW = 300_000
"""Random states that are drawn together [-]."""
LIMIT_OVERSHOOT = 0.125
"""Share of its range by which a joint is sampled beyond each limit, then clipped to it [-]. States
strictly between the limits would miss lines that need a joint at its limit, such as a raised
torso."""
MAX_WAVES = 16
"""Largest number of times that new lines are spread to their neighbors [-]."""
_PARTS, _MIN_PART = 32, 500
"""Number of parts that work is divided into, so that no thread waits long, and the fewest lines of
a part [-]."""


@dataclass(frozen=True)
class Flood:
    """The reached lines of a grid, with the grid and the arm."""

    lines: LineStates
    grid: LineGrid
    arm: AimedArm


def flood(
    chain: Chain, arm: AimedArm, grid: LineGrid, shape: GridShape, count: int, progress: Progress
) -> Flood:
    """Find the lines that an arm reaches.

    Args:
        chain: The arm.
        arm: The same arm for the kernels.
        grid, shape: The grid of lines.
        count: Number of random start states [-].
        progress: Called with the completed share, in [0, 1].
    """
    size = int(np.prod(shape))
    states = np.zeros((size, GROUPS, chain.size), np.float32)
    found = Flood(LineStates(shape, np.zeros(size, np.uint64), states), grid, arm)
    rng = np.random.default_rng(0)
    lower, upper = bounded(chain)
    gained = np.zeros(size, np.uint64)
    beyond = LIMIT_OVERSHOOT * (upper - lower)
    for done in range(0, count, STATES_PER_DRAW):
        drawn = min(STATES_PER_DRAW, count - done)
        q = rng.uniform(lower - beyond, upper + beyond, (drawn, chain.size))
        q = np.clip(q, lower, upper)
        _add_states(found, q, gained)
        progress(0.05 * (done + len(q)) / count)
    for k in range(MAX_WAVES):
        if not gained.any():
            break
        gained = _spread(found, gained, partial(_wave_progress, progress, k))
    return found


def _wave_progress(progress: Progress, k: int, share: float) -> None:
    # Each wave takes about two thirds of the time of the one before.
    progress(1.0 - 0.95 * 0.65 ** (k + share))


def _add_states(
    found: Flood, q: Float[np.ndarray, "k n"], gained: UInt64[np.ndarray, " lines"]
) -> None:
    """Move random states onto their nearest grid lines, and add the turns that they reach."""
    lines, arm, grid = found.lines, found.arm, found.grid
    places = np.empty((len(q), 5))
    _in_parts(lambda lo, hi: lines_of(q[lo:hi], arm, grid, places[lo:hi]), len(q))
    nearest = np.round(places)
    nearest[:, AZIMUTH] %= lines.shape.azimuth
    inside = ((nearest >= 0) & (nearest < lines.shape)).all(1)
    line = np.ravel_multi_index(tuple(nearest[inside].T.astype(np.int64)), lines.shape)
    at, starts, known = nearest[inside], q[inside].astype(np.float32), lines.words[line]
    words, states = np.empty(len(line), np.uint64), np.empty_like(starts)
    _in_parts(
        lambda lo, hi: aim_all(
            at[lo:hi], starts[lo:hi], known[lo:hi], arm, grid, words[lo:hi], states[lo:hi]
        ),
        len(line),
    )
    add(line, words, states[:, None].repeat(GROUPS, 1), lines, gained)


def _spread(
    found: Flood, fresh: UInt64[np.ndarray, " lines"], progress: Progress
) -> UInt64[np.ndarray, " lines"]:
    """Try the neighbors of lines with new turns, from their states; return the turns gained."""
    gained = np.zeros(len(fresh), np.uint64)
    rows = np.flatnonzero(fresh)
    lines, words = np.empty_like(rows), np.empty(len(rows), np.uint64)
    states = np.empty((len(rows), *found.lines.states.shape[1:]), np.float32)
    for axis in range(5):
        for step in (-1, 1):

            def aim(lo: int, hi: int, axis: int = axis, step: int = step) -> None:
                aim_beside(
                    rows[lo:hi], axis, step, fresh, found.lines, found.arm, found.grid,
                    lines[lo:hi], words[lo:hi], states[lo:hi],
                )  # fmt: skip

            _in_parts(aim, len(rows))
            _in_parts(
                lambda lo, hi: add(
                    lines[lo:hi], words[lo:hi], states[lo:hi], found.lines, gained
                ),
                len(rows),
            )  # fmt: skip
            progress((2 * axis + (step > 0) + 1) / 10)
    return gained


def between(
    found: Flood, axis: int, wanted: np.uint64
) -> tuple[Int[np.ndarray, " e"], UInt64[np.ndarray, " e"]]:
    """Find the turns reached half-way between neighboring lines that differ.

    Args:
        found: The reached lines.
        axis: Axis along which the lines are neighbors.
        wanted: Word of the turns that matter; the other bits of the result are undefined.

    Returns:
        The lines at the lower ends, and the words.
    """
    reached = (found.lines.words & wanted).reshape(found.lines.shape)
    near = np.moveaxis(reached, axis, 0)
    differ = np.moveaxis(np.zeros(reached.shape, bool), axis, 0)
    differ[:-1] = near[1:] != near[:-1]
    if axis == AZIMUTH:
        differ[-1] = near[0] != near[-1]
    low = np.flatnonzero(np.moveaxis(differ, 0, axis))
    words = np.empty(len(low), np.uint64)
    _in_parts(
        lambda lo, hi: aim_between(
            low[lo:hi], axis, wanted, found.lines, found.arm, found.grid, words[lo:hi]
        ),
        len(low),
    )
    return low, words


def _in_parts(work: Callable[[int, int], None], count: int) -> None:
    blocks_in_threads(work, count, max(_MIN_PART, count // _PARTS))


_EACH = TURNS // STORED_TURNS
STORED = np.bitwise_or.reduce(np.uint64(1) << np.arange(FIRST_TURN, TURNS, _EACH, dtype=np.uint64))
"""Word of the turns that a map stores."""


def flooded_map(
    robot: Robot,
    frame: ArmAxes,
    extent: tuple[float, tuple[int, ...]],
    config: ReachConfig,
    progress: Progress,
    key: str,
) -> ReachMap:
    """Build the map of any arm, see `build_map`.

    Args:
        frame: Its first and last axis.
        extent: Lowest height [m] and shape of the grid.
        config: Resolution.
        progress: Called with the completed share, in [0, 1].
        key: Content key to store in the map.
    """
    began = time.perf_counter()
    low, shape = extent
    grid = LineGrid(low, config.cell, config.directions, config.azimuths)
    found = flood(
        robot.chain, _aimed(robot, frame), grid, pack_shape(shape), config.states,
        lambda share: progress(0.9 * share),
    )  # fmt: skip
    _close_poles(found)
    wanted = ALL if frame.full_roll else STORED
    edges = []
    for axis in range(5):
        edges.append(between(found, axis, wanted))
        progress(0.9 + 0.015 * (axis + 1))
    if frame.full_roll:
        turned = _values(found, edges, None)[None]
    else:
        turned = np.stack([_values(found, edges, k) for k in range(STORED_TURNS)])
    progress(1.0)
    line = np.stack([frame.tool[0], frame.tool[3]])
    seconds = time.perf_counter() - began
    reach_map = ReachMap(
        turned.max(0), low, config.cell, frame.axis[:2], line, config.threshold, key, seconds
    )
    if frame.full_roll:
        return reach_map
    return replace(reach_map, turned=turned, across_tool=frame.tool[1])


def _aimed(robot: Robot, frame: ArmAxes) -> AimedArm:
    chain = robot.chain
    R = chain.tool_rotation
    line = LineTool(R @ frame.tool[0], R @ frame.tool[1], chain.tool_offset + R @ frame.tool[3])
    lower, upper = chain_limits(chain)
    turns = chain.ends_turning
    if turns and upper[-1] - lower[-1] >= FULL_TURN:
        # A last joint that turns fully has every turn of the tool.
        lower, upper = lower.copy(), upper.copy()
        lower[-1], upper[-1] = -np.inf, np.inf
    limits = JointLimits(lower, upper)
    spheres = robot.spheres.arrays
    own = spheres.segment == len(chain.joints)
    still, turned = _parted(spheres, own)
    return AimedArm(
        chain_arrays(chain), limits, line, turns, still, turned, np.flatnonzero(own), frame.axis
    )


def _parted(
    spheres: SphereArrays, own: Bool[np.ndarray, " groups"]
) -> tuple[SphereArrays, SphereArrays]:
    """Split the collision checks into those unaffected by the last segment and the others."""
    pairs = own[spheres.pairs].any(1)
    still, turned = (
        spheres._replace(
            pairs=spheres.pairs[pick],
            exact=spheres.exact[pick],
            base_pairs=spheres.base_pairs & mine[:, None],
            against_base=np.flatnonzero(mine & spheres.base_pairs.any(1)),
            # Each link is checked against the floor in one of the two halves only.
            gripper=np.where(mine, spheres.gripper, KNOWN),
        )
        for pick, mine in ((~pairs, ~own), (pairs, own))
    )
    return still, turned


def _close_poles(found: Flood) -> None:
    """Count a vertical line that is reached with some turn as reached with all turns.

    The turn counts from the horizontal direction across the line, and a vertical line has no unique
    one.
    """
    words = found.lines.words.reshape(found.lines.shape)
    middle = found.lines.shape.u // 2
    for u, v in ((middle, middle), (0, 0), (0, -1), (-1, 0), (-1, -1)):
        words[:, :, u, v] = np.where(words[:, :, u, v] > 0, ALL, np.uint64(0))


def _values(
    found: Flood, edges: list[tuple[np.ndarray, np.ndarray]], turn: int | None
) -> Int8[np.ndarray, "z r u v azimuth"]:
    """Compute signed distances for one tool turn; None: at least half of all turns must be free."""
    shape, reached = found.lines.shape, found.lines.words
    state = _reached(reached, turn).astype(np.int8)
    middles = np.full((5, len(state)), -1, np.int8)
    for axis, (low, words) in enumerate(edges):
        middles[axis, low] = _reached(words, turn)
    out = np.empty(len(state), np.int8)
    gap = np.zeros(len(state), np.int8) if turn is None else _turn_gap(reached, turn)
    flood_signed_distances(state, middles, gap, shape, out)
    values = out.reshape(shape)
    close_seam(values)
    deepen(values.reshape(-1), shape)
    return values


def _reached(words: UInt64[np.ndarray, " k"], turn: int | None) -> Bool[np.ndarray, " k"]:
    if turn is None:
        return np.bitwise_count(words) * 2 >= TURNS
    return (words >> np.uint64(_EACH * turn + FIRST_TURN)) & np.uint64(1) > 0


def _turn_gap(words: UInt64[np.ndarray, " k"], turn: int) -> Int8[np.ndarray, " k"]:
    """Return the steps of the tool turn to the nearest one that differs, 0 if none is near."""
    own = _reached(words, turn)
    gap = np.zeros(len(words), np.int8)
    for step in range(_EACH, 0, -1):
        for offset in (step, -step):
            bit = np.uint64((_EACH * turn + FIRST_TURN + offset) % TURNS)
            gap[((words >> bit) & np.uint64(1) > 0) != own] = step
    return gap
