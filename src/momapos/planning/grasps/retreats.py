"""Choose how a rigid object leaves where it stands; reversed, how it gets there.

It is lifted, or where something is close above, drawn out until it can be lifted.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from momapos.core import owner_cache
from momapos.model.scene import Scene
from momapos.verification import free_length

from .config import SUBSTEPS, MotionConfig

if TYPE_CHECKING:
    from jaxtyping import Float

Direction: TypeAlias = tuple[float, float, float]
LIFT_HEIGHT = 0.05
"""Height by which a rigid object is lifted, where nothing is above it [m]."""
LOW_LIFTS = (0.03, 0.02, 0.01, 0.005)
"""Heights that are tried where it would hit something [m]."""
LIFT_ROOM = 0.012
"""Free length beyond the end of a lift or a slide, a little more than arms keep from everything
[m]."""
MAX_SLIDE = 0.6
"""Largest distance by which an object is drawn out: the depth of most furniture [m]."""
SLIDE_STEP = 0.02
"""Distance between the places at which it may be lifted [m]."""
MIN_RISE = 0.1
"""Upward component of a direction in which an object leaves its support by itself [-]."""
MAX_RISE = 0.01
"""Height by which an object rises at most on a horizontal slide, so that it leaves its support; at
most half of the free height above it [m]."""
YAWS = 4
"""Number of horizontal directions in which an object is drawn out, from the yaw of each object next
to it [-]."""
NEXT_TO = 0.02
"""Largest distance of these objects [m]."""
MAX_DIRECTIONS = 8
"""Number of directions of the hand that are tried [-]."""
_DIGITS = 3


@dataclass(frozen=True)
class Retreat:
    """How an object leaves where it stands: it slides by a vector, and then it is lifted."""

    lift: float
    """[m]"""
    slide: Direction = (0.0, 0.0, 0.0)
    """In the world [m]; zeros if it is only lifted."""

    @property
    def length(self) -> float:
        """Length of the slide [m]."""
        return float(np.linalg.norm(self.slide))

    def path(self, config: MotionConfig) -> Float[np.ndarray, "v 3"]:
        """Return places of the object relative to where it stands, `SUBSTEPS` per waypoint [m]."""
        slid = np.array(self.slide)
        out = math.ceil(self.length / config.waypoint_slide) * SUBSTEPS
        up = SUBSTEPS if self.lift or not out else 0
        shares = np.linspace(0.0, 1.0, out + 1)[:, None]
        lifts = np.linspace(0.0, self.lift, up + 1)[1:, None]
        return np.concatenate([shares * slid, slid + lifts * [0.0, 0.0, 1.0]])


def retreats(
    scene: Scene,
    name: str,
    config: MotionConfig,
    approach: Float[np.ndarray, "g 3"],
) -> Iterator[Retreat]:
    """Yield how an object can leave where it stands, in the order of trying; at least one way.

    By default it is lifted, if not by `LIFT_HEIGHT` then by less. Where something keeps it from
    being lifted so far, drawing it out comes next.

    Args:
        scene: The scene.
        name: The object.
        config: The wanted way.
        approach: Unit vectors along which the hand approaches in each grasp, in the world.
    """
    lifts = (LIFT_HEIGHT, *LOW_LIFTS) if config.lift is None else (config.lift,)
    if config.slide is not None:
        yield Retreat(lifts[0], config.slide)
        return
    if config.retreat in (None, "up"):
        free = free_length(scene, name, lifts[0] + LIFT_ROOM) - LIFT_ROOM
        lift = next((h for h in lifts if h <= free), None)
        if lift is not None or config.retreat == "up" or config.lift is not None:
            yield Retreat(lifts[0] if lift is None else lift)
        if config.retreat == "up" or config.lift is not None or lift == lifts[0]:
            return
    else:
        lift = None
    ways = _backward(approach) if config.retreat == "back" else _outward(scene, name)
    found = [one for one in (_drawn(scene, name, way, lifts) for way in ways) if one is not None]
    if config.retreat != "back":
        found.sort(key=lambda one: one.length)
    yield from found
    if not found and lift is None:  # for its reason
        x, y, z = ways[0] if config.retreat in ("back", "out") and ways else (0.0, 0.0, 0.0)
        yield Retreat(lifts[0], (MAX_SLIDE * x, MAX_SLIDE * y, MAX_SLIDE * z))


def along_slide(slide: Direction, approach: Float[np.ndarray, "g 3"]) -> np.ndarray:
    """Return in which grasps the hand draws an object back along its approach."""
    unit = np.array(slide) / max(float(np.linalg.norm(slide)), 1e-9)
    return np.asarray(approach @ unit < -math.cos(math.radians(2.0)))


def _backward(approach: Float[np.ndarray, "g 3"]) -> list[Direction]:
    """Return the directions against which hands approach, those of the most grasps first."""
    ways, counts = np.unique(np.round(-approach, _DIGITS) + 0.0, axis=0, return_counts=True)
    ways, counts = ways[ways[:, 2] > -MIN_RISE], counts[ways[:, 2] > -MIN_RISE]
    order = np.argsort(-counts, kind="stable")
    return [(x, y, z) for x, y, z in ways[order][:MAX_DIRECTIONS].tolist()]


def _outward(scene: Scene, name: str) -> list[Direction]:
    """Return horizontal directions along the edges of the objects next to one."""
    low, high = scene.object(name).bounds + NEXT_TO * np.array([[-1.0], [1.0]])
    near = [
        item
        for item in scene.objects
        if (item.bounds[0] <= high).all() and (item.bounds[1] >= low).all()
    ]
    quarter = 2 * np.pi / YAWS
    yaws = {
        round(math.atan2(item.T_world_object[1, 0], item.T_world_object[0, 0]) % quarter, _DIGITS)
        for item in near
    }
    turns = sorted(yaw + k * quarter for yaw in yaws for k in range(YAWS))
    return [(math.cos(turn), math.sin(turn), 0.0) for turn in turns]


@owner_cache(256)
def _drawn(scene: Scene, name: str, way: Direction, lifts: tuple[float, ...]) -> Retreat | None:
    """Return the shortest slide along a unit vector after which an object can be lifted."""
    x, y, z = way
    if z > MIN_RISE:  # it leaves its support on the way
        for lift in lifts:
            most = lift / z + LIFT_ROOM
            if free_length(scene, name, 0.0, (most * x, most * y, most * z)) >= most:
                return Retreat(0.0, (lift / z * x, lift / z * y, lift))
        return None
    rise = free_length(scene, name, 2.0 * MAX_RISE) / 2.0
    free = free_length(scene, name, 0.0, (MAX_SLIDE * x, MAX_SLIDE * y, rise))
    steps = int((free - LIFT_ROOM) / SLIDE_STEP)

    def lifted(k: int, lift: float) -> bool:
        length, up = k * SLIDE_STEP, lift + LIFT_ROOM
        slide = (length * x, length * y, rise)
        return free_length(scene, name, up, slide) >= math.hypot(length, rise) + up - 1e-9

    for lift in lifts:
        if steps > 0 and lifted(steps, lift):
            below, first = 0, steps
            while first - below > 1:
                middle = (below + first) // 2
                below, first = (below, middle) if lifted(middle, lift) else (middle, first)
            length = first * SLIDE_STEP + LIFT_ROOM
            return Retreat(lift, (length * x, length * y, rise))
    return None
