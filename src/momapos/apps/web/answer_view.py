"""Drawing a question and its answer: room, robot, motion, layers."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import InputError
from momapos.model.scene import Scene
from momapos.planning import PlacementResult
from momapos.planning.grasps import in_front_of_parts

from .answer_layers import AnswerLayers
from .cameras import frame
from .card import Card
from .joint_ranges import joint_ranges
from .light import Light
from .motion_view import MotionView
from .playback import Story, values_at_end
from .question import Question, RobotArms
from .robot_view import home_values, joint_values
from .state import PageState
from .words import answer_card, check_lines

if TYPE_CHECKING:
    from jaxtyping import Float

READY = Card("Ready", notes=("Press Place, or drag the base.",))


class AnswerView:
    """Draws a question and then its answer, in place of the last ones."""

    def __init__(
        self, state: PageState, motion: MotionView, layers: AnswerLayers, light: Light
    ) -> None:
        self._state, self._motion, self._layers, self._light = state, motion, layers, light

    def ask(
        self, scene: Scene, arms: RobotArms, question: Question, *, fresh: bool, turn: bool
    ) -> None:
        """Draw a question before its answer is known.

        Args:
            scene: The room.
            arms: The robot.
            question: The question.
            fresh: Whether the room or the robot differs from the one that is drawn.
            turn: Whether to turn the cameras to the task; a new room does it anyway.
        """
        state = self._state
        with state.drawing:
            shown, robot = state.shown, arms.robots[0]
            shown.question, shown.answer, shown.probe = question, None, None
            shown.joints = {}
            self._motion.load(None)
            self._layers.clear()  # before the robot, which is the parent node of one of them
            start = start_of(scene, question)
            if state.room.scene is not scene:
                self._light.of_room(scene)
                turn = True
            if turn:
                frame(state.server, scene, question.target, start[None])
            state.show_room()
            state.room.rest()
            state.panel.show_joints(joint_ranges(scene, shown.target), self._motion.move_joints)
            if state.robot.robot is not robot or fresh:
                state.robot.show(robot, start)
            else:
                state.robot.move(start, home_values(robot))
            state.robot.verdict("")
            state.show(READY)
            state.panel.place_here.visible = False
            state.panel.show_check(() if shown.check is None else check_lines(shown.check))

    def show(self, answer: PlacementResult, arms: RobotArms) -> None:
        """Draw an answer.

        Args:
            answer: An answer for the scene that is shown.
            arms: The robot of the answer.
        """
        with self._state.drawing:
            self._show(answer, arms)

    def _show(self, answer: PlacementResult, arms: RobotArms) -> None:
        state, plan, robot = self._state, answer.plan, answer.prepared.robot
        shown = state.shown
        assert shown.scene is not None
        shown.answer = answer
        self._layers.clear()
        state.show_room()
        if state.robot.robot is not robot:
            state.robot.show(robot, state.robot.base)
            shown.probe = None
        state.room.mark(())
        story, card = None, answer_card(answer)
        if plan.motion is not None and plan.base_pose is not None:
            try:
                story = Story.of(plan, robot, shown.scene)
            except InputError as error:
                card = replace(card, notes=(*card.notes, f"no motion to show: {error}"))
            state.robot.move(np.array(plan.final_base_pose), joint_values(robot, plan.motion.q[-1]))
            if plan.task.joint is not None:
                state.room.move(values_at_end(shown.scene, plan.task, plan.motion))
        shown_base = plan.base_pose or plan.feasible_from
        if plan.motion is None and shown_base is not None:
            state.robot.move(np.array(shown_base), home_values(robot))
        state.robot.verdict("feasible" if plan.motion is not None else "infeasible")
        self._motion.load(story)
        self._layers.show(shown.scene, answer, arms.reach_of(robot.arm))
        state.show(card)
        state.panel.guide.done("choose", "place")

    def change_look(self) -> None:
        """Draw objects by their collision shapes, or by their visual ones again."""
        room = self._state.room
        if room.scene is not None:
            with self._state.drawing:
                collision = bool(self._state.panel.layers["collision"].value)
                room.show(room.scene, room.active, room.joint, collision=collision)


def start_of(scene: Scene, question: Question) -> Float[np.ndarray, "3"]:
    """Return where the robot is drawn before there is an answer: x [m], y [m], yaw [rad]."""
    if question.start is not None:
        return np.array(question.start)
    if scene.start is not None:
        return scene.start
    return np.append(in_front_of_parts(scene), np.pi / 2)
