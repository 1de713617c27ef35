"""Drawing a question and its answer: room, robot, motion, layers and their legend."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.apps import plots
from momapos.core import Clock, InputError, escape_markdown
from momapos.model.records import ReachScorer
from momapos.model.scene import Scene
from momapos.planning import PlacementResult, Tour, opening_map, with_tolerance
from momapos.planning.grasps import hand_path, in_front_of_parts
from momapos.planning.importance import rank

from . import colors
from . import map_layers as draw
from .cameras import Light, frame
from .card import Card
from .motion_view import MotionView
from .panel import LAYERS, joint_ranges
from .playback import story_of, values_at_end
from .question import Question, RobotArms
from .robot_view import home_values, joint_values
from .state import PageState
from .words import answer_card, check_lines, tour_card
from .work import LatestWorker

if TYPE_CHECKING:
    from jaxtyping import Float


VIRIDIS, PLASMA = ("#dde318", "#21918c", "#440f5c"), ("#f0f921", "#cc4778", "#3a049a")


def legend_rows(shown: Collection[str], kinds: Sequence[str]) -> list[tuple[tuple[str, ...], str]]:
    """Return the colors of the layers that are shown, and their meanings.

    Args:
        shown: Keys of the layers.
        kinds: Kinds of outcome of the candidates that are drawn.
    """
    rows: list[tuple[tuple[str, ...], str]] = [
        ((colors.TARGET,), "object of the task"),
        ((colors.PART,), "moving part"),
        ((colors.FEASIBLE,), "feasible base pose, and its tolerance"),
        ((colors.PARTLY,), "base pose feasible in part"),
        ((colors.INFEASIBLE,), "infeasible base pose, and what is in the way"),
        ((colors.UNKNOWN,), "base pose not checked"),
        ((colors.FORCE,), "force of the hand"),
    ]
    of_layers: dict[str, list[tuple[tuple[str, ...], str]]] = {
        "path": [((colors.DRIVE,), "start and path of the base")],
        "waypoints": [((colors.TOOL,), "path of the tool, and grasps")],
        "potential": [(plots.POTENTIAL, "potential, low to high")],
        "free": [((colors.FREE,), "free area, stronger for more yaws")],
        "opening": [(VIRIDIS, "opens a little to fully")],
        "reach": [(PLASMA, "reachable from few to all directions")],
        "importance": [
            (colors.IMPORTANCE, "importance, 0 to 1"),
            *(((look.color,), f"relation: {kind}") for kind, look in plots.RELATIONS.items()),
        ],
        "spheres": [((colors.SPHERES,), "collision spheres")],
        "candidates": [
            ((kind.color,), f"candidate: {kind.name}") for kind in plots.KINDS if kind.name in kinds
        ],
    }
    return rows + [row for key, own in of_layers.items() if key in shown for row in own]


def legend(shown: Collection[str], kinds: Sequence[str]) -> str:
    """Return the legend as HTML; see `legend_rows`."""
    items = "".join(
        f"<div>{_mark(ramp)} {words}</div>" for ramp, words in legend_rows(shown, kinds)
    )
    return f'<div style="font-size:0.8em;line-height:1.5;padding:0 0.8em">{items}</div>'


def _mark(ramp: Sequence[str]) -> str:
    # The border separates dark colors from a dark page, and pale ones from a light page.
    shape = "display:inline-block;height:0.9em;vertical-align:-0.1em;border:1px solid #888"
    fill = (
        f"background:{ramp[0]};width:0.9em"
        if len(ramp) == 1
        else f"background:linear-gradient(90deg,{','.join(ramp)});width:2.2em"
    )
    return f'<span style="{shape};{fill}"></span>'


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
            tour = state.shown.tour
            if tour is None or state.shown.answer is not before:
                return
            steps = tuple(answer if one is before else one for one in tour.steps)
            state.shown.tour = replace(tour, steps=steps)
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
            shown.question, shown.tour, shown.probe = question, None, None
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

    def show(self, tour: Tour, arms: RobotArms) -> None:
        """Draw an answer.

        Args:
            tour: An answer for the scene that is shown, of one or more tasks.
            arms: The robot of the answer.
        """
        with self._state.drawing:
            self._show(tour, arms)

    def _show(self, tour: Tour, arms: RobotArms) -> None:
        state, shown = self._state, self._state.shown
        shown.tour = tour
        answer = shown.answer
        assert answer is not None
        plan, robot = answer.plan, answer.prepared.robot
        self._layers.clear()
        state.show_room()
        if state.robot.robot is not robot:
            state.robot.show(robot, state.robot.base)
            shown.probe = None
        state.room.mark(())
        story, card = None, tour_card(tour)
        if plan.motion is not None and plan.base_pose is not None:
            try:
                story = story_of([one.plan for one in tour.steps], tour.scenes, robot)
            except InputError as error:
                card = replace(card, notes=(*card.notes, f"no motion to show: {error}"))
            state.robot.move(np.array(plan.final_base_pose), joint_values(robot, plan.motion.q[-1]))
            if plan.task.joint is not None:
                state.room.move(values_at_end(answer.prepared.scene, plan.task, plan.motion))
        shown_base = plan.base_pose or plan.feasible_from
        if plan.motion is None and shown_base is not None:
            state.robot.move(np.array(shown_base), home_values(robot))
        state.robot.verdict("feasible" if plan.motion is not None else "infeasible")
        self._motion.load(story, at_end=len(tour.steps) == 1)
        self._layers.show(answer.prepared.scene, answer, arms.reach_of(robot.arm))
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
