"""States of an arm, sampled: which links cannot help touching, and where the arm may rest."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
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
    place_segments,
    scratch_of,
)
from momapos.model.kinematics import Chain, ChainArrays, SphereArrays, chain_arrays, one_turn

if TYPE_CHECKING:
    from collections.abc import Sequence

    from jaxtyping import Bool, Float, Int

SAMPLES = 2000
ALWAYS = 0.95
"""A pair of links that touch in this share of the states is never checked [-]."""
OFTEN = 0.1
"""Nor are neighbors that touch at rest, if they touch in this share of the states [-]: a rest at
which the arm is folded into itself says nothing about the shapes."""
MOSTLY = 0.5
"""Nor are neighbors in the arm that touch in this share of the states, whatever they do at rest
[-]: a wrist that could hardly turn would not have been built, its shapes are too coarse."""
UNWOUND = 0.05
"""Reach of the arm [m] that a radian less on its most turned joint is worth, at rest."""
LIMIT, NEAR_LIMIT = 0.1, 0.15
"""Reach that distance from all joint limits is worth [m], and how much distance [rad]."""
TIGHT, ROOM = 0.1, 0.02
"""Reach that room around the arm is worth, and how much room [m]."""
BLOCKED = 1.0
"""Reach that it is worth, at rest, to block no value of the joints that arms share [m]."""
SHARED = 15
"""Values of a joint that arms share; fewer of each where they share several [-]."""
_BEST = 100
"""States whose room is looked at [-]."""


@entry
def _touches(
    q: F2,
    chain: ChainArrays,
    spheres: SphereArrays,
    floor: bool,
) -> np.ndarray:
    """Which of the states (m, n) touch the robot itself or, where asked, the floor."""
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
    """Which states touch the robot itself or, where asked, the floor."""
    return _touches(q, chain_arrays(chain), spheres.arrays, floor)


def sample_states(chain: Chain, rng: np.random.Generator) -> Float[np.ndarray, "m n"]:
    """States of the arm: all zero (or the limit nearest to it), mid-range, then random ones.

    They are multiples of a milliradian or millimeter that lie within the limits, so that a file
    can hold them.
    """
    lower, upper = one_turn(chain)
    middle = (lower + upper) / 2
    lower, upper = np.minimum(lower + 1e-3, middle), np.maximum(upper - 1e-3, middle)
    ends = np.stack([np.clip(0.0, lower, upper), middle])
    return np.round(np.vstack([ends, rng.uniform(lower, upper, (SAMPLES - 2, chain.size))]), 3)


def inevitable_pairs(
    chain: Chain, spheres: Spheres, q: Float[np.ndarray, "m n"]
) -> dict[tuple[str, str], str]:
    """Pairs of links that touch in (almost) every state, or in the first and many as neighbors,
    or in most as neighbors in the arm.

    Their hulls decide: spheres of links that pass closely by each other always touch.

    Returns:
        The reason by pair, in MoveIt's words: "Always", or "Default" for two links at most two
        joints apart.
    """
    found: dict[tuple[str, str], str] = {}
    segment = dict(zip(spheres.links, spheres.segment.tolist(), strict=True))
    touching = contacts(chain, spheres, q)
    for (a, b), hit in zip(touching.pairs, touching.by_hulls.T, strict=True):
        if hit.mean() >= ALWAYS:
            found[a, b] = "Always"
        elif abs(segment[a] - segment.get(b, 0)) <= 2 and (
            (hit[0] and hit.mean() >= OFTEN) or (b in segment and hit.mean() >= MOSTLY)
        ):
            found[a, b] = "Default"
    return found


@dataclass(frozen=True)
class SelfCollisionShare:
    """How often a pair of links touches in sampled states of the arm."""

    links: tuple[str, str]
    by_spheres: float
    """Share of the states in which their spheres touch [-]."""
    by_hulls: float
    """Share of the states in which their hulls do [-]."""
    decided_by_hulls: bool
    """Whether the planner asks the hulls, the spheres being too coarse for this pair."""


def self_collision_shares(
    chain: Chain, spheres: Spheres, q: Float[np.ndarray, "m n"]
) -> tuple[SelfCollisionShare, ...]:
    """Tell which pairs of links block how many states, those that block most first.

    Args:
        chain: The arm.
        spheres: Its collision spheres.
        q: States, such as `sample_states` draws.

    Returns:
        The pairs that touch in any of the states.
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


def resting_state(
    chain: Chain, spheres: Spheres, q: Float[np.ndarray, "m n"], shared: Sequence[int] = ()
) -> tuple[Float[np.ndarray, " n"], float] | None:
    """The free state that keeps the arm nearest to the base's middle, for driving.

    What counts is the arm itself: neither the torso that carries it nor what else hangs there.
    Away from its limits, unwound, and with room to the robot are worth some reach; most is worth
    that another arm may move what both hang from while this one rests.

    Args:
        chain, spheres: The arm, and what it may touch.
        q: States to choose from.
        shared: Indices of the joints that other arms move as well, such as a torso's.

    Returns:
        The state, and how far the arm reaches from the base's origin [m]; None where all states
        touch something.
    """
    free = np.flatnonzero(~touches(chain, spheres, q, floor=True))
    if not len(free):
        return None
    own = _of_the_arm(chain, spheres)
    R, p = np.empty((chain.last + 1, 3, 3)), np.empty((chain.last + 1, 3))
    reach = np.empty(len(free))
    for row, i in enumerate(free):
        place_segments(q[i], np.zeros(3), chain_arrays(chain), R, p)
        segment = spheres.segment[own]
        middle = np.einsum("gij,gj->gi", R[segment], spheres.bound_center[own]) + p[segment]
        reach[row] = (np.hypot(middle[:, 0], middle[:, 1]) + spheres.bound_radius[own]).max()
    wound = np.where(chain.prismatic, 0.0, abs(q[free])).max(1)
    cost = reach + UNWOUND * wound + LIMIT * _at_limits(chain, q[free])
    if len(shared):
        cost += BLOCKED * _blocked(chain, spheres, q[free], shared)
    thick = replace(spheres, radius=spheres.radius + ROOM, bound_radius=spheres.bound_radius + ROOM)
    # Only the best are worth the look: a state with room beats a tighter one that is no better.
    best = np.argsort(cost, kind="stable")[:_BEST]
    cost[best] += TIGHT * touches(chain, thick, q[free[best]], floor=True)
    chosen = best[int(np.argmin(cost[best]))]
    return q[free[chosen]], float(reach[chosen])


def _blocked(
    chain: Chain, spheres: Spheres, q: Float[np.ndarray, "m n"], shared: Sequence[int]
) -> Float[np.ndarray, " m"]:
    """At which share of the values of some joints each state touches the robot or the floor."""
    lower, upper = one_turn(chain)
    count = max(2, round(SHARED ** (1 / len(shared))))
    values = np.array(list(product(*(np.linspace(lower[i], upper[i], count) for i in shared))))
    moved = np.repeat(q[:, None], len(values), axis=1)
    moved[:, :, list(shared)] = values
    touching = touches(chain, spheres, moved.reshape(-1, q.shape[1]), floor=True)
    return np.asarray(touching.reshape(len(q), -1).mean(1))


def _of_the_arm(chain: Chain, spheres: Spheres) -> Int[np.ndarray, " k"]:
    """Groups of spheres that the arm's first turning joint moves; all where there are none."""
    first = chain.first_turn + 1
    own = np.flatnonzero(spheres.segment >= first)
    return own if len(own) else np.arange(len(spheres.segment))


def _at_limits(chain: Chain, q: Float[np.ndarray, "m n"]) -> Float[np.ndarray, " m"]:
    """How near the turning joint nearest to a limit is to it, 0 (away) to 1 (at it)."""
    gap = np.where(chain.prismatic, np.inf, np.minimum(q - chain.lower, chain.upper - q))
    return np.clip(1.0 - gap.min(1) / NEAR_LIMIT, 0.0, 1.0)
