"""Find the first and the last axis of an arm, with which its reachability map is aligned."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import RobotError
from momapos.core.geometry import orthonormal
from momapos.model.kinematics import NUMERIC, Chain
from momapos.model.robots import MAP_JOINTS, Robot

if TYPE_CHECKING:
    from jaxtyping import Float

FULL_TURN = 0.95 * 2 * np.pi
"""A last joint with at least this range counts as turning fully [rad]."""


@dataclass(frozen=True, eq=False)
class ArmAxes:
    """The first and the last axis of an arm."""

    first: int
    """Index of the first joint that turns."""
    turns_alike: bool
    """Whether the first joint turns the whole reachable set about a vertical axis, and the last
    joint does not change it."""
    turn: float
    """1 if the first joint turns counterclockwise seen from above, else -1."""
    limits: tuple[float, float]
    """Limits of the first joint [rad]."""
    axis: Float[np.ndarray, "3"]
    """Foot of the first axis in the base frame [m]."""
    tool: Float[np.ndarray, "4 3"]
    """Direction of the last axis, two vectors across it and a point on it, in the tool frame."""
    full_roll: bool
    """Whether the last joint turns fully and moves only the tool."""


def no_map(robot: Robot) -> str:
    """Return why an arm cannot have a reachability map; empty if it can."""
    if robot.chain.size < MAP_JOINTS:
        return (
            f"its arm has {robot.chain.size} degrees of freedom, so it reaches few tool poses "
            "exactly"
        )
    return ""


def is_flooded(robot: Robot, frame: ArmAxes) -> bool:
    """Check whether a map is flooded from arm states instead of built by IK line by line.

    Building by IK needs a first joint that turns the whole arm, a last joint that turns fully, and
    all IK branches: numeric IK finds only some. It also looks up contact with the parts that do not
    turn in a table of spheres, which is too coarse if a pair of a link and a torso, a head or
    another arm is checked by hulls.
    """
    spheres = robot.spheres
    stands = spheres.segment[spheres.pairs] <= frame.first
    by_hulls = bool((spheres.exact & (stands[:, 0] != stands[:, 1])).any())
    return not frame.turns_alike or robot.ik.kind == NUMERIC or by_hulls


def arm_frame(chain: Chain, approach_axis: Float[np.ndarray, "3"]) -> ArmAxes:
    """Find the first and the last axis of an arm.

    Raises:
        RobotError: The arm has no revolute joint.
    """
    origin = np.cumsum(chain.d, axis=0)
    first = chain.first_turn
    if first == chain.last:
        raise RobotError("the arm has no revolute joint; a reachability map needs at least one")
    last = chain.last - 1
    p_tool = origin[last] + chain.tool_offset
    axis, point, full = chain.h[last], origin[last], False
    if chain.slides[last]:
        axis, point = chain.tool_rotation @ approach_axis, p_tool
    else:
        full = chain.ends_turning and bool(2 * chain.half_travel[last] >= FULL_TURN)
        point = _nearest(origin[last], axis, origin[last - 1], chain.h[last - 1])
    across = orthonormal(axis)
    rows = np.stack([axis, across, np.cross(axis, across), point - p_tool])
    foot = np.array([origin[first, 0], origin[first, 1], 0.0])
    turn, dof = float(np.sign(chain.h[first, 2])), chain.dof[first]
    limits = float(chain.lower[dof]), float(chain.upper[dof])
    alike = chain.upright and full and not chain.coupled
    return ArmAxes(first, alike, turn, limits, foot, rows @ chain.tool_rotation, full)


def _nearest(o: np.ndarray, h: np.ndarray, other: np.ndarray, k: np.ndarray) -> np.ndarray:
    """Return the point of the line (o, h) that is nearest to the line (other, k)."""
    w, c = o - other, float(h @ k)
    if 1 - c * c < 1e-4:
        return o
    return o + h * (c * float(k @ w) - float(h @ w)) / (1 - c * c)
