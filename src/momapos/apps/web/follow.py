"""Dragging the base: the page checks the pose under the mouse and shows what it finds."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np
from viser.transforms import SO3

from momapos.apps.export import CarriedObject
from momapos.core import Clock

from .motion_view import MotionView
from .playback import DetailControl, values_at_end
from .probe import Probe, ProbedPose
from .robot_view import home_values, joint_values
from .state import PageState
from .words import finding_card, verdict_of
from .work import LatestWorker

if TYPE_CHECKING:
    from jaxtyping import Float

DRAG_TIME_LIMIT = 0.08
"""While the base is dragged, no further grasp is tried after this time [s]."""


class DragFollower:
    """Checks the newest pose to which the base is dragged."""

    def __init__(self, state: PageState, motion: MotionView, detail: DetailControl) -> None:
        self._state, self._motion, self._detail = state, motion, detail
        self.work = LatestWorker("page drag", state.fail)

    def dragged(self, event: Any) -> None:
        """Handle a drag of the base."""
        gizmo = event.target
        yaw = float(SO3(np.asarray(gizmo.wxyz)).compute_yaw_radians())
        base = np.array([gizmo.position[0], gizmo.position[1], yaw])
        self._motion.pause()
        self._detail.scene_moved()
        self._state.robot.base = base
        self._state.panel.resender.node(gizmo)
        self._state.panel.place_here.visible = True
        began = time.perf_counter()
        self.work.put(lambda clock: self._check(base, began, clock))

    def _check(self, base: Float[np.ndarray, "3"], began: float, clock: Clock) -> None:
        probe = self._probe()
        if probe is None:
            return
        finding = probe.at(base, clock, within=DRAG_TIME_LIMIT)
        self._show(finding, probe, time.perf_counter() - began)
        if not finding.complete and not self.work.waiting:
            finding = probe.at(base, clock)
            self._show(finding, probe, time.perf_counter() - began)

    def _probe(self) -> Probe | None:
        """Return the prepared checks of the question, which are rebuilt after it changes."""
        shown = self._state.shown
        if shown.scene is None or shown.arms is None or shown.question is None:
            return None
        if shown.probe is None:
            robot, question = self._state.arm_of(shown.arms), shown.question
            shown.probe = Probe(
                shown.scene, robot, question.task(shown.scene), shown.arms.reach_of(robot.arm),
                question.config, question.seed,
            )  # fmt: skip
        return shown.probe

    def _show(self, finding: ProbedPose, probe: Probe, seconds: float) -> None:
        state, robot, motion = self._state, probe.robot, finding.motion
        with state.drawing, state.server.atomic():
            if state.shown.probe is not probe:  # the question has changed
                return
            state.show_room()
            if motion is None:
                state.robot.move(None, home_values(robot))
                state.room.rest()
                state.panel.show_joint_values({})
            else:
                state.robot.move(None, joint_values(robot, motion.q[-1]))
                values = values_at_end(probe.scene, probe.task, motion)
                state.room.move(values)
                state.panel.show_joint_values(values)
                carried = CarriedObject.of(probe.scene, probe.task, motion)
                if carried is not None:
                    state.room.carry(carried.at_end(probe.task, motion))
            state.robot.verdict(verdict_of(finding))
            state.room.mark(finding.in_the_way)
            state.show(finding_card(finding, probe, seconds))
            state.panel.guide.done("drag", *(() if finding.feasible else ("why",)))
