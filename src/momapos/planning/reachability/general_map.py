"""Put a map together for an arm of any kind, from the lines that its states flood."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.collision import KNOWN
from momapos.model.kinematics import JointLimits, SphereArrays, chain_arrays, chain_limits
from momapos.model.robots import Robot

from .aim import ALL, AimedArm, LineGrid, LineTool
from .arm_axes import FULL_TURN, ArmAxes
from .flood import Flood, between, flood
from .grid import FIRST_TURN, TOLD_APART, TURNS, pack_shape
from .reach_map import ReachConfig, ReachMap
from .signed_distance import close_seam, deepen, flood_signed_distances
from .threads import Progress

if TYPE_CHECKING:
    from jaxtyping import Bool, Int8, UInt64

_EACH = TURNS // TOLD_APART
TOLD = np.bitwise_or.reduce(np.uint64(1) << np.arange(FIRST_TURN, TURNS, _EACH, dtype=np.uint64))
"""The turns that are told apart, as a word."""


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
        robot: The robot.
        frame: Its last axis, and what the grid stands around.
        extent: Lowest height and shape of the grid.
        config: How finely.
        progress: Called with the share that is done.
        key: Content key to be kept in the map.
    """
    began = time.perf_counter()
    low, shape = extent
    grid = LineGrid(low, config.cell, config.directions, config.azimuths)
    found = flood(
        robot.chain, _aimed(robot, frame), grid, pack_shape(shape), config.states,
        lambda share: progress(0.9 * share),
    )  # fmt: skip
    _close_poles(found)
    asked = ALL if frame.full_roll else TOLD
    edges = []
    for axis in range(5):
        edges.append(between(found, axis, asked))
        progress(0.9 + 0.015 * (axis + 1))
    if frame.full_roll:
        turned = _values(found, edges, None)[None]
    else:
        turned = np.stack([_values(found, edges, k) for k in range(TOLD_APART)])
    progress(1.0)
    line = np.stack([frame.tool[0], frame.tool[3]])
    return ReachMap(
        values=turned.max(0),
        low=low,
        cell=config.cell,
        axis_xy=frame.axis[:2],
        line_tool=line,
        threshold=config.threshold,
        key=key,
        build_seconds=time.perf_counter() - began,
        turned=None if frame.full_roll else turned,
        across_tool=None if frame.full_roll else frame.tool[1],
    )


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
    """Checks among what does not move with the last segment, and those of what does."""
    pairs = own[spheres.pairs].any(1)
    still, turned = (
        spheres._replace(
            pairs=spheres.pairs[pick],
            exact=spheres.exact[pick],
            base_pairs=spheres.base_pairs & mine[:, None],
            against_base=np.flatnonzero(mine & spheres.base_pairs.any(1)),
            # The floor is asked of each link once.
            gripper=np.where(mine, spheres.gripper, KNOWN),
        )
        for pick, mine in ((~pairs, ~own), (pairs, own))
    )
    return still, turned


def _close_poles(found: Flood) -> None:
    """Let a vertical line that is reached with some turn count as reached with all of them.

    The turn counts from the level direction across the line, of which a vertical line has many.
    """
    words = found.lines.words.reshape(found.lines.shape)
    middle = found.lines.shape.u // 2
    for u, v in ((middle, middle), (0, 0), (0, -1), (-1, 0), (-1, -1)):
        words[:, :, u, v] = np.where(words[:, :, u, v] > 0, ALL, np.uint64(0))


def _values(
    found: Flood, edges: list[tuple[np.ndarray, np.ndarray]], turn: int | None
) -> Int8[np.ndarray, "z r u v azimuth"]:
    """Signed distances for one turn of the tool, or where at least half of all turns count."""
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
    """Steps of the tool's turn to the first that is not as this one, both ways; 0: none is near."""
    own = _reached(words, turn)
    gap = np.zeros(len(words), np.int8)
    for step in range(_EACH, 0, -1):
        for way in (step, -step):
            bit = np.uint64((_EACH * turn + FIRST_TURN + way) % TURNS)
            gap[((words >> bit) & np.uint64(1) > 0) != own] = step
    return gap
