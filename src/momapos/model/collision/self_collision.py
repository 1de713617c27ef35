"""Check a robot for self-collision by spheres or hulls, and choose between them for each pair.

Spheres are fast and conservative. But where two links pass within a few millimeters, such as links
near a common joint, spheres report contact in free states. For such pairs, hulls decide.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.compiled import B2, F2, I2, entry
from momapos.core.geometry import apply
from momapos.model.kinematics import (
    Chain,
    ChainArrays,
    HullArrays,
    Segments,
    SphereArrays,
    chain_arrays,
    one_turn,
)
from momapos.model.urdf import Articulated

from .arm_collision import APART, MEET, meeting, meeting_base, place_arm, scratch_of
from .link_hulls import hulls_overlap, surface_hulls, surfaces_overlap
from .spheres import Spheres, build_spheres

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

SAMPLES = 2000
"""Number of states in which spheres are compared with hulls [-]."""
MAX_FALSE_SHARE = 0.02
"""Largest share of states that spheres may block although hulls are disjoint [-]."""


@dataclass(frozen=True, eq=False)
class Contacts:
    """Contacts of pairs of links in several states."""

    pairs: tuple[tuple[str, str], ...]
    """Link names: pairs within the arm, then pairs of arm and base."""
    by_spheres: Bool[np.ndarray, "m pairs"]
    """Whether the spheres or the hulls overlap."""
    by_hulls: Bool[np.ndarray, "m pairs"]


@entry
def _contacts(
    q: F2, chain: ChainArrays, spheres: SphereArrays, column: I2, by_spheres: B2, by_hulls: B2
) -> None:
    """Fill the columns of `Contacts`; `column` has those of groups and boxes of the base."""
    scratch = scratch_of(len(chain.slides), spheres)
    R, p, bounds = scratch
    base, hulls = np.zeros(3), spheres.hulls
    for m in range(len(q)):
        place_arm(q[m], base, chain, spheres, scratch)
        for k in range(len(spheres.pairs)):
            i, j = spheres.pairs[k, 0], spheres.pairs[k, 1]
            found = meeting(R, p, bounds, spheres, i, j)
            lo, hi = hulls.of_group[j], hulls.of_group[j + 1]
            by_hulls[m, k] = found != APART and hulls_overlap(R, p, hulls, i, lo, hi)
            by_spheres[m, k] = found == MEET or by_hulls[m, k]
        for g in range(len(column)):
            for b in range(column.shape[1]):
                k = column[g, b]
                if k < 0:
                    continue
                found = meeting_base(R, p, bounds, spheres, g, b)
                h = hulls.of_base[b]
                hit = found != APART and hulls_overlap(R, p, hulls, g, h, h + 1)
                by_hulls[m, k] |= hit
                by_spheres[m, k] |= found == MEET or hit


@entry
def _crossings(q: F2, chain: ChainArrays, spheres: SphereArrays, hulls: HullArrays) -> np.ndarray:
    """Mark the states in which hulls of group 0 overlap those after it."""
    scratch, out = scratch_of(len(chain.slides), spheres), np.zeros(len(q), np.bool_)
    R, p, _ = scratch
    base, at = np.zeros(3), np.empty((len(hulls.segment), 3))
    near = np.empty(len(hulls.segment), np.int64)
    for m in range(len(q)):
        place_arm(q[m], base, chain, spheres, scratch)
        out[m] = surfaces_overlap(R, p, hulls, at, near)
    return out


def surfaces_cross(
    model: Articulated,
    chain: Chain,
    segments: Segments,
    spheres: Spheres,
    pair: tuple[str, str],
    q: Float[np.ndarray, "m n"],
) -> Bool[np.ndarray, " m"]:
    """Mark the states in which the surfaces of two links cross, as their meshes are in the files.

    Hulls and pieces may overlap where surfaces do not, such as those of a wrist in a fork.
    """
    surfaces = [
        apply(segments.T_segment_link[name], model.surface(name).reshape(-1, 3)).reshape(-1, 3, 3)
        for name in pair
    ]
    hulls = surface_hulls(surfaces, [segments.of_link[name] for name in pair])
    states = np.ascontiguousarray(q)
    return np.asarray(_crossings(states, chain_arrays(chain), spheres.arrays, hulls.arrays))


def contacts(chain: Chain, spheres: Spheres, q: Float[np.ndarray, "m n"]) -> Contacts:
    """Check which pairs of the robot's links touch, by spheres and by hulls."""
    pairs = [(spheres.links[i], spheres.links[j]) for i, j in spheres.pairs]
    against, column = _with_base(spheres)
    pairs += against
    by_spheres, by_hulls = np.zeros((2, len(q), len(pairs)), bool)
    _contacts(
        np.ascontiguousarray(q), chain_arrays(chain), spheres.arrays, column, by_spheres, by_hulls
    )
    return Contacts(tuple(pairs), by_spheres, by_hulls)


def _with_base(spheres: Spheres) -> tuple[list[tuple[str, str]], np.ndarray]:
    """Return pairs of arm and base links, and the column of each group and box in `Contacts`."""
    column = np.full(spheres.base_pairs.shape, -1)
    names: dict[tuple[str, str], int] = {}
    for g, b in np.argwhere(spheres.base_pairs).tolist():
        name = (spheres.links[g], spheres.base_links[b])
        column[g, b] = len(spheres.pairs) + names.setdefault(name, len(names))
    return list(names), column


def arm_spheres(
    model: Articulated,
    chain: Chain,
    segments: Segments,
    disabled: Collection[frozenset[str]],
    gripper_links: Sequence[str],
) -> Spheres:
    """Cover an arm with spheres; for pairs of links that they are too coarse for, hulls decide.

    Args:
        model: The robot.
        chain: Its arm.
        segments: The segment with which each link moves.
        disabled: Pairs of links that are never checked (SRDF).
        gripper_links: Links that may touch the grasped part.
    """
    return choose_exact_pairs(chain, build_spheres(model, segments, disabled, gripper_links))


def choose_exact_pairs(chain: Chain, spheres: Spheres) -> Spheres:
    """Choose the pairs for which hulls decide, from random states of the arm."""
    q = np.random.default_rng(0).uniform(*one_turn(chain), (SAMPLES, chain.size))
    return with_exact_pairs(spheres, contacts(chain, spheres, q))


def with_exact_pairs(spheres: Spheres, found: Contacts) -> Spheres:
    """Let hulls decide for the pairs whose spheres block too many free states.

    The pair that blocks the most free states is chosen first, until spheres block at most
    `MAX_FALSE_SHARE` of all states wrongly.

    Args:
        spheres: The robot.
        found: Its contacts in sampled states.
    """
    exact = np.zeros(len(found.pairs), bool)
    free = found.by_spheres[~found.by_hulls.any(1)]
    while free.any(1).sum() > MAX_FALSE_SHARE * len(found.by_hulls):
        coarsest = free.sum(0).argmax()
        exact[coarsest], free[:, coarsest] = True, False
    _, column = _with_base(spheres)
    # Pairs that are never checked have column -1, the last one.
    of_base = np.append(exact, False)[column]
    return replace(spheres, exact=exact[: len(spheres.pairs)], base_exact=of_base)


def decided_by_hulls(spheres: Spheres) -> frozenset[tuple[str, str]]:
    """Return the pairs of links for which hulls decide, as named in `Contacts`."""
    links = spheres.links
    own = ((links[i], links[j]) for i, j in spheres.pairs[spheres.exact])
    base = ((links[g], spheres.base_links[b]) for g, b in np.argwhere(spheres.base_exact))
    return frozenset([*own, *base])
