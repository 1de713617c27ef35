"""Merge the parts that several images show on a front.

How one image shows a front depends on its viewpoint: a seam or a knob may be a pixel wide in one
image and invisible in another, and the networks then merge two drawers into one. The parts in each
image are hypotheses; overlapping parts of different images become one hypothesis. The result is the
overlap-free set of parts with the largest total weight. A part's weight drops with the number of
images that show the handle of another part inside it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.records import Part, PartKind

from .placed_parts import overlap_share
from .projection import area, common_area, overlap

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

MIN_SAME_IOU = 0.6
"""Parts of two images with at least this IoU are the same part [-]."""
MAX_OVERLAP = 0.3
"""Two parts of a front share less than this of the smaller one [-]."""
MIN_SUPPORT = 0.12
"""Parts with a lower mean score over all images are dropped; a missing part scores 0 [-]."""
MIN_HANDLE_INSIDE = 0.5
"""A handle is inside a part if more than this share of it is [-]."""
UNSEEN = 0.01
"""Probability of a part kind that an image does not name [-]."""


Hypothesis = dict[int, Part]
"""One part as several images show it, by image index; the most confident first."""


def consensus(fronts: Sequence[Sequence[Part]]) -> tuple[Part, ...]:
    """Return the parts that images of one face agree on, the most confident first.

    Args:
        fronts: The parts in each image, as fractions of the face; the best image first.
    """
    hypotheses = _hypotheses(fronts)
    support = np.array([sum(p.score for p in v.values()) / len(fronts) for v in hypotheses])
    hypotheses = [
        hypothesis
        for hypothesis, share in zip(hypotheses, support, strict=True)
        if share >= MIN_SUPPORT
    ]
    merged = [_merged(hypothesis) for hypothesis in hypotheses]
    weights = support[support >= MIN_SUPPORT] * [area(part.box) for part in merged]
    weights *= [1.0 - _unexplained(*pair, fronts) for pair in zip(merged, hypotheses, strict=True)]
    apart = np.array([[overlap_share(a, b) < MAX_OVERLAP for b in merged] for a in merged], bool)
    apart = apart.reshape(len(merged), len(merged))
    kept = [merged[k] for k in _heaviest(weights, apart)]
    return tuple(sorted(kept, key=lambda part: -part.score))


def _hypotheses(fronts: Sequence[Sequence[Part]]) -> list[Hypothesis]:
    """Group overlapping parts of different images, the most confident first."""
    every = sorted(
        ((part, image) for image, parts in enumerate(fronts) for part in parts),
        key=lambda pair: -pair[0].score,
    )
    found: list[Hypothesis] = []
    for part, image in every:
        free = [(overlap(next(iter(v.values())).box, part.box), v) for v in found if image not in v]
        common, hypothesis = max(free, key=lambda pair: pair[0], default=(0.0, {}))
        if common < MIN_SAME_IOU:
            hypothesis = {}
            found.append(hypothesis)
        hypothesis[image] = part
    return found


def _unexplained(part: Part, hypotheses: Hypothesis, fronts: Sequence[Sequence[Part]]) -> float:
    """Return the share of images that show another part's handle inside a part [-].

    Neighbors do not count: only parts that cannot coexist with this one.
    """
    own = [v.handle for v in hypotheses.values() if v.handle is not None]
    shows = [
        any(
            other.handle is not None
            and overlap_share(part, other) >= MAX_OVERLAP
            and common_area(part.box, other.handle) > MIN_HANDLE_INSIDE * area(other.handle)
            and all(not common_area(other.handle, one) for one in own)
            for other in parts
        )
        for parts in fronts
    ]
    return sum(shows) / len(fronts)


def _heaviest(weights: Float[np.ndarray, " n"], apart: Bool[np.ndarray, "n n"]) -> list[int]:
    from scipy.optimize import Bounds, LinearConstraint, milp

    if not len(weights):
        return []
    pairs = np.argwhere(np.triu(~apart, k=1))
    rows = np.zeros((len(pairs), len(weights)))
    rows[np.arange(len(pairs))[:, None], pairs] = 1.0
    solved = milp(
        -weights,
        integrality=np.ones(len(weights)),
        bounds=Bounds(0.0, 1.0),
        constraints=[LinearConstraint(rows, ub=1.0)] if len(pairs) else (),
    )
    return np.flatnonzero(solved.x > 0.5).tolist()


def _merged(hypotheses: Hypothesis) -> Part:
    parts = list(hypotheses.values())
    scores = np.array([part.score for part in parts])
    box = np.median([part.box for part in parts], axis=0).tolist()
    odds = _odds(parts, scores)
    held = next((part.handle for part in parts if part.handle is not None), None)
    kind = odds[0][0] if odds else parts[0].kind
    left, top, right, bottom = box
    return replace(parts[0], kind=kind, box=(left, top, right, bottom), handle=held, odds=odds)


def _odds(
    parts: Sequence[Part], scores: Float[np.ndarray, " n"]
) -> tuple[tuple[PartKind, float], ...]:
    """Return the geometric mean of the images' kind probabilities, weighted by score."""
    known = [(dict(p.odds), s) for p, s in zip(parts, scores, strict=True) if p.odds]
    if not known:
        return ()
    kinds = list(known[0][0])
    rows = [[np.log(max(odds.get(kind, 0.0), UNSEEN)) for kind in kinds] for odds, _ in known]
    mean = np.exp(np.average(np.array(rows), axis=0, weights=[s for _, s in known]))
    pairs = zip(kinds, (mean / mean.sum()).tolist(), strict=True)
    return tuple(sorted(pairs, key=lambda pair: -pair[1]))
