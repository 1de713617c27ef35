"""Recommend which objects of a room to scan again, and from where."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import UprightBox, along_edges, to_local
from momapos.model.records import Frame
from momapos.perception.detection import WITHOUT_DOORS, visible_points
from momapos.perception.segmentation import SIDES, coverage

from .records import Decision, Modeled

if TYPE_CHECKING:
    from jaxtyping import Float

MAX_FRONTAL_ANGLE = np.radians(30.0)
"""Images within this angle of a side's normal count as frontal [rad]."""
MIN_FRONTAL_IMAGES = 3
"""A front with fewer frontal images is recommended [-]."""
MAX_COVERAGE = 0.35
"""Only sides with less coverage than this are recommended [-]."""
MIN_VISIBLE = 0.5
"""Only sides of which neighbors leave at least this share visible are recommended [-]."""
MIN_SIZE = 0.3
"""Objects with a shorter middle edge are not recommended [m]."""
DISTANCES = (1.5, 1.2, 1.8, 0.9, 2.2)
"""Distances from which to look at a side, best first [m]."""
PERSON_RADIUS = 0.25
"""Half the width of a person [m]."""
CAMERA_HEIGHTS = (0.9, 1.5)
"""Lowest and highest position of a handheld camera [m]."""
MAX_RECOMMENDED = 8
"""Number of recommended views [-]."""
OPEN_FURNITURE = frozenset({"table", "counter", "shelf"})
"""Labels of furniture without closed sides."""


@dataclass(frozen=True)
class NextView:
    """A recommended image, in the scene's frame."""

    object: str
    reason: str
    position: tuple[float, float, float]
    """Position of the camera [m]."""
    look_at: tuple[float, float, float]
    """Point to aim at [m]."""
    gain: float
    """Surface not seen yet [m2]."""


def scan_again(made: Modeled) -> list[NextView]:
    """Return the most informative missing images, best first, at most one per object."""
    if not len(made.cloud.points):
        return []  # a photo of one object
    everything = [one.detection.box for one in made.decisions]
    low, high = np.percentile(made.cloud.points[:, :2], [0.2, 99.8], axis=0)
    found = []
    for decision in made.decisions:
        if _is_worth(decision):
            found += _of_object(decision, made, everything, (low, high))
    return sorted(found, key=lambda one: -one.gain)[:MAX_RECOMMENDED]


def _is_worth(decision: Decision) -> bool:
    """Check whether another look at an object may change its model."""
    item = decision.detection
    closed = item.label not in WITHOUT_DOORS | OPEN_FURNITURE
    return closed and item.seen is not None and float(np.sort(item.box.size)[1]) >= MIN_SIZE


def _of_object(
    decision: Decision,
    made: Modeled,
    everything: Sequence[UprightBox],
    floor: tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]],
) -> list[NextView]:
    item, box = decision.detection, decision.detection.box
    others = [one for one in everything if one is not box]
    seen = coverage(made.cloud, item, others)
    front = None if decision.model is None or decision.view is None else decision.view.face.index
    found = []
    for k in range(4):  # the upright faces; a top tells nothing about doors
        if seen.open[k] < MIN_VISIBLE:
            continue
        axis, sign = SIDES[k]
        local = np.zeros(3)
        local[axis] = sign
        outward = along_edges(local[None], -box.yaw)[0]
        middle = box.center + outward * box.size[axis] / 2
        straight = sum(_shows(frame, middle, outward) for frame in made.frames)
        missing = float(seen.areas[k] * max(seen.open[k] - seen.seen[k], 0.0))
        if k == front and straight < MIN_FRONTAL_IMAGES:
            reason = f"its front needs {MIN_FRONTAL_IMAGES} frontal images; the scan has {straight}"
            missing = float(seen.areas[k])
        elif front is None and seen.seen[k] < MAX_COVERAGE and straight < MIN_FRONTAL_IMAGES:
            reason = f"the scan covers only {seen.seen[k]:.0%} of this side"
        else:
            continue
        stand = _stand(middle, outward, everything, floor)
        if stand is not None:
            found.append(NextView(item.name, reason, _triple(stand), _triple(middle), missing))
    return sorted(found, key=lambda one: -one.gain)[:1]


def _shows(frame: Frame, middle: Float[np.ndarray, "3"], outward: Float[np.ndarray, "3"]) -> bool:
    """Check whether a frame shows the middle of a side straight on and from close."""
    line = frame.T_world_camera[:3, 3] - middle
    distance = float(np.linalg.norm(line))
    if not 0.2 < distance < 3.5 or line @ outward < np.cos(MAX_FRONTAL_ANGLE) * distance:
        return False
    return bool(visible_points(frame, middle[None], 0.1)[1][0])


def _stand(
    middle: Float[np.ndarray, "3"],
    outward: Float[np.ndarray, "3"],
    everything: Sequence[UprightBox],
    floor: tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]],
) -> Float[np.ndarray, "3"] | None:
    """Return where a person can stand to look at a side; None if there is no free place."""
    low, high = floor
    for distance in DISTANCES:
        place = middle + distance * outward
        place[2] = np.clip(middle[2] + 0.2, *CAMERA_HEIGHTS)
        feet = np.array([[place[0], place[1], 0.0]])
        free = all(
            (np.abs(to_local(feet, box))[0, :2] > box.size[:2] / 2 + PERSON_RADIUS).any()
            for box in everything
            if box.center[2] - box.size[2] / 2 < CAMERA_HEIGHTS[1]
        )
        if free and (place[:2] > low).all() and (place[:2] < high).all():
            return place
    return None


def _triple(point: Float[np.ndarray, "3"]) -> tuple[float, float, float]:
    x, y, z = (round(float(value), 2) + 0.0 for value in point)
    return x, y, z
