"""Read the URDFs that the code of URDFormer's authors writes (Chen et al., 2024)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import UrdfError, read_xml
from momapos.model.records import Part, PartKind
from momapos.model.urdf import MAX_LINKS, MAX_URDF_BYTES

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

    from jaxtyping import Float

Rectangle = tuple[float, float, float, float]
"""Left, top, right, bottom as fractions of the face."""
KINDS: Mapping[str, PartKind] = {
    "drawer": "drawer",
    "doorL": "door_left",
    "doorR": "door_right",
    "washer_door": "door_left",
    "doorD": "door_down",
    "oven_door": "door_down",
    "doorU": "door_up",
}
"""How parts of a class open."""
HANDLES = ("handle", "knob")
"""Classes of handles; all other classes have no counterpart here."""
MESH_EDGE = 0.25
"""Edge length of the authors' meshes of doors and drawers, so a scale of 4 fills the base."""
GAP = {"drawer": 0.02, "doorL": 0.01, "doorR": 0.01}
"""Reduction of a part's scale by the authors, so that neighbors do not touch."""
MESHES = "../meshes/"
"""Folder of the authors' meshes, next to that of their output."""
HANDLE_SIZES = {"handle": (0.035, 0.125), "knob": (0.069, 0.069)}
"""Width and height of the authors' meshes, as fractions of a base of scale 1."""


def read_predicted_urdf(path: Path) -> tuple[Part, ...]:
    """Read the parts of a URDF written by URDFormer's own code; no mesh is needed.

    A part's origin is its lower corner at the hinge, or the upper left one of a door that opens
    up; its size is in the scale of its mesh. Parts on other parts, handles on none, and parts
    without width or height are dropped. Scores are 1.

    Raises:
        UrdfError: The file is not usable.
    """
    robot = _parse(path)
    meshes = {link.get("name", ""): _mesh(path, link) for link in robot.findall("link")}
    joints = [_joint(path, joint) for joint in robot.findall("joint")]
    roots = meshes.keys() - {child for _, child, _, _ in joints}
    if len(roots) != 1:
        raise UrdfError(f"{path}: must have one root link, not {len(roots)}")
    (root,) = roots
    base = np.array(meshes[root][1][1:])
    if not (base > 0.0).all():
        raise UrdfError(f"{path}: the mesh of the base {root!r} has no width or height")
    # The authors' code does not scale the parts of objects at the right wall by their width.
    sized = np.where([_is_at_right_wall(path, robot, root), False], 1.0, base)
    origins: dict[str, Float[np.ndarray, "2"]] = {}
    parts: dict[str, Part] = {}
    for parent, child, xyz, _ in joints:
        name, scale = meshes.get(child, ("", (1.0, 1.0, 1.0)))
        size = (np.array(scale[1:]) + GAP.get(name, 0.0)) * MESH_EDGE / sized
        if parent == root and name in KINDS and (size > 1e-6).all():
            origins[child] = np.array(xyz[1:]) / base
            parts[child] = Part(KINDS[name], _rectangle(name, origins[child], size), 1.0)
    for parent, child, xyz, roll in joints:
        name, _ = meshes.get(child, ("", None))
        if name in HANDLES and parent in parts:
            across, up = (origins[parent] + np.array(xyz[1:]) / sized).tolist()
            lying = abs(math.sin(roll)) > 0.5
            width, height = (np.array(HANDLE_SIZES[name][:: -1 if lying else 1]) / base).tolist()
            part = parts[parent]
            handle = _around((across, 1.0 - up), (width, height), part.box)
            parts[parent] = Part(part.kind, part.box, part.score, handle)
    return tuple(parts.values())


def is_predicted_urdf(path: Path) -> bool:
    """Tell whether URDFormer's own code wrote a URDF, by the meshes of its links.

    Raises:
        UrdfError: The file is not usable.
    """
    links = read_xml(path, MAX_URDF_BYTES, error=UrdfError).findall("link")
    meshes = [link.find("visual/geometry/mesh") for link in links]
    files = ["" if mesh is None else mesh.get("filename", "") for mesh in meshes]
    return bool(files) and all(file.startswith(MESHES) for file in files)


def _is_at_right_wall(path: Path, robot: Element, root: str) -> bool:
    """Tell whether an object of a whole kitchen is at its right wall, by the turn of its mesh."""
    (link,) = (one for one in robot.findall("link") if one.get("name", "") == root)
    origin = link.find("visual/origin")
    yaw = 0.0 if origin is None else _three(path, origin.get("rpy", "0 0 0"))[2]
    return abs(yaw + math.pi / 2) < 0.01


def _rectangle(
    name: str, origin: Float[np.ndarray, "2"], size: Float[np.ndarray, "2"]
) -> Rectangle:
    """Return a part's rectangle as fractions of the face; its origin is at the hinge."""
    low, high = origin.copy(), origin + size
    if name == "doorR":
        low[0], high[0] = origin[0] - size[0], origin[0]
    if name == "doorU":
        low[1], high[1] = origin[1] - size[1], origin[1]
    return float(low[0]), 1.0 - float(high[1]), float(high[0]), 1.0 - float(low[1])


def _parse(path: Path) -> Element:
    robot = read_xml(path, MAX_URDF_BYTES, error=UrdfError)
    if robot.tag != "robot" or len(robot) > 2 * MAX_LINKS:
        raise UrdfError(f"{path}: must be a <robot> of at most {MAX_LINKS} links")
    return robot


def _mesh(path: Path, link: Element) -> tuple[str, tuple[float, ...]]:
    """Return the name of a link's mesh, which is its class, and its scale."""
    mesh = link.find("visual/geometry/mesh")
    if mesh is None:
        raise UrdfError(
            f"{path}: link {link.get('name')!r:.80} has no mesh, so URDFormer did not write it"
        )
    stem = PurePosixPath(mesh.get("filename", "")).stem
    return stem, _three(path, mesh.get("scale", "1 1 1"))


def _joint(path: Path, joint: Element) -> tuple[str, str, tuple[float, ...], float]:
    ends = [joint.find("parent"), joint.find("child")]
    origin = joint.find("origin")
    if ends[0] is None or ends[1] is None or origin is None:
        raise UrdfError(f"{path}: joint {joint.get('name')!r:.80} lacks parent, child or origin")
    xyz = _three(path, origin.get("xyz", "0 0 0"))
    roll = _three(path, origin.get("rpy", "0 0 0"))[0]
    return ends[0].get("link", ""), ends[1].get("link", ""), xyz, roll


def _three(path: Path, text: str) -> tuple[float, ...]:
    try:
        values = tuple(float(word) for word in text.split())
    except ValueError:
        values = ()
    if len(values) != 3 or not all(map(math.isfinite, values)):
        raise UrdfError(f"{path}: {text!r:.80} must be 3 finite numbers")
    return values


def _around(center: tuple[float, float], size: tuple[float, float], within: Rectangle) -> Rectangle:
    """Return a rectangle with a center and size (width, height), clipped to another one."""
    (x, y), (width, height) = center, size
    return (
        max(x - width / 2, within[0]),
        max(y - height / 2, within[1]),
        min(x + width / 2, within[2]),
        min(y + height / 2, within[3]),
    )
