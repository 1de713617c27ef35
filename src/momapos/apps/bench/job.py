"""One job: load, ask the method, check, carry out; the record of it is a row."""

from __future__ import annotations

import socket
import time
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import MomaposError, require, user_cache
from momapos.model.records import PlacementPlan, ReachScorer
from momapos.model.robots import Robot, load_robot
from momapos.model.scene import Scene, load_scene
from momapos.planning import PipelineConfig
from momapos.planning.baselines import plan_by_method
from momapos.planning.grasps import make_task
from momapos.planning.reachability import load_reach
from momapos.verification import PlanVerifier

from .bench_records import Job, Row, SuiteTask
from .containers import without
from .disturbances import still_does
from .folder import scene_path
from .methods import method_config
from .scanned_rooms import scanned_room
from .steps import Asked, Who, plan_opening_first, plan_step
from .trace import Trace

if TYPE_CHECKING:
    from jaxtyping import Float

    from momapos.simulation import RunRecord

WARM = SuiteTask("warm", "", "kitchen_small", "segway_ur5e", "open", "fridge", "door_hinge")
"""What a process answers once by each method before anything counts, so that its kernels are
loaded."""
NOT_SEEN = "the scan shows nothing there"
WARM_TIME = 10.0
"""Processor time for that [s]."""


def answer_job(job: Job) -> Row:
    """Answer a job: the row of it.

    What momapos raises on purpose becomes a row that failed; everything else passes.
    """
    began = time.perf_counter()
    task, trace = job.task, Trace()
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


def _do_steps(job: Job, trace: Trace) -> None:
    """Open what the thing is in, if anything, and do the task from where the base is then."""
    task = job.task
    who = Who(job, *_robot(task.robot), method_config(job.method, job.settings.timeout), trace)
    scene = _scene(scene_path(Path(job.folder), task.scene)).with_joints(task.joints)
    start = None if task.start is None else np.array(task.start)
    if job.settings.scan:
        _do_from_scan(who, scene, start)
    elif task.inside is not None:
        _carry_out(who, plan_opening_first(who, scene, start, task.inside))
    else:
        scene = without(scene, task.carried) if task.carried else scene
        asked = Asked(scene, make_task(scene, task.verb, task.object, task.joint, task.to), start)
        _carry_out(who, plan_step(who, asked))


def _do_from_scan(who: Who, truth: Scene, start: Float[np.ndarray, "3"] | None) -> None:
    """Do the task in the room as a scan shows it; doors and drawers are opened in the true one."""
    task, settings, trace = who.job.task, who.job.settings, who.trace
    room = scanned_room(Path(who.job.folder), task.scene, truth, settings.scan, task.seed)
    seen = room.task(task.verb, task.object, task.joint, task.to)
    if seen is None:
        trace.end("gave up", NOT_SEEN)
        return
    start = room.start(truth.start if start is None else start)
    asked = make_task(room.scene, task.verb, seen.object, seen.joint, seen.to)
    world = None if seen.joint is None else room.truth
    _carry_out(who, plan_step(who, Asked(room.scene, asked, start)), world=world)
    trace.bases = [room.in_room(pose) for pose in trace.bases]
    modeling = room.modeling(trace.modeled)
    trace.stages["modeling"] = modeling
    trace.seconds += modeling


def _carry_out(
    who: Who, steps: list[tuple[Asked, PlacementPlan]], *, world: Scene | None = None
) -> None:
    """Check the steps that were planned; disturb and carry them out where all of them were.

    Args:
        who: Who does them.
        steps: What was asked, and its plan.
        world: What is really there, in the scene's frame; as the scene says by default.
    """
    trace, settings = who.trace, who.job.settings
    for asked, plan in steps:
        trace.verified, wrong = _checked(asked, plan, who.robot)
        if not trace.verified:
            trace.end("failed", f"exact check refuses the plan: {wrong}".strip())
            return
    if trace.outcome != "solved":
        return
    seed, config = who.job.task.seed, who.config
    for asked, plan in steps:
        scene, robot, reach = asked.scene, who.robot, who.reach
        if settings.disturbances:
            count = settings.disturbances
            trace.disturb(
                still_does(plan, scene, robot, reach, count=count, config=config, seed=seed)
            )  # fmt: skip
        if settings.execute:
            trace.carry_out(_execute(plan, scene, robot, reach, config, seed, world))
        if trace.done is False:
            return


def _checked(asked: Asked, plan: PlacementPlan, robot: Robot) -> tuple[bool, str]:
    """Whether the exact check accepts a plan, else what it finds wrong."""
    assert plan.base_pose is not None
    assert plan.motion is not None
    verifier = PlanVerifier(asked.scene, robot, asked.task)
    checks = (*verifier.check(plan.base_pose, plan.motion).checks, *verifier.drive_checks(plan))
    wrong = next((check for check in checks if not check.ok), None)
    return wrong is None, "" if wrong is None else f"{wrong.name} {wrong.culprit}"


def _execute(
    plan: PlacementPlan, scene: Scene, robot: Robot, reach: ReachScorer, config: PipelineConfig,
    seed: int, world: Scene | None,
) -> RunRecord:  # fmt: skip
    """Drive there with noise, plan anew, and hold by contact, as `momapos run` does."""
    with require("physics"):
        from momapos.simulation import ExecutionConfig, FurnitureConfig
        from momapos.workflows import run_plan

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
