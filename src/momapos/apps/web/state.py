"""What the user has chosen, what the page shows, and what all views share."""

from __future__ import annotations

import logging
import threading
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from momapos.model.robots import Robot
from momapos.model.scene import Scene
from momapos.planning import PlacementResult, Tour
from momapos.workflows.scene_check import SceneReport

from .card import Card
from .panel import Panel
from .playback import Playable
from .probe import Probe
from .question import Question, RobotArms
from .robot_view import RobotView
from .room_view import RoomView

if TYPE_CHECKING:
    from viser import ViserServer

LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class Choice:
    """What the controls of a task are set to."""

    scene: str
    robot: str
    arm: str
    question: Question


@dataclass
class Shown:
    """What is loaded and drawn.

    The thread that answers questions changes it. Layers add what they measure of an answer later.
    """

    scene_name: str = ""
    scene: Scene | None = None
    check: SceneReport | None = None
    """What is wrong in the scene."""
    robot_name: tuple[str, str] = ("", "")
    """Robot and arm."""
    arms: RobotArms | None = None
    question: Question | None = None
    tour: Tour | None = None
    """The answer: a task, or several."""
    story: Playable | None = None
    probe: Probe | None = None
    joints: dict[str, float] = field(default_factory=dict)
    """Joints of the object that a user has moved, and the others at that time [rad] or [m]."""

    @property
    def answer(self) -> PlacementResult | None:
        """The task of the answer whose layers are drawn: the first one, or the one that fails."""
        if self.tour is None:
            return None
        return self.tour.steps[0 if self.tour.steps[-1].plan.feasible else -1]

    @property
    def target(self) -> str:
        """The object of the question; "" without a question."""
        return "" if self.question is None else self.question.target.partition("/")[0]

    @property
    def joint(self) -> str | None:
        """The joint of the question; None without one."""
        return None if self.question is None else self.question.target.partition("/")[2] or None


@dataclass(frozen=True)
class PageState:
    """The server, the controls, the drawings and what is shown; each view depends on this only."""

    server: ViserServer
    panel: Panel
    room: RoomView
    robot: RobotView
    shown: Shown = field(default_factory=Shown)
    drawing: AbstractContextManager[Any] = field(default_factory=threading.RLock)
    """Held by a thread while it checks that its request is still current, and draws."""

    def show(self, card: Card) -> None:
        """Show a result."""
        self.panel.card.show(card)

    def fail(self, reason: str) -> None:
        """Show and log an error."""
        LOG.warning("momapos: %s", reason)
        self.show(Card("Error", "bad", notes=(reason,)))

    def show_room(self) -> None:
        """Draw the room of the question, which differs from the one of a later task of a tour."""
        if self.shown.scene is not None:
            collision = bool(self.panel.layers["collision"].value)
            self.room.show(
                self.shown.scene, self.shown.target, self.shown.joint, collision=collision
            )

    def arm_of(self, arms: RobotArms) -> Robot:
        """Return the arm that is drawn, which is the one of the last answer; else the first."""
        robot = self.robot.robot
        return robot if robot in arms.robots else arms.robots[0]
