"""Objects for test scenes: boxes, a fridge with a shelf, a cabinet with a drawer, a bowl."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from momapos.core.geometry.transforms import pose, rotation_about
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_object import SceneObject
from momapos.model.urdf.articulated import Articulated
from momapos.model.urdf.reader import Geometry, Joint, JointKind, Link, Urdf, box_urdf
from momapos.planning.importance.config import GraphConfig
from momapos.planning.importance.scene_graph import KINDS, build_graph

UP = np.array([0.0, 0.0, 1.0])

Size = tuple[float, float, float]
Panel = tuple[Size, Size]
"""Edges and center of a box-shaped part [m]."""
HOLLOW: tuple[Panel, ...] = (
    ((0.6, 0.02, 1.6), (0, 0.29, 0.8)),
    ((0.02, 0.56, 1.6), (-0.29, 0, 0.8)),
    ((0.02, 0.56, 1.6), (0.29, 0, 0.8)),
    ((0.56, 0.56, 0.02), (0, 0, 0.01)),
    ((0.56, 0.56, 0.02), (0, 0, 1.59)),
)
"""A case, open toward -y: back, sides, bottom, top."""
SHELF: Panel = ((0.56, 0.5, 0.02), (0, 0, 0.8))
SHELF_TOP = 0.81


def box(name: str, size: Size, xyz: Size, yaw: float = 0.0, category: str = "") -> SceneObject:
    """Make a rigid box; xyz is the center of its underside."""
    T = pose((xyz[0], xyz[1], xyz[2] + size[2] / 2), rotation_about(UP, yaw))
    return SceneObject(name, category, T, Articulated(box_urdf(name, size)))


def room(*items: SceneObject) -> Scene:
    return Scene("room", items)


def link(name: str, *panels: Panel) -> Link:
    shapes = tuple(Geometry("box", size, pose(at)) for size, at in panels)
    return Link(name, shapes, shapes)


def assembly(name: str, links: list[Link], joints: list[Joint], **values: float) -> SceneObject:
    urdf = Urdf(name, None, links[0].name, {x.name: x for x in links}, tuple(joints))
    return SceneObject(name, name, np.eye(4), Articulated(urdf), values)


def joint(
    name: str, child: str, kind: JointKind, at: Size, axis: np.ndarray, upper: float
) -> Joint:
    return Joint(name, kind, "body", child, pose(at), np.asarray(axis, float), 0.0, upper, 1.0)


def fridge(opening: float = 0.0) -> SceneObject:
    """Make a case with a shelf and a front door, opened by an angle [rad]."""
    door = link("door", ((0.6, 0.04, 1.6), (-0.3, -0.02, 0.8)))
    hinge = joint("hinge", "door", "revolute", (0.3, -0.3, 0), UP, 2.0)
    return assembly("fridge", [link("body", *HOLLOW, SHELF), door], [hinge], hinge=opening)


def drawers(pull: float = 0.0) -> SceneObject:
    """Make a low case with one drawer, pulled out toward -y [m]."""
    case = tuple(((x, y, z / 2), (a, b, c / 2)) for (x, y, z), (a, b, c) in HOLLOW)
    tray = link(
        "tray",
        ((0.5, 0.5, 0.02), (0, 0, 0.31)), ((0.5, 0.02, 0.2), (0, -0.25, 0.4)),
        ((0.5, 0.02, 0.2), (0, 0.25, 0.4)), ((0.02, 0.5, 0.2), (-0.25, 0, 0.4)),
        ((0.02, 0.5, 0.2), (0.25, 0, 0.4)),
    )  # fmt: skip
    slide = joint("slide", "tray", "prismatic", (0, 0, 0), -np.array([0.0, 1.0, 0.0]), 0.5)
    return assembly("drawers", [link("body", *case), tray], [slide], slide=pull)


def bowl(xyz: Size) -> SceneObject:
    """Make a square bowl of five plates, 30 cm wide and 10 cm high."""
    plates = link(
        "bowl",
        ((0.3, 0.3, 0.01), (0, 0, 0.005)), ((0.3, 0.01, 0.1), (0, -0.145, 0.05)),
        ((0.3, 0.01, 0.1), (0, 0.145, 0.05)), ((0.01, 0.3, 0.1), (-0.145, 0, 0.05)),
        ((0.01, 0.3, 0.1), (0.145, 0, 0.05)),
    )  # fmt: skip
    return replace(assembly("bowl", [plates], []), T_world_object=pose(xyz))


def edges(scene: Scene, config: GraphConfig | None = None) -> set[tuple[str, str, str]]:
    """Return the relations of a scene as (child, kind, parent); neighbors in alphabetical order."""
    graph = build_graph(scene, config)
    found = set()
    for child, parent, kind in zip(graph.child, graph.parent, graph.kind, strict=True):
        pair = (graph.names[child], graph.names[parent])
        a, b = sorted(pair) if KINDS[kind] == "near" else pair
        found.add((a, KINDS[kind], b))
    return found


def hierarchy(scene: Scene) -> set[tuple[str, str, str]]:
    """Return the relations of a scene without near."""
    return {edge for edge in edges(scene) if edge[1] != "near"}
