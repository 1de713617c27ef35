"""How a part may move, and what a hand that pulled it says of that: Bayes' rule."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from momapos.core import TaskError
from momapos.core.geometry import apply
from momapos.model.records import Hypothesis, Task
from momapos.model.scene import Scene, moving_as, save_moving_as, scene_taking, way_about
from momapos.model.urdf import opening_of
from momapos.planning import PlacementResult
from momapos.simulation import DRAWN, WIDE_OPEN, Axis, ComplianceConfig, JointEstimate, RunRecord

if TYPE_CHECKING:
    from jaxtyping import Float

FAILS = 0.05
"""Share of the motions that fail although the joint is as believed [-]."""
HAND_ERROR = 0.01
"""A hand strays so far on the part that it pulls, where it does not find its joint [m]."""
DOUBT = float(np.log(5.0))
"""The hand lets go where another way to move is so many times likelier, as a logarithm [-]."""
PROBABLE = 0.01
"""A less probable way to move is not planned for, where the likelier ones have no plan [-]."""

Ask: TypeAlias = "Callable[[Scene, Task], Sequence[PlacementResult]]"
"""Answers a task in a room, for every arm."""


@dataclass(frozen=True, eq=False)
class JointBelief:
    """One way in which the part of a task may move."""

    scene: Scene
    """The room as it is believed to be, the part as it was at first."""
    task: Task
    way: Hypothesis
    log_weight: float
    """Logarithm of how probable it is, but for a constant [-]."""
    moved: float = 0.0
    """How far the hand has moved the part, if it is so [rad] or [m]."""

    @property
    def axis(self) -> Axis:
        """The joint in the world, opening with a positive value."""
        T = self.scene.object(self.task.object).T_world_object
        point = apply(T, np.array(self.way.point)[None])[0]
        return Axis(self.way.kind == "drawer", T[:3, :3] @ np.array(self.way.axis), point)

    def as_left(self) -> tuple[Scene, Task]:
        """The room with the part where the hand has left it, if it is so; and the task there."""
        name, joint = self.task.object, self.task.joint
        assert joint is not None
        opening = opening_of(self.scene.object(name).model, joint)
        low, high = sorted((opening.closed, opening.wide))
        value = float(np.clip(opening.closed + opening.sign * self.moved, low, high))
        return self.scene.with_joint(name, joint, value), self.task


class JointBeliefs:
    """All ways in which the part of a task may move, and which of them is tried."""

    def __init__(self, beliefs: Sequence[JointBelief], config: ComplianceConfig) -> None:
        """The first of `beliefs` is tried first; empty where the scene knows how the part moves.

        `config` says how far a joint may be from where it is modeled.
        """
        self.beliefs, self.tried = tuple(beliefs), 0
        self.config = replace(config, hand_error=HAND_ERROR)

    @property
    def kind(self) -> str:
        """As what kind of part the part is taken; "" where the scene knows how it moves."""
        return self.beliefs[self.tried].way.kind if self.beliefs else ""

    @property
    def moved(self) -> bool:
        """Whether the hand has moved the part, so that it is elsewhere for each way to move."""
        return any(belief.moved > 0.0 for belief in self.beliefs)

    def speaks_against(self, hand_way: Sequence[Float[np.ndarray, "3"]]) -> bool:
        """Whether the way of a hand that holds the part [m] makes another one much likelier."""
        if not self.beliefs:
            return False
        weights = [belief.log_weight for belief in self._pulled(hand_way)]
        return max(weights) - weights[self.tried] > DOUBT

    def ranked(self, hand_way: Sequence[Float[np.ndarray, "3"]]) -> list[JointBelief | None]:
        """All of them after the hand went a way [m], the likeliest first; None is what is tried."""
        found = self._pulled(hand_way)
        order = np.argsort([-belief.log_weight for belief in found], kind="stable")
        return [None if k == self.tried else found[k] for k in order] or [None]

    def fail(self, hand_way: Sequence[Float[np.ndarray, "3"]]) -> JointBelief | None:
        """Take in that a motion failed after the hand had pulled the part along a way [m].

        The way is empty where the hand did not come to pull it.

        Returns:
            The one to try next; None where it is the one that was tried.
        """
        if not self.beliefs:
            return None
        found = list(self._pulled(hand_way) if hand_way else self.beliefs)
        tried = found[self.tried]
        found[self.tried] = replace(tried, log_weight=tried.log_weight + float(np.log(FAILS)))
        self.beliefs, before = tuple(found), self.tried
        self.tried = _likeliest(self.beliefs)
        return None if self.tried == before else self.beliefs[self.tried]

    def give_up(self) -> JointBelief | None:
        """Leave the way that is tried, because no motion is found for it.

        Returns:
            The likeliest of the others; None where none is probable.
        """
        if not self.beliefs:
            return None
        weights = np.array([belief.log_weight for belief in self.beliefs])
        weights -= np.logaddexp.reduce(weights)
        found = list(self.beliefs)
        found[self.tried] = replace(found[self.tried], log_weight=-np.inf)
        weights[self.tried] = -np.inf
        best = int(np.argmax(weights))
        if weights[best] < np.log(PROBABLE):
            return None
        self.beliefs, self.tried = tuple(found), best
        return found[best]

    def _pulled(self, hand_way: Sequence[Float[np.ndarray, "3"]]) -> tuple[JointBelief, ...]:
        """What is believed after the hand has pulled the part."""
        found = []
        for belief in self.beliefs:
            estimate = JointEstimate.along(belief.axis, hand_way, self.config)
            moved = max(belief.moved + estimate.value_at(hand_way[-1]), 0.0)
            weight = belief.log_weight - estimate.misfit
            found.append(replace(belief, log_weight=weight, moved=moved))
        return tuple(found)


def joint_beliefs(scene: Scene, task: Task) -> tuple[JointBelief, ...]:
    """All ways in which the part of a task may move, as the scene has them, the likeliest first.

    Only for parts that are shut and shall be opened; empty where the scene knows how they move.
    """
    if task.verb != "open" or task.joint is None or task.to is None:
        return ()
    item = scene.object(task.object)
    ways = item.hypotheses.get(task.joint, ())
    opening = opening_of(item.model, task.joint)
    if len(ways) < 2 or item.values()[task.joint] != opening.closed:
        return ()
    asked = abs(task.to - opening.closed)
    first = min(abs(opening.wide - opening.closed), _wide(ways[0]))
    beliefs = [JointBelief(scene, task, ways[0], _log(ways[0].probability))]
    for index, way in enumerate(ways[1:], start=1):
        same = (way.kind == "drawer") == (ways[0].kind == "drawer")
        to = asked if same else min(asked / first, 1.0) * _wide(way)
        beliefs.append(
            JointBelief(
                scene_taking(scene, task.object, task.joint, index),
                replace(task, to=min(to, way.upper)),
                way,
                _log(way.probability),
            )
        )
    return tuple(beliefs)


def ask_in_turn(
    scene: Scene, task: Task, ask: Ask
) -> tuple[Scene, Task, Sequence[PlacementResult]]:
    """Ask for the likeliest way in which a part may move; for the next where that has no answer.

    Args:
        scene: The room.
        task: What is to be done.
        ask: Answers a task in a room, for every arm.

    Returns:
        The room and the task as they are solved with the answers; as they were given, with those,
        where no probable way of the part has a solution.

    Raises:
        TaskError: What `ask` raises for the likeliest, where no other way has a solution.
    """
    answers, refused = _asked(ask, scene, task)
    if refused is None and any(answer.plan.status != "infeasible" for answer in answers):
        return scene, task, answers
    for belief in joint_beliefs(scene, task)[1:]:
        if belief.way.probability < PROBABLE:
            continue
        others, _ = _asked(ask, belief.scene, belief.task)
        if any(answer.plan.status == "solved" for answer in others):
            return belief.scene, belief.task, others
    if refused is not None:
        raise refused
    return scene, task, answers


def _asked(
    ask: Ask, scene: Scene, task: Task
) -> tuple[Sequence[PlacementResult], TaskError | None]:
    """The answers, or why there can be none."""
    try:
        return ask(scene, task), None
    except TaskError as error:
        return (), error


def _likeliest(beliefs: Sequence[JointBelief]) -> int:
    return int(np.argmax([belief.log_weight for belief in beliefs])) if beliefs else 0


def save_learned(record: RunRecord, scene: Scene, out: Path) -> Scene | None:
    """Write the scene of a run with the joint of its part as the arm has found it, and as it is.

    Args:
        record: What came of the run.
        scene: The room as the run began.
        out: The new scene file.

    Returns:
        The scene as of that file; None where the run failed or moved no joint.

    Raises:
        SceneError: See `save_moving_as`.
    """
    task, done = record.task, record.execution
    if task.joint is None or done is None or not done.success or done.joint is None:
        return None
    target = scene.object(task.object)
    kind = record.kinds[-1] if record.kinds else None
    ways = [way for way in target.hypotheses.get(task.joint, ()) if way.kind == kind]
    item = moving_as(target, task.joint, ways[0]) if ways else target
    moved = abs(done.reached - done.start)
    found = np.array(done.joint.direction), np.array(done.joint.point)
    way = way_about(item, task.joint, *found, moved)
    return save_moving_as(scene, task.object, task.joint, way, moved, out)


def _wide(way: Hypothesis) -> float:
    """Where a part that moves in a way is wide open [rad] or [m]."""
    return min(way.upper, DRAWN if way.kind == "drawer" else WIDE_OPEN)


def _log(share: float) -> float:
    return float(np.log(max(share, 1e-12)))
