"""Read rooms in SDF, Gazebo's format: models with links, joints and shapes.

A file is a world or contains single models. Included models are searched inside the root, as
NAME/model.sdf for `model://NAME`. Frames and poses have the meaning of SDF 1.7 and later; older
files differ only in the axes of joints.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree.ElementTree import Element

import numpy as np

from momapos.core import FileFormatError, UrdfError, is_name, read_xml, resolved
from momapos.core.geometry import invert, pose, pose_rpy, rotation_of
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

from .imported_room import (
    MIN_FLOOR_NORMAL_Z,
    ImportedRoom,
    ImportReport,
    Names,
    RoomObject,
    ellipsoid,
    find_inside,
    plane,
)

if TYPE_CHECKING:
    from jaxtyping import Float


def text_of(element: Element, key: str) -> str:
    """Return the text of a child element; "" if it is missing."""
    return (element.findtext(key) or "").strip()


def pose_of(element: Element | None, where: str) -> Float[np.ndarray, "4 4"]:
    """Return the transform of a `pose` element: x y z and roll pitch yaw.

    Raises:
        FileFormatError: The pose is invalid.
    """
    if element is None or not (element.text or "").strip():
        return np.eye(4)
    if element.get("rotation_format", "euler_rpy") != "euler_rpy":
        raise FileFormatError(f"{where}: a pose must be x y z and roll, pitch, yaw")
    x, y, z, *turn = numbers(element.text, 6, f"{where}: pose")
    if element.get("degrees", "false") in ("true", "1"):
        turn = [math.radians(angle) for angle in turn]
    return pose_rpy((x, y, z), tuple(turn))


def numbers(text: str | None, count: int | None, where: str) -> list[float]:
    """Return the numbers in a text.

    Args:
        text: The text.
        count: Required number of values; None for any.
        where: Start of messages.

    Raises:
        FileFormatError: The count is wrong, or a value is invalid.
    """
    found = [number(word, where) for word in (text or "").split()]
    if count is not None and len(found) != count:
        raise FileFormatError(f"{where}: {text!r:.80} must be {count} numbers")
    return found


def number(text: str, where: str) -> float:
    """Return a number.

    Raises:
        FileFormatError: The text is not a finite number of supported size.
    """
    try:
        value = float(text)
    except ValueError as error:
        raise FileFormatError(f"{where}: {text!r:.80} is not a number") from error
    if not abs(value) <= 1e17:
        raise FileFormatError(f"{where}: {text!r:.80} must be finite and at most 1e17")
    return value


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
            stiffness = self._number(holder, "dynamics/spring_stiffness")
            self.report.dropped["springs of joints"] += stiffness != 0.0
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
        mass = self._number(element, "inertial/mass")
        center = T @ pose_of(element.find("inertial/pose"), f"{self.where}: inertial")
        self.links[name] = Link(name, groups[0], groups[1], mass, tuple(center[:3, 3].tolist()))

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
        if shape.tag == "mesh" and shape.find("submesh") is None:
            with suppress(FileFormatError, UrdfError):  # it is lost, or damaged
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


MAX_BYTES = 20_000_000
MAX_MODELS = 2_000
MAX_DEPTH = 50
"""Maximum nesting of elements [-]."""
_SETTINGS = {
    "physics", "scene", "gui", "gravity", "magnetic_field", "atmosphere", "spherical_coordinates",
    "audio", "wind", "state", "frame",
}  # fmt: skip
"""Elements of a world without content of a room."""


def read_room(path: Path, root: Path) -> ImportedRoom:
    """Read a room in SDF.

    Args:
        path: The file.
        root: Folder that no file may leave, and in which models are searched.

    Raises:
        FileFormatError: The file is invalid; one line says what is wrong and where.
    """
    reader = _SdfReader(path, resolved(root))
    reader.read(reader.open(path), np.eye(4), None, path.parent)
    objects = tuple(model.object() for model in reader.models if model.solid)
    nothing = len(reader.models) - len(objects)
    reader.report.dropped["objects without collision shapes"] += nothing
    meshes = {file: mesh for model in reader.models for file, mesh in model.meshes.items()}
    return ImportedRoom(path.stem, objects, meshes, reader.report)


class _SdfReader:
    """Collects the models of a file and of the files it includes."""

    def __init__(self, path: Path, root: Path) -> None:
        self.path, self.root = path, root
        self.report, self.names = ImportReport(), Names()
        self.models: list[Model] = []
        self.open_files: list[Path] = []

    def open(self, path: Path) -> Element:
        """Return the tree of a file."""
        tree = read_xml(path, MAX_BYTES)
        if tree.tag != "sdf":
            raise FileFormatError(f"{path}: the root element is <{tree.tag}>; SDF needs <sdf>")
        level: list[Element] = [tree]
        for _ in range(MAX_DEPTH):
            level = [child for element in level for child in element]
        if level:
            raise FileFormatError(f"{path}: elements are nested deeper than {MAX_DEPTH}")
        return tree

    def read(
        self, tree: Element, T: Float[np.ndarray, "4 4"], name: str | None, folder: Path
    ) -> None:
        """Read all models of a file.

        Args:
            tree: Tree of the file.
            T: Pose of its content.
            name: Name of the included model, whose pose is then `T`; None for a file of models
                with their own names and poses.
            folder: Folder of the file.
        """
        version = number(tree.get("version") or "1.7", f"{self.path}: version")
        worlds = tree.findall("world") or [tree]
        for world in worlds:
            for element in world:
                if element.tag == "include":
                    self._include(element, T, folder)
                elif element.tag == "model":
                    self._model(element, T, name, folder, version)
                elif isinstance(element.tag, str) and element.tag not in _SETTINGS:
                    self.report.dropped[f"{element.tag}s"] += 1

    def _model(
        self,
        element: Element,
        T: Float[np.ndarray, "4 4"],
        name: str | None,
        folder: Path,
        version: float,
    ) -> None:
        if len(self.models) >= MAX_MODELS:
            raise FileFormatError(f"{self.path}: more than {MAX_MODELS} models")
        wanted = name or element.get("name") or ""
        T_world_model = T if name is not None else T @ self._pose(element, wanted)
        model = Model(
            self.names(wanted, "model"), T_world_model, version, self.report, self.path,
            lambda uri: self._file(uri, folder), f"m{len(self.models)}_",
        )  # fmt: skip
        model.read(element)
        self.models.append(model)

    def _pose(self, element: Element, name: str) -> Float[np.ndarray, "4 4"]:
        found = element.find("pose")
        if found is not None and (found.get("relative_to") or "world") != "world":
            raise FileFormatError(
                f"{self.path}: the pose of model {name!r:.80} is relative to "
                f"{found.get('relative_to')!r:.80}; only the world is supported"
            )
        return pose_of(found, f"{self.path}: model {name!r:.80}")

    def _include(self, element: Element, T: Float[np.ndarray, "4 4"], folder: Path) -> None:
        uri = text_of(element, "uri")
        file = self._file(uri, folder, whole=True)
        if file in self.open_files or file == resolved(self.path):
            raise FileFormatError(f"{self.path}: {uri!r:.200} includes itself")
        self.open_files.append(file)
        tree = self.open(file)
        inner = next(tree.iter("model"), None)
        if inner is None:
            raise FileFormatError(f"{file}: contains no model")
        name = text_of(element, "name") or inner.get("name") or file.parent.name
        # A pose of the include replaces the model's own.
        own = element if element.find("pose") is not None else inner
        self.read(tree, T @ self._pose(own, name), name, file.parent)
        self.open_files.pop()

    def _file(self, uri: str, folder: Path, *, whole: bool = False) -> Path:
        """Return the file of a URI inside the root; with `whole`, the SDF file of a model."""
        kind, _, rest = uri.rpartition("://")
        if kind not in ("", "model", "file", "package"):
            raise FileFormatError(
                f"{self.path}: {uri!r:.200}: only model:// and paths are supported"
            )
        place = (folder if kind in ("", "file") else self.root) / rest
        places = [place / "model.sdf", place] if whole else [place]
        return find_inside(uri, places, self.root, self.path)
