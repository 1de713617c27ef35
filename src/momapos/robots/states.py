"""States of an arm, sampled: which links cannot help touching, and where the arm may rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from momapos.compiled import F2, entry
from momapos.kinematics.articulated import Articulated
from momapos.kinematics.chain import Chain, chain_arrays
from momapos.kinematics.collision import (
    FREE,
    hit_floor,
    hit_self,
    place_arm,
    place_segments,
    scratch_of,
)
from momapos.kinematics.records import ChainArrays, SphereArrays
from momapos.kinematics.spheres import Spheres

SAMPLES = 2000
ALWAYS = 0.95
"""A pair of links that touch in this share of the states is never checked [-]."""
UNWOUND = 0.05
"""Reach of the arm [m] that a radian less on its most turned joint is worth, at rest."""


@entry
def _touches(
    q: F2,
    chain: ChainArrays,
    spheres: SphereArrays,
    floor: bool,
) -> np.ndarray:
    """Which of the states (m, n) touch the robot itself or, where asked, the floor."""
    scratch = scratch_of(q.shape[1], spheres)
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
    """Which states touch the robot itself or, where asked, the floor."""
    return _touches(q, chain_arrays(chain), spheres.arrays(), floor)


def sample_states(chain: Chain, rng: np.random.Generator) -> Float[np.ndarray, "m n"]:
    """States of the arm: all zero (or the limit nearest to it), mid-range, then random ones.

    They are multiples of a milliradian or millimetre that lie within the limits, so that a file
    can hold them.
    """
    lower, upper = np.maximum(chain.lower, -np.pi), np.minimum(chain.upper, np.pi)
    middle = (lower + upper) / 2
    lower, upper = np.minimum(lower + 1e-3, middle), np.maximum(upper - 1e-3, middle)
    ends = np.stack([np.clip(0.0, lower, upper), middle])
    return np.round(np.vstack([ends, rng.uniform(lower, upper, (SAMPLES - 2, chain.size))]), 3)


def inevitable_pairs(
    chain: Chain, spheres: Spheres, q: Float[np.ndarray, "m n"], model: Articulated
) -> dict[tuple[str, str], str]:
    """Pairs of links that touch in (almost) every state, or in the first one as near neighbours.

    Returns:
        The reason by pair, in MoveIt's words: "Always", or "Default" for two links at most two
        joints apart.
    """
    found: dict[tuple[str, str], str] = {}
    base_links = [
        link
        for link in model.links
        for _ in range(sum(len(b) for b in model.boxes[link]))
        if link not in spheres.links
    ]
    none = np.zeros_like(spheres.base_pairs)
    for i, j in spheres.pairs:
        one = _only(spheres, np.array([[i, j]]), none)
        near = abs(int(spheres.segment[i]) - int(spheres.segment[j])) <= 2
        _judge(found, touches(chain, one, q), (spheres.links[i], spheres.links[j]), near)
    for g, link in enumerate(spheres.links):
        for name in dict.fromkeys(base_links):
            mask = none.copy()
            mask[g] = spheres.base_pairs[g] & (np.array(base_links) == name)
            one = _only(spheres, np.zeros((0, 2), np.int64), mask)
            _judge(found, touches(chain, one, q), (name, link), bool(spheres.segment[g] <= 2))
    return found


def _only(spheres: Spheres, pairs: np.ndarray, base_pairs: np.ndarray) -> Spheres:
    return replace(spheres, pairs=pairs, base_pairs=base_pairs)


def _judge(
    found: dict[tuple[str, str], str], hit: np.ndarray, pair: tuple[str, str], near: bool
) -> None:
    if hit.mean() >= ALWAYS:
        found[pair] = "Always"
    elif near and hit[0]:
        found[pair] = "Default"


def resting_state(
    chain: Chain, spheres: Spheres, q: Float[np.ndarray, "m n"]
) -> tuple[Float[np.ndarray, " n"], float] | None:
    """The free state that keeps the arm nearest to the base's middle, and unwound, for driving.

    Returns:
        The state, and how far the arm reaches from the base's origin [m]; None where all states
        touch something.
    """
    free = ~touches(chain, spheres, q, floor=True)
    R, p = np.empty((chain.size + 1, 3, 3)), np.empty((chain.size + 1, 3))
    reach = np.full(len(q), np.inf)
    for i in np.flatnonzero(free):
        place_segments(q[i], np.zeros(3), chain_arrays(chain), R, p)
        centers = np.einsum("gij,gj->gi", R[spheres.segment], spheres.bound_center)
        middle = centers + p[spheres.segment]
        reach[i] = (np.hypot(middle[:, 0], middle[:, 1]) + spheres.bound_radius).max()
    best = int(np.argmin(reach + UNWOUND * abs(q).max(1)))
    return (q[best], float(reach[best])) if free.any() else None


def srdf_text(name: str, pairs: dict[tuple[str, str], str]) -> str:
    """Write an SRDF that disables pairs of links, each with its reason."""
    lines = [
        f'  <disable_collisions link1="{a}" link2="{b}" reason="{why}"/>'
        for (a, b), why in pairs.items()
    ]
    return "\n".join([f'<robot name="{name}">', *lines, "</robot>", ""])
