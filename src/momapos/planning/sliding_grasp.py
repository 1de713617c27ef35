"""Open a part with a hook that slides along the handle while the part rests."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.records import ArmPathResult, Attempt
from momapos.planning.arm_motion import Feasibility
from momapos.planning.grasps import FULL_DOF, SlidingMotion, sliding_motion
from momapos.planning.placement import GraspModeScorer, Problem, turning_grasp_scorer

from .config import PipelineConfig
from .task_setup import PreparedTask

if TYPE_CHECKING:
    from jaxtyping import Float, Int


@dataclass(frozen=True)
class SlidingHook:
    """The check of base poses for a task with a sliding hook."""

    motion: SlidingMotion
    feasible: Feasibility

    @cached_property
    def Ts_world_tool(self) -> Float[np.ndarray, "g w 4 4"]:
        """Return the tool poses of the hooks at the waypoints, each once."""
        steps = self.motion.waypoint_steps[~self.motion.after]
        return np.ascontiguousarray(self.motion.Ts_world_tool[:, steps])

    @property
    def mode_scorers(self) -> tuple[GraspModeScorer, ...]:
        """Return the scorer of the hooks between which the hand may slide."""
        return (turning_grasp_scorer(self.Ts_world_tool, self.motion.turning.groups),)

    def problem(self, problem: Problem) -> Problem:
        """Return the search's problem, for a sliding hook."""
        return replace(
            problem,
            geometry=replace(problem.geometry, Ts_world_tool=self.Ts_world_tool),
            mode_scorers=self.mode_scorers,
            screen=self.screen,
            near=self.feasible.follows,
            attempt=self,
        )

    def screen(
        self, bases: Float[np.ndarray, "n 3"], scores: Float[np.ndarray, "n h"], most: int | None
    ) -> list[ArmPathResult]:
        """Search arm paths, see `Feasibility.screen`."""
        return self.feasible.screen(bases, scores, most)

    def __call__(
        self, base: Float[np.ndarray, "3"], screened: ArmPathResult, ways: Int[np.ndarray, " k"]
    ) -> Attempt:
        """Complete a motion at a base pose, see `Feasibility`."""
        return self.feasible(base, screened, ways)


def sliding_hooks(
    prepared: PreparedTask, feasible: Feasibility, config: PipelineConfig
) -> Iterator[SlidingHook]:
    """Yield the task with a sliding hook, if some hook can do it.

    Args:
        prepared: The task.
        feasible: Its check of base poses with one grasp.
        config: How to plan.
    """
    robot, task = prepared.robot, prepared.task
    if prepared.infeasible_reason or robot.chain.size < FULL_DOF:
        return
    target = prepared.scene.object(task.object)
    motion = sliding_motion(prepared.motion, robot, target, config.motion.grasps)
    if motion is not None:
        yield SlidingHook(motion, replace(feasible, motion=motion))
