"""Write scenes as MJCF, MuJoCo's format, in one file with all joints.

All parts of an object are named OBJECT/PART. A custom text contains what MJCF cannot express (the
floor's outline, the start, areas, categories, and confidences), so that reading the file returns
the same scene. Furniture collides only with other bodies: parts that touch by design, such as a
drawer and its cabinet, would be stuck.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np
from scipy.spatial.transform import Rotation

from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import object_members, room_members, write_text_atomic
from momapos.model.scene.scene_object import SceneObject
from momapos.model.urdf import Geometry, Joint, Mesh, hull_of, joint_motion, mesh_triangles

from .imported_room import Names
from .mjcf_files import OWN_TEXT
from .urdf_writer import numbers

if TYPE_CHECKING:
    from jaxtyping import Float

MIN_MESH_THICKNESS = 1e-5
"""Thickness below which a mesh is written as its hull, which has a thickness [m]."""


def write_mjcf(scene: Scene, path: Path) -> None:
    """Write a scene as MJCF, atomically.

    Raises:
        SceneError: The file cannot be written.
        UrdfError: A mesh cannot be read.
    """
    writer = _Writer(scene.name)
    for item in scene.objects:
        writer.add(item)
    writer.finish(room_members(scene))
    write_text_atomic(path, f"{tostring(writer.tree, encoding='unicode')}\n")


class _Writer:
    """Builds the XML tree of a model."""

    def __init__(self, name: str) -> None:
        self.tree = Element("mujoco", model=name)
        # A moving part without shapes has no mass, which MuJoCo rejects.
        SubElement(self.tree, "compiler", angle="radian", boundmass="1e-3", boundinertia="1e-6")
        self.own = SubElement(SubElement(self.tree, "custom"), "text", name=OWN_TEXT)
        default = SubElement(self.tree, "default")
        SubElement(default, "geom", contype="1", conaffinity="0")
        drawn = SubElement(default, "default", {"class": "drawn"})
        SubElement(drawn, "geom", contype="0", conaffinity="0", group="2", mass="0")
        self.assets = SubElement(self.tree, "asset")
        self.world = SubElement(self.tree, "worldbody")
        SubElement(self.world, "geom", name="floor", type="plane", size="0 0 0.05")
        self.couplings = SubElement(self.tree, "equality")
        self.meshes: dict[tuple[Path | Mesh, tuple[float, ...]], str] = {}
        self.objects: dict[str, dict[str, Any]] = {}
        """Members of the scene file by object."""
        self.names = Names()

    def add(self, item: SceneObject) -> None:
        """Add an object."""
        name = self.names(item.name, "object")
        urdf, values = item.model.urdf, item.values()
        self.objects[name] = object_members(item)
        root = SubElement(self.world, "body", name=f"{name}/{urdf.root}")
        _place(root, item.T_world_object)
        bodies = {urdf.root: root}
        for joint in urdf.joints:
            body = SubElement(bodies[joint.parent], "body", name=f"{name}/{joint.child}")
            bodies[joint.child] = body
            self._join(body, name, joint, values)
        for link, body in bodies.items():
            number = 0
            shapes = urdf.links[link]
            for drawn, group in ((False, shapes.collisions), (True, shapes.visuals)):
                for shape in group:
                    number += 1
                    geom = SubElement(body, "geom", name=f"{name}/{link}/{shape.name}#{number}")
                    if drawn:
                        geom.set("class", "drawn")
                    self._shape(geom, shape)

    def finish(self, members: Mapping[str, Any]) -> None:
        """Add what MJCF cannot express."""
        self.own.set("data", json.dumps({**members, "objects": self.objects}))
        indent(self.tree)

    def _join(self, body: Element, name: str, joint: Joint, values: Mapping[str, float]) -> None:
        """Place a body in its parent, with its joint at the scene's value."""
        if not joint.movable:
            _place(body, joint.T_parent_joint)
            return
        value = values[joint.name]
        _place(body, joint.T_parent_joint @ joint_motion(joint, value))
        kind = "slide" if joint.kind == "prismatic" else "hinge"
        words = {"type": kind, "axis": numbers(joint.axis), "ref": numbers([value])}
        if joint.lower == joint.upper:
            return
        if math.isfinite(joint.lower) and math.isfinite(joint.upper):
            words["range"] = numbers([joint.lower, joint.upper])
        resists = {"frictionloss": joint.friction, "damping": joint.damping}
        words |= {key: numbers([known]) for key, known in resists.items() if known}
        SubElement(body, "joint", words, name=f"{name}/{joint.name}")
        if joint.mimic is not None:
            other = joint.mimic.joint
            offset = joint.mimic.at(values[other]) - value
            ratio = numbers([offset, joint.mimic.ratio, 0.0, 0.0, 0.0])
            one, two = f"{name}/{joint.name}", f"{name}/{other}"
            SubElement(self.couplings, "joint", joint1=one, joint2=two, polycoef=ratio)

    def _shape(self, geom: Element, shape: Geometry) -> None:
        _place(geom, shape.T_link_geometry)
        geom.set("type", shape.kind)
        if shape.mesh is not None:
            key = shape.mesh, shape.size
            if key not in self.meshes:
                self.meshes[key] = self._mesh(shape)
            geom.set("mesh", self.meshes[key])
        elif shape.kind == "box":
            geom.set("size", numbers(np.array(shape.size) / 2))
        elif shape.kind == "cylinder":
            geom.set("size", numbers([shape.size[0], shape.size[1] / 2]))
        else:
            geom.set("size", numbers(shape.size))

    def _mesh(self, shape: Geometry) -> str:
        assert shape.mesh is not None
        name, mesh = f"mesh{len(self.meshes)}", _mesh_of(shape)
        asset = SubElement(self.assets, "mesh", name=name, inertia="convex")
        asset.set("vertex", numbers(mesh.vertices.ravel()))
        if len(mesh.faces):
            asset.set("face", " ".join(map(str, mesh.faces.ravel().tolist())))
        return name


def _mesh_of(shape: Geometry) -> Mesh:
    """Return the scaled mesh of a shape; for a flat one, its hull."""
    assert shape.mesh is not None
    triangles = mesh_triangles(shape.mesh) * shape.size
    corners = triangles.reshape(-1, 3)
    spread = np.linalg.svd(corners - corners.mean(0), full_matrices=False, compute_uv=False)
    if len(corners) < 4 or spread[-1] < MIN_MESH_THICKNESS * math.sqrt(len(corners)):
        hull = hull_of(replace(shape, T_link_geometry=np.eye(4)))
        return Mesh(hull.vertices, hull.faces)
    vertices, faces = np.unique(corners, axis=0, return_inverse=True)
    faces = faces.reshape(-1, 3)
    whole = (faces != np.roll(faces, 1, axis=1)).all(1)  # without degenerate triangles
    return Mesh(vertices, faces[whole])


def _place(element: Element, T: Float[np.ndarray, "4 4"]) -> None:
    if np.array_equal(T, np.eye(4)):
        return
    element.set("pos", numbers(T[:3, 3]))
    element.set("quat", numbers(Rotation.from_matrix(T[:3, :3]).as_quat(scalar_first=True)))
