"""What a robot's motors bear, and how far it is from tipping over, at rest in a state.

Gravity acts on all links, and a force may act on the hand. Accelerations are not considered: the
margin below the effort limits is for them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import GRAVITY
from momapos.core.geometry import apply, contains, edge_distances
from momapos.model.kinematics import SegmentMasses, chain_arrays, static_efforts
from momapos.model.records import MAX_EFFORT_SHARE

from .robot import Robot
from .support_outline import support_outline

if TYPE_CHECKING:
    from jaxtyping import Float, Int


@dataclass(frozen=True, eq=False)
class StateLoads:
    """Loads of a robot at s states."""

    efforts: Float[np.ndarray, "s n"]
    """Torque or force of each degree of freedom [Nm] or [N]."""
    shares: Float[np.ndarray, "s n"]
    """Share of its limit [-]; 0 where no limit counts."""
    stability: Float[np.ndarray, " s"]
    """Distance from the zero moment point to the nearest edge of the area that the wheels stand on
    [m]; negative if the robot tips over, infinite where that is unknown."""

    def take(self, states: Int[np.ndarray, " k"]) -> StateLoads:
        """Return the loads at some of the states."""
        return StateLoads(self.efforts[states], self.shares[states], self.stability[states])


@dataclass(frozen=True, eq=False)
class RobotLoads:
    """A robot's masses, effort limits and wheels."""

    robot: Robot
    masses: SegmentMasses
    limits: Float[np.ndarray, " n"]
    """Effort limit of each degree of freedom [Nm] or [N]; infinite where none counts."""
    support: Float[np.ndarray, "k 2"] | None
    """Outline of the area that the wheels stand on, in the base frame [m]; None if masses or
    wheels are unknown, so that stability does not count."""
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
        efforts, center = static_efforts(
            np.ascontiguousarray(q), chain_arrays(self.robot.chain), self.masses, force, point
        )
        shares = np.abs(efforts) / self.limits
        return StateLoads(efforts, shares, self._stability(center, force, point))

    def _stability(
        self,
        center: Float[np.ndarray, "s 3"],
        force: Float[np.ndarray, "s 3"],
        point: Float[np.ndarray, "s 3"],
    ) -> Float[np.ndarray, " s"]:
        """Return the distance of the zero moment point from the edge of the support (Vukobratovic
        1972): where the floor's reaction to weight and force acts."""
        if self.support is None:
            return np.full(len(center), np.inf)
        weight = GRAVITY * float(self.masses.mass.sum())
        up = weight - force[:, 2:]
        moment = weight * center[:, :2] + point[:, 2:] * force[:, :2] - point[:, :2] * force[:, 2:]
        zero = moment / np.maximum(up, 1e-6)
        distance = edge_distances(zero, self.support)
        inside = contains(self.support, zero) & (up[:, 0] > 0)
        return np.asarray(np.where(inside, distance, -distance))

    def never_exceeded(self, force: float) -> bool:
        """Return whether no state with a force on the hand up to this one [N] needs too much.

        An upper bound: the arm is taken as straight, and all weights as across it.
        """
        return bool((self._bound(force) <= MAX_EFFORT_SHARE * self.limits).all())

    def _bound(self, force: float) -> Float[np.ndarray, " n"]:
        chain = self.robot.chain
        travel = np.where(
            chain.slides, np.abs(chain.ratio) * np.maximum(-chain.lower, chain.upper)[chain.dof], 0
        )
        links = np.linalg.norm(chain.d, axis=1) + travel
        along = np.cumsum(links)
        weights = GRAVITY * self.masses.mass[1:]
        centers = along + np.linalg.norm(self.masses.center[1:], axis=1)
        tool = along[-1] + float(np.linalg.norm(chain.tool_offset))
        out = np.zeros(chain.size)
        for j in range(chain.last):
            reach = 0.0 if chain.slides[j] else along[j] - travel[j]
            arms = np.ones(chain.last - j) if chain.slides[j] else centers[j:] - reach
            load = force * (1.0 if chain.slides[j] else tool - reach)
            out[chain.dof[j]] += abs(chain.ratio[j]) * (weights[j:] @ arms + load)
        return out


@lru_cache(maxsize=64)
def robot_loads(robot: Robot) -> RobotLoads:
    """Return a robot's masses, effort limits and wheels, from its URDF."""
    chain, notes = robot.chain, []
    masses = _segment_masses(robot)
    limits = np.array([robot.model.joint(name).effort for name in chain.names])
    unknown = [n for n, limit in zip(chain.names, limits, strict=True) if not np.isfinite(limit)]
    if unknown:
        notes.append(f"no effort limit is known for {', '.join(unknown)}")
    if not masses.mass[1:].any():
        notes.append("the arm's links have no masses, so only loads at the hand count")
    base = [link for link, segment in robot.segments.of_link.items() if segment == 0]
    support = support_outline(robot.model, robot.base_link, base)
    found = RobotLoads(robot, masses, limits, support, tuple(notes))
    why = ""
    if masses.mass[0] <= 0:
        why = "the base has no mass"
    elif support is None:
        why = "no wheels are found on the floor"
    elif found.at(robot.home[None]).stability[0] < 0:
        why = "by the masses in its file the robot tips over at home"
    if not why:
        return found
    return replace(found, support=None, notes=(*notes, f"stability does not count: {why}"))


def _segment_masses(robot: Robot) -> SegmentMasses:
    """Return the mass and center of mass of each segment of the arm, the base first."""
    segments, count = robot.segments, robot.chain.last + 1
    mass, moment = np.zeros(count), np.zeros((count, 3))
    for link in robot.model.urdf.links.values():
        at = segments.of_link[link.name]
        mass[at] += link.mass
        center = apply(segments.T_segment_link[link.name], np.array([link.center]))
        moment[at] += link.mass * center[0]
    return SegmentMasses(mass, moment / np.maximum(mass, 1e-12)[:, None])
