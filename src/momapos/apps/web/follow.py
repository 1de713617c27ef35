"""The base that is dragged by hand: what is known of where it is follows it."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np
from viser.transforms import SO3

from momapos.apps.export import Carried
from momapos.core import Clock

from .probe import Finding, Probe
from .robot_view import home_values, joint_values
from .words import finding_words, verdict_of
from .work import Latest

if TYPE_CHECKING:
    from jaxtyping import Float

    from .page import Page

FOLLOW = 0.08
"""While the base is dragged no further way of holding is tried after this time [s]."""


class Follow:
    """Asks about where the base is dragged, and about nothing that came before."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self.work = Latest("page drag", page.fail)

    def dragged(self, event: Any) -> None:
        """The base is dragged."""
        gizmo = event.target
        yaw = float(SO3(np.asarray(gizmo.wxyz)).compute_yaw_radians())
        base = np.array([gizmo.position[0], gizmo.position[1], yaw])
        self._page.motion.pause()
        self._page.moving.stirred()
        self._page.robot.base = base
        self._page.settled.node(gizmo)
        asked = time.perf_counter()
        self.work.put(lambda clock: self._ask(base, asked, clock))

    def _ask(self, base: Float[np.ndarray, "3"], asked: float, clock: Clock) -> None:
        probe = self._probe()
        if probe is None:
            return
        finding = probe.at(base, clock, within=FOLLOW)
        self._show(finding, probe, time.perf_counter() - asked)
        if not finding.sure and not self.work.waiting:
            finding = probe.at(base, clock)
            self._show(finding, probe, time.perf_counter() - asked)

    def _probe(self) -> Probe | None:
        """The question made ready for many base poses; made anew when it has changed."""
        shown = self._page.shown
        if shown.scene is None or shown.machine is None or shown.question is None:
            return None
        if shown.probe is None:
            robot, question = self._page.arm_of(shown.machine), shown.question
            shown.probe = Probe(
                shown.scene, robot, question.task(shown.scene), shown.machine.reach_of(robot.arm),
                question.config, question.seed,
            )  # fmt: skip
        return shown.probe

    def _show(self, finding: Finding, probe: Probe, seconds: float) -> None:
        page, robot, joint = self._page, probe.robot, probe.task.joint
        with page.drawing, page.server.atomic():
            if page.shown.probe is not probe:  # something else is asked by now
                return
            page.answer.show_room()
            if finding.motion is None:
                page.robot.move(None, home_values(robot))
                page.room.rest()
                page.panel.show_joint_values({})
            else:
                motion, carried = (
                    finding.motion,
                    Carried.of(probe.scene, probe.task, finding.motion),
                )
                page.robot.move(None, joint_values(robot, motion.q[-1]))
                values = {} if joint is None else {joint: float(motion.object_q[-1])}
                page.room.move(values)
                page.panel.show_joint_values(values)
                if carried is not None:
                    page.room.carry(carried.at_end(probe.task, motion))
            page.robot.verdict(verdict_of(finding))
            page.room.mark(finding.in_the_way)
            page.tell(finding_words(finding, probe, seconds))
