"""Convert a model of an SDF file to an object of ours."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree.ElementTree import Element

import numpy as np

from momapos.core import FileFormatError, is_name
from momapos.core.geometry import invert, pose, rotation_of
from momapos.model.urdf import (
    Geometry,
    Joint,
    JointKind,
    Link,
    Mesh,
    Mimic,
    Urdf,
    capsule_shapes,
    leader_of,
    mesh_triangles,
)

from .composed_shapes import MIN_FLOOR_NORMAL_Z, ellipsoid, plane
from .imported_room import ImportReport, Names, RoomObject
from .sdf_values import number, numbers, pose_of, text_of

if TYPE_CHECKING:
    from jaxtyping import Float

MAX_LIMIT = 1e15
"""Magnitude beyond which a limit means unlimited [rad] or [m]; SDF's default is 1e16."""
MAX_SIZE = 1e4
"""Maximum coordinate and size [m]."""
_KINDS: dict[str, JointKind] = {
    "revolute": "revolute", "continuous": "continuous", "prismatic": "prismatic", "fixed": "fixed",
}  # fmt: skip


@dataclass(eq=False)
class Model:
    """Collects the links and joints of a model."""

    name: str
    T_world_model: Float[np.ndarray, "4 4"]
    version: float
    """Version of SDF."""
    report: ImportReport
    path: Path
    """SDF file, for messages."""
    find: Callable[[str], Path]
    """Finds the file of a mesh."""
    prefix: str
    """Prefix of the file names of its meshes."""
    meshes: dict[Path, Mesh] = field(default_factory=dict)
    links: dict[str, Link] = field(default_factory=dict)
    joints: list[Joint] = field(default_factory=list)
    frames: dict[str, tuple[str, Float[np.ndarray, "4 4"]]] = field(default_factory=dict)
    """Reference frame and pose of each link, joint and frame."""

    @property
    def where(self) -> str:
        """Start of messages."""
        return f"{self.path}: model {self.name!r:.80}"

    @property
    def solid(self) -> bool:
        """Whether it has collision shapes."""
        return any(link.collisions for link in self.links.values())

    def object(self) -> RoomObject:
        """Return the object."""
        urdf = Urdf(self.name, None, next(iter(self.links)), self.links, tuple(self.joints))
        return RoomObject(self.name, self.T_world_model, urdf)

    def read(self, element: Element) -> None:
        """Read the element of the model.

        Raises:
            FileFormatError: The model is invalid.
        """
        if element.find("model") is not None or element.find("include") is not None:
            raise FileFormatError(f"{self.where} contains other models, which is not supported")
        for tag in ("plugin", "gripper"):
            self.report.dropped[f"{tag}s"] += len(element.findall(tag))
        self._collect_frames(element)
        links = {self._name(link): link for link in element.findall("link")}
        joints = {self._name(joint): joint for joint in element.findall("joint")}
        moving = self._moving(joints, links)
        origins = {
            name: self._pose(self._name(moving[name]) if name in moving else name) for name in links
        }
        names = Names()
        for name in links:
            names(name, "link")
        base = names("base", "base")
        origins[base] = np.eye(4)
        self.links[base] = Link(base, (), ())
        for name, link in links.items():
            self._add_link(name, link, origins[name])
            self._add_joint(name, moving.get(name), base, origins)
        self._couple(joints)

    def _collect_frames(self, element: Element) -> None:
        for tag, key in (("link", None), ("joint", "child"), ("frame", None)):
            for part in element.findall(tag):
                name, found = self._name(part), part.find("pose")
                if name in self.frames:
                    raise FileFormatError(f"{self.where}: two parts are named {name!r:.80}")
                attached = text_of(part, key) if key else part.get("attached_to", "")
                named = "" if found is None else found.get("relative_to", found.get("frame", ""))
                T = pose_of(found, f"{self.where}: {tag} {name!r:.80}")
                self.frames[name] = named or attached or "__model__", T

    def _pose(self, name: str) -> Float[np.ndarray, "4 4"]:
        T, seen = np.eye(4), {name}
        while name != "__model__":
            if name not in self.frames:
                raise FileFormatError(f"{self.where}: there is no frame {name!r:.80}")
            name, T_parent = self.frames[name]
            T = T_parent @ T
            if name in seen:
                raise FileFormatError(f"{self.where}: frame {name!r:.80} is relative to itself")
            seen.add(name)
        return T

    def _name(self, element: Element) -> str:
        name = element.get("name", "")
        if not is_name(name, longest=200):
            raise FileFormatError(
                f"{self.where}: the name of a {element.tag} must be printable, 1 to 200 characters "
                f"long, not {name!r:.60}"
            )
        return name

    def _moving(self, joints: dict[str, Element], links: dict[str, Element]) -> dict[str, Element]:
        """Return the joint that moves each link, by the name of the link."""
        found: dict[str, Element] = {}
        for name, joint in joints.items():
            parent, child = text_of(joint, "parent"), text_of(joint, "child")
            for end in (parent, child):
                if end not in links and end != "world":
                    raise FileFormatError(
                        f"{self.where}: joint {name!r:.80} names link {end!r:.80}, which does not "
                        "exist"
                    )
            if child == "world" or child in found:
                raise FileFormatError(
                    f"{self.where}: joint {name!r:.80} closes a loop; joints must form a tree"
                )
            found[child] = joint
        return found

    def _add_joint(
        self,
        link: str,
        element: Element | None,
        base: str,
        origins: dict[str, Float[np.ndarray, "4 4"]],
    ) -> None:
        """Attach a link to its parent, or to the model's base if it has none."""
        parent = "world" if element is None else text_of(element, "parent")
        parent = base if parent == "world" else parent
        name = f"{link}_fixed" if element is None else self._name(element)
        T = invert(origins[parent]) @ origins[link]
        kind = "fixed" if element is None else element.get("type", "")
        if kind not in _KINDS:
            self.report.approximated[f"{kind} joints as fixed"] += 1
        found = _KINDS.get(kind, "fixed")
        axis, lower, upper = np.array([0.0, 0.0, 1.0]), 0.0, 0.0
        friction = damping = 0.0
        if element is not None and found != "fixed":
            holder = element.find("axis")
            if holder is None:
                raise FileFormatError(f"{self.where}: joint {name!r:.80} has no axis")
            axis = self._axis(holder, origins[link], name)
            lower, upper = self._limits(holder, name)
            if found == "continuous" or not (math.isfinite(lower) and math.isfinite(upper)):
                found = "prismatic" if found == "prismatic" else "continuous"
                lower, upper = -math.inf, math.inf
            friction = self._number(holder, "dynamics/friction")
            damping = self._number(holder, "dynamics/damping")
        joint = Joint(name, found, parent, link, T, axis, lower, upper, math.inf)
        self.joints.append(replace(joint, friction=friction, damping=damping))

    def _couple(self, joints: dict[str, Element]) -> None:
        """Make joints follow others where the file says so (`mimic`, SDFormat 1.11).

        Joints with two axes are fixed here, so what follows them or what they follow is dropped.
        """
        movable = {joint.name for joint in self.joints if joint.movable}
        follows: dict[str, Mimic] = {}
        for name, element in joints.items():
            for axis in ("axis", "axis2"):
                mimic = element.find(f"{axis}/mimic")
                if mimic is None:
                    continue
                found = self._mimic(mimic, name, joints)
                if name in movable and found.joint in movable:
                    follows[name] = found
                else:
                    self.report.dropped["mimic joints"] += 1
        leaders = {n: leader_of(n, follows, self.where, FileFormatError) for n in follows}
        self.joints = [replace(joint, mimic=leaders.get(joint.name)) for joint in self.joints]

    def _mimic(self, element: Element, name: str, joints: dict[str, Element]) -> Mimic:
        """Return a relation: follower = multiplier * (leader - reference) + offset."""
        where = f"{self.where}: joint {name!r:.80}: mimic"
        other, axis = element.get("joint", ""), element.get("axis", "axis")
        if other not in joints:
            raise FileFormatError(f"{where} names the joint {other!r:.80}, which does not exist")
        if axis not in ("axis", "axis2") or joints[other].find(axis) is None:
            raise FileFormatError(f"{where} names {axis!r:.40}, which {other!r:.80} does not have")
        keys = {"multiplier": 1.0, "offset": 0.0, "reference": 0.0}
        ratio, offset, reference = (self._number(element, key, v) for key, v in keys.items())
        if max(map(abs, (ratio, offset, reference))) > MAX_SIZE:
            raise FileFormatError(f"{where}: its numbers must be at most {MAX_SIZE:g}")
        return Mimic(other, ratio, offset - ratio * reference)

    def _axis(
        self, holder: Element, T_model_joint: Float[np.ndarray, "4 4"], joint: str
    ) -> Float[np.ndarray, "3"]:
        """Return the axis of a joint in its own frame."""
        where = f"{self.where}: joint {joint!r:.80}: axis"
        xyz, frame = holder.find("xyz"), ""
        axis = np.array([0.0, 0.0, 1.0])
        if xyz is not None:
            axis = np.array(numbers(xyz.text, 3, where))
            frame = xyz.get("expressed_in", "")
        if text_of(holder, "use_parent_model_frame") in ("1", "true") and self.version < 1.65:
            frame = "__model__"
        if frame:
            axis = T_model_joint[:3, :3].T @ self._pose(frame)[:3, :3] @ axis
        length = float(np.linalg.norm(axis))
        if length < 1e-9:
            raise FileFormatError(f"{where} must not be zero")
        return axis / length

    def _limits(self, holder: Element, joint: str) -> tuple[float, float]:
        lower = self._number(holder, "limit/lower", -math.inf)
        upper = self._number(holder, "limit/upper", math.inf)
        if lower > upper:
            raise FileFormatError(
                f"{self.where}: joint {joint!r:.80} has a lower limit {lower:g} above the upper "
                f"limit {upper:g}"
            )
        return (
            lower if lower > -MAX_LIMIT else -math.inf,
            upper if upper < MAX_LIMIT else math.inf,
        )

    def _number(self, element: Element, key: str, otherwise: float = 0.0) -> float:
        text = text_of(element, key)
        words = text.lower().lstrip("+-")
        if words in ("inf", "infinity"):
            return -math.inf if text.startswith("-") else math.inf
        return number(text, f"{self.where}: {key}") if text else otherwise

    def _add_link(
        self, name: str, element: Element, T_model_origin: Float[np.ndarray, "4 4"]
    ) -> None:
        """Add a link.

        Args:
            name: Name of the link.
            element: Its element.
            T_model_origin: Pose of our link, whose origin is that of its joint.
        """
        T = invert(T_model_origin) @ self._pose(name)
        T_world_origin = self.T_world_model @ T_model_origin
        groups = []
        for tag in ("collision", "visual"):
            shapes: list[Geometry] = []
            for part in element.findall(tag):
                shapes += self._shapes(part, T, T_world_origin, solid=tag == "collision")
            groups.append(tuple(shapes))
        for tag in ("sensor", "light"):
            self.report.dropped[f"{tag}s"] += len(element.findall(tag))
        self.links[name] = Link(name, groups[0], groups[1])

    def _shapes(
        self,
        part: Element,
        T: Float[np.ndarray, "4 4"],
        T_world_origin: Float[np.ndarray, "4 4"],
        *,
        solid: bool,
    ) -> list[Geometry]:
        name, where = part.get("name", "")[:200], f"{self.where}: {part.tag}"
        T = T @ pose_of(part.find("pose"), where)
        geometry = part.find("geometry")
        kinds = [] if geometry is None else list(geometry)
        if len(kinds) != 1:
            raise FileFormatError(f"{where} {name!r:.80} has no shape")
        (shape,) = kinds

        def sizes(*keys: str) -> list[float]:
            found = [v for key in keys for v in numbers(text_of(shape, key), None, where)]
            if not found or min(found) <= 0 or max(found) > MAX_SIZE:
                raise FileFormatError(f"{where} {name!r:.80}: sizes must be > 0, not {found}")
            return found

        if shape.tag == "box":
            return [Geometry("box", tuple(sizes("size")), T, name)]
        if shape.tag == "sphere":
            return [Geometry("sphere", tuple(sizes("radius")), T, name)]
        if shape.tag in ("cylinder", "cone"):
            self.report.approximated["cones as cylinders"] += shape.tag == "cone" and solid
            return [Geometry("cylinder", tuple(sizes("radius", "length")), T, name)]
        if shape.tag == "capsule":
            radius, length = sizes("radius", "length")
            return capsule_shapes(radius, length, T, name)
        if shape.tag == "ellipsoid":
            a, b, c = sizes("radii")
            self.report.approximated["ellipsoids as meshes"] += solid
            made, file, mesh = ellipsoid((a, b, c), T, name)
            self.meshes[file] = mesh
            return [made]
        if shape.tag == "plane":
            return self._plane(shape, T, T_world_origin[2, :3], name, where, solid=solid)
        if shape.tag == "mesh" and solid:
            return [self._mesh(shape, T, name, where)]
        self.report.dropped["visual meshes" if shape.tag == "mesh" else f"{shape.tag} shapes"] += 1
        return []

    def _plane(
        self,
        shape: Element,
        T: Float[np.ndarray, "4 4"],
        up: Float[np.ndarray, "3"],
        name: str,
        where: str,
        *,
        solid: bool,
    ) -> list[Geometry]:
        """Return a box behind a plane of the drawn size, unless the plane is a floor."""
        normal = np.array(numbers(text_of(shape, "normal") or "0 0 1", 3, where))
        length = float(np.linalg.norm(normal))
        if length < 1e-9:
            raise FileFormatError(f"{where} {name!r:.80}: the normal of a plane must not be zero")
        upward = up @ T[:3, :3] @ normal / length
        if not solid or abs(upward) >= MIN_FLOOR_NORMAL_Z:
            self.report.dropped["floors"] += solid
            return []
        self.report.approximated["bounded planes as boxes"] += 1
        x, y = numbers(text_of(shape, "size") or "1 1", 2, where)
        turn = pose(np.zeros(3), _turned_to(normal / length))
        return [plane(x, y, T @ turn, name)]

    def _mesh(self, shape: Element, T: Float[np.ndarray, "4 4"], name: str, where: str) -> Geometry:
        if shape.find("submesh") is not None:
            self.report.approximated["submeshes as whole meshes"] += 1
        scale = np.array(numbers(text_of(shape, "scale") or "1 1 1", 3, where))
        corners = mesh_triangles(self.find(text_of(shape, "uri"))) * scale
        points, faces = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
        file = Path(f"{self.prefix}mesh{len(self.meshes)}.obj")
        self.meshes[file] = Mesh(points, faces.reshape(-1, 3).astype(np.int64))
        return Geometry("mesh", (1.0, 1.0, 1.0), T, name, file)


def _turned_to(normal: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Return the smallest rotation that maps z to a unit vector."""
    across = np.array([-normal[1], normal[0], 0.0])
    length = float(np.linalg.norm(across))
    angle = math.atan2(length, normal[2])
    axis = across / length if length > 1e-9 else np.array([1.0, 0.0, 0.0])
    return rotation_of(angle * axis)
