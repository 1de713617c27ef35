"""What a robot's motors bear, and how far it is from tipping over, at rest in a state.

Gravity acts on all links, and a force may act on the hand. Accelerations are not considered: the
margin below the effort limits is for them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import apply, edge_normals
from momapos.model.kinematics import BASE, LoadArrays, chain_arrays, static_loads
from momapos.model.records import MAX_EFFORT_SHARE, MIN_STABILITY, PoseOutcome, PoseStatus

from .robot import Robot
from .wheel_contacts import support_outline

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int


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


@lru_cache(maxsize=64)
def _robot_loads(robot: Robot) -> RobotLoads:
    chain, notes = robot.chain, []
    mass, center = _segment_masses(robot)
    limits = np.array([robot.model.joint(name).effort for name in chain.names])
    unknown = [n for n, limit in zip(chain.names, limits, strict=True) if not np.isfinite(limit)]
    if unknown:
        notes.append(f"no effort limit is known for {', '.join(unknown)}")
    if not mass[1:].any():
        notes.append("the arm's links have no masses, so only loads at the hand count")
    links = [link for link, segment in robot.segments.of_link.items() if segment == 0]
    support = support_outline(robot.model, robot.base_link, links)
    arrays = LoadArrays(
        mass, center, MAX_EFFORT_SHARE * limits, np.zeros((0, 2)), np.zeros(0), MIN_STABILITY
    )
    unmoving = RobotLoads(robot, arrays, tuple(notes))
    if mass[0] <= 0:
        return _without_stability(unmoving, "the base has no mass")
    if support is None:
        return _without_stability(unmoving, "no wheels are found on the floor")
    normals = edge_normals(support)
    offsets = (normals * support).sum(1)
    standing = replace(unmoving, arrays=arrays._replace(normals=normals, offsets=offsets))
    if standing.at(robot.home[None]).stability[0] < MIN_STABILITY:
        why = "by the masses in its file the robot hardly stands at home"
        return _without_stability(unmoving, why)
    return standing


def _without_stability(loads: RobotLoads, why: str) -> RobotLoads:
    return replace(loads, notes=(*loads.notes, f"stability does not count: {why}"))


def _segment_masses(
    robot: Robot,
) -> tuple[Float[np.ndarray, " m_plus_1"], Float[np.ndarray, "m_plus_1 3"]]:
    """Return mass and center of mass of each segment of the arm, the base first."""
    segments, count = robot.segments, robot.chain.last + 1
    mass, moment = np.zeros(count), np.zeros((count, 3))
    for link in robot.model.urdf.links.values():
        at = segments.of_link[link.name]
        mass[at] += link.mass
        center = apply(segments.T_segment_link[link.name], np.array([link.center]))
        moment[at] += link.mass * center[0]
    return mass, moment / np.maximum(mass, 1e-12)[:, None]
