"""The parts on a front that several images agree on.

What one image shows of a front depends on where it was taken: a seam or a knob is a pixel there
and none here, and the networks then take two drawers for one. Each image's parts are hypotheses;
those of different images that lie on each other are one, and what is kept is the set of parts, free
of overlaps, that explains most of what was seen in all of them. A part with the handle of another
one in it explains the less, the more images show that handle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.records import Part, PartKind

from .placed_parts import shared
from .projection import area, common_area, overlap

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

SAME = 0.6
"""Parts of two images that overlap by this much are one (IoU) [-]."""
APART = 0.3
"""Two parts of a front share less than this of the smaller one [-]."""
LEAST = 0.12
"""Mean score over all images from which on there is a part, 0 where one shows none [-]."""
HELD = 0.5
"""A handle is within a part by more than this share of it [-]."""
UNSEEN = 0.01
"""How probable a kind is where an image says nothing of it [-]."""


Voices = dict[int, Part]
"""One part as several images show it, by their indices; the surest first."""


def agreed(fronts: Sequence[Sequence[Part]]) -> tuple[Part, ...]:
    """The parts that images of one face agree on, the surest first.

    Args:
        fronts: What each image shows, as fractions of the face; the best image first.
    """
    voices = _voices(fronts)
    support = np.array([sum(p.score for p in v.values()) / len(fronts) for v in voices])
    voices = [voice for voice, share in zip(voices, support, strict=True) if share >= LEAST]
    joined = [_joined(voice) for voice in voices]
    weights = support[support >= LEAST] * [area(part.box) for part in joined]
    weights *= [1.0 - _unexplained(*pair, fronts) for pair in zip(joined, voices, strict=True)]
    apart = np.array([[shared(a, b) < APART for b in joined] for a in joined], bool)
    apart = apart.reshape(len(joined), len(joined))
    kept = [joined[k] for k in _heaviest(weights, apart)]
    return tuple(sorted(kept, key=lambda part: -part.score))


def _voices(fronts: Sequence[Sequence[Part]]) -> list[Voices]:
    """Parts that lie on each other in different images, the surest first."""
    every = sorted(
        ((part, image) for image, parts in enumerate(fronts) for part in parts),
        key=lambda pair: -pair[0].score,
    )
    found: list[Voices] = []
    for part, image in every:
        free = [(overlap(next(iter(v.values())).box, part.box), v) for v in found if image not in v]
        common, voice = max(free, key=lambda pair: pair[0], default=(0.0, {}))
        if common < SAME:
            voice = {}
            found.append(voice)
        voice[image] = part
    return found


def _unexplained(part: Part, voices: Voices, fronts: Sequence[Sequence[Part]]) -> float:
    """Share of the images that show the handle of another part within a part [-].

    Only of parts that cannot be there beside it: the handles of neighbors are explained by these.
    """
    own = [v.handle for v in voices.values() if v.handle is not None]
    shows = [
        any(
            other.handle is not None
            and shared(part, other) >= APART
            and common_area(part.box, other.handle) > HELD * area(other.handle)
            and all(not common_area(other.handle, one) for one in own)
            for other in parts
        )
        for parts in fronts
    ]
    return sum(shows) / len(fronts)


def _heaviest(weights: Float[np.ndarray, " n"], apart: Bool[np.ndarray, "n n"]) -> list[int]:
    """Indices of the heaviest set of parts that are all apart."""
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


def _joined(voices: Voices) -> Part:
    """One part of what several images say of it."""
    parts = list(voices.values())
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
    """How a part may open: the geometric mean of what the images say, the surer the more."""
    known = [(dict(p.odds), s) for p, s in zip(parts, scores, strict=True) if p.odds]
    if not known:
        return ()
    kinds = list(known[0][0])
    rows = [[np.log(max(odds.get(kind, 0.0), UNSEEN)) for kind in kinds] for odds, _ in known]
    mean = np.exp(np.average(np.array(rows), axis=0, weights=[s for _, s in known]))
    pairs = zip(kinds, (mean / mean.sum()).tolist(), strict=True)
    return tuple(sorted(pairs, key=lambda pair: -pair[1]))
