"""The robot record, read from a TOML file beside a URDF."""

from __future__ import annotations

import difflib
import math
import os
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from momapos.cache import Cache
from momapos.errors import FileFormatError, RobotError, unknown_name
from momapos.geometry.transforms import apply, invert
from momapos.kinematics.articulated import Articulated
from momapos.kinematics.chain import Chain, Segments, build_chain
from momapos.kinematics.hulls import Boxes
from momapos.kinematics.ik import IkModel, build_ik
from momapos.kinematics.kept import once
from momapos.kinematics.spheres import Spheres, build_spheres
from momapos.kinematics.urdf import read_urdf
from momapos.robots.names import find_robot

if TYPE_CHECKING:
    from jaxtyping import Float

MAX_TOML_BYTES = 1_000_000
Drive = Literal["differential", "omni"]


@dataclass(frozen=True)
class Robot:
    """A mobile base with one arm and one tool."""

    name: str
    path: Path
    """The TOML file."""
    model: Articulated
    base_link: str
    """Stands on the floor, x forward."""
    tool_link: str
    arm_joints: tuple[str, ...]
    """Base to tool; a torso comes first."""
    gripper_links: tuple[str, ...]
    home: Float[np.ndarray, " n"]
    """Where the arm is while the base drives."""
    footprint: Float[np.ndarray, "k 2"]
    """Convex outline of the base in its own frame, anticlockwise [m]."""
    drive: Drive
    max_speed: float
    max_yaw_rate: float
    max_acceleration: float
    max_yaw_acceleration: float
    approach_axis: Float[np.ndarray, "3"]
    """Unit vector in the tool frame along which the gripper moves onto things."""
    closing_axis: Float[np.ndarray, "3"]
    """Unit vector in the tool frame along which the fingers close."""
    opening: float
    """Widest thing that fits between the fingers [m]."""
    disabled: frozenset[frozenset[str]]
    """Pairs of links whose contact is never checked."""

    @cached_property
    def _parts(self) -> tuple[Chain, Segments]:
        return build_chain(self.model, self.base_link, self.tool_link, self.arm_joints)

    @property
    def chain(self) -> Chain:
        """The arm."""
        return self._parts[0]

    @property
    def segments(self) -> Segments:
        """Which link moves with which joint."""
        return self._parts[1]

    @cached_property
    def ik(self) -> IkModel:
        """How the arm is inverted."""
        return build_ik(self.chain)

    @cached_property
    def spheres(self) -> Spheres:
        """Collision spheres of the arm, boxes of the base."""
        return self.model.kept(
            "spheres",
            lambda: build_spheres(self.model, self.segments, self.disabled, self.gripper_links),
            (self.base_link, self.tool_link, self.arm_joints, self.gripper_links),
            sorted(sorted(pair) for pair in self.disabled),
            records=(Spheres,),
        )

    @property
    def base(self) -> Boxes:
        """The base as boxes in its own frame."""
        return self.spheres.base

    @cached_property
    def finger_depth(self) -> float:
        """How far the fingertips stick out beyond the tool's origin [m]."""
        poses = self.model.link_poses({})
        T_tool_root = invert(poses[self.tool_link])
        tips = [
            float((apply(T_tool_root @ poses[link], hull.vertices) @ self.approach_axis).max())
            for link in self.gripper_links
            for hull in self.model.hulls[link]
        ]
        return max(0.0, *tips) if tips else 0.0

    @cached_property
    def reach(self) -> float:
        """Upper bound on the distance from the first revolute axis to the tool [m]."""
        links = np.linalg.norm(self.chain.d, axis=1)
        travel = np.where(
            self.chain.prismatic, np.maximum(abs(self.chain.lower), abs(self.chain.upper)), 0.0
        )
        first = int(np.argmin(self.chain.prismatic))
        tool = float(np.linalg.norm(self.chain.tool_offset))
        return float(links[first + 1 :].sum() + travel[first + 1 :].sum()) + tool


def load_robot(source: str | Path, *, cache: Cache | None = None) -> Robot:
    """Load a robot by library name or from a TOML file.

    Args:
        source: The name or the file.
        cache: Where its geometry is kept, so that it is computed once.

    Raises:
        RobotError, FileFormatError, UnknownNameError: It cannot be used; one line says why.
    """
    return read_robot(find_robot(source), cache=cache)


def read_robot(path: Path, *, cache: Cache | None = None) -> Robot:
    """Read a robot file; docs/robots.md tells its format."""
    data = _read_toml(path)
    table = _Table(data, path)
    urdf = (path.parent / table.text("urdf")).resolve()
    model = Articulated(read_urdf(urdf, cache=cache), cache)
    base, tool = table.table("base"), table.table("tool")
    robot = Robot(
        name=table.text("name"),
        path=path,
        model=model,
        base_link=table.text("base_link"),
        tool_link=table.text("tool_link"),
        arm_joints=tuple(table.texts("arm_joints")),
        gripper_links=tuple(table.texts("gripper_links")),
        home=table.vector("home"),
        footprint=_footprint(base, path, cache),
        drive=base.choice("drive", ("differential", "omni")),  # type: ignore[arg-type]
        max_speed=base.positive("max_speed", 0.5),
        max_yaw_rate=base.positive("max_yaw_rate", 1.0),
        max_acceleration=base.positive("max_acceleration", 0.5),
        max_yaw_acceleration=base.positive("max_yaw_acceleration", 1.0),
        approach_axis=tool.unit("approach_axis"),
        closing_axis=tool.unit("closing_axis"),
        opening=tool.positive("opening", 0.08),
        disabled=read_srdf(urdf.with_suffix(".srdf")),
    )
    _check(robot)
    return robot


def _check(robot: Robot) -> None:
    chain = robot.chain
    for link in robot.gripper_links:
        if link not in robot.model.urdf.links:
            raise unknown_name("gripper link", link, robot.model.urdf.links, str(robot.path))
    if robot.home.shape != (chain.size,):
        raise RobotError(
            f"{robot.path}: home has {len(robot.home)} values, arm_joints has {chain.size}"
        )
    outside = (robot.home < chain.lower - 1e-6) | (robot.home > chain.upper + 1e-6)
    if outside.any():
        i = int(np.argmax(outside))
        raise RobotError(
            f"{robot.path}: home of {chain.names[i]!r} is {robot.home[i]:g}, its limits are "
            f"{chain.lower[i]:g} to {chain.upper[i]:g}"
        )
    if abs(float(robot.approach_axis @ robot.closing_axis)) > 1e-3:
        raise RobotError(f"{robot.path}: approach_axis and closing_axis must be perpendicular")


def read_srdf(path: Path) -> frozenset[frozenset[str]]:
    """Pairs of links that an SRDF disables; none where there is no such file."""
    if not path.is_file():
        return frozenset()
    from defusedxml import DefusedXmlException, ElementTree

    try:
        root = ElementTree.fromstring(path.read_bytes(), forbid_dtd=True)
    except (DefusedXmlException, ElementTree.ParseError) as error:
        raise RobotError(f"{path}: not a usable SRDF ({error})") from error
    pairs = [(e.get("link1"), e.get("link2")) for e in root.iter("disable_collisions")]
    return frozenset(frozenset(pair) for pair in pairs if None not in pair)  # type: ignore[misc]


def _read_toml(path: Path) -> dict[str, Any]:
    if not os.path.isfile(path):
        raise FileFormatError(f"{path}: no such robot file")
    if path.stat().st_size > MAX_TOML_BYTES:
        raise FileFormatError(f"{path}: larger than a robot file can be (1 MB)")
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise FileFormatError(f"{path}: not a robot file in TOML ({error})") from error


def _footprint(base: _Table, path: Path, cache: Cache | None) -> Float[np.ndarray, "k 2"]:
    points = base.matrix("footprint", 2)
    return once(cache, "footprint", (points,), lambda: _outline(points, path))


def _outline(points: Float[np.ndarray, "n 2"], path: Path) -> Float[np.ndarray, "k 2"]:
    from scipy.spatial import ConvexHull, QhullError

    try:
        return points[ConvexHull(points).vertices]
    except (QhullError, ValueError) as error:
        raise RobotError(
            f"{path}: base.footprint must enclose an area, as [[x, y], ...]"
        ) from error


class _Table:
    """A TOML table whose values are checked as they are taken."""

    def __init__(self, data: Mapping[str, Any], path: Path, prefix: str = "") -> None:
        self.data, self.path, self.prefix = data, path, prefix

    def _take(self, key: str) -> Any:
        if key not in self.data:
            near = difflib.get_close_matches(key, self.data, n=1)
            hint = f"; is {near[0]!r} meant to be it?" if near else ""
            raise RobotError(f"{self.path}: {self.prefix}{key} is missing{hint}")
        return self.data[key]

    def table(self, key: str) -> _Table:
        value = self._take(key)
        if not isinstance(value, dict):
            raise RobotError(f"{self.path}: [{key}] must be a table")
        return _Table(value, self.path, f"{key}.")

    def text(self, key: str) -> str:
        value = self._take(key)
        if not isinstance(value, str) or not value:
            raise RobotError(f"{self.path}: {self.prefix}{key} must be a text")
        return value

    def texts(self, key: str) -> Sequence[str]:
        value = self._take(key)
        if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
            raise RobotError(f"{self.path}: {self.prefix}{key} must be a list of names")
        return value

    def choice(self, key: str, options: Sequence[str]) -> str:
        value = self.text(key)
        if value not in options:
            raise RobotError(
                f"{self.path}: {self.prefix}{key} is {value!r}; it must be {' or '.join(options)}"
            )
        return value

    def positive(self, key: str, default: float) -> float:
        value = self.data.get(key, default)
        if (
            isinstance(value, bool)
            or not isinstance(value, int | float)
            or not (math.isfinite(value) and value > 0)
        ):
            raise RobotError(f"{self.path}: {self.prefix}{key} must be a number > 0")
        return float(value)

    def _numbers(self, key: str) -> Float[np.ndarray, "..."]:
        try:
            value = np.array(self._take(key), float)
        except (TypeError, ValueError) as error:
            raise RobotError(f"{self.path}: {self.prefix}{key} must be numbers") from error
        if not np.isfinite(value).all():
            raise RobotError(f"{self.path}: {self.prefix}{key} holds NaN or infinity")
        return value

    def vector(self, key: str) -> Float[np.ndarray, " n"]:
        value = self._numbers(key)
        if value.ndim != 1:
            raise RobotError(f"{self.path}: {self.prefix}{key} must be a list of numbers")
        return value

    def matrix(self, key: str, columns: int) -> Float[np.ndarray, "n columns"]:
        value = self._numbers(key)
        if value.ndim != 2 or value.shape[1] != columns:
            raise RobotError(f"{self.path}: {self.prefix}{key} must be rows of {columns} numbers")
        return value

    def unit(self, key: str) -> Float[np.ndarray, "3"]:
        value = self.vector(key)
        if value.shape != (3,) or np.linalg.norm(value) < 1e-9:
            raise RobotError(f"{self.path}: {self.prefix}{key} must be 3 numbers, not all zero")
        return value / np.linalg.norm(value)
