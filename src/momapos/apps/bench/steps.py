"""The steps of a job, planned one after the other by one method."""

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
    OTHERS,
    PipelineConfig,
    PlacementQuery,
    PlacementResult,
    base_poses_elsewhere,
    ready_search,
    without_way_on,
)
from momapos.planning.baselines import plan_by_method
from momapos.planning.grasps import make_task, task_motion
from momapos.planning.placement import OURS, PoseFilter

from .bench_records import Container, Job, Outcome, Pose
from .containers import opened, without
from .trace import Trace

if TYPE_CHECKING:
    from jaxtyping import Float

ELSEWHERE = "other base poses"
"""Stage in which it is found out whether another base pose leads elsewhere."""


@dataclass(frozen=True)
class Asked:
    """One step as it is asked."""

    scene: Scene
    """The room as the robot knows it."""
    task: Task
    start: Float[np.ndarray, "3"] | None
    """Where the base is; None for the scene's start."""


@dataclass(frozen=True)
class Who:
    """Who answers a job."""

    job: Job
    robot: Robot
    reach: ReachScorer
    config: PipelineConfig
    trace: Trace

    def answer(self, asked: Asked, *, pose_filter: PoseFilter | None = None) -> PlacementResult:
        """The method's answer to a step; what it took is added to the job.

        Raises:
            SceneError: The base cannot stand where the step begins.
        """
        scene, robot, config = asked.scene, self.robot, self.config
        if pose_filter is not None:
            config = without_way_on(config)
        _make_ready(scene, robot, asked.task, self.reach, asked.start, config)
        result = plan_by_method(
            scene, robot, asked.task, self.reach, start=asked.start, pose_filter=pose_filter,
            config=config, seed=self.job.task.seed, clock=time.process_time,
        )  # fmt: skip
        self.trace.spend(result.plan)
        return result

    def elsewhere(
        self, found: PlacementResult, after: Scene, tried: list[Pose]
    ) -> PoseFilter | None:
        """What rules out base poses of a step that are no other than those that were tried."""
        watch = Stopwatch(time.process_time)
        with watch.stage(ELSEWHERE):
            poses = [np.array(pose) for pose in tried]
            others = base_poses_elsewhere(found.prepared.geometry, after, poses)
        self.trace.add_time(watch.timing)
        return others

    def refusal(self, plan: PlacementPlan) -> tuple[Outcome, str]:
        """How a search without a plan ended, and for what most base poses were refused."""
        counts = plan.candidates.rejections
        most = max(counts, key=lambda reason: counts[reason]) if counts else "no base pose proposed"
        if plan.status == "timeout":
            return "gave up", f"out of time; most: {most}"
        return ("infeasible" if self.config.place.method in OURS else "gave up"), most


def plan_step(who: Who, asked: Asked) -> list[tuple[Asked, PlacementPlan]]:
    """A job of one step."""
    plan = who.answer(asked).plan
    who.trace.take(plan)
    if plan.status != "solved":
        who.trace.end(*who.refusal(plan))
        return []
    return [(asked, plan)]


def plan_opening_first(
    who: Who, scene: Scene, start: Float[np.ndarray, "3"] | None, box: Container
) -> list[tuple[Asked, PlacementPlan]]:
    """A container opened, and the task done from where the base is then.

    Where the task cannot be done then, the container is opened from a base pose elsewhere. The job
    ends with the refusal of the task after the opening as it was planned first.
    """
    task, trace = who.job.task, who.trace
    room = without(scene, task.carried)
    opening = Asked(room, make_task(room, "open", box.object, box.joint, None), start)
    first = found = who.answer(opening)
    if first.plan.status != "solved":
        trace.end(*who.refusal(first.plan))
        return []
    tried: list[Pose] = []
    refusals: list[tuple[Outcome, str]] = []
    while found.plan.base_pose is not None and found.plan.task.to is not None:
        tried.append(found.plan.base_pose)
        after = opened(scene, box, found.plan.task.to, task.carried)
        target = make_task(after, task.verb, task.object, task.joint, task.to)
        asked = Asked(after, target, np.array(tried[-1]))
        plan, why = _next_plan(who, asked, box)
        if plan is not None and plan.status == "solved":
            trace.take(found.plan)
            trace.take(plan)
            return [(opening, found.plan), (asked, plan)]
        refusals.append(why)
        if len(tried) > OTHERS or (plan is not None and plan.status == "timeout"):
            break
        others = who.elsewhere(found, after, tried)
        if others is None:
            break
        found = who.answer(opening, pose_filter=others)
    trace.take(first.plan)
    trace.end(*refusals[0])
    return [(opening, first.plan)]


def _next_plan(
    who: Who, asked: Asked, box: Container
) -> tuple[PlacementPlan | None, tuple[Outcome, str]]:
    """The task after an opening, and what its refusal is; no plan where it cannot begin."""
    try:
        plan = who.answer(asked).plan
    except SceneError as error:  # the robot cannot stand there any more
        why = str(error).partition(": ")[2].partition(";")[0] or str(error)
        return None, ("gave up", f"where it opened {box.object}: {why}")
    return plan, who.refusal(plan)


def _make_ready(
    scene: Scene, robot: Robot, task: Task, reach: ReachScorer,
    start: Float[np.ndarray, "3"] | None, config: PipelineConfig,
) -> None:  # fmt: skip
    """Make what a process keeps of a room and a task: bodies, handles, grasps.

    Else the method that is asked first pays for it, and those that are asked next do not.
    """
    watch = Stopwatch(time.process_time)
    query = PlacementQuery(scene, robot, task, reach, start, None, config, 0, watch)
    ready_search(query, scene, task_motion(scene, robot, task, config.motion))
