"""What is drawn of a question, and of its answer: room, robot, motion, layers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from momapos.core import InputError
from momapos.model.scene import Scene
from momapos.planning import PlacementResult
from momapos.planning.grasps import in_front_of_parts

from .cameras import look_at
from .panel import joint_ranges
from .playback import Story
from .question import Machine, Question
from .robot_view import home_values, joint_values
from .words import answer_words, escaped

if TYPE_CHECKING:
    from jaxtyping import Float

    from .page import Page

READY = "Press **Place**, or drag the base."


class AnswerView:
    """Draws what is asked, then what is answered, in place of what was drawn before."""

    def __init__(self, page: Page) -> None:
        self._page = page

    def ask(self, scene: Scene, machine: Machine, question: Question, *, fresh: bool) -> None:
        """Draw what is asked, before there is an answer.

        Args:
            scene: The room.
            machine: The robot.
            question: What is asked.
            fresh: Whether the room or the robot is another one than is drawn.
        """
        page = self._page
        with page.drawing:
            shown, robot = page.shown, machine.arms[0]
            shown.question, shown.answer, shown.probe = question, None, None
            shown.joints = {}
            page.motion.load(None)
            page.layers.clear()  # before the robot, from which one of them hangs
            if fresh and page.room.scene is not scene:
                look_at(page.server, scene)
                page.light.of_room(scene)
            self.show_room()
            page.room.rest()
            page.panel.show_joints(joint_ranges(scene, self.asked_object))
            page.panel.to.disabled = question.verb not in ("open", "close")
            begin = begin_of(scene, question)
            if page.robot.robot is not robot or fresh:
                page.robot.show(robot, begin)
            else:
                page.robot.move(begin, home_values(robot))
            page.robot.verdict("")
            warnings = "".join(f"\n- {escaped(text)}" for text in scene.warnings)
            page.tell(f"{READY}{warnings}")

    def show(self, answer: PlacementResult, machine: Machine) -> None:
        """Draw an answer.

        Args:
            answer: It is about the scene that is shown.
            machine: The robot that it is of.
        """
        with self._page.drawing:
            self._show(answer, machine)

    def _show(self, answer: PlacementResult, machine: Machine) -> None:
        page, plan, robot = self._page, answer.plan, answer.prepared.robot
        shown = page.shown
        assert shown.scene is not None
        shown.answer = answer
        page.layers.clear()
        self.show_room()
        if page.robot.robot is not robot:
            page.robot.show(robot, page.robot.base)
            shown.probe = None
        page.room.mark(())
        story, words = None, answer_words(answer)
        if plan.motion is not None and plan.base_pose is not None:
            try:
                story = Story.of(plan, robot, shown.scene)
            except InputError as error:
                words += f"\n- no motion to show: {escaped(str(error))}"
            page.robot.move(np.array(plan.base_pose), joint_values(robot, plan.motion.q[-1]))
            if plan.task.joint is not None:
                page.room.move({plan.task.joint: float(plan.motion.object_q[-1])})
        shown_base = plan.base_pose or plan.feasible_from
        if plan.motion is None and shown_base is not None:
            page.robot.move(np.array(shown_base), home_values(robot))
        page.robot.verdict("feasible" if plan.motion is not None else "infeasible")
        page.motion.load(story)
        page.layers.show(shown.scene, answer, machine.reach_of(robot.arm))
        page.tell(words)

    def measured(self, before: PlacementResult, answer: PlacementResult) -> None:
        """The tolerance of an answer is known: take it instead, and say it where that is said.

        Args:
            before: The answer that may be shown still.
            answer: The same with its tolerance.
        """
        page = self._page
        with page.drawing:
            if page.shown.answer is not before:
                return
            page.shown.answer = answer
            said, known = page.panel.result.content, answer_words(before)
            if said.startswith(known):
                page.tell(answer_words(answer) + said.removeprefix(known))

    def change_look(self) -> None:
        """Things are drawn as what is checked, or as what they look like."""
        room = self._page.room
        if room.scene is not None:
            with self._page.drawing:
                room.show(room.scene, room.active, collision=self._collision)

    def show_room(self) -> None:
        """Draw the room that is asked about, where another moment of a tour is shown."""
        scene = self._page.shown.scene
        if scene is not None:
            self._page.room.show(scene, self.asked_object, collision=self._collision)

    @property
    def asked_object(self) -> str:
        """The object that is asked about; "" where nothing is."""
        question = self._page.shown.question
        return "" if question is None else question.target.partition("/")[0]

    @property
    def _collision(self) -> bool:
        return bool(self._page.panel.layers["collision"].value)


def begin_of(scene: Scene, question: Question) -> Float[np.ndarray, "3"]:
    """Where the robot is drawn before there is an answer: x [m], y [m], yaw [rad]."""
    if question.start is not None:
        return np.array(question.start)
    if scene.start is not None:
        return scene.start
    return np.append(in_front_of_parts(scene), np.pi / 2)
