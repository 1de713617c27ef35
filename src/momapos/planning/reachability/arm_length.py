"""What stands in for the map of an arm that has none: the arm's length alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import invert, pose_planar
from momapos.model.robots import Robot

if TYPE_CHECKING:
    from jaxtyping import Float

BEST = 0.6
"""Share of its length at which an arm is taken to reach best [-]."""
_BLOCK = 2_000_000
"""Tool poses that are looked at together."""


@dataclass(frozen=True)
class ArmLength:
    """Scores base poses by distance alone: it rules out what is too far, and no more.

    What remains is for inverse kinematics to tell, base pose by base pose.
    """

    shoulder: Float[np.ndarray, "3"]
    """Middle of where the first turning axis can be, in the base frame [m]."""
    travel: Float[np.ndarray, "3"]
    """How far it slides to both sides of that along each axis [m]."""
    length: float
    """No tool is farther from that axis [m]."""
    note: str
    """Why there is no map, in one line."""

    def min_score(
        self, bases: Float[np.ndarray, "n 3"], Ts_world_tool: Float[np.ndarray, "g w 4 4"]
    ) -> Float[np.ndarray, "n g"]:
        """Score of the waypoint that each grasp's arm stands worst for, for each base pose."""
        bases, points = np.asarray(bases, float), Ts_world_tool[..., :3, 3]
        out = np.empty((len(bases), len(points)), np.float32)
        block = max(1, _BLOCK // max(1, points[..., 0].size))
        for lo in range(0, len(bases), block):
            T = invert(pose_planar(bases[lo : lo + block]))
            local = np.einsum("nij,gwj->ngwi", T[:, :3, :3], points) + T[:, None, None, :3, 3]
            off = np.maximum(np.abs(local - self.shoulder) - self.travel, 0.0)
            share = np.linalg.norm(off, axis=-1) / self.length
            score = np.where(share <= 1.0, 1.0 - 0.9 * np.abs(share - BEST), 0.0)
            out[lo : lo + block] = score.min(-1)
        return out


def arm_length(robot: Robot, why: str) -> ArmLength:
    """Score a robot's base poses by its arm's length.

    Args:
        robot: The robot.
        why: Why it has no map.
    """
    chain, first = robot.chain, robot.chain.first_turn
    slides = chain.half_travel[:first, None] * np.abs(chain.h[:first])
    shoulder = chain.d[: first + 1].sum(0) + chain.middle[:first] @ chain.h[:first]
    note = f"{robot.name} has no reachability map: {why}; base poses are tried one by one, slower"
    return ArmLength(shoulder, slides.sum(0), robot.reach, note)
