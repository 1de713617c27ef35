"""What a base pose costs: driving, room beside it, clearance, and the arm's motion from there."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.collision import FREE, base_hits
from momapos.model.kinematics import least_dexterity, travel_of_arm
from momapos.model.records import CostTerm

from .area import PlacementGeometry
from .config import PlaceConfig

if TYPE_CHECKING:
    from jaxtyping import Float

_LEVELS = np.arange(1, 11) * 0.02
"""Clearances that are asked about; beyond the last, more is worth nothing [m]."""


@dataclass(frozen=True)
class PoseCosts:
    """Costs of base poses for one task; a cost is a sum of terms, each times its weight."""

    geometry: PlacementGeometry
    config: PlaceConfig
    takes_hold: int
    """Index of the state of an arm path in which the hand takes hold [-]."""

    @property
    def room_first(self) -> bool:
        """Whether room beside a base pose counts before all that has a finite weight."""
        return math.isinf(self.config.weight_room)

    def before_path(
        self, poses: Float[np.ndarray, "n 3"], travel: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, " n"]:
        """What base poses cost at least, known before the arm has a path.

        Args:
            poses: x [m], y [m], yaw [rad].
            travel: Driving length to each [m].
        """
        cost = self.config.weight_driving * travel
        if self.config.weight_clearance:
            cost = cost + self.config.weight_clearance * missing_clearance(self.geometry, poses)
        return cost

    def of_path(self, q: Float[np.ndarray, "m n"]) -> float:
        """What the arm's path adds from where the hand takes hold.

        Args:
            q: Its degrees of freedom at each state.
        """
        robot, config = self.geometry.robot, self.config
        cost, q = 0.0, q[self.takes_hold :]
        if config.weight_manipulability:
            worst = least_dexterity(robot.chain, q, robot.reach)
            cost += config.weight_manipulability * (1.0 - worst)
        if config.weight_effort:
            cost += config.weight_effort * travel_of_arm(robot.chain, q, robot.reach)
        return cost

    def of_room(self, margin: float) -> float:
        """What a share of poses beside it that work adds; nothing where room comes first."""
        return 0.0 if self.room_first else self.config.weight_room * (1.0 - margin)


def cost_terms(
    geometry: PlacementGeometry,
    config: PlaceConfig,
    base: Float[np.ndarray, "3"],
    q: Float[np.ndarray, "m n"],
    *,
    travel: float,
    margin: float | None,
) -> Mapping[str, CostTerm]:
    """The terms of an answer's cost by name, those of no weight too.

    Args:
        geometry: The room and the task.
        config: The weights.
        base: x [m], y [m], yaw [rad].
        q: The arm's degrees of freedom at each state in which it holds the object.
        travel: Driving length [m].
        margin: Share of poses beside it that work; None where nobody has looked.
    """
    robot = geometry.robot
    values = {
        "driving": travel,
        "room": None if margin is None else 1.0 - margin,
        "clearance": float(missing_clearance(geometry, base[None])[0]),
        "manipulability": 1.0 - least_dexterity(robot.chain, q, robot.reach),
        "effort": travel_of_arm(robot.chain, q, robot.reach),
    }
    weights = {name: getattr(config, f"weight_{name}") for name in values}
    return {
        name: CostTerm(value, None if math.isinf(weights[name]) else weights[name])
        for name, value in values.items()
    }


def missing_clearance(
    geometry: PlacementGeometry, poses: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, " n"]:
    """How much base poses lack of 20 cm to the room and to the moving part, to 2 cm [m]."""
    robot, boxes = geometry.robot, geometry.boxes
    kept, left = np.zeros(len(poses)), np.arange(len(poses))
    for level in _LEVELS:
        left = left[base_hits(poses[left], robot.base, boxes, clearance=level) == FREE]
        kept[left] = level
    return _LEVELS[-1] - kept
