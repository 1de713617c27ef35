"""Find flat fronts of furniture, and how far the furniture extends behind them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import UprightBox, corners, from_corners
from momapos.model.records import Cloud, Instance

from .room_shell import RoomShell, RoomWall, area, ends, floor_seen, peaks
from .supports import components

if TYPE_CHECKING:
    from jaxtyping import Float, Int


MIN_CLEAR_STEP = 4.0
"""A step in the edge of standing furniture counts if it is this many times the roughness of the
edge [-]. Upper edges of hanging furniture are above the cameras and randomly cut off."""
PROFILE_STEP = 0.03
"""Steps in the upper or lower edge of a front larger than this divide it [m]."""
MAX_RAGGEDNESS = 0.2
"""The same for the upper edge of tall standing furniture, which is often cut off because it is
above the camera [m]. Doors divide such a row later."""
MIN_PROTRUSION = 0.15
"""Maximum protrusion of handles [m]."""
MIN_FRONT_AREA = 0.06
"""Minimum area [m2]."""
MIN_FRONT_SIDE = 0.2
"""Minimum width and height [m]."""
HALF_MAX_STEP = 0.02
"""Surfaces with a step of more than twice this are two fronts [m]."""
HALF_MAX_GAP = 0.04
"""Gaps of up to twice this, as between doors, are bridged [m]."""
MAX_FURNITURE_DEPTH = 0.9
"""Maximum depth of furniture [m], unless it hides all of the floor back to a wall."""
MAX_HIDDEN_DEPTH = 1.25
"""Maximum depth in that case [m]."""
MAX_FLOOR_SEEN = 0.2
"""A footprint is not filled if the floor is seen on more than this share of it; under raised doors
the floor is seen a little [-]."""
MAX_FOOT_HEIGHT = 0.25
"""Fronts whose lower edge is below this stand on the floor, on feet or a plinth [m]."""
MIN_FURNITURE_DEPTH = 0.05
"""Minimum depth of furniture [m]."""
MAX_STACK_GAP = 0.15
"""Maximum gap between stacked fronts of one width that belong together [m]."""
MIN_HUNG_HEIGHT = 1.0
"""Fronts whose lower edge is above this hang on the wall [m]."""
MIN_TALL_HEIGHT = 1.2
"""Standing fronts that end above this are tall [m]."""


@dataclass(frozen=True, eq=False)
class FrontPlane:
    """A flat upright surface and the box behind it."""

    axis: int
    """0 if it faces along x, 1 if along y."""
    sign: float
    """+1 if it faces toward larger coordinates, else -1."""
    box: UprightBox
    members: Int[np.ndarray, " k"]
    rank: float
    """Quality: the seen area, times 3 with a wall behind it."""


def find_front_planes(
    cloud: Cloud, room: RoomShell, among: Int[np.ndarray, " m"]
) -> list[FrontPlane]:
    """Find fronts among some points of an upright cloud.

    Returns:
        The fronts by rank, highest first.
    """
    found = []
    for axis in (0, 1):
        for sign in (1.0, -1.0):
            facing = among[sign * cloud.normals[among, axis] > 0.85]
            for members in _flat(cloud.points[facing], facing, axis):
                for piece in _divided(cloud.points[members], members, axis):
                    found.append(_front(cloud, room, among, piece, axis, sign))
    return _stacked(sorted((f for f in found if f is not None), key=lambda f: -f.rank))


def _stacked(fronts: list[FrontPlane]) -> list[FrontPlane]:
    """Merge stacked fronts in one plane, such as the doors of a fridge with a grip gap."""
    out: list[FrontPlane] = []
    for front in fronts:
        for k, other in enumerate(out):
            if _one_above_other(front, other):
                (low, high), (low_2, high_2) = corners(front.box), corners(other.box)
                members = np.concatenate([other.members, front.members])
                box = from_corners(np.minimum(low, low_2), np.maximum(high, high_2))
                out[k] = replace(other, box=box, members=members)
                break
        else:
            out.append(front)
    return out


def _one_above_other(a: FrontPlane, b: FrontPlane) -> bool:
    if (a.axis, a.sign) != (b.axis, b.sign):
        return False
    apart = np.abs(a.box.center - b.box.center) - (a.box.size + b.box.size) / 2
    faces = [f.box.center[f.axis] + f.sign * f.box.size[f.axis] / 2 for f in (a, b)]
    across = 1 - a.axis
    return bool(
        abs(faces[0] - faces[1]) < HALF_MAX_STEP
        and abs(a.box.center[across] - b.box.center[across]) < PROFILE_STEP
        and abs(a.box.size[across] - b.box.size[across]) < 2 * PROFILE_STEP
        and apart[2] < MAX_STACK_GAP
    )


def _flat(
    points: Float[np.ndarray, "n 3"],
    members: Int[np.ndarray, " n"],
    axis: int,
) -> Iterator[Int[np.ndarray, " k"]]:
    cell = [HALF_MAX_GAP] * 3
    cell[axis] = HALF_MAX_STEP
    label = components(points, (cell[0], cell[1], cell[2]))
    for k in range(label.max(initial=-1) + 1):
        group = label == k
        if group.sum() < MIN_FRONT_AREA / HALF_MAX_GAP**2:
            return
        yield members[group]


def _divided(
    points: Float[np.ndarray, "n 3"],
    members: Int[np.ndarray, " n"],
    axis: int,
) -> Iterator[Int[np.ndarray, " k"]]:
    """Divide a flat surface where its upper or lower edge has a step, into pieces wide enough for
    a front: a narrow strip at an end is just an unseen part of the edge."""
    along, z = points[:, 1 - axis], points[:, 2]
    strip = 0.03
    low = float(along.min())
    bins = np.floor((along - low) / strip).astype(int)
    order = np.lexsort((z, bins))
    counts = np.bincount(bins)
    starts = np.concatenate([[0], np.cumsum(counts)])
    seen = np.flatnonzero(counts > 3)
    if not len(seen):
        yield members
        return
    # Second row below the top: a single stray point is not an edge.
    top = np.array([z[order[starts[k + 1] - 2]] for k in seen])
    bottom = np.array([z[order[starts[k] + 1]] for k in seen])
    hangs = float(np.median(bottom)) > MIN_HUNG_HEIGHT
    tall = not hangs and float(np.median(top)) > MIN_TALL_HEIGHT
    cuts = _steps(
        top, MAX_RAGGEDNESS if tall else PROFILE_STEP, np.inf if hangs else MIN_CLEAR_STEP
    )
    # Lower edges near the floor are hidden by objects in front of them.
    if hangs:
        cuts |= _steps(bottom, PROFILE_STEP, np.inf)
    edges = [low]
    high = float(along.max())
    for cut in low + strip * seen[sorted(cuts)]:
        if cut - edges[-1] > MIN_FRONT_SIDE and high - cut > MIN_FRONT_SIDE:
            edges.append(float(cut))
    part = np.searchsorted(edges[1:], along)
    for k in range(len(edges)):
        yield members[part == k]


def _steps(profile: Float[np.ndarray, " n"], least: float, clear: float, side: int = 4) -> set[int]:
    """Return where a profile has a lasting step: the medians on both sides differ.

    The step must exceed `least` [m], and both sides must be smoother than `least` or than the step
    divided by `clear` [-].
    """
    n = len(profile)
    jumps = np.zeros(n)
    for k in range(side, n - side + 1):
        before, after = profile[k - side : k], profile[k : k + side]
        jump = abs(float(np.median(after) - np.median(before)))
        if max(np.ptp(before), np.ptp(after)) < max(least, jump / clear):
            jumps[k] = jump
    cuts: set[int] = set()
    while jumps.max(initial=0.0) > least:
        k = int(np.argmax(jumps))
        cuts.add(k)
        jumps[max(0, k - side) : k + side] = 0
    return cuts


def _front(
    cloud: Cloud,
    room: RoomShell,
    among: Int[np.ndarray, " m"],
    members: Int[np.ndarray, " k"],
    axis: int,
    sign: float,
) -> FrontPlane | None:
    points = cloud.points[members]
    other = 1 - axis
    if len(points) < 20:
        return None
    low, high = points.min(axis=0), points.max(axis=0)
    for k in (other, 2):
        low[k], high[k] = ends(points[:, k], PROFILE_STEP / 2)
    if high[other] - low[other] < MIN_FRONT_SIDE or high[2] - low[2] < MIN_FRONT_SIDE:
        return None
    size = area(points[:, other], points[:, 2])
    if size < MIN_FRONT_AREA:
        return None
    # The densest plane: of a curved front it is the middle, which protrudes most.
    face = peaks(points[:, axis], HALF_MAX_STEP / 2, 1, HALF_MAX_STEP)[0]
    wall = _wall_behind(cloud, room, low, high, face, axis, sign)
    if wall is not None:
        back = wall.offset
    else:
        around, facing = cloud.points[among], sign * cloud.normals[among, axis]
        away = sign * (face - around[:, axis])
        beyond = np.maximum(low[other] - around[:, other], around[:, other] - high[other])
        column = (around[:, 2] > low[2]) & (around[:, 2] < high[2] + 0.03)
        column &= (away > -HALF_MAX_STEP) & (away < MAX_FURNITURE_DEPTH)
        alike = column & (beyond < -2 * HALF_MAX_GAP) & (facing > 0.8)  # not of noisy sides
        end = _next_front(away[alike], around[alike][:, [other, 2]])
        # Sides, top and back tell the depth; most points are of the front itself.
        column &= (beyond < HALF_MAX_STEP) & (away < end) & (facing < 0.8)
        depth = float(np.percentile(away[column], 98)) if column.any() else 0.0
        back = face - sign * max(MIN_FURNITURE_DEPTH, depth)
    low[axis], high[axis] = min(face, back), max(face, back)
    low[2] = 0.0 if low[2] < MAX_FOOT_HEIGHT else low[2]
    box = from_corners(low, high)
    return FrontPlane(axis, sign, box, members, size * (1.0 if wall is None else 3.0))


def _next_front(
    away: Float[np.ndarray, " n"],
    places: Float[np.ndarray, "n 2"],
) -> float:
    """Return the distance from a front to the next front or side behind it; at most `depth` [m].

    Args:
        away: Distance behind the front of surfaces that face the same way [m].
        places: Their position across it [m].
    """
    behind = away[away > MIN_PROTRUSION]
    for at in sorted(peaks(behind, HALF_MAX_STEP, 10, 2 * HALF_MAX_STEP)):
        flat = np.abs(away - at) < HALF_MAX_STEP
        if area(*places[flat].T) > MIN_FRONT_AREA:
            return at - HALF_MAX_STEP
    return MAX_FURNITURE_DEPTH


def _wall_behind(
    cloud: Cloud,
    room: RoomShell,
    low: Float[np.ndarray, "3"],
    high: Float[np.ndarray, "3"],
    face: float,
    axis: int,
    sign: float,
) -> RoomWall | None:
    middle = (low + high) / 2
    middle[axis] = face
    behind = [
        wall
        for wall in room.walls
        if wall.axis == axis and wall.sign == sign and wall.spans(middle[None], 0.2)[0]
    ]
    reach = MAX_HIDDEN_DEPTH if low[2] < MAX_FOOT_HEIGHT else MAX_FURNITURE_DEPTH
    near = [w for w in behind if MIN_FURNITURE_DEPTH < w.distance(middle[None])[0] < reach]
    if not near:
        return None
    wall = min(near, key=lambda wall: wall.distance(middle[None])[0])
    if wall.distance(middle[None])[0] < MAX_FURNITURE_DEPTH:
        return wall
    start, stop = low[:2].copy(), high[:2].copy()
    start[axis], stop[axis] = sorted((face, wall.offset))
    return None if floor_seen(cloud, start, stop) > MAX_FLOOR_SEEN else wall


def attach_hoods(
    furniture: Sequence[Instance], rest: Sequence[Instance], cloud: Cloud, near: float
) -> list[Instance]:
    """Merge a hood's rim with its chimney: a flat object right below a narrower hanging one."""
    out, alone = list(furniture), []
    for item in rest:
        points = cloud.points[item.members]
        low, high = points.min(axis=0), points.max(axis=0)
        for k, body in enumerate(out):
            if body.box is None:
                continue
            start, stop = corners(body.box)
            both = np.minimum(stop, high)[:2] - np.maximum(start, low)[:2]
            below = np.prod(both.clip(0.0)) > 0.6 * np.prod((stop - start)[:2])
            flat = high[2] - low[2] < 0.15 and start[2] > 1.0
            if flat and below and low[2] - near < start[2] < high[2] + near:
                box = from_corners(np.minimum(low, start), np.maximum(high, stop))
                members = np.concatenate([body.members, item.members])
                out[k] = replace(body, members=members, box=box)
                break
        else:
            alone.append(item)
    return out + alone


def attach_handles(
    furniture: Sequence[Instance], rest: Sequence[Instance], cloud: Cloud
) -> tuple[list[Instance], list[Instance]]:
    """Add handles that touch no other points to the furniture that they protrude from.

    Objects that reach down to the floor stand in front of furniture and are not handles.
    """
    out, alone = list(furniture), []
    for item in rest:
        points = cloud.points[item.members]
        low, high = points.min(axis=0), points.max(axis=0)
        for k, body in enumerate(out):
            if body.box is not None and low[2] > MAX_FOOT_HEIGHT and _before(body.box, low, high):
                out[k] = replace(body, members=np.concatenate([body.members, item.members]))
                break
        else:
            alone.append(item)
    return out, alone


def _before(
    box: UprightBox,
    low: Float[np.ndarray, "3"],
    high: Float[np.ndarray, "3"],
) -> bool:
    """Check whether an object lies close in front of an upright face of a box."""
    start, stop = corners(box)
    out = np.maximum(start - low, high - stop)[:2]  # protrusion along x and y
    beside = (high < start) | (low > stop)
    return any(
        0 < out[axis] < MIN_PROTRUSION
        and beside[axis]
        and (np.delete(out, axis) <= 0).all()
        and low[2] > start[2]
        and high[2] < stop[2]
        for axis in (0, 1)
    )
