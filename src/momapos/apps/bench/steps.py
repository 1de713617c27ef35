"""Plan the steps of a job with one method."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import SceneError, Stopwatch
from momapos.model.records import PlacementPlan, ReachScorer, Task
from momapos.model.robots import Robot
from momapos.model.scene import Scene
from momapos.planning import (
    MAX_OTHER_REGIONS,
    PipelineConfig,
    PlacementQuery,
    PlacementResult,
    poses_in_other_regions,
    prepare_search,
    without_departure_check,
)
from momapos.planning.baselines import plan_with_method
from momapos.planning.grasps import make_task, task_motion
from momapos.planning.placement import OURS, PoseMask

from .bench_records import Container, Job, Outcome, Pose
from .containers import opened, without
from .trace import JobTrace

if TYPE_CHECKING:
    from jaxtyping import Float

OTHER_POSES = "other base poses"
"""Stage that looks for base poses in other regions of the free floor."""


@dataclass(frozen=True, eq=False)
class Step:
    """One step of a job."""

    scene: Scene
    """The room as the robot knows it."""
    task: Task
    start: Float[np.ndarray, "3"] | None
    """Initial base pose; None for the scene's start."""


@dataclass(frozen=True)
class StepPlanner:
    """A method and a robot that plan the steps of a job."""

    job: Job
    robot: Robot
    reach: ReachScorer
    config: PipelineConfig
    trace: JobTrace

    def plan(self, step: Step, *, keep_poses: PoseMask | None = None) -> PlacementResult:
        """Plan a step, and add its effort to the job.

        Raises:
            SceneError: The base can't stand at the start of the step.
        """
        scene, robot, config = step.scene, self.robot, self.config
        if keep_poses is not None:
            config = without_departure_check(config)
        _fill_caches(scene, robot, step.task, self.reach, step.start, config)
        query = PlacementQuery(
            scene, robot, step.task, self.reach, step.start, config, keep_poses=keep_poses,
            seed=self.job.task.seed, watch=Stopwatch(time.process_time),
        )  # fmt: skip
        result = plan_with_method(query)
        self.trace.add_effort(result.plan)
        return result

    def other_poses(
        self, found: PlacementResult, after: Scene, tried: list[Pose]
    ) -> PoseMask | None:
        """Return a mask of base poses in regions without a tried pose; None if there are none."""
        watch = Stopwatch(time.process_time)
        with watch.stage(OTHER_POSES):
            poses = [np.array(pose) for pose in tried]
            others = poses_in_other_regions(found.prepared.geometry, after, poses)
        self.trace.add_time(watch.timing)
        return others

    def failure(self, plan: PlacementPlan) -> tuple[Outcome, str]:
        """Return the outcome without a plan, and the most frequent rejection reason."""
        counts = plan.candidates.rejections
        most = max(counts, key=lambda reason: counts[reason]) if counts else "no base pose proposed"
        if plan.status == "timeout":
            return "gave up", f"out of time; most frequent rejection: {most}"
        if plan.status == "assumed":
            return "gave up", f"only a plan that assumes that {plan.assumes}"
        return ("infeasible" if self.config.place.method in OURS else "gave up"), most


def plan_step(planner: StepPlanner, step: Step) -> list[tuple[Step, PlacementPlan]]:
    """Plan a job of one step; return the step with its plan, or nothing."""
    plan = planner.plan(step).plan
    planner.trace.add_step(plan)
    if plan.status != "solved":
        planner.trace.end(*planner.failure(plan))
        return []
    return [(step, plan)]


def plan_opening_first(
    planner: StepPlanner, scene: Scene, start: Float[np.ndarray, "3"] | None, box: Container
) -> list[tuple[Step, PlacementPlan]]:
    """Plan to open a container, then plan the task from that base pose.

    If the task is infeasible then, try to open the container from other base poses, unless the
    first one counts. If all fail, the job ends with the first opening and the failure of the task
    after it.
    """
    task, trace = planner.job.task, planner.trace
    room = without(scene, task.carried)
    opening = Step(room, make_task(room, "open", box.object, box.joint, None), start)
    first = found = planner.plan(opening)
    if first.plan.status != "solved":
        trace.end(*planner.failure(first.plan))
        return []
    tried: list[Pose] = []
    failures: list[tuple[Outcome, str]] = []
    while found.plan.base_pose is not None and found.plan.task.to is not None:
        tried.append(found.plan.base_pose)
        after = opened(scene, box, found.plan.task.to, task.carried)
        target = make_task(after, task.verb, task.object, task.joint, task.to)
        step = Step(after, target, np.array(tried[-1]))
        plan, failure = _next_plan(planner, step, box)
        if plan is not None and plan.status == "solved":
            trace.add_step(found.plan)
            trace.add_step(plan)
            return [(opening, found.plan), (step, plan)]
        failures.append(failure)
        timed_out = plan is not None and plan.status == "timeout"
        committed = planner.job.protocol.commit == "first"
        if committed or timed_out or len(tried) > MAX_OTHER_REGIONS:
            break
        others = planner.other_poses(found, after, tried)
        if others is None:
            break
        found = planner.plan(opening, keep_poses=others)
    trace.add_step(first.plan)
    trace.end(*failures[0])
    return [(opening, first.plan)]


def _next_plan(
    planner: StepPlanner, step: Step, box: Container
) -> tuple[PlacementPlan | None, tuple[Outcome, str]]:
    """Plan the task after an opening; return the plan, if any, and its failure."""
    try:
        plan = planner.plan(step).plan
    except SceneError as error:  # the robot can't stay at the base pose of the opening
        reason = str(error).partition(": ")[2].partition(";")[0] or str(error)
        return None, ("gave up", f"after opening {box.object}: {reason}")
    return plan, planner.failure(plan)


def _fill_caches(
    scene: Scene, robot: Robot, task: Task, reach: ReachScorer,
    start: Float[np.ndarray, "3"] | None, config: PipelineConfig,
) -> None:  # fmt: skip
    """Compute the cached data of room and task: bodies, handles, grasps.

    Otherwise they would count only for the first method.
    """
    watch = Stopwatch(time.process_time)
    query = PlacementQuery(scene, robot, task, reach, start, config, watch=watch)
    prepare_search(query, scene, task_motion(scene, robot, task, config.motion))
