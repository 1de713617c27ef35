"""Join descriptions of a base, a mast, arms and grippers into one URDF.

Each part is fixed to a link of another one. The base keeps its names; where another part has a name
that occurs twice, it gets the part's name as a prefix. What no reader of robots uses, such as
transmissions, is left out.
"""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element, tostring

from momapos.core import RobotError, UrdfError, unknown_name
from momapos.model.urdf import (
    MeshFinder,
    fix_root_joints,
    link_of,
    package_name,
    read_tree,
    read_urdf,
)

from .amended_urdf import ZERO, Triple, fix, rename, root_of
from .xacro import Expanded, off_by_default

_TIPS = re.compile(r"flange|tool|mount|attach|tcp|ee|tip|end", re.IGNORECASE)
"""Words in the names of frames that carry a tool."""
_KEPT = {"link", "joint", "material", "gazebo"}


@dataclass(frozen=True)
class RobotPart:
    """A description, and the link of another part that carries it."""

    name: str
    """Unique among the parts."""
    file: Path
    """The description's file, for messages."""
    content: Expanded
    on: str = ""
    """Name of the part that carries it; "" for the one that stands on the floor."""
    link: str | None = None
    """Link of that part; None for its root if it is the base, otherwise for its tip."""
    xyz: Triple = ZERO
    """Position of the part's root in that link [m]."""
    rpy: Triple = ZERO
    """[rad]"""


def join_parts(name: str, parts: Sequence[RobotPart]) -> Expanded:
    """Join parts into one robot.

    Args:
        name: Name of the robot.
        parts: The base first; every other part names the one that carries it.

    Raises:
        UrdfError: A part is invalid, or lacks a mesh.
        UnknownNameError: The carrying part has no such link.
        RobotError: The mounts form a cycle, a tip is ambiguous, or names cannot be made unique.
    """
    _refuse_cycle(parts)
    trees, packages = {}, dict[str, Path]()
    for part in parts:
        content = _apart(part.content, packages)
        packages |= content.packages
        trees[part.name] = _tree(part, content)
    carriers = {part.name: _carrier(part, parts, trees) for part in parts if part.on}
    renamed = _renamed(parts, trees)
    robot = Element("robot", name=name)
    for part in parts:
        tree = trees[part.name]
        kept = _KEPT if not part.on else _KEPT - {"gazebo"}  # plugins of the base decide its drive
        robot.extend(element for element in tree if element.tag in kept)
    for part in parts:
        if part.on:
            link = carriers[part.name]
            parent = renamed[part.on].get(link, link)
            fix(robot, parent, root_of(trees[part.name]), part.xyz, part.rpy)
    meshes = {file: text for part in parts for file, text in part.content.meshes.items()}
    notes = [note for part in parts for note in part.content.notes]
    notes += [
        f"xacro: {off_by_default(part.file, part.content)}" for part in parts if part.content.off
    ]
    return Expanded(tostring(robot, encoding="unicode"), packages, tuple(notes), "", meshes)


def _refuse_cycle(parts: Sequence[RobotPart]) -> None:
    """Refuse parts that carry each other, or that no part carries."""
    on = {part.name: part.on for part in parts}
    for part in parts:
        seen, carrier = [part.name], part.on
        while carrier:
            if carrier not in on:
                raise unknown_name("part", carrier, on, f"the robot (below {seen[-1]})")
            seen.append(carrier)
            if carrier in seen[:-1]:
                raise RobotError(
                    f"{' on '.join(seen)}: these parts carry each other; put one of them on "
                    f"{parts[0].name!r}"
                )
            carrier = on[carrier]


def _apart(content: Expanded, taken: Mapping[str, Path]) -> Expanded:
    """Return a description whose packages have names of their own, unless they are the same."""
    text, packages = content.urdf, dict[str, Path]()
    for name, folder in content.packages.items():
        new = _unique_package(name, folder, {**taken, **packages})
        packages[new] = folder
        if new != name:
            text = text.replace(f'"package://{name}/', f'"package://{new}/')
    return Expanded(text, packages, content.notes, content.off, content.meshes)


def _tree(part: RobotPart, content: Expanded) -> Element:
    """Return the XML tree of a part, after the checks of any robot's description."""
    finder = MeshFinder(part.file, packages=content.packages)
    find = Path if content.meshes else finder.find  # written later
    read_urdf(part.file, text=content.urdf, find_mesh=find, visuals=False, actuated=True)
    tree = read_tree(content.urdf, part.file)
    fix_root_joints(tree)
    return tree


def _carrier(part: RobotPart, parts: Sequence[RobotPart], trees: Mapping[str, Element]) -> str:
    """Return the link that carries a part, by the name in its own file."""
    tree = trees[part.on]
    names = [link.get("name", "") for link in tree.findall("link")]
    file = next(other.file for other in parts if other.name == part.on)
    if part.link is not None:
        if part.link not in names:
            raise unknown_name("link", part.link, names, f"{file} (carries {part.name!r})")
        return part.link
    if part.on == parts[0].name:
        return root_of(tree)
    tips = _tips(tree)
    if len(tips) != 1:
        raise RobotError(
            f"{file}: several frames can carry {part.name!r}: {', '.join(tips)}; choose one: "
            f"--on {part.name}={tips[0]}"
        )
    return tips[0]


def _tips(tree: Element) -> list[str]:
    """Return the frames at the end of the longest chain of joints.

    Of several, those named as a flange or tool count.
    """
    below = defaultdict[str, list[tuple[str, bool]]](list)
    for joint in tree.findall("joint"):
        moves = joint.get("type") != "fixed"
        below[link_of(joint, "parent")].append((link_of(joint, "child"), moves))
    most, ends = 0, list[str]()
    waiting = [(root_of(tree), 0)]
    while waiting:
        link, depth = waiting.pop()
        if depth > most:
            most, ends = depth, []
        if depth == most and not below[link]:
            ends.append(link)
        waiting += [(child, depth + moves) for child, moves in below[link]]
    named = [end for end in ends if _TIPS.search(end)]
    return sorted(named or ends)


def _renamed(parts: Sequence[RobotPart], trees: Mapping[str, Element]) -> dict[str, dict[str, str]]:
    """Make the names of links and joints unique; return the new names of links by part."""
    found = {}
    counts = {
        tag: Counter(part.get("name", "") for tree in trees.values() for part in tree.findall(tag))
        for tag in ("link", "joint")
    }
    for part in parts:
        new: dict[str, dict[str, str]] = {"link": {}, "joint": {}}
        for tag, count in counts.items():
            for element in trees[part.name].findall(tag) if part.on else ():
                name = element.get("name", "")
                if count[name] > 1:
                    new[tag][name] = f"{part.name}_{name}"
        rename(trees[part.name], new)
        found[part.name] = new["link"]
    for tag in counts:
        names = Counter(e.get("name", "") for tree in trees.values() for e in tree.findall(tag))
        if double := [name for name, count in names.items() if count > 1]:
            raise RobotError(f"two parts have a {tag} {double[0]!r}; give the parts other names")
    return found


def read_part(path: Path, text: str, packages: Mapping[str, Path]) -> Expanded:
    """Return a URDF with its meshes named by package, so that it can be anywhere.

    Visual meshes may be missing, since robots do not use them.

    Args:
        path: The URDF.
        text: Its content.
        packages: Package folders by name; others are searched.

    Raises:
        UrdfError: A mesh or a package is missing, or the file is invalid.
    """
    tree, used = read_tree(text, path), dict[str, Path]()
    finder = MeshFinder(path, packages=packages)
    drawn = {id(mesh) for mesh in tree.iterfind("link/visual//mesh")}
    solid = [mesh for mesh in tree.iter("mesh") if id(mesh) not in drawn]
    finder.check_packages(mesh.get("filename", "") for mesh in solid)
    for mesh in tree.iter("mesh"):
        try:
            file = finder.find(mesh.get("filename", ""))
        except UrdfError:
            if id(mesh) in drawn:
                continue
            raise
        name, folder = _package_of(file)
        name = _unique_package(name, folder, used)
        used[name] = folder
        mesh.set("filename", f"package://{name}/{file.relative_to(folder).as_posix()}")
    return Expanded(tostring(tree, encoding="unicode"), used, (), "")


def _package_of(file: Path) -> tuple[str, Path]:
    """Return the package that holds a file; without one, the folder of the file."""
    for folder in file.parents:
        if name := package_name(folder):
            return name, folder
    return file.parent.name or "root", file.parent


def _unique_package(name: str, folder: Path, taken: Mapping[str, Path]) -> str:
    """Return a name for a package which no other folder has."""
    new, count = name, 1
    while taken.get(new, folder) != folder:
        count += 1
        new = f"{name}_{count}"
    return new
