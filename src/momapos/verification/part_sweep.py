"""The way of the moved part through the room, whoever moves it.

Real scenes are not clean: doors stand flush with their neighbors, drawers lie in frames that
they touch, a thing leans on a front. So the scene as it is counts as given, and asked is only that
the part comes no deeper into anything. The part's own object is its bearing: its elements that
touch the part where it is closed are left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import invert

from .convex import overlap
from .exact_shapes import Shapes
from .moved_part import MovedPart
from .report import Limits
from .sweep import all_pairs, deepest

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

BEARING = -1e-3
"""Depth from which an element of the own object touches the closed part: 1 mm apart [m]."""


@dataclass(frozen=True)
class PartSweepCheck:
    """A part, the room, and which of their shapes may meet how deep."""

    part: MovedPart
    fixed: Shapes
    pairs: Int[np.ndarray, "p 2"]
    """Indices into the shapes of the part and into the room's."""
    already: Float[np.ndarray, " p"]
    """What does not count of the depth of each pair, since the scene has it so [m]."""
    limits: Limits

    def first_hit(self, goal: float) -> str | None:
        """What stops the part before a value of its joint (or a lift), and at which.

        Args:
            goal: Value [rad] or [m]; where no joint moves it, how far it is lifted [m].

        Returns:
            Words for people; None where the way is free.
        """
        span = goal - self.part.start
        count = max(2, math.ceil(abs(span) / self.limits.step) + 1)
        values = np.linspace(self.part.start, goal, count)
        Ts, Ts_fixed = self.part.placed(values), self.fixed.Ts_body_shape
        limit = self.limits.penetration
        depth, _ = deepest(
            self.part.shapes, Ts, self.fixed, Ts_fixed[None], self.pairs, min(0.0, limit)
        )
        deep = np.flatnonzero(depth - self.already > limit)
        hits = [(self._first_state(p, Ts), p) for p in deep.tolist()]
        if not hits:
            return None
        state, p = min(hits)
        i, j = self.pairs[p]
        names = f"{self.part.shapes.names[i]} hits {self.fixed.names[j]}"
        return f"{names} {self._at(float(values[state]), goal)}"

    def _first_state(self, pair: int, Ts: Float[np.ndarray, "s k 4 4"]) -> int:
        """The first of some states at which a pair is too deep; there is one."""
        i, j = self.pairs[pair].tolist()
        a, b = self.part.shapes.core(i), self.fixed.core(j)
        allowed = self.limits.penetration + self.already[pair]
        Ts_b_a = invert(self.fixed.Ts_body_shape[j]) @ Ts[:, i]
        deep = [overlap(a, b, np.ascontiguousarray(T)) > allowed for T in Ts_b_a]
        return int(np.argmax(deep))

    def _at(self, value: float, goal: float) -> str:
        """Say where on its way the part is."""
        start, joint = self.part.start, self.part.joint
        if joint is None:
            return f"when lifted by {value:.2f} of {goal:.2f} m"
        if joint.kind == "prismatic":
            return f"at {value:.2f} m on its way from {start:.2f} to {goal:.2f} m"
        v, a, b = (round(math.degrees(x)) for x in (value, start, goal))
        return f"at {v} deg on its way from {a} to {b} deg"


def part_sweep_check(
    part: MovedPart, fixed: Shapes, own: Bool[np.ndarray, " k"], limits: Limits
) -> PartSweepCheck:
    """Find out what a part touches in the scene.

    Args:
        part: What is moved.
        fixed: All else, in world coordinates.
        own: Which of it belongs to the same object.
        limits: How deep things may overlap, and how much deeper than in the scene.
    """
    pairs = all_pairs(len(part.shapes), len(fixed))
    Ts_fixed = fixed.Ts_body_shape[None]

    def depths(value: float, pairs: Int[np.ndarray, "p 2"], floor: float) -> tuple[np.ndarray, ...]:
        Ts = part.placed(np.array([value]))
        return deepest(part.shapes, Ts, fixed, Ts_fixed, pairs, floor)

    ours = np.flatnonzero(own[pairs[:, 1]])
    _, state = depths(part.rest, pairs[ours], BEARING)
    pairs = np.delete(pairs, ours[state >= 0], axis=0)
    floor = limits.penetration - limits.deeper
    depth, _ = depths(part.start, pairs, floor)
    return PartSweepCheck(part, fixed, pairs, depth - floor, limits)
