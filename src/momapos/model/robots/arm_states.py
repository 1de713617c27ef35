"""Sampled states of an arm: links in permanent contact."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.compiled import F2, entry
from momapos.model.collision import (
    FREE,
    Spheres,
    contacts,
    decided_by_hulls,
    hit_floor,
    hit_self,
    place_arm,
    scratch_of,
)
from momapos.model.kinematics import Chain, ChainArrays, SphereArrays, chain_arrays, one_turn

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

SAMPLES = 2000
ALWAYS_SHARE = 0.95
"""Share of states in contact above which a pair of links is never checked [-]."""
NEIGHBOR_REST_SHARE = 0.1
"""Share of states in contact above which neighbors that also touch at rest are never checked [-];
contact at rest alone can come from an arm that is folded there."""
NEIGHBOR_SHARE = 0.5
"""Share of states in contact above which neighbors in the arm are never checked [-]; a wrist that
can hardly rotate has too coarse shapes."""


@entry
def _touches(
    q: F2,
    chain: ChainArrays,
    spheres: SphereArrays,
    floor: bool,
) -> np.ndarray:
    """Mark the states in self-collision or, with `floor`, in contact with the floor."""
    scratch = scratch_of(len(chain.slides), spheres)
    R, p, bounds = scratch
    base, out = np.zeros(3), np.empty(len(q), np.bool_)
    for i in range(len(q)):
        place_arm(q[i], base, chain, spheres, scratch)
        out[i] = hit_self(R, p, bounds, spheres) != FREE or (
            floor and hit_floor(R, p, bounds, spheres) != FREE
        )
    return out


def touches(
    chain: Chain, spheres: Spheres, q: Float[np.ndarray, "m n"], *, floor: bool = False
) -> Bool[np.ndarray, " m"]:
    """Mark the states in self-collision or, with `floor`, in contact with the floor."""
    return _touches(q, chain_arrays(chain), spheres.arrays, floor)


def sample_states(chain: Chain, rng: np.random.Generator) -> Float[np.ndarray, "m n"]:
    """Sample arm states: zero (clipped to the limits), mid-range, then random ones.

    Values are multiples of 1 mrad or 1 mm within the limits, so that a file can store them.
    """
    lower, upper = one_turn(chain)
    middle = (lower + upper) / 2
    lower, upper = np.minimum(lower + 1e-3, middle), np.maximum(upper - 1e-3, middle)
    ends = np.stack([np.clip(0.0, lower, upper), middle])
    return np.round(np.vstack([ends, rng.uniform(lower, upper, (SAMPLES - 2, chain.size))]), 3)


def inevitable_pairs(
    chain: Chain, spheres: Spheres, q: Float[np.ndarray, "m n"]
) -> dict[tuple[str, str], str]:
    """Return the pairs of links that touch in (almost) all states, or in many as neighbors.

    Convex hulls decide: spheres of links that pass close to each other always touch.

    Returns:
        The reason by pair, in MoveIt's terms: "Always", or "Default" for two links at most two
        joints apart.
    """
    found: dict[tuple[str, str], str] = {}
    segment = dict(zip(spheres.links, spheres.segment.tolist(), strict=True))
    touching = contacts(chain, spheres, q)
    for (a, b), hit in zip(touching.pairs, touching.by_hulls.T, strict=True):
        if hit.mean() >= ALWAYS_SHARE:
            found[a, b] = "Always"
        elif abs(segment[a] - segment.get(b, 0)) <= 2 and (
            (hit[0] and hit.mean() >= NEIGHBOR_REST_SHARE)
            or (b in segment and hit.mean() >= NEIGHBOR_SHARE)
        ):
            found[a, b] = "Default"
    return found


@dataclass(frozen=True)
class SelfCollisionShare:
    """Share of sampled states in which two links touch."""

    links: tuple[str, str]
    by_spheres: float
    """Share of states with contact by spheres [-]."""
    by_hulls: float
    """Share of states with contact by hulls [-]."""
    decided_by_hulls: bool
    """Whether the planner checks hulls, because the spheres are too coarse for this pair."""


def self_collision_shares(
    chain: Chain, spheres: Spheres, q: Float[np.ndarray, "m n"]
) -> tuple[SelfCollisionShare, ...]:
    """Return how many states each pair of links blocks, most blocking first.

    Args:
        chain: The arm.
        spheres: Its collision spheres.
        q: States, for example from `sample_states`.

    Returns:
        The pairs that touch in at least one state.
    """
    touching = contacts(chain, spheres, q)
    exact = decided_by_hulls(spheres)
    shares = [
        SelfCollisionShare(pair, float(seen.mean()), float(true.mean()), pair in exact)
        for pair, seen, true in zip(
            touching.pairs, touching.by_spheres.T, touching.by_hulls.T, strict=True
        )
        if seen.any()
    ]
    return tuple(sorted(shares, key=lambda share: (-share.by_spheres, share.links)))
