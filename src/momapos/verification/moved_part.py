"""The part that a task moves, at any value of its joint."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import TaskError
from momapos.core.geometry import invert
from momapos.model.records import Task
from momapos.model.scene import Scene, SceneObject
from momapos.model.urdf import Joint

from .convex import Body, overlap
from .exact_shapes import Shapes, join, of_bodies, prepared
from .link_bodies import LinkBodies, body_poses, joint_motions

if TYPE_CHECKING:
    from jaxtyping import Bool, Float


@dataclass(frozen=True, eq=False)
class MovedPart:
    """The links that a joint moves, or a whole object."""

    name: str
    joint: Joint | None
    """None for a whole object; its value is then the height to which it is lifted [m]."""
    start: float
    """Value of the joint in the scene [rad] or [m]."""
    rest: float
    """Value of the joint where the object is closed: zero, or the nearest limit."""
    goal: float
    """Value that the task requests."""
    T_world_joint: Float[np.ndarray, "4 4"]
    shapes: Shapes
    """Shapes of the part, all on one body, the part."""

    def poses(self, values: Float[np.ndarray, " s"]) -> Float[np.ndarray, "s 4 4"]:
        """Return world poses of the part at joint values."""
        if self.joint is None:
            Ts = np.repeat(self.T_world_joint[None], len(values), axis=0)
            Ts[:, 2, 3] += values
            return Ts
        return np.asarray(self.T_world_joint @ joint_motions(self.joint, values))

    def placed(self, values: Float[np.ndarray, " s"]) -> Float[np.ndarray, "s k 4 4"]:
        """Return world poses of the shapes at joint values."""
        return self.placed_at(self.poses(values))

    def placed_at(self, Ts_world_part: Float[np.ndarray, "s 4 4"]) -> Float[np.ndarray, "s k 4 4"]:
        """Return world poses of the shapes, given those of the part."""
        return self.shapes.placed(Ts_world_part[:, None])

    def distance(self, point: Float[np.ndarray, "3"]) -> float:
        """Return the distance of a point in the part's frame from the part [m]; negative inside."""
        Ts_shape_part = invert(self.shapes.Ts_body_shape)
        local = Ts_shape_part[:, :3, :3] @ point + Ts_shape_part[:, :3, 3]
        beyond = np.abs(local) - self.shapes.half
        least = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
        least = np.where(beyond.max(1) < 0.0, beyond.max(1), least)
        nearest, T = np.inf, np.eye(4)
        for index in np.argsort(least).tolist():
            if least[index] >= nearest:
                break
            T[:3, 3] = local[index]
            nearest = min(nearest, -overlap(_POINT, self.shapes.core(index), T))
        return nearest


_POINT = Body(np.zeros((1, 3)), 0.0, 0.0)


def split(scene: Scene, task: Task) -> tuple[MovedPart, Shapes, Bool[np.ndarray, " k"]]:
    """Split a scene into the part that a task moves and all other shapes, in world coordinates.

    Returns:
        The part, the other shapes, and which of these belong to the part's own object.

    Raises:
        UnknownNameError: There is no such object or joint.
        TaskError: The task names a joint but no value, or opens an object without a joint.
    """
    target = scene.object(task.object)
    if task.joint is None and task.verb in ("open", "close"):
        raise TaskError(f"task: joint must be given to {task.verb} {task.object!r}")
    if task.joint is not None and task.to is None:
        raise TaskError(f"task: to must be given for joint {task.joint!r} of {task.object!r}")
    if task.joint is not None:
        target.joint(task.joint)
    fixed, prefixes, own = [], [], []
    for item in scene.objects:
        bodies, shapes = _world_shapes(item)
        if item is target:
            everything = frozenset(range(len(bodies)))
            moved = everything if task.joint is None else bodies.moved_by(task.joint)
            inside = of_bodies(shapes, moved)
            part = _part(target, task, bodies, shapes.take(inside))
            shapes = shapes.take(np.setdiff1d(np.arange(len(shapes)), inside))
        fixed.append(shapes)
        prefixes.append(f"{item.name}/")
        own.append(np.full(len(shapes), item is target))
    return part, join(fixed, prefixes), np.concatenate(own)


def _world_shapes(item: SceneObject) -> tuple[LinkBodies, Shapes]:
    """Return an object's bodies, and its shapes in world coordinates."""
    bodies, shapes = prepared(item.model)
    Ts = shapes.placed(body_poses(bodies, item.values(), item.T_world_object))[0]
    return bodies, shapes.moved_to(Ts)


def _part(item: SceneObject, task: Task, bodies: LinkBodies, shapes: Shapes) -> MovedPart:
    joint, start, rest, goal = None, 0.0, 0.0, 0.0
    T = item.T_world_object
    if task.joint is not None and task.to is not None:
        body = bodies.of_joint[task.joint]
        joint, start, goal = bodies.joints[body], item.values()[task.joint], task.to
        rest = bodies.rest[task.joint]
        Ts = body_poses(bodies, item.values(), item.T_world_object)[0]
        T = Ts[bodies.parent[body]] @ bodies.Ts_parent_joint[body]
    named = join([shapes], [f"{item.name}/"])
    part = MovedPart(item.name, joint, float(start), float(rest), float(goal), T, named)
    T_part_world = invert(part.poses(np.array([start]))[0])
    return replace(part, shapes=named.moved_to(T_part_world @ named.Ts_body_shape))
