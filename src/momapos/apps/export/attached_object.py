"""Write the object in the hand as a `moveit_msgs/AttachedCollisionObject` in JSON.

The text format of a planning scene has only objects of the world.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation

from momapos.core import write_atomic
from momapos.core.geometry import invert
from momapos.model.records import PlacementPlan
from momapos.model.robots import Robot
from momapos.model.scene import Scene

from .ros2 import stamp

if TYPE_CHECKING:
    from jaxtyping import Float

PRIMITIVES = {"box": 1, "sphere": 2, "cylinder": 3}
"""Types of `shape_msgs/SolidPrimitive`."""


def carries_object(plan: PlacementPlan) -> bool:
    """Check that the plan picks or places a movable object."""
    return plan.task.joint is None and plan.motion is not None


def attached_object(plan: PlacementPlan, scene: Scene, robot: Robot) -> dict[str, Any]:
    """Return the members of the message: the object in the frame of the tool.

    The object is attached after the grasp of a pick, or before the release of a place.

    Args:
        plan: A solved plan that carries an object, see `carries_object`.
        scene: Scene of the plan.
        robot: Robot of the plan.
    """
    item, motion = scene.object(plan.task.object), plan.motion
    assert motion is not None
    T_tool_object = invert(motion.Ts_world_tool[0]) @ item.T_world_object
    primitives, poses, meshes, mesh_poses = [], [], [], []
    for link, T_world_link in item.link_poses().items():
        T = invert(item.T_world_object) @ T_world_link
        shapes = item.model.urdf.links[link].collisions
        for shape, hull in zip(shapes, item.model.hulls[link], strict=True):
            if shape.kind == "mesh":
                meshes.append({
                    "triangles": [{"vertex_indices": face} for face in hull.faces.tolist()],
                    "vertices": [dict(zip("xyz", v, strict=True)) for v in hull.vertices.tolist()],
                })  # fmt: skip
                mesh_poses.append(_pose(T))
            else:
                # The message lists a cylinder's height, then its radius.
                sizes = shape.size[::-1] if shape.kind == "cylinder" else shape.size
                primitives.append({"type": PRIMITIVES[shape.kind], "dimensions": list(sizes)})
                poses.append(_pose(T @ shape.T_link_geometry))
    return {
        "link_name": robot.tool_link,
        "object": {
            "header": {"stamp": stamp(0.0), "frame_id": robot.tool_link},
            "pose": _pose(T_tool_object),
            "id": item.name,
            "primitives": primitives,
            "primitive_poses": poses,
            "meshes": meshes,
            "mesh_poses": mesh_poses,
            "operation": 0,
        },
        "touch_links": list(robot.gripper_links),
    }


def write_attached(plan: PlacementPlan, scene: Scene, robot: Robot, path: Path) -> None:
    """Write `attached_object` as JSON."""
    text = json.dumps(attached_object(plan, scene, robot), indent=1) + "\n"
    write_atomic(path, text.encode())


def _pose(T: Float[np.ndarray, "4 4"]) -> dict[str, dict[str, float]]:
    position, turn = T[:3, 3].tolist(), Rotation.from_matrix(T[:3, :3]).as_quat().tolist()
    return {
        "position": dict(zip("xyz", position, strict=True)),
        "orientation": dict(zip("xyzw", turn, strict=True)),
    }
