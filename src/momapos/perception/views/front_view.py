"""Find the front face of an object, and the image that shows it best."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from momapos.core.geometry import UprightBox
from momapos.model.records import FaceImage, Frame, Front, Part

from .agreement import consensus
from .even_doors import equalize_doors
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
from .placed_parts import most_confident, shift_handles, transferred
from .projection import Observation

if TYPE_CHECKING:
    from jaxtyping import Float

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
    return replace(fronts[0], parts=parts)


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
