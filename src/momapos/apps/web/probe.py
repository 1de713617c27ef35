"""One base pose after the other: is it feasible, how far does the part go, what is in the way?

`check_base_pose` answers the same to a degree and makes everything ready each time. Here the room,
the robot and the task are made ready once for each of a few values of the joint, a waypoint apart,
so that the answer follows a hand that drags the base.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import Clock, Stopwatch
from momapos.model.records import Attempt, Motion, PoseOutcome, PoseStatus, ReachScorer, Task
from momapos.model.robots import Robot
from momapos.model.scene import Scene
from momapos.planning import (
    BasePoseChecks,
    PipelineConfig,
    PlacementQuery,
    PreparedTask,
    last_that_works,
    waypoint_values,
)
from momapos.planning.grasps import slides
from momapos.planning.placement import base_pose_status

if TYPE_CHECKING:
    from jaxtyping import Float

DEFAULT = PipelineConfig()


@dataclass(frozen=True)
class Finding:
    """What came of a base pose."""

    base: Float[np.ndarray, "3"]
    """x [m], y [m], yaw [rad]."""
    outcome: PoseOutcome
    """Of the value that the task asks for."""
    in_the_way: tuple[str, ...]
    """What is hit, as "object/link"; empty where nothing is."""
    value: float | None
    """The farthest of the values a waypoint apart that works [rad] or [m]; None where none does,
    and for rigid objects."""
    motion: Motion | None
    """To that value, or of a rigid object; None where none works."""
    sure: bool
    """Whether all ways of holding were tried; else the time ended before."""

    @property
    def feasible(self) -> bool:
        """Whether the task can be done from there."""
        return self.outcome.status is PoseStatus.FEASIBLE


@dataclass(frozen=True)
class Probe:
    """One task in one room with one robot, made ready to be asked about many base poses."""

    scene: Scene
    robot: Robot
    task: Task
    reach: ReachScorer
    config: PipelineConfig = DEFAULT
    seed: int = 0
    _ready: dict[float | None, BasePoseChecks] = field(default_factory=dict, repr=False)

    @property
    def values(self) -> tuple[float | None, ...]:
        """Values of the joint a waypoint apart, the task's last; one None for a rigid object."""
        if self.task.joint is None:
            return (None,)
        return tuple(waypoint_values(self.scene, self.task, self.config).tolist())

    @property
    def slides(self) -> bool:
        """Whether the part slides [m]; it turns otherwise [rad]."""
        return slides(self.scene, self.task)

    def make_ready(self, clock: Clock, report: Callable[[float], None] = lambda _: None) -> None:
        """Make all values ready, so that the first question is as quick as the others.

        Args:
            clock: Looked at before each value; what it raises ends the work.
            report: Is told the share that is done, in [0, 1].
        """
        for done, value in enumerate(self.values[::-1]):
            clock()
            report(done / len(self.values))
            self._checks(value)

    def at(
        self, base: Float[np.ndarray, "3"], clock: Clock, *, within: float = math.inf
    ) -> Finding:
        """Ask about one base pose.

        Args:
            base: x [m], y [m], yaw [rad].
            clock: Looked at between the steps of the work; what it raises ends it.
            within: No further way of holding is tried after this time [s].

        Raises:
            TaskError: The gripper cannot hold the object.
        """
        base, ends, cut = np.asarray(base, float), clock() + within, []

        def out_of_time() -> bool:
            if clock() <= ends:
                return False
            cut.append(True)
            return True

        values = self.values
        best, hit = self._attempt(values[-1], base, clock, out_of_time)
        outcome = best.outcome
        if best.motion is not None:
            return Finding(base, outcome, (), values[-1], best.motion, sure=True)

        def ask(index: int) -> Attempt | None:
            found, _ = self._attempt(values[index], base, clock, out_of_time)
            return None if found.motion is None else found

        if len(values) == 1 or (first := ask(0)) is None:
            return Finding(base, outcome, hit, None, None, sure=not cut)
        at, farther = last_that_works(ask, 0, len(values) - 1)
        motion = (farther or first).motion
        return Finding(base, outcome, hit, values[at], motion, sure=not cut)

    def _checks(self, value: float | None) -> BasePoseChecks:
        if value not in self._ready:
            task = replace(self.task, to=value, farthest=False)
            query = PlacementQuery(
                self.scene, self.robot, task, self.reach, None, None, self.config, self.seed,
                Stopwatch(lambda: 0.0),
            )  # fmt: skip
            checks = BasePoseChecks(query)
            # What is made when it is first asked for is made now.
            _ = checks.prepared.infeasible_reason
            self._ready[value] = checks
        return self._ready[value]

    def _attempt(
        self,
        value: float | None,
        base: Float[np.ndarray, "3"],
        clock: Clock,
        out_of_time: Callable[[], bool],
    ) -> tuple[Attempt, tuple[str, ...]]:
        """Check a base pose for one value; what is hit comes with it."""
        clock()
        checks = self._checks(value)
        found = checks.in_one_hold(base, out_of_time=out_of_time)
        if found.motion is not None:
            return found, ()
        if found.outcome.status is PoseStatus.BASE_BLOCKED:
            return found, _blocking(checks.prepared, base)
        labels = tuple(dict.fromkeys(checks.prepared.motion.labels))
        return found, named_in(found.outcome.detail, labels)


def _blocking(ready: PreparedTask, base: Float[np.ndarray, "3"]) -> tuple[str, ...]:
    """The name of the box that a base stands in: standing boxes first, then the part's."""
    box = int(base_pose_status(ready.geometry, base[None])[1][0])
    labels, standing = ready.motion.labels, len(ready.motion.static)
    moving = len(labels) - standing
    return (labels[box if box < standing else standing + (box - standing) % moving],)


def named_in(words: str, labels: tuple[str, ...]) -> tuple[str, ...]:
    """The labels "object/link" that a reason names, the longest first where one begins another."""
    found: list[str] = []
    for label in sorted(labels, key=len, reverse=True):
        at = words.find(label)
        if at >= 0:
            found.append(label)
            words = f"{words[:at]} {words[at + len(label) :]}"
    return tuple(found)
