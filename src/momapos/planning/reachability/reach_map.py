"""The reachability map of one robot: how well a tool pose can be reached from a base pose."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from importlib import import_module
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import finite_number, refuse_above, refuse_below

from .floor_scores import FloorGrid, floor_scores
from .grid import OUTSIDE, GridFrame, MapArrays, Point, min_line_scores, pack_shape, score_lines

if TYPE_CHECKING:
    from jaxtyping import Float, Int, Int8

YAWS = 12
"""Number of base yaws that `base_scores` tries [-]."""
MAX_VALUES = 100_000_000
"""Largest number of values of a map [-]; building it takes several bytes per value."""
MAX_LOOKUPS = 2_000_000
"""Number of lines that are looked up between two looks at the clock; they take about 0.1 s [-]."""
_TURNS = np.arange(YAWS) / YAWS
_YAWS = np.stack([np.cos(2 * np.pi * _TURNS), np.sin(2 * np.pi * _TURNS), _TURNS], -1)


MAX_GRID, MAX_STATES = 1_000, 100_000_000
"""Bounds of the counts [-]."""


@dataclass(frozen=True)
class ReachConfig:
    """Resolution of a reachability map."""

    cell: float = 0.04
    """Spacing of the grid in height and distance [m]."""
    directions: int = 25
    """Grid points along each side of the octahedral square of directions, odd [-]."""
    azimuths: int = 32
    """Grid points along the azimuth, a divisor of 64 [-]; 1 omits the azimuth. It is also omitted
    if it makes no difference."""
    samples: int = 32
    """Locked values of the first joint of a redundant arm [-]; up to four times as many where
    neighbors disagree. Far from any reachable line, only half of them are tried."""
    heights: int = 5
    """Locked values of a torso joint [-]; about half of them far from any reachable line."""
    threshold: float = -0.4
    """Value above which a line counts as reachable [1/8 cell]. Interpolation shifts the convex
    boundary of the reachable set inwards by about 1/20 of a cell."""
    spins: int = 4
    """Tool turns about the last axis that are checked for collision, as tools are not round [-];
    at least half of them must be free."""
    states: int = 300_000
    """Random arm states that start the flooding [-]. An arm is flooded if its first axis is not
    vertical or its last joint does not turn fully."""

    def __post_init__(self) -> None:
        refuse_below(self, 0.005, "cell")
        refuse_below(self, 3, "directions")
        refuse_below(self, 1, "azimuths", "samples", "heights", "spins", "states")
        refuse_above(self, MAX_GRID, "directions", "azimuths", "samples", "heights", "spins")
        refuse_above(self, MAX_STATES, "states")
        finite_number("ReachConfig.threshold", self.threshold)


@dataclass(frozen=True, eq=False)
class ReachMap:
    """The reachability map of a robot: signed distances to the boundary of the reachable set.

    The grid is over the lines of the arm's last axis, see `momapos.planning.reachability.grid`.
    """

    values: Int8[np.ndarray, "z r u v azimuth"]
    """Distance to the boundary [1/8 cell]; positive inside."""
    low: float
    """Height of the lowest grid point over the floor [m]."""
    cell: float
    """Spacing in height and distance [m]."""
    axis_xy: Float[np.ndarray, "2"]
    """Foot of the first axis in the base frame [m]; the grid is centered on it."""
    line_tool: Float[np.ndarray, "2 3"]
    """Direction of the last axis and a point on it [m], in the tool frame."""
    threshold: float = 0.0
    """Value above which a line counts as reachable [1/8 cell]."""
    key: str = ""
    """Content key of the data that the map was built from."""
    build_seconds: float = 0.0
    turned: Int8[np.ndarray, "k z r u v azimuth"] | None = None
    """Values for k tool turns about the line; `values` holds their maximum. None if the turn makes
    no difference."""
    across_tool: Float[np.ndarray, "3"] | None = None
    """Unit vector across the line, in the tool frame; its angle about the line is the tool turn."""

    def __repr__(self) -> str:
        size = " x ".join(map(str, self.values.shape))
        return f"<ReachMap {self.key}: {size} values, {self.reach:.2f} m>"

    def _repr_png_(self) -> bytes:
        """Return the figure that a notebook shows."""
        # Imported by name, because plots are above planning in the import order.
        png: bytes = import_module("momapos.apps.plots.notebook_images").reach_png(self)
        return png

    @property
    def reach(self) -> float:
        """Upper bound of the distance between the last axis point and the first axis [m]."""
        return (self.values.shape[1] - 1) * self.cell

    def _arrays(self) -> MapArrays:
        frame = GridFrame(float(self.low), 1.0 / float(self.cell), float(self.threshold))
        shape = pack_shape(self.values.shape)
        if self.turned is None:
            return MapArrays(self.values.reshape(-1), shape, frame, 1)
        return MapArrays(self.turned.reshape(-1), shape, frame, len(self.turned))

    def turns(self, Ts: Float[np.ndarray, "*batch 4 4"]) -> Float[np.ndarray, " *batch"]:
        """Return the tool's turn about its last axis [turns]; 0 if it makes no difference.

        It counts from the horizontal direction across the axis, so it is the same for every base.
        """
        Ts = np.asarray(Ts, float)
        if self.across_tool is None:
            return np.zeros(Ts.shape[:-2])
        direction, across = Ts[..., :3, :3] @ self.line_tool[0], Ts[..., :3, :3] @ self.across_tool
        level = np.stack([-direction[..., 1], direction[..., 0], 0 * direction[..., 2]], -1)
        upwards = np.cross(direction, level)
        turn = np.arctan2((across * upwards).sum(-1), (across * level).sum(-1))
        return np.asarray(turn / (2 * np.pi) % 1.0)

    def _any_turn(self) -> MapArrays:
        """Return the map that scores each line by its best tool turn."""
        return replace(self, turned=None)._arrays()

    def _axis(self) -> Point:
        return Point(float(self.axis_xy[0]), float(self.axis_xy[1]))

    def lines(self, Ts: Float[np.ndarray, "*batch 4 4"]) -> Float[np.ndarray, "*batch 6"]:
        """Return the last axis of tool poses in their frame: a point [m] and a direction."""
        Ts = np.asarray(Ts, float)
        direction = Ts[..., :3, :3] @ self.line_tool[0]
        point = Ts[..., :3, :3] @ self.line_tool[1] + Ts[..., :3, 3]
        return np.concatenate([point, direction], -1)

    def score(self, Ts_base_tool: Float[np.ndarray, "*batch 4 4"]) -> Float[np.ndarray, " *batch"]:
        """Score tool poses: 0 for unreachable, 1 from four cells inside the boundary on.

        Args:
            Ts_base_tool: Tool poses in the base frame, z up from the floor.
        """
        lines = self.lines(Ts_base_tool)
        batch = lines.shape[:-1]
        lines = np.ascontiguousarray(lines.reshape(-1, 6))
        lines[:, :2] -= self.axis_xy
        out = np.empty(len(lines))
        score_lines(lines, self.turns(Ts_base_tool).reshape(-1), self._arrays(), out)
        return out.reshape(batch)

    def min_score(
        self, bases: Float[np.ndarray, "n 3"], Ts_world_tool: Float[np.ndarray, "g w 4 4"]
    ) -> Float[np.ndarray, "n g"]:
        """Return the worst score along each grasp's waypoints, for each base pose.

        Args:
            bases: x, y [m], yaw [rad] of the base on the floor, in the world frame.
            Ts_world_tool: Tool poses of g grasps at w waypoints.
        """
        # Evaluate the last waypoint first: it rules out most base poses that the first one leaves.
        Ts_world_tool = np.roll(np.asarray(Ts_world_tool, float), 1, axis=1)
        lines = np.ascontiguousarray(self.lines(Ts_world_tool))
        bases = np.ascontiguousarray(bases, float)
        out = np.empty((len(bases), len(lines)), np.float32)
        turn = np.ascontiguousarray(self.turns(Ts_world_tool))
        block = max(1, MAX_LOOKUPS // max(1, lines[..., 0].size))
        for first in range(0, len(bases), block):
            part = slice(first, first + block)
            min_line_scores(bases[part], lines, turn, self._axis(), self._arrays(), out[part])
        return out

    def score_base_poses(
        self, base_poses: Float[np.ndarray, "n 3"], T_world_tool: Float[np.ndarray, "4 4"]
    ) -> Float[np.ndarray, " n"]:
        """Score base poses for one tool pose, see `score`.

        Args:
            base_poses: x, y [m], yaw [rad] of the base on the floor, in the world frame.
            T_world_tool: Tool pose in the world frame.
        """
        return self.min_score(base_poses, np.asarray(T_world_tool, float)[None, None])[:, 0]

    def base_scores(
        self,
        T_world_tool: Float[np.ndarray, "4 4"],
        xs: Float[np.ndarray, " columns"],
        ys: Float[np.ndarray, " rows"],
    ) -> Float[np.ndarray, "rows columns"]:
        """Score base positions on a floor grid for one tool pose, each at the best of 12 yaws.

        Positions of the first axis are interpolated between points 6 cm apart: scores differ from
        `score` by 0.01 on average and by at most 0.15.

        Args:
            T_world_tool: Tool pose in the world frame.
            xs: x coordinates of the bases [m].
            ys: y coordinates of the bases [m].
        """
        line = self.lines(T_world_tool)
        xs, ys = np.ascontiguousarray(xs, float), np.ascontiguousarray(ys, float)
        out = np.empty((len(ys), len(xs)), np.float32)
        floor = FloorGrid(xs, ys, _YAWS)
        floor_scores(line, floor, self._axis(), self._any_turn(), self._rims, out)
        return out

    @cached_property
    def _rims(self) -> Int[np.ndarray, " z"]:
        """For each height, the smallest r beyond which all values are `OUTSIDE` [cells]."""
        near = (self.values > OUTSIDE).any((2, 3, 4))
        return (near * np.arange(1, near.shape[1] + 1)).max(1)
