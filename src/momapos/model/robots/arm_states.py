"""Sampled states of an arm: links in permanent contact, and a home state."""

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
ALWAYS_SHARE = 0.95
"""Share of states in contact above which a pair of links is never checked [-]."""
NEIGHBOR_REST_SHARE = 0.1
"""Share of states in contact above which neighbors that also touch at rest are never checked [-];
contact at rest alone can come from an arm that is folded there."""
NEIGHBOR_SHARE = 0.5
"""Share of states in contact above which neighbors in the arm are never checked [-]; a wrist that
can hardly rotate has too coarse shapes."""
ANGLE_COST = 0.05
"""Cost of the most rotated joint of a home state, as reach per angle [m/rad]."""
LIMIT_COST, LIMIT_DISTANCE = 0.1, 0.15
"""Cost of a home state at a joint limit, as reach [m], and the distance over which it fades
[rad]."""
CLEARANCE_COST, CLEARANCE = 0.1, 0.02
"""Cost of a home state with less clearance, as reach [m], and that clearance [m]."""
BLOCKED_COST = 1.0
"""Cost of a home state that blocks all values of the joints that arms share, as reach [m]."""
SHARED_VALUES = 15
"""Number of values of the shared joints that are checked [-]."""
_MAX_CLEARANCE_CHECKS = 100
"""Number of states whose clearance is checked [-]."""


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


def resting_state(
    chain: Chain, spheres: Spheres, q: Float[np.ndarray, "m n"], shared: Sequence[int] = ()
) -> tuple[Float[np.ndarray, " n"], float] | None:
    """Return the collision-free state with the arm closest to the base's center, for driving.

    Only the links of the arm itself count, not the torso. Distance from joint limits, small angles
    and clearance reduce the cost a little; most weight has that another arm can move the joints
    both share while this arm is at home.

    Args:
        chain, spheres: The arm, and its collision model.
        q: Candidate states.
        shared: Indices of joints that other arms move, too, such as a torso's.

    Returns:
        The state, and the reach of the arm from the base's origin [m]; None without a
        collision-free state.
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
    cost = reach + ANGLE_COST * wound + LIMIT_COST * _at_limits(chain, q[free])
    if len(shared):
        cost += BLOCKED_COST * _blocked(chain, spheres, q[free], shared)
    thick = replace(
        spheres, radius=spheres.radius + CLEARANCE, bound_radius=spheres.bound_radius + CLEARANCE
    )
    # Clearance is expensive, so only the best states are checked.
    best = np.argsort(cost, kind="stable")[:_MAX_CLEARANCE_CHECKS]
    cost[best] += CLEARANCE_COST * touches(chain, thick, q[free[best]], floor=True)
    chosen = best[int(np.argmin(cost[best]))]
    return q[free[chosen]], float(reach[chosen])


def _blocked(
    chain: Chain, spheres: Spheres, q: Float[np.ndarray, "m n"], shared: Sequence[int]
) -> Float[np.ndarray, " m"]:
    """Return the share of shared joint values at which each state is in contact."""
    lower, upper = one_turn(chain)
    count = max(2, round(SHARED_VALUES ** (1 / len(shared))))
    values = np.array(list(product(*(np.linspace(lower[i], upper[i], count) for i in shared))))
    moved = np.repeat(q[:, None], len(values), axis=1)
    moved[:, :, list(shared)] = values
    touching = touches(chain, spheres, moved.reshape(-1, q.shape[1]), floor=True)
    return np.asarray(touching.reshape(len(q), -1).mean(1))


def _of_the_arm(chain: Chain, spheres: Spheres) -> Int[np.ndarray, " k"]:
    """Return the sphere groups beyond the first revolute joint; all if there are none."""
    first = chain.first_turn + 1
    own = np.flatnonzero(spheres.segment >= first)
    return own if len(own) else np.arange(len(spheres.segment))


def _at_limits(chain: Chain, q: Float[np.ndarray, "m n"]) -> Float[np.ndarray, " m"]:
    """Return how close a state's revolute joints are to a limit, 0 (far) to 1 (at it)."""
    gap = np.where(chain.prismatic, np.inf, np.minimum(q - chain.lower, chain.upper - q))
    return np.clip(1.0 - gap.min(1) / LIMIT_DISTANCE, 0.0, 1.0)
