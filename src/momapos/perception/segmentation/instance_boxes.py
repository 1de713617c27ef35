"""Fit boxes to instances: remove outliers, snap faces, guess labels from sizes.

Labels by size come from a table of rules, one per kind. It is a fallback for instances without a
label, and it errs where objects look alike from outside, such as a dishwasher behind a cabinet
front.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from math import inf
from typing import TYPE_CHECKING, Literal

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from momapos.core import InputError
from momapos.core.geometry import (
    UprightBox,
    along_edges,
    apply,
    bottom,
    corners,
    from_corners,
    point_spacing,
    to_local,
    top,
)
from momapos.model.records import (
    UNKNOWN,
    Cloud,
    Detection,
    Frame,
    ImageDetection,
    Instance,
    LabelSource,
)

from .config import SPACING_PERCENT
from .room_shell import RoomShell, area, peaks

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int


Stand = Literal["floor", "support", "hung"]
Range = tuple[float, float, float, float]
"""A trapezoid: the fit rises from 0 to 1 between the first two numbers, and falls from 1 to 0
between the last two."""


@dataclass(frozen=True)
class BoxFeatures:
    """Input of the rules."""

    stand: Stand
    """Whether it stands on the floor, on another object, or hangs."""
    height: float
    """Vertical extent [m]."""
    width: float
    """Longer side seen from above [m]."""
    depth: float
    """Shorter side [m]."""
    bottom: float
    """Height above the floor [m]."""
    closed: float
    """Share of its fullest side that surfaces cover [-]."""
    step: float
    """How much higher it is than adjacent furniture [m]; 0 without neighbors."""
    free: float
    """Distance to the nearest wall [m]."""
    bright: float
    """Median brightness in [0, 1]."""

    @property
    def slender(self) -> float:
        """Height over width [-]."""
        return self.height / max(self.width, 1e-6)


@dataclass(frozen=True)
class SizeRule:
    """One kind of object."""

    label: str
    stand: tuple[Stand, ...]
    fits: Mapping[str, Range]
    """Ranges of features; all must fit."""
    score: float
    """Confidence if everything fits, in [0, 1]."""


def _from(low: float, full: float) -> Range:
    return (low, full, inf, inf)


def _to(full: float, high: float) -> Range:
    return (-inf, -inf, full, high)


FLOOR: tuple[Stand, ...] = ("floor",)
ON: tuple[Stand, ...] = ("support",)
HUNG: tuple[Stand, ...] = ("hung",)

RULES: tuple[SizeRule, ...] = (
    SizeRule("fridge", FLOOR, {"height": (1.1, 1.3, 2.1, 2.3), "width": (0.45, 0.55, 0.98, 1.1),
         "depth": (0.4, 0.5, 0.95, 1.05), "closed": _from(0.3, 0.5)}, 0.8),
    SizeRule("cabinet", FLOOR, {"height": _from(1.1, 1.5), "closed": _from(0.3, 0.5)}, 0.5),
    SizeRule("oven", FLOOR, {"height": (0.82, 0.88, 1.0, 1.05), "width": (0.5, 0.56, 0.92, 0.98),
         "depth": (0.45, 0.5, 0.8, 0.9), "step": (0.01, 0.025, 0.08, 0.12)}, 0.75),
    SizeRule("dishwasher", FLOOR, {"height": (0.75, 0.8, 0.92, 0.96),
         "width": (0.5, 0.55, 0.72, 0.8), "depth": (0.45, 0.5, 0.72, 0.8),
         "closed": _from(0.3, 0.5), "bright": _to(0.2, 0.3)}, 0.6),
    SizeRule("kitchen island", FLOOR, {"height": (0.75, 0.8, 1.0, 1.1), "width": _from(0.6, 0.8),
         "depth": _from(0.25, 0.32), "closed": _from(0.3, 0.5), "free": _from(0.5, 0.7)}, 0.6),
    SizeRule("cabinet", FLOOR, {"height": (0.4, 0.6, 1.0, 1.1), "width": _from(0.2, 0.3),
         "closed": _from(0.3, 0.5)}, 0.5),
    SizeRule("wall cabinet", HUNG, {"bottom": _from(1.0, 1.2), "height": (0.25, 0.3, 1.1, 1.3),
         "depth": (0.2, 0.25, 0.45, 0.55)}, 0.7),
    SizeRule("range hood", HUNG, {"bottom": _from(1.2, 1.35), "width": (0.4, 0.5, 1.0, 1.2),
         "depth": _from(0.42, 0.5)}, 0.6),
    SizeRule("counter", ("floor", "support", "hung"), {"height": _to(0.07, 0.1),
         "bottom": (0.6, 0.7, 1.05, 1.15), "width": _from(0.5, 0.6),
         "depth": _from(0.4, 0.5)}, 0.6),
    SizeRule("table", FLOOR, {"height": (0.35, 0.5, 0.95, 1.1), "width": _from(0.5, 0.65),
         "depth": _from(0.4, 0.5), "closed": _to(0.4, 0.5)}, 0.7),
    SizeRule("chair", FLOOR, {"height": (0.5, 0.65, 1.15, 1.25), "width": (0.2, 0.3, 0.65, 0.75),
         "depth": (0.15, 0.25, 0.6, 0.7)}, 0.45),
    SizeRule("shelf", HUNG, {"bottom": _from(0.3, 0.5), "height": _to(0.1, 0.15),
         "depth": _to(0.4, 0.5), "width": _from(0.3, 0.4)}, 0.5),
    SizeRule("microwave", ("support", "hung"), {"height": (0.17, 0.22, 0.42, 0.48),
         "width": (0.34, 0.4, 0.7, 0.85), "depth": (0.2, 0.26, 0.55, 0.62)}, 0.7),
    SizeRule("cup", ON, {"height": (0.05, 0.075, 0.12, 0.14), "width": (0.04, 0.055, 0.13, 0.16),
         "slender": (0.95, 1.12, 1.6, 1.9)}, 0.6),
    SizeRule("apple", ON, {"height": (0.04, 0.05, 0.08, 0.095), "width": (0.045, 0.055, 0.1, 0.12),
         "slender": (0.5, 0.6, 1.06, 1.15)}, 0.5),
    SizeRule("bottle", ON, {"height": (0.14, 0.17, 0.36, 0.42), "width": (0.035, 0.045, 0.11, 0.14),
         "slender": _from(1.7, 2.1)}, 0.6),
    SizeRule("box", ON, {"height": (0.1, 0.14, 0.36, 0.42), "width": (0.1, 0.12, 0.3, 0.36),
         "slender": (0.5, 0.7, 2.1, 2.5)}, 0.5),
    SizeRule("bowl", ON, {"height": (0.025, 0.04, 0.09, 0.11), "width": (0.11, 0.13, 0.26, 0.3),
         "depth": _from(0.1, 0.12)}, 0.4),
    SizeRule("plate", ON, {"height": _to(0.03, 0.045), "width": (0.13, 0.16, 0.3, 0.34),
         "depth": _from(0.12, 0.15)}, 0.4),
)  # fmt: skip
"""Earlier rules win ties."""

MIN_FIT: float = UNKNOWN[1]
"""Boxes that no rule fits at least this well are an "object" [-]."""


def guesses_of(features: BoxFeatures) -> tuple[tuple[str, float], ...]:
    """Return all labels whose rules fit a box well enough, with scores in [0, 1], best first."""
    values = {**asdict(features), "slender": features.slender}
    scores = [
        (rule.score * min(fit(values[name], spread) for name, spread in rule.fits.items()))
        if features.stand in rule.stand
        else 0.0
        for rule in RULES
    ]
    order = sorted(range(len(RULES)), key=lambda k: -scores[k])
    fitting = [(RULES[k].label, scores[k]) for k in order if scores[k] >= MIN_FIT]
    best: dict[str, float] = {}
    for label, score in fitting:
        best.setdefault(label, score)
    return tuple(best.items())


def fit(value: float, spread: Range) -> float:
    """Return how well a value fits a range, in [0, 1]."""
    low, full, still, high = spread
    if full <= value <= still:
        return 1.0
    if value <= low or value >= high:
        return 0.0
    return (value - low) / (full - low) if value < full else (high - value) / (high - still)


def features_of(
    cloud: Cloud,
    members: Int[np.ndarray, " k"],
    box: UprightBox,
    stand: Stand,
    others: Sequence[UprightBox],
    room: RoomShell,
) -> BoxFeatures:
    """Measure the features of a box.

    Args:
        cloud: Upright.
        members: Points of the object.
        box: Its box.
        stand: What it stands on.
        others: Boxes of all objects; it may be among them.
        room: Walls.
    """
    flat = np.sort(box.size[:2])
    walls = [
        float(wall.distance(box.center[None])[0]) - box.size[wall.axis] / 2
        for wall in room.walls
        if wall.spans(box.center[None], 0.5)[0]
    ]
    colors = cloud.colors[members]
    return BoxFeatures(
        stand=stand,
        height=float(box.size[2]),
        width=float(flat[1]),
        depth=float(flat[0]),
        bottom=bottom(box),
        closed=_closed(cloud, members, box),
        step=_step(box, others),
        free=min(walls, default=10.0),
        bright=float(np.median(colors)) / 255 if len(colors) else 0.5,
    )


def _closed(cloud: Cloud, members: Int[np.ndarray, " k"], box: UprightBox) -> float:
    """Return the share of the fullest upright side that surfaces cover [-]."""
    local = to_local(cloud.points[members], box)
    facing = along_edges(cloud.normals[members], box.yaw)
    inner = np.abs(local[:, 2]) < box.size[2] / 2 - 0.05
    if box.size[2] < 0.2:
        return 0.0
    shares = []
    for axis in (0, 1):
        for sign in (-1.0, 1.0):
            at = np.abs(sign * local[:, axis] - box.size[axis] / 2) < 0.08
            on = local[at & inner & (np.abs(facing[:, axis]) > 0.8)]
            whole = box.size[1 - axis] * (box.size[2] - 0.1)
            shares.append(area(on[:, 1 - axis], on[:, 2]) / whole)
    return float(max(shares))


def _step(box: UprightBox, others: Sequence[UprightBox]) -> float:
    """Return how much higher a box is than the highest similar one that touches its side [m]."""
    steps = []
    for other in others:
        apart = np.abs(box.center - other.center)[:2] - (box.size + other.size)[:2] / 2
        similar = abs(top(box) - top(other)) < 0.15
        if similar and apart.max() < 0.06 and apart.max() > -0.06:
            steps.append(top(box) - top(other))
    return min(steps, default=0.0)


MIN_INSIDE = 0.9
"""A fragment has more than this share of its points inside a larger box [-]."""
GIVEN_SEARCH = 0.035
"""The same for boxes from a segmenter, which knows better how far a top overhangs [m]."""
MIN_EDGE = 0.01
"""Minimum edge length [m]."""
WALL_THICKNESS = 0.1
"""Thickness of the boxes of walls [m]."""
MAX_NEIGHBOR_DISTANCE = 0.03
"""Points farther than this from their eight nearest neighbors on average are outliers, unless the
cloud is sparse [m]."""
OUTLIER_FACTOR = 1.3
"""In a sparse cloud, outliers are this much farther from their neighbors than `SPACING_PERCENT` of
its points [-]. A cloud fused in voxels of 15 mm gets about `MAX_NEIGHBOR_DISTANCE`."""
OUTSIDE_PERCENT = 1.0
"""Share of points that may lie outside on each side [%]."""
FACE_SEARCH = 0.08
"""A face is searched this far from the outermost points [m]; handles protrude by 3 to 6 cm."""
MIN_FACE_COVERED = 0.2
"""Minimum share of a face that a surface covers [-]."""
PLANE_TOLERANCE = 0.008
"""Points of one surface are within this of its plane [m]."""
FLOOR_SNAP = 0.12
"""Bottoms closer to the floor are snapped to it; the lowest part is rarely seen [m]."""
WALL_SNAP = 0.1
"""Backs closer to a wall are snapped to it; they are never seen [m]."""
SUPPORT_SNAP = 0.1
"""Bottoms closer to a surface are snapped to it [m]."""
MIN_YAW = 3.0
"""Objects whose faces are turned by more from x and y get a turned box [deg]; the normals of small
ones are off by up to 2."""
MIN_AGREEMENT = 0.3
"""Agreement of the directions of an object's faces, in [0, 1]: arcs of a circle of a quarter and
more have up to 0.22, boxes seen by a depth camera at least 0.35 [-]."""
MAX_SMALL_SIDE = 0.35
"""Smaller objects are extended if a side was not seen [m]."""
MAX_SHEET_THICKNESS = 0.12
"""Larger ones are extended if what was seen of them is thinner than this [m]."""
MAX_DEPTH = 0.8
"""Furniture whose front is closer to a wall behind it reaches to that wall [m]; fridges are up to
75 cm deep."""
MIN_POINTS = 10
"""Instances without a box and with fewer points are dropped [-]."""


def boxes(cloud: Cloud, instances: Sequence[Instance], room: RoomShell) -> list[Detection]:
    """Fit boxes to instances and name them.

    Args:
        cloud: Upright: z up, floor at z = 0.
        instances: With members, or a box, or both.
        room: Walls that backs are snapped to.

    Returns:
        One detection per instance with a box or enough points, named `<label>_<k>`: for each
        label, k counts from 1 by distance from the world's origin.

    Raises:
        InputError: Members are not indices of the cloud.
    """
    drawn = []
    farthest = max(
        MAX_NEIGHBOR_DISTANCE, OUTLIER_FACTOR * point_spacing(cloud.points, SPACING_PERCENT)
    )
    for instance in instances:
        members = _members(cloud, instance, farthest)
        if len(members) >= MIN_POINTS or instance.box is not None:
            box = _draw(cloud, members, instance.box)
            drawn.append((instance, members, _snapped(box, room)))
    drawn.sort(key=lambda row: bottom(row[2]))
    tops: list[UprightBox] = []
    standing = []
    for instance, members, box in drawn:
        box, stand = _on_support(box, tops)
        if instance.box is None:
            extend = _extended if stand == "support" else _reaching_back
            box = extend(cloud, members, box, room)
        tops.append(box)
        standing.append((instance, members, box, stand))
    found = []
    for instance, members, box, stand in standing:
        label, score, guesses = instance.label, instance.score, instance.guesses
        if not label:
            guesses = guesses_of(features_of(cloud, members, box, stand, tops, room)) or (UNKNOWN,)
            label, fit = guesses[0]
            score = min(score, fit)
        source: LabelSource = "size" if guesses else "segmenter"
        found.append(Detection("", label, score, box, members, source, guesses))
    return named(found)


def named(detections: Sequence[Detection]) -> list[Detection]:
    """Name detections `<label>_<k>`, in the order of labels and of distance from the origin."""

    def rank(detection: Detection) -> tuple[str, float, tuple[float, ...]]:
        center = np.round(detection.box.center, 3)
        return detection.label, round(float(np.hypot(*center[:2])), 2), tuple(center.tolist())

    counts: dict[str, int] = {}
    out = []
    for detection in sorted(detections, key=rank):
        k = counts[detection.label] = counts.get(detection.label, 0) + 1
        out.append(replace(detection, name=f"{detection.label.replace(' ', '_')}_{k}"))
    return out


def drop_fragments(detections: Sequence[Detection], cloud: Cloud) -> list[Detection]:
    """Drop unlabeled objects whose points lie inside a larger box.

    They are fragments of it, such as the rim of a door. As objects they would block the door.
    """

    def is_fragment(item: Detection) -> bool:
        points, volume = cloud.points[item.members], np.prod(item.box.size)
        larger = (other.box for other in detections if np.prod(other.box.size) > volume)
        return any(inside(points, box).mean() > MIN_INSIDE for box in larger)

    return [
        d for d in detections if d.label != "object" or not len(d.members) or not is_fragment(d)
    ]


def inside(points: Float[np.ndarray, "n 3"], box: UprightBox) -> Bool[np.ndarray, " n"]:
    """Tell which points lie in a box, or within 1 cm of it."""
    return (np.abs(to_local(points, box)) <= box.size / 2 + 0.01).all(axis=1)


def wall_detections(room: RoomShell) -> list[Detection]:
    """Return the walls as boxes behind their surfaces; a robot must not drive there."""
    out = []
    for wall in room.walls:
        center, size = np.empty(3), np.empty(3)
        center[wall.axis] = wall.offset - wall.sign * WALL_THICKNESS / 2
        center[1 - wall.axis], center[2] = (wall.low + wall.high) / 2, wall.top / 2
        size[wall.axis], size[1 - wall.axis] = WALL_THICKNESS, wall.high - wall.low
        size[2] = wall.top
        out.append(Detection("", "wall", 0.8, UprightBox(center, size), np.zeros(0, int)))
    return named(out)


# ---------------------------------------------------------------- points


def _members(cloud: Cloud, instance: Instance, farthest: float) -> Int[np.ndarray, " k"]:
    if instance.members is not None:
        members = np.asarray(instance.members)
        if len(members) and not (members.min() >= 0 and members.max() < len(cloud.points)):
            raise InputError(
                f"members of an instance must be indices below the number of points, "
                f"{len(cloud.points)}; they range from {members.min()} to {members.max()}"
            )
    elif instance.box is not None:
        members = np.flatnonzero(inside(cloud.points, instance.box))
    else:
        return np.zeros(0, int)
    if len(members) < 12:
        return members
    distances, _ = cKDTree(cloud.points[members]).query(cloud.points[members], k=9)
    return members[distances[:, 1:].mean(axis=1) < farthest]


# ---------------------------------------------------------------- faces


def _draw(cloud: Cloud, members: Int[np.ndarray, " k"], given: UprightBox | None) -> UprightBox:
    """Return the box around points, or a given one, with its faces snapped to surfaces."""
    points, normals = cloud.points[members], cloud.normals[members]
    yaw = given.yaw if given is not None else faces_yaw(normals)
    turned, facing = along_edges(points, yaw), along_edges(normals, yaw)
    if given is not None:
        low, high = corners(given)
    else:
        low, high = np.percentile(turned, [OUTSIDE_PERCENT, 100 - OUTSIDE_PERCENT], axis=0)
    faces = [low.copy(), high.copy()]
    for axis in range(3):
        for side, sign in ((0, -1.0), (1, 1.0)):
            on = sign * facing[:, axis] > 0.8
            start = (low, high)[side][axis]
            reach = FACE_SEARCH if given is None else GIVEN_SEARCH
            reach = min(reach, 0.4 * (high - low)[axis])
            near = on & (np.abs(turned[:, axis] - start) < reach)
            found = _surface(turned[near], axis, low, high)
            if found is not None:
                faces[side][axis] = found
    thin = faces[1] - faces[0] < MIN_EDGE
    middle = (faces[0] + faces[1]) / 2
    faces[0][thin] = middle[thin] - MIN_EDGE / 2
    faces[1][thin] = middle[thin] + MIN_EDGE / 2
    return from_corners(faces[0], faces[1], yaw)


def _surface(
    points: Float[np.ndarray, "n 3"],
    axis: int,
    low: Float[np.ndarray, "3"],
    high: Float[np.ndarray, "3"],
) -> float | None:
    """Return the coordinate of the largest plane across an axis, among points facing along it."""
    found = peaks(points[:, axis], PLANE_TOLERANCE, 8, PLANE_TOLERANCE)
    if not found:
        return None
    on = points[np.abs(points[:, axis] - found[0]) < 2 * PLANE_TOLERANCE]
    a, b = (k for k in range(3) if k != axis)
    whole = (high[a] - low[a]) * (high[b] - low[b])
    seen = area(on[:, a], on[:, b], 0.025)
    return found[0] if seen > MIN_FACE_COVERED * whole else None


def faces_yaw(normals: Float[np.ndarray, "n 3"]) -> float:
    """Return the yaw of an object's box [rad]: 0, unless its faces clearly show another one."""
    upright = np.abs(normals[:, 2]) < 0.3
    if upright.sum() < 30:
        return 0.0
    angle = np.arctan2(normals[upright, 1], normals[upright, 0])
    mean = np.exp(4j * angle).mean()
    offset = float(np.angle(mean)) / 4
    # Round objects have faces on all sides: their normals cancel.
    clear = abs(mean) > MIN_AGREEMENT and abs(offset) > np.radians(MIN_YAW)
    return offset if clear else 0.0


# ---------------------------------------------------------------- snapping


def _snapped(box: UprightBox, room: RoomShell) -> UprightBox:
    """Snap a box to the floor and the walls that it nearly touches."""
    low, high = corners(box)
    if low[2] < FLOOR_SNAP:
        low[2] = 0.0
    if abs(box.yaw) < 1e-9:
        for wall in room.walls:
            if wall.spans(box.center[None], 0.3)[0]:
                face = low if wall.sign > 0 else high
                if abs(face[wall.axis] - wall.offset) < WALL_SNAP:
                    face[wall.axis] = wall.offset
    if (high - low < MIN_EDGE).any():
        return box
    return from_corners(low, high, box.yaw)


def _on_support(box: UprightBox, tops: Sequence[UprightBox]) -> tuple[UprightBox, Stand]:
    """Snap a box to the object below it, and tell what it stands on."""
    at = bottom(box)
    if at <= 0.0:
        return box, "floor"
    below = [
        top(other)
        for other in tops
        if (np.abs(to_local(box.center[None], other)[0, :2]) < other.size[:2] / 2).all()
        and top(other) < top(box) - MIN_EDGE
        and -SUPPORT_SNAP < at - top(other) < SUPPORT_SNAP
    ]
    if not below:
        return box, "hung"
    low, high = corners(box)
    low[2] = min(below, key=lambda height: abs(height - at))
    return from_corners(low, high, box.yaw), "support"


def _extended(
    cloud: Cloud,
    members: Int[np.ndarray, " k"],
    box: UprightBox,
    room: RoomShell,
) -> UprightBox:
    """Make an object as deep as it is wide if its far side was not seen.

    The camera sees only the near half of a cup on a counter, and only the front of a microwave
    below a shelf. A flat top seen from above shows the whole outline, so nothing is added.
    """
    sheet = min(box.size[:2]) < MAX_SHEET_THICKNESS
    if (max(box.size) > MAX_SMALL_SIDE and not sheet) or len(members) < 10:
        return box
    local = to_local(cloud.points[members], box)
    facing = along_edges(cloud.normals[members], box.yaw)
    flat = (facing[:, 2] > 0.9) & (local[:, 2] > box.size[2] / 2 - 0.02)
    top_seen = area(local[flat, 0], local[flat, 1], 0.02) > 0.5 * box.size[0] * box.size[1]
    if top_seen and max(box.size) < MAX_SMALL_SIDE:
        return box
    low, high = corners(box)
    axis = 0 if box.size[0] < box.size[1] else 1
    missing = box.size[1 - axis] - box.size[axis]
    sides = [(sign * facing[:, axis] > 0.5).mean() for sign in (-1.0, 1.0)]
    if min(sides) < 0.1 * max(sides):
        if sides[0] < sides[1]:
            low[axis] -= missing
        else:
            high[axis] += missing
    return _clipped_at_walls(from_corners(low, high, box.yaw), room)


def _reaching_back(
    cloud: Cloud, members: Int[np.ndarray, " k"], box: UprightBox, room: RoomShell
) -> UprightBox:
    """Extend furniture of which only the front was seen back to the wall behind it.

    The top of a base cabinet is a counter of its own, its sides are other cabinets.
    """
    axis = int(np.argmin(box.size[:2]))
    if abs(box.yaw) > 1e-9 or box.size[axis] > MAX_SHEET_THICKNESS or len(members) < MIN_POINTS:
        return box
    facing = cloud.normals[members, axis]
    sides = [float((sign * facing > 0.5).mean()) for sign in (-1.0, 1.0)]
    if min(sides) > 0.1 * max(sides):
        return box
    sign = 1.0 if sides[1] > sides[0] else -1.0
    low, high = corners(box)
    for wall in room.walls:
        behind = sign * (box.center[axis] - wall.offset)
        is_behind = wall.axis == axis and wall.sign * sign > 0 and 0 < behind < MAX_DEPTH
        if is_behind and wall.spans(box.center[None], 0.3)[0]:
            (low if sign > 0 else high)[axis] = wall.offset
    return from_corners(low, high)


def _clipped_at_walls(box: UprightBox, room: RoomShell) -> UprightBox:
    """Clip a box at the walls that it would penetrate."""
    if abs(box.yaw) > 1e-9:
        return box
    low, high = corners(box)
    for wall in room.walls:
        if wall.spans(box.center[None], 0.3)[0]:
            if wall.sign > 0 and high[wall.axis] > wall.offset:
                low[wall.axis] = max(low[wall.axis], wall.offset)
            if wall.sign < 0 and low[wall.axis] < wall.offset:
                high[wall.axis] = min(high[wall.axis], wall.offset)
    return from_corners(low, high)


MAX_OVERLAP = 0.5
"""Masks with a larger IoU are one object [-]. Mask3D exports up to 750 masks of a room, one for
each probable class of an object."""

BOX_ERROR = 0.06
"""Boxes of one object in several images differ by this [m]: a counter is 4 cm thick."""


def without_duplicates(instances: Sequence[Instance], count: int) -> list[Instance]:
    """Drop masks that nearly repeat a mask with a higher score.

    Args:
        instances: In any order; those without members are kept.
        count: Number of points of the cloud.

    Returns:
        The rest, in the given order.
    """
    masked = [k for k, item in enumerate(instances) if item.members is not None]
    members = [np.unique(np.asarray(instances[k].members, int)) for k in masked]
    sizes = np.array([len(own) for own in members], float)
    if len(masked) < 2 or max(own.max(initial=0) for own in members) >= count:
        return list(instances)  # `boxes` refuses members that are not in the cloud
    rows = np.repeat(np.arange(len(masked)), sizes.astype(int))
    columns = np.concatenate(members)
    table = sparse.csr_array(
        (np.ones(len(rows), np.float32), (rows, columns)), shape=(len(masked), count)
    )
    shared = np.asarray((table @ table.T).todense())
    overlap = shared / np.maximum(sizes[:, None] + sizes - shared, 1.0)
    dropped: set[int] = set()
    kept: list[int] = []
    for row in np.argsort([-instances[k].score for k in masked], kind="stable").tolist():
        if (overlap[row, kept] > MAX_OVERLAP).any():
            dropped.add(masked[row])
        else:
            kept.append(row)
    return [item for k, item in enumerate(instances) if k not in dropped]


def boxes_in_images(
    found: Mapping[str, Sequence[ImageDetection]], frames: Sequence[Frame]
) -> list[Instance]:
    """Return the 3-D boxes that a detector found in images, one for each object.

    A box in one image is the same object as one of equal label in another image if the center of
    either lies in the other, or nearly; the one with the highest score is kept.

    Args:
        found: Detections by frame name; those without corners are ignored.
        frames: With poses in the upright world.
    """
    seen = [
        Instance(item.label, min(max(item.score, 0.0), 1.0), box=_upright(item.corners, frame))
        for frame in frames
        for item in found.get(frame.name, ())
        if item.corners is not None
    ]
    kept: list[Instance] = []
    for one in sorted(seen, key=lambda item: -item.score):
        if not any(one.label == other.label and _is_same(one.box, other.box) for other in kept):
            kept.append(one)
    return kept


def _is_same(a: UprightBox | None, b: UprightBox | None) -> bool:
    assert a is not None
    assert b is not None
    return _holds(a, b.center) or _holds(b, a.center)


def _holds(box: UprightBox, point: Float[np.ndarray, "3"]) -> bool:
    return bool((np.abs(to_local(point[None], box)[0]) < box.size / 2 + BOX_ERROR).all())


def _upright(corners: Sequence[tuple[float, float, float]] | None, frame: Frame) -> UprightBox:
    """Return the upright box around the corners of a box in a camera's frame.

    Its x axis is the edge that is closest to level; a detector's boxes are tilted by some degrees.
    """
    points = apply(frame.T_world_camera, np.array(corners, float))
    edges = points[[1, 3, 4]] - points[0]
    edges = edges / np.linalg.norm(edges, axis=1, keepdims=True)
    level = edges[np.argmin(np.abs(edges[:, 2]))]
    yaw = float(np.arctan2(level[1], level[0]))
    yaw = float(np.mod(yaw + np.pi / 4, np.pi / 2) - np.pi / 4)
    turned = along_edges(points, yaw)
    return from_corners(turned.min(axis=0), turned.max(axis=0), yaw)
