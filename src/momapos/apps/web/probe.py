"""Fast checks of many base poses for one task: feasibility, farthest joint value, collisions.

`check_base_pose` finds the farthest value to one degree, and prepares the room, the robot and the
task at each call. Here they are prepared once for each of a few joint values, one waypoint apart,
so that the result keeps up with a base that is dragged.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import Clock, OutOfTimeError, Stopwatch, look, time_limit
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


@dataclass(frozen=True, eq=False)
class ProbedPose:
    """Result of the check of a base pose."""

    base: Float[np.ndarray, "3"]
    """x [m], y [m], yaw [rad]."""
    outcome: PoseOutcome
    """Outcome for the task's own value."""
    in_the_way: tuple[str, ...]
    """Obstacles as "object/link"; empty without a collision."""
    value: float | None
    """Farthest feasible value, one waypoint apart [rad] or [m]; None where there is none, and for
    rigid objects."""
    motion: Motion | None
    """Motion to that value, or of a rigid object; None where infeasible."""
    complete: bool
    """Whether all grasps were tried; otherwise the time ran out."""

    @property
    def feasible(self) -> bool:
        """Whether the task is feasible from the base pose."""
        return self.outcome.status is PoseStatus.FEASIBLE


@dataclass(frozen=True)
class Probe:
    """One task in one room with one robot, prepared for the check of many base poses."""

    scene: Scene
    robot: Robot
    task: Task
    reach: ReachScorer
    config: PipelineConfig = DEFAULT
    seed: int = 0
    _ready: dict[float | None, BasePoseChecks] = field(default_factory=dict, repr=False)

    @property
    def values(self) -> tuple[float | None, ...]:
        """Joint values, one waypoint apart, up to the task's; a single None for a rigid object."""
        if self.task.joint is None:
            return (None,)
        return tuple(waypoint_values(self.scene, self.task, self.config).tolist())

    @property
    def slides(self) -> bool:
        """Whether the part slides [m] instead of turning [rad]."""
        return slides(self.scene, self.task)

    def prepare(self) -> None:
        """Prepare all values, so that the first check is as fast as the others."""
        for value in self.values[::-1]:
            self._checks(value)

    def at(
        self, base: Float[np.ndarray, "3"], clock: Clock, *, within: float = math.inf
    ) -> ProbedPose:
        """Check one base pose.

        Args:
            base: x [m], y [m], yaw [rad].
            clock: Called between steps; may raise to cancel.
            within: The check ends after this time [s], with what it has found.

        Raises:
            TaskError: The gripper cannot hold the object.
        """
        base, values = np.asarray(base, float), self.values
        found = ProbedPose(base, PoseOutcome(PoseStatus.NOT_TRIED), (), None, None, complete=True)

        def check(index: int) -> Attempt | None:
            nonlocal found
            attempt, hit = self._attempt(values[index], base)
            if index == len(values) - 1:
                found = replace(found, outcome=attempt.outcome, in_the_way=hit)
            if attempt.motion is None:
                return None
            found = replace(found, value=values[index], motion=attempt.motion)
            return attempt

        try:
            with time_limit(within, clock):
                whole = check(len(values) - 1)
                if whole is None and len(values) > 1 and check(0) is not None:
                    last_that_works(check, 0, len(values) - 1)
        except OutOfTimeError:
            return replace(found, complete=False)
        return found

    def _checks(self, value: float | None) -> BasePoseChecks:
        if value not in self._ready:
            task = replace(self.task, to=value, farthest=False)
            query = PlacementQuery(
                self.scene, self.robot, task, self.reach, config=self.config, seed=self.seed,
                watch=Stopwatch(lambda: 0.0),
            )  # fmt: skip
            checks = BasePoseChecks(query)
            for one in checks.by_handle():
                _ = one.prepared.infeasible_reason  # computed now, not at the first check
            self._ready[value] = checks
        return self._ready[value]

    def _attempt(
        self, value: float | None, base: Float[np.ndarray, "3"]
    ) -> tuple[Attempt, tuple[str, ...]]:
        """Check a base pose for one value; return the obstacles, too."""
        look()
        checks = self._checks(value)
        found = checks.with_one_grasp(base)
        if found.motion is not None:
            return found, ()
        if found.outcome.status is PoseStatus.BASE_BLOCKED:
            return found, _blocking(checks.prepared, base)
        labels = tuple(dict.fromkeys(checks.prepared.motion.labels))
        return found, named_in(found.outcome.detail, labels)


def _blocking(ready: PreparedTask, base: Float[np.ndarray, "3"]) -> tuple[str, ...]:
    """Return the label of the box in which a base stands: static boxes first, then the part's."""
    box = int(base_pose_status(ready.geometry, base[None])[1][0])
    labels, standing = ready.motion.labels, len(ready.motion.static)
    moving = len(labels) - standing
    return (labels[box if box < standing else standing + (box - standing) % moving],)


def named_in(words: str, labels: tuple[str, ...]) -> tuple[str, ...]:
    """Find the labels "object/link" in a reason; longer ones first, as one may begin another."""
    found: list[str] = []
    for label in sorted(labels, key=len, reverse=True):
        at = words.find(label)
        if at >= 0:
            found.append(label)
            words = f"{words[:at]} {words[at + len(label) :]}"
    return tuple(found)
