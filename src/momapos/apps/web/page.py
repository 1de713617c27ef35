"""The page: what all browsers see, and the work behind it.

There is one state, and every browser shows it: what one changes the others see, and a reload shows
where things stand. What is loaded and answered is changed by one thread, that of `work`; the base
that is dragged, the layers and the files have threads of their own. In each the newest request
wins, and draws what it finds itself.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from momapos.core import Cache, Clock
from momapos.model.robots import Robot
from momapos.model.scene import Scene, load_scene

from .answer_layers import AnswerLayers
from .answer_view import READY, AnswerView
from .browsers import Browsers
from .cameras import look_at
from .compare import Compare
from .extras import Extras
from .follow import Follow
from .light import Light
from .motion_view import MotionView
from .moving import Moving
from .opened import Opened, OpenedScan
from .panel import Panel
from .question import Machine, Machines, Question, ask, ask_at, targets
from .robot_view import RobotView
from .room_view import RoomView
from .scan_view import COARSE, FINE, ScanView
from .settled import Settled
from .state import Choice, Shown
from .words import answer_words, escaped
from .work import Latest

if TYPE_CHECKING:
    from viser import ViserServer


LOG = logging.getLogger(__name__)


class Page:
    """One state for all browsers."""

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
        """Build the page, and load the scene and the robot behind it.

        Args:
            server: Serves it.
            scenes: Names or files of the scenes that may be chosen.
            robots: Likewise of the robots.
            scene: The one that is shown first.
            robot: Likewise.
            cache: Where geometry and maps are kept.
            folder: Where files are saved.
            opened: A plan, run or scan that is shown first; its scene is among those that may be
                chosen.
        """
        self.server, self._cache, self.folder = server, cache, folder
        self._machines = Machines(cache)
        self._start: tuple[float, float, float] | None = None
        self._opened = opened
        self.shown = Shown()
        self.drawing = threading.RLock()
        """Held while what is drawn is changed, and while it is looked at whether it still should
        be: several threads draw."""
        self.settled = Settled()
        self.room = RoomView(server.scene, self._pick)
        self.robot = RobotView(server.scene, dragged=lambda event: self.follow.dragged(event))
        self.motion = MotionView(self)
        self.panel = Panel(server.gui, self, scenes=scenes, robots=robots, scene=scene, robot=robot)
        self._told = 0.0
        self.light = Light(server.scene, self.panel)
        self.extras = Extras(self)
        self.compare = Compare(self)
        self.scan = ScanView(server.scene, self.panel)
        self.moving = Moving(
            server,
            fine=FINE,
            coarse=COARSE,
            wanted=lambda: self.scan.many and not self.extras.work.busy,
        )
        self.answer = AnswerView(self)
        self.layers = AnswerLayers(
            server.scene, self.panel, self.robot, self.drawing, self.answer.measured
        )
        self.work = Latest("page work", self.fail)
        self.follow = Follow(self)
        self.browsers = Browsers(server, self._stop_if_busy)
        if isinstance(opened, Opened):
            self._open(opened)
        else:
            self.change()

    def close(self) -> None:
        """End all work."""
        self.browsers.close()
        self.settled.close()
        self.motion.pause()
        self.work.close()
        self.follow.work.close()
        self.layers.close()
        self.extras.close()

    # --------------------------------------------------------------------------- what is asked

    @property
    def choice(self) -> Choice:
        """What the controls say."""
        panel = self.panel
        question = Question(
            panel.verb.value, panel.target.value, panel.to.value, panel.method.value,
            int(panel.seed.value), self._start,
        )  # fmt: skip
        return Choice(panel.scene.value, panel.robot.value, panel.arm.value, question)

    def change(self) -> None:
        """Something else is chosen: load and draw it; what runs is for nothing."""

        def work(clock: Clock) -> None:
            drawn = self.shown.question
            _, _, question = self._update(clock)
            if question == drawn and self.shown.answer is not None:
                self.tell(answer_words(self.shown.answer))
            elif question == drawn:
                self.tell(READY)

        self._request(work)

    def _open(self, opened: Opened) -> None:
        """Show a plan from a file."""
        question = opened.question

        def work(clock: Clock) -> None:
            self.panel.verb.value = question.verb
            self.panel.method.value, self.panel.seed.value = question.method, question.seed
            self._update(clock)
            self.panel.offer(self.panel.target, self.panel.target.options, question.target)
            self.panel.to.value = question.to
            self._start = question.start
            _, machine, _ = self._update(clock)
            answer = opened.answer()
            if answer is not None:
                self.answer.show(answer, machine)
            if opened.words:
                self.motion.load(opened.story(), at_end=False)
                self.tell(opened.words)

        self._request(work)

    def place(self) -> None:
        """Answer the question."""

        def work(clock: Clock) -> None:
            scene, machine, question = self._update(clock)
            self.tell("**Searching**")
            self.answer.show(ask(scene, machine, question, clock, self._tell_stage), machine)

        self._request(work)

    def place_here(self) -> None:
        """Answer how it is done from where the robot stands."""
        base = self.robot.base.copy()

        def work(clock: Clock) -> None:
            scene, machine, question = self._update(clock)
            robot = self.arm_of(machine)
            self.tell("**Planning from here**")
            self.answer.show(
                ask_at(scene, robot, machine.reach_of(robot.arm), question, base, clock), machine
            )

        self._request(work)

    def stop(self) -> None:
        """End what runs."""
        self.work.stop()
        self.follow.work.stop()
        self.layers.stop()
        self.extras.work.stop()
        self.motion.pause()
        self.panel.result.content = "Stopped."

    def start_here(self) -> None:
        """The robot starts where it stands now."""
        x, y, yaw = self.robot.base.tolist()
        self._start = (x, y, yaw)
        self.change()

    def start_of_scene(self) -> None:
        """The robot starts where the scene says."""
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

    def tell(self, words: str) -> None:
        self.panel.result.content = words

    def _tell_stage(self, stage: str) -> None:
        now = time.perf_counter()
        if now - self._told > 0.1:  # a search names its stages a thousand times a second
            self._told = now
            self.tell(f"**Searching**: {escaped(stage)}")

    def fail(self, reason: str) -> None:
        LOG.warning("momapos: %s", reason)
        self.panel.result.content = f"**It cannot be done so.** {escaped(reason)}"

    # ------------------------------------------------------------------------- what is loaded

    def _update(self, clock: Clock) -> tuple[Scene, Machine, Question]:
        """Load and draw what is chosen, where it is not shown already."""
        choice, shown = self.choice, self.shown
        fresh = shown.scene_name != choice.scene
        if fresh:
            self.tell(f"Loading {escaped(choice.scene)}.")
            shown.scene, shown.scene_name = self._load(choice.scene, clock), ""
            self._start = None
        scene = shown.scene
        assert scene is not None
        target = self.panel.offer(
            self.panel.target, targets(scene, choice.question.verb), choice.question.target
        )
        clock()
        name = (choice.robot, choice.arm)
        if shown.machine_name != name:
            self.tell(f"Loading {escaped(choice.robot)}.")
            machine = self._machine(choice, clock)
            shown.machine, shown.machine_name = machine, (choice.robot, self.panel.arm.value)
            fresh = True
        assert shown.machine is not None
        question = Question(**{**vars(self.choice.question), "target": target})
        if fresh or shown.question != question:
            self.answer.ask(scene, shown.machine, question, fresh=fresh)
            shown.scene_name = choice.scene
        return scene, shown.machine, question

    def _load(self, name: str, clock: Clock) -> Scene:
        opened = self._opened if self._opened is not None and name == self._opened.name else None
        if isinstance(opened, OpenedScan):
            scene = opened.load(clock, lambda words: self.tell(escaped(words)))
            self.scan.show(opened.modeled)
            return scene
        self.scan.show(None)
        return load_scene(name, cache=self._cache) if opened is None else opened.scene

    def _machine(self, choice: Choice, clock: Clock) -> Machine:
        """The robot that is chosen; of another robot than the last all arms are taken."""
        other = self.shown.machine_name[0] != choice.robot
        arm = "any" if other else choice.arm
        machine = self._machines.load(choice.robot, arm, clock, self.tell)
        names = ("any", *machine.arms[0].arms)
        self.panel.offer(self.panel.arm, names, arm)
        self.panel.arm.disabled = len(names) == 1
        return machine

    def arm_of(self, machine: Machine) -> Robot:
        """The arm that is drawn, which is the one that was last answered for."""
        robot = self.robot.robot
        return robot if robot in machine.arms else machine.arms[0]

    # -------------------------------------------------------------------- clicks and browsers

    def look_at_room(self) -> None:
        """Turn the cameras back to the whole room."""
        if self.shown.scene is not None:
            look_at(self.server, self.shown.scene)

    def _pick(self, name: str) -> None:
        """An object is clicked: ask about it."""
        scene = self.shown.scene
        if scene is None:
            return
        options = targets(scene, self.panel.verb.value)
        own = [option for option in options if option.partition("/")[0] == name]
        if own and self.panel.target.value not in own:
            self.panel.target.value = own[0]
            self.change()

    def _stop_if_busy(self) -> None:
        """Nobody looks any more."""
        works = (self.work, self.follow.work, self.layers, self.extras.work)
        if self.motion.player.playing or any(one.busy for one in works):
            self.stop()
