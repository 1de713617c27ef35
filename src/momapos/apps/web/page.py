"""The page: one state for all browsers, and the threads that work on it.

Every browser shows the same state. A change in one browser appears in the others, and a reload
restores it. One worker thread loads scenes and answers questions; the dragged base, the layers and
the files have threads of their own. In each thread the newest request replaces older ones.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from viser.transforms import SO3

from momapos.apps.export import CarriedObject
from momapos.core import Cache, Clock
from momapos.model.scene import Scene, load_scene
from momapos.planning import Tour
from momapos.workflows.scene_check import check_scene

from .answer_view import READY, AnswerLayers, AnswerView
from .cameras import Light, frame, look_at
from .card import WORKING, Card
from .extras import FileActions
from .motion_view import Compare, MotionView
from .opened import Opened, OpenedScan
from .panel import CLICKS, Panel, Resender, how_far
from .playback import DetailControl, values_at_end
from .probe import Probe, ProbedPose
from .question import VERBS, Question, RobotArms, RobotLoader, ask, ask_at, places, targets
from .robot_view import RobotView, home_values, joint_values
from .room_view import RoomView
from .scan_view import COARSE, FINE, ScanView
from .state import Choice, PageState
from .words import finding_card, run_card, tour_card, verdict_of
from .work import LatestWorker

if TYPE_CHECKING:
    from jaxtyping import Float
    from viser import ViserServer


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
        question = self._state.shown.question
        self._state.panel.place_here.visible = question is not None and not question.brings
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


GRACE_PERIOD = 5.0
"""Time after the last browser disconnects until work stops; a reload takes less [s]."""


class Browsers:
    """Counts the connected browsers, and reports when none is left."""

    def __init__(self, server: ViserServer, on_empty: Callable[[], None]) -> None:
        """Start to count.

        Args:
            server: The server of the page.
            on_empty: Called after the grace period without any browser.
        """
        self._on_empty = on_empty
        self._lock = threading.Lock()
        self._connected: set[int] = set()
        self._timer: threading.Timer | None = None
        server.on_client_connect(self._add)
        server.on_client_disconnect(self._remove)

    def close(self) -> None:
        """Cancel the timer."""
        with self._lock:
            if self._timer is not None:
                self._timer.cancel()

    def _add(self, client: Any) -> None:
        with self._lock:
            self._connected.add(client.client_id)

    def _remove(self, client: Any) -> None:
        with self._lock:
            self._connected.discard(client.client_id)
            if self._timer is not None:
                self._timer.cancel()
            self._timer = threading.Timer(GRACE_PERIOD, self._report)
            self._timer.daemon = True
            self._timer.start()

    def _report(self) -> None:
        with self._lock:
            empty = not self._connected
        if empty:
            self._on_empty()


INTERVAL = 0.1
"""Time between updates; a search changes its stage 1,000 times a second [s]."""


class StageCard:
    """Shows which stage runs, and how long the others have taken."""

    def __init__(self, show: Callable[[Card], None], clock: Clock) -> None:
        """Show that a search begins.

        Args:
            show: Shows a card.
            clock: Returns the time [s].
        """
        self._show, self._clock = show, clock
        self._spent: dict[str, float] = {}
        self._stage, self._began, self._shown = "", clock(), 0.0
        show(Card("Searching", progress=WORKING))

    def begin(self, stage: str) -> None:
        """Note that a stage begins, which ends the one before."""
        now = self._clock()
        if self._stage:
            self._spent[self._stage] = self._spent.get(self._stage, 0.0) + now - self._began
        self._stage, self._began = stage, now
        if now - self._shown > INTERVAL:
            self._shown = now
            stages = tuple(self._spent.items())
            self._show(Card(f"Searching: {stage}", progress=WORKING, stages=stages))


class Page:
    """Builds the views, and loads and answers what the user chooses."""

    def __init__(
        self,
        server: ViserServer,
        *,
        scenes: Sequence[str],
        robots: Sequence[str],
        scene: str,
        robot: str,
        cache: Cache,
        folder: Path,
        opened: Opened | OpenedScan | None = None,
    ) -> None:
        """Build the page, and start to load the scene and the robot.

        Args:
            server: The server of the page.
            scenes: Names or files of the scenes offered.
            robots: Names or files of the robots offered.
            scene: The scene shown first.
            robot: The robot shown first.
            cache: Cache of geometry and maps.
            folder: Where files are saved.
            opened: A plan, run or scan shown first; its scene is among `scenes`.
        """
        self.server, self._cache, self._opened = server, cache, opened
        self._loader = RobotLoader(cache)
        self._picked = ""
        """The object that a user has clicked last; it is in view."""
        self._start: tuple[float, float, float] | None = None
        self.panel = Panel(
            server.gui, Resender(), scenes=scenes, robots=robots, scene=scene, robot=robot
        )
        self.room = RoomView(server.scene, self._pick)
        self.robot = RobotView(server.scene, dragged=lambda event: self.follow.dragged(event))
        self.state = PageState(server, self.panel, self.room, self.robot)
        self.shown = self.state.shown
        self.scan = ScanView(server.scene, self.panel)
        self.detail = DetailControl(
            server,
            fine=FINE,
            coarse=COARSE,
            wanted=lambda: self.scan.many and not self.files.work.busy,
        )
        self.compare = Compare(self.state)
        self.motion = MotionView(self.state, self.compare, self.detail)
        self.light = Light(server, self.panel, self.room)
        self.layers = AnswerLayers(self.state)
        self.answer = AnswerView(self.state, self.motion, self.layers, self.light)
        self.work = LatestWorker("page work", self.state.fail)
        self.files = FileActions(self.state, self.motion, folder, lambda: self.work.busy)
        self.follow = DragFollower(self.state, self.motion, self.detail)
        self._connect()
        self.browsers = Browsers(server, self._stop_if_busy)
        if isinstance(opened, Opened):
            self._open(opened)
        else:
            self.change()

    def _connect(self) -> None:
        panel, motion = self.panel, self.motion
        for handle in panel.question:
            panel.on_change(handle, self.change)
        panel.on_click(panel.start_here, self.start_here)
        panel.on_click(panel.start_of_scene, self.start_of_scene)
        panel.on_click(panel.place, self.place)
        panel.on_click(panel.place_here, self.place_here)
        panel.on_click(panel.stop, self.stop)
        panel.on_change(panel.furniture, lambda: self.room.set_visible(panel.furniture.value))
        panel.on_change(panel.layers["collision"], self.answer.change_look)
        panel.on_key("Place", "P", self.place)
        panel.on_key("Stop", "X", self.stop)
        panel.on_key("Play or pause", "space", motion.toggle)
        # The space bar activates what has the focus, such as the tab that was clicked last.
        panel.on_key("Play or pause (second key)", "K", motion.toggle)
        panel.on_key("Back 1 s", "J", lambda: motion.step(-1.0))
        panel.on_key("Forward 1 s", "L", lambda: motion.step(1.0))
        panel.on_key("Show the whole room", "H", self.look_at_room)
        panel.on_key("Show robot and task", "F", self.look_at_task)

    def close(self) -> None:
        """End all work."""
        self.browsers.close()
        self.panel.resender.close()
        self.motion.pause()
        self.work.close()
        self.follow.work.close()
        self.layers.close()
        self.files.work.close()

    # ------------------------------------------------------------------------------- the question

    @property
    def choice(self) -> Choice:
        """What the controls are set to."""
        panel = self.panel
        question = Question(
            panel.verb.value, panel.target.value, panel.to, panel.method.value,
            int(panel.seed.value), self._start,
        )  # fmt: skip
        return Choice(panel.scene.value, panel.robot.value, panel.arm.value, question)

    def change(self) -> None:
        """Load and draw what the controls are set to; cancel running work."""

        def work(clock: Clock) -> None:
            drawn = self.shown.question
            _, _, question = self._update(clock)
            if question == drawn and self.shown.tour is not None:
                self.state.show(tour_card(self.shown.tour))
            elif question == drawn:
                self.state.show(READY)

        self._request(work)

    def _open(self, opened: Opened) -> None:
        question = opened.question

        def work(clock: Clock) -> None:
            if question.verb in VERBS:
                self.panel.verb.value = question.verb
            self.panel.method.value, self.panel.seed.value = question.method, question.seed
            self._update(clock)
            self.panel.offer(self.panel.target, self.panel.target.options, question.target)
            self._update(clock)
            self.panel.show_to(question.to)
            self._start = question.start
            _, arms, _ = self._update(clock)
            answer = opened.answer()
            if answer is not None:
                self.answer.show(answer, arms)
            if opened.run is not None:
                self.motion.load(opened.story(), at_end=False)
                self.state.show(run_card(opened.run))

        self._request(work)

    def place(self) -> None:
        """Answer the question."""

        def work(clock: Clock) -> None:
            scene, arms, question = self._update(clock)
            stages = StageCard(self.state.show, clock)
            self.answer.show(ask(scene, arms, question, clock, stages.begin), arms)

        self._request(work)

    def place_here(self) -> None:
        """Plan from the current base pose."""
        base = self.robot.base.copy()

        def work(clock: Clock) -> None:
            scene, arms, question = self._update(clock)
            robot = self.state.arm_of(arms)
            self.state.show(Card("Planning from here", progress=WORKING))
            reach = arms.reach_of(robot.arm)
            found = ask_at(scene, robot, reach, question, base, clock)
            self.answer.show(Tour((found,), (1,), scenes=(scene,)), arms)

        self._request(work)

    def stop(self) -> None:
        """Stop all running work."""
        self.work.stop()
        self.follow.work.stop()
        self.layers.stop()
        self.files.work.stop()
        self.motion.pause()
        self.state.show(Card("Stopped"))

    def start_here(self) -> None:
        """Use the current base pose as the start."""
        x, y, yaw = self.robot.base.tolist()
        self._start = (x, y, yaw)
        self.change()

    def start_of_scene(self) -> None:
        """Use the scene's start pose."""
        self._start = None
        self.change()

    def _request(self, work: Callable[[Clock], None]) -> None:
        self.motion.pause()
        self.follow.work.stop()
        self.panel.show_busy(True)

        def then(clock: Clock) -> None:
            try:
                work(clock)
            finally:
                self.panel.show_busy(False)

        self.work.put(then, stop_running=True)

    def _show_work(self, what: str, share: float = WORKING) -> None:
        self.state.show(Card(what, progress=share))

    # ------------------------------------------------------------------------- what is loaded

    def _update(self, clock: Clock) -> tuple[Scene, RobotArms, Question]:
        """Load and draw what the controls are set to, unless it is shown already."""
        choice, shown = self.choice, self.shown
        fresh = shown.scene_name != choice.scene
        if fresh:
            self._show_work(f"Loading {choice.scene}")
            shown.scene, shown.scene_name = self._load(choice.scene, clock), ""
            shown.check = check_scene(shown.scene)
            self._start = None
        scene = shown.scene
        assert scene is not None
        target = self.panel.offer(
            self.panel.target, targets(scene, choice.question.verb), choice.question.target
        )
        self.panel.offer_range(how_far(scene, choice.question.verb, target))
        self.panel.offer_places(places(scene, target) if choice.question.brings else ())
        clock()
        if shown.robot_name != (choice.robot, choice.arm):
            self._show_work(f"Loading {choice.robot}")
            arms = self._load_robot(choice, clock)
            shown.arms, shown.robot_name = arms, (choice.robot, self.panel.arm.value)
            fresh = True
        assert shown.arms is not None
        question = replace(self.choice.question, target=target)
        if fresh or shown.question != question:
            name = target.partition("/")[0]
            other = name not in (shown.target, self._picked)
            self.answer.ask(scene, shown.arms, question, fresh=fresh, turn=other)
            shown.scene_name = choice.scene
        return scene, shown.arms, question

    def _load(self, name: str, clock: Clock) -> Scene:
        opened = self._opened if self._opened is not None and name == self._opened.name else None
        if isinstance(opened, OpenedScan):
            scene = opened.load(clock, self._show_work)
            self.scan.show(opened.modeled)
            return scene
        self.scan.show(None)
        return load_scene(name, cache=self._cache) if opened is None else opened.scene

    def _load_robot(self, choice: Choice, clock: Clock) -> RobotArms:
        """Load the chosen robot; all its arms if it differs from the last one."""
        other = self.shown.robot_name[0] != choice.robot
        arm = "any" if other else choice.arm
        arms = self._loader.load(choice.robot, arm, clock, self._show_work)
        names = ("any", *arms.robots[0].arms)
        self.panel.offer(self.panel.arm, names, arm)
        self.panel.arm.disabled = len(names) == 1
        self.panel.arm.visible = len(names) > 2
        return arms

    # -------------------------------------------------------------------- clicks and browsers

    def look_at_room(self) -> None:
        """Turn all cameras to the whole room."""
        if self.shown.scene is not None:
            look_at(self.server, self.shown.scene)

    def look_at_task(self) -> None:
        """Turn all cameras to the robot and the object of the task."""
        if self.shown.scene is not None and self.shown.question is not None:
            base = self.robot.base[None]
            frame(self.server, self.shown.scene, self.shown.question.target, base)

    def _pick(self, name: str, point: Float[np.ndarray, "3"] | None) -> None:
        """Select the object, or the place for it, that a user clicks."""
        scene, panel = self.shown.scene, self.panel
        if scene is None:
            return
        if panel.clicks.visible and panel.clicks.value == CLICKS[1]:
            if point is not None and name != panel.target.value:
                panel.click_place(point)
                self.change()
            return
        options = targets(scene, self.panel.verb.value)
        own = [option for option in options if option.partition("/")[0] == name]
        if own and self.panel.target.value not in own:
            self.panel.target.value, self._picked = own[0], name
            self.panel.clicks.value = CLICKS[1]
            self.panel.guide.done("choose")
            self.change()

    def _stop_if_busy(self) -> None:
        """Stop all work after the last browser has disconnected."""
        works = (self.work, self.follow.work, self.layers, self.files.work)
        if self.motion.player.playing or any(one.busy for one in works):
            self.stop()
