"""What goes beside the question: files, pictures, answers kept to be compared."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.page.robot_view import RobotView, joint_values
from momapos.page.saving import save_plan, save_room, send_film, send_picture
from momapos.page.words import escaped
from momapos.page.work import Latest
from momapos.placement_result import PlacementResult

if TYPE_CHECKING:
    from momapos.page.page import Page

COLORS = ("#0072b2", "#d55e00", "#cc79a7", "#009e73")
"""Of the robots of answers that are kept (Okabe and Ito)."""
NAMES = ("blue", "orange", "pink", "green")


@dataclass(frozen=True)
class Kept:
    """An answer that is kept to be compared."""

    answer: PlacementResult
    view: RobotView | None


class Extras:
    """Does what the lower controls ask for; its work has a thread of its own."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._kept: list[Kept] = []
        self.work = Latest("page files", self._fail)

    def _fail(self, reason: str) -> None:
        self._page.panel.files.content = f"**Not done.** {escaped(reason)}"

    def _do(self, work: Callable[[], str]) -> None:
        def tell(_: object) -> None:
            self._page.panel.files.content = work()

        self.work.put(tell)

    def save_plan(self, name: str) -> None:
        """Write the plan into the working folder."""
        page = self._page
        self._do(lambda: _saved(save_plan(page.folder, name, page.shown.answer).name))

    def save_scene(self, name: str) -> None:
        """Write the scene into the working folder."""
        page, shown = self._page, self._page.shown
        target = "" if shown.question is None else shown.question.target.partition("/")[0]
        joints = dict(shown.joints)
        self._do(lambda: _saved(save_room(page.folder, name, shown.scene, target, joints).name))

    def picture(self, client: Any) -> None:
        """Give a browser a picture of what it sees."""

        def work() -> str:
            send_picture(client)
            return "The picture is in the browser's downloads."

        if client is not None:
            self._do(work)

    def film(self, client: Any) -> None:
        """Give a browser a film of the motion from where it looks."""
        page = self._page

        def work() -> str:
            page.panel.files.content = "Filming."
            send_film(client, page.player.duration, page.player.seek)
            return "The film is in the browser's downloads."

        page.player.pause()
        if client is not None:
            self._do(work)

    def keep(self) -> None:
        """Keep the answer that is shown, as a see-through robot and a line of a table."""
        page, answer = self._page, self._page.shown.answer
        if answer is None or len(self._kept) == len(COLORS):
            words = "there is no answer yet" if answer is None else "no more than four are kept"
            page.panel.kept.content = f"**Not kept:** {words}."
            return
        view, plan, robot = None, answer.plan, answer.prepared.robot
        if plan.motion is not None and plan.base_pose is not None:
            index = len(self._kept)
            view = RobotView(page.server.scene, f"/kept{index}")
            view.show(robot, np.array(plan.base_pose), opacity=0.45, color=COLORS[index])
            view.move(None, joint_values(robot, plan.motion.q[-1]))
        self._kept.append(Kept(answer, view))
        page.panel.kept.content = compared([kept.answer for kept in self._kept])

    def forget(self) -> None:
        """Forget the answers that are kept."""
        for kept in self._kept:
            if kept.view is not None:
                kept.view.remove()
        self._kept = []
        self._page.panel.kept.content = "Nothing is kept."

    def close(self) -> None:
        """End all work."""
        self.work.close()


def _saved(name: str) -> str:
    return f"Saved as {escaped(name)}."


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
