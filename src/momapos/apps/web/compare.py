"""Answers that are kept to be compared: one over the other, or side by side, in step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.apps.plots import room_bounds
from momapos.model.scene import Scene
from momapos.planning import PlacementResult

from .cameras import look_at, viewpoint
from .playback import Story
from .robot_view import RobotView, joint_values
from .room_view import RoomView
from .words import escaped

if TYPE_CHECKING:
    from jaxtyping import Float

    from .page import Page

COLORS = ("#0072b2", "#d55e00", "#cc79a7", "#009e73")
"""Of the robots of answers that are kept (Okabe and Ito)."""
NAMES = ("blue", "orange", "pink", "green")
APART = 1.0
"""Rooms that stand side by side are so far apart [m]."""
CAPTION = 2.6
"""Height of the words over a room [m]."""
SEEN_THROUGH = 0.45
"""How much is seen of a robot that is drawn over another [-]."""


@dataclass(frozen=True)
class Kept:
    """An answer that is kept."""

    answer: PlacementResult
    scene: Scene
    story: Story | None
    """None where there is no motion."""
    frame: Any
    room: RoomView
    """Empty as long as it is drawn over the room itself."""
    robot: RobotView
    color: str


class Compare:
    """Keeps answers."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._kept: list[Kept] = []
        self._captions: list[Any] = []

    @property
    def kept(self) -> tuple[Kept, ...]:
        """The answers that are kept."""
        return tuple(self._kept)

    @property
    def _beside(self) -> bool:
        return bool(self._page.panel.beside.value)

    def keep(self) -> None:
        """Keep the answer that is shown, as another robot and a line of a table."""
        with self._page.drawing:
            self._keep()

    def _keep(self) -> None:
        page, answer, scene = self._page, self._page.shown.answer, self._page.shown.scene
        if answer is None or scene is None or len(self._kept) == len(COLORS):
            words = "there is no answer yet" if answer is None else "no more than four are kept"
            page.panel.kept.content = f"**Not kept:** {words}."
            return
        name, story = f"/kept{len(self._kept)}", page.motion.story
        api = page.server.scene
        kept = Kept(
            answer, scene, story if isinstance(story, Story) else None,
            api.add_frame(name, show_axes=False), RoomView(api, name=f"{name}/room"),
            RobotView(api, f"{name}/robot"), COLORS[len(self._kept)],
        )  # fmt: skip
        self._kept.append(kept)
        page.panel.kept.content = compared([one.answer for one in self._kept])
        self._arrange()

    def arrange(self) -> None:
        """Put the answers over the room, or beside it, and turn to all of them."""
        with self._page.drawing:
            self._arrange()
            scene = self._page.shown.scene
            if scene is not None and self._kept:
                beside = self._kept if self._beside else []
                shifts = [self._shift(kept.scene, k + 1) for k, kept in enumerate(beside)]
                look_at(self._page.server, scene, shifts)

    def _arrange(self) -> None:
        self._remove_captions()
        for k, kept in enumerate(self._kept):
            kept.frame.position = self._shift(kept.scene, k + 1) if self._beside else np.zeros(3)
            self._draw(kept)
            if self._beside:
                words = f"{NAMES[k]}: {title(kept.answer)}"
                self._caption(f"/kept{k}/caption", kept.scene, words)
        shown = self._page.shown
        if self._beside and self._kept and shown.scene is not None:
            words = "now" if shown.answer is None else f"now: {title(shown.answer)}"
            self._caption("/caption", shown.scene, words)

    def show(self, seconds: float) -> None:
        """Show all kept motions at a time [s]."""
        for kept in self._kept:
            if kept.story is not None:
                kept.story.at(seconds).show(kept.room, kept.robot)

    def forget(self) -> None:
        """Forget the answers that are kept."""
        with self._page.drawing:
            self._forget()

    def _forget(self) -> None:
        self._remove_captions()
        for kept in self._kept:
            kept.room.remove()
            kept.robot.remove()
            kept.frame.remove()
        self._kept = []
        self._page.panel.kept.content = "Nothing is kept."

    def _draw(self, kept: Kept) -> None:
        plan, robot = kept.answer.plan, kept.answer.prepared.robot
        if self._beside:
            kept.room.show(kept.scene, plan.task.object)
        else:
            kept.room.remove()
        if plan.motion is None or plan.base_pose is None:
            return
        opacity = None if self._beside else SEEN_THROUGH
        kept.robot.show(robot, np.array(plan.base_pose), opacity=opacity, color=kept.color)
        kept.robot.move(None, joint_values(robot, plan.motion.q[-1]))
        if plan.task.joint is not None:
            kept.room.move({plan.task.joint: float(plan.motion.object_q[-1])})

    def _remove_captions(self) -> None:
        for caption in self._captions:
            caption.remove()
        self._captions = []

    def _shift(self, scene: Scene, places: int) -> Float[np.ndarray, "3"]:
        """How far aside a room stands [m]: to the right of who looks at the first one."""
        eye, target = viewpoint(scene)
        ahead = (target - eye)[:2]
        axis = int(np.argmax(np.abs(ahead)))  # along the room's own edges
        right = np.zeros(3)
        right[1 - axis] = np.sign(ahead[axis]) * (1.0 if axis else -1.0)
        wide = float(np.abs(np.ptp(room_bounds(scene), axis=0) @ right[:2]))
        return places * (wide + APART) * right

    def _caption(self, name: str, scene: Scene, words: str) -> None:
        middle = np.append(room_bounds(scene).mean(0), CAPTION)
        label = self._page.server.scene.add_label(
            name, words, position=middle, anchor="bottom-center"
        )
        self._captions.append(label)


def title(answer: PlacementResult) -> str:
    """An answer in a few words."""
    plan = answer.plan
    drive = "" if plan.navigation_cost is None else f", {plan.navigation_cost:.2f} m driven"
    return f"{plan.robot_name}, {plan.method}, seed {plan.seed}: {plan.status}{drive}"


def compared(answers: list[PlacementResult]) -> str:
    """Answers as a table."""
    lines = ["| | robot, method, seed | status | drive [m] | time [ms] |", "|-|-|-|-|-|"]
    for color, answer in zip(NAMES, answers, strict=False):
        plan = answer.plan
        drive = "-" if plan.navigation_cost is None else f"{plan.navigation_cost:.2f}"
        what = escaped(f"{plan.robot_name}, {plan.method}, {plan.seed}")
        took = 1000 * plan.timing.get("total", 0.0)
        lines.append(f"| {color} | {what} | {plan.status} | {drive} | {took:.0f} |")
    return "\n".join(lines)
