"""The robot record, and its robot file: TOML next to a URDF."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import (
    USER_CACHE,
    Cache,
    RobotError,
    UnknownNameError,
    as_path,
    expect,
    expect_callable,
    unknown_name,
)
from momapos.core.geometry import apply, convex_hull, invert
from momapos.model.collision import LinkHulls, Spheres, arm_spheres
from momapos.model.kinematics import Chain, IkModel, Segments, build_chain, build_ik, fine_ik
from momapos.model.records import GraspSource, InverseKinematics
from momapos.model.urdf import Articulated, Boxes, read_urdf

from .gripper_guess import FINGER, HAND
from .robot_file import (
    ANY,
    Drive,
    RobotTool,
    amendments_of,
    at_rest,
    choose_arms,
    read_footprint,
    read_robot_file,
    srdf_of,
)
from .robot_names import find_robot, library_file
from .srdf import claimed_apart, read_srdf

if TYPE_CHECKING:
    from jaxtyping import Float

MAX_REACH = 5.0
"""Maximum reach of an arm [m]; the size of maps and grids grows with its cube."""
ASSUMED_FORCE, ASSUMED_OPENING = 60.0, 0.08
"""Assumed finger force [N] and gripper opening [m] if the robot file does not state them."""


class Grip(StrEnum):
    """What a tool holds with. Robot files contain these strings."""

    FINGERS = "fingers"
    """Fingers that close."""
    SUCTION = "suction"
    """A suction cup or magnet, which holds what it touches."""
    HOOK = "hook"
    """A rigid finger that pulls from behind."""


@dataclass(frozen=True, eq=False)
class Robot:
    """A mobile base with one arm and one tool. Equality is identity."""

    name: str
    path: Path
    """Robot file (TOML)."""
    model: Articulated
    base_link: str
    """Link on the floor, x forward; of a car-like base at the middle of its fixed axle."""
    tool_link: str
    arm_joints: tuple[str, ...]
    """Base to tool; a torso joint comes first."""
    gripper_links: tuple[str, ...]
    home: Float[np.ndarray, " n"]
    """State of the arm while the base drives."""
    footprint: Float[np.ndarray, "k 2"]
    """Convex outline of the base in its own frame, counterclockwise [m]."""
    drive: Drive
    """Wheels that turn on the spot, that also drive sideways, or that turn on arcs only."""
    max_speed: float
    max_yaw_rate: float
    max_acceleration: float
    max_yaw_acceleration: float
    approach_axis: Float[np.ndarray, "3"]
    """Unit vector in the tool frame along which the gripper approaches an object."""
    closing_axis: Float[np.ndarray, "3"]
    """Unit vector in the tool frame along which the fingers close."""
    opening: float
    """Maximum width of an object between the fingers [m]."""
    disabled: frozenset[frozenset[str]]
    """Pairs of links whose contact is never checked."""

    claimed: frozenset[frozenset[str]] = frozenset()
    """Those that are said never to touch; the exact check compares their surfaces."""
    srdf: Path | None = None
    """File with these pairs; None without one."""
    grips: Grip = Grip.FINGERS
    """What the tool holds with."""
    grip_force: float = ASSUMED_FORCE
    """Closing force of each finger, or pull of a suction cup [N]."""
    assumed: tuple[str, ...] = ()
    """Assumptions about what the robot file leaves out, and keys of it that are not known, one line
    each."""
    arm: str = ""
    """Name of this arm; "" for a robot with one arm."""
    arms: tuple[str, ...] = ()
    """Names of all arms; empty for a robot with one arm. The other arms rest at home."""
    other_arms: tuple[str, ...] = ()
    """Joints of the other arms."""
    min_turning_radius: float = 0.0
    """Least radius of the base link's path [m], of a car-like base; 0 for others."""
    payload: float | None = None
    """Payload of the arm [kg]; None if unknown."""
    amended: str | None = None
    """URDF with the robot file's additions and absolute mesh paths; None if the URDF is used
    unchanged."""
    fully_open: Robot | None = field(default=None, repr=False)
    """The robot with its hand fully open, if this hand is not; see `hand_openings`."""
    own_ik: InverseKinematics | None = field(default=None, repr=False)
    """Solves for the states at the waypoints in place of `ik`; see `with_inverse_kinematics`."""
    own_grasps: GraspSource | None = field(default=None, repr=False)
    """Proposes grasps beyond the planner's; see `with_grasps`."""

    @property
    def source(self) -> str:
        """Argument of `load_robot`: the library name, or the path of the robot file."""
        return self.name if self.path == library_file(self.name) else str(self.path)

    @property
    def title(self) -> str:
        """Name of the robot, and of the arm if it has several."""
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
        """Kinematic chain of the arm."""
        return self._parts[0]

    @property
    def moved_joints(self) -> tuple[str, ...]:
        """Joints of the arm and their followers, base to tool, as in a plan."""
        return self.chain.joints

    @property
    def segments(self) -> Segments:
        """Moving segment of each link."""
        return self._parts[1]

    @cached_property
    def ik(self) -> IkModel:
        """Inverse kinematics of the arm."""
        return build_ik(self.chain)

    @cached_property
    def finer(self) -> Robot:
        """The same robot with a finer inverse kinematics, which misses less and takes longer."""
        ik, finer = fine_ik(self.chain), copy(self)
        vars(finer)["ik"] = ik
        return finer

    def with_home(self, q: Float[np.ndarray, " n"]) -> Robot:
        """Return the same robot with its arm in another state while the base drives."""
        robot = copy(self)
        vars(robot).pop("finer", None)
        vars(robot)["home"] = np.array(q, float)
        return robot

    def with_inverse_kinematics(self, solve: InverseKinematics) -> Robot:
        """Return the same robot with inverse kinematics of your own.

        It finds the states at the waypoints of a task. Between waypoints the planner follows the
        tool by Newton steps as always, and the reachability map keeps its own. Searches in which
        the hand turns about a bar, or the base moves, have joints that it does not know and keep
        the planner's.

        Args:
            solve: Returns states (m, b, n) of the arm joints for tool poses (m, 4, 4) in the base
                frame; rows without a state are NaN.

        Raises:
            InputError: It cannot be called.
        """
        expect_callable("solve", solve)
        return self._with_own("own_ik", solve)

    def with_grasps(self, source: GraspSource) -> Robot:
        """Return the same robot with grasps of your own, in addition to the planner's.

        They are proposals: the fingers close at each, and a grasp whose pads do not meet a handle
        or the object, or do not bear its load, is left out. Only hands whose fingers close use
        them, and only handles that momapos finds are held, by a link that the joint moves itself.
        To allow no others, pass `keep_grasps`.

        Args:
            source: Returns poses of the tool link (g, 4, 4) for an object and a joint.

        Raises:
            InputError: It cannot be called.
        """
        expect_callable("source", source)
        return self._with_own("own_grasps", source)

    def _with_own(self, name: str, function: object) -> Robot:
        """Return the same robot with a function of the user's own, also if its hand is open."""
        robot = copy(self)
        vars(robot).pop("finer", None)
        vars(robot)[name] = function
        if self.fully_open is not None:
            vars(robot)["fully_open"] = self.fully_open._with_own(name, function)
        return robot

    @cached_property
    def spheres(self) -> Spheres:
        """Collision spheres of the arm, and boxes of the base."""
        return self.model.cached(
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
        """Boxes of the base, in its own frame."""
        return self.spheres.base

    @cached_property
    def base_outline(self) -> Float[np.ndarray, "k 2"]:
        """Outline of the base in its own frame, counterclockwise [m]: the convex hull of the
        footprint and of all links that do not move with the arm, at any height."""
        poses = self.model.link_poses({})
        T_base_root = invert(poses[self.base_link])
        points = [
            apply(T_base_root @ poses[link], hull.vertices)[:, :2]
            for link, hulls in self.model.hulls.items()
            for hull in hulls
            if self.segments.of_link[link] == 0
        ]
        return convex_hull(np.concatenate([self.footprint, *points]))

    @cached_property
    def has_gripper(self) -> bool:
        """Whether the gripper has links beyond the arm's own, or links with a gripper's name."""
        own = {self.model.joint(name).child for name in self.arm_joints}
        return any(
            link not in own or FINGER.search(link) or HAND.search(link)
            for link in self.gripper_links
        )

    @cached_property
    def finger_depth(self) -> float:
        """Distance of the fingertips beyond the tool's origin [m]."""
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
        """Reach plus the horizontal travel of joints before the first revolute one [m].

        This is the travel of a telescope; a lift moves vertically.
        """
        chain, first = self.chain, self.chain.first_turn
        level = np.linalg.norm(chain.h[:first, :2], axis=1)
        return self.reach + float(level @ (2 * chain.half_travel[:first]))


def load_robot(
    source: str | Path, *, arm: str | None = None, cache: Cache | None = USER_CACHE
) -> Robot:
    """Load a robot by library name or from a TOML file.

    Args:
        source: The name or the file.
        arm: Name of the arm, for a robot with several; None for the first one.
        cache: Stores expensive geometry; None to always compute it.

    Raises:
        RobotError, FileFormatError, UnknownNameError: The robot is invalid; one line says why.
    """
    if not isinstance(source, str):
        source = as_path("source", source)
    if arm is not None:
        expect("arm", arm, str)
    return read_robot(find_robot(source), arm=arm, cache=cache)


def load_arms(
    source: str | Path, arm: str = ANY, *, cache: Cache | None = USER_CACHE
) -> tuple[Robot, ...]:
    """Load a robot once for each of its arms, or for the named arm.

    Raises:
        RobotError, FileFormatError, UnknownNameError: The robot is invalid; one line says why.
    """
    path = find_robot(source)
    names = choose_arms(read_robot_file(path), arm)
    return tuple(read_robot(path, arm=name or None, cache=cache) for name in names)


def drawn_model(robot: Robot, *, cache: Cache | None = USER_CACHE) -> Articulated:
    """Return a robot with the shapes that its URDF draws instead of those for collisions.

    Nothing else is made of them, so they are an independent witness.

    Args:
        robot: The robot.
        cache: Stores parsed files; None to always read them.

    Raises:
        UrdfError: A file has changed and is invalid.
    """
    read = read_robot_file(robot.path)
    amendments = replace(amendments_of(read), drawn=True)
    text = amendments.text(read.path_of(read.file.urdf))
    record = read_urdf(
        read.path_of(read.file.urdf), cache=cache, text=text, find_mesh=Path, actuated=True
    )
    return Articulated(record, robot.model.held, cache)


def read_robot(path: Path, *, arm: str | None = None, cache: Cache | None = None) -> Robot:
    """Read a robot file (format: docs/robots.md).

    Args:
        path: The file.
        arm: Name of the arm, for a robot with several; None for the first one.
        cache: Stores expensive geometry.
    """
    read = read_robot_file(path)
    file, base, arms = read.file, read.file.base, read.file.arms
    (chosen,) = choose_arms(read, arm)
    own, tool = arms[chosen], arms[chosen].tool
    urdf = read.path_of(file.urdf)
    record, text = amendments_of(read).read(urdf, cache)
    with _names_of(path):
        model = at_rest(Articulated(record, cache=cache), read, chosen)
    srdf = srdf_of(read, urdf)
    robot = Robot(
        name=file.name,
        path=path,
        model=model,
        base_link=file.base_link,
        tool_link=own.tool_link,
        arm_joints=tuple(own.arm_joints),
        gripper_links=tuple(own.gripper_links),
        home=np.array(own.home),
        footprint=read_footprint(read, cache),
        drive=base.drive,
        min_turning_radius=base.min_turning_radius or 0.0,
        max_speed=base.max_speed,
        max_yaw_rate=base.max_yaw_rate,
        max_acceleration=base.max_acceleration,
        max_yaw_acceleration=base.max_yaw_acceleration,
        approach_axis=_unit(tool.approach_axis),
        closing_axis=_unit(tool.closing_axis),
        opening=tool.opening or ASSUMED_OPENING,
        grips=Grip(tool.grips),
        grip_force=tool.force or ASSUMED_FORCE,
        assumed=(*_assumed(tool, path), *read.ignored),
        disabled=frozenset() if srdf is None else read_srdf(srdf),
        claimed=frozenset() if srdf is None else claimed_apart(srdf),
        srdf=srdf,
        arm=chosen,
        arms=() if "" in arms else tuple(arms),
        other_arms=tuple(
            joint for name, other in arms.items() if name != chosen for joint in other.arm_joints
        ),
        payload=own.payload,
        amended=text,
    )
    _check(robot)
    return robot


def _unit(axis: tuple[float, ...]) -> Float[np.ndarray, "3"]:
    return np.array(axis) / math.hypot(*axis)


def _assumed(tool: RobotTool, path: Path) -> tuple[str, ...]:
    """Return the gripper values that a robot file leaves out, with their assumptions."""
    values = {"opening": f"{100 * ASSUMED_OPENING:g} cm", "force": f"{ASSUMED_FORCE:g} N"}
    needed = {"fingers": ("opening", "force"), "suction": ("force",), "hook": ()}
    return tuple(
        f"the gripper's {key} is assumed to be {values[key]}: {path} has no tool.{key}"
        for key in needed[tool.grips]
        if getattr(tool, key) is None
    )


@contextmanager
def _names_of(path: Path) -> Iterator[None]:
    """Add the robot file to errors about names that its URDF does not have."""
    try:
        yield
    except UnknownNameError as error:
        raise UnknownNameError(f"{path}: {error}") from error


def _check(robot: Robot) -> None:
    try:
        with _names_of(robot.path):
            chain = robot.chain
    except RobotError as error:  # for example a tool that no arm moves
        raise RobotError(f"{robot.path}: {error}") from error
    if robot.reach > MAX_REACH:
        raise RobotError(
            f"{robot.path}: the arm reaches {robot.reach:.3g} m; at most {MAX_REACH:g} m are "
            "supported; check that lengths are in meters"
        )
    for link in robot.gripper_links:
        if link not in robot.model.urdf.links:
            raise unknown_name("gripper link", link, robot.model.urdf.links, str(robot.path))
    if robot.home.shape != (chain.size,):
        raise RobotError(
            f"{robot.path}: home must have one value per joint of arm_joints, {chain.size}, not "
            f"{len(robot.home)}"
        )
    outside = (robot.home < chain.lower - 1e-6) | (robot.home > chain.upper + 1e-6)
    if outside.any():
        i = int(np.argmax(outside))
        raise RobotError(
            f"{robot.path}: home of {chain.names[i]!r} is {robot.home[i]:g}; its limits are "
            f"{chain.lower[i]:g} to {chain.upper[i]:g}"
        )
    if abs(float(robot.approach_axis @ robot.closing_axis)) > 1e-3:
        raise RobotError(f"{robot.path}: approach_axis and closing_axis must be perpendicular")
