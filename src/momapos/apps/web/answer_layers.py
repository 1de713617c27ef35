"""Which layers are drawn: made when they are first asked for, then only switched on and off."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.apps.plots import (
    BAD,
    GOOD,
    HANDLE,
    INK,
    KINDS,
    PART,
    POTENTIAL,
    RELATIONS,
    SELECTED,
    SOFT_INK,
    TARGET,
    WAYPOINT,
    potential_map,
    reach_slice,
    tool_axes,
)
from momapos.core import Clock
from momapos.model.records import ReachScorer
from momapos.model.scene import Scene
from momapos.planning import PlacementResult, opening_map, with_tolerance
from momapos.planning.grasps import hand_path
from momapos.planning.importance import rank

from . import map_layers as draw
from .panel import LAYERS, Panel
from .robot_view import VERDICTS
from .words import escaped
from .work import Latest

if TYPE_CHECKING:
    from viser import SceneApi

    from .robot_view import RobotView

ROOT = "/layers"
BESIDE = 0.4
"""The arm's reach is asked for so much farther from the base than the arm is long [m]."""
CELL = 0.06
"""Edge of a cell of the pictures on the floor [m]."""
DEAR = ("tolerance", "opening")
"""Layers that take half a second, and seconds: each has a thread of its own."""
BASES = {"feasible": "can do it from here", "partly": "only in part", "infeasible": "not from here"}
"""What the colors of the footprint say."""
VIRIDIS = ("#dde318", "#21918c", "#440f5c")


@dataclass(frozen=True)
class Answered:
    """What the layers are of."""

    scene: Scene
    answer: PlacementResult
    reach: ReachScorer


class AnswerLayers:
    """Draws the layers of one answer."""

    def __init__(
        self,
        api: SceneApi,
        panel: Panel,
        robot: RobotView,
        drawing: AbstractContextManager[Any],
        measured: Callable[[PlacementResult, PlacementResult], None],
    ) -> None:
        """Draw nothing yet.

        Args:
            api: Where to draw.
            panel: Which layers are wanted.
            robot: From which the arm's reach hangs.
            drawing: Is held while what is drawn is changed.
            measured: Is told an answer, and the same with its tolerance.
        """
        self._api, self._panel, self._robot, self._drawing = api, panel, robot, drawing
        self._measured = measured
        self._roots: dict[str, Any] = {}
        self._of: Answered | None = None
        self._kinds: tuple[str, ...] = ()
        self.work = Latest("page layers", self._fail)
        self._dear = {key: Latest(f"page {key}", self._fail) for key in DEAR}
        """For layers that take long, so that the others do not wait for them."""

    @property
    def drawn(self) -> tuple[str, ...]:
        """The layers that are drawn, seen or not."""
        with self._drawing:
            return tuple(self._roots)

    @property
    def _works(self) -> tuple[Latest, ...]:
        return (self.work, *self._dear.values())

    @property
    def busy(self) -> bool:
        """Whether a layer is computed, or waits to be."""
        return any(work.busy for work in self._works)

    def wait(self, timeout: float) -> bool:
        """Wait until all are drawn; whether that came true, each kind in time [s]."""
        return all(work.wait(timeout) for work in self._works)

    def stop(self) -> None:
        """End what is computed; what is not drawn then is when layers are next switched."""
        for work in self._works:
            work.stop()

    def close(self) -> None:
        """End all work."""
        for work in self._works:
            work.close()

    def show(self, scene: Scene, answer: PlacementResult, reach: ReachScorer) -> None:
        """Draw the layers of another answer that are switched on."""
        self.clear()
        self._of = Answered(scene, answer, reach)
        self.changed()

    def clear(self) -> None:
        """Draw nothing."""
        self.stop()
        with self._drawing:
            self._of = None
            for root in self._roots.values():
                root.remove()
            self._roots, self._kinds = {}, ()
        self._panel.legend.content = legend([], ())
        self._panel.clicked.content = ""

    def changed(self) -> None:
        """Layers were switched on or off."""
        with self._drawing:
            self._robot.show_spheres(bool(self._panel.layers["spheres"].value))
        self.work.put(lambda clock: self._update(clock, [k for k in LAYERS if k not in DEAR]))
        for key, work in self._dear.items():
            # What runs goes on where it is still wanted: it would begin anew.
            wanted = bool(self._panel.layers[key].value)
            work.put(partial(self._update, keys=(key,)), stop_running=not wanted)

    def height_changed(self) -> None:
        """The reach is asked for at another height."""
        with self._drawing:
            root = self._roots.pop("reach", None)
            if root is not None:
                root.remove()
        self.changed()

    def _fail(self, reason: str) -> None:
        self._panel.clicked.content = f"**This layer cannot be drawn.** {escaped(reason)}"

    def _update(self, clock: Clock, keys: Sequence[str]) -> None:
        """Draw those of some layers that are wanted, and hide the others."""
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

    def _draw(self, key: str, of: Answered, clock: Clock) -> None:
        """Draw a layer, and take it away again where another answer came meanwhile."""
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

    # ------------------------------------------------------------------------------- one a layer

    def _way(self, name: str, of: Answered, _: Clock) -> None:
        draw.draw_way(self._api, name, of.answer)

    def _waypoints(self, name: str, of: Answered, _: Clock) -> None:
        draw.draw_waypoints(self._api, name, of.answer)

    def _candidates(self, name: str, of: Answered, _: Clock) -> None:
        self._kinds = draw.draw_candidates(self._api, f"{name}/all", of.answer, self._clicked)

    def _potential(self, name: str, of: Answered, _: Clock) -> None:
        heat = potential_map(of.answer.prepared.geometry, of.reach, cell=CELL)
        if heat is not None and heat.value.size:
            draw.floor_image(
                self._api, f"{name}/map", draw.potential_pixels(heat), heat.extent, height=0.004
            )

    def _free(self, name: str, of: Answered, _: Clock) -> None:
        bounds = draw.whole_floor(of.scene)
        share, extent = draw.free_area(of.answer.prepared.geometry, bounds, cell=CELL)
        draw.floor_image(self._api, f"{name}/map", draw.free_pixels(share), extent, height=0.002)

    def _opening(self, name: str, of: Answered, clock: Clock) -> None:
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

    def _tolerance(self, name: str, of: Answered, clock: Clock) -> None:
        answer = with_tolerance(of.answer, clock=clock)
        self._measured(of.answer, answer)
        plan, found = answer.plan, answer.plan.tolerance
        if found is not None and found.radius and plan.base_pose is not None:
            footprint = answer.prepared.robot.footprint
            draw.draw_tolerance(self._api, name, footprint, np.array(plan.base_pose), found)

    def _reach(self, name: str, of: Answered, _: Clock) -> None:
        height = float(self._panel.height.value)
        robot = of.answer.prepared.robot
        axes = tool_axes(robot.approach_axis, robot.closing_axis)
        share, half = reach_slice(of.reach, axes, robot.reach + BESIDE, height)
        draw.floor_image(
            self._api, f"{name}/map", draw.reach_pixels(share), (-half, half, -half, half),
            height=height,
        )  # fmt: skip

    def _importance(self, name: str, of: Answered, _: Clock) -> None:
        task = of.answer.plan.task
        path = hand_path(of.scene, task.object, task.joint, task.to)
        ranked = rank(of.scene, task.object, path=path, seed=of.answer.plan.seed)
        draw.draw_importance(self._api, name, ranked)

    def _clicked(self, words: str) -> None:
        self._panel.clicked.content = f"This candidate: **{escaped(words)}**"


DRAW = {
    "way": AnswerLayers._way, "waypoints": AnswerLayers._waypoints,
    "candidates": AnswerLayers._candidates, "potential": AnswerLayers._potential,
    "free": AnswerLayers._free, "opening": AnswerLayers._opening, "reach": AnswerLayers._reach,
    "importance": AnswerLayers._importance, "tolerance": AnswerLayers._tolerance,
}  # fmt: skip


def legend(shown: list[str], kinds: tuple[str, ...]) -> str:
    """What the colors of the layers that are shown mean, as HTML."""
    rows = [(_box(TARGET), "asked about"), (_box(PART), "what moves of it"),
            (_box(BAD), "in the way")]  # fmt: skip
    rows += [(_box(VERDICTS[key]), f"base: {words}") for key, words in BASES.items()]
    if "way" in shown:
        rows += [(_box(SOFT_INK), "start"), (_box(INK), "driven path")]
    if "waypoints" in shown:
        rows += [(_box(WAYPOINT), "way of the tool"), (_box(HANDLE), "grasps")]
    if "tolerance" in shown:
        rows.append((_box(GOOD), "tolerance: base, and what it may cover"))
    if "potential" in shown:
        rows.append((_ramp(POTENTIAL), "potential, low to high"))
    if "free" in shown:
        rows.append((_box(SELECTED), "free area: the stronger, the more yaws"))
    if "opening" in shown:
        rows.append((_ramp(VIRIDIS), "opens a little, to the end"))
    if "reach" in shown:
        rows.append((_ramp(VIRIDIS), "reached from few, from all directions"))
    if "importance" in shown:
        rows.append((_ramp(("#c3cad0", SELECTED)), "importance 0 to 1"))
        rows += [(_box(look.color), kind) for kind, look in RELATIONS.items()]
    if "spheres" in shown:
        rows.append((_box(PART), "collision spheres"))
    if "candidates" in shown:
        rows += [(_box(kind.color), kind.name) for kind in KINDS if kind.name in kinds]
    items = "".join(f"<div>{mark} {words}</div>" for mark, words in rows)
    return f'<div style="font-size:0.8em;line-height:1.5;padding:0 0.8em">{items}</div>'


def _box(color: str) -> str:
    return _mark(f"background:{color};width:0.9em")


def _ramp(colors: tuple[str, ...]) -> str:
    return _mark(f"background:linear-gradient(90deg,{','.join(colors)});width:2.2em")


def _mark(style: str) -> str:
    # The border sets dark colors off from a dark page, and pale ones from a light one.
    shape = "display:inline-block;height:0.9em;vertical-align:-0.1em;border:1px solid #888"
    return f'<span style="{shape};{style}"></span>'
