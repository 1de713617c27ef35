"""What a robot's motors bear, and how far it is from tipping over, at rest in a state.

Gravity acts on all links, and a force may act on the hand. Accelerations are not considered: the
margin below the effort limits is for them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import owner_cache
from momapos.core.geometry import apply, edge_normals
from momapos.model.kinematics import (
    BASE,
    Chain,
    LoadArrays,
    Segments,
    chain_arrays,
    static_loads,
)
from momapos.model.records import MAX_EFFORT_SHARE, MIN_STABILITY, PoseOutcome, PoseStatus
from momapos.model.urdf import Articulated

from .robot import Robot
from .wheel_contacts import support_outline

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
