"""Moves between the states of the lattice, for each kind of drive."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import wrap_angle
from momapos.model.robots import Robot

from .cost_map import CELL
from .footprint_map import HEADINGS, MOVES
from .lattice import Moves

if TYPE_CHECKING:
    from jaxtyping import Int

REVERSING_COST = 1.3
"""Cost of a meter driven backwards, except for an omni base [-]."""
RADIUS_RESERVE = 1.1
"""Turning radius of the paths of a car-like base, relative to its least one [-]. The rest corrects
deviations in a turn: twelve drives in `kitchen_small` take 27 paths and 213 s with 1.02, 19 and
187 s with 1.1, and 18 and 202 s with 1.25, where the paths are longer."""


def planned_radius(robot: Robot) -> float:
    """Return the turning radius of a robot's paths [m]; 0 for one that turns on the spot."""
    return RADIUS_RESERVE * robot.min_turning_radius if robot.drive == "car" else 0.0


def lattice_moves(robot: Robot) -> Moves:
    """Return the moves of a robot's base.

    An omni base moves along all headings and turns on the spot; a differential base moves along its
    own heading, both ways, and turns on the spot. A car-like base moves along its heading, and
    bends to the next heading: whole steps before and after are the tangents of an arc.
    """
    if robot.drive == "omni":
        return _turning_moves(True)
    return _car_moves(planned_radius(robot)) if robot.drive == "car" else _turning_moves(False)


@lru_cache(maxsize=2)
def _turning_moves(omni: bool) -> Moves:
    count = len(HEADINGS)
    own = np.arange(count)
    ways = count if omni else 2
    along = np.arange(count)[None] + 0 * own[:, None]
    if not omni:
        along = np.stack([own, own + count // 2], -1) % count
    heading = np.column_stack([(own + 1) % count, (own - 1) % count, np.tile(own[:, None], ways)])
    steps = np.concatenate([np.zeros((count, 2, 2), int), MOVES[along]], axis=1)
    factor = np.ones(2 + ways)
    factor[3:] = 1.0 if omni else REVERSING_COST
    return _moves(heading, steps, np.hypot(*steps.T).T * CELL, factor)


@lru_cache(maxsize=8)
def _car_moves(radius: float) -> Moves:
    count = len(HEADINGS)
    own = np.arange(count)
    heading, steps, length = [own, own], [MOVES, -MOVES], [_sizes(MOVES), _sizes(MOVES)]
    for way in (1, -1):
        for side in (1, -1):
            # Backwards, the heading after the move is that of a turn to the other side.
            after = (own + side) % count
            half = np.abs(wrap_angle(HEADINGS[after] - HEADINGS)) / 2
            tangent = radius * np.tan(half)
            before_steps, after_steps = (
                np.maximum(1, np.ceil(tangent / _sizes(MOVES[which]))).astype(int)
                for which in (own, after)
            )
            before, behind = before_steps * _sizes(MOVES), after_steps * _sizes(MOVES[after])
            least = np.minimum(before, behind)
            heading.append(after)
            steps.append(
                way * (before_steps[:, None] * MOVES + after_steps[:, None] * MOVES[after])
            )
            length.append(before + behind - 2 * least + least / np.tan(half) * 2 * half)
    factor = np.array([1.0, REVERSING_COST, 1.0, 1.0, REVERSING_COST, REVERSING_COST])
    return _moves(np.stack(heading, -1), np.stack(steps, 1), np.stack(length, -1), factor)


def _sizes(moves: Int[np.ndarray, "n 2"]) -> np.ndarray:
    return np.asarray(np.hypot(*moves.T) * CELL)


def _moves(
    heading: Int[np.ndarray, "h m"],
    steps: Int[np.ndarray, "h m 2"],
    length: np.ndarray,
    factor: np.ndarray,
) -> Moves:
    columns, rows = (np.ascontiguousarray(steps[..., k], np.int64) for k in (0, 1))
    return Moves(
        np.ascontiguousarray(heading, np.int64), columns, rows, np.ascontiguousarray(length), factor
    )
