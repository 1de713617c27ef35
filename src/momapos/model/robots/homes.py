"""Home states of all arms of a robot, and the pairs of links that are never checked."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.collision import Spheres, build_spheres, choose_exact_pairs
from momapos.model.kinematics import Chain, LoadArrays, build_chain
from momapos.model.urdf import Articulated

from .arm_states import inevitable_pairs, sample_states
from .base_guess import base_links
from .gripper_guess import listed, points_of
from .joint_tree import ArmChain
from .load_limits import load_arrays
from .never_checked import nested_pairs, rigid_pairs, without
from .resting_states import Body, RestingState, blocked_share, resting_states
from .robot_text import ArmText
from .srdf import Srdf

if TYPE_CHECKING:
    from jaxtyping import Float

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
    """
    search = _Search(model, base_link, arms, footprint, srdf, seed)
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
        q = self._samples(arm, chain, held)
        torso = self._torso(arm, chain)
        found = resting_states(
            chain, spheres, replace(self._body, loads=loads), q,
            torso=torso,
            held=[k for k, name in enumerate(chain.names) if name in held],
            crossing=crossing if placed else None,
            count=CANDIDATES if len(self.arms) > 1 else 1,
            rng=np.random.default_rng(self.seed),
        )  # fmt: skip
        state = None
        for state in found:
            gap = _gap(chain, spheres, state.q, torso) if state.blocked else GAPS[0]
            yield _Home(state.q, state, gap)
        if state is None:
            yield _Home(q[0], None)

    def _torso(self, arm: ArmToRest, chain: Chain) -> list[int]:
        """Return the joints that arms share, and vertical slides below the first turn."""
        others = {j for other in self.arms if other is not arm for j in other.text.joints}
        rising = abs(chain.h[chain.leads, 2]) > 0.99
        low = chain.leads < chain.first_turn
        return [k for k, name in enumerate(chain.names) if name in others or (low[k] and rising[k])]

    @property
    def _body(self) -> Body:
        """Return the outline of what no turning joint of an arm moves."""
        turning = [
            next((j for j in arm.text.joints if self.model.joint(j).kind != "prismatic"), None)
            for arm in self.arms
        ]
        firsts = [j or arm.text.joints[0] for arm, j in zip(self.arms, turning, strict=True)]
        points = points_of(self.model, self.base_link, base_links(self.model, firsts))
        return Body(self.footprint, float(points[:, 2].max(initial=0.0)))

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
