"""What the page is opened with, instead of a scene: a plan, a tour, the record of a run, a scan."""

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

from .playback import Playable, Story
from .question import METHODS, Question
from .run_story import RunStory
from .tour_story import TourStory
from .words import run_words, tour_words

if TYPE_CHECKING:
    from momapos.perception import Modeled


@dataclass(frozen=True)
class Opened:
    """A plan from a file, what it is about, and what came of it."""

    name: str
    """What the scene of the plan is called on the page."""
    scene: Scene
    """As the plan left it; of a run what was really there."""
    robot: Robot
    plan: PlacementPlan
    run: RunRecord | None = None
    then: tuple[Opened, ...] = ()
    """Of a tour the tasks after this one."""

    @property
    def words(self) -> str:
        """What there is to say beside the answer; "" of a single plan."""
        if self.run is not None:
            return run_words(self.run)
        return tour_words([self.plan, *(one.plan for one in self.then)]) if self.then else ""

    @property
    def question(self) -> Question:
        """What the plan answers."""
        plan = self.plan
        task = plan.task
        if self.run is not None and self.run.true_task is not None:
            task = self.run.true_task
        target = task.object if task.joint is None else f"{task.object}/{task.joint}"
        to = "" if task.to is None else far_text(task.to, slides=slides(self.scene, task))
        method = plan.method if plan.method in METHODS else METHODS[0]
        return Question(task.verb, target, to, method, plan.seed, plan.start)

    def answer(self) -> PlacementResult | None:
        """The plan as an answer whose search nobody knows; None where it is for another room.

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
        """The plan, the tour, or what physics made of the plan, over time.

        Raises:
            InputError: There is no motion to show.
        """
        if self.run is not None:
            return RunStory.of(self.run, self.robot)
        if self.then:
            tasks = (self, *self.then)
            return TourStory.of([t.plan for t in tasks], [t.scene for t in tasks], self.robot)
        return Story.of(self.plan, self.robot, self.scene)


def far_text(to: float, *, slides: bool) -> str:
    """How far a part goes, as it is typed on the page: in degrees where these say it exactly."""
    if slides:
        return f"{to!r}m"
    degrees = f"{math.degrees(to):g}"
    exact = math.isclose(math.radians(float(degrees)), to, rel_tol=1e-12)
    return f"{degrees}deg" if exact else f"{to!r}rad"


@dataclass
class OpenedScan:
    """A scan, of which a scene is made when it is shown first."""

    name: str
    scan: Scan
    folder: Path
    """Where the scene and its models are written."""
    modeled: Modeled | None = None
    """What was seen in it; None before it was looked at."""

    def load(self, clock: Clock, tell: Callable[[str], None]) -> Scene:
        """The scene of the scan.

        Args:
            clock: What it raises ends the work.
            tell: Is told what is done.

        Raises:
            InputError: The scan holds nothing.
        """
        if self.modeled is None:
            from momapos.workflows import scan_to_scene  # and all that looks at images

            def progress(what: str, share: float) -> None:
                clock()
                tell(f"scan, {100 * share:.0f} %: {what}")

            out = self.folder / "scene.json"
            self.modeled = scan_to_scene(self.scan, out, progress=progress, clock=clock)
        return load_scene(self.modeled.scene)
