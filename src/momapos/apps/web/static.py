"""A plan as one HTML file that plays in any browser, without a server or network."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import InputError, write_atomic
from momapos.model.records import PlacementPlan
from momapos.model.robots import Robot
from momapos.model.scene import Scene

from .cameras import frame
from .card import Card
from .light import DAY, DAY_INTENSITY, lamps
from .looks import LIGHT, sky
from .map_layers import draw_path
from .playback import RATE, Playable, Story
from .robot_view import RobotView
from .room_view import RoomView, large
from .serve import open_server, quiet
from .static_overlay import phases, with_overlay
from .words import plan_card, target_text

if TYPE_CHECKING:
    from jaxtyping import Float

ENDINGS = (".html", ".htm")
PAUSE_AT_END = 1.5
"""Time for which the last moment stays before the motion repeats [s]."""
CLOSE = 0.85
"""Distance of the camera relative to the one at which robot and object fit [-]."""
SPEED = 2.0
"""Playback speed, where 1 is real time [-]."""


def check_page(path: Path) -> None:
    """Check, before the work, that a page can be written to a path.

    Raises:
        InputError: The file ending is not that of a page, or the path is a folder.
    """
    if path.suffix.lower() not in ENDINGS:
        raise InputError(f"{path}: unsupported page format; use {' or '.join(ENDINGS)}")
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
    card: Card | None = None,
) -> None:
    """Write a solved plan as a page that plays it in a loop.

    Args:
        scene: The room before the task.
        robot: The robot of the plan.
        plan: The plan.
        path: An HTML file; its folder is created if needed.
        story: The motion to play; by default that of the plan.
        active: What moves, as "object" or "object/joint"; by default that of the plan.
        card: The answer in words; by default that of the plan.

    Raises:
        InputError: The plan is not solved, or the file cannot be written.
    """
    check_page(path)
    content = page_of(scene, robot, plan, story, active, card)
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
    card: Card | None = None,
) -> str:
    """Return the page as HTML; see `write_page`."""
    story = story or Story.of(plan, robot, scene)
    server = open_server("127.0.0.1", 0)  # viser records only what a server has drawn
    try:
        bases = np.array([story.at(story.duration).base])
        target = active or target_text(plan.task)
        frame(server, scene, target, bases, close=CLOSE)
        lamps(server.scene, LIGHT, plain=large(scene))
        server.scene.configure_default_lights(enabled=False, cast_shadow=False)
        server.scene.configure_environment_map(
            None if large(scene) else DAY, environment_intensity=DAY_INTENSITY
        )
        server.scene.set_background_image(sky(LIGHT), format="png")
        room, robot_view = RoomView(server.scene), RobotView(server.scene)
        name, _, joint = target.partition("/")
        room.show(scene, name, joint or None)
        robot_view.show(robot, story.at(0.0).base)
        robot_view.verdict("feasible")
        if plan.base_path is not None:
            draw_path(server.scene, "/path", plan.base_path)
        if plan.motion is not None and plan.motion.base is not None:
            draw_path(server.scene, "/base", plan.motion.base)
        recording = server.get_scene_serializer()
        words = []
        for seconds in _times(story.duration):
            moment = story.at(seconds)
            moment.show(room, robot_view)
            words.append(moment.phase)
            recording.insert_sleep(1.0 / RATE)
        recording.insert_sleep(PAUSE_AT_END)
        html: str = with_overlay(
            recording.as_html(),
            card or plan_card(plan, scene),
            phases(words, 1.0 / RATE),
            PAUSE_AT_END,
        )
    finally:
        with quiet():
            server.stop()
    return html


def _times(duration: float) -> Sequence[float]:
    times: Float[np.ndarray, " t"] = np.arange(0.0, duration, SPEED / RATE)
    return [*times.tolist(), duration]
