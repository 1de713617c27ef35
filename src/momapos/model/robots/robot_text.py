"""Text of a derived robot file."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.urdf import Mimic

from .amended_urdf import AddedFrame, Mount
from .gripper_guess import GripperGeometry, listed
from .robot import ASSUMED_FORCE
from .robot_file import VERSION

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass(frozen=True, eq=False)
class ArmText:
    """Content of a robot file for one arm."""

    joints: tuple[str, ...]
    tool_link: str
    gripper_links: tuple[str, ...]
    home: Float[np.ndarray, " n"]
    grip: GripperGeometry
    grips: str
    force: float | None
    """[N]; None if assumed."""


@dataclass(frozen=True, eq=False)
class RobotText:
    """Content of a derived robot file."""

    name: str
    urdf: str
    srdf: str
    """"" if the file names none."""
    base_link: str
    footprint: Float[np.ndarray, "k 2"]
    drive: str
    min_turning_radius: float
    """Of a car-like base [m]."""
    arms: Mapping[str, ArmText]
    """By name; a single arm is named ""."""
    rest: Mapping[str, float]
    coupled: Mapping[str, Mimic]
    frames: Sequence[AddedFrame]
    mount: Mount | None
    visual_hulls: bool
    mount_urdf: str
    packages: Mapping[str, str]

    def text(self) -> str:
        """Return the robot file. Names come from an XML file, so all strings are quoted."""
        one = self.arms.get("")
        corners = ", ".join(listed(corner) for corner in self.footprint)
        lines = [
            "# Derived by 'momapos robot check'; see docs/robots.md for every key.",
            f"version = {VERSION}",
            f"name = {quoted(self.name)}",
            key("urdf", self.urdf),
            *([key("srdf", self.srdf)] if self.srdf else []),
            *(["visual_hulls = true"] if self.visual_hulls else []),
            f"base_link = {quoted(self.base_link)}",
            *([] if one is None else _arm(one)),
            "",
            "[base]",
            f"footprint = [{corners}]",
            f"drive = {quoted(self.drive)}",
            *self._radius(),
            "max_speed = 0.5",
            "max_yaw_rate = 1.0",
            "max_acceleration = 0.5",
            "max_yaw_acceleration = 1.0",
        ]
        if one is not None:
            lines += ["", "[tool]", *_tool(one)]
        for name, arm in self.arms.items() if one is None else ():
            lines += ["", f"[arms.{quoted(name)}]", *_arm(arm)]
            lines += ["", f"[arms.{quoted(name)}.tool]", *_tool(arm)]
        lines += self._tables()
        return "\n".join(lines) + "\n"

    def _radius(self) -> list[str]:
        radius = math.ceil(1000 * self.min_turning_radius) / 1000  # rather too large
        return [f"min_turning_radius = {radius:g}"] if self.drive == "car" else []

    def _tables(self) -> list[str]:
        """Return the tables with additions to the URDF and nonzero rest values."""
        lines: list[str] = []
        if self.rest:
            lines += ["", "[rest]"]
            lines += [f"{quoted(name)} = {value:.7g}" for name, value in self.rest.items()]
        if self.coupled:
            lines += ["", "[coupled]"]
            lines += [
                f"{quoted(name)} = {{ joint = {quoted(m.joint)}, ratio = {m.ratio:.9g}, "
                f"offset = {m.offset:.9g} }}"
                for name, m in self.coupled.items()
            ]
        if self.mount is not None:
            place = f"xyz = {listed(np.array(self.mount.xyz))}"
            lines += ["", "[mount]"]
            if self.mount.box is not None:
                lines += [f"box = {listed(np.array(self.mount.box))}"]
            else:
                lines += [key("urdf", self.mount_urdf)]
                lines += [key("link", self.mount.link)] if self.mount.link else []
            lines += [place, f"rpy = {listed(np.array(self.mount.rpy))}"]
        for frame in self.frames:
            lines += ["", f"[frames.{quoted(frame.name)}]", key("parent", frame.parent)]
            lines += [f"xyz = {listed(np.array(frame.xyz))}"]
            lines += [f"rpy = {listed(np.array(frame.rpy))}"] if any(frame.rpy) else []
        if self.packages:
            lines += ["", "[packages]"]
            lines += [f"{quoted(name)} = {quoted(path)}" for name, path in self.packages.items()]
        return lines


def key(name: str, value: str) -> str:
    """Return a line of a robot file."""
    return f"{name} = {quoted(value)}"


def quoted(value: str) -> str:
    """Return a TOML string."""
    return json.dumps(value, ensure_ascii=False)


def _names(values: Sequence[str]) -> str:
    return f"[{', '.join(map(quoted, values))}]"


def _arm(arm: ArmText) -> list[str]:
    return [
        key("tool_link", arm.tool_link),
        f"arm_joints = {_names(arm.joints)}",
        f"gripper_links = {_names(arm.gripper_links)}",
        f"home = {listed(arm.home)}",
    ]


def _tool(arm: ArmText) -> list[str]:
    force = f"# force = {ASSUMED_FORCE:g}    # of each finger, or pull of a suction cup [N];"
    return [
        f"approach_axis = {listed(arm.grip.approach)}",
        f"closing_axis = {listed(arm.grip.closing)}",
        f"opening = {arm.grip.opening:g}",
        f"grips = {quoted(arm.grips)}",
        f"{force} assumed by default" if arm.force is None else f"force = {arm.force:g}",
    ]
