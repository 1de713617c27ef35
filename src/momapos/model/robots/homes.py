"""Home states of all arms of a robot: states of rest, compact and free of contact."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import RobotError
from momapos.core.compiled import F1, F2, entry
from momapos.core.geometry import invert
from momapos.model.collision import (
    Spheres,
    build_spheres,
    choose_exact_pairs,
    contacts,
    neighbors,
    place_arm,
    scratch_of,
)
from momapos.model.kinematics import (
    Chain,
    ChainArrays,
    LoadArrays,
    SphereArrays,
    build_chain,
    chain_arrays,
    one_turn,
    static_loads,
)
from momapos.model.urdf import Articulated

from .base_guess import base_links
from .gripper_guess import listed, points_of
from .joint_tree import ArmChain
from .load_limits import (
    crossing_shares,
    inevitable_pairs,
    load_arrays,
    most_crossing,
    sample_states,
    touches,
)
from .robot_text import ArmText
from .srdf import Srdf, claims

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
UPRIGHT_COST = 1.0
"""Cost of the most turned joint that arms share, as protrusion per angle [m/rad]: with 0.3, a torso
leaned by 0.15 rad for arms that are hardly more compact there."""
MAX_MIRROR_ERROR = 0.02
"""Largest distance of joints of two arms from mirror images [m]."""
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
class RobotBody:
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
    body: RobotBody,
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
    fewest = max(PARENTS, _MAX_CLEARANCE_CHECKS)
    first_step = FIRST_STEP * np.subtract(*reversed(one_turn(chain)))
    first_step[list(held)] = 0.0
    middles: list[np.ndarray] = []
    q = ranking.free(q, middles)
    cost, whole = ranking.cost(q), np.zeros(len(q), bool)
    for _ in range(count):
        step = first_step
        q, cost, whole = ranking.ranked(q, cost, whole, fewest)
        for _ in range(ROUNDS):
            near = ranking.free(_children(chain, q[:PARENTS], step, rng), middles)
            q, cost = np.vstack([q, near]), np.append(cost, ranking.cost(near))
            whole = np.append(whole, np.zeros(len(near), bool))
            q, cost, whole = ranking.ranked(q, cost, whole, fewest)
            step = step / 2
        if not len(q):
            return
        best, best_cost = q[:_MAX_CLEARANCE_CHECKS], cost[:_MAX_CLEARANCE_CHECKS]
        chosen = best[np.argmin(best_cost + CLEARANCE_COST * ranking.tight(best))]
        state, middle = ranking.state(chosen)
        yield state
        middles.append(middle)
        far = ranking.apart(q, middles[-1:])
        q, cost, whole = q[far], cost[far], whole[far]


def resting_state(
    chain: Chain, spheres: Spheres, body: RobotBody, q: Float[np.ndarray, " n"],
    torso: Sequence[int],
) -> RestingState:  # fmt: skip
    """Return a state with what is known of it; see `resting_states` for the arguments."""
    return _Ranking(chain, spheres, body, torso, None).state(q)[0]


@dataclass(frozen=True, eq=False)
class _Ranking:
    """Order of the states of an arm."""

    chain: Chain
    spheres: Spheres
    body: RobotBody
    torso: Sequence[int]
    crossing: Spheres | None

    def free(
        self, q: Float[np.ndarray, "m n"], middles: Sequence[Float[np.ndarray, "3"]]
    ) -> Float[np.ndarray, "k n"]:
        """Return the states free of contact and apart from others."""
        q = q[~touches(self.chain, self.spheres, q, floor=True)]
        return q[self.apart(q, middles)]

    def ranked(
        self,
        q: Float[np.ndarray, "m n"],
        cost: Float[np.ndarray, " m"],
        whole: Bool[np.ndarray, " m"],
        fewest: int,
    ) -> tuple[Float[np.ndarray, "m n"], Float[np.ndarray, " m"], Bool[np.ndarray, " m"]]:
        """Sort states by cost, and complete the costs of the first ones.

        The heights of a torso take most of the time, and contact there only adds to the cost. So it
        is computed in the order of the rest of the cost, until the first states are known.

        Args:
            q, cost: The states and their costs [m].
            whole: Whether a cost is complete.
            fewest: Number of first states whose costs must be complete [-].
        """
        while True:
            order = np.argsort(cost, kind="stable")
            q, cost, whole = q[order], cost[order], whole[order]
            rows = np.flatnonzero(~whole[:fewest])
            if not len(rows):
                return q, cost, whole
            cost[rows] += BLOCKED_COST * blocked_share(
                self.chain, self.spheres, q[rows], self.torso
            )
            whole[rows] = True

    def cost(self, q: Float[np.ndarray, "m n"]) -> Float[np.ndarray, " m"]:
        """Return the cost of states [m], without that of contact at other heights of the torso."""
        protrusion, top, reach, *_ = self._extents(q).T
        wound = np.where(self.chain.prismatic, 0.0, abs(q)).max(1, initial=0.0)
        above = np.maximum(top - self.body.height, self._rise(q))
        cost = np.maximum(protrusion, 0.0) + HEIGHT_COST * above + REACH_COST * reach
        cost += ANGLE_COST * wound + LIMIT_COST * _at_limits(self.chain, q)
        turning = [k for k in self.torso if not self.chain.prismatic[k]]
        cost += UPRIGHT_COST * abs(q[:, turning]).max(1, initial=0.0)
        cost += OVERLOAD_COST * self._overloaded(q)
        if self.crossing is not None:
            cost += NEAR_COST * contacts(self.chain, self.crossing, q).by_spheres.sum(1)
        return np.asarray(cost)

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


NESTED = "Nested"
"""Reason in our SRDFs for pairs of telescope stages."""


def nested_pairs(
    model: Articulated, chain: ArmChain, spheres: Spheres
) -> dict[tuple[str, str], str]:
    """Return the pairs of a telescope's stages and its carrier, whose hulls overlap by design."""
    slides = {name for follower, mimic in chain.coupled for name in (follower, mimic.joint)}
    joints = [model.joint(name) for name in slides]
    stages = {joint.child for joint in joints} | {joint.parent for joint in joints}
    above = {joint.child: joint.parent for joint in model.urdf.joints if not joint.movable}
    for link in tuple(stages):
        while (link := above.get(link, "")) and link not in stages:
            stages.add(link)
    return {pair: NESTED for pair in checked_pairs(spheres) if stages.issuperset(pair)}


def checked_pairs(spheres: Spheres) -> list[tuple[str, str]]:
    """Return the pairs of links that a collision model checks."""
    links = spheres.links
    moving = [(links[i], links[j]) for i, j in spheres.pairs.tolist()]
    base = [(links[g], spheres.base_links[b]) for g, b in np.argwhere(spheres.base_pairs).tolist()]
    return [*moving, *base]


def rigid_pairs(
    model: Articulated, chain: Chain, spheres: Spheres, srdf: Srdf
) -> dict[tuple[str, str], str]:
    """Return the pairs of links that touch at rest and that no arm joint moves relatively."""
    joined, links = neighbors(model), spheres.links
    i, j = np.triu_indices(len(links), 1)
    rows = np.flatnonzero((spheres.segment[i] == spheres.segment[j]) & (spheres.segment[i] > 0))
    pairs = np.array([
        (a, b)
        for a, b in zip(i[rows].tolist(), j[rows].tolist(), strict=True)
        if not joined(links[a], links[b]) and frozenset((links[a], links[b])) not in srdf.disabled
    ], np.int64).reshape(-1, 2)  # fmt: skip
    alone = replace(
        spheres,
        pairs=pairs,
        exact=np.zeros(len(pairs), bool),
        base_pairs=np.zeros_like(spheres.base_pairs),
    )
    found = contacts(chain, alone, np.clip(np.zeros((1, chain.size)), chain.lower, chain.upper))
    return {pair: "Always" for pair, hit in zip(found.pairs, found.by_hulls[0], strict=True) if hit}


def without(spheres: Spheres, pairs: Collection[tuple[str, str]]) -> Spheres:
    """Return the collision model without checks of some pairs of links."""
    never = {frozenset(pair) for pair in pairs}
    links = spheres.links
    keep = np.array([frozenset((links[i], links[j])) not in never for i, j in spheres.pairs], bool)
    free = np.array(
        [[frozenset((a, b)) in never for b in spheres.base_links] for a in links], bool
    ).reshape(spheres.base_pairs.shape)
    return replace(
        spheres,
        pairs=spheres.pairs[keep],
        exact=spheres.exact[keep],
        base_pairs=spheres.base_pairs & ~free,
    )


def true_claims(
    model: Articulated,
    base_link: str,
    arms: Sequence[ArmToRest],
    srdf: Srdf,
    seed: int,
    notes: list[str],
) -> Srdf:
    """Return an SRDF without the pairs that it says never touch, but that do in sampled states.

    Args:
        model: The robot.
        base_link: Link on the floor.
        arms: Its arms.
        srdf: The SRDF; returned unchanged if all is true.
        seed: Seed of the sampled states.
        notes: Receives what is not true.

    Raises:
        RobotError: It disables all pairs that an arm moves, and some of them touch.
    """
    claimed = claims(srdf.reasons)
    false: dict[frozenset[str], float] = {}
    for arm in arms if srdf.disabled else ():
        chain, segments = build_chain(model, base_link, arm.text.tool_link, arm.text.joints)
        spheres = build_spheres(model, segments, (), arm.text.gripper_links)
        every = set(checked_pairs(spheres))
        q = sample_states(chain, np.random.default_rng(seed))
        everything = srdf.disabled.issuperset(map(frozenset, every))
        pairs = srdf.disabled if everything else claimed
        spheres = without(spheres, {pair for pair in every if frozenset(pair) not in pairs})
        shares = crossing_shares(model, chain, segments, spheres, pairs, q)
        if everything and shares:
            raise RobotError(
                f"{srdf.path}: disables all {len(every)} pairs of links that the arm moves, but "
                f"{most_crossing(shares)}; remove the pairs that touch, or the file"
            )
        false |= {pair: max(share, false.get(pair, 0.0)) for pair, share in shares.items()}
    if not false:
        return srdf
    notes.append(
        f"IMPORTANT: self-collision: {srdf.path} says that they never touch, but "
        f"{most_crossing(false)}; they are checked"
    )
    reasons = {pair: why for pair, why in srdf.reasons.items() if frozenset(pair) not in false}
    return replace(srdf, reasons=reasons, disabled=srdf.disabled.difference(false))


CANDIDATES = 4
"""Number of home states of an arm that are tried, if another arm cannot rest next to it [-]."""
GAPS = (0.02, 0.01, 0.005, 0.0)
"""Distances from contact that are told apart where spheres refuse a home [m]."""
Pairs = dict[tuple[str, str], str]


@dataclass(frozen=True)
class Homes:
    """Where the arms of a robot rest."""

    states: Mapping[str, Float[np.ndarray, " n"]]
    """By arm."""
    model: Articulated
    """The robot; if it has several arms, they rest at home."""
    pairs: Pairs
    """Pairs of links in contact by design with the reason, for an SRDF."""


@dataclass(frozen=True)
class ArmToRest:
    """An arm without a home."""

    name: str
    chain: ArmChain
    text: ArmText


def find_homes(
    model: Articulated,
    base_link: str,
    arms: Sequence[ArmToRest],
    footprint: Float[np.ndarray, "k 2"],
    srdf: Srdf,
    seed: int,
    notes: list[str],
    report: Callable[[float, str], None],
    given: Mapping[str, Float[np.ndarray, " n"]],
) -> Homes:
    """Find a home for every arm, so that all are compact, free of contact, and let a torso move.

    The arms get their homes in turn, each next to the homes before. A home is free if the planner
    accepts it for its arm with all other arms at home. Where one is not, an arm takes its next
    candidate; if no candidates are free, those with contact at the fewest heights of the torso
    remain and, among these, those that are farthest from contact.

    Args:
        model: The robot.
        base_link: Link on the floor.
        arms: Its arms.
        footprint: Outline of the base, anticlockwise [m].
        srdf: Its known pairs of links, and named states.
        seed: Seed of the sampled states.
        notes: Receives the assumptions.
        report: Receives the completed share of the work, and the arm.
        given: The homes of arms that have one.
    """
    search = _Search(model, base_link, arms, footprint, srdf, seed, given)
    pairs = search.pairs(report)
    found = search.rest((), pairs)
    held = dict(model.held)
    for arm, home in zip(arms, found, strict=True):
        of_arm = f"{arm.name}: " if arm.name else ""
        notes.append(_note(of_arm, home, shared=len(arms) > 1))
        if len(arms) > 1:
            held |= _values(arm, home)
    states = {arm.name: home.q for arm, home in zip(arms, found, strict=True)}
    return Homes(states, model.changed(held=held), pairs)


@dataclass(frozen=True, eq=False)
class _Home:
    q: Float[np.ndarray, " n"]
    state: RestingState | None
    """None if no state is free of contact."""
    gap: float = GAPS[0]
    """Distance from contact [m], at most the largest of `GAPS`; negative in contact."""

    @property
    def flaw(self) -> float:
        """Return the share of torso heights in contact, 2 if there is no free state."""
        return 2.0 if self.state is None else self.state.blocked


def _values(arm: ArmToRest, home: _Home) -> dict[str, float]:
    return dict(zip(arm.text.joints, map(float, home.q), strict=True))


def _note(of_arm: str, home: _Home, *, shared: bool) -> str:
    if home.state is None:
        return f"IMPORTANT: {of_arm}home: found no state free of self-collision; set home"
    state = home.state
    where = (
        f"within {state.protrusion:.2f} m of the footprint"
        if state.protrusion > 0
        else "above the footprint"
    )
    at = f"{100 * state.blocked:.0f} % of the torso's heights"
    if state.blocked and shared:
        far = f"at least {1000 * home.gap:.0f} mm" if home.gap > 0 else "hardly"
        how = "is in contact" if home.gap < 0 else f"is {far} from contact, too near for planning,"
        return (
            f"IMPORTANT: {of_arm}home: {listed(state.q)} {how} at {at}; no better state was found"
        )
    touches = f"; in contact at {at}, if it moves alone" if state.blocked else ""
    keeps = f"keeps the arm {where} and below {state.top:.2f} m"
    return f"{of_arm}home: {listed(state.q)} {keeps}{touches}"


@dataclass(frozen=True, eq=False)
class _Search:
    model: Articulated
    base_link: str
    arms: Sequence[ArmToRest]
    footprint: Float[np.ndarray, "k 2"]
    srdf: Srdf
    seed: int
    given: Mapping[str, Float[np.ndarray, " n"]]

    def pairs(self, report: Callable[[float, str], None]) -> Pairs:
        """Return the pairs of links in contact by design.

        Where the other arms are decides which of their links an arm touches, so a pair of links
        of two arms counts only if the states of either arm show it.
        """
        found: dict[frozenset[str], tuple[tuple[str, str], str]] = {}
        seen: list[set[frozenset[str]]] = []
        for index, arm in enumerate(self.arms):
            report(index / len(self.arms), f"states of the arm {arm.name}")
            chain, spheres, _ = self._collision(arm, {})
            q = self._samples(arm, chain, {})
            mine = inevitable_pairs(chain, spheres, q)
            mine |= nested_pairs(self.model, arm.chain, spheres)
            mine |= rigid_pairs(self.model, chain, spheres, self.srdf)
            seen.append({frozenset(pair) for pair in mine})
            found |= {frozenset(pair): (pair, why) for pair, why in mine.items()}
        own = [self._own_links(arm) for arm in self.arms]
        kept: Pairs = {}
        for key, (pair, why) in found.items():
            owners = [k for k, links in enumerate(own) if key & links]
            if len(owners) < 2 or all(key in seen[k] for k in owners):
                kept[pair] = why
        return kept

    def rest(self, before: tuple[_Home, ...], pairs: Pairs) -> tuple[_Home, ...]:
        """Return homes of all arms, given those of the first ones: the least flawed found."""
        if len(before) == len(self.arms):
            return self._checked(before, pairs)
        best: tuple[_Home, ...] = ()
        for home in self._candidates(before, pairs):
            homes = self.rest((*before, home), pairs)
            if not best or _flaw(homes) < _flaw(best):
                best = homes
            if not any(home.flaw for home in homes) or home.flaw:
                break  # further candidates of this arm are worse themselves
        return best

    def _checked(self, homes: tuple[_Home, ...], pairs: Pairs) -> tuple[_Home, ...]:
        """Return the homes, each checked with all other arms at home, as the last one is already.

        An arm is spheres and the others are boxes, and the other arms decide for which pairs of
        links hulls count, so that a home may be free for one arm and block another.
        """
        return (*(self._seen_by(k, homes, pairs) for k in range(len(homes) - 1)), homes[-1])

    def _seen_by(self, index: int, homes: Sequence[_Home], pairs: Pairs) -> _Home:
        """Return the home of an arm as its planner sees it, with all other arms at home."""
        arm, home = self.arms[index], homes[index]
        if home.state is None:
            return home
        others = [pair for pair in zip(self.arms, homes, strict=True) if pair[0] is not arm]
        held = {name: q for other in others for name, q in _values(*other).items()}
        chain, spheres, _ = self._collision(arm, held)
        spheres = choose_exact_pairs(chain, without(spheres, set(pairs)))
        torso = self._torso(arm, chain)
        share = float(blocked_share(chain, spheres, home.q[None], torso)[0])
        gap = _gap(chain, spheres, home.q, torso) if share else GAPS[0]
        return replace(home, state=replace(home.state, blocked=share), gap=gap)

    def _candidates(self, before: tuple[_Home, ...], pairs: Pairs) -> Iterator[_Home]:
        arm, waiting = self.arms[len(before)], self.arms[len(before) + 1 :]
        placed = self.arms[: len(before)]
        held: dict[str, float] = {}
        for other, home in zip(placed, before, strict=True):
            held |= _values(other, home)
        chain, spheres, loads = self._collision(arm, held)
        unplaced = {link for other in waiting for link in self._own_links(other)}
        spheres = without(spheres, set(pairs))
        spheres = _of_pairs(spheres, lambda a, b: not unplaced & {a, b})
        spheres = choose_exact_pairs(chain, spheres)
        mine = self._own_links(arm)
        theirs = {link for other in placed for link in self._own_links(other)}
        crossing = _of_pairs(spheres, lambda a, b: bool(mine & {a, b} and theirs & {a, b}))
        torso, body = self._torso(arm, chain), replace(self._body, loads=loads)
        if arm.name in self.given:
            state = resting_state(chain, spheres, body, self.given[arm.name], torso)
            yield _Home(state.q, state, _gap(chain, spheres, state.q, torso))
            return
        for other, home in zip(placed, before, strict=True):
            image = self._mirrored(arm, other, home.q)
            if image is not None and not blocked_share(chain, spheres, image[None], torso)[0]:
                yield _Home(image, resting_state(chain, spheres, body, image, torso))
        q = self._samples(arm, chain, held)
        found = resting_states(
            chain, spheres, replace(body, footprint=self._own_side(arm)), q,
            torso=torso,
            held=[k for k, name in enumerate(chain.names) if name in held],
            crossing=crossing if placed else None,
            count=CANDIDATES if len(self.arms) > 1 else 1,
            rng=np.random.default_rng(self.seed),
        )  # fmt: skip
        none = True
        for one in found:
            none, state = False, resting_state(chain, spheres, body, one.q, torso)
            gap = _gap(chain, spheres, state.q, torso) if state.blocked else GAPS[0]
            yield _Home(state.q, state, gap)
        if none:
            yield _Home(q[0], None)

    def _own_side(self, arm: ArmToRest) -> Float[np.ndarray, "k 2"]:
        """Return the half of the footprint on the side of an arm that has a mirror image."""
        others = [other for other in self.arms if other is not arm]
        still = np.zeros(len(arm.text.joints))
        if not any(self._mirrored(arm, other, still) is not None for other in others):
            return self.footprint
        T = self.model.rest_poses
        first = next(j for j in arm.text.joints if all(j not in o.text.joints for o in others))
        y = (invert(T[self.base_link]) @ T[self.model.joint(first).child])[1, 3]
        here, there = self.footprint, np.roll(self.footprint, -1, axis=0)
        inside = here[:, 1] * y >= 0.0
        crossing = here[:, 1] * there[:, 1] < 0.0
        t = (here[:, 1] / np.where(crossing, here[:, 1] - there[:, 1], 1.0))[:, None]
        cut = np.stack([here, here + t * (there - here)], axis=1).reshape(-1, 2)
        return np.asarray(cut[np.stack([inside, crossing], axis=1).reshape(-1)])

    def _mirrored(
        self, arm: ArmToRest, other: ArmToRest, q: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, " n"] | None:
        """Return the mirror image of another arm's state; None if the arms are none."""
        if len(arm.text.joints) != len(other.text.joints):
            return None
        model = self.model.changed(held=dict.fromkeys((*arm.text.joints, *other.text.joints), 0.0))
        T_base_root, image = invert(model.rest_poses[self.base_link]), np.zeros_like(q)
        across = np.array([1.0, -1.0, 1.0])
        for k, names in enumerate(zip(arm.text.joints, other.text.joints, strict=True)):
            mine, theirs = map(self.model.joint, names)
            T, T_other = (T_base_root @ model.rest_poses[joint.child] for joint in (mine, theirs))
            same = float((T[:3, :3] @ mine.axis) @ (across * (T_other[:3, :3] @ theirs.axis)))
            away = float(np.linalg.norm(T[:3, 3] - across * T_other[:3, 3]))
            sign = 1.0 if mine.kind == "prismatic" else -1.0
            image[k] = q[k] if mine is theirs else sign * round(same) * q[k]
            inside = mine.lower <= image[k] <= mine.upper
            if mine is not theirs and (abs(same) < 0.99 or away > MAX_MIRROR_ERROR or not inside):
                return None
        return image

    def _torso(self, arm: ArmToRest, chain: Chain) -> list[int]:
        """Return the joints that arms share, and vertical slides below the first turn."""
        others = {j for other in self.arms if other is not arm for j in other.text.joints}
        rising = abs(chain.h[chain.leads, 2]) > 0.99
        low = chain.leads < chain.first_turn
        return [k for k, name in enumerate(chain.names) if name in others or (low[k] and rising[k])]

    @property
    def _body(self) -> RobotBody:
        """Return the outline of what no turning joint of an arm moves."""
        turning = [
            next((j for j in arm.text.joints if self.model.joint(j).kind != "prismatic"), None)
            for arm in self.arms
        ]
        firsts = [j or arm.text.joints[0] for arm, j in zip(self.arms, turning, strict=True)]
        points = points_of(self.model, self.base_link, base_links(self.model, firsts))
        return RobotBody(self.footprint, float(points[:, 2].max(initial=0.0)))

    def _own_links(self, arm: ArmToRest) -> set[str]:
        """Return the links that the arm moves and no other arm does."""
        others = {j for other in self.arms if other is not arm for j in other.text.joints}
        return {
            link
            for joint in arm.text.joints
            if joint not in others
            for link in self.model.moved_by(joint)
        }

    def _collision(
        self, arm: ArmToRest, held: Mapping[str, float]
    ) -> tuple[Chain, Spheres, LoadArrays]:
        """Return an arm, its collision model and its loads, with other arms at rest."""
        model = self.model.changed(held={**self.model.held, **held})
        text = arm.text
        chain, segments = build_chain(model, self.base_link, text.tool_link, text.joints)
        loads, _ = load_arrays(model, self.base_link, chain, segments)
        spheres = build_spheres(model, segments, self.srdf.disabled, text.gripper_links)
        return chain, spheres, loads

    def _samples(
        self, arm: ArmToRest, chain: Chain, held: Mapping[str, float]
    ) -> Float[np.ndarray, "m n"]:
        q = np.vstack([
            sample_states(chain, np.random.default_rng(self.seed)),
            *_named_states(chain, self.srdf),
        ])  # fmt: skip
        for index, joint in enumerate(arm.text.joints):
            if joint in held:
                q[:, index] = held[joint]
        return q


def _flaw(homes: Sequence[_Home]) -> tuple[float, float]:
    """Return what the best homes have least of."""
    return sum(home.flaw for home in homes), -min(home.gap for home in homes)


def _gap(chain: Chain, spheres: Spheres, q: Float[np.ndarray, " n"], torso: Sequence[int]) -> float:
    """Return the largest of `GAPS` by which hulls are apart at all heights [m], -1 in contact."""
    hulls = spheres.by_hulls
    free = (g for g in GAPS if not blocked_share(chain, hulls.grown(g), q[None], torso)[0])
    return next(free, -1.0)


def _of_pairs(spheres: Spheres, chosen: Callable[[str, str], bool]) -> Spheres:
    """Return the collision model with some pairs of links only."""
    links, every = spheres.links, {(a, b) for a in spheres.links for b in spheres.base_links}
    every |= {(links[i], links[j]) for i, j in spheres.pairs}
    return without(spheres, {pair for pair in every if not chosen(*pair)})


def _named_states(chain: Chain, srdf: Srdf) -> list[Float[np.ndarray, "1 n"]]:
    """Return the arm states that an SRDF names, within the joint limits."""
    found = []
    for state in srdf.states:
        if all(name in state for name in chain.names):
            q = np.array([[state[name] for name in chain.names]])
            if ((chain.lower <= q) & (q <= chain.upper)).all():
                found.append(q)
    return found
