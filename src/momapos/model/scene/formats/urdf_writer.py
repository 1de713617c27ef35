"""Write records of links and joints as a URDF, and their meshes."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np

from momapos.core.geometry import rpy_of
from momapos.model.urdf import Geometry, Joint, Mesh, Urdf

if TYPE_CHECKING:
    from jaxtyping import Float


_MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


def obj_text(mesh: Mesh) -> str:
    """Return a mesh as an OBJ file with all digits, so that it round-trips."""
    points, faces = (mesh.vertices + 0.0).tolist(), (mesh.faces + 1).tolist()
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in points]
    lines += [f"f {a} {b} {c}" for a, b, c in faces]
    return "\n".join([*lines, ""])


def urdf_text(urdf: Urdf) -> str:
    """Return records as a URDF, in which the names of mesh files are kept."""
    robot = Element("robot", name=urdf.name)
    for link in urdf.links.values():
        element = SubElement(robot, "link", name=link.name)
        if link.mass > 0.0:
            inertial = SubElement(element, "inertial")
            SubElement(inertial, "origin", xyz=numbers(link.center))
            SubElement(inertial, "mass", value=numbers([link.mass]))
            # A point mass: readers of URDF require the element, and furniture here moves slowly.
            SubElement(inertial, "inertia", dict.fromkeys(_MOMENTS, "0.0"))
        for tag, shapes in (("visual", link.visuals), ("collision", link.collisions)):
            for shape in shapes:
                _shape(SubElement(element, tag), shape)
    for joint in urdf.joints:
        _joint(SubElement(robot, "joint", name=joint.name, type=joint.kind), joint)
    indent(robot)
    return f'<?xml version="1.0"?>\n{tostring(robot, encoding="unicode")}\n'


def _shape(element: Element, shape: Geometry) -> None:
    if shape.name:
        element.set("name", shape.name)
    _origin(element, shape.T_link_geometry)
    geometry = SubElement(SubElement(element, "geometry"), shape.kind)
    if shape.kind == "mesh":
        assert isinstance(shape.mesh, Path)
        geometry.set("filename", shape.mesh.as_posix())
        geometry.set("scale", numbers(shape.size))
    elif shape.kind == "box":
        geometry.set("size", numbers(shape.size))
    else:
        for key, value in zip(("radius", "length"), shape.size, strict=False):
            geometry.set(key, numbers([value]))


def _joint(element: Element, joint: Joint) -> None:
    _origin(element, joint.T_parent_joint)
    SubElement(element, "parent", link=joint.parent)
    SubElement(element, "child", link=joint.child)
    if not joint.movable:
        return
    SubElement(element, "axis", xyz=numbers(joint.axis))
    bounds = {
        "lower": joint.lower, "upper": joint.upper,
        "effort": joint.effort, "velocity": joint.velocity,
    }  # fmt: skip
    finite = {key: numbers([value]) for key, value in bounds.items() if math.isfinite(value)}
    if finite:
        SubElement(element, "limit", finite)
    if joint.mimic is not None:
        multiplier, offset = numbers([joint.mimic.ratio]), numbers([joint.mimic.offset])
        SubElement(element, "mimic", joint=joint.mimic.joint, multiplier=multiplier, offset=offset)
    if joint.damping or joint.friction:
        damping, friction = numbers([joint.damping]), numbers([joint.friction])
        SubElement(element, "dynamics", damping=damping, friction=friction)


def _origin(element: Element, T: Float[np.ndarray, "4 4"]) -> None:
    if not np.array_equal(T, np.eye(4)):
        SubElement(element, "origin", xyz=numbers(T[:3, 3]), rpy=numbers(rpy_of(T[:3, :3])))


def numbers(values: Float[np.ndarray, " n"] | list[float] | tuple[float, ...]) -> str:
    """Format numbers with all digits, so that they round-trip."""
    return " ".join(repr(value) for value in (np.asarray(values, float) + 0.0).tolist())
