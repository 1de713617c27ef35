"""Score candidates for open doors and flaps: the cavity that they close, and their free edges."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from momapos.core.geometry import apply, between, invert
from momapos.model.records import Cloud, OpenLeaf

from .room_shell import area

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

Free: TypeAlias = "Callable[[Float[np.ndarray, 'n 3']], Bool[np.ndarray, ' n']]"
"""Tells which places were seen to be empty [m]."""
MAX_JAMB = 0.5
"""Minimum share of the hinge and of the opposite edge that closes against something [-]."""
OTHER_SIDE = 0.3
"""Share of a leaf's back that must be seen to measure its thickness [-]."""
CELL = 0.03
"""Spacing of the points that are examined [m]."""
EMPTY_BEHIND = (0.06, 0.12, 0.18)
"""A leaf is thin: it is empty behind its surface at one of these distances [m]."""
MIN_THIN = 0.35
"""Minimum share of a surface parallel to the walls that is thin [-]."""
MIN_AREA = 0.04
"""Minimum area [m2]."""
SIDE_RANGE = (0.15, 2.2)
"""Minimum and maximum width and height [m]."""
MIN_FILLED = 0.6
"""Minimum share of its bounding rectangle that a leaf covers [-]."""
TURN_RANGE = (np.radians(20.0), np.radians(125.0))
"""Minimum and maximum opening angle [rad]."""
MAX_LIFT = np.radians(70.0)
"""Flaps lifted farther look like shelves and are ignored [rad]."""
MIN_FACING = 0.85
"""Minimum cosine between the normals of one leaf, which are noisy far from the camera [-]."""
MIN_FRONT_FACING = 0.95
"""Minimum cosine between the normals of a front [-]."""
LAYER = 0.015
"""Points this close to a plane belong to it, twice that if it is uneven [m]."""
MIN_REMOVED = 0.5
"""Clouds are downsampled to one point per layer if this removes at least this share [-]."""
LEAF_THICKNESS = (0.02, 0.1)
"""Thickness of a leaf of which one side is seen, and maximum thickness [m]."""
HINGE_DEPTH = 0.005
"""Depth of the axis behind the outer face, between those that `furniture_model` gives to doors with
and without neighbors [m]."""
MIN_HOLLOW = 0.6
"""Minimum share of the closed leaf's rectangle that was seen through [-]."""
CAVITY_DEPTH = 0.12
"""At this depth behind it ... [m]"""
MIN_CAVITY = 0.2
"""... at least this share is empty; racks and shelves fill the rest [-]."""
MAX_CAVITY_DEPTH = 1.3
"""Maximum depth of the back of the cavity [m]."""
MAX_ASIDE = 0.3
"""Surfaces this close to its sides, in or behind the front, are of the same furniture [m]."""
MAX_HIDDEN = 0.3
"""Maximum share of a closed leaf that another front hides [-]."""
BEYOND_EDGE = (0.05, 0.065, 0.08)
"""At these distances beyond its free edge ... [m]"""
MIN_FREE_EDGE = 0.4
"""... it is empty for this share of the edge, and for one of the adjacent edges [-]."""
SEARCH_DISTANCE = 0.6
"""Distance around a leaf in which fronts are searched [m]."""
WALL_DISTANCE = 0.05
"""Surfaces this close to a wall's plane are not fronts [m]."""
MIN_POINTS = 30
"""Minimum number of points of a front [-]."""
MAX_SHARED = 0.3
"""Of two leaves that overlap by this share of the smaller one, the better one remains [-]."""
MAX_BESIDE = 0.08
"""What a leaf closes against is at most this far from its edge ... [m]"""
MAX_BEHIND = 0.08
"""... and this far behind it [m]."""


def evidence(leaf: OpenLeaf, cloud: Cloud, free: Free) -> float:
    """Return the score of a leaf; 0 if it closes nothing [-]."""
    width, height = leaf.size
    steps = np.linspace(0.1, 0.9, 9)

    def empty(behind: float) -> float:
        grid = np.stack(np.meshgrid(steps * width, [-behind], steps * height), -1)
        return float(free(leaf.world(grid.reshape(-1, 3))).mean())

    hollow = empty(2 * LAYER)
    if hollow < MIN_HOLLOW or empty(CAVITY_DEPTH) < MIN_CAVITY:
        return 0.0
    if empty(MAX_CAVITY_DEPTH) > 1.0 - MIN_HOLLOW:
        return 0.0
    if _free_ends(leaf, free) < MIN_FREE_EDGE or _hidden(leaf, cloud):
        return 0.0
    shares, flush = _jambs(leaf, cloud)
    if min(shares[:2]) < MAX_JAMB or max(shares[2:]) < MAX_JAMB:
        return 0.0
    return hollow + sum(shares) + sum(flush)


def _jambs(leaf: OpenLeaf, cloud: Cloud) -> tuple[list[float], list[float]]:
    """Check what a closed leaf would close against: at its hinge, opposite to it, at both ends.

    Returns:
        Share of each edge along which there is anything, and of each with a flush front [-].
    """
    width, height = leaf.size
    place = leaf.local(cloud.points)
    beside = between(
        place,
        (-MAX_BESIDE, -leaf.thickness - MAX_BEHIND, -MAX_BESIDE),
        (width + MAX_BESIDE, LAYER, height + MAX_BESIDE),
    )
    opened = leaf.local(apply(leaf.T_closed_open, cloud.points[beside]))
    still = (opened[:, 0] < 0.0) | (np.abs(opened[:, 1]) > 2 * LAYER)
    place = place[beside][still]
    front = cloud.normals[beside][still] @ leaf.out > MIN_FRONT_FACING
    front &= np.abs(place[:, 1]) < LAYER
    beyond = [-place[:, 0], place[:, 0] - width, -place[:, 2], place[:, 2] - height]
    shares, flush = [], []
    for k, away in enumerate(beyond):
        axis, length = (2, height) if k < 2 else (0, width)
        shares.append(_covered(place[away > -MAX_BESIDE / 2, axis], length))
        # The rim that a leaf covers is not an adjacent front.
        flush.append(_covered(place[front & (away > LAYER), axis], length))
    return shares, flush


def _hidden(leaf: OpenLeaf, cloud: Cloud) -> bool:
    """Check whether another front lies in front of a leaf's own, so that the leaf is inside it."""
    place = leaf.local(cloud.points)
    reach = leaf.size[0] + MAX_BESIDE + LEAF_THICKNESS[1]
    before = between(place, (0.0, MAX_BESIDE, 0.0), (leaf.size[0], reach, leaf.size[1]))
    before &= cloud.normals @ leaf.out > MIN_FRONT_FACING
    seen = area(place[before, 0], place[before, 2], CELL)
    return seen > MAX_HIDDEN * leaf.size[0] * leaf.size[1]


def _free_ends(leaf: OpenLeaf, free: Free) -> float:
    """Return the share of the free edge, and of one adjacent edge, beyond which it is empty [-]."""
    width, height = leaf.size
    beyond, steps = np.array(BEYOND_EDGE), np.linspace(0.1, 0.9, 9)
    middle = -leaf.thickness / 2

    def share(along: Float[np.ndarray, "a"], across: Float[np.ndarray, "b"], axis: int) -> float:
        x, z = np.meshgrid(along, across, indexing="ij")
        place = np.stack([x.ravel(), np.full(x.size, middle), z.ravel()], axis=1)
        there = free(apply(invert(leaf.T_closed_open), leaf.world(place))).reshape(x.shape)
        return float(there.all(axis=axis).mean())

    outer = width * (0.5 + steps / 2)
    sides = share(outer, height + beyond, 1), share(outer, -beyond, 1)
    return min(share(width + beyond, height * steps, 0), max(sides))


def _covered(along: Float[np.ndarray, " n"], length: float) -> float:
    count = max(1, round(length / (2 * CELL)))
    bins = np.floor(along / length * count)
    return len(np.unique(bins[(bins >= 0) & (bins < count)])) / count


def is_same(one: OpenLeaf, other: OpenLeaf) -> bool:
    """Check whether two leaves close one opening, are one slab, or one is inside the other."""
    corners = np.array([[0.0, 0.0, 0.0], [other.size[0], 0.0, other.size[1]]])
    place = one.local(other.world(corners))
    low, high = place.min(0), place.max(0)
    common = np.minimum(high[[0, 2]], one.size) - np.maximum(low[[0, 2]], 0.0)
    least = min(np.prod(one.size), np.prod(other.size))
    shared = float(np.prod(np.maximum(common, 0.0))) > MAX_SHARED * least
    if shared and np.abs(place[:, 1]).max() < MAX_BESIDE + MAX_BEHIND:
        return True
    now = [apply(invert(leaf.T_closed_open), leaf.middle[None])[0] for leaf in (one, other)]
    if np.linalg.norm(now[0] - now[1]) < min(*one.size, *other.size) / 2:
        return True
    return any(_behind(leaf, place) for leaf, place in ((one, now[1]), (other, now[0])))


def _behind(leaf: OpenLeaf, place: Float[np.ndarray, "3"]) -> bool:
    """Check whether a place is in or behind a leaf's front, like a shelf or a closed door."""
    x, y, z = leaf.local(place[None])[0]
    width, height = leaf.size
    return bool(
        -MAX_ASIDE < x < width + MAX_ASIDE
        and -MAX_ASIDE < z < height + MAX_ASIDE
        and -MAX_CAVITY_DEPTH < y < MAX_BESIDE
    )
