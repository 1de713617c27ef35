"""The question that the page asks, and how it is answered."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, get_args

import numpy as np

from momapos.core import Cache, Clock, Stopwatch, TaskError
from momapos.model.records import (
    JointVerb,
    PoseVerb,
    ReachScorer,
    RequestVerb,
    Task,
    ToolPose,
)
from momapos.model.robots import Robot, load_arms
from momapos.model.scene import Scene
from momapos.planning import (
    PipelineConfig,
    PlacementQuery,
    PlacementResult,
    Request,
    Tour,
    best_tour,
    cheapest,
    plan_at_pose,
    plan_chain,
)
from momapos.planning.baselines import plan_with_method
from momapos.planning.grasps import make_task, openable
from momapos.planning.placement import OURS, Method
from momapos.planning.reachability import load_reach

if TYPE_CHECKING:
    from jaxtyping import Float

METHODS: tuple[str, ...] = get_args(Method)
VERBS: tuple[RequestVerb, ...] = tuple(
    verb for verb in get_args(RequestVerb) if verb not in get_args(PoseVerb)
)
"""What can be planned on the page; tool poses come from files."""


@dataclass(frozen=True)
class Question:
    """A task for a robot in a room, and how to plan it."""

    verb: RequestVerb
    target: str
    """The object, or "object/joint"."""
    to: str = ""
    """Joint value, as 60deg, 0.3m or max; "" for the verb's default. Where to bring an object."""
    method: str = "ours"
    seed: int = 0
    start: tuple[float, float, float] | None = None
    """Start pose x [m], y [m], yaw [rad]; None for the scene's, or a free place."""
    poses: tuple[ToolPose, ...] = ()
    """Tool poses of a plan from a file, which has no target."""

    @property
    def brings(self) -> bool:
        """Whether the task is a tour: to pick an object up, and to place it."""
        return self.verb == "bring"

    def task(self, scene: Scene) -> Task:
        """Build the task in a room; to bring an object begins with picking it up.

        Raises:
            MomaposError: The room has no such object or joint, or the value is out of range.
        """
        if self.poses:
            return Task("reach", "", poses=self.poses)
        name, _, joint = self.target.partition("/")
        if self.verb in get_args(JointVerb):
            return make_task(scene, self.verb, name, joint or None, self.to.strip() or None)
        return make_task(scene, "pick" if self.verb == "bring" else self.verb, name)

    @property
    def config(self) -> PipelineConfig:
        """Configuration of the pipeline."""
        default = PipelineConfig()
        if self.method not in METHODS:
            raise TaskError(f"unknown method {self.method!r}; choose from {', '.join(METHODS)}")
        return replace(default, place=replace(default.place, method=self.method))  # type: ignore[arg-type]


@dataclass(frozen=True)
class RobotArms:
    """A robot, once for each of its arms, with the reachability maps."""

    robots: tuple[Robot, ...]
    maps: tuple[ReachScorer, ...]

    def reach_of(self, arm: str) -> ReachScorer:
        """Return the map of an arm by its name."""
        return next(m for one, m in zip(self.robots, self.maps, strict=True) if one.arm == arm)


class RobotLoader:
    """Loads each robot once.

    Caches elsewhere hold references to robots, so a robot that was loaded at every choice would
    stay in memory as often as it was chosen.
    """

    def __init__(self, cache: Cache) -> None:
        """Set the cache of geometry and maps."""
        self._cache = cache
        self._loaded: dict[tuple[str, str], RobotArms] = {}

    def load(
        self, name: str, arm: str, clock: Clock, report: Callable[[str, float], None]
    ) -> RobotArms:
        """Return a robot and its reachability maps, which are built at the first use.

        Args:
            name: A library robot or a robot file.
            arm: Name of the arm; "any" for all of them.
            clock: Called between steps; may raise to cancel.
            report: Called with what is being done, and the share that is done.
        """
        if (name, arm) not in self._loaded:
            arms = load_arms(name, arm, cache=self._cache)

            def progress(share: float, what: str = "") -> None:
                clock()
                report(f"Reachability map of {arms[0].name} {what}".rstrip(), share)

            maps = tuple(load_reach(robot, self._cache.folder, progress) for robot in arms)
            self._loaded[name, arm] = RobotArms(arms, maps)
        return self._loaded[name, arm]


def targets(scene: Scene, verb: RequestVerb) -> tuple[str, ...]:
    """List the targets of a verb in a room: joints with handles first, or small objects first."""
    if verb in get_args(JointVerb):
        handled = [f"{name}/{joint}" for name, joint in openable(scene)]
        every = [f"{item.name}/{joint}" for item in scene.objects for joint in item.model.joints]
        return tuple(dict.fromkeys((*handled, *every)))
    rigid = [item for item in scene.objects if not item.model.joints and item.category != "wall"]
    return tuple(o.name for o in sorted(rigid, key=lambda o: float(np.ptp(o.bounds, axis=0).max())))


def places(scene: Scene, name: str) -> tuple[str, ...]:
    """List where an object can be put in a room: on others, on their parts, in areas."""
    others = [item for item in scene.objects if item.name != name and item.category != "wall"]
    parts = (f"{item.name}/{joint}" for item in others for joint in item.model.joints)
    return (*(item.name for item in others), *parts, *scene.areas)


class ReportingStopwatch(Stopwatch):
    """A stopwatch that reports each stage as it begins."""

    def __init__(self, clock: Clock, report: Callable[[str], None]) -> None:
        super().__init__(clock)
        self._report, self._last = report, ""

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Measure a block; the same stage again is not reported."""
        if name != self._last:
            self._last = name
            self._report(name)
        with super().stage(name):
            yield


def ask(
    scene: Scene,
    arms: RobotArms,
    question: Question,
    clock: Clock,
    report: Callable[[str], None],
) -> Tour:
    """Answer where the robot must stand; most answers are a tour of one task.

    Args:
        scene: The room.
        arms: The robot; the cheapest answer of its arms is returned.
        question: The question.
        clock: Measures the stages; may raise to cancel the search.
        report: Called with each stage.

    Raises:
        MomaposError: The task does not fit the room or the robot.
    """
    task, config = question.task(scene), question.config
    if question.brings and config.place.method not in OURS:
        raise TaskError(f"bring needs the method {' or '.join(OURS)}, not {config.place.method}")
    start = None if question.start is None else np.array(question.start)
    answers, tours = list[PlacementResult](), list[Tour]()
    for robot, reach in zip(arms.robots, arms.maps, strict=True):
        if config.place.method not in OURS:
            report(f"search with {config.place.method}")
        query = PlacementQuery(
            scene, robot, task, reach, start, config, seed=question.seed,
            watch=ReportingStopwatch(clock, report),
        )  # fmt: skip
        if question.brings:
            tours.append(plan_chain(query, [Request("bring", task.object, None, question.to)]))
        else:
            answers.append(plan_with_method(query))
    if tours:
        return best_tour(tours)
    return Tour((cheapest(answers, farthest=task.farthest),), (1,), scenes=(scene,))


def ask_at(
    scene: Scene,
    robot: Robot,
    reach: ReachScorer,
    question: Question,
    base: Float[np.ndarray, "3"],
    clock: Clock,
) -> PlacementResult:
    """Plan the task from one base pose; see `plan_at_pose`."""
    start = None if question.start is None else np.array(question.start)
    query = PlacementQuery(
        scene, robot, question.task(scene), reach, start, question.config, seed=question.seed,
        watch=Stopwatch(clock),
    )  # fmt: skip
    return plan_at_pose(query, base)
