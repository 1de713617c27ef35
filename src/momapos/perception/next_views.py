"""What of a room should be scanned again, and from where."""

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

STRAIGHT = np.radians(30.0)
"""Pictures within this of a front's normal show it straight on [rad]."""
PICTURES = 3
"""A front wants so many of them [-]."""
LITTLE = 0.35
"""Of a side that is to be looked at no more was seen than this [-]."""
OPEN = 0.5
"""And at least this much of it can be seen [-]."""
ROOMY = 0.3
"""Smaller things need no second look [m]."""
AWAY = (1.5, 1.2, 1.8, 0.9, 2.2)
"""Distances from which a side is looked at, the best first [m]."""
PERSON = 0.25
"""Half the room that a person takes [m]."""
EYES = (0.9, 1.5)
"""A camera in a hand is no lower and no higher than this [m]."""
MOST = 8
"""Longer lists are not walked through [-]."""
OPEN_FURNITURE = frozenset({"table", "counter", "shelf"})
"""What has no closed sides."""


@dataclass(frozen=True)
class Advice:
    """One picture that is missing, in the scene's frame."""

    object: str
    reason: str
    position: tuple[float, float, float]
    """Where the camera should be [m]."""
    look_at: tuple[float, float, float]
    """What it should be turned to [m]."""
    gain: float
    """Surface that was not seen yet [m2]."""


def scan_again(made: Modeled) -> list[Advice]:
    """Pictures that would tell most, the most telling first, one a thing at most."""
    everything = [one.detection.box for one in made.decisions]
    low, high = np.percentile(made.cloud.points[:, :2], [0.2, 99.8], axis=0)
    found = []
    for decision in made.decisions:
        if _worth(decision):
            found += _of_thing(decision, made, everything, (low, high))
    return sorted(found, key=lambda one: -one.gain)[:MOST]


def _worth(decision: Decision) -> bool:
    """Whether a second look at a thing may change what is known of how it moves."""
    item = decision.detection
    closed = item.label not in WITHOUT_DOORS | OPEN_FURNITURE
    return closed and item.seen is not None and float(np.sort(item.box.size)[1]) >= ROOMY


def _of_thing(
    decision: Decision,
    made: Modeled,
    everything: Sequence[UprightBox],
    floor: tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]],
) -> list[Advice]:
    item, box = decision.detection, decision.detection.box
    others = [one for one in everything if one is not box]
    seen = coverage(made.cloud, item, others)
    front = None if decision.model is None or decision.view is None else decision.view.face.index
    found = []
    for k in range(4):  # the upright faces; a top tells nothing about doors
        if seen.open[k] < OPEN:
            continue
        axis, sign = SIDES[k]
        local = np.zeros(3)
        local[axis] = sign
        outward = along_edges(local[None], -box.yaw)[0]
        middle = box.center + outward * box.size[axis] / 2
        straight = sum(_shows(frame, middle, outward) for frame in made.frames)
        missing = float(seen.areas[k] * max(seen.open[k] - seen.seen[k], 0.0))
        if k == front and straight < PICTURES:
            reason = f"its front was seen straight on in {_pictures(straight)}"
            missing = float(seen.areas[k])
        elif front is None and seen.seen[k] < LITTLE and straight < PICTURES:
            reason = f"only {seen.seen[k]:.0%} of this side was seen"
        else:
            continue
        stand = _stand(middle, outward, everything, floor)
        if stand is not None:
            found.append(Advice(item.name, reason, _triple(stand), _triple(middle), missing))
    return sorted(found, key=lambda one: -one.gain)[:1]


def _shows(frame: Frame, middle: Float[np.ndarray, "3"], outward: Float[np.ndarray, "3"]) -> bool:
    """Whether a picture shows the middle of a side, straight on and from near."""
    way = frame.T_world_camera[:3, 3] - middle
    distance = float(np.linalg.norm(way))
    if not 0.2 < distance < 3.5 or way @ outward < np.cos(STRAIGHT) * distance:
        return False
    return bool(visible_points(frame, middle[None], 0.1)[1][0])


def _stand(
    middle: Float[np.ndarray, "3"],
    outward: Float[np.ndarray, "3"],
    everything: Sequence[UprightBox],
    floor: tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]],
) -> Float[np.ndarray, "3"] | None:
    """Where a person can stand before a side; None where there is no room."""
    low, high = floor
    for distance in AWAY:
        place = middle + distance * outward
        place[2] = np.clip(middle[2] + 0.2, *EYES)
        feet = np.array([[place[0], place[1], 0.0]])
        free = all(
            (np.abs(to_local(feet, box))[0, :2] > box.size[:2] / 2 + PERSON).any()
            for box in everything
            if box.center[2] - box.size[2] / 2 < EYES[1]
        )
        if free and (place[:2] > low).all() and (place[:2] < high).all():
            return place
    return None


def _pictures(count: int) -> str:
    return "no picture" if count == 0 else f"{count} picture{'s' if count > 1 else ''} only"


def _triple(point: Float[np.ndarray, "3"]) -> tuple[float, float, float]:
    x, y, z = (round(float(value), 2) + 0.0 for value in point)
    return x, y, z
