"""What speaks for a door or flap that stands open: the hollow that it shuts, and its free edges."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from momapos.core.geometry import apply, between, invert
from momapos.model.records import Cloud, OpenLeaf

from .room_shell import area

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

Free: TypeAlias = "Callable[[Float[np.ndarray, 'n 3']], Bool[np.ndarray, ' n']]"
"""Whether places were seen to be empty [m]."""


@dataclass(frozen=True)
class OpenLeafConfig:
    """What makes a surface a door that stands open."""

    cell: float = 0.03
    """Of points that are looked at, so far apart [m]."""
    thick: tuple[float, ...] = (0.06, 0.12, 0.18)
    """A leaf is seen to end behind its surface at one of these [m]."""
    thin: float = 0.35
    """Share of a surface along the walls behind which that is so, at least [-]."""
    area: float = 0.04
    """Least area [m2]."""
    sides: tuple[float, float] = (0.15, 2.2)
    """Least and greatest width and height [m]."""
    filled: float = 0.6
    """Share of its rectangle that a leaf covers, at least [-]."""
    turns: tuple[float, float] = (np.radians(20.0), np.radians(125.0))
    """How far it is open, at least and at most [rad]."""
    lifted: float = np.radians(70.0)
    """Flaps that are lifted farther look like shelves, and are left out [rad]."""
    facing: float = 0.85
    """Cosine between the normals of one leaf, which are uneven where it is seen from far [-]."""
    straight: float = 0.95
    """And of a front [-]."""
    layer: float = 0.015
    """What is this near to its plane belongs to it, twice that where it is uneven [m]."""
    dense: float = 0.5
    """Of clouds of which so few points, at most, are a layer apart only these are looked at [-]."""
    thickness: tuple[float, float] = (0.02, 0.1)
    """Of a leaf of which one side is seen, and of any at most [m]."""
    hinge_depth: float = 0.005
    """How far behind its outer face its axis is taken to be: between what models of shut doors are
    given that have something beside them and those that have not [m]."""
    hollow: float = 0.6
    """Share of the place of the shut leaf through which one sees, at least [-]."""
    shallow: float = 0.12
    """So far behind it there is room [m] ..."""
    deep: float = 0.2
    """... in this share of it, at least: racks and shelves fill the rest [-]."""
    depth: float = 1.3
    """So far behind is what closes the hollow, at most [m]."""
    aside: float = 0.3
    """What is so near beside it in or behind its front belongs to the same furniture [m]."""
    before: float = 0.3
    """Share of a shut leaf that another front may hide [-]."""
    beyond: tuple[float, ...] = (0.05, 0.065, 0.08)
    """A leaf ends at its free edge: so far beyond that it is empty [m] ..."""
    ends: float = 0.4
    """... for this share of the edge, and of one of those beside it at least [-]."""
    around: float = 0.6
    """Fronts are looked for so far around it [m]."""
    wall: float = 0.05
    """What is this near to a wall's plane is no front [m]."""
    fewest: int = 30
    """And have so many points, at least [-]."""
    same: float = 0.3
    """Of two leaves that would cover this share of the smaller one the likelier is taken [-]."""
    other_side: float = 0.3
    """Share of a leaf's other side that must be seen to tell how thick it is [-]."""
    jamb: float = 0.5
    """Share of the hinge and of the edge opposite to it where something is to close against [-]."""
    beside: float = 0.08
    """That lies so far beside the edge, at most [m] ..."""
    behind: float = 0.08
    """... and so far behind the leaf [m]."""


def evidence(leaf: OpenLeaf, cloud: Cloud, free: Free, config: OpenLeafConfig) -> float:
    """How much speaks for a leaf; 0 where it closes nothing [-]."""
    width, height = leaf.size
    steps = np.linspace(0.1, 0.9, 9)

    def empty(behind: float) -> float:
        grid = np.stack(np.meshgrid(steps * width, [-behind], steps * height), -1)
        return float(free(leaf.world(grid.reshape(-1, 3))).mean())

    hollow = empty(2 * config.layer)
    if hollow < config.hollow or empty(config.shallow) < config.deep:
        return 0.0
    if empty(config.depth) > 1.0 - config.hollow:
        return 0.0
    if _free_ends(leaf, free, config) < config.ends or _hidden(leaf, cloud, config):
        return 0.0
    shares, flush = _jambs(leaf, cloud, config)
    if min(shares[:2]) < config.jamb or max(shares[2:]) < config.jamb:
        return 0.0
    return hollow + sum(shares) + sum(flush)


def _jambs(leaf: OpenLeaf, cloud: Cloud, config: OpenLeafConfig) -> tuple[list[float], list[float]]:
    """What a shut leaf would close against: at its hinge, opposite to it, and at either end.

    Returns:
        Share of each edge beside which there is anything, and a front in one plane with it [-].
    """
    width, height = leaf.size
    place = leaf.local(cloud.points)
    beside = between(
        place,
        (-config.beside, -leaf.thickness - config.behind, -config.beside),
        (width + config.beside, config.layer, height + config.beside),
    )
    opened = leaf.local(apply(leaf.T_shut_open, cloud.points[beside]))
    still = (opened[:, 0] < 0.0) | (np.abs(opened[:, 1]) > 2 * config.layer)
    place = place[beside][still]
    front = cloud.normals[beside][still] @ leaf.out > config.straight
    front &= np.abs(place[:, 1]) < config.layer
    beyond = [-place[:, 0], place[:, 0] - width, -place[:, 2], place[:, 2] - height]
    shares, flush = [], []
    for k, away in enumerate(beyond):
        axis, length = (2, height) if k < 2 else (0, width)
        shares.append(_covered(place[away > -config.beside / 2, axis], length, config))
        # The rim that a leaf covers is no front beside it.
        flush.append(_covered(place[front & (away > config.layer), axis], length, config))
    return shares, flush


def _hidden(leaf: OpenLeaf, cloud: Cloud, config: OpenLeafConfig) -> bool:
    """Whether another front lies before the one that a leaf belongs to: it is inside of that."""
    place = leaf.local(cloud.points)
    reach = leaf.size[0] + config.beside + config.thickness[1]
    before = between(place, (0.0, config.beside, 0.0), (leaf.size[0], reach, leaf.size[1]))
    before &= cloud.normals @ leaf.out > config.straight
    seen = area(place[before, 0], place[before, 2], config.cell)
    return seen > config.before * leaf.size[0] * leaf.size[1]


def _free_ends(leaf: OpenLeaf, free: Free, config: OpenLeafConfig) -> float:
    """Share of the free edge, and of one of those beside it, beyond which it is empty [-]."""
    width, height = leaf.size
    beyond, steps = np.array(config.beyond), np.linspace(0.1, 0.9, 9)
    middle = -leaf.thickness / 2

    def share(along: Float[np.ndarray, "a"], across: Float[np.ndarray, "b"], axis: int) -> float:
        x, z = np.meshgrid(along, across, indexing="ij")
        place = np.stack([x.ravel(), np.full(x.size, middle), z.ravel()], axis=1)
        there = free(apply(invert(leaf.T_shut_open), leaf.world(place))).reshape(x.shape)
        return float(there.all(axis=axis).mean())

    outer = width * (0.5 + steps / 2)
    sides = share(outer, height + beyond, 1), share(outer, -beyond, 1)
    return min(share(width + beyond, height * steps, 0), max(sides))


def _covered(along: Float[np.ndarray, " n"], length: float, config: OpenLeafConfig) -> float:
    """Share of a length where there are points [-]."""
    count = max(1, round(length / (2 * config.cell)))
    bins = np.floor(along / length * count)
    return len(np.unique(bins[(bins >= 0) & (bins < count)])) / count


def same(one: OpenLeaf, other: OpenLeaf, config: OpenLeafConfig) -> bool:
    """Whether two leaves close the same opening, are the same slab, or one is in the other."""
    corners = np.array([[0.0, 0.0, 0.0], [other.size[0], 0.0, other.size[1]]])
    place = one.local(other.world(corners))
    low, high = place.min(0), place.max(0)
    common = np.minimum(high[[0, 2]], one.size) - np.maximum(low[[0, 2]], 0.0)
    least = min(np.prod(one.size), np.prod(other.size))
    shared = float(np.prod(np.maximum(common, 0.0))) > config.same * least
    if shared and np.abs(place[:, 1]).max() < config.beside + config.behind:
        return True
    now = [apply(invert(leaf.T_shut_open), leaf.middle[None])[0] for leaf in (one, other)]
    if np.linalg.norm(now[0] - now[1]) < min(*one.size, *other.size) / 2:
        return True
    return any(_behind(leaf, place, config) for leaf, place in ((one, now[1]), (other, now[0])))


def _behind(leaf: OpenLeaf, place: Float[np.ndarray, "3"], config: OpenLeafConfig) -> bool:
    """Whether a place is in or behind the front of which a leaf is: a shelf, or a shut door."""
    x, y, z = leaf.local(place[None])[0]
    width, height = leaf.size
    return bool(
        -config.aside < x < width + config.aside
        and -config.aside < z < height + config.aside
        and -config.depth < y < config.beside
    )
