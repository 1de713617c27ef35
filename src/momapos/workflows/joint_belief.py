"""Weight the hypotheses of a part's joint by the path of the hand that pulls it (Bayes' rule)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from momapos.core import OutOfTimeError, TaskError
from momapos.core.geometry import apply
from momapos.model.records import Assumption, Hypothesis, Task
from momapos.model.scene import (
    Scene,
    hypothesis_about,
    save_with_part_motion,
    scene_with_hypothesis,
    with_part_motion,
)
from momapos.model.urdf import opening_of
from momapos.planning import PlacementResult, with_max_opening
from momapos.planning.placement import OURS
from momapos.simulation import (
    WIDE_OPEN_ANGLE,
    WIDE_OPEN_SLIDE,
    Axis,
    ComplianceConfig,
    JointEstimate,
    RunRecord,
)

if TYPE_CHECKING:
    from jaxtyping import Float

FAILURE_SHARE = 0.05
"""Share of the motions that fail although the hypothesis is true [-]."""
HAND_ERROR = 0.01
"""Standard deviation of the hand's position on the part that it pulls [m]."""
MIN_LOG_ODDS = float(np.log(5.0))
"""Log odds of another hypothesis at which the hand lets go [-]."""
MIN_PROBABILITY = 0.01
"""Hypotheses with a smaller probability are not planned for [-]."""

PlanTask: TypeAlias = "Callable[[Scene, Task], Sequence[PlacementResult]]"
"""Plans a task in a scene, with every arm."""


@dataclass(frozen=True, eq=False)
class JointBelief:
    """One hypothesis of the joint of a task's part."""

    scene: Scene
    """The scene under this hypothesis, with the part at its initial value."""
    task: Task
    hypothesis: Hypothesis
    log_weight: float
    """Log probability up to a constant [-]."""
    moved: float = 0.0
    """Joint displacement by the hand under this hypothesis [rad] or [m]."""

    @property
    def axis(self) -> Axis:
        """The joint in the world, opening with a positive value."""
        T = self.scene.object(self.task.object).T_world_object
        point = apply(T, np.array(self.hypothesis.point)[None])[0]
        return Axis(
            self.hypothesis.kind == "drawer", T[:3, :3] @ np.array(self.hypothesis.axis), point
        )

    def as_left(self) -> tuple[Scene, Task]:
        """Return the scene with the part where the hand left it under this hypothesis; the task."""
        name, joint = self.task.object, self.task.joint
        assert joint is not None
        opening = opening_of(self.scene.object(name).model, joint)
        low, high = sorted((opening.closed, opening.wide))
        value = float(np.clip(opening.closed + opening.sign * self.moved, low, high))
        return self.scene.with_joint(name, joint, value), self.task


class JointBeliefs:
    """All hypotheses of the joint of a task's part, and the current one.

    Args:
        beliefs: The hypotheses, the first to try first; empty if the scene has only one.
        config: Its deviations are the prior of the joint.
    """

    def __init__(self, beliefs: Sequence[JointBelief], config: ComplianceConfig) -> None:
        self.beliefs, self.current = tuple(beliefs), 0
        self.config = replace(config, hand_error=HAND_ERROR)

    @property
    def kind(self) -> str:
        """Kind of part of the current hypothesis; "" if the scene has only one."""
        return self.beliefs[self.current].hypothesis.kind if self.beliefs else ""

    @property
    def moved(self) -> bool:
        """Whether the hand has moved the part under any hypothesis."""
        return any(belief.moved > 0.0 for belief in self.beliefs)

    def contradicts(self, hand_path: Sequence[Float[np.ndarray, "3"]]) -> bool:
        """Check that the path of the hand [m] makes another hypothesis much more probable."""
        if not self.beliefs:
            return False
        weights = [belief.log_weight for belief in self._pulled(hand_path)]
        return max(weights) - weights[self.current] > MIN_LOG_ODDS

    def ranked(self, hand_path: Sequence[Float[np.ndarray, "3"]]) -> list[JointBelief | None]:
        """Return the hypotheses after a path of the hand [m], the most probable first.

        None stands for the current hypothesis.
        """
        found = self._pulled(hand_path)
        order = np.argsort([-belief.log_weight for belief in found], kind="stable")
        return [None if k == self.current else found[k] for k in order] or [None]

    def fail(self, hand_path: Sequence[Float[np.ndarray, "3"]]) -> JointBelief | None:
        """Update the hypotheses after a failed motion.

        Args:
            hand_path: Path of the hand while it pulled the part [m]; empty if it did not.

        Returns:
            The next hypothesis; None if the current one remains.
        """
        if not self.beliefs:
            return None
        found = list(self._pulled(hand_path) if hand_path else self.beliefs)
        weight = found[self.current].log_weight + float(np.log(FAILURE_SHARE))
        found[self.current] = replace(found[self.current], log_weight=weight)
        self.beliefs, before = tuple(found), self.current
        self.current = int(np.argmax([belief.log_weight for belief in found]))
        return None if self.current == before else self.beliefs[self.current]

    def drop_current(self) -> JointBelief | None:
        """Drop the current hypothesis, because there is no motion for it.

        Returns:
            The most probable remaining hypothesis; None if all are too improbable.
        """
        if not self.beliefs:
            return None
        weights = np.array([belief.log_weight for belief in self.beliefs])
        weights -= np.logaddexp.reduce(weights)
        found = list(self.beliefs)
        found[self.current] = replace(found[self.current], log_weight=-np.inf)
        weights[self.current] = -np.inf
        best = int(np.argmax(weights))
        if weights[best] < np.log(MIN_PROBABILITY):
            return None
        self.beliefs, self.current = tuple(found), best
        return found[best]

    def _pulled(self, hand_path: Sequence[Float[np.ndarray, "3"]]) -> tuple[JointBelief, ...]:
        """Return the hypotheses updated by the path of the hand."""
        found = []
        for belief in self.beliefs:
            estimate = JointEstimate.along(belief.axis, hand_path, self.config)
            moved = max(belief.moved + estimate.value_at(hand_path[-1]), 0.0)
            weight = belief.log_weight - estimate.misfit
            found.append(replace(belief, log_weight=weight, moved=moved))
        return tuple(found)


def joint_beliefs(scene: Scene, task: Task) -> tuple[JointBelief, ...]:
    """Return the scene's hypotheses of the joint of a task's part, the most probable first.

    Empty if the scene has only one, or if the task does not open a closed part.
    """
    if task.verb != "open" or task.joint is None or task.to is None:
        return ()
    item = scene.object(task.object)
    hypotheses = item.hypotheses.get(task.joint, ())
    opening = opening_of(item.model, task.joint)
    if len(hypotheses) < 2 or item.values()[task.joint] != opening.closed:
        return ()
    travel = abs(task.to - opening.closed)
    first = min(abs(opening.wide - opening.closed), _wide(hypotheses[0]))
    beliefs = [JointBelief(scene, task, hypotheses[0], _log(hypotheses[0].probability))]
    for index, hypothesis in enumerate(hypotheses[1:], start=1):
        same = (hypothesis.kind == "drawer") == (hypotheses[0].kind == "drawer")
        to = travel if same else min(travel / first, 1.0) * _wide(hypothesis)
        beliefs.append(
            JointBelief(
                scene_with_hypothesis(scene, task.object, task.joint, index),
                replace(task, to=min(to, hypothesis.upper)),
                hypothesis,
                _log(hypothesis.probability),
            )
        )
    return tuple(beliefs)


def plan_by_hypothesis(
    scene: Scene, task: Task, plan: PlanTask
) -> tuple[Scene, Task, Sequence[PlacementResult]]:
    """Plan for the most probable hypothesis of a part's joint; if infeasible, for the next ones.

    Args:
        scene: The scene, with all objects modeled that the scan shows.
        task: The task.
        plan: Plans a task in a scene, with every arm.

    Returns:
        Scene, task and results, see `MostProbable.or_next`.

    Raises:
        TaskError: Raised by `plan` for the given task, and no other hypothesis has a plan.
    """
    return MostProbable.of(scene, task, plan).or_next(plan)


@dataclass(frozen=True, eq=False)
class MostProbable:
    """The answers for the most probable hypothesis of a part's joint."""

    scene: Scene
    task: Task
    results: Sequence[PlacementResult]
    """One per arm; empty if the task was refused."""
    refused: TaskError | None = None
    """Why no arm can do the task, such as that no hand holds the part."""

    @classmethod
    def of(cls, scene: Scene, task: Task, plan: PlanTask) -> MostProbable:
        """Plan for the most probable hypothesis."""
        try:
            return cls(scene, task, plan(scene, task))
        except TaskError as error:
            return cls(scene, task, (), error)

    @property
    def is_no(self) -> bool:
        """Whether there is no plan for this hypothesis, and not for lack of time."""
        return all(result.plan.status == "infeasible" for result in self.results)

    def or_next(self, plan: PlanTask) -> tuple[Scene, Task, Sequence[PlacementResult]]:
        """Return these answers, or those for the next probable hypothesis with a plan.

        A plan for another than the first hypothesis is `assumed`, also if it is as probable; so is
        a plan for the first if it is improbable.

        Args:
            plan: Plans a task in a scene, with every arm.

        Returns:
            Scene, task and results; these ones if no probable hypothesis has a plan.

        Raises:
            TaskError: The task was refused, and no other hypothesis has a plan.
        """
        try:
            for belief in joint_beliefs(self.scene, self.task)[1:] if self.is_no else ():
                if belief.hypothesis.probability < MIN_PROBABILITY:
                    continue
                others = MostProbable.of(belief.scene, belief.task, plan).results
                if any(result.plan.feasible for result in others):
                    found = self._assumption(belief.hypothesis)
                    assumed = [_assumed(result, found) for result in others]
                    return belief.scene, belief.task, assumed
        except OutOfTimeError:
            if not self.results:
                raise
            late = [replace(one, plan=replace(one.plan, status="timeout")) for one in self.results]
            return self.scene, self.task, late
        if self.refused is not None:
            raise self.refused
        return self.scene, self.task, self.results

    def _assumption(self, taken: Hypothesis) -> Assumption:
        """Describe an assumed hypothesis, with how far the most probable joint opens instead."""
        assert self.task.joint is not None
        item = self.scene.object(self.task.object)
        first, closed = item.hypotheses[self.task.joint][0], item.values()[self.task.joint]
        found = [to for to in map(_largest_opening, self.results) if to is not None]
        farthest = max((abs(to - closed) for to in found), default=None)
        return Assumption(taken.kind, taken.probability, first.kind, first.probability, farthest)


def _largest_opening(result: PlacementResult) -> float | None:
    """Return how far the part of an infeasible answer opens [rad] or [m]; None if not at all."""
    plan, query = result.plan, result.query
    whole = query is not None and plan.base_pose is None and not plan.task.farthest
    if query is None or not whole or query.config.place.method not in OURS:
        return plan.feasible_to
    return with_max_opening(result, clock=query.watch.clock).plan.feasible_to


def _assumed(result: PlacementResult, found: Assumption) -> PlacementResult:
    if not result.plan.feasible:
        return result
    return replace(result, plan=replace(result.plan, status="assumed", assumption=found))


def save_learned(record: RunRecord, scene: Scene, out: Path) -> Scene | None:
    """Write the scene with the measured joint of a run, and the part at its final value.

    Args:
        record: Record of the run.
        scene: The scene at the start of the run.
        out: The new scene file.

    Returns:
        The scene of that file; None if the run failed, moved no joint, or only an assumed one.

    Raises:
        SceneError: See `save_with_part_motion`.
    """
    task, done = record.task, record.execution
    if task.joint is None or done is None or record.verdict != "done" or done.joint is None:
        return None
    target = scene.object(task.object)
    kind = record.kinds[-1] if record.kinds else None
    hypotheses = [
        hypothesis
        for hypothesis in target.hypotheses.get(task.joint, ())
        if hypothesis.kind == kind
    ]
    item = with_part_motion(target, task.joint, hypotheses[0]) if hypotheses else target
    moved = abs(done.reached - done.start)
    direction, point = np.array(done.joint.direction), np.array(done.joint.point)
    hypothesis = hypothesis_about(item, task.joint, direction, point, moved)
    return save_with_part_motion(scene, task.object, task.joint, hypothesis, moved, out)


def _wide(hypothesis: Hypothesis) -> float:
    """Return the joint value of a wide-open part [rad] or [m]."""
    return min(
        hypothesis.upper, WIDE_OPEN_SLIDE if hypothesis.kind == "drawer" else WIDE_OPEN_ANGLE
    )


def _log(share: float) -> float:
    return float(np.log(max(share, 1e-12)))
