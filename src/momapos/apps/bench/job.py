"""Run one job: load, plan, check, execute; the result is a row."""

from __future__ import annotations

import socket
import time
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import MomaposError, OutOfTimeError, require
from momapos.model.plan_files import write_plan
from momapos.model.records import PlacementPlan, ReachScorer
from momapos.model.robots import Robot, load_robot, opened_as
from momapos.model.scene import Scene, load_scene, with_assumptions
from momapos.planning import PipelineConfig, plan_by_method
from momapos.planning.grasps import make_task
from momapos.planning.reachability import load_reach
from momapos.verification import PlanVerifier

from .bench_records import Job, Row, SuiteTask
from .containers import without
from .disturbances import works_disturbed
from .folder import scene_path
from .methods import method_config
from .scan_stages import MODELING, SURVEY
from .scanned_rooms import scanned_room
from .steps import Step, StepPlanner, plan_opening_first, plan_step
from .trace import JobTrace

if TYPE_CHECKING:
    from jaxtyping import Float

    from momapos.simulation import RunRecord

WARM_UP = SuiteTask("warm", "", "kitchen_small", "segway_ur5e", "open", "fridge", "door_hinge")
"""Task that each process plans once per method before it measures, to load the kernels."""
WARM_UP_TIMEOUT = 10.0
"""Processor time for the warm-up [s]."""
MAX_POSES = 3
"""Maximum number of base poses in physics [-]."""
NOT_SEEN = "no such object in the scan"


def answer_job(job: Job) -> Row:
    """Run a job and return its row; a `MomaposError` becomes a failed row."""
    began = time.perf_counter()
    task, trace = job.task, JobTrace()
    try:
        _warm_up(job.method)
        _run_steps(job, trace)
    except OutOfTimeError as error:
        trace.end("gave up", str(error))
    except MomaposError as error:
        trace.end("failed", str(error))
    return Row(
        key=job.key, task=task.name, group=task.group, robot=task.robot, method=job.method,
        seed=task.seed, outcome=trace.outcome, reason=trace.reason, verified=trace.verified,
        done=trace.done, seconds=trace.seconds, wall=time.perf_counter() - began,
        stages=trace.stages, driving=trace.driving if trace.outcome == "solved" else None,
        checked=trace.checked, sampled=trace.sampled, clearance=trace.clearance,
        bases=tuple(trace.bases), protocol=str(job.protocol), host=socket.gethostname(),
        **trace.disturbed_shares(),
    )  # fmt: skip


def _run_steps(job: Job, trace: JobTrace) -> None:
    task, config = job.task, method_config(job.method, job.settings.timeout, job.protocol)
    planner = StepPlanner(job, *_robot(task.robot), config, trace)
    scene = _scene(scene_path(Path(job.folder), task.scene)).with_joints(task.joints)
    start = None if task.start is None else np.array(task.start)
    if job.settings.scan:
        _run_from_scan(planner, scene, start)
    elif task.inside is not None:
        _check_and_execute(planner, plan_opening_first(planner, scene, start, task.inside))
    else:
        scene = without(scene, task.carried) if task.carried else scene
        step = Step(scene, make_task(scene, task.verb, task.object, task.joint, task.to), start)
        _check_and_execute(planner, plan_step(planner, step))


def _run_from_scan(
    planner: StepPlanner, truth: Scene, start: Float[np.ndarray, "3"] | None
) -> None:
    """Plan in the room as modeled from a scan; execute openings in the true room."""
    job, trace = planner.job, planner.trace
    task = job.task
    room = scanned_room(Path(job.folder), task.scene, truth, job.settings.scan, task.seed)
    seen = room.task(task.verb, task.object, task.joint, task.to)
    if seen is None:
        trace.end("gave up", NOT_SEEN)
        return
    start = room.start(truth.start if start is None else start)
    target = make_task(room.scene, task.verb, seen.object, seen.joint, seen.to)
    world = None if seen.joint is None else room.truth
    _check_and_execute(planner, plan_step(planner, Step(room.scene, target, start)), world=world)
    trace.bases = [room.in_room(pose) for pose in trace.bases]
    stages = {SURVEY: room.surveying, MODELING: room.modeling(trace.modeled)}
    trace.add_time({**stages, "total": sum(stages.values())})


def _check_and_execute(
    planner: StepPlanner, steps: list[tuple[Step, PlacementPlan]], *, world: Scene | None = None
) -> None:
    """Check all plans; if the job is solved, also disturb and execute them.

    Args:
        planner: The planner of the steps.
        steps: The steps with their plans.
        world: The true room, in the scene's frame; the scene by default.
    """
    trace, settings, robot, reach = (
        planner.trace,
        planner.job.settings,
        planner.robot,
        planner.reach,
    )
    for step, plan in steps:
        trace.verified, wrong = _verify(step, plan, opened_as(robot, plan.robot_rest))
        if not trace.verified:
            trace.end("failed", f"the exact check rejects the plan: {wrong}".strip())
            return
    if trace.outcome != "solved":
        return
    seed, config = planner.job.task.seed, planner.config
    for number, (step, plan) in enumerate(steps, start=1):
        if settings.disturbances:
            trace.add_disturbed(works_disturbed(
                plan, step.scene, robot, reach, count=settings.disturbances, config=config,
                seed=seed,
            ))  # fmt: skip
        if settings.execute:
            attempts = 1 if planner.job.protocol.commit == "first" else MAX_POSES
            record = _execute(
                plan, step.scene, robot, reach, config, seed, world, attempts,
                _record_file(planner.job, number),
            )  # fmt: skip
            trace.add_run(record)
        if trace.done is False:
            return


def _verify(step: Step, plan: PlacementPlan, robot: Robot) -> tuple[bool, str]:
    """Return whether the exact check accepts a plan, and the failed check."""
    assert plan.base_pose is not None
    assert plan.motion is not None
    verifier = PlanVerifier(with_assumptions(step.scene, plan), robot, step.task)
    checks = (*verifier.check(plan.base_pose, plan.motion).checks, *verifier.drive_checks(plan))
    wrong = next((check for check in checks if not check.ok), None)
    return wrong is None, "" if wrong is None else f"{wrong.name} {wrong.culprit}"


def _execute(
    plan: PlacementPlan, scene: Scene, robot: Robot, reach: ReachScorer, config: PipelineConfig,
    seed: int, world: Scene | None, attempts: int, file: Path | None,
) -> RunRecord:  # fmt: skip
    """Execute a plan in physics with noise and contact grasping, as `momapos run` does.

    If there is a file, the record with its motion is written to it, and the plan next to it.
    """
    with require("physics"):
        from momapos.simulation import (
            ExecutionConfig,
            FurnitureConfig,
            RunTrace,
            with_files,
            write_run,
        )
        from momapos.workflows import run_plan

    watch = None if file is None else RunTrace()
    record = run_plan(
        plan, scene, robot, reach, world=world, attempts=attempts, config=config, seed=seed,
        physics=ExecutionConfig(hold="contact", furniture=FurnitureConfig(spread=0.3)),
        clock=time.process_time, watch=watch, trace=None if watch is None else watch.drive,
    )  # fmt: skip
    if file is not None and watch is not None:
        plan_file = file.with_name(f"{file.stem}.plan.json")
        write_plan(plan, plan_file)
        write_run(replace(with_files(record, file, plan_file), motion=watch.motion()), file)
    return record


def _record_file(job: Job, step: int) -> Path | None:
    """Return the file for the record of a step of a job; None if there shall be none."""
    if not job.record:
        return None
    return Path(job.record) / job.task.robot / f"{job.key}_{step}.json"


# --------------------------------------------------------------------- caches of a process


@lru_cache(maxsize=16)
def _scene(path: Path) -> Scene:
    return load_scene(path)


@lru_cache(maxsize=8)
def _robot(name: str) -> tuple[Robot, ReachScorer]:
    robot = load_robot(name)
    return robot, load_reach(robot)


@lru_cache(maxsize=256)
def _warm_up(method: str) -> None:
    """Plan an easy task, so that loading kernels counts for no job."""
    robot, reach = _robot(WARM_UP.robot)
    scene = load_scene(WARM_UP.scene)
    task = make_task(scene, WARM_UP.verb, WARM_UP.object, WARM_UP.joint)
    config = method_config(method, WARM_UP_TIMEOUT)
    plan_by_method(scene, robot, task, reach, config=config, clock=time.process_time)
