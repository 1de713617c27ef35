"""States in which an arm rests while the base drives: compact, and free of contact."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.compiled import F1, F2, entry
from momapos.model.collision import Spheres, contacts, place_arm, scratch_of
from momapos.model.kinematics import (
    Chain,
    ChainArrays,
    LoadArrays,
    SphereArrays,
    chain_arrays,
    one_turn,
    static_loads,
)

from .arm_states import touches

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

HEIGHT_COST = 0.4
"""Cost of a home state above the body, as protrusion from the footprint per height [-]: a doorway
is 0.8 m wide and 2 m high."""
REACH_COST = 0.2
"""Cost of the distance from the base's origin, as protrusion [-]: among the states above the
footprint the one near the middle is chosen."""
ANGLE_COST = 0.05
"""Cost of the most rotated joint of a home state, as protrusion per angle [m/rad]."""
LIMIT_COST, LIMIT_DISTANCE = 0.1, 0.15
"""Cost of a home state at a joint limit, as protrusion [m], and the distance over which it fades
[rad]."""
CLEARANCE_COST, CLEARANCE = 0.1, 0.02
"""Cost of a home state with less clearance, as protrusion [m], and that clearance [m]."""
OVERLOAD_COST = 1.0
"""Cost of a home state that a motor cannot hold or that tips the base over, as protrusion [m]:
more than any compactness, less than contact."""
NEAR_COST = 0.3
"""Cost of a pair of links of two arms whose spheres meet, as protrusion [m]. Hulls may decide for
the pair here and spheres in the view of the other arm, so such a state may block the other arm.
Costs count pairs, so that a pair that meets in every state changes no order."""
BLOCKED_COST = 3.0
"""Cost of a home state that blocks all heights of the torso, as protrusion [m]; larger than any
arm's reach, so that a state that blocks none comes first wherever there is one."""
TORSO_VALUES = 15
"""Number of values of the torso's joints that are checked [-]."""
ROUNDS, PARENTS, CHILDREN = 4, 40, 25
"""Rounds of refinement; in each the best states get children nearby. On seven library robots four
rounds cost at most 2.5 cm more than ten, and take 0.1 to 0.3 s."""
FIRST_STEP = 0.15
"""Largest step of the first round, as share of a joint's range [-]; each round halves it."""
APART = 0.15
"""Distance between the middles of the arm by which a second candidate differs [m]."""
_MAX_CLEARANCE_CHECKS = 100
"""Number of states whose clearance is checked [-]."""


@dataclass(frozen=True, eq=False)
class Body:
    """Outline of the robot without its arms."""

    footprint: Float[np.ndarray, "k 2"]
    """Convex, anticlockwise [m]."""
    height: float
    """Highest point of what no turning joint of an arm moves [m]."""
    loads: LoadArrays | None = None
    """What the arm and the base bear; None to ignore it."""


@dataclass(frozen=True, eq=False)
class RestingState:
    """A state free of contact in which an arm can rest."""

    q: Float[np.ndarray, " n"]
    protrusion: float
    """Distance by which the arm protrudes from the footprint [m]."""
    top: float
    """Highest point of the arm above the floor [m]."""
    blocked: float
    """Share of the torso's heights at which the arm touches something [-]."""


@entry
def _extents(
    q: F2, chain: ChainArrays, spheres: SphereArrays, first: int, normal: F2, offset: F1
) -> np.ndarray:
    """Return per state the protrusion, highest point, reach, and middle (x, y, z) of an arm."""
    scratch = scratch_of(len(chain.slides), spheres)
    R, p, _ = scratch
    base, out = np.zeros(3), np.zeros((len(q), 6))
    for i in range(len(q)):
        place_arm(q[i], base, chain, spheres, scratch)
        out[i, 0], out[i, 1], count = -np.inf, -np.inf, 0
        for g in range(len(spheres.segment)):
            s = spheres.segment[g]
            if s < first:
                continue
            for k in range(spheres.start[g], spheres.start[g + 1]):
                c, r = spheres.center[k], spheres.radius[k]
                x = R[s, 0, 0] * c[0] + R[s, 0, 1] * c[1] + R[s, 0, 2] * c[2] + p[s, 0]
                y = R[s, 1, 0] * c[0] + R[s, 1, 1] * c[1] + R[s, 1, 2] * c[2] + p[s, 1]
                z = R[s, 2, 0] * c[0] + R[s, 2, 1] * c[1] + R[s, 2, 2] * c[2] + p[s, 2]
                for e in range(len(offset)):
                    beyond = normal[e, 0] * x + normal[e, 1] * y - offset[e] + r
                    out[i, 0] = max(out[i, 0], beyond)
                out[i, 1] = max(out[i, 1], z + r)
                out[i, 2] = max(out[i, 2], np.sqrt(x * x + y * y) + r)
                out[i, 3] += x
                out[i, 4] += y
                out[i, 5] += z
                count += 1
        for k in range(3, 6):
            out[i, k] /= max(count, 1)
    return out


def resting_states(
    chain: Chain,
    spheres: Spheres,
    body: Body,
    q: Float[np.ndarray, "m n"],
    *,
    torso: Sequence[int] = (),
    held: Sequence[int] = (),
    crossing: Spheres | None = None,
    count: int = 1,
    rng: np.random.Generator,
) -> Iterator[RestingState]:
    """Yield states in which the arm rests, free of contact, the most compact first.

    Compact means within the footprint and not above the body. Only the links of the arm itself
    count, not the torso. Distance from joint limits, small angles and clearance reduce the cost a
    little; more weight has that motors and wheels bear it, most that the torso can move meanwhile.

    Args:
        chain, spheres: The arm, and its collision model.
        body: The robot without its arms.
        q: Candidates; states near the best ones are tried, too.
        torso: Indices of the joints that raise the arm.
        held: Indices of joints whose values are given.
        crossing: The collision model with pairs of links of two arms only; None for a single arm.
        count: Maximum number of states; further ones are elsewhere in space, and take time only
            when they are asked for.
        rng: For the states near the best ones.
    """
    ranking = _Ranking(chain, spheres, body, torso, crossing)
    first_step = FIRST_STEP * np.subtract(*reversed(one_turn(chain)))
    first_step[list(held)] = 0.0
    middles: list[np.ndarray] = []
    q, cost = ranking.rank(q, middles)
    for _ in range(count):
        step = first_step
        for _ in range(ROUNDS):
            near, its_cost = ranking.rank(_children(chain, q[:PARENTS], step, rng), middles)
            q, cost = np.vstack([q, near]), np.append(cost, its_cost)
            order = np.argsort(cost, kind="stable")
            q, cost, step = q[order], cost[order], step / 2
        if not len(q):
            return
        best, best_cost = q[:_MAX_CLEARANCE_CHECKS], cost[:_MAX_CLEARANCE_CHECKS]
        chosen = best[np.argmin(best_cost + CLEARANCE_COST * ranking.tight(best))]
        state, middle = ranking.state(chosen)
        yield state
        middles.append(middle)
        far = ranking.apart(q, middles[-1:])
        q, cost = q[far], cost[far]


@dataclass(frozen=True, eq=False)
class _Ranking:
    """Order of the states of an arm."""

    chain: Chain
    spheres: Spheres
    body: Body
    torso: Sequence[int]
    crossing: Spheres | None

    def rank(
        self, q: Float[np.ndarray, "m n"], middles: Sequence[Float[np.ndarray, "3"]]
    ) -> tuple[Float[np.ndarray, "k n"], Float[np.ndarray, " k"]]:
        """Return the states free of contact and apart from others, and their cost [m], sorted."""
        q = q[~touches(self.chain, self.spheres, q, floor=True)]
        q = q[self.apart(q, middles)]
        protrusion, top, reach, *_ = self._extents(q).T
        wound = np.where(self.chain.prismatic, 0.0, abs(q)).max(1, initial=0.0)
        above = np.maximum(top - self.body.height, self._rise(q))
        cost = np.maximum(protrusion, 0.0) + HEIGHT_COST * above + REACH_COST * reach
        cost += ANGLE_COST * wound + LIMIT_COST * _at_limits(self.chain, q)
        cost += OVERLOAD_COST * self._overloaded(q) + BLOCKED_COST * blocked_share(
            self.chain, self.spheres, q, self.torso
        )
        if self.crossing is not None:
            cost += NEAR_COST * contacts(self.chain, self.crossing, q).by_spheres.sum(1)
        order = np.argsort(cost, kind="stable")
        return q[order], cost[order]

    def apart(
        self, q: Float[np.ndarray, "m n"], middles: Sequence[Float[np.ndarray, "3"]]
    ) -> Bool[np.ndarray, " m"]:
        """Mark the states with the arm elsewhere than at the given middles."""
        if not middles:
            return np.ones(len(q), bool)
        away = self._extents(q)[:, None, 3:] - np.array(middles)
        return np.asarray((np.linalg.norm(away, axis=-1) > APART).all(1))

    def state(self, q: Float[np.ndarray, " n"]) -> tuple[RestingState, Float[np.ndarray, "3"]]:
        """Return a state with what is known of it, and the middle of the arm there [m]."""
        protrusion, top, _, *middle = self._extents(q[None])[0].tolist()
        blocked = float(blocked_share(self.chain, self.spheres, q[None], self.torso)[0])
        return RestingState(q, protrusion, top, blocked), np.array(middle)

    def _rise(self, q: Float[np.ndarray, "m n"]) -> Float[np.ndarray, " m"]:
        """Return how far the torso is raised [m]: a head may rise with it."""
        chain, torso = self.chain, list(self.torso)
        up = np.where(chain.prismatic, chain.h[chain.leads, 2], 0.0)[torso]
        ends = np.stack(one_turn(chain))[:, torso] * up
        return np.asarray((q[:, torso] * up - ends.min(0)).sum(1))

    def tight(self, q: Float[np.ndarray, "m n"]) -> Bool[np.ndarray, " m"]:
        """Mark the states with less clearance than `CLEARANCE`."""
        thick = replace(
            self.spheres,
            radius=self.spheres.radius + CLEARANCE,
            bound_radius=self.spheres.bound_radius + CLEARANCE,
        )
        return touches(self.chain, thick, q, floor=True)

    def _extents(self, q: Float[np.ndarray, "m n"]) -> Float[np.ndarray, "m 6"]:
        edge = np.roll(self.body.footprint, -1, 0) - self.body.footprint
        normal = np.stack([edge[:, 1], -edge[:, 0]], -1) / np.linalg.norm(edge, axis=1)[:, None]
        offset = np.einsum("ij,ij->i", normal, self.body.footprint)
        segment = self.spheres.segment
        first = self.chain.first_turn + 1
        first = first if (segment >= first).any() else 0  # all links if no joint turns
        return np.asarray(
            _extents(q, chain_arrays(self.chain), self.spheres.arrays, first, normal, offset)
        )

    def _overloaded(self, q: Float[np.ndarray, "m n"]) -> Float[np.ndarray, " m"]:
        """Return 0 for states that the robot bears, 0.5 to 1 for others."""
        if self.body.loads is None:
            return np.zeros(len(q))
        none = np.zeros((len(q), 3))
        _, _, excess, _ = static_loads(
            np.ascontiguousarray(q), chain_arrays(self.chain), self.body.loads, none, none
        )
        return np.where(excess > 0.0, 0.5 + 0.5 * np.clip(excess, 0.0, 1.0), 0.0)


def blocked_share(
    chain: Chain, spheres: Spheres, q: Float[np.ndarray, "m n"], torso: Sequence[int]
) -> Float[np.ndarray, " m"]:
    """Return the share of the torso's heights at which each state is in contact [-].

    Args:
        chain, spheres: The arm, and its collision model.
        q: States.
        torso: Indices of the joints that raise the arm; without any the states themselves count.
    """
    if not len(q):
        return np.zeros(0)
    lower, upper = one_turn(chain)
    count = max(2, round(TORSO_VALUES ** (1 / len(torso)))) if torso else 1
    ends = [np.linspace(lower[i], upper[i], count) for i in torso]
    values = np.array(list(product(*ends)))
    moved = np.repeat(q[:, None], len(values), axis=1)
    moved[:, :, list(torso)] = values
    touching = touches(chain, spheres, moved.reshape(-1, q.shape[1]), floor=True)
    return np.asarray(touching.reshape(len(q), -1).mean(1))


def _children(
    chain: Chain,
    parents: Float[np.ndarray, "p n"],
    step: Float[np.ndarray, " n"],
    rng: np.random.Generator,
) -> Float[np.ndarray, "k n"]:
    """Return states near some, within the limits and rounded as `sample_states` are."""
    lower, upper = one_turn(chain)
    middle = (lower + upper) / 2
    lower, upper = np.minimum(lower + 1e-3, middle), np.maximum(upper - 1e-3, middle)
    q = np.repeat(parents, CHILDREN, axis=0)
    moved = np.round(q + rng.uniform(-step, step, q.shape), 3)
    return np.where(step > 0, np.clip(moved, lower, upper), q)


def _at_limits(chain: Chain, q: Float[np.ndarray, "m n"]) -> Float[np.ndarray, " m"]:
    """Return how close a state's revolute joints are to a limit, 0 (far) to 1 (at it)."""
    gap = np.where(chain.prismatic, np.inf, np.minimum(q - chain.lower, chain.upper - q))
    return np.clip(1.0 - gap.min(1, initial=np.inf) / LIMIT_DISTANCE, 0.0, 1.0)
