"""Score base poses by the arm's length alone, for an arm without a reachability map."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import invert, pose_planar
from momapos.model.robots import Robot

if TYPE_CHECKING:
    from jaxtyping import Float

BEST_EXTENSION = 0.6
"""Share of the arm's length with the highest score [-]."""
_BLOCK = 2_000_000
"""Tool poses that are scored together [-]."""


@dataclass(frozen=True, eq=False)
class ArmLength:
    """Scores base poses by distance alone: it rules out only base poses that are too far.

    Inverse kinematics decides about the others.
    """

    shoulder: Float[np.ndarray, "3"]
    """Mean position of the first turning axis, in the base frame [m]."""
    travel: Float[np.ndarray, "3"]
    """Travel of that axis to both sides along x, y and z [m]."""
    length: float
    """Upper bound of the tool's distance from that axis [m]."""
    note: str
    """Why there is no map, in one line."""

    def min_score(
        self, bases: Float[np.ndarray, "n 3"], Ts_world_tool: Float[np.ndarray, "g w 4 4"]
    ) -> Float[np.ndarray, "n g"]:
        """Return the worst score along each grasp's waypoints, for each base pose."""
        bases, points = np.asarray(bases, float), Ts_world_tool[..., :3, 3]
        out = np.empty((len(bases), len(points)), np.float32)
        block = max(1, _BLOCK // max(1, points[..., 0].size))
        for lo in range(0, len(bases), block):
            T = invert(pose_planar(bases[lo : lo + block]))
            local = np.einsum("nij,gwj->ngwi", T[:, :3, :3], points) + T[:, None, None, :3, 3]
            off = np.maximum(np.abs(local - self.shoulder) - self.travel, 0.0)
            share = np.linalg.norm(off, axis=-1) / self.length
            score = np.where(share <= 1.0, 1.0 - 0.9 * np.abs(share - BEST_EXTENSION), 0.0)
            out[lo : lo + block] = score.min(-1)
        return out


def by_arm_length(robot: Robot, why: str) -> ArmLength:
    """Build the scorer of a robot by its arm's length, with the reason why it has no map."""
    chain, first = robot.chain, robot.chain.first_turn
    slides = chain.half_travel[:first, None] * np.abs(chain.h[:first])
    shoulder = chain.d[: first + 1].sum(0) + chain.middle[:first] @ chain.h[:first]
    note = f"{robot.name} has no reachability map: {why}; planning is slower without one"
    return ArmLength(shoulder, slides.sum(0), robot.reach, note)
