"""A page for one robot: move its joints, see what touches, and save the state as home."""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core import Clock, escape_markdown
from momapos.model.robots import Robot, export_robot, library_file, save_homes
from momapos.verification import LinkContact, link_contacts

from .cameras import DAY, DAY_INTENSITY, lamps, turn
from .card import Card, CardView
from .panel import JointRange, Resender, joint_range, joint_slider
from .robot_view import RobotView
from .room_view import LIGHT, link_surfaces, sky
from .serve import open_server, quiet
from .work import LatestWorker

if TYPE_CHECKING:
    from viser import ViserServer

LOG = logging.getLogger(__name__)
EYE = np.array([1.1, -1.4, 0.8])
"""Where the camera is, from the middle of the robot, as shares of its height and width [-]."""
MAX_NOTES = 12
"""Contacts that are listed [-]."""
FREE = "No links touch"


def joint_groups(arms: Sequence[Robot]) -> dict[str, tuple[JointRange, ...]]:
    """Return the joints with a slider by group: torso, arms, hand.

    The torso is what arms share, and other joints that carry an arm. Joints that carry the base,
    and those of wheels and heads, have no slider.

    Args:
        arms: The robot, once for each of its arms.
    """
    model, groups = arms[0].model, dict[str, list[str]]({"Torso": []})
    own = [joint for robot in arms for joint in robot.arm_joints]
    for robot in arms:
        shared = [joint for joint in robot.arm_joints if own.count(joint) > 1]
        groups["Torso"] = list(dict.fromkeys((*groups["Torso"], *shared)))
        groups[f"Arm {robot.arm}".rstrip()] = [j for j in robot.arm_joints if j not in shared]
    groups["Hand"] = []
    hands = {link for robot in arms for link in robot.gripper_links}
    bases = {model.joint(robot.arm_joints[0]).child for robot in arms}
    for name in model.joints:
        moved = set(model.moved_by(name))
        if name not in own and arms[0].base_link not in moved and moved & (hands | bases):
            groups["Torso" if moved & bases else "Hand"].append(name)
    values = home_of(arms)
    ranges = {
        group: (
            joint_range(model.joint(name), values.get(name, model.rest[name])) for name in names
        )
        for group, names in groups.items()
    }
    found = {group: tuple(one for one in own if one) for group, own in ranges.items()}
    return {group: own for group, own in found.items() if own}


def home_of(arms: Sequence[Robot]) -> dict[str, float]:
    """Return the joint values of all arms at home [rad] or [m]."""
    return {
        name: float(value)
        for robot in arms
        for name, value in zip(robot.arm_joints, robot.home, strict=True)
    }


def contact_card(found: Sequence[LinkContact]) -> Card:
    """Return the card that names what touches."""
    if not found:
        return Card(FREE, "good")
    notes = [contact.words for contact in found[:MAX_NOTES]]
    more = [f"and {len(found) - MAX_NOTES} more"] * (len(found) > MAX_NOTES)
    return Card(f"{len(found)} contact{'s' * (len(found) > 1)}", "bad", notes=(*notes, *more))


class RobotPage:
    """Draws a robot in the state of its sliders."""

    def __init__(self, server: ViserServer, arms: Sequence[Robot], folder: Path) -> None:
        """Show the robot at home.

        Args:
            server: The server of the page.
            arms: The robot, once for each of its arms.
            folder: Where library robots are copied to, to give them another home.
        """
        self.server, self.arms, self._folder = server, tuple(arms), folder
        self.file = arms[0].path
        """The robot file that gets the home; a copy once a library robot is saved."""
        gui, self.resender = server.gui, Resender()
        self.work = LatestWorker("robot page", self._fail)
        self.files = LatestWorker("robot page files", self._fail)
        gui.add_markdown(f"**{escape_markdown(arms[0].name)}**")
        self.card = CardView(gui)
        self.save = gui.add_button(
            "Save as home", color="blue", hint="Writes the joints of the arms into the robot file"
        )
        self.saved = gui.add_markdown("")
        self.shapes = gui.add_checkbox("Collision shapes", False)
        self.values: dict[str, float] = {}
        """The state: all joints with a slider, and those of arms without one [rad] or [m]."""
        self.sliders: dict[str, tuple[JointRange, Any]] = {}
        for group, joints in joint_groups(arms).items():
            with gui.add_folder(group):
                for joint in joints:
                    slider = joint_slider(gui, joint)
                    self.sliders[joint.name] = joint, slider
                    self.values[joint.name] = joint.value
                    self.resender.on_change(slider, partial(self.moved, joint.name))
        self.values |= home_of(arms)
        self.save.on_click(lambda _: self.save_home())
        self.resender.on_change(self.shapes, self.draw)
        self.view = RobotView(server.scene)
        self._drawing = threading.Lock()
        self._light()
        self.draw()

    def close(self) -> None:
        """End all work."""
        self.resender.close()
        self.work.close()
        self.files.close()

    def moved(self, name: str) -> None:
        """Move a joint to where its slider is."""
        joint, slider = self.sliders[name]
        self.values[name] = joint.from_slider(float(slider.value))
        self._update()

    def draw(self) -> None:
        """Draw the links again: as they look, or the shapes that are checked."""
        with self._drawing:
            self.view.show(self.arms[0], np.zeros(3), collision=bool(self.shapes.value))
        self._update()

    def save_home(self) -> None:
        """Write the state of the arms into the robot file; copy that of a library robot first."""
        homes = {robot.arm: [self.values[name] for name in robot.arm_joints] for robot in self.arms}

        def work(_: Clock) -> None:
            name = self.arms[0].name
            if self.file == library_file(name):
                files = export_robot(name, self._folder / f"my_{name}")
                self.file = next(file for file in files if file.name == f"{name}.toml")
            save_homes(self.file, homes)
            text = f"Home is written to {self.file}. Test it: momapos robot check {self.file}"
            self.saved.content = escape_markdown(text)

        self.files.put(work)

    def _update(self) -> None:
        values = dict(self.values)
        with self._drawing:
            self.view.move(None, values)

        def work(_: Clock) -> None:
            found = link_contacts(self.arms[0], values)
            with self._drawing, self.server.atomic():
                self.view.mark({link for contact in found for link in contact.links})
                self.card.show(contact_card(found))

        self.work.put(work)

    def _fail(self, reason: str) -> None:
        LOG.warning("momapos: %s", reason)
        self.saved.content = f"**Error:** {escape_markdown(reason)}"

    def _light(self) -> None:
        api, model = self.server.scene, self.arms[0].model
        api.configure_default_lights(enabled=False, cast_shadow=False)
        api.set_background_image(sky(LIGHT), format="png")
        api.configure_environment_map(DAY, environment_intensity=DAY_INTENSITY)
        lamps(api, LIGHT, plain=False)
        api.add_grid("/floor", plane="xy", cell_size=0.1, section_size=1.0)
        poses = model.link_poses(self.values)
        points = np.concatenate([
            link.body.moved(poses[link.link]).vertices for link in link_surfaces(model)
        ])  # fmt: skip
        middle = (points.min(0) + points.max(0)) / 2
        size = float(np.ptp(points, axis=0).max())
        turn(self.server, middle + size * EYE, middle)


@contextmanager
def served_robot(
    arms: Sequence[Robot], folder: Path, host: str, port: int
) -> Iterator[tuple[RobotPage, str]]:
    """Serve the page of a robot while the context lasts.

    Args:
        arms, folder: As for `RobotPage`.
        host: Address to listen on.
        port: Port; 0 for a free one.

    Yields:
        The page, and its URL.

    Raises:
        InputError: The port is in use, or the address does not belong to this machine.
    """
    server = open_server(host, port)
    page = RobotPage(server, arms, folder)
    try:
        yield page, f"http://{host}:{server.get_port()}"
    finally:
        page.close()
        with quiet():
            server.stop()
