"""A plan as one file that any browser plays, without a server and without a network."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import InputError, write_atomic
from momapos.model.records import PlacementPlan
from momapos.model.robots import Robot
from momapos.model.scene import Scene

from .cameras import look_at
from .map_layers import draw_path
from .playback import RATE, Playable, Story
from .robot_view import RobotView
from .room_view import RoomView
from .serve import open_server, quiet

if TYPE_CHECKING:
    from jaxtyping import Float

ENDINGS = (".html", ".htm")
REST = 1.5
"""The last moment stays for so long before it begins again [s]."""
SPEED = 2.0
"""How many times faster than in truth it plays [-]."""


def check_page(path: Path) -> None:
    """Make sure before the work that a page can be written there.

    Raises:
        InputError: Its ending is none of a page, or it is a folder.
    """
    if path.suffix.lower() not in ENDINGS:
        raise InputError(f"{path}: a page ends in {' or '.join(ENDINGS)}; name it so")
    if path.is_dir():
        raise InputError(f"{path}: cannot be written (it is a folder)")


def write_page(
    scene: Scene,
    robot: Robot,
    plan: PlacementPlan,
    path: Path,
    *,
    story: Playable | None = None,
    active: str | None = None,
) -> None:
    """Write a solved plan as a page that plays it over and over.

    Args:
        scene: The room as it is before the task.
        robot: The robot of the plan.
        plan: The plan.
        path: An HTML file; its folder is made if it does not exist.
        story: What came of it, where that is to be shown instead.
        active: What moves then; by default the object of the plan.

    Raises:
        InputError: The plan is not solved, or the file cannot be written.
    """
    check_page(path)
    content = page_of(scene, robot, plan, story, active)
    try:
        write_atomic(path, content.encode())
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from error


def page_of(
    scene: Scene,
    robot: Robot,
    plan: PlacementPlan,
    story: Playable | None = None,
    active: str | None = None,
) -> str:
    """The page as HTML; see `write_page`."""
    story = story or Story.of(plan, robot, scene)
    server = open_server("127.0.0.1", 0)  # viser records only what a server has drawn
    try:
        look_at(server, scene)
        room, machine = RoomView(server.scene), RobotView(server.scene)
        room.show(scene, active or plan.task.object)
        first = story.at(0.0)
        machine.show(robot, first.base)
        machine.verdict("feasible")
        if plan.base_path is not None:
            draw_path(server.scene, "/way", plan.base_path)
        recording = server.get_scene_serializer()
        for seconds in _times(story.duration):
            story.at(seconds).show(room, machine)
            recording.insert_sleep(1.0 / RATE)
        recording.insert_sleep(REST)
        html: str = recording.as_html()
    finally:
        with quiet():
            server.stop()
    return html


def _times(duration: float) -> Sequence[float]:
    """The moments that are recorded [s]."""
    times: Float[np.ndarray, " t"] = np.arange(0.0, duration, SPEED / RATE)
    return [*times.tolist(), duration]
