"""Comparison of answers: robots in one room, or copies of the room side by side, played in step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.apps.plots import room_bounds
from momapos.core import escape_markdown
from momapos.model.scene import Scene
from momapos.planning import PlacementResult

from .cameras import frame, look_at, viewpoint
from .colors import COMPARED
from .playback import Story, values_at_end
from .robot_view import RobotView, joint_values
from .room_view import RoomView
from .state import PageState

if TYPE_CHECKING:
    from jaxtyping import Float

NAMES, COLORS = tuple(COMPARED), tuple(COMPARED.values())
"""Colors of the robots of compared answers, and their names."""
ROOM_GAP = 1.0
"""Gap between rooms that stand side by side [m]."""
CAPTION_HEIGHT = 2.6
"""Height of the caption over a room [m]."""
OVERLAY_OPACITY = 0.45
"""Opacity of a robot that is drawn over another one [-]."""
EMPTY = "No answers to compare."


@dataclass(frozen=True)
class ComparedAnswer:
    """An answer, and how it is drawn."""

    answer: PlacementResult
    scene: Scene
    story: Story | None
    """None where there is no motion."""
    frame: Any
    room: RoomView
    """Empty unless the answers stand side by side."""
    robot: RobotView
    color: str


class Compare:
    """Draws answers for comparison, up to one per color."""

    def __init__(self, state: PageState) -> None:
        self._state = state
        self._answers: list[ComparedAnswer] = []
        self._captions: list[Any] = []
        panel = state.panel
        panel.comparison.content = EMPTY
        panel.on_click(panel.add_answer, self.add)
        panel.on_click(panel.clear_answers, self.clear)
        panel.on_change(panel.side_by_side, self.arrange)

    @property
    def answers(self) -> tuple[ComparedAnswer, ...]:
        """The compared answers."""
        return tuple(self._answers)

    @property
    def _side_by_side(self) -> bool:
        return bool(self._state.panel.side_by_side.value)

    def add(self) -> None:
        """Add the answer that is shown, as another robot and a row of the table."""
        with self._state.drawing:
            self._add()

    def _add(self) -> None:
        state, answer, scene = self._state, self._state.shown.answer, self._state.shown.scene
        if answer is None or scene is None or len(self._answers) == len(COLORS):
            reason = "there is no answer yet" if answer is None else "the limit is four answers"
            state.panel.comparison.content = f"**Not added:** {reason}."
            return
        name, story, api = f"/compared{len(self._answers)}", state.shown.story, state.server.scene
        self._answers.append(ComparedAnswer(
            answer, scene, story if isinstance(story, Story) else None,
            api.add_frame(name, show_axes=False), RoomView(api, name=f"{name}/room"),
            RobotView(api, f"{name}/robot"), COLORS[len(self._answers)],
        ))  # fmt: skip
        state.panel.comparison.content = comparison([one.answer for one in self._answers])
        self._arrange()

    def arrange(self) -> None:
        """Put the answers into one room or side by side, and show all of them."""
        with self._state.drawing:
            self._arrange()
            scene = self._state.shown.scene
            if scene is not None and self._answers and self._side_by_side:
                shifts = [self._shift(one.scene, k + 1) for k, one in enumerate(self._answers)]
                look_at(self._state.server, scene, shifts)
            elif scene is not None:
                base = self._state.robot.base
                frame(self._state.server, scene, self._state.panel.target.value, base[None])

    def _arrange(self) -> None:
        self._remove_captions()
        for k, one in enumerate(self._answers):
            places = k + 1 if self._side_by_side else 0
            one.frame.position = self._shift(one.scene, places)
            self._draw(one)
            if self._side_by_side:
                caption = f"{NAMES[k]}: {title(one.answer)}"
                self._add_caption(f"/compared{k}/caption", one.scene, caption)
        shown = self._state.shown
        if self._side_by_side and self._answers and shown.scene is not None:
            caption = "now" if shown.answer is None else f"now: {title(shown.answer)}"
            self._add_caption("/caption", shown.scene, caption)

    def show(self, seconds: float) -> None:
        """Show all compared motions at a time [s]."""
        for one in self._answers:
            if one.story is not None:
                one.story.at(seconds).show(one.room, one.robot)

    def clear(self) -> None:
        """Remove all answers."""
        with self._state.drawing:
            self._remove_captions()
            for one in self._answers:
                one.room.remove()
                one.robot.remove()
                one.frame.remove()
            self._answers = []
            self._state.panel.comparison.content = EMPTY

    def _draw(self, one: ComparedAnswer) -> None:
        plan, robot = one.answer.plan, one.answer.prepared.robot
        if self._side_by_side:
            one.room.show(one.scene, plan.task.object, plan.task.joint)
        else:
            one.room.remove()
        if plan.motion is None or plan.base_pose is None:
            return
        opacity = None if self._side_by_side else OVERLAY_OPACITY
        one.robot.show(robot, np.array(plan.final_base_pose), opacity=opacity, color=one.color)
        one.robot.move(None, joint_values(robot, plan.motion.q[-1]))
        if plan.task.joint is not None:
            one.room.move(values_at_end(one.scene, plan.task, plan.motion))

    def _remove_captions(self) -> None:
        for caption in self._captions:
            caption.remove()
        self._captions = []

    def _shift(self, scene: Scene, places: int) -> Float[np.ndarray, "3"]:
        """Return the offset of a room, to the right as seen by the camera [m]."""
        eye, target = viewpoint(scene)
        ahead = (target - eye)[:2]
        axis = int(np.argmax(np.abs(ahead)))  # along the room's own edges
        right = np.zeros(3)
        right[1 - axis] = np.sign(ahead[axis]) * (1.0 if axis else -1.0)
        width = float(np.abs(np.ptp(room_bounds(scene), axis=0) @ right[:2]))
        return places * (width + ROOM_GAP) * right

    def _add_caption(self, name: str, scene: Scene, words: str) -> None:
        middle = np.append(room_bounds(scene).mean(0), CAPTION_HEIGHT)
        self._captions.append(self._state.server.scene.add_label(
            name, words, position=middle, anchor="bottom-center"
        ))  # fmt: skip


def title(answer: PlacementResult) -> str:
    """Summarize an answer in a few words."""
    plan = answer.plan
    drive = "" if plan.navigation_cost is None else f", {plan.navigation_cost:.2f} m driven"
    return f"{plan.robot_name}, {plan.method}, seed {plan.seed}: {plan.status}{drive}"


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
