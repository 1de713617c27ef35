"""Read URDF files that come from strangers.

yourdfpy parses; this module guards what goes in (no entities, bounded size, no path out of the
root folder) and what comes out (a tree, finite numbers, ordered limits), and hands on frozen
records with everything scaled to meters.
"""

from __future__ import annotations

import io
import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal
from xml.etree.ElementTree import Element, tostring

import numpy as np

from momapos.cache import Cache
from momapos.errors import UrdfError
from momapos.files import parse_xml, read_text_bounded
from momapos.kinematics.kept import once
from momapos.kinematics.mesh_files import MeshFinder

if TYPE_CHECKING:
    from jaxtyping import Float

JointKind = Literal["revolute", "continuous", "prismatic", "fixed"]
MAX_URDF_BYTES = 20_000_000
MAX_LINKS = 5_000
MAX_SHAPES = 2_000
"""Collision elements of a URDF, and visual ones [-]; detailed furniture has some 150."""
MAX_SIZE = 1e4
"""Edge, radius or length of a shape may be this at most [m]; distances too."""
MAX_DEPTH = 50
_COUNTS = {
    "xyz": (3,), "rpy": (3,), "size": (3,), "scale": (1, 3), "radius": (1,), "length": (1,),
    "lower": (1,), "upper": (1,), "velocity": (1,), "effort": (1,),
}  # fmt: skip
"""How many numbers an attribute holds."""
_LENGTHS = {"xyz", "size", "radius", "length", "scale"}
_SHAPES = {
    "box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",),
    "mesh": ("filename",),
}  # fmt: skip
"""The shapes of a URDF and the attributes that each must have."""
_PARTS: dict[str, tuple[str, ...]] = {
    "robot": ("link", "joint"), "link": ("collision", "visual"),
    "collision": ("origin", "geometry"), "visual": ("origin", "geometry"),
    "geometry": tuple(_SHAPES), "joint": ("parent", "child", "origin", "axis", "limit"),
}  # fmt: skip
"""The elements that are used, by the one that holds them."""
_ATTRIBUTES = {*_COUNTS, "name", "type", "link", "filename"}
"""The attributes that are used."""
_OPTENV = re.compile(r"\$\(optenv\s([^()]{0,1000}+)\)")


@dataclass(frozen=True)
class Geometry:
    """One shape of a link."""

    kind: Literal["box", "cylinder", "sphere", "mesh"]
    size: tuple[float, ...]
    """box: edges; cylinder: radius, length; sphere: radius [m]; mesh: scale per axis [-]."""
    T_link_geometry: Float[np.ndarray, "4 4"]
    """Pose in the link frame; cylinders lie along z."""
    name: str = ""
    """Name of the `collision` or `visual` element, often empty."""
    mesh: Path | None = None


@dataclass(frozen=True)
class Link:
    """A rigid body."""

    name: str
    collisions: tuple[Geometry, ...]
    visuals: tuple[Geometry, ...]


@dataclass(frozen=True)
class Joint:
    """A joint between two links."""

    name: str
    kind: JointKind
    parent: str
    child: str
    T_parent_joint: Float[np.ndarray, "4 4"]
    axis: Float[np.ndarray, "3"]
    """Unit axis in the joint frame."""
    lower: float
    upper: float
    """Limits [rad] or [m]; infinite for continuous joints."""
    velocity: float
    """Speed limit [rad/s] or [m/s]; infinite when the file gives none."""
    effort: float = math.inf
    """Greatest torque or force [Nm] or [N]; infinite when the file gives none."""

    @property
    def movable(self) -> bool:
        """Whether the joint moves at all."""
        return self.kind != "fixed"


@dataclass(frozen=True)
class Urdf:
    """A tree of links and joints, parents before children."""

    name: str
    path: Path | None
    root: str
    links: dict[str, Link]
    joints: tuple[Joint, ...]
    scale: float = 1.0
    """What all lengths of the file were multiplied by [-]."""


def read_urdf(
    path: Path,
    *,
    root: Path | None = None,
    scale: float = 1.0,
    cache: Cache | None = None,
    text: str | None = None,
    packages: Mapping[str, Path] | None = None,
) -> Urdf:
    """Read a URDF file.

    Args:
        path: The file.
        root: Folder that no mesh may leave; the file's own folder and every parent up to four
            levels where None (packages keep meshes beside the `urdf` folder).
        scale: Uniform scale of all lengths [-].
        cache: Where what was parsed is kept, so that a file is parsed once.
        text: What is read instead of the file's content, as one who changed it may have it.
        packages: Folders of packages by name; meshes may come from these too.

    Raises:
        UrdfError: The file cannot be used; the message says where and why.
    """
    if not (math.isfinite(scale) and scale > 0):
        raise UrdfError(f"{path}: scale must be a number > 0, not {scale}")
    if text is None:
        text = read_text_bounded(path, MAX_URDF_BYTES, error=UrdfError)
    urdf, meshes = once(
        cache, "urdf", (text, scale), lambda: _parse(text, path, scale),
        (Urdf, Link, Joint, Geometry),
    )  # fmt: skip
    return _with_meshes(urdf, path, iter(meshes), MeshFinder(path, root, packages or {}))


def box_urdf(name: str, size: tuple[float, float, float]) -> Urdf:
    """Build the model of a rigid box, its frame at the center."""
    shape = Geometry("box", size, np.eye(4))
    return Urdf(name, None, "box", {"box": Link("box", (shape,), (shape,))}, ())


def _parse(text: str, path: Path, scale: float) -> tuple[Urdf, tuple[str, ...]]:
    """A checked URDF, its meshes without their files, and how it names these, in order."""
    robot = _with_yourdfpy(_read_tree(text, path), path)
    reader = _Reader(path, scale)
    links = {link.name: reader.link(link) for link in robot.links}
    if len(links) != len(robot.links):
        raise UrdfError(f"{path}: two links share a name; link names must be unique")
    joints = [reader.joint(joint) for joint in robot.joints]
    twin = next((n for n, k in Counter(joint.name for joint in joints).items() if k > 1), None)
    if twin is not None:
        raise UrdfError(f"{path}: two joints are named {twin!r}; names must be unique")
    root_link, ordered = _order(path, links, joints)
    return Urdf(robot.name or path.stem, None, root_link, links, ordered, scale), tuple(
        reader.meshes
    )


def _read_tree(text: str, path: Path) -> Element:
    tree = parse_xml(_OPTENV.sub(_default, text), path, error=UrdfError)
    if tree.tag != "robot":
        raise UrdfError(f"{path}: the root element is <{tree.tag}>, a URDF has <robot>")
    _check_tree(path, tree)
    return tree


def _default(optenv: re.Match[str]) -> str:
    """What `$(optenv NAME DEFAULT)` says where NAME is not set, which here it never is."""
    words = optenv[1].split(None, 1)
    return words[1] if len(words) == 2 else ""


def _check_tree(path: Path, tree: Element) -> None:
    """Refuse what a parser would choke on or, worse, take in silence."""
    if not tree.get("name"):
        raise UrdfError(f"{path}: <robot> has no name")
    if len(tree.findall("link")) > MAX_LINKS or len(tree.findall("joint")) > MAX_LINKS:
        raise UrdfError(f"{path}: more than {MAX_LINKS} links")
    for kind in ("collision", "visual"):
        if len(tree.findall(f"link/{kind}")) > MAX_SHAPES:
            raise UrdfError(f"{path}: more than {MAX_SHAPES} {kind} elements; use simpler shapes")
    level = [tree]
    for _ in range(MAX_DEPTH):
        level = [child for element in level for child in element]
    if level:
        raise UrdfError(f"{path}: elements are nested deeper than {MAX_DEPTH}")
    for part in tree:
        if not isinstance(part.tag, str):
            continue
        if "xacro" in part.tag:
            raise UrdfError(f"{path}: holds xacro macros; expand it first: xacro IN > OUT.urdf")
        if part.tag in ("link", "joint"):
            name = part.get("name", "")
            if not name.strip() or not name.isprintable() or len(name) > 500:
                raise UrdfError(f"{path}: a {part.tag} has no usable name: {name!r:.60}")
            _check_part(part, f"{path}: {part.tag} {name!r}")


def _check_part(part: Any, where: str) -> None:
    """Check the numbers and shapes of a link or joint; commas stand for spaces."""
    for element in part.iter():
        if element.tag == "geometry":
            _check_geometry(element, where)
        if element.tag in ("collision", "visual") and element.find("geometry") is None:
            raise UrdfError(f"{where}: a <{element.tag}> has no <geometry>")
        for key in _COUNTS.keys() & set(element.keys()):
            if element.tag in ("texture", "color"):
                continue
            text = element.get(key)
            values = [_float(word) for word in text.replace(",", " ").split()]
            if len(values) not in _COUNTS[key] or not all(map(math.isfinite, values)):
                count = " or ".join(map(str, _COUNTS[key]))
                raise UrdfError(
                    f"{where}: {key}={text!r:.80} in <{element.tag}> must be {count} finite "
                    f"number{'s' * (count != '1')}"
                )
            if key in _LENGTHS and max(map(abs, values)) > MAX_SIZE:
                raise UrdfError(f"{where}: {key}={text!r:.80} is larger than {MAX_SIZE:g}")
            if key in ("size", "radius", "length") and min(values) <= 0:
                raise UrdfError(f"{where}: {key}={text!r:.80} in <{element.tag}> must be > 0")
    if part.tag == "joint":
        for end in ("parent", "child"):
            element = part.find(end)
            if element is None:
                raise UrdfError(f"{where} has no <{end}>")
            if not element.get("link"):
                raise UrdfError(f"{where}: <{end}> has no link")


def _check_geometry(geometry: Any, where: str) -> None:
    tags = [child.tag for child in geometry]
    if len(tags) != 1 or tags[0] not in _SHAPES:
        found, shapes = ", ".join(map(str, tags)) or "nothing", ", ".join(_SHAPES)
        raise UrdfError(f"{where}: <geometry> holds {found:.80}; it must be one of {shapes}")
    for key in _SHAPES[tags[0]]:
        if not geometry[0].get(key):
            raise UrdfError(f"{where}: <{tags[0]}> has no {key}")


def _float(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        return math.nan


def _with_yourdfpy(tree: Element, path: Path) -> Any:
    import yourdfpy

    robot = Element("robot", name=tree.get("name", ""))
    for part in tree:
        if part.tag in _PARTS["robot"]:
            robot.append(_needed(part))
    text = tostring(robot)
    try:
        urdf = yourdfpy.URDF.load(io.BytesIO(text), build_scene_graph=False, load_meshes=False)
    except Exception as error:  # yourdfpy raises whatever its parser met
        raise UrdfError(f"{path}: not a usable URDF ({error})") from error
    if not urdf.robot.links:
        raise UrdfError(f"{path}: has no links")
    return urdf.robot


def _needed(element: Element) -> Element:
    """A part of the tree with what is needed alone, so that no parser meets the rest."""
    found = Element(element.tag)
    for key, value in element.items():
        if key in _ATTRIBUTES:
            found.set(key, value.replace(",", " ") if key in _COUNTS else value)
    for child in element:
        if child.tag in _PARTS.get(element.tag, ()):
            found.append(_needed(child))
    return found


class _Reader:
    """Turns yourdfpy's records into ours, scaled and checked."""

    def __init__(self, path: Path, scale: float) -> None:
        self.path, self.scale = path, scale
        self.meshes: list[str] = []

    def link(self, link: Any) -> Link:
        shapes = [
            tuple(self.geometry(link.name, item) for item in items if item.geometry is not None)
            for items in (link.collisions, link.visuals)
        ]
        return Link(link.name, shapes[0], shapes[1])

    def geometry(self, link: str, item: Any) -> Geometry:
        T, g, s = self.transform(item.origin), item.geometry, self.scale
        name = item.name or ""
        if g.mesh is not None:
            factor = np.ones(3) if g.mesh.scale is None else np.broadcast_to(g.mesh.scale, 3)
            shape = Geometry("mesh", tuple(s * factor), T, name)
            self.meshes.append(g.mesh.filename)
        elif g.box is not None:
            shape = Geometry("box", tuple(s * np.asarray(g.box.size, float)), T, name)
        elif g.cylinder is not None:
            shape = Geometry("cylinder", (s * g.cylinder.radius, s * g.cylinder.length), T, name)
        elif g.sphere is not None:
            shape = Geometry("sphere", (s * g.sphere.radius,), T, name)
        else:
            raise UrdfError(f"{self.path}: a shape of link {link!r} has no geometry")
        sizes = np.abs(shape.size)
        if not (len(sizes) and np.isfinite(sizes).all() and sizes.min() > 0):
            raise UrdfError(f"{self.path}: a {shape.kind} of link {link!r} has size {shape.size}")
        return shape

    def transform(self, origin: Any) -> Float[np.ndarray, "4 4"]:
        T = np.eye(4) if origin is None else np.array(origin, float)
        T[:3, 3] *= self.scale
        return T

    def joint(self, joint: Any) -> Joint:
        kind, where = joint.type, f"{self.path}: joint {joint.name!r}"
        if kind not in ("revolute", "continuous", "prismatic", "fixed"):
            raise UrdfError(
                f"{where} is {kind!r}; revolute, continuous, prismatic and fixed are supported"
            )
        axis = np.array([1.0, 0.0, 0.0] if joint.axis is None else joint.axis, float)
        length = float(np.linalg.norm(axis))
        if kind != "fixed" and length < 1e-9:
            raise UrdfError(f"{where} has a zero axis")
        lower, upper = self.limits(where, kind, joint.limit)
        velocity = getattr(joint.limit, "velocity", None) or math.inf
        effort = getattr(joint.limit, "effort", None) or math.inf
        unit = axis / length if length > 1e-9 else axis
        T = self.transform(joint.origin)
        return Joint(
            joint.name, kind, joint.parent, joint.child, T, unit, lower, upper, velocity, effort
        )

    def limits(self, where: str, kind: str, limit: Any) -> tuple[float, float]:
        if kind == "fixed":
            return 0.0, 0.0
        lower, upper = getattr(limit, "lower", None), getattr(limit, "upper", None)
        if kind == "continuous" or (lower is None and upper is None):
            return -math.inf, math.inf
        factor = self.scale if kind == "prismatic" else 1.0
        lower, upper = factor * (lower or 0.0), factor * (upper or 0.0)
        if lower > upper:
            raise UrdfError(f"{where} has lower limit {lower:g} above upper limit {upper:g}")
        return lower, upper


def _with_meshes(urdf: Urdf, path: Path, names: Iterator[str], finder: MeshFinder) -> Urdf:
    """Put the files of a URDF and of its meshes, in the order they were parsed, into a record."""

    def found(shape: Geometry) -> Geometry:
        return replace(shape, mesh=finder.find(next(names))) if shape.kind == "mesh" else shape

    links = {
        name: Link(name, tuple(map(found, link.collisions)), tuple(map(found, link.visuals)))
        for name, link in urdf.links.items()
    }
    return replace(urdf, path=path, links=links)


def _order(
    path: Path, links: dict[str, Link], joints: list[Joint]
) -> tuple[str, tuple[Joint, ...]]:
    """Sort joints parents first and make sure that they form one tree."""
    by_parent: dict[str, list[Joint]] = {}
    parents: dict[str, str] = {}
    for joint in joints:
        for link in (joint.parent, joint.child):
            if link not in links:
                raise UrdfError(f"{path}: joint {joint.name!r} names a missing link {link!r}")
        if joint.child in parents:
            raise UrdfError(f"{path}: link {joint.child!r} has two parents (a loop); need a tree")
        parents[joint.child] = joint.parent
        by_parent.setdefault(joint.parent, []).append(joint)
    roots = [name for name in links if name not in parents]
    if not roots:
        raise UrdfError(f"{path}: the joints form a loop; a URDF must be a tree")
    ordered: list[Joint] = []
    queue = [roots[0]]
    while queue:
        for joint in by_parent.get(queue.pop(0), []):
            ordered.append(joint)
            queue.append(joint.child)
    if len(ordered) != len(joints):
        raise UrdfError(f"{path}: the joints form a loop; a URDF must be a tree")
    if len(roots) > 1:
        raise UrdfError(f"{path}: links {roots[0]!r} and {roots[1]!r} are not connected")
    return roots[0], tuple(ordered)
