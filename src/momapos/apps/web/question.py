"""What is asked on the page, and how it is answered."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, get_args

import numpy as np

from momapos.core import Cache, Clock, Stopwatch, TaskError
from momapos.model.records import ReachScorer, Task, Verb
from momapos.model.robots import Robot, load_arms
from momapos.model.scene import Scene
from momapos.planning import (
    PipelineConfig,
    PlacementQuery,
    PlacementResult,
    answer,
    as_far_as_possible,
    cheapest,
    plan_at_base_pose,
)
from momapos.planning.baselines import plan_by_method
from momapos.planning.grasps import make_task, openable
from momapos.planning.placement import OURS, Method
from momapos.planning.reachability import load_reach

if TYPE_CHECKING:
    from jaxtyping import Float

METHODS: tuple[str, ...] = get_args(Method)
VERBS: tuple[Verb, ...] = get_args(Verb)
ANY = "any"


@dataclass(frozen=True)
class Question:
    """What is asked of a room and a robot."""

    verb: Verb
    target: str
    """The object, or "object/joint"."""
    to: str = ""
    """How far, as 60deg, 0.3m or max; "" for what the verb takes by itself."""
    method: str = "ours"
    seed: int = 0
    start: tuple[float, float, float] | None = None
    """Where the robot is; None for the scene's start, or a roomy place."""

    def task(self, scene: Scene) -> Task:
        """The task in a room.

        Raises:
            MomaposError: It makes no sense there.
        """
        name, _, joint = self.target.partition("/")
        if self.verb in ("open", "close"):
            return make_task(scene, self.verb, name, joint or None, self.to.strip() or None)
        return make_task(scene, self.verb, name)

    @property
    def config(self) -> PipelineConfig:
        """How it is answered."""
        default = PipelineConfig()
        if self.method not in METHODS:
            raise TaskError(f"no method {self.method!r}; there are {', '.join(METHODS)}")
        return replace(default, place=replace(default.place, method=self.method))  # type: ignore[arg-type]


@dataclass(frozen=True)
class Machine:
    """A robot, once for each of its arms, with its reachability maps."""

    arms: tuple[Robot, ...]
    maps: tuple[ReachScorer, ...]

    def reach_of(self, arm: str) -> ReachScorer:
        """The map of one of the arms, by its name."""
        return next(m for one, m in zip(self.arms, self.maps, strict=True) if one.arm == arm)


class Machines:
    """The robots that were chosen so far, each loaded once.

    What is computed of a robot is kept with it, dozens of robots long; one that were loaded at
    every choice anew would stay in memory as often as it was chosen.
    """

    def __init__(self, cache: Cache) -> None:
        """Load nothing yet; `cache` is where geometry and maps are kept."""
        self._cache = cache
        self._loaded: dict[tuple[str, str], Machine] = {}

    def load(self, name: str, arm: str, clock: Clock, tell: Callable[[str], None]) -> Machine:
        """A robot and its reachability maps, which are built at the first use.

        Args:
            name: A library robot or a robot file.
            arm: Which arm; any: all of them.
            clock: What it raises ends the work.
            tell: Is told what is done.
        """
        if (name, arm) not in self._loaded:
            arms = load_arms(name, arm, cache=self._cache)

            def report(share: float, what: str = "") -> None:
                clock()
                tell(f"reachability map of {arms[0].name}: {100 * share:.0f} % {what}")

            maps = tuple(load_reach(robot, self._cache.folder, report) for robot in arms)
            self._loaded[name, arm] = Machine(arms, maps)
        return self._loaded[name, arm]


def targets(scene: Scene, verb: Verb) -> tuple[str, ...]:
    """What a verb may be about in a room, the likeliest first."""
    if verb in ("open", "close"):
        handled = [f"{name}/{joint}" for name, joint in openable(scene)]
        every = [f"{item.name}/{joint}" for item in scene.objects for joint in item.model.joints]
        return tuple(dict.fromkeys((*handled, *every)))
    rigid = [item for item in scene.objects if not item.model.joints and item.category != "wall"]
    return tuple(o.name for o in sorted(rigid, key=lambda o: float(np.ptp(o.bounds, axis=0).max())))


class TellingWatch(Stopwatch):
    """A stopwatch that says which stage begins."""

    def __init__(self, clock: Clock, tell: Callable[[str], None]) -> None:
        super().__init__(clock)
        self._tell, self._last = tell, ""

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Count the time of a block for a stage; stages within it are not told again."""
        if name != self._last:
            self._last = name
            self._tell(name)
        with super().stage(name):
            yield


def ask(
    scene: Scene,
    machine: Machine,
    question: Question,
    clock: Clock,
    tell: Callable[[str], None],
) -> PlacementResult:
    """Answer where the robot must stand.

    Args:
        scene: The room.
        machine: The robot; of several arms the one with the cheapest answer counts.
        question: What is asked.
        clock: Measures the stages; what it raises ends the search.
        tell: Is told each stage.

    Raises:
        MomaposError: The question cannot be answered as it is asked.
    """
    task, config = question.task(scene), question.config
    start = None if question.start is None else np.array(question.start)
    answers = []
    for robot, reach in zip(machine.arms, machine.maps, strict=True):
        if config.place.method in OURS:
            watch = TellingWatch(clock, tell)
            query = PlacementQuery(
                scene, robot, task, reach, start, None, config, question.seed, watch
            )
            found = as_far_as_possible(query, answer) if task.farthest else answer(query)
        else:
            tell(f"search by {config.place.method}")
            found = plan_by_method(
                scene, robot, task, reach, start=start, config=config, seed=question.seed,
                clock=clock,
            )  # fmt: skip
        answers.append(found)
    return cheapest(answers, farthest=task.farthest)


def ask_at(
    scene: Scene,
    robot: Robot,
    reach: ReachScorer,
    question: Question,
    base: Float[np.ndarray, "3"],
    clock: Clock,
) -> PlacementResult:
    """Answer how the robot does it from one base pose; see `plan_at_base_pose`."""
    start = None if question.start is None else np.array(question.start)
    return plan_at_base_pose(
        scene, robot, question.task(scene), base, reach, start=start, config=question.config,
        seed=question.seed, clock=clock,
    )  # fmt: skip
