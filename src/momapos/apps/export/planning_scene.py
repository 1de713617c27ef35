"""Write a scene and a robot for MoveIt: a `.scene` text file and an SRDF.

MoveIt's `PlanningScene::saveGeometryToStream` writes this format, and RViz's motion planning panel
imports it: the pose of an object, its shapes with their poses and colors, its subframes.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path
from typing import TYPE_CHECKING
from xml.sax.saxutils import quoteattr

import numpy as np
from scipy.spatial.transform import Rotation

from momapos.core import write_atomic
from momapos.model.robots import Robot, disable_lines
from momapos.model.scene import Scene, SceneObject
from momapos.model.urdf import Geometry, Hull

if TYPE_CHECKING:
    from jaxtyping import Float

COLOR = "0.7 0.7 0.7 1"


def write_scene(
    scene: Scene,
    T_frame_world: Float[np.ndarray, "4 4"],
    path: Path,
    *,
    absent: Collection[str] = (),
) -> None:
    """Write a planning scene, with one object per link of articulated furniture.

    Args:
        scene: The scene.
        T_frame_world: Pose of the world in the planning frame, by default the robot's base frame
            in MoveIt.
        path: The file.
        absent: Objects to omit.
    """
    lines = [scene.name.replace("\n", " ")]
    for item in scene.objects:
        if item.name in absent:
            continue
        for link, T in item.link_poses().items():
            lines += _object(item, link, T_frame_world @ T)
    write_atomic(path, "\n".join([*lines, ".", ""]).encode())


def _object(item: SceneObject, link: str, T: Float[np.ndarray, "4 4"]) -> Iterator[str]:
    """Yield the lines of a link; none if it has no shape."""
    shapes = item.model.urdf.links[link].collisions
    if not shapes:
        return
    alone = sum(bool(other.collisions) for other in item.model.urdf.links.values()) == 1
    yield f"* {item.name if alone else f'{item.name}/{link}'}"
    yield from _pose(T)
    elements = item.model.static_elements[link]
    yield str(sum(len(element.hulls) for element in elements))
    for shape, element in zip(shapes, elements, strict=True):
        for hull in element.hulls:
            yield from _shape(shape, hull)
    yield "0"


def _shape(shape: Geometry, hull: Hull) -> Iterator[str]:
    if shape.kind == "mesh":
        yield "mesh"
        yield f"{len(hull.vertices)} {len(hull.faces)}"
        yield from (_numbers(vertex) for vertex in hull.vertices)
        yield from (" ".join(map(str, face)) for face in hull.faces.tolist())
        yield from _pose(np.eye(4))
    else:
        yield shape.kind
        yield _numbers(np.array(shape.size))
        yield from _pose(shape.T_link_geometry)
    yield COLOR


def _pose(T: Float[np.ndarray, "4 4"]) -> tuple[str, str]:
    """Return two lines: position, and orientation as a quaternion x y z w."""
    return _numbers(T[:3, 3]), _numbers(Rotation.from_matrix(T[:3, :3]).as_quat())


def _numbers(values: Float[np.ndarray, " n"]) -> str:
    return " ".join(f"{value:.9g}" for value in (np.asarray(values) + 0.0).tolist())


def write_srdf(robot: Robot, path: Path) -> None:
    """Write an SRDF: the arm as a group with its home, the hand, and the disabled pairs."""
    hand = [name for name in robot.gripper_links if name in robot.model.urdf.links]
    pairs = sorted((min(pair), max(pair)) for pair in robot.disabled if len(pair) == 2)
    base, tool = quoteattr(robot.base_link), quoteattr(robot.tool_link)
    values = robot.chain.joint_values(robot.home).tolist()
    lines = [
        '<?xml version="1.0"?>',
        f"<robot name={quoteattr(robot.model.urdf.name)}>",
        '  <group name="arm">',
        f"    <chain base_link={base} tip_link={tool}/>",
        "  </group>",
        '  <group name="gripper">',
        *(f"    <link name={quoteattr(name)}/>" for name in hand),
        "  </group>",
        '  <group_state name="home" group="arm">',
        *(
            f'    <joint name={quoteattr(name)} value="{value:.9g}"/>'
            for name, value in zip(robot.moved_joints, values, strict=True)
        ),
        "  </group_state>",
        f'  <end_effector name="hand" group="gripper" parent_link={tool}/>',
        *disable_lines(dict.fromkeys(pairs, "User")),
        "</robot>",
        "",
    ]
    write_atomic(path, "\n".join(lines).encode())
