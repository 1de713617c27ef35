"""Comparison of answers: robots in one room, played in step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from momapos.core import escape_markdown
from momapos.planning import PlacementResult

from .colors import COMPARED
from .playback import Story
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
    story: Story | None
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
        story = story if isinstance(story, Story) else None
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
