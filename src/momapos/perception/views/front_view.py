"""Find the front face of an object, the image that shows it best, and the parts on it.

How one image shows a front depends on its viewpoint: a seam or a knob may be a pixel wide in one
image and invisible in another, and the networks then merge two drawers into one. The parts in each
image are hypotheses; overlapping parts of different images become one hypothesis. The result is the
overlap-free set of parts with the largest total weight. A part's weight drops with the number of
images that show the handle of another part inside it.

Points alone do not separate the cabinets of a row: fronts lie in one plane, and the gaps between
them are thinner than a depth camera resolves. A row can be cut wherever no door crosses.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Literal

import numpy as np

from momapos.core.geometry import UprightBox, apply, dark_lines
from momapos.model.records import FaceImage, Frame, Front, Part, PartKind

from .faces import (
    FACES,
    Face,
    SampledFace,
    box_faces,
    camera_position_of,
    coplanar_share,
    face_image,
    visible_share,
)
from .placed_parts import (
    Observation,
    area,
    common_area,
    most_confident,
    overlap,
    overlap_share,
    projection,
    shift_handles,
    transferred,
)

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Float32


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


DOORS = ("door_left", "door_right")
MAX_LEVEL_DIFFERENCE = 0.05
"""Tops and bottoms of doors in one row differ by less than this share of the face's height [-]."""
MAX_GAP = 0.4
"""Doors in a row overlap or are apart by less than this share of the narrower one [-]."""
SEARCH_RADIUS = 0.02
"""Seams are searched for this far from their predicted place [m]."""
RIM = 0.04
"""A door that starts closer to the rim of its face starts at the rim, unless a seam is visible
[m]."""
MIN_CONTRAST = 0.05
"""Contrast of a visible seam in `dark_lines` [-]."""
MAX_WIDTH_CHANGE = 0.3
"""No door changes its width by more than this share [-]."""


def equalize_doors(face: FaceImage, parts: Sequence[Part]) -> tuple[Part, ...]:
    """Divide rows of doors evenly between the visible seams.

    Args:
        face: The face.
        parts: All parts on it.

    Returns:
        The same parts in the same order. Only doors that meet without a visible seam change.
    """
    found, rows = list(parts), _rows(parts)
    upright = dark_lines(face.color, 1) if rows else np.zeros((0, 0), np.float32)
    for row in rows:
        doors = [parts[k] for k in row]
        edges = _edges(face, doors, upright)
        even = np.interp(np.arange(len(doors) + 1), list(edges), list(edges.values())).tolist()
        made = [_between(door, *span) for door, span in zip(doors, pairwise(even), strict=True)]
        if None not in made:
            for k, door in zip(row, made, strict=True):
                found[k] = door or found[k]
    return tuple(found)


def _rows(parts: Sequence[Part]) -> list[list[int]]:
    """Return the indices of the doors of each row, from left to right."""
    rows: list[list[int]] = []
    for k in sorted(range(len(parts)), key=lambda k: parts[k].box[0]):
        if parts[k].kind not in DOORS:
            continue
        for row in rows:
            if _side_by_side(parts[row[-1]], parts[k]):
                row.append(k)
                break
        else:
            rows.append([k])
    return [row for row in rows if len(row) > 1]


def _side_by_side(a: Part, b: Part) -> bool:
    level = max(abs(a.box[1] - b.box[1]), abs(a.box[3] - b.box[3])) < MAX_LEVEL_DIFFERENCE
    return level and abs(b.box[0] - a.box[2]) < MAX_GAP * min(_width(a), _width(b))


def _edges(
    face: FaceImage, doors: Sequence[Part], upright: Float32[np.ndarray, "h w"]
) -> dict[int, float]:
    """Return the visible seams of a row, and its start and end, by index.

    Without a visible seam, a door near the rim extends to the rim.
    """
    first, last = doors[0].box, doors[-1].box
    rim = RIM / face.width
    edges = [_seam(face, (a, b), (a.box[2], b.box[0]), upright) for a, b in pairwise(doors)]
    start, end = (
        _seam(face, (door, door), (edge, edge), upright)
        for door, edge in ((doors[0], first[0]), (doors[-1], last[2]))
    )
    begins = 0.0 if start is None and first[0] < rim else first[0]
    ends = 1.0 if end is None and last[2] > 1.0 - rim else last[2]
    known = [(0, begins), *enumerate(edges, start=1), (len(doors), ends)]
    return {k: edge for k, edge in known if edge is not None}


def _seam(
    face: FaceImage,
    doors: tuple[Part, Part],
    about: tuple[float, float],
    upright: Float32[np.ndarray, "h w"],
) -> float | None:
    """Find a line near two places over most of the height of two doors; None if there is none."""
    h, w = upright.shape
    near = SEARCH_RADIUS / face.width
    left, right = min(about) - near, max(about) + near
    start = max(int(left * w), 0)
    tops, bottoms = zip(*((door.box[1], door.box[3]) for door in doors), strict=True)
    rows = slice(int(max(tops) * h), int(min(bottoms) * h))
    lines = upright[rows, start : int(np.ceil(right * w)) + 1]
    if not lines.size:
        return None
    contrast = np.median(lines, axis=0)
    place = (start + int(contrast.argmax()) + 0.5) / w
    return place if contrast.max() > MIN_CONTRAST else None


def _between(door: Part, left: float, right: float) -> Part | None:
    """Return a door with other sides; None if it changes too much or loses its handle."""
    handle = door.handle
    off = abs((right - left) / max(_width(door), 1e-9) - 1.0)
    if off > MAX_WIDTH_CHANGE or (
        handle is not None and not left <= (handle[0] + handle[2]) / 2 <= right
    ):
        return None
    return replace(door, box=(left, door.box[1], right, door.box[3]))


def _width(part: Part) -> float:
    return part.box[2] - part.box[0]


ViewMethod = Literal["voting", "first"]
SURROUNDINGS = (0.03, 0.1)
"""Width of the surroundings shown with a face; the second if the first shows no front [m]."""
FRONTAL_POWER = 10
"""Power of the cosine of the viewing angle by which images are weighted [-]."""
MIN_DISTANCE = 0.5
"""Closer images are not better [m]."""
UNBACKED_WEIGHT = 0.5
"""Weight of a face without a wall behind the object, if another face has one: objects at a wall
open away from it [-]."""
FrontDetector = Callable[[FaceImage], Front]
"""Finds the parts on a face, and whether it is a front."""


@dataclass(frozen=True, eq=False)
class KnownFront:
    """Parts that are already known, on a face that may contain the object's own."""

    face: Face
    score: float
    """Probability that the face is a front where it has parts."""
    parts: tuple[Part, ...]
    """In fractions of that face; handles are at their true place."""


MIN_AGREEING = 4
"""Number of images whose parts are merged on the front [-]."""
MAX_OBLIQUENESS = 45.0
"""Used instead of `frontal` if no image lies within it [deg]."""
MAX_FRONTAL_ANGLE = 30.0
"""Images farther than this from a face's normal are ignored [deg]."""
MIN_FRONT_PROBABILITY = 0.5
"""A face is a front from this probability on [-]."""
MIN_FLAT = 0.3
"""Share of a front that must be coplanar; half of a desk is leg space [-]."""
MIN_SHOWN = 0.55
"""Share of a face that an image must show [-]."""
VOTES = 2
"""Number of images that vote for a face [-]."""
MIN_PARTLY_SHOWN = 0.15
"""Images that show less of a face are not merged into its height map [-]."""
MAX_MERGED = 12
"""Number of images whose depth is merged into the height map of a face [-]."""
MAX_SURROUNDINGS = 3
"""Number of images in which the borders of parts are examined [-]."""
MAX_EXAMINED = 32
"""Number of images of a face that are examined, the most promising first [-]."""


@dataclass(frozen=True, eq=False)
class FaceSurroundings:
    """A face with its surroundings, in the colors of several images."""

    face: Face
    """The enlarged face."""
    images: tuple[FaceImage, ...]
    """The best first."""


@dataclass(frozen=True, eq=False)
class FrontView:
    """The front of an object in its best image."""

    face: Face
    frame: int
    """Index of the image."""
    angle: float
    """Angle between the line of sight and the face's normal [rad]."""
    image: FaceImage
    front: Front
    surroundings: FaceSurroundings
    """The face with its surroundings in the best images."""
    evidence: tuple[float, ...]
    """Mean vote for each face: the mean of its appearance score and handle evidence, times
    its coplanar share, lower if another side has a wall behind it. Voting stops as soon as the
    winner is certain. NaN for faces without a vote."""


def choose_view(
    box: UprightBox,
    frames: Sequence[Frame],
    seen: Sequence[Observation],
    look: FrontDetector,
    method: ViewMethod = "voting",
    known: Sequence[KnownFront] = (),
    backed: Sequence[bool] = (False,) * FACES,
    frontal: Mapping[str, float] | None = None,
) -> FrontView | None:
    """Find the front of a box (MoMa-Pos, III-B).

    As printed ("first"), images are tried from the most central one on. The first one that shows a
    face frontally, by the camera's pose and the front score, decides alone. With "voting", every
    image votes for the face that it shows, so the error of one image is outvoted.

    Args:
        box: The object.
        frames: All images.
        seen: The images that show it, most central first.
        look: Finds the parts on a face.
        method: Vote of all images for each face, or the first image that passes, as in the paper.
        known: Fronts of rows that the box may be a piece of (voting).
        backed: Whether the side opposite to each face stands against a wall (voting).
        frontal: Scores of a frontal classifier by frame, in place of pose and front score (first);
            a frame without a score is not frontal.

    Returns:
        The front; None if no image shows one.
    """
    if method == "first":
        return _first(box, frames, seen, look, frontal)
    return _voting(box, frames, seen, look, known, backed)


def _first(
    box: UprightBox,
    frames: Sequence[Frame],
    seen: Sequence[Observation],
    look: FrontDetector,
    frontal: Mapping[str, float] | None,
) -> FrontView | None:
    faces = box_faces(box)
    for sight in seen:
        cosines = np.array([cosines_to(face, [frames[sight.frame]])[0] for face in faces])
        face, frame = faces[int(np.argmax(cosines))], frames[sight.frame]
        if frontal is not None:
            if frontal.get(frame.name, 0.0) < MIN_FRONT_PROBABILITY:
                continue
        elif (
            cosines.max() < np.cos(np.radians(MAX_FRONTAL_ANGLE))
            or visible_share(face, frame) < MIN_SHOWN
        ):
            continue
        image = face_image(face, [frame])
        views = FaceViews(face, [frame], [0])
        front = views.look(0, look, MIN_FRONT_PROBABILITY)
        if frontal is not None or front_evidence(front, image) >= MIN_FRONT_PROBABILITY:
            angle = float(np.arccos(min(1.0, cosines.max())))
            around = views.surroundings([0])
            return FrontView(face, sight.frame, angle, image, front, around, ())
    return None


def _voting(
    box: UprightBox,
    frames: Sequence[Frame],
    seen: Sequence[Observation],
    look: FrontDetector,
    known: Sequence[KnownFront],
    backed: Sequence[bool],
) -> FrontView | None:
    indices = np.array([sight.frame for sight in seen], int)
    if not len(indices):
        return None
    evidence = [float("nan")] * FACES
    best: tuple[float, FaceViews, list[int], FaceImage, list[Front]] | None = None
    worth = [1.0 if behind or not any(backed) else UNBACKED_WEIGHT for behind in backed]
    for face in sorted(box_faces(box), key=lambda face: -worth[face.index]):
        order, partly = choose_frames(face, frames, indices)
        if not order:
            continue
        merged = [*order, *partly][:MAX_MERGED]
        views = FaceViews(face, frames, merged)
        image = face_image(face, [frames[i] for i in merged])
        flat = coplanar_share(image)
        if flat < MIN_FLAT:  # open, like the side of a table
            evidence[face.index] = 0.0
            continue
        asked, least = order[:VOTES], best[0] if best is not None else -1.0
        own: list[Front] = []
        doors: list[float] = []
        looks: list[float] = []
        # Faces compete by appearance and handles together; doors alone do not win. Otherwise a
        # side of a fridge with a seam and a shadow on it passes for the front.
        most = worth[face.index] * (flat + 1.0) / 2
        for i in asked:
            if most * (len(asked) - len(looks)) + sum(looks) <= least * len(asked):
                break
            own.append(views.look(i, look, MIN_FRONT_PROBABILITY))
            vote = _with_known(own[-1], face, frames[i], known)
            doors.append(front_evidence(vote, image))
            evident = (flat * vote.score + handle_evidence(vote, image)) / 2
            looks.append(worth[face.index] * evident)
        if not looks:
            continue
        rank = evidence[face.index] = float(np.mean(looks))
        if len(looks) == len(asked) and np.mean(doors) >= MIN_FRONT_PROBABILITY and rank > least:
            best = rank, views, order, image, own
    if best is None:
        return None
    _, views, order, image, own = best
    face, chosen = views.face, order[0]
    front = _merged_front(views, order[:MIN_AGREEING], look, MIN_FRONT_PROBABILITY, own)
    front = _with_known(front, face, frames[chosen], known)
    front = replace(front, parts=equalize_doors(image, front.parts))
    angle = float(np.arccos(min(1.0, cosines_to(face, [frames[chosen]])[0])))
    around = views.surroundings(order[:MAX_SURROUNDINGS])
    return FrontView(face, chosen, angle, image, front, around, tuple(evidence))


def _merged_front(
    views: FaceViews, chosen: Sequence[int], look: FrontDetector, least: float,
    own: Sequence[Front] = (),
) -> Front:  # fmt: skip
    """Merge what several images show of a face, with handles as in the first image.

    The score is the mean of all these images: it decides how much evidence the parts need, and that
    of one image depends on its viewpoint as its parts do.

    Args:
        views: The face.
        chosen: Indices of the images to examine, the best first.
        look: Finds the parts on a face.
        least: From this door evidence on, no wider surroundings are shown.
        own: Results for the first of the chosen images, if already known.
    """
    face = views.face
    fronts = [*own, *(views.look(i, look, least) for i in chosen[len(own) :])]
    cameras = [camera_position_of(face, views.frames[i]) for i in chosen]
    upright = [
        shift_handles(front.parts, face, camera, undo=True)
        for front, camera in zip(fronts, cameras, strict=True)
    ]
    parts = shift_handles(consensus(upright), face, cameras[0])
    return Front(float(np.mean([front.score for front in fronts])), parts)


def _with_known(front: Front, face: Face, frame: Frame, known: Sequence[KnownFront]) -> Front:
    """Add the known parts to a front.

    A door that fills its face shows no edges on it, but it does next to its neighbors.
    """
    for one in known:
        parts = transferred(one.parts, one.face, face)
        if parts:
            parts = shift_handles(parts, face, camera_position_of(face, frame))
            score = max(front.score, one.score)
            front = replace(front, score=score, parts=most_confident([*front.parts, *parts]))
    return front


def front_evidence(front: Front, image: FaceImage) -> float:
    """Return the probability of a door or drawer in the plane of a face, in [0, 1].

    The score of the face and of each part is weighted by its coplanar share: nothing opens between
    the legs of a table, but drawers open next to the leg space of a desk.

    Args:
        front: The parts on the face.
        image: The face with its height map.
    """
    looks = coplanar_share(image) * front.score
    return 1.0 - (1.0 - looks) * (1.0 - handle_evidence(front, image))


def door_evidence(front: Front) -> float:
    """Return the probability of a door or drawer on a face, in [0, 1].

    Apart from its handles a plain front looks like any panel, so each part with a handle is
    independent evidence.
    """
    return 1.0 - (1.0 - front.score) * (1.0 - handle_evidence(front))


def handle_evidence(front: Front, image: FaceImage | None = None) -> float:
    """Return the probability that any part with a handle is correct, in [0, 1].

    Args:
        front: The parts on a face.
        image: If given, each part is weighted by its coplanar share.
    """
    held = [part for part in front.parts if part.handle is not None]
    flat = [1.0 if image is None else coplanar_share(image, part.box) for part in held]
    return 1.0 - float(np.prod([1.0 - p.score * f for p, f in zip(held, flat, strict=True)]))


@dataclass(frozen=True, eq=False)
class FaceViews:
    """A face and its surroundings in several images."""

    face: Face
    frames: Sequence[Frame]
    merged: Sequence[int]
    """Indices of the images whose depth is merged, the best first."""
    _sampled: dict[float, SampledFace] = field(default_factory=dict)
    """By width of the surroundings [m]."""

    def look(self, chosen: int, look: FrontDetector, least: float) -> Front:
        """Find the parts in one image's colors, with the height map of all images.

        The edges of a door that fills its face show only against the surroundings. Parts that lie
        mostly outside the face belong to other objects.

        Args:
            chosen: Index of the image.
            look: Finds the parts on a face.
            least: From this door evidence on, no wider surroundings are shown.
        """
        fronts = []
        for around in SURROUNDINGS:
            sampled, order = self._around(around, chosen)
            front = look(sampled.image(order))
            fronts.append(replace(front, parts=transferred(front.parts, sampled.face, self.face)))
            if door_evidence(fronts[-1]) >= least:
                break
        return max(fronts, key=door_evidence)

    def surroundings(self, chosen: Sequence[int]) -> FaceSurroundings:
        """Return the face with its wider surroundings.

        Args:
            chosen: Indices of the images whose colors to show.
        """
        shown = [self._around(SURROUNDINGS[-1], index) for index in chosen]
        images = tuple(sampled.image(order) for sampled, order in shown)
        return FaceSurroundings(shown[0][0].face, images)

    def _around(self, around: float, chosen: int) -> tuple[SampledFace, list[int]]:
        """Return the face with its surroundings [m], and its frames with the chosen one first."""
        wide = replace(
            self.face, width=self.face.width + 2 * around, height=self.face.height + 2 * around
        )
        order = [chosen, *(i for i in self.merged if i != chosen)]
        if chosen not in self.merged:
            return SampledFace.of(wide, [self.frames[i] for i in order]), list(range(len(order)))
        if around not in self._sampled:
            self._sampled[around] = SampledFace.of(wide, [self.frames[i] for i in self.merged])
        places = {i: place for place, i in enumerate(self.merged)}
        return self._sampled[around], [places[i] for i in order]


def choose_frames(
    face: Face, frames: Sequence[Frame], indices: np.ndarray
) -> tuple[list[int], list[int]]:
    """Choose the images in which to examine a face.

    Frontal and close images are better: from across a room a handle is a few pixels wide, and depth
    noise exceeds its protrusion.

    Returns:
        Indices among the given ones of images that show the face well enough, and of images that
        show a piece of it; each the best first.
    """
    lines, cosines = _lines_to(face, [frames[i] for i in indices])
    clear = np.maximum(cosines, 0.0) ** FRONTAL_POWER / np.maximum(lines, MIN_DISTANCE) ** 2
    for most in (MAX_FRONTAL_ANGLE, MAX_OBLIQUENESS):
        good = np.flatnonzero(cosines >= np.cos(np.radians(most)))
        good = good[np.argsort(-clear[good], kind="stable")][:MAX_EXAMINED]
        parts = np.array([visible_share(face, frames[indices[i]]) for i in good])
        order = np.argsort(-(parts**2 * clear[good]), kind="stable")
        if (parts >= MIN_SHOWN).any():
            best, parts = indices[good[order]], parts[order]
            part_only = (parts >= MIN_PARTLY_SHOWN) & (parts < MIN_SHOWN)
            return best[parts >= MIN_SHOWN].tolist(), best[part_only].tolist()
    return [], []


def cosines_to(face: Face, frames: Sequence[Frame]) -> Float[np.ndarray, " n"]:
    """Return the cosine of the angle between the face's normal and the line to each camera."""
    return _lines_to(face, frames)[1]


def _lines_to(
    face: Face, frames: Sequence[Frame]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Return the distance from a face's middle to each camera [m], and the cosine to its normal."""
    cameras = np.array([frame.T_world_camera[:3, 3] for frame in frames]).reshape(-1, 3)
    lines = cameras - face.T_world_face[:3, 3]
    length = np.linalg.norm(lines, axis=1)
    return length, lines @ face.outward / length


COARSE_PIXELS = 96
"""Resolution at which a window is checked for flatness: a table is open [px]."""
MIN_PIECE = 0.2
"""A narrower stretch without parts belongs to its neighbor [m]."""
MIN_WIDTH = 0.95
"""Narrower boxes are not split [m]."""
MIN_WINDOW = 1.3
"""Minimum window width, since drawers of low rows are as wide as those of high ones [m]."""
WINDOW_RATIO = 1.5
"""Width of the windows in which a face is examined, in heights of the row [-]."""
END_MARGIN = 0.03
"""Parts that end this close to a window's end may continue beyond it [m]."""


def split_row(
    box: UprightBox,
    frames: Sequence[Frame],
    look: FrontDetector,
) -> tuple[list[UprightBox], KnownFront | None]:
    """Split a box between the fronts on its longer faces.

    Args:
        box: The row.
        frames: All images.
        look: Finds the parts on a face.

    Returns:
        The pieces from left to right as seen from the front, or the box itself if it is not split;
        and the front with its parts, None if there is none or if an image of the whole box shows it
        as well.
    """
    wide = [face for face in box_faces(box) if face.width >= MIN_WIDTH]
    fronts = [_front_of(face, frames, look) for face in wide]
    best = max(fronts, key=lambda front: sum(part.score for part in front.parts), default=None)
    if best is None or not best.parts:
        return [box], None
    cuts = _cuts(best.parts, best.face.width)
    if not cuts:
        return [box], None if _window_width(best.face) == best.face.width else best
    return _pieces(box, best.face, cuts), best


def _window_width(face: Face) -> float:
    """Return the width of the windows in which a face is examined [m]."""
    return min(face.width, max(WINDOW_RATIO * face.height, MIN_WINDOW))


def _front_of(face: Face, frames: Sequence[Frame], look: FrontDetector) -> KnownFront:
    """Find the parts on a long face in overlapping windows."""
    wide = _window_width(face)
    count = max(1, int(np.ceil(2 * (face.width - wide) / wide)) + 1)
    found: list[Part] = []
    evidence = [0.0]
    for left in np.linspace(0.0, face.width - wide, count):
        window = _window(face, float(left), wide)
        chosen = _frames_for(window, frames)
        if not chosen:
            continue
        front = FaceViews(window, chosen, range(len(chosen))).look(0, look, MIN_FRONT_PROBABILITY)
        likely = front_evidence(front, face_image(window, chosen, pixels=COARSE_PIXELS))
        if likely >= MIN_FRONT_PROBABILITY:
            ends = (
                bool(left > END_MARGIN), bool(left + wide < face.width - END_MARGIN)
            )  # fmt: skip
            whole = _whole(front.parts, wide, ends, END_MARGIN)
            whole = equalize_doors(face_image(window, chosen), whole)
            whole = shift_handles(whole, window, camera_position_of(window, chosen[0]), undo=True)
            found += transferred(whole, window, face)
            evidence.append(likely)
    return KnownFront(face, max(evidence), most_confident(found))


def _window(face: Face, left: float, wide: float) -> Face:
    T = face.T_world_face.copy()
    offset = left + wide / 2 - face.width / 2
    T[:3, 3] = apply(face.T_world_face, np.array([[offset, 0.0, 0.0]]))[0]
    return replace(face, T_world_face=T, width=wide)


def _frames_for(face: Face, frames: Sequence[Frame]) -> list[Frame]:
    thin = UprightBox(
        face.T_world_face[:3, 3],
        np.array([0.02, face.width, face.height]),
        float(np.arctan2(face.outward[1], face.outward[0])),
    )
    candidates = [i for i, frame in enumerate(frames) if projection(thin, frame) is not None]
    order, partly = choose_frames(face, frames, np.array(candidates, int))
    return [frames[i] for i in [*order, *partly][:MAX_MERGED]] if order else []


def _whole(
    parts: Sequence[Part], wide: float, ends: tuple[bool, bool], margin: float
) -> tuple[Part, ...]:
    """Return the parts that do not touch a window end at which the row continues."""
    return tuple(
        part
        for part in parts
        if not (ends[0] and part.box[0] * wide < margin)
        and not (ends[1] and (1 - part.box[2]) * wide < margin)
    )


def _cuts(parts: Sequence[Part], width: float) -> list[float]:
    spans = sorted((part.box[0] * width, part.box[2] * width) for part in parts)
    spans += [
        (a.box[0] * width, b.box[2] * width) for a in parts for b in parts if _pair(a, b, width)
    ]
    columns: list[list[float]] = []
    for left, right in sorted(spans):
        if columns and left < columns[-1][1] - END_MARGIN:
            columns[-1][1] = max(columns[-1][1], right)
        else:
            columns.append([left, right])
    edges: list[float] = []
    ends = [0.0, *(v for column in columns for v in column), width]
    for right, left in zip(ends[0::2], ends[1::2], strict=True):
        gap = left - right
        if gap >= MIN_PIECE:
            edges += [right, left]
        else:
            edges.append((left + right) / 2 if right > 0.0 and left < width else 0.0)
    least = MIN_PIECE / 2
    return [e for e in sorted(set(edges)) if least < e < width - least]


def _pair(a: Part, b: Part, width: float) -> bool:
    """Check whether two doors are a double door, whose handles are where they meet."""
    gap = (b.box[0] - a.box[2]) * width
    level = abs(a.box[1] - b.box[1]) < 0.05 and abs(a.box[3] - b.box[3]) < 0.05
    return a.kind == "door_left" and b.kind == "door_right" and abs(gap) < 0.04 and level


def _pieces(box: UprightBox, face: Face, cuts: Sequence[float]) -> list[UprightBox]:
    edges: Float[np.ndarray, " k"] = np.array([0.0, *cuts, face.width])
    along = face.T_world_face[:3, 0]
    axis = 1 if face.index % 2 == 0 else 0
    pieces = []
    for left, right in pairwise(edges):
        size = box.size.copy()
        size[axis] = right - left
        middle = box.center + along * ((left + right) / 2 - face.width / 2)
        pieces.append(UprightBox(middle, size, box.yaw))
    return pieces
