"""Collect overlapping pairs of bodies, and turn them into a check."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from .exact_shapes import Shapes
from .report import Check, at_most
from .sweep import deepest

if TYPE_CHECKING:
    from jaxtyping import Float, Int

MAX_NAMED_PAIRS = 6
"""Largest number of overlapping pairs that a check lists [-]."""


class Overlaps:
    """Collects overlapping pairs of links, each with its deepest overlap."""

    def __init__(self, limit: float) -> None:
        self.limit = limit
        self.worst: dict[tuple[str, str], tuple[float, str]] = {}

    def add(
        self,
        a: Shapes,
        Ts_a: Float[np.ndarray, "s a 4 4"],
        b: Shapes,
        Ts_b: Float[np.ndarray, "#s b 4 4"],
        pairs: Int[np.ndarray, "p 2"],
        where: Callable[[int], str],
        *,
        swapped: bool = False,
        already: Float[np.ndarray, " p"] | float = 0.0,
    ) -> None:
        """Add pairs of shapes; overlap counts beyond `already` [m]."""
        depth, state = deepest(a, Ts_a, b, Ts_b, pairs, min(0.0, self.limit))
        self.collect(a, b, pairs, depth - already, state, where, swapped=swapped)

    def collect(
        self,
        a: Shapes,
        b: Shapes,
        pairs: Int[np.ndarray, "p 2"],
        depth: Float[np.ndarray, " p"],
        state: Int[np.ndarray, " p"],
        where: Callable[[int], str],
        *,
        swapped: bool = False,
    ) -> None:
        """Add pairs of shapes by their deepest overlap [m] and its state, see `deepest`."""
        for p in np.flatnonzero(state >= 0):
            names = (a.names[pairs[p, 0]], b.names[pairs[p, 1]])
            names = names[::-1] if swapped else names
            if depth[p] > self.worst.get(names, (-np.inf, ""))[0]:
                self.worst[names] = (float(depth[p]), where(int(state[p])))

    def check(self, name: str) -> Check:
        ranked = sorted(self.worst.items(), key=lambda item: -item[1][0])
        deep = ranked[0][1][0] if ranked else min(0.0, self.limit)
        bad = [(names, d, at) for names, (d, at) in ranked if d > self.limit]
        words = [
            f"{a} and {b} overlap by {1000 * d:.0f} mm at {at}"
            for (a, b), d, at in bad[:MAX_NAMED_PAIRS]
        ]
        more = (
            [f"and {len(bad) - MAX_NAMED_PAIRS} more pairs"] if len(bad) > MAX_NAMED_PAIRS else []
        )
        culprit = " and ".join(bad[0][0]) if bad else ""
        return at_most(
            name, 1000 * deep, 1000 * self.limit, "mm deep", "; ".join(words + more), culprit
        )
