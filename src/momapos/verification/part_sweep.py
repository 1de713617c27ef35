"""Check the path of the moved part through the scene, independently of the robot.

Real scenes are imprecise: doors are flush with their neighbors, drawers touch their frames, an
object leans on a front. So the scene as given is the reference, and the part must not overlap
anything more deeply than there, nor extend deeper below the floor. Elements of the part's own
object that touch the closed part are its bearing and are ignored.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import invert

from .convex import overlap
from .exact_shapes import Shapes
from .floor_contact import floor_contact
from .moved_part import MovedPart, OwnElements
from .report import Limits
from .sweep import all_pairs, deepest

if TYPE_CHECKING:
    from jaxtyping import Float, Int

BEARING_DEPTH = -1e-3
"""Overlap from which an element of the same object touches the closed part: 1 mm apart [m]."""


@dataclass(frozen=True, eq=False)
class PartSweepCheck:
    """A part, its obstacles, and the allowed overlap of each pair of their shapes."""

    part: MovedPart
    fixed: Shapes
    pairs: Int[np.ndarray, "p 2"]
    """Indices into the shapes of the part and of the obstacles."""
    already: Float[np.ndarray, " p"]
    """Overlap of each pair to subtract, as the given scene has it [m]."""
    limits: Limits

    def first_hit(self, goal: float) -> str | None:
        """Return the first collision of the part on the path to a joint value (or a lift).

        Args:
            goal: Joint value [rad] or [m]; without a joint, the height of the lift [m].

        Returns:
            A description; None if the path is free.
        """
        span = goal - self.part.start
        count = max(2, math.ceil(abs(span) / self.limits.step) + 1)
        values = np.linspace(self.part.start, goal, count)
        Ts = self.part.placed(values, self.part.turned(count))
        Ts_fixed = self.fixed.Ts_body_shape
        limit = self.limits.penetration
        depth, _ = deepest(
            self.part.shapes, Ts, self.fixed, Ts_fixed[None], self.pairs, min(0.0, limit)
        )
        deep = np.flatnonzero(depth - self.already > limit)
        hits = [(self._first_state(p, Ts), p) for p in deep.tolist()]
        state, p = min(hits, default=(count - 1, -1))
        contact = floor_contact(self.part, float(values[state]), self.limits.step)
        if contact is not None:
            value, name = contact
            return f"{name} meets the floor {self._at(value, goal)}"
        if not hits:
            return None
        i, j = self.pairs[p]
        names = f"{self.part.shapes.names[i]} hits {self.fixed.names[j]}"
        return f"{names} {self._at(float(values[state]), goal)}"

    def _first_state(self, pair: int, Ts: Float[np.ndarray, "s k 4 4"]) -> int:
        """Return the first state at which a pair overlaps too deeply; there must be one."""
        i, j = self.pairs[pair].tolist()
        a, b = self.part.shapes.core(i), self.fixed.core(j)
        allowed = self.limits.penetration + self.already[pair]
        Ts_b_a = invert(self.fixed.Ts_body_shape[j]) @ Ts[:, i]
        deep = [overlap(a, b, np.ascontiguousarray(T)) > allowed for T in Ts_b_a]
        return int(np.argmax(deep))

    def _at(self, value: float, goal: float) -> str:
        start, joint = self.part.start, self.part.joint
        if joint is None:
            return f"when lifted by {value:.2f} of {goal:.2f} m"
        if joint.kind == "prismatic":
            return f"at {value:.2f} m, moving from {start:.2f} to {goal:.2f} m"
        v, a, b = (round(math.degrees(x)) for x in (value, start, goal))
        return f"at {v} deg, moving from {a} to {b} deg"


def part_sweep_check(
    part: MovedPart, fixed: Shapes, own: OwnElements, limits: Limits
) -> PartSweepCheck:
    """Find which shapes the part touches in the given scene.

    Args:
        part: The moved part.
        fixed: All other shapes, in world coordinates.
        own: The elements of the same object. A hollow one is a bearing if its hull touches the
            part, whose meshes are hulls, too.
        limits: Allowed overlap, also relative to the given scene.
    """
    pairs = all_pairs(len(part.shapes), len(fixed))

    def depths(
        value: float, others: Shapes, pairs: Int[np.ndarray, "p 2"], floor: float
    ) -> tuple[np.ndarray, ...]:
        Ts = part.placed(np.array([value]))
        return deepest(part.shapes, Ts, others, others.Ts_body_shape[None], pairs, floor)

    ours = all_pairs(len(part.shapes), len(own.hulls))
    _, state = depths(part.rest, own.hulls, ours, BEARING_DEPTH)
    bearing = np.zeros((len(part.shapes), len(own.hulls) + 1), bool)  # last: of other objects
    bearing[tuple(ours[state >= 0].T)] = True
    pairs = pairs[~bearing[pairs[:, 0], own.of_obstacle[pairs[:, 1]]]]
    floor = limits.penetration - limits.deeper
    depth, _ = depths(part.start, fixed, pairs, floor)
    return PartSweepCheck(part, fixed, pairs, depth - floor, limits)
