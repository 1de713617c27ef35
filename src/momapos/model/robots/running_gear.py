"""Find the wheels of a robot, and the area on the floor that it stands on."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import RobotError, UrdfError, read_text_bounded
from momapos.core.geometry import apply, convex_hull, edge_normals, invert
from momapos.model.urdf import MAX_URDF_BYTES, Articulated, Joint, fit_box, read_tree

from .gripper_guess import fixed_to, joints_below

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

    from jaxtyping import Float


WHEEL = re.compile(r"wheel|caster|castor|track(?!ing)|roller", re.I)
_CASTER = re.compile(r"caster|castor", re.I)
OMNI = re.compile(r"mecanum|omni|swerve", re.I)
SIDEWAYS = re.compile(r"planar_move|force_based_move|mecanum|omni_?drive", re.I)
"""Plugins of Gazebo Classic and Gazebo Sim that drive a base in any direction."""
ON_THE_SPOT = re.compile(r"diff_?-?drive|differential|skid_?steer", re.I)
"""Plugins that drive a base ahead and turn it on the spot."""
STEER = re.compile(r"steer|knuckle|ackerman", re.I)
ENDLESS = 6.0
"""Range from which a joint turns a wheel [rad]."""
FREE_STEERING = 3.0
"""Range from which steering points a wheel in every direction, as wheels drive both ways [rad]."""
LEVEL_COSINE = 0.1
"""Largest cosine between an axle and the vertical [-]."""
MIN_ROLLERS = 3
"""Number of joints below a wheel from which they are its rollers [-]."""
WHEEL_TOLERANCE = 0.02
"""Difference between the radius of a wheel and the height of its axle [m]."""
MAX_JOINTS_ABOVE = 3
"""Number of joints, such as suspension and steering, beyond which only a name tells a wheel [-]."""
MIN_ROUNDNESS = 0.8
"""Share of the radius that a round body reaches in each eighth of a turn [-]."""
MIN_TRAIL = 0.01
"""Distance of a wheel behind its steering axis from which it trails like a caster's [m]."""


@dataclass(frozen=True, eq=False)
class Wheel:
    """A wheel of a base, in the frame of the base's anchor."""

    joint: str
    link: str
    center: Float[np.ndarray, "3"]
    """[m]"""
    axle: Float[np.ndarray, "3"]
    """Unit vector; level."""
    steering: str = ""
    """Joint that steers it; "" for none."""
    least: float = 0.0
    most: float = 0.0
    """Steering range, counterclockwise seen from the base's z axis [rad]."""
    trail: float = 0.0
    """Distance between the steering axis and the wheel [m]."""
    unlimited: bool = False
    """Whether a joint of that name steers it, and has no limits."""
    locked: str = ""
    """Fixed joint with the name of a steering above it; "" for none."""
    caster: bool = False
    """Whether a name says that it is a caster's."""
    rollers: bool = False
    """Whether it has rollers, or a name says that it is omnidirectional."""
    fixed: bool = False
    """Whether the file fixes it, so that its shape gives the axle."""

    @property
    def ahead(self) -> Float[np.ndarray, "2"]:
        """Unit vector in which it rolls, from above."""
        return np.array([self.axle[1], -self.axle[0]])

    @property
    def free(self) -> bool:
        """Whether its steering points it in every direction."""
        return bool(self.steering) and self.most - self.least >= FREE_STEERING


@dataclass(frozen=True, eq=False)
class RunningGear:
    """The wheels of a base, and what hints at how they drive."""

    wheels: tuple[Wheel, ...] = ()
    joints: frozenset[str] = frozenset()
    """Joints of wheels, steering and suspension, which are not joints of an arm."""
    locked: tuple[str, ...] = ()
    """Fixed joints of the base whose name, or whose link's name, is that of a steering."""
    words: bool = False
    """Whether a name of the base, or a mesh of it, says that it is omnidirectional."""


def find_running_gear(
    model: Articulated, anchor: str, meshes: Mapping[str, Sequence[str]]
) -> RunningGear:
    """Find the wheels of a base.

    A wheel turns endlessly about a level axle. A name says so, or its shape: its radius is the
    height of its axle above the lowest point of the base. Files may fix wheels; these need both.

    Args:
        model: The robot.
        anchor: Link that carries the base.
        meshes: File names of meshes by link, drawn ones too.

    Raises:
        RobotError: The file gives a wheel no axis.
    """
    found: list[Wheel] = []
    gear: set[str] = set()
    named: list[bool] = []
    finder = _Finder(model, anchor, meshes)
    joints = [(name, one) for name in fixed_to(model, anchor) for one in joints_below(model, name)]
    locked = [one for _, one in joints if not one.movable and _names_steering(one)]
    knuckle = {link: one.name for one in locked for link in fixed_to(model, one.child)}
    for name, joint in joints:
        below = finder.wheels(joint, ()) if joint.movable else None
        if below:
            found += [replace(one, locked=knuckle.get(name, "")) for one in below]
            named += [bool(WHEEL.search(f"{w.joint} {w.link}")) for w in below]
            gear |= {j.name for j in _joints_in(model, joint)}
    if found:
        rigid = [j for _, j in joints if j.name not in gear and finder.steers_a_rigid_wheel(j)]
        found += [finder.rigid_wheel(joint, found[0].axle) for joint in rigid]
        gear |= {joint.name for joint in rigid}
    if len(found) < 2 and not any(named):  # one round body on the floor is no base
        found, gear = [], set()
    found += [wheel for _, one in joints if (wheel := finder.fixed_wheel(one)) is not None]
    if not found:
        return RunningGear()
    body = {*fixed_to(model, anchor), *(w.link for w in found)}
    names = [*body, *(j.name for j in model.urdf.joints if j.parent in body)]
    names += [mesh for link in body for mesh in meshes.get(link, ())]
    return RunningGear(
        tuple(found),
        frozenset(gear),
        tuple(one.name for one in locked),
        any(OMNI.search(name) for name in names),
    )


def drawn_meshes(content: str | None, urdf: Path) -> dict[str, list[str]]:
    """Return the links that have a shape, drawn ones too, with the file names of their meshes.

    Args:
        content: The URDF's content; None to read it.
        urdf: The file.
    """
    return {
        link.get("name", ""): [mesh.get("filename", "") for mesh in link.iter("mesh")]
        for link in _tree(content, urdf).findall("link")
        if link.find("visual") is not None or link.find("collision") is not None
    }


@dataclass(frozen=True)
class DrivePlugin:
    """A plugin of Gazebo that drives the base in its maker's simulation."""

    name: str
    sideways: bool
    """Whether it drives the base in any direction, rather than ahead."""

    @property
    def words(self) -> str:
        """Return what it does."""
        how = "in any direction" if self.sideways else "ahead and turns it on the spot"
        return f"{self.name} drives it {how}"


def drive_plugin(content: str | None, urdf: Path) -> DrivePlugin | None:
    """Return the plugin that drives the base in Gazebo; None for none.

    Args:
        content: The URDF's content; None to read it.
        urdf: The file.
    """
    names = [plugin.get("filename", "") for plugin in _tree(content, urdf).iter("plugin")]
    found = [DrivePlugin(name, sideways=True) for name in names if SIDEWAYS.search(name)]
    found += [DrivePlugin(name, sideways=False) for name in names if ON_THE_SPOT.search(name)]
    return found[0] if found else None


def _tree(content: str | None, urdf: Path) -> Element:
    text = read_text_bounded(urdf, MAX_URDF_BYTES, error=UrdfError) if content is None else content
    return read_tree(text, urdf)


def _names_steering(joint: Joint) -> bool:
    return bool(STEER.search(f"{joint.name} {joint.child}"))


def _joints_in(model: Articulated, joint: Joint) -> list[Joint]:
    """Return a joint and all joints below it."""
    links = set(model.links_below(joint.child))
    return [joint, *(one for one in model.urdf.joints if one.parent in links)]


class _Finder:
    """Finds the wheels below a joint."""

    def __init__(
        self, model: Articulated, anchor: str, meshes: Mapping[str, Sequence[str]]
    ) -> None:
        self.model, self.meshes = model, meshes
        T = invert(model.rest_poses[anchor])
        self.poses = {link: T @ pose for link, pose in model.rest_poses.items()}
        body = [apply(self.poses[n], h.vertices) for n in model.links for h in model.hulls[n]]
        self.ground = float(min((points[:, 2].min() for points in body), default=0.0))

    def wheels(self, joint: Joint, above: tuple[Joint, ...]) -> list[Wheel] | None:
        """Return the wheels that a joint carries; None if it carries something else, too."""
        if self._turns_a_wheel(joint, len(above)):
            return [self._wheel(joint, above)]
        below = [
            one
            for name in fixed_to(self.model, joint.child)
            for one in joints_below(self.model, name)
            if one.movable
        ]
        found = [self.wheels(one, (*above, joint)) for one in below]
        if not found or any(part is None for part in found):
            return None
        return [wheel for part in found if part is not None for wheel in part]

    def _turns_a_wheel(self, joint: Joint, above: int) -> bool:
        named = bool(WHEEL.search(joint.name) or WHEEL.search(joint.child))
        if joint.kind == "prismatic" or joint.upper - joint.lower < ENDLESS:
            return False
        if named and joint.name in self.model.urdf.without_axis:
            raise RobotError(
                f"{self.model.urdf.path}: joint {joint.name!r} of a wheel has no <axis>, so it "
                'would turn about x; add the axle, such as <axis xyz="0 1 0"/>'
            )
        if abs(self._axis(joint)[2]) > LEVEL_COSINE:
            return False
        return named or (above <= MAX_JOINTS_ABOVE and self._rolls(joint))

    def _axis(self, joint: Joint) -> Float[np.ndarray, "3"]:
        return np.asarray(self.poses[joint.child][:3, :3] @ joint.axis)

    def _rolls(self, joint: Joint) -> bool:
        """Return whether a body is round about its axle, with a radius of the axle's height."""
        center, axis = self.poses[joint.child][:3, 3], self._axis(joint)
        return self._roundness(joint.child, center, axis) > MIN_ROUNDNESS

    def _roundness(
        self, link: str, center: Float[np.ndarray, "3"], axis: Float[np.ndarray, "3"]
    ) -> float:
        """Return the least share of its radius that a body reaches in each eighth of a turn [-].

        Zero if its radius is not the height of the axle.
        """
        links = self.model.links_below(link)
        points = [apply(self.poses[n], h.vertices) for n in links for h in self.model.hulls[n]]
        if not points:
            return 0.0
        away = np.concatenate(points) - center
        across = np.stack([away[:, 2], away @ np.cross(axis, [0.0, 0.0, 1.0])])
        radii, sector = np.hypot(*across), np.arctan2(*across) // (np.pi / 4)
        radius = radii.max()
        if abs(float(center[2]) - self.ground - radius) >= WHEEL_TOLERANCE + 0.1 * radius:
            return 0.0
        return min(float(radii[sector == k].max(initial=0.0) / radius) for k in range(-4, 4))

    def _wheel(self, joint: Joint, above: tuple[Joint, ...]) -> Wheel:
        links = self.model.links_below(joint.child)
        names = [n for one in (*above, joint) for n in (one.name, one.child)]
        own = [joint.name, *links, *(m for link in links for m in self.meshes.get(link, ()))]
        rollers = sum(one.movable for one in _joints_in(self.model, joint)) - 1
        axis, center = self._axis(joint), self.poses[joint.child][:3, 3]
        steering = [one for one in above if self._turns_upright(one)]
        level = np.array([axis[0], axis[1], 0.0])
        wheel = Wheel(
            joint.name, joint.child, center, level / np.linalg.norm(level),
            caster=any(map(_CASTER.search, names)),
            rollers=rollers >= MIN_ROLLERS or any(map(OMNI.search, own)),
        )  # fmt: skip
        return self._steered(wheel, steering[0]) if steering else wheel

    def fixed_wheel(self, joint: Joint) -> Wheel | None:
        """Return the wheel that a joint fixes, by its name and its shape; None if it is none."""
        name, shapes = joint.child, self.model.urdf.links[joint.child].collisions
        if joint.movable or not shapes or not WHEEL.search(f"{joint.name} {name}"):
            return None
        if shapes[0].kind == "cylinder":
            T = self.poses[name] @ shapes[0].T_link_geometry
            center, axes = T[:3, 3], T[:3, 2:3]
        else:
            hull = self.model.hulls[name][0]
            center, axes, _ = fit_box(apply(self.poses[name], hull.vertices))
        level = [axis for axis in axes.T if abs(axis[2]) < LEVEL_COSINE]
        round_ = [self._roundness(name, center, axis) for axis in level]
        if max(round_, default=0.0) <= MIN_ROUNDNESS:
            return None
        axle = level[int(np.argmax(round_))]
        own = [joint.name, name, *self.meshes.get(name, ())]
        return Wheel(
            joint.name, name, center, axle / np.linalg.norm(axle),
            caster=bool(_CASTER.search(f"{joint.name} {name}")),
            rollers=any(map(OMNI.search, own)), fixed=True,
        )  # fmt: skip

    def steers_a_rigid_wheel(self, joint: Joint) -> bool:
        """Return whether a joint named steering turns a body on the floor that does not roll."""
        links = self.model.links_below(joint.child)
        points = [apply(self.poses[n], h.vertices) for n in links for h in self.model.hulls[n]]
        if not (joint.movable and points and _names_steering(joint) and self._turns_upright(joint)):
            return False
        return float(np.concatenate(points)[:, 2].min()) - self.ground < WHEEL_TOLERANCE

    def rigid_wheel(self, joint: Joint, axle: Float[np.ndarray, "3"]) -> Wheel:
        """Return the wheel that a steering joint carries, with the axle of another one."""
        center = self.poses[joint.child][:3, 3]
        return self._steered(Wheel(joint.name, joint.child, center, axle), joint)

    def _turns_upright(self, joint: Joint) -> bool:
        return bool(joint.kind != "prismatic" and abs(self._axis(joint)[2]) > 1 - LEVEL_COSINE)

    def _steered(self, wheel: Wheel, turn: Joint) -> Wheel:
        """Return a wheel with the joint that steers it."""
        T = self.poses[turn.child]
        least, most = self._range(turn)
        if self._axis(turn)[2] < 0:
            least, most = -most, -least
        trail = abs(float((wheel.center - T[:3, 3])[:2] @ wheel.ahead))
        return replace(
            wheel, steering=turn.name, least=least, most=most, trail=trail,
            unlimited=_names_steering(turn) and bool(np.isinf(most - least)),
        )  # fmt: skip

    def _range(self, joint: Joint) -> tuple[float, float]:
        """Return the range of a steering joint about its rest value, also of a follower."""
        if joint.mimic is None:
            rest = self.model.rest[joint.name]
            return joint.lower - rest, joint.upper - rest
        leader = self.model.joint(joint.mimic.joint)
        rest, ratio = self.model.rest[leader.name], joint.mimic.ratio
        ends = sorted(ratio * (end - rest) for end in (leader.lower, leader.upper))
        return ends[0], ends[1]


MAX_CONTACT_HEIGHT = 0.015
"""Maximum height of the lowest point of a wheel, since casters and meshes are imprecise [m]."""
_FLAT = 0.005
"""Points of a shape that are this near its lowest one form its contact [m]."""
MIN_WIDTH = 0.1
"""Least width of the area to stand on; less is an axle whose casters are not modeled [m]. The
library robots stand on 0.23 to 0.55 m."""
_UPRIGHT = 0.99
"""Cosine to the vertical of the axis of a drive unit [-]."""
_CORNERS = 24
"""Corners of a circle [-]."""


def support_outline(
    model: Articulated, base_link: str, links: Collection[str]
) -> Float[np.ndarray, "k 2"] | None:
    """Return the outline of the points on which a robot stands, in the base frame [m].

    These are its wheels or, if they are only an axle, all that reaches the floor. Wheels below one
    turning joint (a drive unit that turns under the body) support the circle that lies within them
    wherever the unit is.

    Args:
        model: The robot.
        base_link: Link on the floor, z up.
        links: The links that the arm does not move.

    Returns:
        Corners, counterclockwise; None if what reaches the floor is narrower than `MIN_WIDTH`.
    """
    poses = model.rest_poses
    T_base_root = invert(poses[base_link])
    rolling = {joint.child for joint in model.joints.values() if joint.kind == "continuous"}
    wheels, everything, rolling_links = [], [], []
    for link in links:
        for hull in model.hulls[link]:
            points = apply(T_base_root @ poses[link], hull.vertices)
            lowest = float(points[:, 2].min())
            if lowest > MAX_CONTACT_HEIGHT:
                continue
            contact = points[points[:, 2] < lowest + _FLAT, :2]
            everything.append(contact)
            if link in rolling or WHEEL.search(link):
                wheels.append(contact.mean(0, keepdims=True))
                rolling_links.append(link)
    outlines = (_hull(np.concatenate(found)) for found in (wheels, everything) if found)
    outline = next((outline for outline in outlines if outline is not None), None)
    axis = _turning_unit(model, T_base_root, rolling_links)
    return outline if outline is None or axis is None else _within(outline, axis)


def _turning_unit(
    model: Articulated, T_base_root: Float[np.ndarray, "4 4"], wheels: Collection[str]
) -> Float[np.ndarray, "2"] | None:
    """Return the position of the vertical axis about which all wheels turn together; None if none.

    The unit's joint turns endlessly, as no limit keeps its wheels where they are at rest.
    """
    for joint in model.joints.values():
        if joint.kind == "continuous" and len(wheels) > 1:
            T = T_base_root @ model.rest_poses[joint.child]
            upright = abs((T[:3, :3] @ joint.axis)[2]) > _UPRIGHT
            if upright and set(wheels) <= set(model.links_below(joint.child)) - {joint.child}:
                return T[:2, 3]
    return None


def _within(
    outline: Float[np.ndarray, "k 2"], center: Float[np.ndarray, "2"]
) -> Float[np.ndarray, "c 2"] | None:
    """Return the largest circle about a point within a convex outline; None if it is too small."""
    edge = np.roll(outline, -1, 0) - outline
    normal = np.stack([edge[:, 1], -edge[:, 0]], -1) / np.linalg.norm(edge, axis=1)[:, None]
    radius = float((normal * (outline - center)).sum(1).min())
    if radius < MIN_WIDTH / 2:
        return None
    angle = np.arange(_CORNERS) * 2 * np.pi / _CORNERS
    return center + radius * np.stack([np.cos(angle), np.sin(angle)], -1)


def _hull(points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "k 2"] | None:
    """Return the corners of the convex hull; None if it is too narrow to stand on."""
    hull = convex_hull(points) if len(points) > 2 else points
    if len(hull) < 3:
        return None
    normals = edge_normals(hull)
    inside = (normals * hull).sum(1)[:, None] - normals @ hull.T
    return hull if inside.max(1).min() >= MIN_WIDTH else None
