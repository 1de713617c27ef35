"""Which pairs of a robot's links touch, by spheres and by hulls, and which of the two decides.

Spheres are fast and keep some distance. But where two links pass a few millimeters from each other,
as those next to a common joint do, spheres see contact in states that are free. Such pairs
are left to the hulls.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.compiled import B2, F2, I2, entry
from momapos.model.kinematics import (
    Chain,
    ChainArrays,
    Segments,
    SphereArrays,
    chain_arrays,
    one_turn,
)
from momapos.model.urdf import Articulated

from .arm_collision import APART, MEET, meeting, meeting_base, place_arm, scratch_of
from .hull_overlap import hulls_overlap
from .spheres import Spheres, build_spheres

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

SAMPLES = 2000
"""States in which spheres are held against hulls [-]."""
TOO_MANY = 0.02
"""Share of the states that spheres may block where hulls do not [-]."""


@dataclass(frozen=True)
class Contacts:
    """Which pairs of links touch in which states."""

    pairs: tuple[tuple[str, str], ...]
    """Names of the links: pairs of the arm, then the arm's with the base's."""
    by_spheres: Bool[np.ndarray, "m pairs"]
    """They meet, or their hulls do."""
    by_hulls: Bool[np.ndarray, "m pairs"]


@entry
def _contacts(
    q: F2,
    chain: ChainArrays,
    spheres: SphereArrays,
    column: I2,
    by_spheres: B2,
    by_hulls: B2,
) -> None:
    """Fill the columns of `Contacts`; those of groups and boxes of the base are in `column`."""
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


def contacts(chain: Chain, spheres: Spheres, q: Float[np.ndarray, "m n"]) -> Contacts:
    """Say which of the robot's pairs of links touch, by spheres and by hulls."""
    pairs = [(spheres.links[i], spheres.links[j]) for i, j in spheres.pairs]
    against, column = _with_base(spheres)
    pairs += against
    by_spheres, by_hulls = np.zeros((2, len(q), len(pairs)), bool)
    _contacts(
        np.ascontiguousarray(q), chain_arrays(chain), spheres.arrays, column, by_spheres, by_hulls
    )
    return Contacts(tuple(pairs), by_spheres, by_hulls)


def _with_base(spheres: Spheres) -> tuple[list[tuple[str, str]], np.ndarray]:
    """Pairs of a link and one of the base's, and which pair each group and box belong to."""
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
    """Cover a robot's arm with spheres, and leave to its hulls the pairs they are too coarse for.

    Args:
        model: The robot.
        chain: Its arm.
        segments: Which link moves with which joint.
        disabled: Pairs of links whose contact is never checked (SRDF).
        gripper_links: Links that may touch what is grasped.
    """
    return decided(chain, build_spheres(model, segments, disabled, gripper_links))


def decided(chain: Chain, spheres: Spheres) -> Spheres:
    """Leave to hulls the pairs that spheres are wrong about too often in states of the arm."""
    q = np.random.default_rng(0).uniform(*one_turn(chain), (SAMPLES, chain.size))
    return left_to_hulls(spheres, contacts(chain, spheres, q))


def left_to_hulls(spheres: Spheres, found: Contacts) -> Spheres:
    """Let hulls decide the pairs that spheres are wrong about too often.

    Of the pairs, the one that blocks most of the free states goes first, until at most `TOO_MANY`
    of all states are blocked without need.

    Args:
        spheres: The robot.
        found: Its contacts in sampled states.
    """
    exact = np.zeros(len(found.pairs), bool)
    free = found.by_spheres[~found.by_hulls.any(1)]
    while free.any(1).sum() > TOO_MANY * len(found.by_hulls):
        coarsest = free.sum(0).argmax()
        exact[coarsest], free[:, coarsest] = True, False
    _, column = _with_base(spheres)
    # What is never checked has column -1, the last one.
    of_base = np.append(exact, False)[column]
    return replace(spheres, exact=exact[: len(spheres.pairs)], base_exact=of_base)


def decided_by_hulls(spheres: Spheres) -> frozenset[tuple[str, str]]:
    """The pairs of links that hulls decide, as `Contacts` names them."""
    links = spheres.links
    own = ((links[i], links[j]) for i, j in spheres.pairs[spheres.exact])
    base = ((links[g], spheres.base_links[b]) for g, b in np.argwhere(spheres.base_exact))
    return frozenset([*own, *base])
