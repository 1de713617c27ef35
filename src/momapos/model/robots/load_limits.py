"""What a robot bears at rest in a state, and its links in permanent contact.

Gravity acts on all links, and a force may act on the hand. Accelerations are not considered: the
margin below the effort limits is for them.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import owner_cache
from momapos.core.compiled import F2, entry
from momapos.core.geometry import apply, edge_normals
from momapos.model.collision import (
    FREE,
    Spheres,
    contacts,
    decided_by_hulls,
    hit_floor,
    hit_self,
    place_arm,
    scratch_of,
    surfaces_cross,
)
from momapos.model.kinematics import (
    BASE,
    Chain,
    ChainArrays,
    LoadArrays,
    Segments,
    SphereArrays,
    chain_arrays,
    one_turn,
    static_loads,
)
from momapos.model.records import MAX_EFFORT_SHARE, MIN_STABILITY, PoseOutcome, PoseStatus
from momapos.model.urdf import Articulated

from .robot import Robot
from .running_gear import support_outline

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int


_NO_EDGES = np.zeros((0, 2))


@dataclass(frozen=True, eq=False)
class StateLoads:
    """Loads of a robot at s states."""

    efforts: Float[np.ndarray, "s n"]
    """Torque or force of each degree of freedom [Nm] or [N]."""
    stability: Float[np.ndarray, " s"]
    """Distance of the zero moment point from the nearest edge of the area that the wheels stand on
    [m]; negative if the robot tips over, infinite where that is unknown."""
    excess: Float[np.ndarray, " s"]
    """By how much the worst joint, or else the base, exceeds its limit [-]."""
    where: Int[np.ndarray, " s"]
    """That degree of freedom, or BASE."""

    @property
    def refused(self) -> Bool[np.ndarray, " s"]:
        """Which states need more than a motor may exert, or tip the base over."""
        return np.asarray(self.excess > 0.0)


@dataclass(frozen=True, eq=False)
class RobotLoads:
    """A robot's masses, effort limits and wheels."""

    robot: Robot
    arrays: LoadArrays
    """Its limits are `MAX_EFFORT_SHARE` of those in the file."""
    notes: tuple[str, ...]
    """What the robot's files leave open, one line each."""

    def at(
        self,
        q: Float[np.ndarray, "s n"],
        force: Float[np.ndarray, "s 3"] | None = None,
        point: Float[np.ndarray, "s 3"] | None = None,
    ) -> StateLoads:
        """Return the loads at some states.

        Args:
            q: Values of the degrees of freedom.
            force: Force on the hand or on what it holds, in the base frame [N]; none by default.
            point: Where it acts, in the base frame [m].
        """
        none = np.zeros((len(q), 3))
        force, point = (np.ascontiguousarray(none if x is None else x) for x in (force, point))
        chain = chain_arrays(self.robot.chain)
        return StateLoads(*static_loads(np.ascontiguousarray(q), chain, self.arrays, force, point))

    def outcome(self, where: int, excess: float, at: str) -> PoseOutcome:
        """Return the outcome of a base pose whose worst state exceeds the limits.

        Args:
            where: A degree of freedom, or BASE.
            excess: By how much it exceeds its limit [-].
            at: Where on the motion, in words.
        """
        if where == BASE:
            return PoseOutcome(PoseStatus.TIPS_OVER, self.robot.title, at)
        chain = self.robot.chain
        limit = self.arrays.limit[where]
        unit = "N" if chain.prismatic[where] else "Nm"
        need = (1.0 + excess) * limit
        words = f"{need:.3g} of {limit / MAX_EFFORT_SHARE:.3g} {unit} at {at}"
        return PoseOutcome(PoseStatus.OVERLOAD, chain.names[where], words)

    def worst(self, loads: StateLoads, at: str) -> PoseOutcome | None:
        """Return the outcome for the worst of some states; None if the robot bears it."""
        state = int(loads.excess.argmax())
        if loads.excess[state] <= 0.0:
            return None
        return self.outcome(int(loads.where[state]), float(loads.excess[state]), at)


def robot_loads(robot: Robot) -> RobotLoads:
    """Return a robot's masses, effort limits and wheels, from its URDF; cached."""
    return _robot_loads(robot)


@owner_cache()
def _robot_loads(robot: Robot) -> RobotLoads:
    chain, notes = robot.chain, []
    arrays, why = load_arrays(robot.model, robot.base_link, chain, robot.segments)
    limited = zip(chain.names, np.isfinite(arrays.limit), strict=True)
    unknown = [name for name, known in limited if not known]
    if unknown:
        notes.append(f"no effort limit is known for {', '.join(unknown)}")
    if not arrays.mass[1:].any():
        notes.append("the arm's links have no masses, so only loads at the hand count")
    elif light := _weightless(robot, arrays):
        notes.append(f"no mass is known for {', '.join(light)}: what they weigh does not count")
    loads = RobotLoads(robot, arrays, tuple(notes))
    if not why and loads.at(robot.home[None]).stability[0] < MIN_STABILITY:
        why = "by the masses in its file the robot hardly stands at home"
        loads = replace(loads, arrays=arrays._replace(normals=_NO_EDGES, offsets=np.zeros(0)))
    return replace(loads, notes=(*notes, f"stability does not count: {why}")) if why else loads


def _weightless(robot: Robot, arrays: LoadArrays) -> list[str]:
    """Return links that have shapes and move, but have no mass, nor what is fixed to them."""
    segments = robot.segments.of_link.items()
    return [
        link for link, k in segments if k > 0 and not arrays.mass[k] and robot.model.hulls[link]
    ]


def load_arrays(
    model: Articulated, base_link: str, chain: Chain, segments: Segments
) -> tuple[LoadArrays, str]:
    """Return what an arm on a base bears, and "" or why it is unknown whether it tips over."""
    mass, center = _segment_masses(model, segments, chain.last + 1)
    limits = MAX_EFFORT_SHARE * np.array([model.joint(name).effort for name in chain.names])
    links = [link for link, segment in segments.of_link.items() if segment == 0]
    support = support_outline(model, base_link, links)
    arrays = LoadArrays(mass, center, limits, _NO_EDGES, np.zeros(0), MIN_STABILITY)
    if mass[0] <= 0:
        return arrays, "the base has no mass"
    if support is None:
        return arrays, "its wheels do not span an area on the floor, so casters may be missing"
    normals = edge_normals(support)
    return arrays._replace(normals=normals, offsets=(normals * support).sum(1)), ""


def _segment_masses(
    model: Articulated, segments: Segments, count: int
) -> tuple[Float[np.ndarray, " m_plus_1"], Float[np.ndarray, "m_plus_1 3"]]:
    """Return mass and center of mass of each segment of the arm, the base first."""
    mass, moment = np.zeros(count), np.zeros((count, 3))
    for link in model.urdf.links.values():
        at = segments.of_link[link.name]
        mass[at] += link.mass
        center = apply(segments.T_segment_link[link.name], np.array([link.center]))
        moment[at] += link.mass * center[0]
    return mass, moment / np.maximum(mass, 1e-12)[:, None]


SAMPLES = 2000
ALWAYS_SHARE = 0.95
"""Share of states in contact above which a pair of links is never checked [-]."""
NEIGHBOR_REST_SHARE = 0.1
"""Share of states in contact above which neighbors that also touch at rest are never checked [-];
contact at rest alone can come from an arm that is folded there."""
MAX_CROSSINGS = 20
"""Number of states with overlapping hulls in which the surfaces of two links are compared [-]."""
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


def crossing_shares(
    model: Articulated,
    chain: Chain,
    segments: Segments,
    spheres: Spheres,
    pairs: Collection[frozenset[str]],
    q: Float[np.ndarray, "m n"],
) -> dict[frozenset[str], float]:
    """Return in which share of states the surfaces of pairs of links cross [-].

    Args:
        model: The robot.
        chain, segments: Its arm.
        spheres: Its collision model, with these pairs.
        pairs: The pairs; only those that cross are returned.
        q: States.
    """
    found, shares = contacts(chain, spheres, q), dict[frozenset[str], float]()
    for names, hit in zip(found.pairs, found.by_hulls.T, strict=True):
        if hit.any() and frozenset(names) in pairs:
            states = q[hit][:MAX_CROSSINGS]
            share = surfaces_cross(model, chain, segments, spheres, names, states).mean()
            if share > 0.0:
                shares[frozenset(names)] = float(share * hit.mean())
    return shares


def most_crossing(shares: Mapping[frozenset[str], float]) -> str:
    """Return in words which pair of links crosses in most states."""
    pair = max(shares, key=lambda pair: (shares[pair], sorted(pair)))
    one, other = sorted(pair)
    more = f", and {len(shares) - 1} more pairs do" if len(shares) > 1 else ""
    return f"{one} and {other} overlap in {100 * shares[pair]:.2g} % of the arm's states{more}"


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
