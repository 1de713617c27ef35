"""Replan at base poses near one with a known motion, which usually can be adapted."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np

from momapos.core import look
from momapos.core.geometry import pose_planar
from momapos.model.collision import FREE, check
from momapos.model.records import Motion
from momapos.planning.arm_motion import adapt_motion, arm_spheres, brief_config, with_payload
from momapos.planning.placement import BaseStatus, base_pose_status

from .base_pose_check import BasePoseChecks
from .query import PlacementQuery

if TYPE_CHECKING:
    from jaxtyping import Float

Depth: TypeAlias = Literal["base", "arm", "all"]
"""How deep a pose is checked: the base alone, also an arm path in the planner's model, or all that
a plan must pass."""
MAX_REPLANNED_POSES = 12
"""Poses at which a motion is planned from scratch because no known one can be adapted; after that,
a pose where none can be adapted counts as a failure [-]."""


@dataclass(frozen=True, eq=False)
class _Known:
    """A base pose with its motion."""

    base: Float[np.ndarray, "3"]
    motion: Motion


@dataclass
class NearbyReplanner:
    """Find motions at base poses near one with a known motion."""

    checks: BasePoseChecks
    known: list[_Known]
    replanned: int = 0
    """Number of poses at which a motion was planned from scratch."""

    @classmethod
    def around(
        cls, query: PlacementQuery, base: Float[np.ndarray, "3"], motion: Motion
    ) -> NearbyReplanner:
        """Build a replanner around a base pose with a motion."""
        config = replace(query.config, planner=brief_config(query.config.planner))
        checks = BasePoseChecks(replace(query, config=config)).holding(motion)
        return cls(checks, [_Known(base, motion)])

    def failure(self, poses: Float[np.ndarray, "n 3"], depth: Depth) -> int | None:
        """Return the index of a pose without a motion; None if all poses have one.

        Args:
            poses: x [m], y [m], yaw [rad], those that fail most often first.
            depth: How deep each pose is checked.
        """
        status, _ = base_pose_status(self.checks.prepared.geometry, poses)
        blocked = np.flatnonzero(status != BaseStatus.CLEAR)
        if len(blocked):
            return int(blocked[-1])
        for index, pose in enumerate(poses if depth != "base" else ()):
            look()
            if not self._has_motion(pose, exact=depth == "all"):
                return index
        return None

    def _has_motion(self, pose: Float[np.ndarray, "3"], *, exact: bool) -> bool:
        if any(self._adapts(one, pose, exact=exact) for one in self.known):
            return True
        if self.replanned == MAX_REPLANNED_POSES:
            return False
        self.replanned += 1
        regrasps = len(self.known[0].motion.holds) > 1
        found = (self.checks if regrasps else self.checks.with_one_grasp)(pose).motion
        if found is None:
            return False
        self.known.insert(0, _Known(pose, found))
        return True

    def _adapts(self, known: _Known, pose: Float[np.ndarray, "3"], *, exact: bool) -> bool:
        prepared = self.checks.prepared
        straight = prepared.motion.grasp_step
        motion = adapt_motion(prepared.robot, known.motion, known.base, pose, straight)
        if motion is None or not self._clear(motion, pose):
            return False
        return not exact or prepared.violation(pose, motion) is None

    def _clear(self, motion: Motion, pose: Float[np.ndarray, "3"]) -> bool:
        """Return whether the arm is free in the planner's model.

        True for a motion with more than one grasp, which only the exact check judges.
        """
        prepared = self.checks.prepared
        task, robot, chain = prepared.motion, prepared.robot, prepared.robot.chain
        steps, straight = len(task.object_q), task.grasp_step
        if len(motion.holds) > 1 or straight + len(motion.q) != steps:
            return True
        carrying = task.task.verb == "place"
        q = chain.freedom_values(np.concatenate([motion.approach, motion.q]))
        approach = len(q) - steps
        spheres = robot.spheres.by_hulls
        if carrying:
            T = pose_planar(pose) @ chain.tool_poses(q[approach : approach + 1])[0]
            spheres = with_payload(robot, task, T, 0)
        bases = np.tile(pose, (len(q), 1))
        codes = check(
            prepared.world, chain, spheres, q[:approach], bases[:approach],
            np.full(approach, task.value[0]), np.full(approach, carrying),
        )  # fmt: skip
        if (codes != FREE).any():
            return False
        # Grasps and the exact check test the hand against the object that it holds.
        codes = check(
            prepared.world, chain, arm_spheres(robot), q[approach:], bases[approach:],
            task.value, task.holding,
        )  # fmt: skip
        return bool((codes == FREE).all())
