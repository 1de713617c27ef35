"""Relabel objects by the user's labels and by the votes of the images that show them.

A detection in an image votes for an object if it contains the object's visible points and overlaps
its rectangle. Both are required, since rectangles also contain what is in front of and behind it.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import InputError, unknown_name
from momapos.core.geometry import apply, invert
from momapos.model.records import UNKNOWN, Cloud, Detection, Frame, ImageDetection

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int


LONGEST_EDGE: Mapping[str, tuple[float, float]] = {
    "apple": (0.04, 0.15), "backpack": (0.2, 0.8), "banana": (0.08, 0.3), "bed": (0.8, 3.0),
    "bench": (0.5, 4.0), "book": (0.1, 0.6), "bottle": (0.08, 0.5), "bowl": (0.06, 0.5),
    "cell phone": (0.06, 0.25), "chair": (0.2, 1.5), "clock": (0.06, 1.2), "couch": (0.6, 4.0),
    "cup": (0.04, 0.25), "fork": (0.08, 0.35), "fridge": (0.4, 2.5), "handbag": (0.12, 0.7),
    "keyboard": (0.2, 0.6), "knife": (0.08, 0.5), "laptop": (0.18, 0.6), "microwave": (0.25, 0.9),
    "mouse": (0.05, 0.2), "orange": (0.04, 0.15), "oven": (0.3, 2.3), "plant": (0.08, 2.5),
    "remote": (0.06, 0.35), "scissors": (0.06, 0.35), "screen": (0.15, 2.5), "sink": (0.2, 1.5),
    "spoon": (0.08, 0.4), "suitcase": (0.3, 1.2), "table": (0.35, 5.0), "toaster": (0.15, 0.6),
    "toilet": (0.3, 1.2), "umbrella": (0.15, 1.5), "vase": (0.06, 0.8), "wine glass": (0.08, 0.35),
}  # fmt: skip
"""Range of the longest edge of an object, also if seen in part [m]: a small network takes a lunch
box on a table for a cell phone."""


Votes = dict[str, dict[str, float]]
"""Weights in [0, 1] of one object, by label and image name; one per image."""
MIN_PIXELS = 20.0
"""Minimum size of an object in an image [px]."""
SAMPLED_POINTS = 400
"""Number of points of an object that are projected into every image [-]."""
DEPTH_TOLERANCE = 0.03
"""Depth agrees with a point within this plus 2 % of its distance [m]."""
MIN_SHOWN = 0.2
"""Minimum share of an object's points that an image shows [-]."""
MIN_INSIDE = 0.5
"""Minimum share of an object's visible points in a detection [-]."""
MIN_OVERLAP = 0.25
"""Minimum IoU of a detection and the object's rectangle [-]."""
BLUR = 0.01
"""Rectangles are widened by this share of the image's width: color and depth of many sensors are a
few pixels off [-]."""
MIN_HITS = 2
"""Minimum number of images that give the label [-]."""
MIN_CONFIDENCE = 0.35
"""Minimum confidence of a label [-]."""
MAX_MISSES = 5
"""After this many images without a detection, an object is none that the detector knows [-]."""


@dataclass(frozen=True)
class Verdict:
    """Result of the votes for one object."""

    label: str
    """"" without agreement."""
    confidence: float
    """Confidence of the label, in [0, 1]."""
    hits: int
    """Number of images that gave it [-]."""
    seen: int
    """Number of images that show the object [-]."""


@dataclass(frozen=True, eq=False)
class _Samples:
    """Some points of all objects."""

    points: Float[np.ndarray, "n 3"]
    owner: Int[np.ndarray, " n"]
    count: Int[np.ndarray, " objects"]


def vote(
    objects: Sequence[Detection],
    cloud: Cloud,
    frames: Sequence[Frame],
    found: Mapping[str, Sequence[ImageDetection]],
) -> list[Verdict]:
    """Count the votes of all images for each object.

    Args:
        objects: Objects with members in the cloud; those without are in no image.
        cloud: In the world of the frames.
        frames: The examined images.
        found: 2-D detections by frame name.
    """
    samples = _sampled(objects, cloud, SAMPLED_POINTS)
    votes: list[Votes] = [{} for _ in objects]
    seen = np.zeros(len(objects), int)
    if len(samples.points):
        longest = np.array([item.box.size.max() for item in objects])
        for frame in frames:
            _count(frame, found.get(frame.name, ()), samples, longest, votes, seen)
    return [_verdict(weights, int(n)) for weights, n in zip(votes, seen, strict=True)]


def _count(
    frame: Frame,
    found: Sequence[ImageDetection],
    samples: _Samples,
    longest: Float[np.ndarray, " objects"],
    votes: list[Votes],
    seen: Int[np.ndarray, " objects"],
) -> None:
    pixels, visible = visible_points(frame, samples.points, DEPTH_TOLERANCE)
    owner, at = samples.owner[visible], pixels[visible]
    number = np.bincount(owner, minlength=len(samples.count))
    low, high = np.full((len(number), 2), np.inf), np.full((len(number), 2), -np.inf)
    np.minimum.at(low, owner, at)
    np.maximum.at(high, owner, at)
    shown = (number >= 8) & (number >= MIN_SHOWN * samples.count)
    shown &= (high - low).max(axis=1) >= MIN_PIXELS
    seen += shown
    if not found or not shown.any():
        return
    margin = BLUR * frame.color.shape[1]
    low, high = low - margin, high + margin
    for item in found:
        first, last = np.array(item.box[:2]) - margin, np.array(item.box[2:]) + margin
        held = ((at >= first) & (at <= last)).all(axis=1)
        inside = np.bincount(owner[held], minlength=len(number)) / np.maximum(number, 1)
        both = np.prod(np.maximum(np.minimum(high, last) - np.maximum(low, first), 0), axis=1)
        alike = both / (np.prod(high - low, axis=1) + np.prod(last - first) - both)
        least, most = LONGEST_EDGE.get(item.label, (0.0, np.inf))
        fits = shown & (inside >= MIN_INSIDE) & (alike >= MIN_OVERLAP)
        fits &= (longest >= least) & (longest <= most)
        for k in np.flatnonzero(fits).tolist() if item.label else ():
            weight = float(item.score * inside[k] * alike[k])
            of_label = votes[k].setdefault(item.label, {})
            of_label[frame.name] = max(weight, of_label.get(frame.name, 0.0))


def _verdict(votes: Votes, seen: int) -> Verdict:
    """Return the label with most votes, if enough images agree on it.

    Each vote is the probability that it is right, and votes for other labels are doubt.
    """
    if not votes:
        return Verdict("", 0.0, 0, seen)
    total = {label: sum(weights.values()) for label, weights in votes.items()}
    best = max(sorted(total), key=lambda label: total[label])
    wrong = float(np.prod([1.0 - weight for weight in votes[best].values()]))
    confidence = (1.0 - wrong) * total[best] / sum(total.values())
    if len(votes[best]) < MIN_HITS or confidence < MIN_CONFIDENCE:
        return Verdict("", 0.0, 0, seen)
    return Verdict(best, confidence, len(votes[best]), seen)


def visible_points(
    frame: Frame, points: Float[np.ndarray, "n 3"], near: float
) -> tuple[Float[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]:
    """Project points into an image [px], and tell which of them it shows.

    A point is hidden if another depth was measured at its pixel. Pixels without depth, as on black
    and mirroring surfaces, may show it; an image without depth hides nothing.
    """
    local = apply(invert(frame.T_world_camera), points)
    before = local[:, 2] > 0.05
    distance = np.where(before, local[:, 2], 1.0)
    pixels = (local @ frame.intrinsics.T)[:, :2] / distance[:, None]
    height, width = frame.color.shape[:2]
    nearest = np.floor(pixels + 0.5)  # intrinsics count from the middle of the first pixel
    visible = before & (nearest >= 0).all(axis=1) & (nearest < [width, height]).all(axis=1)
    if frame.depth is not None:
        x, y = np.where(visible[:, None], nearest, 0).astype(int).T
        measured = frame.depth[y, x]
        agree = np.abs(measured - distance) < near + 0.02 * distance
        visible &= agree | (measured == 0)
    return pixels, visible


def _sampled(objects: Sequence[Detection], cloud: Cloud, most: int) -> _Samples:
    chosen = []
    for item in objects:
        members = np.asarray(item.members, int)
        keep = np.linspace(0, len(members) - 1, min(most, len(members))).astype(int)
        chosen.append(members[keep])
    count = np.array([len(members) for members in chosen], int)
    among = np.concatenate([np.zeros(0, int), *chosen])
    return _Samples(cloud.points[among], np.repeat(np.arange(len(objects)), count), count)


_LABEL = re.compile(r"[a-z][a-z ]{0,39}")


def relabeled(
    objects: Sequence[Detection],
    verdicts: Sequence[Verdict],
    known: frozenset[str],
) -> list[Detection]:
    """Relabel objects by the votes of the images.

    If the images agree on a label, it is used. A label by size loses confidence with each image
    that shows the object without a detection, if the detector knows that label; the best remaining
    guess by size is used.

    Args:
        objects: Objects with labels by segmenter and size.
        verdicts: Result of the votes for each.
        known: All labels that the detector knows.
    """
    return [
        _relabeled(item, verdict, known) for item, verdict in zip(objects, verdicts, strict=True)
    ]


def _relabeled(item: Detection, verdict: Verdict, known: frozenset[str]) -> Detection:
    if verdict.label:
        return replace(
            item, label=verdict.label, score=verdict.confidence, label_from="detector", guesses=()
        )
    if item.label_from != "size":
        return item
    doubt = max(0.0, 1.0 - verdict.seen / MAX_MISSES)
    label, least = UNKNOWN
    left = [(name, score * (doubt if name in known else 1.0)) for name, score in item.guesses]
    left = [(name, score) for name, score in left if score >= least]
    best, score = max(left, key=lambda pair: pair[1], default=(label, least))
    return replace(item, label=best, score=min(score, item.score), guesses=tuple(left))


def with_given_labels(objects: Sequence[Detection], labels: Mapping[str, str]) -> list[Detection]:
    """Relabel objects as the user says.

    Args:
        objects: Named objects.
        labels: The labels by name.

    Raises:
        UnknownNameError: No object has one of the names.
        InputError: A label is not valid.
    """
    names = [item.name for item in objects]
    for name, label in labels.items():
        if name not in names:
            raise unknown_name("object", name, names, "the scan")
        if not _LABEL.fullmatch(label):
            raise InputError(
                f"label {label!r:.60} of {name!r} must be up to 40 lowercase letters and spaces, "
                "as in 'wall cabinet'"
            )
    return [
        replace(item, label=labels[item.name], score=1.0, label_from="given", guesses=())
        if item.name in labels
        else item
        for item in objects
    ]


def parse_labels(texts: Sequence[str]) -> dict[str, str]:
    """Read OBJECT=LABEL texts.

    Raises:
        InputError: A text has another form, or an object is named twice.
    """
    pairs = []
    for text in texts:
        name, equals, label = text.partition("=")
        if not (equals and name and label):
            raise InputError(f"label {text!r:.80} must be OBJECT=LABEL, as in object_3=fridge")
        pairs.append((name, label))
    for (one, _), (other, _) in pairwise(sorted(pairs)):
        if one == other:
            raise InputError(f"label names {one!r} twice")
    return dict(pairs)
