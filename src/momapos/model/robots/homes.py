"""Home states of all arms of a robot, and the pairs of links that are never checked."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
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

    The arms get their homes in turn, each next to the homes before. If an arm finds none, the arm
    before it tries its next candidate.

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
        return (
            f"IMPORTANT: {of_arm}home: {listed(state.q)} is in contact at {at}; no better "
            "state was found"
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
            if not _flaw(homes) or home.flaw:
                break  # further candidates of this arm are worse themselves
        return best

    def _checked(self, homes: tuple[_Home, ...], pairs: Pairs) -> tuple[_Home, ...]:
        """Return the homes, each checked with all other arms at home.

        An arm is spheres and the others are boxes, so that who is which decides close calls.
        """
        checked = list(homes[-1:])
        for index, home in enumerate(homes[:-1]):
            if home.state is not None:
                others = [(a, h) for k, (a, h) in enumerate(zip(self.arms, homes, strict=True))
                          if k != index]  # fmt: skip
                held = {name: q for a, h in others for name, q in _values(a, h).items()}
                chain, spheres, _ = self._collision(self.arms[index], held)
                spheres = choose_exact_pairs(chain, without(spheres, set(pairs)))
                torso = self._torso(self.arms[index], chain)
                share = float(blocked_share(chain, spheres, home.q[None], torso)[0])
                home = replace(home, state=replace(home.state, blocked=share))
            checked.insert(index, home)
        return tuple(checked)

    def _candidates(self, before: tuple[_Home, ...], pairs: Pairs) -> list[_Home]:
        arm, waiting = self.arms[len(before)], self.arms[len(before) + 1 :]
        held: dict[str, float] = {}
        for other, home in zip(self.arms, before, strict=False):
            held |= _values(other, home)
        chain, spheres, loads = self._collision(arm, held)
        never = set(pairs)
        unplaced = {link for other in waiting for link in self._own_links(other)}
        never |= {(a, b) for a in spheres.links for b in spheres.links if unplaced & {a, b}}
        never |= {(a, b) for a in spheres.links for b in spheres.base_links if unplaced & {a, b}}
        spheres = choose_exact_pairs(chain, without(spheres, never))
        q = self._samples(arm, chain, held)
        found = resting_states(
            chain, spheres, replace(self._body, loads=loads), q,
            torso=self._torso(arm, chain),
            held=[k for k, name in enumerate(chain.names) if name in held],
            count=CANDIDATES if len(self.arms) > 1 else 1,
            rng=np.random.default_rng(self.seed),
        )  # fmt: skip
        return [_Home(state.q, state) for state in found] or [_Home(q[0], None)]

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


def _flaw(homes: Sequence[_Home]) -> float:
    return sum(home.flaw for home in homes)


def _named_states(chain: Chain, srdf: Srdf) -> list[Float[np.ndarray, "1 n"]]:
    """Return the arm states that an SRDF names, within the joint limits."""
    found = []
    for state in srdf.states:
        if all(name in state for name in chain.names):
            q = np.array([[state[name] for name in chain.names]])
            if ((chain.lower <= q) & (q <= chain.upper)).all():
                found.append(q)
    return found
