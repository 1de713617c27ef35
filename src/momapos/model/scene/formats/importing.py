"""Write imported rooms as momapos scenes, and momapos scenes as MJCF.

In MJCF, parts of an object are named OBJECT/PART. A custom text contains what MJCF cannot express
(the floor's outline, the start, areas, categories, and confidences), so that reading the file
returns the same scene. Furniture collides only with other bodies: parts that touch by design, such
as a drawer and its cabinet, would be stuck.
"""

from __future__ import annotations

import json
import math
import os
import re
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np
from scipy.spatial.transform import Rotation

from momapos.core import MomaposError, SceneError, incomplete, temporary_folder, write_file
from momapos.model.scene.bestman import category_of
from momapos.model.scene.model_copies import files_folder
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import (
    VERSION,
    load_scene,
    object_members,
    room_members,
)
from momapos.model.scene.scene_names import FORMAT
from momapos.model.scene.scene_object import SceneObject
from momapos.model.urdf import Geometry, Joint, Link, Mesh, hull_of, joint_motion, mesh_triangles

from .imported_room import DECIMALS, ImportedRoom, Names, RoomObject
from .mjcf_files import OWN_TEXT
from .urdf_writer import numbers, obj_text, urdf_text

if TYPE_CHECKING:
    from jaxtyping import Float


_MEMBERS = ("category", "hypotheses", "confidence")
"""Extras of an object that its entry contains."""


def write_room(room: ImportedRoom, source: Path, out: Path) -> Scene:
    """Write a room as a momapos scene, with URDF and mesh files in `<stem>_files` next to it.

    Args:
        room: The room.
        source: File that the room was read from, for messages.
        out: The scene file.

    Returns:
        The scene, read back from the written file.

    Raises:
        SceneError: The folder exists or cannot be written to, or the room makes no valid scene;
            then nothing is written.
    """
    target = files_folder(out)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with temporary_folder(target.parent, out.stem) as new:
            (new / target.name).mkdir()
            file = new / out.name
            file.write_text(_write_files(room, new / target.name), encoding="utf-8")
            with _naming(source, new):
                load_scene(file)
            with incomplete(new / target.name, target):
                (new / target.name).rename(target)
                try:
                    file.replace(out)
                except OSError:
                    shutil.rmtree(target)
                    raise
    except OSError as error:
        raise SceneError(f"{out}: cannot be written ({error.strerror})") from error
    return load_scene(out)


@contextmanager
def _naming(source: Path, folder: Path) -> Iterator[None]:
    """Replace the names of temporary files in errors by the file they were made from."""
    try:
        yield
    except MomaposError as error:
        text = str(error).replace(f"{folder}{os.sep}", "")
        raise SceneError(f"{source}: makes no valid scene: {text}") from error


def _write_files(room: ImportedRoom, folder: Path) -> str:
    """Write URDF and mesh files, and return the text of the scene file for their folder."""
    for file, mesh in room.meshes.items():
        (folder / file).write_text(obj_text(_rounded(mesh)), encoding="ascii")
    files = Names()
    entries = []
    for item in room.objects:
        plain = re.sub(r"[^A-Za-z0-9._-]", "_", item.name)[:80]
        file = folder / f"{files(plain, 'object')}.urdf"
        file.write_text(urdf_text(item.urdf), encoding="utf-8")
        entries.append(_entry(item, f"{folder.name}/{file.name}"))
    head = {"format": FORMAT, "version": VERSION, "name": room.name, **room.extras}
    objects = ",\n".join(f"  {json.dumps(entry)}" for entry in entries)
    return f'{json.dumps(head)[:-1]},\n "objects": [\n{objects}\n ]}}\n'


def _entry(item: RoomObject, urdf: str) -> dict[str, Any]:
    T = item.T_world_object
    wxyz = Rotation.from_matrix(T[:3, :3]).as_quat(scalar_first=True)
    extras: Mapping[str, Any] = {key: item.extras[key] for key in _MEMBERS if key in item.extras}
    return {
        "name": item.name,
        "category": category_of(item.name, item.name),
        "pose": {"xyz": (T[:3, 3] + 0.0).tolist(), "wxyz": (wxyz + 0.0).tolist()},
        "urdf": urdf,
        "joints": dict(item.joints),
        **extras,
    }


def _rounded(mesh: Mesh) -> Mesh:
    return Mesh(np.round(mesh.vertices, DECIMALS), mesh.faces)


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
    write_file(path, f"{tostring(writer.tree, encoding='unicode')}\n", error=SceneError)


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
            _weigh(body, shapes)
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


def _weigh(body: Element, link: Link) -> None:
    """Give a body the mass of a link, and the inertia of a box as large as its shapes."""
    if link.mass <= 0.0:
        return
    points = [hull_of(shape).vertices for shape in link.collisions]
    squares = np.ptp(np.concatenate(points or [np.zeros((1, 3))]), axis=0) ** 2
    moments = link.mass / 12 * (squares.sum() - squares)
    words = {"pos": link.center, "mass": [link.mass], "diaginertia": moments}
    SubElement(body, "inertial", {key: numbers(value) for key, value in words.items()})


def _place(element: Element, T: Float[np.ndarray, "4 4"]) -> None:
    if np.array_equal(T, np.eye(4)):
        return
    element.set("pos", numbers(T[:3, 3]))
    element.set("quat", numbers(Rotation.from_matrix(T[:3, :3]).as_quat(scalar_first=True)))
