"""Build a map for any arm by flooding the grid of lines, see `flood`."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.collision import KNOWN
from momapos.model.kinematics import JointLimits, SphereArrays, chain_arrays, chain_limits
from momapos.model.robots import Robot

from .aim import ALL, AimedArm, LineGrid, LineTool
from .arm_axes import FULL_TURN, ArmAxes
from .flood import Flood, between, flood
from .grid import FIRST_TURN, STORED_TURNS, TURNS, pack_shape
from .reach_map import ReachConfig, ReachMap
from .signed_distance import close_seam, deepen, flood_signed_distances
from .threads import Progress

if TYPE_CHECKING:
    from jaxtyping import Bool, Int8, UInt64

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
