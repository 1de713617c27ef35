"""The layers of an answer: drawn when first switched on, then only hidden and shown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from momapos.apps import plots
from momapos.core import Clock, escape_markdown
from momapos.model.records import ReachScorer
from momapos.model.scene import Scene
from momapos.planning import PlacementResult, opening_map, with_tolerance
from momapos.planning.grasps import hand_path
from momapos.planning.importance import rank

from . import map_layers as draw
from .legend import legend
from .panel import LAYERS
from .state import PageState
from .words import answer_card
from .work import LatestWorker

ROOT = "/layers"
REACH_MARGIN = 0.4
"""The reachability layer extends this much farther from the base than the arm is long [m]."""
CELL = 0.06
"""Edge of a cell of the images on the floor [m]."""
SLOW = ("tolerance", "opening")
"""Layers that take half a second, and seconds: each has a thread of its own."""


@dataclass(frozen=True)
class LayerSource:
    """What the layers are computed from."""

    scene: Scene
    answer: PlacementResult
    reach: ReachScorer


class AnswerLayers:
    """Draws the layers of one answer."""

    def __init__(self, state: PageState) -> None:
        self._state, self._panel, self._drawing = state, state.panel, state.drawing
        self._api, self._robot = state.server.scene, state.robot
        self._roots: dict[str, Any] = {}
        self._of: LayerSource | None = None
        self._kinds: tuple[str, ...] = ()
        self.work = LatestWorker("page layers", self._fail)
        self._slow = {key: LatestWorker(f"page {key}", self._fail) for key in SLOW}
        panel = state.panel
        for handle in panel.layers.values():
            panel.on_change(handle, self.changed)
        panel.on_change(panel.height, self.height_changed)

    @property
    def drawn(self) -> tuple[str, ...]:
        """The layers that are drawn, visible or not."""
        with self._drawing:
            return tuple(self._roots)

    @property
    def _works(self) -> tuple[LatestWorker, ...]:
        return (self.work, *self._slow.values())

    @property
    def busy(self) -> bool:
        """Whether a layer is being computed, or waits for it."""
        return any(work.busy for work in self._works)

    def wait(self, timeout: float) -> bool:
        """Wait until all layers are drawn; return whether each thread was done in time [s]."""
        return all(work.wait(timeout) for work in self._works)

    def stop(self) -> None:
        """Cancel running work; missing layers are drawn when a layer is next switched."""
        for work in self._works:
            work.stop()

    def close(self) -> None:
        """End all work."""
        for work in self._works:
            work.close()

    def show(self, scene: Scene, answer: PlacementResult, reach: ReachScorer) -> None:
        """Draw the layers of another answer that are switched on."""
        self.clear()
        self._of = LayerSource(scene, answer, reach)
        self.changed()

    def clear(self) -> None:
        """Remove all layers."""
        self.stop()
        with self._drawing:
            self._of = None
            for root in self._roots.values():
                root.remove()
            self._roots, self._kinds = {}, ()
        self._panel.legend.content = legend([], ())
        self._panel.clicked.content = ""

    def changed(self) -> None:
        """Draw the layers that are switched on, and hide the others."""
        with self._drawing:
            self._robot.show_spheres(bool(self._panel.layers["spheres"].value))
        self.work.put(lambda clock: self._update(clock, [k for k in LAYERS if k not in SLOW]))
        for key, work in self._slow.items():
            # Running work continues if it is still wanted, instead of starting again.
            wanted = bool(self._panel.layers[key].value)
            work.put(partial(self._update, keys=(key,)), stop_running=not wanted)

    def height_changed(self) -> None:
        """Redraw the reachability at another height."""
        with self._drawing:
            root = self._roots.pop("reach", None)
            if root is not None:
                root.remove()
        self.changed()

    def _fail(self, reason: str) -> None:
        self._panel.clicked.content = f"**Cannot draw this layer:** {escape_markdown(reason)}"

    def _update(self, clock: Clock, keys: Sequence[str]) -> None:
        of = self._of
        if of is None:
            return
        for key in keys:
            wanted = bool(self._panel.layers[key].value)
            if wanted and key in DRAW and key not in self._roots:
                self._draw(key, of, clock)
            with self._drawing:
                if self._of is not of:
                    return
                if key in self._roots:
                    self._roots[key].visible = wanted
        self._panel.legend.content = legend(
            [k for k in LAYERS if self._panel.layers[k].value], self._kinds
        )

    def _draw(self, key: str, of: LayerSource, clock: Clock) -> None:
        """Draw a layer; remove it again if the answer has changed meanwhile."""
        name = f"{self._robot.name if key == 'reach' else ROOT}/{key}"
        root, drawn = self._api.add_frame(name, show_axes=False), False
        try:
            DRAW[key](self, name, of, clock)
            drawn = True
        finally:
            with self._drawing:
                if drawn and self._of is of:
                    self._roots[key] = root
                elif self._api.get_handle_by_name(name) is not None:  # not gone with the robot
                    self._api.remove_by_name(name)

    def use_tolerance(self, before: PlacementResult, answer: PlacementResult) -> None:
        """Show an answer with its tolerance, if the one without it is still shown.

        Args:
            before: The answer without its tolerance.
            answer: The same answer with its tolerance.
        """
        state = self._state
        with state.drawing:
            if state.shown.answer is not before:
                return
            state.shown.answer = answer
            shown = state.panel.card.shown
            if shown.facts == answer_card(before).facts:
                state.show(replace(shown, facts=answer_card(answer).facts))

    # ------------------------------------------------------------------------- one for each layer

    def _path(self, name: str, of: LayerSource, _: Clock) -> None:
        draw.draw_start_and_path(self._api, name, of.answer)

    def _waypoints(self, name: str, of: LayerSource, _: Clock) -> None:
        draw.draw_waypoints(self._api, name, of.answer)

    def _candidates(self, name: str, of: LayerSource, _: Clock) -> None:
        self._kinds = draw.draw_candidates(self._api, f"{name}/all", of.answer, self._clicked)

    def _potential(self, name: str, of: LayerSource, _: Clock) -> None:
        found = plots.potential_map(of.answer.prepared.geometry, of.reach, cell=CELL)
        if found is not None and found.value.size:
            draw.floor_image(
                self._api, f"{name}/map", draw.potential_pixels(found), found.extent, height=0.004
            )

    def _free(self, name: str, of: LayerSource, _: Clock) -> None:
        bounds = draw.floor_bounds(of.scene)
        share, extent = draw.free_area(of.answer.prepared.geometry, bounds, cell=CELL)
        draw.floor_image(self._api, f"{name}/map", draw.free_pixels(share), extent, height=0.002)

    def _opening(self, name: str, of: LayerSource, clock: Clock) -> None:
        if of.answer.plan.task.joint is None:
            return

        def report(share: float) -> None:
            clock()
            self._panel.clicked.content = f"Opening map: {100 * share:.0f} %"

        robot, task = of.answer.prepared.robot, of.answer.plan.task
        try:
            found = opening_map(of.scene, robot, task, of.reach, report=report)
        finally:
            self._panel.clicked.content = ""
        if found.farthest.size:
            draw.floor_image(
                self._api, f"{name}/map", draw.opening_pixels(found), found.extent, height=0.006
            )

    def _tolerance(self, name: str, of: LayerSource, clock: Clock) -> None:
        answer = with_tolerance(of.answer, clock=clock)
        self.use_tolerance(of.answer, answer)
        plan, found = answer.plan, answer.plan.tolerance
        if found is not None and found.radius and plan.base_pose is not None:
            footprint = answer.prepared.robot.footprint
            draw.draw_tolerance(self._api, name, footprint, np.array(plan.base_pose), found)

    def _reach(self, name: str, of: LayerSource, _: Clock) -> None:
        height = float(self._panel.height.value)
        robot = of.answer.prepared.robot
        axes = plots.tool_axes(robot.approach_axis, robot.closing_axis)
        share, half = plots.reach_slice(of.reach, axes, robot.reach + REACH_MARGIN, height)
        draw.floor_image(
            self._api, f"{name}/map", draw.reach_pixels(share), (-half, half, -half, half),
            height=height,
        )  # fmt: skip

    def _importance(self, name: str, of: LayerSource, _: Clock) -> None:
        task = of.answer.plan.task
        path = hand_path(of.scene, task.object, task.joint, task.to)
        ranked = rank(of.scene, task.object, path=path, seed=of.answer.plan.seed)
        draw.draw_importance(self._api, name, ranked)

    def _clicked(self, words: str) -> None:
        self._panel.clicked.content = f"This candidate: **{escape_markdown(words)}**"
        self._panel.guide.done("why")


DRAW = {
    "path": AnswerLayers._path, "waypoints": AnswerLayers._waypoints,
    "candidates": AnswerLayers._candidates, "potential": AnswerLayers._potential,
    "free": AnswerLayers._free, "opening": AnswerLayers._opening, "reach": AnswerLayers._reach,
    "importance": AnswerLayers._importance, "tolerance": AnswerLayers._tolerance,
}  # fmt: skip
