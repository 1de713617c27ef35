"""The motion on the page: playing and seeking it, sliders of joints, and answers in step."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from momapos.core import escape_markdown
from momapos.planning import PlacementResult

from .colors import COMPARED
from .panel import NO_MOTION
from .playback import DetailControl, Playable, Player
from .robot_view import RobotView, joint_values
from .state import PageState

NAMES, COLORS = tuple(COMPARED), tuple(COMPARED.values())
"""Colors of the robots of compared answers, and their names."""
OVERLAY_OPACITY = 0.45
"""Opacity of a robot that is drawn over another one [-]."""
EMPTY = "No answers to compare."


@dataclass(frozen=True)
class ComparedAnswer:
    """An answer, and how it is drawn."""

    answer: PlacementResult
    story: Playable | None
    """None where there is no motion."""
    robot: RobotView


class Compare:
    """Draws answers for comparison, up to one per color."""

    def __init__(self, state: PageState) -> None:
        self._state = state
        self._answers: list[ComparedAnswer] = []
        panel = state.panel
        panel.comparison.content = EMPTY
        panel.on_click(panel.add_answer, self.add)
        panel.on_click(panel.clear_answers, self.clear)

    @property
    def answers(self) -> tuple[ComparedAnswer, ...]:
        """The compared answers."""
        return tuple(self._answers)

    def add(self) -> None:
        """Add the answer that is shown, as another robot and a row of the table."""
        with self._state.drawing:
            self._add()

    def _add(self) -> None:
        state, answer = self._state, self._state.shown.answer
        if answer is None or len(self._answers) == len(COLORS):
            reason = "there is no answer yet" if answer is None else "the limit is four answers"
            state.panel.comparison.content = f"**Not added:** {reason}."
            return
        story, color = state.shown.story, COLORS[len(self._answers)]
        view = RobotView(state.server.scene, f"/compared{len(self._answers)}")
        self._answers.append(ComparedAnswer(answer, story, view))
        state.panel.comparison.content = comparison([one.answer for one in self._answers])
        plan, robot = answer.plan, answer.prepared.robot
        if plan.motion is not None and plan.base_pose is not None:
            base = np.array(plan.final_base_pose)
            view.show(robot, base, opacity=OVERLAY_OPACITY, color=color)
            view.move(None, joint_values(robot, plan.motion.q[-1]))

    def show(self, seconds: float) -> None:
        """Show all compared motions at a time [s]."""
        for one in self._answers:
            if one.story is not None:
                one.story.at(seconds).show_robot(one.robot)

    def clear(self) -> None:
        """Remove all answers."""
        with self._state.drawing:
            for one in self._answers:
                one.robot.remove()
            self._answers = []
            self._state.panel.comparison.content = EMPTY


def comparison(answers: list[PlacementResult]) -> str:
    """Format answers as a Markdown table."""
    lines = ["| | robot, method, seed | status | drive [m] | time [ms] |", "|-|-|-|-|-|"]
    for color, answer in zip(NAMES, answers, strict=False):
        plan = answer.plan
        drive = "-" if plan.navigation_cost is None else f"{plan.navigation_cost:.2f}"
        what = escape_markdown(f"{plan.robot_name}, {plan.method}, {plan.seed}")
        took = 1000 * plan.timing.get("total", 0.0)
        lines.append(f"| {color} | {what} | {plan.status} | {drive} | {took:.0f} |")
    return "\n".join(lines)


TEXT_INTERVAL = 0.2
"""Time between updates of the text while the motion plays [s]."""


class MotionView:
    """Plays the motion that is shown, and those of the compared answers in step with it."""

    def __init__(self, state: PageState, compare: Compare, detail: DetailControl) -> None:
        self._state, self._compare, self._detail = state, compare, detail
        self._text_time = 0.0
        self.player = Player(self._show)
        panel = state.panel
        panel.on_click(panel.play, self.toggle)
        panel.on_change(panel.time, lambda: self.player.seek(float(panel.time.value)))
        panel.on_change(panel.speed, lambda: self.set_speed(float(panel.speed.value)))

    def load(self, story: Playable | None, *, at_end: bool = True) -> None:
        """Show another motion.

        Args:
            story: The motion; None where there is none.
            at_end: Whether to seek to its end, which is the state that an answer shows.
        """
        state, duration = self._state, 0.0 if story is None else story.duration
        state.shown.story = story
        self.player.load(duration)
        state.panel.show_duration(duration)
        state.robot.show_force(None)
        if story is None:
            state.panel.moment.content = NO_MOTION
        else:
            self.player.seek(duration if at_end else 0.0)

    def toggle(self) -> None:
        """Play the motion, or pause it."""
        state = self._state
        if self.player.playing:
            self.pause()
            self._show(self.player.now, False)
        elif state.shown.story is not None:
            with state.drawing:
                state.room.mark(())
                state.robot.verdict("feasible")
            state.panel.guide.done("play")
            self.player.play()

    def pause(self) -> None:
        """Pause the motion."""
        self.player.pause()
        self._state.panel.show_playing(False)

    def seek(self, seconds: float) -> None:
        """Show the motion at a time [s]."""
        self.player.seek(seconds)

    def step(self, seconds: float) -> None:
        """Seek forward, or backward by a negative time [s]."""
        self.player.seek(self.player.now + seconds)

    def set_speed(self, speed: float) -> None:
        """Set the playback speed, where 1 is real time [-]."""
        self.player.speed = speed

    def move_joints(self) -> None:
        """Move the object's joints to the values of their sliders."""
        self.pause()
        state = self._state
        state.shown.joints = state.panel.joint_values
        with state.drawing:
            state.show_room()
            state.room.move(state.shown.joints)

    def _show(self, seconds: float, playing: bool) -> None:
        state = self._state
        with state.drawing, state.server.atomic():
            story = state.shown.story
            if story is None:
                return
            moment = story.at(seconds)
            moment.show(state.room, state.robot)
            self._compare.show(seconds)
        if playing:
            self._detail.scene_moved()
        now = time.perf_counter()
        panel = state.panel
        panel.show_playing(self.player.playing)
        if playing and now - self._text_time <= TEXT_INTERVAL:
            return
        self._text_time = now
        text = moment.phase
        if moment.force is not None and moment.force.any():
            text += f", hand force {np.linalg.norm(moment.force):.0f} N"
        if state.room.active == state.shown.target:
            panel.show_joint_values(moment.object_q)
        panel.show_moment(seconds, text)
