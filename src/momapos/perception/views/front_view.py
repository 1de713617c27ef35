"""Which face of an object is its front, and which image shows it best."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from momapos.core.geometry import UprightBox
from momapos.model.records import FaceImage, Frame, Front, Part

from .agreement import agreed
from .even_doors import evened
from .faces import FACES, Face, Sampled, box_faces, camera_position_of, face_image, shown, solid
from .placed_parts import handles_seen_from, placed, surest
from .projection import Sight

if TYPE_CHECKING:
    from jaxtyping import Float

AROUND = (0.03, 0.1)
"""How much of what surrounds a face is looked at with it; the second where the first shows no
front [m]."""
STRAIGHT = 10
"""How much more an image counts that is taken straight on: power of the cosine [-]."""
NEAREST = 0.5
"""Images taken from nearer than this are no better for it [m]."""
UNBACKED = 0.5
"""What is said for a face counts so much less where another one has a wall behind the thing: what
stands against a wall opens away from it [-]."""
Look = Callable[[FaceImage], Front]
"""Says what is on a face, and whether it is a front."""


@dataclass(frozen=True, eq=False)
class Seen:
    """Parts that were seen before, on a face of which the object's own may be a piece."""

    face: Face
    score: float
    """Probability that the face is a front, where there are parts on it."""
    parts: tuple[Part, ...]
    """In fractions of that face; handles are where they would be seen from far away."""


@dataclass(frozen=True)
class ViewConfig:
    """How the front of an object is chosen."""

    method: Literal["voting", "first"] = "voting"
    """Votes of all images for each face, or the first image that passes, as in the paper."""
    frontal: float = 30.0
    """Images taken farther than this from a face's normal say nothing about it [deg]."""
    oblique: float = 45.0
    """Where there is none within `frontal`, images up to here are taken [deg]."""
    least: float = 0.5
    """A face is a front from this probability on [-]."""
    flat: float = 0.3
    """And where so much of it lies in its plane: half of a desk is room for knees [-]."""
    shown: float = 0.55
    """Part of a face that an image must show [-]."""
    votes: int = 2
    """Images that vote for a face [-]."""
    agreeing: int = 4
    """Images whose parts are brought together on the face that is the front [-]."""
    partly: float = 0.15
    """Images that show less of it do not help to measure its height map [-]."""
    merged: int = 12
    """Images whose depth is merged to the height map of a face [-]."""
    looked_at: int = 32
    """Images of a face that are looked at, the most promising first [-]."""


@dataclass(frozen=True, eq=False)
class View:
    """The front of an object, as the best image shows it."""

    face: Face
    frame: int
    """Index of the image that was chosen."""
    angle: float
    """Between the line of sight and the face's normal [rad]."""
    image: FaceImage
    front: Front
    evidence: tuple[float, ...]
    """Mean of what the images say for each face: by its looks and by the handles on it, half
    and half, times how flat it is, less where another side has the wall behind it; of as many
    images as it took to see which face wins. NaN for faces that no image was asked about."""


def choose_view(
    box: UprightBox,
    frames: Sequence[Frame],
    seen: Sequence[Sight],
    look: Look,
    config: ViewConfig,
    before: Sequence[Seen] = (),
    backed: Sequence[bool] = (False,) * FACES,
) -> View | None:
    """Find the front of a box (MoMa-Pos, III-B).

    The paper takes the most central image that a classifier calls frontal. Where poses are
    known, every image votes for the face that it shows; one image's error is outvoted.

    Args:
        box: The object.
        frames: All images.
        seen: Those that show it, most central first.
        look: What is on a face.
        config: How to choose.
        before: What was seen on the rows that the box may be a piece of.
        backed: Whether the side opposite to each face stands against a wall.

    Returns:
        None where no image shows a front.
    """
    if config.method == "first":
        return _first(box, frames, seen, look, config, before)
    return _voting(box, frames, seen, look, config, before, backed)


def _first(
    box: UprightBox,
    frames: Sequence[Frame],
    seen: Sequence[Sight],
    look: Look,
    config: ViewConfig,
    before: Sequence[Seen],
) -> View | None:
    faces = box_faces(box)
    for sight in seen:
        cosines = np.array([cosines_to(face, [frames[sight.frame]])[0] for face in faces])
        face = faces[int(np.argmax(cosines))]
        if cosines.max() < np.cos(np.radians(config.frontal)):
            continue
        frame = frames[sight.frame]
        if shown(face, frame) < config.shown:
            continue
        image = face_image(face, [frame])
        front = Views(face, [frame], [0]).look(0, look, config.least)
        front = _with(front, face, frame, before)
        if front_evidence(front, image) >= config.least:
            angle = float(np.arccos(min(1.0, cosines.max())))
            return View(face, sight.frame, angle, image, front, ())
    return None


def _voting(
    box: UprightBox,
    frames: Sequence[Frame],
    seen: Sequence[Sight],
    look: Look,
    config: ViewConfig,
    before: Sequence[Seen],
    backed: Sequence[bool],
) -> View | None:
    indices = np.array([sight.frame for sight in seen], int)
    if not len(indices):
        return None
    evidence = [float("nan")] * FACES
    best: tuple[float, Views, list[int], FaceImage, list[Front]] | None = None
    worth = [1.0 if behind or not any(backed) else UNBACKED for behind in backed]
    for face in sorted(box_faces(box), key=lambda face: -worth[face.index]):
        order, partly = showing(face, frames, indices, config)
        if not order:
            continue
        merged = [*order, *partly][: config.merged]
        views = Views(face, frames, merged)
        image = face_image(face, [frames[i] for i in merged])
        flat = solid(image)
        if flat < config.flat:  # open, as the side of a table: no vote makes it a front
            evidence[face.index] = 0.0
            continue
        asked, least = order[: config.votes], best[0] if best is not None else -1.0
        own: list[Front] = []
        doors: list[float] = []
        looks: list[float] = []
        # Where faces compete, doors do not make up for looks: both count, or one side of a
        # fridge with a seam and a shadow on it passes for the front.
        most = worth[face.index] * (flat + 1.0) / 2
        for i in asked:
            if most * (len(asked) - len(looks)) + sum(looks) <= least * len(asked):
                break
            own.append(views.look(i, look, config.least))
            vote = _with(own[-1], face, frames[i], before)
            doors.append(front_evidence(vote, image))
            evident = (flat * vote.score + handle_evidence(vote, image)) / 2
            looks.append(worth[face.index] * evident)
        if not looks:
            continue
        rank = evidence[face.index] = float(np.mean(looks))
        if len(looks) == len(asked) and np.mean(doors) >= config.least and rank > least:
            best = rank, views, order, image, own
    if best is None:
        return None
    _, views, order, image, own = best
    face, chosen = views.face, order[0]
    front = _together(views, order[: config.agreeing], look, config.least, own)
    front = _with(front, face, frames[chosen], before)
    front = replace(front, parts=evened(image, front.parts))
    angle = float(np.arccos(min(1.0, cosines_to(face, [frames[chosen]])[0])))
    return View(face, chosen, angle, image, front, tuple(evidence))


def _together(
    views: Views, chosen: Sequence[int], look: Look, least: float, known: Sequence[Front] = ()
) -> Front:
    """What several images of a face agree on, with handles as the first of them shows them.

    Args:
        views: The face.
        chosen: Indices of the images whose colors are looked at, the best first.
        look: What is on a face.
        least: From this evidence of a door on, no more of what surrounds the face is looked at.
        known: What the first of the chosen images were found to show.
    """
    face = views.face
    fronts = [*known, *(views.look(i, look, least) for i in chosen[len(known) :])]
    cameras = [camera_position_of(face, views.frames[i]) for i in chosen]
    upright = [
        handles_seen_from(front.parts, face, camera, undo=True)
        for front, camera in zip(fronts, cameras, strict=True)
    ]
    parts = handles_seen_from(agreed(upright), face, cameras[0])
    return replace(fronts[0], parts=parts)


def _with(front: Front, face: Face, frame: Frame, before: Sequence[Seen]) -> Front:
    """A front with what was seen on it before.

    A door that fills its face shows no edges, beside its neighbors it does.
    """
    for seen in before:
        known = placed(seen.parts, seen.face, face)
        if known:
            known = handles_seen_from(known, face, camera_position_of(face, frame))
            score = max(front.score, seen.score)
            front = replace(front, score=score, parts=surest([*front.parts, *known]))
    return front


def front_evidence(front: Front, image: FaceImage) -> float:
    """How probable it is that there is a door or a drawer in the plane of a face, in [0, 1].

    The looks of the whole face count as far as it lies in its plane, each part as far as it does:
    between the legs of a table there is nothing that opens, beside the knees at a desk there is.

    Args:
        front: What is on the face.
        image: The face; its height map tells.
    """
    looks = solid(image) * front.score
    return 1.0 - (1.0 - looks) * (1.0 - handle_evidence(front, image))


def door_evidence(front: Front) -> float:
    """How probable it is that there is a door or a drawer on a face, in [0, 1].

    A plain front looks like any panel but for its handles: each part that has one is evidence of
    its own, and there is none only where all of it errs.
    """
    return 1.0 - (1.0 - front.score) * (1.0 - handle_evidence(front))


def handle_evidence(front: Front, image: FaceImage | None = None) -> float:
    """How probable it is that any of the parts with a handle is one, in [0, 1].

    Args:
        front: What is on a face.
        image: The face, so that a part counts as far as it lies in its plane.
    """
    held = [part for part in front.parts if part.handle is not None]
    flat = [1.0 if image is None else solid(image, part.box) for part in held]
    return 1.0 - float(np.prod([1.0 - p.score * f for p, f in zip(held, flat, strict=True)]))


@dataclass(frozen=True, eq=False)
class Views:
    """A face with some of what surrounds it, as several images show it."""

    face: Face
    frames: Sequence[Frame]
    merged: Sequence[int]
    """Indices of those whose depth is merged, the best first."""
    _sampled: dict[float, Sampled] = field(default_factory=dict)
    """By how much of what surrounds the face is seen [m]."""

    def look(self, chosen: int, look: Look, least: float) -> Front:
        """What one image's colors say of the face, with the height map that all measured.

        The edges of a door that fills its face show only against what is beside it. Parts that lie
        mostly beside the face belong to another thing.

        Args:
            chosen: Index of that image.
            look: What is on a face.
            least: From this evidence of a door on, no more of what surrounds the face is looked at.
        """
        fronts = []
        for around in AROUND:
            sampled, order = self._around(around, chosen)
            front = look(sampled.image(order))
            fronts.append(replace(front, parts=placed(front.parts, sampled.face, self.face)))
            if door_evidence(fronts[-1]) >= least:
                break
        return max(fronts, key=door_evidence)

    def _around(self, around: float, chosen: int) -> tuple[Sampled, list[int]]:
        """The face and some of what surrounds it [m], and the frames of it, one of them first."""
        wide = replace(
            self.face, width=self.face.width + 2 * around, height=self.face.height + 2 * around
        )
        order = [chosen, *(i for i in self.merged if i != chosen)]
        if chosen not in self.merged:
            return Sampled.of(wide, [self.frames[i] for i in order]), list(range(len(order)))
        if around not in self._sampled:
            self._sampled[around] = Sampled.of(wide, [self.frames[i] for i in self.merged])
        places = {i: place for place, i in enumerate(self.merged)}
        return self._sampled[around], [places[i] for i in order]


def showing(
    face: Face, frames: Sequence[Frame], indices: np.ndarray, config: ViewConfig
) -> tuple[list[int], list[int]]:
    """Choose the frames in which a face is looked at.

    Straight ones are better, and near ones: from across a room a handle is a few pixels, and the
    noise of its depth is larger than what it stands out by.

    Returns:
        Indices of those, among the given, that show the face well enough, and of those that show
        a piece of it; each the best first.
    """
    lines, cosines = _lines_to(face, [frames[i] for i in indices])
    clear = np.maximum(cosines, 0.0) ** STRAIGHT / np.maximum(lines, NEAREST) ** 2
    for most in (config.frontal, config.oblique):
        good = np.flatnonzero(cosines >= np.cos(np.radians(most)))
        good = good[np.argsort(-clear[good], kind="stable")][: config.looked_at]
        parts = np.array([shown(face, frames[indices[i]]) for i in good])
        order = np.argsort(-(parts**2 * clear[good]), kind="stable")
        if (parts >= config.shown).any():
            best, parts = indices[good[order]], parts[order]
            part_only = (parts >= config.partly) & (parts < config.shown)
            return best[parts >= config.shown].tolist(), best[part_only].tolist()
    return [], []


def cosines_to(face: Face, frames: Sequence[Frame]) -> Float[np.ndarray, " n"]:
    """Cosine of the angle between the face's normal and the line to each camera."""
    return _lines_to(face, frames)[1]


def _lines_to(
    face: Face, frames: Sequence[Frame]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Length of the line from a face's middle to each camera [m]; cosine to the face's normal."""
    cameras = np.array([frame.T_world_camera[:3, 3] for frame in frames]).reshape(-1, 3)
    lines = cameras - face.T_world_face[:3, 3]
    length = np.linalg.norm(lines, axis=1)
    return length, lines @ face.outward / length
