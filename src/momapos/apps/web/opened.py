"""Sources other than a scene with which the page opens: a plan, a tour, a run record, a scan."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import Clock
from momapos.model.records import PlacementPlan, Scan
from momapos.model.robots import Robot
from momapos.model.scene import Scene, load_scene
from momapos.planning import PlacementResult, prepare
from momapos.planning.grasps import slides
from momapos.planning.placement import Search
from momapos.simulation import RunRecord

from .card import Card
from .playback import Playable, Story
from .question import METHODS, Question
from .run_story import RunStory
from .tour_story import TourStory
from .words import run_card, target_text, tour_card

if TYPE_CHECKING:
    from momapos.perception import Modeled


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
        return tour_card([self.plan, *(one.plan for one in self.then)]) if self.then else None

    @property
    def question(self) -> Question:
        """The question that the plan answers."""
        plan = self.plan
        task = plan.task
        if self.run is not None and self.run.true_task is not None:
            task = self.run.true_task
        to = "" if task.to is None else quantity_text(task.to, slides=slides(self.scene, task))
        method = plan.method if plan.method in METHODS else METHODS[0]
        return Question(task.verb, target_text(task), to, method, plan.seed, plan.start)

    def answer(self) -> PlacementResult | None:
        """Return the plan as an answer without a search; None for a run in another world.

        Raises:
            TaskError: The gripper cannot hold the object.
        """
        if self.run is not None and self.run.true_task is not None:
            return None
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
        if self.then:
            tasks = (self, *self.then)
            return TourStory.of([t.plan for t in tasks], [t.scene for t in tasks], self.robot)
        return Story.of(self.plan, self.robot, self.scene)


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
