"""Answer the node's requests without ROS; scenes, robots and maps are loaded once."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

import momapos
from momapos.apps.export.ros2 import messages
from momapos.apps.export.timeline import Phase, PhaseKind, phases_of
from momapos.core.errors import TaskError
from momapos.model.robots.hand_openings import opened_as

scene_of = cache(momapos.load_scene)
robot_of = cache(momapos.load_robot)
Pose = tuple[float, float, float]
"""x [m], y [m], yaw [rad] on the floor."""


@cache
def map_of(robot: str) -> momapos.ReachMap:
    """Return a robot's reachability map; one that is not shipped is built at first use."""
    return momapos.load_reach_map(robot_of(robot))


@dataclass(frozen=True)
class Question:
    """A request, see PlanBasePlacement."""

    scene: str
    robot: str
    verb: str
    target: str
    to: str = ""
    start: Pose | None = None


@dataclass(frozen=True)
class Answer:
    """A plan, and the question that it answers."""

    plan: momapos.PlacementPlan
    question: Question

    @property
    def phases(self) -> tuple[Phase, ...]:
        """Return the phases of a solved plan."""
        return phases_of(self.plan, robot_of(self.question.robot))

    def messages(self, frame: str) -> dict[str, Any]:
        """Return the messages of a solved plan, as dictionaries of momapos' export."""
        return messages(self.plan, self.phases, robot_of(self.question.robot), frame)

    @property
    def message(self) -> str:
        """Return the answer in one line."""
        base, count = self.plan.base_pose, self.plan.candidates
        if base is not None:
            found = self.plan.tolerance
            tolerance = "" if found is None else f"; tolerance {found}"
            pose = f"x {base[0]:.3f} m, y {base[1]:.3f} m, yaw {base[2]:.3f} rad"
            assumed = f"assumed that {self.plan.assumes}; " if self.plan.assumes else ""
            return f"{assumed}base pose {pose}{tolerance}"
        most = sorted(count.rejections.items(), key=lambda item: -item[1])[:3]
        reasons = ", ".join(f"{number} x {reason}" for reason, number in most)
        return f"{self.plan.status}: {reasons or 'no base pose was sampled'}"


def task_of(question: Question) -> momapos.Task:
    """Return the task of a question.

    Raises:
        MomaposError: The request is invalid in this scene.
    """
    name, _, joint = question.target.partition("/")
    return momapos.make_task(
        scene_of(question.scene), question.verb, name, joint or None, question.to or None
    )


def answer(question: Question, timeout: float, *, tolerance: bool = False) -> Answer:
    """Plan the base pose and the motion, and optionally the tolerance of the base pose.

    Raises:
        MomaposError: Scene, robot or task cannot be used, or the base must move with the arm.
    """
    scene, robot = scene_of(question.scene), robot_of(question.robot)
    result = momapos.plan_base_placement(
        scene, robot, task_of(question), map_of(question.robot),
        start=None if question.start is None else np.array(question.start),
        config=momapos.PipelineConfig(timeout=timeout),
    )  # fmt: skip
    if result.plan.moves_base:
        raise TaskError(
            "the plan moves its base while the hand works; this node executes plans at one base "
            "pose only, and 'momapos export PLAN --to ros2' writes the goals of others"
        )
    return Answer((result.with_tolerance() if tolerance else result).plan, question)


def answer_at(given: Answer, reached: Pose) -> Answer:
    """Replan the arm's motion of an answer from the base pose that was reached.

    Raises:
        TaskError: There is no motion from there; the message states the reason.
    """
    question = given.question
    scene = scene_of(question.scene)
    robot = opened_as(robot_of(question.robot), given.plan.robot_rest)
    attempt = momapos.check_base_pose(
        scene, robot, task_of(question), reached, map_of(question.robot), how_far=False
    )
    if attempt.motion is None:
        x, y, yaw = reached
        raise TaskError(f"no motion from ({x:.3f}, {y:.3f}, {yaw:.3f}): {attempt.reason}")
    plan = replace(given.plan, base_pose=reached, motion=attempt.motion, base_path=None)
    return Answer(plan, question)


def kinds(given: Answer) -> list[str]:
    """Return the kinds of the phases of a solved plan after the drive."""
    return [str(phase.kind) for phase in given.phases if phase.kind is not PhaseKind.DRIVE]
