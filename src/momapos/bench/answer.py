"""One job: load, ask the method, check, carry out; the record of it is a row."""

from __future__ import annotations

import socket
import time
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.baselines.answer import plan_by_method
from momapos.bench.containers import opened, without
from momapos.bench.disturbances import still_does
from momapos.bench.folder import scene_path
from momapos.bench.methods import method_config
from momapos.bench.records import Job, Outcome, Pose, Row, SuiteTask
from momapos.bench.scans import scanned_room
from momapos.cache import user_cache
from momapos.config import PipelineConfig
from momapos.errors import MomaposError, SceneError, require
from momapos.manipulation.motion import task_motion
from momapos.manipulation.tasks import make_task
from momapos.placement.config import OURS
from momapos.protocols import ReachScorer
from momapos.query import PlacementQuery
from momapos.reachability.store import load_reach
from momapos.ready_search import ready_search
from momapos.robots.robot import Robot, load_robot
from momapos.scene.files import load_scene
from momapos.scene.scene import Scene
from momapos.stopwatch import Stopwatch
from momapos.types import PlacementPlan, Task
from momapos.verification.exact import PlanVerifier

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

    from momapos.execution.record import RunRecord

WARM = SuiteTask("warm", "", "kitchen_small", "segway_ur5e", "open", "fridge", "door_hinge")
"""What a process answers once by each method before anything counts, so that its kernels are
loaded."""
NOT_SEEN = "the scan shows nothing there"
WARM_TIME = 10.0
"""Processor time for that [s]."""


@dataclass
class _Trace:
    """What a job leaves, step after step."""

    stages: dict[str, float] = field(default_factory=dict)
    seconds: float = 0.0
    driving: float = 0.0
    checked: int = 0
    sampled: int = 0
    bases: list[Pose] = field(default_factory=list)
    modeled: tuple[str, ...] | None = None
    """What the last step had modeled; None for everything."""
    verified: bool | None = None
    done: bool | None = None
    clearance: float | None = None
    held: Bool[np.ndarray, "levels n"] | None = None
    """From which disturbed base poses all steps so far still work."""
    outcome: Outcome = "solved"
    reason: str = ""

    def take(self, plan: PlacementPlan) -> None:
        """Add what a plan says to the steps before."""
        for stage, seconds in plan.timing.items():
            if stage != "total":
                self.stages[stage] = self.stages.get(stage, 0.0) + seconds
        self.seconds += plan.timing.get("total", 0.0)
        self.checked += plan.candidates.checked
        self.sampled += plan.candidates.sampled
        self.driving += plan.navigation_cost or 0.0
        self.modeled = None if plan.key_objects is None else plan.key_objects.names
        if plan.base_pose is not None:
            self.bases.append(plan.base_pose)

    def carry_out(self, record: RunRecord) -> None:
        """Add what physics says; a job is done where all its steps are."""
        self.done = record.success and self.done is not False
        self.reason = self.reason or record.reason
        seen = [visit.clearance for visit in record.visits]
        seen.append(None if record.execution is None else record.execution.clearance)
        known = [value for value in (self.clearance, *seen) if value is not None]
        self.clearance = min(known, default=None)

    def disturb(self, held: Bool[np.ndarray, "levels n"]) -> None:
        """Add from which disturbed base poses a step still works."""
        self.held = held if self.held is None else self.held & held

    def shares_held(self) -> dict[str, float]:
        """Columns of the row that say how much of a solved job survives base errors."""
        if self.held is None or self.outcome != "solved":
            return {}
        at_2cm, at_5cm = self.held.mean(axis=1).tolist()
        return {"at_2cm": at_2cm, "at_5cm": at_5cm}

    def end(self, outcome: Outcome, reason: str) -> None:
        """Say how the job ended."""
        self.outcome, self.reason = outcome, reason


def answer_job(job: Job) -> Row:
    """Answer a job: the row of it.

    What momapos raises on purpose becomes a row that failed; everything else passes.
    """
    began = time.perf_counter()
    task, trace = job.task, _Trace()
    try:
        _warm_up(job.method)
        _do_steps(job, trace)
    except MomaposError as error:
        trace.end("failed", str(error))
    return Row(
        key=job.key, task=task.name, group=task.group, robot=task.robot, method=job.method,
        seed=task.seed, outcome=trace.outcome, reason=trace.reason, verified=trace.verified,
        done=trace.done, seconds=trace.seconds, wall=time.perf_counter() - began,
        stages=trace.stages, driving=trace.driving if trace.outcome == "solved" else None,
        checked=trace.checked, sampled=trace.sampled, clearance=trace.clearance,
        bases=tuple(trace.bases), host=socket.gethostname(), **trace.shares_held(),
    )  # fmt: skip


def _do_steps(job: Job, trace: _Trace) -> None:
    """Open what the thing is in, if anything, and do the task from where the base is then."""
    task = job.task
    robot, reach = _robot(task.robot)
    scene = _scene(scene_path(Path(job.folder), task.scene)).with_joints(task.joints)
    start = None if task.start is None else np.array(task.start)
    if job.settings.scan:
        _do_from_scan(job, scene, robot, reach, start, trace)
        return
    if task.inside is not None:
        box, room = task.inside, without(scene, task.carried)
        plan = _step(job, room, robot, reach, "open", (box.object, box.joint, None), start, trace)
        if plan is None or plan.base_pose is None or plan.task.to is None:
            return
        scene = opened(scene, box, plan.task.to, task.carried)
        start = np.array(plan.base_pose)
    elif task.carried:
        scene = without(scene, task.carried)
    target = (task.object, task.joint, task.to)
    try:
        _step(job, scene, robot, reach, task.verb, target, start, trace)
    except SceneError as error:  # the robot cannot stand there any more
        if task.inside is None:
            raise
        why = str(error).partition(": ")[2].partition(";")[0] or str(error)
        trace.end("gave up", f"where it opened {task.inside.object}: {why}")


def _do_from_scan(
    job: Job, truth: Scene, robot: Robot, reach: ReachScorer,
    start: Float[np.ndarray, "3"] | None, trace: _Trace,
) -> None:  # fmt: skip
    """Do the task in the room as a scan shows it; doors and drawers are opened in the true one."""
    task, settings = job.task, job.settings
    room = scanned_room(Path(job.folder), task.scene, truth, settings.scan, task.seed)
    asked = room.task(task.verb, task.object, task.joint, task.to)
    if asked is None:
        trace.end("gave up", NOT_SEEN)
        return
    start = room.start(truth.start if start is None else start)
    target = (asked.object, asked.joint, asked.to)
    world = None if asked.joint is None else room.truth
    _step(job, room.scene, robot, reach, task.verb, target, start, trace, world=world)
    trace.bases = [room.in_room(pose) for pose in trace.bases]
    modeling = room.modeling(trace.modeled)
    trace.stages["modeling"] = modeling
    trace.seconds += modeling


def _step(
    job: Job, scene: Scene, robot: Robot, reach: ReachScorer, verb: str,
    target: tuple[str, str | None, float | None], start: Float[np.ndarray, "3"] | None,
    trace: _Trace, *, world: Scene | None = None,
) -> PlacementPlan | None:  # fmt: skip
    """Answer, check and carry out one step.

    Args:
        job: What is asked, and how.
        scene: The room as the robot knows it.
        robot, reach: Who does it.
        verb, target: The task: object, joint and value.
        start: Where the base is.
        trace: What is left of the job.
        world: What is really there, in the scene's frame; as the scene says by default.

    Returns:
        The plan, where the next step can follow; the trace says why not where it cannot.
    """
    config = method_config(job.method, job.settings.timeout)
    asked = make_task(scene, verb, *target)
    seed = job.task.seed
    _make_ready(scene, robot, asked, reach, start, config)
    plan = plan_by_method(
        scene, robot, asked, reach, start=start, config=config, seed=seed, clock=time.process_time
    ).plan
    trace.take(plan)
    if plan.motion is None or plan.base_pose is None:
        trace.end(*_refusal(plan, config))
        return None
    verifier = PlanVerifier(scene, robot, asked)
    checks = (*verifier.check(plan.base_pose, plan.motion).checks, *verifier.drive_checks(plan))
    wrong = next((check for check in checks if not check.ok), None)
    trace.verified = wrong is None
    if wrong is not None:
        trace.end("failed", f"exact check refuses the plan: {wrong.name} {wrong.culprit}".strip())
        return None
    if job.settings.disturbances:
        count = job.settings.disturbances
        trace.disturb(
            still_does(plan, scene, robot, reach, count=count, config=config, seed=seed)
        )  # fmt: skip
    if job.settings.execute:
        trace.carry_out(_execute(plan, scene, robot, reach, config, seed, world))
    return None if trace.done is False else plan


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


def _refusal(plan: PlacementPlan, config: PipelineConfig) -> tuple[Outcome, str]:
    """How a search without a plan ended, and the most frequent reason for which poses failed."""
    counts = plan.candidates.rejections
    most = max(counts, key=lambda reason: counts[reason]) if counts else "no base pose proposed"
    if plan.status == "timeout":
        return "gave up", f"out of time; most: {most}"
    return ("infeasible" if config.place.method in OURS else "gave up"), most


def _execute(
    plan: PlacementPlan, scene: Scene, robot: Robot, reach: ReachScorer, config: PipelineConfig,
    seed: int, world: Scene | None,
) -> RunRecord:  # fmt: skip
    """Drive there with noise, plan anew, and hold by contact, as `momapos run` does."""
    with require("physics"):
        from momapos.execution.config import ExecutionConfig, FurnitureConfig
        from momapos.run_plan import run_plan

    return run_plan(
        plan, scene, robot, reach, world=world, config=config, seed=seed,
        physics=ExecutionConfig(hold="contact", furniture=FurnitureConfig(spread=0.3)),
        clock=time.process_time,
    )  # fmt: skip


# --------------------------------------------------------------------- what a process keeps


@lru_cache(maxsize=16)
def _scene(path: Path) -> Scene:
    return load_scene(path, cache=user_cache())


@lru_cache(maxsize=8)
def _robot(name: str) -> tuple[Robot, ReachScorer]:
    robot = load_robot(name)
    return robot, load_reach(robot, user_cache().folder)


@lru_cache(maxsize=256)
def _warm_up(method: str) -> None:
    """Answer an easy question by a method, so that what is loaded once counts for no job."""
    robot, reach = _robot(WARM.robot)
    scene = load_scene(WARM.scene, cache=user_cache())
    task = make_task(scene, WARM.verb, WARM.object, WARM.joint)
    config = method_config(method, WARM_TIME)
    plan_by_method(scene, robot, task, reach, config=config, clock=time.process_time)
