"""Paths of the base through the layers of a lattice: how far each use of the base moves a part."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from lattice_kernel import BORNE, CLEAR, PULLED, REACHED
from lattice_nodes import CELL, Lattice

if TYPE_CHECKING:
    from jaxtyping import Bool, Int, Int8

ALONG, AROUND = "along", "around"
"""A base that keeps its yaw, and one that also turns, while the hand holds."""
WITHOUT_FORCES, WITHOUT_OBSTACLES = "any without forces", "any without obstacles"


@dataclass(frozen=True)
class Use:
    """A use of the base, and what its nodes must be."""

    name: str
    level: int
    """Least level of a node."""
    moves: str = ""
    """How the base moves while the hand holds: `ALONG`, `AROUND`, or not at all."""
    moving_level: int = PULLED
    """Least level of nodes while it moves."""
    rigid: bool = False
    """Whether the hand keeps its grasp without turning about it."""
    stops: bool = False
    """Whether it may drive elsewhere where the part stays, as often as it needs."""


USES = (
    Use("fixed", BORNE),
    Use("moving", PULLED, ALONG),
    Use("turning", PULLED, AROUND),
    Use("stops", BORNE, stops=True),
    Use("any", BORNE, AROUND, PULLED, stops=True),
    Use("moving rigid", PULLED, ALONG, rigid=True),
    Use("moving without its pull", BORNE, ALONG, BORNE),
    Use(WITHOUT_FORCES, CLEAR, AROUND, CLEAR, stops=True),
    Use(WITHOUT_OBSTACLES, REACHED, AROUND, REACHED, stops=True),
)
"""The last four say what stops the others."""


@dataclass(frozen=True, eq=False)
class Neighbors:
    """Which cells the base may change between."""

    lattice: Lattice

    @cached_property
    def along(self) -> Int[np.ndarray, "k 2"]:
        """Steps between cells of one yaw, each once."""
        every = np.array([[1, 0], [0, 1], [1, 1], [1, -1]])
        return every if self.lattice.robot.drive == "omni" else every[:1]

    @cached_property
    def around(self) -> tuple[Int[np.ndarray, " e"], Int[np.ndarray, " e"]]:
        """Pairs of cells at one yaw and at the next one, as indices into their cells.

        Where the base ends is not on the lattice: all cells around count as its end.
        """
        lattice = self.lattice
        side, turn = lattice.shape[2], float(lattice.yaws[1])
        i, j = (a.ravel() for a in np.indices((side, side)))
        ends = []
        for length in self._arcs(turn):
            chord = length * np.sinc(turn / 2 / np.pi) / CELL
            x = i - lattice.half + chord * np.cos(turn / 2)
            y = j - lattice.half + chord * np.sin(turn / 2)
            c, s = np.cos(turn), np.sin(turn)
            ends.append(np.stack([c * x + s * y, c * y - s * x], axis=-1) + lattice.half)
        low = np.floor(np.concatenate(ends) + 1e-9).astype(np.int64)
        corners = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])
        to = (low[:, None] + corners).reshape(-1, 2)
        start = np.tile(np.repeat(i * side + j, 4), len(ends))
        inside = ((to >= 0) & (to < side)).all(1)
        pairs = np.unique(
            np.column_stack([start, to[:, 0] * side + to[:, 1]])[inside], axis=0
        )  # fmt: skip
        return pairs[:, 0], pairs[:, 1]

    def _arcs(self, turn: float) -> list[float]:
        """Return the signed lengths of the arcs by which the base turns to the next yaw [m]."""
        robot = self.lattice.robot
        if robot.min_turning_radius <= 0.0 or robot.drive != "car":
            return [0.0]
        least = robot.min_turning_radius * turn
        return [sign * factor * least for sign in (-1, 1) for factor in (1.0, 1.5, 2.0)]


@dataclass(eq=False)
class Reach:
    """What the uses of the base reach, layer by layer."""

    lattice: Lattice
    neighbors: Neighbors

    def __post_init__(self) -> None:
        self.reached: dict[str, Bool[np.ndarray, "g y i j"] | None] = {}
        self.farthest = {use.name: -1 for use in USES}
        self.nodes: list[int] = []

    def add(self, layer: int, levels: Int8[np.ndarray, "g y i j"]) -> bool:
        """Extend all uses by a layer; return whether farther ones matter.

        They do not once no use gets there even without forces.
        """
        self.nodes.append(int((levels >= CLEAR).sum()))
        drivable = self.lattice.drivable[None]
        for use in USES:
            before = self.reached.get(use.name)
            free = levels >= use.level
            if layer == 0:
                now = free & drivable
            elif before is None:
                continue
            else:
                now = self._crossed(before, levels, use) & free
            now = self._spread(now, levels, use, drivable, bool(self.lattice.stays[layer]))
            self.reached[use.name] = now if now.any() else None
            if now.any():
                self.farthest[use.name] = layer
        return self.reached[WITHOUT_FORCES] is not None

    @property
    def why(self) -> str:
        """What stops a base that may do anything: reach, collision or force; "" for nothing."""
        last = len(self.lattice.values) - 1
        if self.farthest["any"] == last:
            return ""
        if self.farthest[WITHOUT_FORCES] == last:
            return "force"
        farther = self.farthest[WITHOUT_OBSTACLES] > self.farthest[WITHOUT_FORCES]
        return "collision" if farther else "reach"

    def _crossed(
        self, before: Bool[np.ndarray, "g y i j"], levels: Int8[np.ndarray, "g y i j"], use: Use
    ) -> Bool[np.ndarray, "g y i j"]:
        """Return where the base may be a layer later."""
        out = before.copy()
        if use.moves:
            moved = levels >= use.moving_level
            out |= _stepped(before, self.neighbors, use) & moved
        return out if use.rigid else out | self._turned(out)

    def _turned(self, reached: Bool[np.ndarray, "g y i j"]) -> Bool[np.ndarray, "g y i j"]:
        """Return the nodes whose grasp is next to one that is reached, as the hand turns."""
        out, begin = np.zeros_like(reached), 0
        for one in self.lattice.sets:
            first = np.flatnonzero(one.following >= 0)
            begin, start = begin + len(one.free), begin
            after = start + one.following[first]
            out[after] |= reached[start + first]
            # A grasp follows at most one other.
            out[start + first] |= reached[after]
        return out

    def _spread(
        self, now: Bool[np.ndarray, "g y i j"], levels: Int8[np.ndarray, "g y i j"], use: Use,
        drivable: Bool[np.ndarray, "1 y i j"], stays: bool,
    ) -> Bool[np.ndarray, "g y i j"]:  # fmt: skip
        """Return the nodes that are reached from others while the part rests."""
        free = levels >= use.level
        if not now.any():
            return now
        if stays and use.stops:
            return np.asarray(now | (free & drivable))
        if stays and not use.moves:
            now = np.asarray(now | (np.any(now, axis=0, keepdims=True) & free))
        moved = levels >= use.moving_level
        while True:
            more = now if use.rigid else now | (self._turned(now) & free)
            if use.moves:
                more = more | (_stepped(more & moved, self.neighbors, use) & moved)
            if np.array_equal(more, now):
                return now
            now = more


def _stepped(
    reached: Bool[np.ndarray, "g y i j"], neighbors: Neighbors, use: Use
) -> Bool[np.ndarray, "g y i j"]:
    """Return the cells next to those that are reached."""
    out = np.zeros_like(reached)
    for i, j in neighbors.along.tolist():
        ahead, behind = _window(i, j)
        out[(..., *ahead)] |= reached[(..., *behind)]
        out[(..., *behind)] |= reached[(..., *ahead)]
    if use.moves == AROUND:
        start, end = neighbors.around
        grasps, yaws, side, _ = reached.shape
        from_, to = (a.reshape(grasps, yaws, side * side) for a in (reached, out))
        g, y, cell = np.nonzero(from_)
        order, first = np.argsort(start, kind="stable"), np.arange(side * side + 1)
        _scatter(to, g, (y + 1) % yaws, cell, end[order], np.searchsorted(start[order], first))
        order = np.argsort(end, kind="stable")
        _scatter(to, g, (y - 1) % yaws, cell, start[order], np.searchsorted(end[order], first))
    return out


def _scatter(
    out: Bool[np.ndarray, "g y c"],
    g: Int[np.ndarray, " m"],
    y: Int[np.ndarray, " m"],
    cell: Int[np.ndarray, " m"],
    to: Int[np.ndarray, " e"],
    first: Int[np.ndarray, " c_plus_1"],
) -> None:
    """Mark the cells to which edges lead, in compressed rows, from some cells."""
    count = first[cell + 1] - first[cell]
    rows = np.repeat(np.arange(len(cell)), count)
    within = np.arange(len(rows)) - np.repeat(np.cumsum(count) - count, count)
    out[g[rows], y[rows], to[first[cell[rows]] + within]] = True


def _window(i: int, j: int) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Return the slices of a grid that are a step apart."""
    ahead = slice(i, None), slice(j, None) if j >= 0 else slice(None, j)
    behind = slice(None, -i or None), slice(None, -j or None) if j >= 0 else slice(-j, None)
    return ahead, behind
