"""Is a motion found anew beside a base pose? Mostly the one that is known there can be carried."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np

from momapos.core.geometry import pose_planar
from momapos.model.collision import FREE, check
from momapos.model.records import Motion
from momapos.planning.arm_motion import arm_spheres, brief, carried, with_payload
from momapos.planning.placement import BaseStatus, base_pose_status

from .base_pose_check import BasePoseChecks
from .query import PlacementQuery

if TYPE_CHECKING:
    from jaxtyping import Float

Depth: TypeAlias = Literal["base", "arm", "all"]
"""How much is asked of a pose: whether the base stands clear, for an arm path as well that the
planner's model lets pass, or for all that a plan has to pass."""
MOST = 12
"""Base poses at which a motion is planned from nothing, because none that is known can be carried
there; beyond that a pose where none can counts as one where there is none [-]."""


@dataclass(frozen=True)
class _Known:
    """A base pose and a motion there."""

    base: Float[np.ndarray, "3"]
    motion: Motion


@dataclass
class FoundAnew:
    """Looks for motions at poses beside a base pose where one is known."""

    checks: BasePoseChecks
    known: list[_Known]
    asked: int = 0
    """At how many poses a motion was planned from nothing."""

    @classmethod
    def around(
        cls, query: PlacementQuery, base: Float[np.ndarray, "3"], motion: Motion
    ) -> FoundAnew:
        """Around a base pose with a motion."""
        config = replace(query.config, planner=brief(query.config.planner))
        asked = replace(query, config=config)
        return cls(BasePoseChecks(asked), [_Known(base, motion)])

    def failure(self, poses: Float[np.ndarray, "n 3"], how: Depth) -> int | None:
        """Index of a pose where no motion is found; None where one is found at all.

        The query's clock is looked at before each pose; what it raises ends the work.

        Args:
            poses: x [m], y [m], yaw [rad], those that fail most first.
            how: How much is asked.
        """
        status, _ = base_pose_status(self.checks.prepared.geometry, poses)
        blocked = np.flatnonzero(status != BaseStatus.CLEAR)
        if len(blocked):
            return int(blocked[-1])
        for index, pose in enumerate(poses if how != "base" else ()):
            self.checks.query.watch.clock()
            if not self._found(pose, exact=how == "all"):
                return index
        return None

    def _found(self, pose: Float[np.ndarray, "3"], *, exact: bool) -> bool:
        if any(self._carries(one, pose, exact=exact) for one in self.known):
            return True
        if self.asked == MOST:
            return False
        self.asked += 1
        held = len(self.known[0].motion.holds) > 1
        found = (self.checks if held else self.checks.in_one_hold)(pose).motion
        if found is None:
            return False
        self.known.insert(0, _Known(pose, found))
        return True

    def _carries(self, known: _Known, pose: Float[np.ndarray, "3"], *, exact: bool) -> bool:
        prepared = self.checks.prepared
        straight = prepared.motion.grasp_step
        motion = carried(prepared.robot, known.motion, known.base, pose, straight)
        if motion is None or not self._clear(motion, pose):
            return False
        return not exact or prepared.violation(pose, motion) is None

    def _clear(self, motion: Motion, pose: Float[np.ndarray, "3"]) -> bool:
        """Whether the arm is free as the planner sees it; true of more than one hold, of which the
        exact check alone decides."""
        prepared = self.checks.prepared
        task, robot, chain = prepared.motion, prepared.robot, prepared.robot.chain
        steps, straight = len(task.object_q), task.grasp_step
        if len(motion.holds) > 1 or straight + len(motion.q) != steps:
            return True
        carrying = task.task.verb == "place"
        q = chain.freedom_values(np.concatenate([motion.approach, motion.q]))
        way = len(q) - steps
        spheres = robot.spheres
        if carrying:
            T = pose_planar(pose) @ chain.tool_poses(q[way : way + 1])[0]
            spheres = with_payload(robot, task, T, 0)
        where = np.tile(pose, (len(q), 1))
        codes = check(
            prepared.world, chain, spheres, q[:way], where[:way],
            np.full(way, task.value[0]), np.full(way, carrying),
        )  # fmt: skip
        if (codes != FREE).any():
            return False
        # The hand is held against what it holds by its boxes, and here by the exact check.
        codes = check(
            prepared.world, chain, arm_spheres(robot), q[way:], where[way:], task.value,
            task.holding,
        )  # fmt: skip
        return bool((codes == FREE).all())
