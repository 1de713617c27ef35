"""Parts that several looks at one front show: which of them are one, and how they may open."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from momapos.types import Front, Part
from momapos.views.projection import area, common_area, overlap

SHARED = 0.5
"""Of two parts that share this much of the smaller one, one is left out [-]."""
SAME = 0.75
"""Two looks show one part where it overlaps by this (IoU): one that takes two drawers for one part
says nothing of either [-]."""
LEAST = 1e-3
"""One look alone makes no kind of part less probable than this [-]."""


def agreed(fronts: Sequence[Front]) -> Front:
    """The first of several looks at a face, how its parts may open weighed by all looks.

    Looks err alike where a front is misleading, and differ in noise and light: so the mean of what
    they say counts, by the logarithm, not the product.

    Args:
        fronts: What images of one face show, the best first.
    """
    first, *others = fronts
    parts = tuple(_weighed(part, [other.parts for other in others]) for part in first.parts)
    return replace(first, parts=parts)


def doubtful(front: Front, sure: float) -> bool:
    """Whether how any part opens is less probable than it should be."""
    return any(part.odds[0][1] < sure for part in front.parts if part.odds)


def surest(parts: Sequence[Part]) -> tuple[Part, ...]:
    """The surest of parts that were seen twice, as one or as two, the surest first.

    How each may open is the mean of what all looks at it say, as in `agreed`.
    """
    kept: list[Part] = []
    for part in sorted(parts, key=lambda p: -p.score):
        if all(_shared(part, other) < SHARED for other in kept):
            kept.append(part)
    return tuple(_weighed(part, [(one,) for one in parts if one is not part]) for part in kept)


def _weighed(part: Part, looks: Sequence[Sequence[Part]]) -> Part:
    """A part, with the mean of the odds that all looks which show it give it."""
    seen = [part]
    for parts in looks:
        best = max(parts, key=lambda other: overlap(part.box, other.box), default=None)
        if best is not None and overlap(part.box, best.box) >= SAME:
            seen.append(best)
    odds = [dict(one.odds) for one in seen if one.odds]
    if len(odds) < 2 or not part.odds:
        return part
    kinds = [kind for kind, _ in part.odds]
    logs = np.log([[max(each.get(kind, 0.0), LEAST) for kind in kinds] for each in odds]).mean(0)
    share = np.exp(logs - logs.max())
    ranked = sorted(zip(kinds, (share / share.sum()).tolist(), strict=True), key=lambda o: -o[1])
    return replace(part, kind=ranked[0][0], odds=tuple(ranked))


def _shared(a: Part, b: Part) -> float:
    """Common area of two parts, as a share of the smaller [-]."""
    least = min(area(a.box), area(b.box))
    return common_area(a.box, b.box) / least if least > 0 else 1.0
