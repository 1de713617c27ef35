"""URDFs with the additions of a robot file: frames, a mount, packages, mimic joints, limits."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, tostring

from momapos.core import (
    Cache,
    RobotError,
    UrdfError,
    parse_xml,
    read_text_bounded,
    resolved,
    unknown_name,
)
from momapos.core.geometry import rpy_of
from momapos.model.urdf import (
    MAX_MESH_PARENTS,
    MAX_URDF_BYTES,
    MeshFinder,
    Mimic,
    Urdf,
    check_coupled,
    fix_root_joints,
    in_convex_pieces,
    leader_of,
    link_of,
    mimics,
    origin_pose,
    read_tree,
    read_urdf,
)

Triple = tuple[float, float, float]
ZERO: Triple = (0.0, 0.0, 0.0)
BOX = "box_base"
"""Link of a box that carries an arm; its frame is on the floor."""
_PREFIX = "mount_"


@dataclass(frozen=True)
class AddedFrame:
    """A link without geometry, fixed to another link."""

    name: str
    parent: str
    xyz: Triple = ZERO
    """[m]"""
    rpy: Triple = ZERO
    """[rad]"""


@dataclass(frozen=True)
class Mount:
    """Carrier of an arm: a box, or a base with its own URDF."""

    xyz: Triple = ZERO
    """Origin of the arm's root in the carrying link [m]."""
    rpy: Triple = ZERO
    """[rad]"""
    box: Triple | None = None
    """Edge lengths [m]."""
    urdf: Path | None = None
    link: str = ""
    """Link of the base that carries the arm; "" for its root."""


@dataclass(frozen=True)
class Amendments:
    """Additions of a robot file to its URDF."""

    frames: tuple[AddedFrame, ...] = ()
    mount: Mount | None = None
    packages: Mapping[str, Path] = field(default_factory=dict)
    """Package folders by name."""
    coupled: Mapping[str, Mimic] = field(default_factory=dict)
    """Mimic joints by name; they replace those of the URDF."""
    limits: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Limits of joints, by joint and by name as in `<limit>`; they replace those of the URDF."""
    visual_hulls: bool = False
    """Whether bodies without collision shapes get the hulls of what is drawn."""
    content: str | None = None
    """Content of the URDF, if it is not in a file yet."""
    drawn: bool = False
    """Whether links have the shapes that are drawn instead of those for collisions, as far as their
    meshes exist."""

    @property
    def none(self) -> bool:
        """Whether the URDF is used unchanged."""
        tables = self.frames, self.mount, self.packages, self.coupled, self.limits
        return not (any(tables) or self.visual_hulls or self.content or self.drawn)

    def text(self, urdf: Path) -> str | None:
        """Return the URDF with all additions and absolute mesh paths; None if it is unchanged.

        Raises:
            UrdfError: A file is invalid, or a mesh is missing.
            UnknownNameError: A frame or the mount names an unknown link, or a mimic joint an
                unknown joint.
            RobotError: A frame's name is taken, a joint follows itself, or a ratio or offset is
                invalid.
        """
        if self.none:
            return None
        tree = self._read(urdf, self.content)
        if self.mount is not None:
            tree = _mounted(tree, self.mount, self._read)
        links = [link.get("name", "") for link in tree.iter("link") if link.get("name")]
        for frame in self.frames:
            if frame.name in links:
                raise RobotError(
                    f"{urdf}: frame {frame.name!r} already is a link of the URDF; choose another "
                    "name"
                )
            if frame.parent not in links:
                raise unknown_name("link", frame.parent, links, f"{urdf} (frame {frame.name!r})")
            tree.append(Element("link", name=frame.name))
            fix(tree, frame.parent, frame.name, frame.xyz, frame.rpy)
            links.append(frame.name)
        _couple(tree, self.coupled, urdf)
        _limit(tree, self.limits, urdf)
        return tostring(tree, encoding="unicode")

    def read(self, urdf: Path, cache: Cache | None = None) -> tuple[Urdf, str | None]:
        """Read a URDF with all additions, its hollow meshes in convex pieces.

        Returns:
            The model, and its `text`.

        Raises:
            UrdfError, UnknownNameError, RobotError: See `text` and `read_urdf`.
        """
        text = self.text(urdf)
        if text is None:
            model = read_urdf(urdf, cache=cache, visuals=False, actuated=True)
        else:
            model = read_urdf(urdf, cache=cache, text=text, find_mesh=Path, actuated=True)
            check_coupled(model, self.coupled, f"{urdf} (coupled)")
        return in_convex_pieces(model, cache), text

    def _read(self, urdf: Path, content: str | None = None) -> Element:
        """Return the XML tree of a URDF with absolute mesh paths."""
        text = (
            read_text_bounded(urdf, MAX_URDF_BYTES, error=UrdfError) if content is None else content
        )
        tree = read_tree(text, urdf)
        finder = MeshFinder(urdf, packages=self.packages)
        for origin in tree.iter("origin"):
            if origin.get("quat_xyzw") is not None:  # readers of plans may know URDF 1.0 only
                origin.set("rpy", _words(rpy_of(origin_pose(origin)[:3, :3])))
                del origin.attrib["quat_xyzw"]
        if self.visual_hulls:
            _draw_collisions(tree)
        if self.drawn:
            _keep_drawn(tree, finder)
        for link in tree.iter("link"):
            for visual in link.findall("visual"):  # not used, and their meshes are often missing
                link.remove(visual)
        finder.check_packages(mesh.get("filename", "") for mesh in tree.iter("mesh"))
        for mesh in tree.iter("mesh"):
            mesh.set("filename", str(finder.find(mesh.get("filename", ""))))
        return tree


def _draw_collisions(tree: Element) -> None:
    """Give bodies without collision shapes those that are drawn; fixed joints join a body."""
    body = {link.get("name", ""): link.get("name", "") for link in tree.findall("link")}
    for joint in tree.findall("joint"):
        if joint.get("type") == "fixed":
            one, other = (body.get(link_of(joint, end), "") for end in ("parent", "child"))
            body = {name: one if root == other else root for name, root in body.items()}
    solid = {body[link.get("name", "")] for link in tree.findall("link[collision]")}
    for link in tree.findall("link[visual]"):
        if body[link.get("name", "")] not in solid:
            for visual in link.findall("visual"):
                visual.tag = "collision"


def _keep_drawn(tree: Element, finder: MeshFinder) -> None:
    """Replace the collision shapes of links by what is drawn, without meshes that are missing."""
    for link in tree.findall("link"):
        for shape in link.findall("collision"):
            link.remove(shape)
        for visual in link.findall("visual"):
            try:
                for mesh in visual.iter("mesh"):
                    finder.find(mesh.get("filename", ""))
                visual.tag = "collision"
            except UrdfError:
                continue


def _couple(tree: Element, follows: Mapping[str, Mimic], urdf: Path) -> None:
    where = f"{urdf} (coupled)"
    movable = {j.get("name", ""): j for j in tree.findall("joint") if j.get("type") != "fixed"}
    for name, mimic in follows.items():
        for joint in (name, mimic.joint):
            if joint not in movable:
                raise unknown_name("movable joint", joint, movable, where)
        if not (math.isfinite(mimic.ratio) and mimic.ratio and math.isfinite(mimic.offset)):
            raise RobotError(f"{where}: {name!r} needs a nonzero ratio and a finite offset")
        for element in movable[name].findall("mimic"):
            movable[name].remove(element)
        numbers = {"multiplier": f"{mimic.ratio:.17g}", "offset": f"{mimic.offset:.17g}"}
        SubElement(movable[name], "mimic", {"joint": mimic.joint, **numbers})
    every = mimics(tree, urdf, 1.0)
    for name in follows:
        leader_of(name, every, where, RobotError)


def _limit(tree: Element, limits: Mapping[str, Mapping[str, float]], urdf: Path) -> None:
    """Replace limits of joints. A range replaces soft limits, and ends the turns of a joint."""
    movable = {j.get("name", ""): j for j in tree.findall("joint") if j.get("type") != "fixed"}
    for name, values in limits.items():
        joint = movable.get(name)
        if joint is None:
            raise unknown_name("movable joint", name, movable, f"{urdf} (limits)")
        limit = joint.find("limit")
        limit = SubElement(joint, "limit") if limit is None else limit
        for key, value in values.items():
            limit.set(key, f"{value:.17g}")
        if "acceleration" in values:
            limit.attrib.pop("deceleration", None)
        if values.keys() & {"lower", "upper"}:
            for safety in joint.findall("safety_controller"):
                joint.remove(safety)
            if joint.get("type") == "continuous" and not values.keys() >= {"lower", "upper"}:
                raise RobotError(f"{urdf} (limits): {name!r} has no limits; give lower and upper")
            if joint.get("type") == "continuous":
                joint.set("type", "revolute")


def portable(text: str, folder: Path, what: str) -> str:
    """Return a URDF for a file in a folder, with mesh paths relative to it.

    Raises:
        RobotError: A mesh is outside the folders that readers of the file search.
    """
    tree = parse_xml(text, Path(what), error=RobotError)
    here = resolved(folder)
    root = [here, *here.parents][: MAX_MESH_PARENTS + 1][-1]
    for mesh in tree.iter("mesh"):
        name = Path(mesh.get("filename", ""))
        if not name.is_relative_to(root):
            raise RobotError(
                f"{what}: the robot's mesh {name} is outside {root}, so the plan could not be "
                f"verified; write the plan within {MAX_MESH_PARENTS} folders of one that contains "
                "both"
            )
        mesh.set("filename", Path(os.path.relpath(name, here)).as_posix())
    return tostring(tree, encoding="unicode")


def _mounted(arm: Element, mount: Mount, read: Callable[[Path], Element]) -> Element:
    """Return a base with an arm on it, under the arm's name."""
    fix_root_joints(arm)
    if mount.urdf is None:
        assert mount.box is not None
        base, carrier = _box(mount.box), BOX
    else:
        base = read(mount.urdf)
        carrier = mount.link or root_of(base)
        names = [link.get("name", "") for link in base.findall("link")]
        if carrier not in names:
            raise unknown_name("link", carrier, names, f"{mount.urdf} (mount.link)")
        carrier = _rename(base, arm).get(carrier, carrier)
    root = root_of(arm)
    base.set("name", arm.get("name", ""))
    fix(base, carrier, root, mount.xyz, mount.rpy)
    base.extend(part for part in arm if part.tag in ("link", "joint"))
    return base


def _box(size: Triple) -> Element:
    base = Element("robot", name="box")
    link = SubElement(base, "link", name=BOX)
    shape = SubElement(link, "collision")
    SubElement(shape, "origin", xyz=_words((0.0, 0.0, size[2] / 2)), rpy="0 0 0")
    SubElement(SubElement(shape, "geometry"), "box", size=_words(size))
    return base


def root_of(tree: Element) -> str:
    """Return the link that no joint moves."""
    children = {child.get("link") for child in tree.findall("joint/child")}
    names = [link.get("name", "") for link in tree.findall("link")]
    return next((name for name in names if name not in children), names[0] if names else "")


def _rename(base: Element, arm: Element) -> dict[str, str]:
    """Rename links and joints of the base whose names the arm uses, too; return those of links."""
    renamed: dict[str, dict[str, str]] = {}
    for tag in ("link", "joint"):
        taken = {part.get("name") for part in arm.findall(tag)}
        names = [part.get("name", "") for part in base.findall(tag)]
        renamed[tag] = {name: f"{_PREFIX}{name}" for name in names if name in taken}
    rename(base, renamed)
    return renamed["link"]


def rename(tree: Element, renamed: Mapping[str, Mapping[str, str]]) -> None:
    """Rename links and joints of a URDF, wherever it names them.

    Args:
        tree: The URDF.
        renamed: New names by old ones, for "link" and for "joint".
    """
    places = (
        ("link", "link", "name"), ("joint", "joint", "name"), ("link", "joint/parent", "link"),
        ("link", "joint/child", "link"), ("joint", "joint/mimic", "joint"),
    )  # fmt: skip
    for tag, place, attribute in places:
        for element in tree.findall(place):
            name = element.get(attribute, "")
            element.set(attribute, renamed[tag].get(name, name))


def fix(tree: Element, parent: str, child: str, xyz: Triple, rpy: Triple) -> None:
    """Add a fixed joint between two links of a URDF [m], [rad]."""
    joint = SubElement(tree, "joint", name=f"{child}_fixed_to_{parent}", type="fixed")
    SubElement(joint, "parent", link=parent)
    SubElement(joint, "child", link=child)
    SubElement(joint, "origin", xyz=_words(xyz), rpy=_words(rpy))


def _words(values: Triple) -> str:
    return " ".join(repr(float(value)) for value in values)
