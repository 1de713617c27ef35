"""Masses, inertias and effort limits of a robot, and the forces of its fingers."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core import UrdfError, read_xml
from momapos.core.geometry import apply, invert
from momapos.model.robots import Pivot, Robot, pivots
from momapos.model.urdf import MAX_URDF_BYTES, Geometry, Hull, Joint, Mimic, hull_of, origin_pose

if TYPE_CHECKING:
    from jaxtyping import Float


_MATRIX = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")


@dataclass(frozen=True, eq=False)
class Inertia:
    """Mass and inertia of a link."""

    mass: float
    """[kg]"""
    T_link_inertia: Float[np.ndarray, "4 4"]
    """Frame of `matrix`; its origin is the center of mass."""
    matrix: tuple[float, float, float, float, float, float]
    """xx, yy, zz, xy, xz, yz [kg m^2]."""


@dataclass(frozen=True)
class Dynamics:
    """Masses, effort limits and mimic joints of a URDF."""

    inertias: Mapping[str, Inertia]
    """By link; links without a mass are left out."""
    efforts: Mapping[str, float]
    """Maximum torque or force by joint [Nm] or [N]; joints without a limit are left out."""
    mimics: Mapping[str, Mimic]
    """By the name of the following joint."""


def read_dynamics(path: Path) -> Dynamics:
    """Read the inertial data of a URDF that `read_urdf` has accepted.

    Raises:
        UrdfError: A mass, inertia, mimic or effort value is invalid.
    """
    root: Any = read_xml(path, MAX_URDF_BYTES, error=UrdfError)
    inertias = {}
    for link in root.iter("link"):
        inertial = link.find("inertial")
        if inertial is not None and inertial.find("mass") is not None:
            inertias[link.get("name")] = _inertia(inertial, f"{path}: link {link.get('name')!r}")
    efforts, mimics = {}, {}
    for joint in root.iter("joint"):
        mimic = joint.find("mimic")
        if mimic is not None and mimic.get("joint"):
            where = f"{path}: joint {joint.get('name')!r}: mimic"
            factor = _number(mimic.get("multiplier", "1"), where)
            offset = _number(mimic.get("offset", "0"), where)
            mimics[joint.get("name")] = Mimic(mimic.get("joint"), factor, offset)
        limit = joint.find("limit")
        effort = 0.0 if limit is None else float(limit.get("effort", "0").replace(",", " "))
        if 0 < effort < math.inf:
            efforts[joint.get("name")] = effort
    return Dynamics(inertias, efforts, mimics)


def _inertia(element: Any, where: str) -> Inertia:
    mass = _number(element.find("mass").get("value"), f"{where}: mass")
    if mass < 0:
        raise UrdfError(f"{where}: mass {mass:g} is negative")
    origin, matrix = element.find("origin"), element.find("inertia")
    values = [
        _number("0" if matrix is None else matrix.get(key, "0"), f"{where}: {key}")
        for key in _MATRIX
    ]
    return Inertia(mass, origin_pose(origin), tuple(values))  # type: ignore[arg-type]


def _number(text: str | None, where: str) -> float:
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or abs(value) > 1e6:
        raise UrdfError(f"{where} {text!r:.80} must be a finite number of magnitude at most 1e6")
    return value


def volume(shape: Geometry) -> float:
    """Return the volume of a shape [m^3]; for a mesh, of its convex hull."""
    if shape.kind == "box":
        return float(np.prod(shape.size))
    if shape.kind == "cylinder":
        return math.pi * shape.size[0] ** 2 * shape.size[1]
    if shape.kind == "sphere":
        return 4 / 3 * math.pi * shape.size[0] ** 3
    return hull_volume(hull_of(shape))


def hull_volume(hull: Hull) -> float:
    """Return the volume of a convex hull [m^3]."""
    a, b, c = (hull.vertices[hull.faces[:, k]] for k in range(3))
    return float(np.einsum("fi,fi->", np.cross(a, b), c)) / 6


MAX_PAD_DEPTH = 0.03
"""Distance behind the fingertip within which a link can be the opposing jaw [m]."""
_LEVER_STEP = 0.02
"""Share of a finger's travel over which its pad speed is measured [-]."""


@dataclass(frozen=True)
class Finger:
    """A motorized joint that closes one finger, or several that follow it."""

    joint: str
    open: float
    """Value in the plan [rad] or [m]."""
    closed: float
    """Joint limit at which the fingers are closest [rad] or [m]."""
    lever: float
    """Closing travel of all its tips per travel of the joint [m/rad] or [-]."""


@dataclass(frozen=True, eq=False)
class SimulatedHand:
    """Fingers and pads of a gripper."""

    fingers: tuple[Finger, ...]
    """Motorized finger joints; empty if nothing closes."""
    followers: Mapping[str, Mimic]
    """Joints that follow a finger: mimic joints of the URDF, and those of `pivots`."""
    pads: Mapping[str, float]
    """Links that hold, with their side of the tool along the closing axis, 1 or -1; 0 for the tip
    of a hand that does not close."""
    axis: Float[np.ndarray, "3"]
    """Closing axis, in the tool frame."""
    approach: Float[np.ndarray, "3"]
    """Approach direction, in the tool frame."""
    force: float
    """Closing force of each finger [N]."""
    pivots: tuple[Pivot, ...] = ()
    """Tips that rotate on their fingers, so that they face each other."""

    @property
    def closes(self) -> bool:
        """Whether the hand can grasp between its fingers."""
        return bool(self.fingers)


def find_hand(robot: Robot, mimics: Mapping[str, Mimic]) -> SimulatedHand:
    """Find the fingers of a gripper: the joints, sliding or rotating, that move its links.

    Args:
        robot: The robot.
        mimics: Joints of its URDF that follow others.
    """
    model, links = robot.model, set(robot.gripper_links)
    moving = {
        joint.name: joint
        for joint in model.joints.values()
        if joint.name not in robot.moved_joints
        and links & set(model.moved_by(joint.name))
        and not _moves_arm(robot, joint)
    }
    followers = {n: m for n, m in mimics.items() if n in moving and m.joint in moving}
    found = []
    for joint in moving.values():
        if joint.name not in followers and np.isfinite([joint.lower, joint.upper]).all():
            finger = _finger(robot, joint, followers)
            if finger is not None:
                found.append(finger)
    named = {finger.joint for finger in found}
    followers = {n: m for n, m in followers.items() if m.joint in named}
    pads = {
        link: side
        for name in (*named, *followers)
        for link, side in _sides(robot, model.moved_by(name)).items()
    }
    pads |= _fixed_jaw(robot, pads)
    axes = robot.closing_axis, robot.approach_axis, robot.grip_force
    if {1.0, -1.0} <= set(pads.values()):
        tips = tuple(pivot for pivot in pivots(robot) if pivot.joint in named)
        followers |= {tip.name: Mimic(tip.joint, tip.ratio, tip.offset) for tip in tips}
        return SimulatedHand(tuple(found), followers, pads, *axes, tips)
    return SimulatedHand((), {}, dict.fromkeys(_tip(robot), 0.0), *axes)


def _fixed_jaw(robot: Robot, pads: Mapping[str, float]) -> dict[str, float]:
    """Return the fixed jaw that a single moving jaw closes on, with its side."""
    ahead = _ahead(robot, robot.gripper_links)
    others = [link for link in ahead if link not in pads and link in robot.gripper_links]
    if len(set(pads.values())) != 1 or not others:
        return {}
    farthest = max(others, key=lambda link: ahead[link])
    if ahead[farthest] < max(ahead[link] for link in pads if link in ahead) - MAX_PAD_DEPTH:
        return {}
    return {farthest: -next(iter(pads.values()))}


def _moves_arm(robot: Robot, joint: Joint) -> bool:
    """Return whether a joint moves the hand itself, so that it belongs to no finger."""
    return robot.tool_link in robot.model.moved_by(joint.name)


def _finger(robot: Robot, joint: Joint, followers: Mapping[str, Mimic]) -> Finger | None:
    """Return a finger with its closed value; None if its joint closes nothing."""
    rest = robot.model.rest[joint.name]
    group = [joint.name, *(n for n, m in followers.items() if m.joint == joint.name)]
    tips = _tips(robot, {link for name in group for link in robot.model.moved_by(name)})

    def apart(value: float) -> Float[np.ndarray, " t"]:
        values = {joint.name: value}
        values |= {n: followers[n].at(value) for n in group[1:]}
        across = _across(robot, tips, values)
        return np.array([side * across[link] for link, side in tips.items()])

    ends = (joint.lower, joint.upper)
    gaps = [np.abs(apart(end)).sum() for end in ends]
    closed = ends[int(np.argmin(gaps))]
    way = closed - rest
    if abs(way) < 1e-6:
        return None
    step = _LEVER_STEP * way
    closing = apart(rest + 0.5 * way - step) - apart(rest + 0.5 * way + step)
    lever = float(closing.sum() / abs(2 * step))
    return Finger(joint.name, rest, closed, lever) if lever > 1e-6 else None


def _sides(robot: Robot, links: Iterable[str]) -> dict[str, float]:
    """Return the side of the tool on which each link with a shape is, at rest."""
    return {n: float(np.sign(v)) for n, v in _across(robot, links, {}).items() if v}


def _tips(robot: Robot, links: Iterable[str]) -> dict[str, float]:
    """Return the link that reaches farthest along the approach on each side, at rest."""
    ahead, sides = _ahead(robot, links), _sides(robot, links)
    return {
        max((n for n in sides if sides[n] == side), key=lambda n: ahead[n]): side
        for side in sorted(set(sides.values()))
    }


def _across(robot: Robot, links: Iterable[str], values: dict[str, float]) -> dict[str, float]:
    """Return the centers of links along the closing axis, from the tool's origin [m]."""
    clouds = _clouds(robot, links, values).items()
    return {n: float((p.min(0) + p.max(0)) / 2 @ robot.closing_axis) for n, p in clouds}


def _ahead(robot: Robot, links: Iterable[str]) -> dict[str, float]:
    """Return the reach of links along the approach at rest, from the tool's origin [m]."""
    clouds = _clouds(robot, links, {}).items()
    return {n: float((p @ robot.approach_axis).max()) for n, p in clouds}


def _clouds(
    robot: Robot, links: Iterable[str], values: dict[str, float]
) -> dict[str, Float[np.ndarray, "n 3"]]:
    """Return the vertices of links that have a shape, in the tool frame [m]."""
    model = robot.model
    poses = model.link_poses(values)
    T = invert(poses[robot.tool_link])
    return {
        name: apply(T @ poses[name], np.concatenate([h.vertices for h in model.hulls[name]]))
        for name in sorted(set(links))
        if model.hulls[name]
    }


def _tip(robot: Robot) -> tuple[str, ...]:
    """Return the gripper link that reaches farthest along the approach."""
    ahead = _ahead(robot, robot.gripper_links)
    return (max(ahead, key=lambda name: ahead[name]),) if ahead else ()
