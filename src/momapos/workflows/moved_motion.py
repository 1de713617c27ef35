"""Execute a motion whose base moves from where the base has stopped instead of its base pose."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import compose, invert, local_points, pose_planar
from momapos.model.kinematics import track_tools
from momapos.model.records import Attempt, Motion, PlacementPlan, PoseOutcome, PoseStatus
from momapos.model.robots import Robot
from momapos.model.scene import Scene, with_assumptions
from momapos.verification import PlanVerifier

if TYPE_CHECKING:
    from jaxtyping import Float

_BEYOND = PoseOutcome(PoseStatus.EXACT_CHECK, "the arm does not reach from the displaced base path")
MAX_OFFSET = 0.02
"""Largest offset of the hand from the plan, of an arm that cannot make up for where the base has
stopped [m] or [rad]; the exact check decides whether the hand may hold the part so."""


def motion_from(
    plan: PlacementPlan, scene: Scene, robot: Robot, here: Float[np.ndarray, "3"]
) -> Attempt:
    """Return a plan's motion for a base that has stopped near its base pose.

    The base path moves with the base, so that the drive can follow it as planned. The hand moves as
    planned, and the arm makes up for the difference; a short arm as far as it can. The motion is
    checked exactly.

    Args:
        plan: A plan whose base moves.
        scene: The scene, as the robot believes it.
        robot: The robot.
        here: Where the base has stopped: x [m], y [m], yaw [rad].
    """
    motion = plan.motion
    assert motion is not None
    assert motion.base is not None
    base, chain = _displaced(motion.base, here), robot.chain
    T_world_base = pose_planar(base)
    q = track_tools(
        chain,
        chain.freedom_values(motion.q),
        invert(T_world_base) @ motion.Ts_world_tool,
        MAX_OFFSET,
    )
    if q is None:
        return Attempt(None, _BEYOND)
    found = _joined(
        replace(
            motion, base=base, times=None, approach_times=None,
            Ts_world_tool=T_world_base @ chain.tool_poses(q),
        ),
        motion, chain.joint_values(q),
    )  # fmt: skip
    x, y, yaw = base[0].tolist()
    verifier = PlanVerifier(with_assumptions(scene, plan), robot, plan.task)
    violation = verifier.first_violation((x, y, yaw), found)
    if violation is not None:
        return Attempt(None, PoseOutcome(PoseStatus.EXACT_CHECK, violation))
    return Attempt(found, PoseOutcome(PoseStatus.FEASIBLE))


def _displaced(
    base: Float[np.ndarray, "m 3"], here: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "m 3"]:
    """Return a base path that starts at a pose instead of at its first one."""
    relative = np.column_stack([local_points(base[0], base[:, :2]), base[:, 2] - base[0, 2]])
    moved = compose(here, relative)
    moved[:, 2] = here[2] + relative[:, 2]
    return moved


def _joined(found: Motion, planned: Motion, q: Float[np.ndarray, "m n"]) -> Motion:
    """Return a motion with new arm states, whose approach and path home lead to and from them."""
    approach, home = planned.approach, planned.home
    if len(approach):
        share = np.linspace(0.0, 1.0, len(approach))[:, None]
        share = share if len(approach) > 1 else np.ones((1, 1))
        approach = approach + share * (q[0] - planned.q[0])
    if home is not None:
        home = home + np.linspace(1.0, 0.0, len(home))[:, None] * (q[-1] - planned.q[-1])
    return replace(found, q=q, approach=approach, home=home)
