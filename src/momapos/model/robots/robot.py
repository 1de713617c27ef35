"""The robot record, read from a TOML file beside a URDF."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from momapos.core import Cache, RobotError, UnknownNameError, unknown_name
from momapos.core.geometry import apply, invert
from momapos.model.collision import LinkHulls, Spheres, arm_spheres
from momapos.model.kinematics import Chain, IkModel, Segments, build_chain, build_ik, fine_ik
from momapos.model.urdf import Articulated, Boxes, once

from .file_values import Table
from .gripper_guess import FINGER, HAND
from .robot_names import find_robot, library_file
from .robot_tables import (
    ANY,
    amendments_of,
    arm_tables,
    at_rest,
    beside,
    check_version,
    choose_arms,
    read_table,
    srdf_of,
)
from .srdf import read_srdf

if TYPE_CHECKING:
    from jaxtyping import Float

MAX_OUTLINE = 1_000
"""Corners of a footprint [-]."""
MAX_REACH = 5.0
"""Reach of an arm [m]; maps and grids grow with its cube."""
Drive = Literal["differential", "omni"]
ASSUMED_FORCE, ASSUMED_OPENING = 60.0, 0.08
"""Closing force of a finger [N] and opening [m] of a gripper whose file does not say."""


class Grip(StrEnum):
    """What a tool holds things with; the words stand in robot files."""

    FINGERS = "fingers"
    """Fingers that close."""
    SUCTION = "suction"
    """A cup, or a magnet: it holds what it touches."""
    HOOK = "hook"
    """A stiff finger that pulls from behind."""


@dataclass(frozen=True, eq=False)
class Robot:
    """A mobile base with one arm and one tool; one is equal to itself alone."""

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
    """Convex outline of the base in its own frame, counterclockwise [m]."""
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

    srdf: Path | None = None
    """The file that names those pairs; None where there is none."""
    grips: Grip = Grip.FINGERS
    """What the tool holds with."""
    grip_force: float = ASSUMED_FORCE
    """Closing force of each finger, or pull of a suction cup [N]."""
    assumed: tuple[str, ...] = ()
    """What the robot's file leaves out about the gripper, and what is taken instead, in words."""
    arm: str = ""
    """Which of its arms this is; empty where it has one."""
    arms: tuple[str, ...] = ()
    """Names of all its arms; none where it has one. The others rest at their homes."""
    other_arms: tuple[str, ...] = ()
    """Joints of the other arms."""
    payload: float | None = None
    """What the arm can carry [kg]; None where the file does not say."""
    amended: str | None = None
    """The URDF with what the robot file adds to it, meshes by absolute names; None where it is used
    as it is."""

    @property
    def source(self) -> str:
        """What `load_robot` finds it by: its name in the library, or the path of its file."""
        return self.name if self.path == library_file(self.name) else str(self.path)

    @property
    def title(self) -> str:
        """Its name, and which arm this is where it has several."""
        return f"{self.name}, arm {self.arm}" if self.arm else self.name

    def __repr__(self) -> str:
        arm = f" ({self.arm})" if self.arm else ""
        joints = f"{len(self.arm_joints)} arm joints"
        return f"<Robot {self.name!r}{arm}: {joints}, {self.drive}, {self.path}>"

    @cached_property
    def _parts(self) -> tuple[Chain, Segments]:
        return build_chain(self.model, self.base_link, self.tool_link, self.arm_joints)

    @property
    def chain(self) -> Chain:
        """The arm."""
        return self._parts[0]

    @property
    def moved_joints(self) -> tuple[str, ...]:
        """The joints of the arm and those that follow them, base to tool: what a plan names."""
        return self.chain.joints

    @property
    def segments(self) -> Segments:
        """Which link moves with which joint."""
        return self._parts[1]

    @cached_property
    def ik(self) -> IkModel:
        """How the arm is inverted."""
        return build_ik(self.chain)

    @cached_property
    def finer(self) -> Robot:
        """The same robot with inverse kinematics that overlooks less and takes longer."""
        ik, finer = fine_ik(self.chain), copy(self)
        vars(finer)["ik"] = ik
        return finer

    @cached_property
    def spheres(self) -> Spheres:
        """Collision spheres of the arm, boxes of the base."""
        return self.model.kept(
            "spheres",
            lambda: arm_spheres(
                self.model, self.chain, self.segments, self.disabled, self.gripper_links
            ),
            (self.base_link, self.tool_link, self.arm_joints, self.gripper_links),
            sorted(sorted(pair) for pair in self.disabled),
            records=(Spheres, LinkHulls),
        )

    @property
    def base(self) -> Boxes:
        """The base as boxes in its own frame."""
        return self.spheres.base

    @cached_property
    def has_gripper(self) -> bool:
        """Whether there is something to hold with: more than the arm's own links, or named so."""
        own = {self.model.joint(name).child for name in self.arm_joints}
        return any(
            link not in own or FINGER.search(link) or HAND.search(link)
            for link in self.gripper_links
        )

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
        links, first = np.linalg.norm(self.chain.d, axis=1), self.chain.first_turn
        farthest = np.maximum(abs(self.chain.lower), abs(self.chain.upper))[self.chain.dof]
        travel = np.where(self.chain.slides, abs(self.chain.ratio) * farthest, 0.0)
        tool = float(np.linalg.norm(self.chain.tool_offset))
        return float(links[first + 1 :].sum() + travel[first + 1 :].sum()) + tool

    @cached_property
    def outreach(self) -> float:
        """The reach, and how far joints before the first that turns slide outwards [m].

        That is a telescope's way; a lift slides upwards.
        """
        chain, first = self.chain, self.chain.first_turn
        level = np.linalg.norm(chain.h[:first, :2], axis=1)
        return self.reach + float(level @ (2 * chain.half_travel[:first]))


def load_robot(source: str | Path, *, arm: str | None = None, cache: Cache | None = None) -> Robot:
    """Load a robot by library name or from a TOML file.

    Args:
        source: The name or the file.
        arm: Which arm, of a robot with several; the first one where None.
        cache: Where its geometry is kept, so that it is computed once.

    Raises:
        RobotError, FileFormatError, UnknownNameError: It cannot be used; one line says why.
    """
    return read_robot(find_robot(source), arm=arm, cache=cache)


def load_arms(
    source: str | Path, arm: str = ANY, *, cache: Cache | None = None
) -> tuple[Robot, ...]:
    """Load a robot once for each of its arms, or for the one that is named.

    Raises:
        RobotError, FileFormatError, UnknownNameError: It cannot be used; one line says why.
    """
    path = find_robot(source)
    table = read_table(path)
    names = choose_arms(arm_tables(table), arm, path)
    return tuple(read_robot(path, arm=name or None, cache=cache) for name in names)


def read_robot(path: Path, *, arm: str | None = None, cache: Cache | None = None) -> Robot:
    """Read a robot file; docs/robots.md tells its format.

    Args:
        path: The file.
        arm: Which arm, of a robot with several; the first one where None.
        cache: Where its geometry is kept, so that it is computed once.
    """
    table = read_table(path)
    check_version(table)
    arms = arm_tables(table)
    (chosen,) = choose_arms(arms, arm, path)
    own = arms[chosen]
    urdf = beside(path, table.text("urdf"))
    record, text = amendments_of(table).read(urdf, cache)
    with _names_of(path):
        model = at_rest(Articulated(record, cache=cache), table, arms, chosen)
    base, tool = table.table("base"), own.table("tool")
    srdf = srdf_of(table, urdf)
    grips = Grip(tool.choice("grips", tuple(Grip), Grip.FINGERS))
    robot = Robot(
        name=table.text("name"),
        path=path,
        model=model,
        base_link=table.text("base_link"),
        tool_link=own.text("tool_link"),
        arm_joints=tuple(own.texts("arm_joints")),
        gripper_links=tuple(own.texts("gripper_links")),
        home=own.vector("home"),
        footprint=_footprint(base, path, cache),
        drive=base.choice("drive", ("differential", "omni")),  # type: ignore[arg-type]
        max_speed=base.positive("max_speed", 0.5),
        max_yaw_rate=base.positive("max_yaw_rate", 1.0),
        max_acceleration=base.positive("max_acceleration", 0.5),
        max_yaw_acceleration=base.positive("max_yaw_acceleration", 1.0),
        approach_axis=tool.unit("approach_axis"),
        closing_axis=tool.unit("closing_axis"),
        opening=tool.positive("opening", ASSUMED_OPENING),
        grips=grips,
        grip_force=tool.positive("force", ASSUMED_FORCE),
        assumed=_assumed(tool, grips),
        disabled=frozenset() if srdf is None else read_srdf(srdf),
        srdf=srdf,
        arm=chosen,
        arms=() if "" in arms else tuple(arms),
        other_arms=tuple(
            joint
            for name, other in arms.items()
            if name != chosen
            for joint in other.texts("arm_joints")
        ),
        payload=own.positive("payload", 0.0) if "payload" in own.data else None,
        amended=text,
    )
    _check(robot)
    return robot


def _assumed(tool: Table, grips: Grip) -> tuple[str, ...]:
    """What a robot file leaves out about its gripper."""
    values = {"opening": f"{100 * ASSUMED_OPENING:g} cm", "force": f"{ASSUMED_FORCE:g} N"}
    needed = {Grip.FINGERS: ("opening", "force"), Grip.SUCTION: ("force",), Grip.HOOK: ()}
    return tuple(
        f"the gripper's {key} is assumed to be {values[key]}: {tool.path} has no tool.{key}"
        for key in needed[grips]
        if key not in tool.data
    )


@contextmanager
def _names_of(path: Path) -> Iterator[None]:
    """Say which robot file gives a name that its URDF does not have."""
    try:
        yield
    except UnknownNameError as error:
        raise UnknownNameError(f"{path}: {error}") from error


def _check(robot: Robot) -> None:
    try:
        with _names_of(robot.path):
            chain = robot.chain
    except RobotError as error:  # a tool that no arm moves, joints out of order
        raise RobotError(f"{robot.path}: {error}") from error
    if robot.reach > MAX_REACH:
        raise RobotError(
            f"{robot.path}: the arm reaches {robot.reach:.3g} m; at most {MAX_REACH:g} m are "
            "supported; are the lengths in meters?"
        )
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


def _footprint(base: Table, path: Path, cache: Cache | None) -> Float[np.ndarray, "k 2"]:
    points = base.matrix("footprint", 2)
    return once(cache, "footprint", (points,), lambda: _outline(points, path))


def _outline(points: Float[np.ndarray, "n 2"], path: Path) -> Float[np.ndarray, "k 2"]:
    from scipy.spatial import ConvexHull, QhullError

    if len(points) > MAX_OUTLINE or np.abs(points).max(initial=0.0) > MAX_REACH:
        raise RobotError(
            f"{path}: base.footprint must have at most {MAX_OUTLINE} corners within {MAX_REACH:g} m"
        )
    try:
        return points[ConvexHull(points).vertices]
    except (QhullError, ValueError) as error:
        raise RobotError(
            f"{path}: base.footprint must enclose an area, as [[x, y], ...]"
        ) from error
