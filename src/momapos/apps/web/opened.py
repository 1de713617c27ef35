"""Sources other than a scene with which the page opens: a plan, a tour, a run record, a scan."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.apps.export import recorded_motion
from momapos.core import Clock
from momapos.core.geometry import pose_wxyz, wrap_angle
from momapos.model.records import PlacementPlan, Scan
from momapos.model.robots import Robot
from momapos.model.scene import Scene, load_scene
from momapos.planning import PlacementResult, Tour, prepare
from momapos.planning.grasps import slides
from momapos.planning.placement import Search
from momapos.simulation import RunMotion, RunRecord

from .card import Card
from .playback import Moment, Playable, story_of
from .question import METHODS, Question
from .robot_view import home_values
from .words import run_card, target_text, tasks_card

if TYPE_CHECKING:
    from momapos.perception import Modeled


@dataclass(frozen=True)
class RunStory:
    """A run as moments, interpolated between those of the record."""

    robot: Robot
    joint: str | None
    """The joint that the task moves; None for a movable object."""
    motion: RunMotion

    @classmethod
    def of(cls, record: RunRecord, robot: Robot) -> RunStory:
        """Build the motion of a run.

        Raises:
            InputError: The record has no motion, or belongs to another robot.
        """
        motion, task = recorded_motion(record, robot), record.true_task or record.task
        return cls(robot, task.joint, motion)

    @property
    def duration(self) -> float:
        """[s]"""
        return self.motion.times[-1]

    def at(self, seconds: float) -> Moment:
        """Interpolate the moment at a time [s], clipped to the duration."""
        motion = self.motion
        times = np.array(motion.times)
        i = int(np.clip(np.searchsorted(times, seconds, side="right") - 1, 0, len(times) - 2))
        step = times[i + 1] - times[i]
        share = float(np.clip((seconds - times[i]) / step, 0.0, 1.0)) if step > 0 else 1.0

        def between(values: tuple[float, ...]) -> float:
            return values[i] + share * (values[i + 1] - values[i])

        begin, end = np.array(motion.bases[i]), np.array(motion.bases[i + 1])
        base = begin + share * np.append(end[:2] - begin[:2], wrap_angle(end[2] - begin[2]))
        moved = {name: between(values) for name, values in motion.joints.items()}
        object_q = {self.joint: between(motion.part)} if self.joint and motion.part else {}
        object_q |= {name: between(values) for name, values in motion.latch.items()}
        near = i + round(share)
        return Moment(
            base, {**home_values(self.robot), **moved}, object_q, motion.stages[near],
            np.array(motion.forces[near]) if motion.forces else None,
            pose_wxyz(motion.poses[near][:3], motion.poses[near][3:]) if motion.poses else None,
        )  # fmt: skip


@dataclass(frozen=True)
class Opened:
    """A plan from a file, with its scene and robot, and the run or the tour it belongs to."""

    name: str
    """Name of the scene on the page."""
    scene: Scene
    """The scene of the plan; for a run the true world."""
    robot: Robot
    plan: PlacementPlan
    run: RunRecord | None = None
    then: tuple[Opened, ...] = ()
    """Later tasks of a tour."""

    @property
    def card(self) -> Card | None:
        """Description of the run or the tour; None for a single plan."""
        if self.run is not None:
            return run_card(self.run)
        return tasks_card([self.plan, *(one.plan for one in self.then)]) if self.then else None

    @property
    def question(self) -> Question:
        """The question that the plan answers."""
        plan = self.plan
        task = plan.task
        if self.run is not None and self.run.true_task is not None:
            task = self.run.true_task
        to = "" if task.to is None else quantity_text(task.to, slides=slides(self.scene, task))
        method = plan.method if plan.method in METHODS else METHODS[0]
        return Question(
            task.verb, target_text(task), to, method, plan.seed, plan.start, task.poses
        )  # fmt: skip

    def answer(self) -> Tour | None:
        """Return the plans as an answer without a search; None for a run in another world.

        Raises:
            TaskError: The gripper cannot hold the object.
        """
        if self.run is not None and self.run.true_task is not None:
            return None
        tasks = (self, *self.then)
        steps = tuple(one._result() for one in tasks)
        stops = tuple(range(1, 1 + len(tasks)))
        return Tour(steps, stops, scenes=tuple(one.scene for one in tasks))

    def _result(self) -> PlacementResult:
        plan, config = self.plan, self.question.config
        prepared = prepare(self.scene, self.robot, plan.task, config, clearance=0.0)
        start = plan.start or plan.base_pose
        assert start is not None
        return PlacementResult(plan, prepared, Search(), np.array(start))

    def story(self) -> Playable:
        """Return the motion of the plan, the tour, or the run.

        Raises:
            InputError: There is no motion to show.
        """
        if self.run is not None:
            return RunStory.of(self.run, self.robot)
        tasks = (self, *self.then)
        return story_of([t.plan for t in tasks], [t.scene for t in tasks], self.robot)


def quantity_text(to: float, *, slides: bool) -> str:
    """Format a joint value as a user types it: in degrees where these are exact."""
    if slides:
        return f"{to!r}m"
    degrees = f"{math.degrees(to):g}"
    exact = math.isclose(math.radians(float(degrees)), to, rel_tol=1e-12)
    return f"{degrees}deg" if exact else f"{to!r}rad"


@dataclass
class OpenedScan:
    """A scan, from which a scene is built when it is first shown."""

    name: str
    scan: Scan
    folder: Path
    """Where the scene and its models are written."""
    modeled: Modeled | None = None
    """Result of the perception pipeline; None before it has run."""

    def load(self, clock: Clock, report: Callable[[str, float], None]) -> Scene:
        """Return the scene of the scan.

        Args:
            clock: Called between steps; may raise to cancel.
            report: Called with what is being done, and the share that is done.

        Raises:
            InputError: The scan contains no objects.
        """
        if self.modeled is None:
            from momapos.workflows import scan_to_scene  # imports the whole perception pipeline

            def progress(what: str, share: float) -> None:
                clock()
                report(f"Scan: {what}", share)

            out = self.folder / "scene.json"
            self.modeled = scan_to_scene(self.scan, out, progress=progress, clock=clock)
        return load_scene(self.modeled.scene)
