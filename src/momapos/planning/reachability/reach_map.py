"""The reachability map of one robot: how well can a tool pose be reached from a base pose."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from importlib import import_module
from typing import TYPE_CHECKING

import numpy as np

from .floor_scores import FloorGrid, floor_scores
from .grid import OUTSIDE, GridFrame, MapArrays, Point, min_line_scores, pack_shape, score_lines

if TYPE_CHECKING:
    from jaxtyping import Float, Int, Int8

YAWS = 12
"""Yaws that `base_scores` tries."""
MAX_VALUES = 100_000_000
"""Values that a map may hold [-]; building it takes several bytes for each."""
_TURNS = np.arange(YAWS) / YAWS
_YAWS = np.stack([np.cos(2 * np.pi * _TURNS), np.sin(2 * np.pi * _TURNS), _TURNS], -1)


@dataclass(frozen=True)
class ReachConfig:
    """How finely a reachability map is built."""

    cell: float = 0.04
    """Spacing of the grid in height and distance [m]."""
    directions: int = 25
    """Grid points along each side of the octahedral square of directions, odd [-]."""
    azimuths: int = 32
    """Grid points along the azimuth, a divisor of 64 [-]; 1 leaves the azimuth out. It is also
    left out where it makes no difference."""
    samples: int = 32
    """Values at which the first joint of a longer arm is locked [-]; where they disagree, up to
    four times as many. Only half of them are tried far from anything reachable."""
    heights: int = 5
    """Values at which a torso is locked [-]; about half of them far from anything reachable."""
    threshold: float = -0.4
    """Value from which on a line counts as reachable [1/8 cell]. Interpolation rounds the convex
    boundary of the reachable set inwards, by about 1/20 of a cell."""
    spins: int = 4
    """Turns of the tool about its last axis that vote on a line: tools are not round, and half of
    them must be free of collision [-]."""
    states: int = 300_000
    """Random arm states that the map of an arm begins with whose first axis is not vertical, or
    whose last joint does not turn fully [-]."""


@dataclass(frozen=True)
class ReachMap:
    """The reachability map of a robot: signed distances to the boundary of what its arm reaches.

    They stand over the lines of the last axis; see `momapos.planning.reachability.grid`.
    """

    values: Int8[np.ndarray, "z r u v azimuth"]
    """Cells to the boundary in steps of 1/8; positive inside."""
    low: float
    """Height of the lowest grid point over the floor [m]."""
    cell: float
    """Spacing in height and distance [m]."""
    axis_xy: Float[np.ndarray, "2"]
    """Foot of the first axis in the base frame, which the grid stands around [m]."""
    line_tool: Float[np.ndarray, "2 3"]
    """Direction of the last axis and a point on it [m], in the tool frame."""
    threshold: float = 0.0
    """Value from which on a line counts as reachable."""
    key: str = ""
    """Content key of what the map was built from."""
    build_seconds: float = 0.0
    turned: Int8[np.ndarray, "k z r u v azimuth"] | None = None
    """The same for k turns of the tool about the line, where these make a difference; `values` are
    then the best of them."""
    across_tool: Float[np.ndarray, "3"] | None = None
    """Unit vector across the line whose angle about it is the turn, in the tool frame."""

    def __repr__(self) -> str:
        size = " x ".join(map(str, self.values.shape))
        return f"<ReachMap {self.key}: {size} values, {self.reach:.2f} m>"

    def _repr_png_(self) -> bytes:
        """The picture that a notebook shows."""
        # By name: what draws records is downstream of them.
        png: bytes = import_module("momapos.apps.plots.notebook_images").reach_png(self)
        return png

    @property
    def reach(self) -> float:
        """No tool's last axis point is farther from the first axis than this [m]."""
        return (self.values.shape[1] - 1) * self.cell

    def _arrays(self) -> MapArrays:
        frame = GridFrame(float(self.low), 1.0 / float(self.cell), float(self.threshold))
        shape = pack_shape(self.values.shape)
        if self.turned is None:
            return MapArrays(self.values.reshape(-1), shape, frame, 1)
        return MapArrays(self.turned.reshape(-1), shape, frame, len(self.turned))

    def turns(self, Ts: Float[np.ndarray, "*batch 4 4"]) -> Float[np.ndarray, " *batch"]:
        """Turn of the tool about its last axis [turns]; 0 where it makes no difference.

        It counts from the level direction across the axis, so that it is the same for every base.
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
        """The map in which the best turn of the tool counts."""
        return replace(self, turned=None)._arrays()

    def _axis(self) -> Point:
        return Point(float(self.axis_xy[0]), float(self.axis_xy[1]))

    def lines(self, Ts: Float[np.ndarray, "*batch 4 4"]) -> Float[np.ndarray, "*batch 6"]:
        """The last axis of tool poses: a point [m] and a direction, in the frame of the poses."""
        Ts = np.asarray(Ts, float)
        direction = Ts[..., :3, :3] @ self.line_tool[0]
        point = Ts[..., :3, :3] @ self.line_tool[1] + Ts[..., :3, 3]
        return np.concatenate([point, direction], -1)

    def score(self, Ts_base_tool: Float[np.ndarray, "*batch 4 4"]) -> Float[np.ndarray, " *batch"]:
        """How well tool poses can be reached: 0 not at all, 1 four cells inside the boundary.

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
        """The worst score along each grasp's waypoints, for each base pose.

        Args:
            bases: x, y [m], yaw [rad] of the base on the floor, in the world frame.
            Ts_world_tool: Tool poses of g grasps at w waypoints.
        """
        # The last waypoint rules most bases out that the first does not, so it is looked at first.
        Ts_world_tool = np.roll(np.asarray(Ts_world_tool, float), 1, axis=1)
        lines = np.ascontiguousarray(self.lines(Ts_world_tool))
        bases = np.ascontiguousarray(bases, float)
        out = np.empty((len(bases), len(lines)), np.float32)
        turn = np.ascontiguousarray(self.turns(Ts_world_tool))
        min_line_scores(bases, lines, turn, self._axis(), self._arrays(), out)
        return out

    def score_base_poses(
        self, base_poses: Float[np.ndarray, "n 3"], T_world_tool: Float[np.ndarray, "4 4"]
    ) -> Float[np.ndarray, " n"]:
        """Score of base poses for one tool pose, see `score`.

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
        """Score of bases on a grid of the floor for one tool pose, each at its best yaw.

        The best of 12 yaws. What is between axes of the arm 6 cm apart is interpolated: scores
        differ from `score` by 0.01 on average, and by 0.15 at most.

        Args:
            T_world_tool: Tool pose in the world frame.
            xs: Coordinates of the bases along x [m].
            ys: Likewise along y [m].
        """
        line = self.lines(T_world_tool)
        xs, ys = np.ascontiguousarray(xs, float), np.ascontiguousarray(ys, float)
        out = np.empty((len(ys), len(xs)), np.float32)
        floor = FloorGrid(xs, ys, _YAWS)
        floor_scores(line, floor, self._axis(), self._any_turn(), self._rims, out)
        return out

    @cached_property
    def _rims(self) -> Int[np.ndarray, " z"]:
        """For each height, the first r from which on nothing is near the reachable [cells]."""
        near = (self.values > OUTSIDE).any((2, 3, 4))
        return (near * np.arange(1, near.shape[1] + 1)).max(1)
