"""Run one job: load, plan, check, execute; the result is a row.

The room of a job may be scanned and modeled first, once per room, in the results folder:

scans/ROOM/scene.json   the complete model of the room
scans/ROOM/scan.json    pose of the true room in the model, and the time of modeling
"""

from __future__ import annotations

import json
import os
import re
import shutil
import socket
import time
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.apps.synthetic_scans import DepthSensor, synthetic_scan
from momapos.core import (
    FileFormatError,
    InputError,
    MomaposError,
    OutOfTimeError,
    SceneError,
    Stopwatch,
    read_bytes_bounded,
    require,
    temporary_folder,
)
from momapos.core.geometry import apply, compose, local_points, wrap_angle
from momapos.model.plan_files import write_plan
from momapos.model.records import PlacementPlan, ReachScorer, Scan, Task
from momapos.model.robots import Robot, load_robot, opened_as
from momapos.model.scene import Scene, load_scene, with_assumptions
from momapos.perception import ScanConfig, Tools, default_tools, model_room, survey
from momapos.planning import (
    MAX_OTHER_REGIONS,
    PipelineConfig,
    PlacementQuery,
    PlacementResult,
    check_base_pose,
    plan_by_method,
    poses_in_other_regions,
    prepare_search,
    without_departure_check,
)
from momapos.planning.baselines import plan_with_method
from momapos.planning.grasps import hand_path, make_task, task_motion
from momapos.planning.placement import OURS, PoseMask
from momapos.planning.reachability import load_reach
from momapos.simulation import moved, true_world
from momapos.verification import PlanVerifier
from momapos.workflows import motion_from

from .bench_records import Container, Job, Outcome, Pose, Row, SuiteTask, from_plain, to_plain
from .folder import scene_path
from .methods import method_config, opened, without
from .report_tables import MODELING, SURVEY

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

    from momapos.simulation import RunRecord


CONFIG = ScanConfig(voxel=0.008)
"""Finer than the default, whose voxels make objects 2 cm too wide for most hands."""
SCENE, RECORD = "scene.json", "scan.json"
MAX_BYTES = 1_000_000
BOX_MARGIN = 0.02
"""Maximum distance of an object's true center from its box in the scan [m]."""


@dataclass(frozen=True)
class ScanRecord:
    """Contents of scan.json."""

    frames: int
    """Number of images."""
    room: Pose
    """Pose of the true room's origin in the modeled scene [m], [rad]."""
    survey: Mapping[str, float]
    """Processor time by stage for the boxes of all objects, and for writing the scene [s]."""
    models: Mapping[str, float]
    """Processor time to model each object, by name [s]."""


@dataclass(frozen=True)
class ScannedRoom:
    """A room modeled from a scan, and the true room in the frame of the model."""

    scene: Scene
    truth: Scene
    record: ScanRecord

    @property
    def surveying(self) -> float:
        """Return the processor time from the images to the boxes of all objects [s]."""
        return sum(self.record.survey.values())

    def modeling(self, names: Collection[str] | None) -> float:
        """Return the processor time to model some objects [s].

        Args:
            names: The modeled objects; None for all.
        """
        models = self.record.models
        return sum(models[name] for name in models if names is None or name in names)

    def start(self, pose: Float[np.ndarray, "3"] | None) -> Float[np.ndarray, "3"] | None:
        """Transform a base pose from the true room to the scene."""
        return None if pose is None else compose(np.array(self.record.room), pose[None])[0]

    def in_room(self, pose: Pose) -> Pose:
        """Transform a base pose from the scene to the true room."""
        ((x, y),) = local_points(np.array(self.record.room), np.array([pose[:2]])).tolist()
        return x, y, float(wrap_angle(pose[2] - self.record.room[2]))

    def task(self, verb: str, name: str, joint: str | None, to: float | None) -> Task | None:
        """Translate a task in the true room to the scene; None if the scene has no such object.

        Args:
            verb, name, joint, to: Arguments of `make_task` in the true room.

        Raises:
            TaskError: The true room has no such task, or the scene's model does not allow it.
        """
        true_task = make_task(self.truth, verb, name, joint, to)
        if true_task.joint is None:
            found = self._object_at(hand_path(self.truth, name)[0])
            return None if found is None else make_task(self.scene, true_task.verb, found)
        handle = hand_path(self.truth, name, true_task.joint, true_task.to)[0]
        try:
            there = true_world(self.scene, self.truth, true_task, handle).task
        except InputError:  # the scan shows nothing that opens there
            return None
        return make_task(self.scene, true_task.verb, there.object, there.joint, there.to)

    def _object_at(self, point: Float[np.ndarray, "3"]) -> str | None:
        """Return the smallest object whose box contains a point."""
        around = [
            item
            for item in self.scene.objects
            for low, high in [item.bounds]
            if (point >= low - BOX_MARGIN).all() and (point <= high + BOX_MARGIN).all()
        ]
        smallest = min(around, key=lambda item: float(np.ptp(item.bounds, 0).prod()), default=None)
        return None if smallest is None else smallest.name


def scanned_room(folder: Path, name: str, truth: Scene, frames: int, seed: int) -> ScannedRoom:
    """Return a scanned room; scan and model it if the folder does not have it.

    Args:
        folder: The results folder.
        name: Name of the room in the tasks.
        truth: The true room.
        frames: Number of images of the scan.
        seed: Seed of materials, route and noise.

    Raises:
        InputError: The folder can't be written, or the scan shows nothing.
        MissingExtraError: Packages for scans are missing.
    """
    home = folder / "scans" / re.sub(r"[^A-Za-z0-9_.-]", "_", Path(name).stem)
    if not (home / RECORD).exists():
        _make(home, truth, frames, seed)
    record = _read(home / RECORD)
    scene = load_scene(home / SCENE)
    if truth.floor_polygon is None:  # the room continues beyond the scanned floor
        scene = replace(scene, floor_polygon=None)
    return ScannedRoom(scene, moved(truth, np.array(record.room)), record)


def _make(home: Path, truth: Scene, frames: int, seed: int) -> None:
    """Scan and model a room; write the complete result or nothing."""
    tools = default_tools()
    images = synthetic_scan(truth, frames=frames, seed=seed, sensor=DepthSensor())
    scan = Scan(truth.name, tuple(images.frames()))
    try:
        home.parent.mkdir(parents=True, exist_ok=True)
        with temporary_folder(home.parent, home.name) as temporary:
            new = temporary / "new"
            new.mkdir()
            record = _modeled(scan, new / SCENE, tools, frames)
            (new / RECORD).write_text(json.dumps(to_plain(record), indent=1) + "\n")
            if home.exists() and not (home / RECORD).exists():
                shutil.rmtree(home)
            if not home.exists():  # else another worker was faster, with an equal result
                os.rename(new, home)
    except OSError as error:
        if not (home / RECORD).exists():
            why = error.strerror or error
            raise InputError(f"{home}: cannot be written ({why})") from error


def _modeled(scan: Scan, out: Path, tools: Tools, frames: int) -> ScanRecord:
    clock = time.process_time
    seen = survey(scan, tools, config=CONFIG, clock=clock)
    made = model_room(seen, out, tools, config=CONFIG, clock=clock)
    T = seen.T_scene_scan
    x, y, _ = apply(T, np.zeros((1, 3)))[0].tolist()
    turn = float(np.arctan2(T[1, 0], T[0, 0]))
    models = {one.detection.name: one.seconds for one in made.decisions}
    spent = {**seen.timing, "write": made.timing["write"]}
    return ScanRecord(frames, (x, y, turn), spent, models)


def _read(path: Path) -> ScanRecord:
    try:
        data = json.loads(read_bytes_bounded(path, MAX_BYTES))
    except (ValueError, RecursionError) as error:
        raise FileFormatError(f"{path}: damaged JSON ({error})") from error
    return from_plain(data, ScanRecord, str(path))


@dataclass(eq=False)
class JobTrace:
    """Results of a job, summed over its steps."""

    stages: dict[str, float] = field(default_factory=dict)
    seconds: float = 0.0
    driving: float = 0.0
    checked: int = 0
    sampled: int = 0
    bases: list[Pose] = field(default_factory=list)
    modeled: tuple[str, ...] | None = None
    """Objects that the last step modeled; None for all."""
    verified: bool | None = None
    done: bool | None = None
    clearance: float | None = None
    works: Bool[np.ndarray, "levels n"] | None = None
    """Whether all steps so far work at each disturbed base pose."""
    outcome: Outcome = "solved"
    reason: str = ""

    def add_effort(self, plan: PlacementPlan) -> None:
        """Add the time and the base poses of an answer."""
        self.add_time(plan.timing)
        self.checked += plan.candidates.checked
        self.sampled += plan.candidates.sampled

    def add_time(self, timing: Mapping[str, float]) -> None:
        """Add times by stage and their "total" [s]."""
        for stage, seconds in timing.items():
            if stage != "total":
                self.stages[stage] = self.stages.get(stage, 0.0) + seconds
        self.seconds += timing.get("total", 0.0)

    def add_step(self, plan: PlacementPlan) -> None:
        """Add the drive and the base pose of a step's final plan."""
        self.driving += plan.navigation_cost or 0.0
        self.modeled = None if plan.key_objects is None else plan.key_objects.names
        if plan.base_pose is not None:
            self.bases.append(plan.base_pose)

    def add_run(self, record: RunRecord) -> None:
        """Add the physics run of a step; a job is done if all its steps are."""
        self.done = record.success and self.done is not False
        self.reason = self.reason or record.reason
        values = [self.clearance, *(visit.clearance for visit in record.visits)]
        values.append(None if record.execution is None else record.execution.clearance)
        self.clearance = min((value for value in values if value is not None), default=None)

    def add_disturbed(self, works: Bool[np.ndarray, "levels n"]) -> None:
        """Add whether a step works at each disturbed base pose."""
        self.works = works if self.works is None else self.works & works

    def disturbed_shares(self) -> dict[str, float]:
        """Return the columns `at_2cm` and `at_5cm` of a solved job."""
        if self.works is None or self.outcome != "solved":
            return {}
        at_2cm, at_5cm = self.works.mean(axis=1).tolist()
        return {"at_2cm": at_2cm, "at_5cm": at_5cm}

    def end(self, outcome: Outcome, reason: str) -> None:
        self.outcome, self.reason = outcome, reason


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


LEVELS = ((0.02, np.radians(2.0)), (0.05, np.radians(5.0)))
"""Distance [m] and rotation [rad] of the base from its planned pose."""


def disturbed_poses(
    base: Float[np.ndarray, "3"], off: float, turn: float, count: int, rng: np.random.Generator
) -> Float[np.ndarray, "n 3"]:
    """Return base poses at one distance in evenly spread directions, turned to either side.

    Args:
        base: x [m], y [m], yaw [rad].
        off: Distance from the base [m].
        turn: Rotation from the base [rad].
        count: Number of poses.
        rng: Draws the first direction, and the sign of every rotation.
    """
    angle = 2 * np.pi * (np.arange(count) + rng.random()) / max(count, 1)
    turns = turn * rng.choice([-1.0, 1.0], count)
    yaw = wrap_angle(base[2] + turns)
    return np.column_stack([base[:2] + off * np.column_stack([np.cos(angle), np.sin(angle)]), yaw])


def works_disturbed(
    plan: PlacementPlan,
    scene: Scene,
    robot: Robot,
    reach: ReachScorer,
    *,
    count: int,
    config: PipelineConfig,
    seed: int,
) -> Bool[np.ndarray, "levels n"]:
    """Check at which disturbed base poses the replanned arm still does the task.

    Args:
        plan: A solved plan.
        scene, robot, reach: Inputs of the plan.
        count: Base poses at each level.
        config: Configuration of the planner.
        seed: Same seed, same poses.
    """
    assert plan.base_pose is not None
    base, rng = np.array(plan.base_pose), np.random.default_rng(seed)
    task, robot = replace(plan.task, farthest=False), opened_as(robot, plan.robot_rest)

    def works(pose: Float[np.ndarray, "3"]) -> bool:
        if plan.moves_base:  # as a run continues from there
            return motion_from(plan, scene, robot, pose).motion is not None
        attempt = check_base_pose(
            scene, robot, task, pose, reach, how_far=False, config=config, seed=seed
        )
        return attempt.motion is not None

    poses = [disturbed_poses(base, off, turn, count, rng) for off, turn in LEVELS]
    return np.array([[works(pose) for pose in level] for level in poses], bool)


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
