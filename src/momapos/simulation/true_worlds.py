"""The true world, if a plan was made for a scene that is not accurate."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import InputError
from momapos.core.geometry import apply, invert, pose_planar
from momapos.model.records import Task
from momapos.model.scene import Scene, SceneObject
from momapos.model.urdf import JointOpening, opening_of

if TYPE_CHECKING:
    from jaxtyping import Float

MAX_HAND_DISTANCE = 0.3
"""Maximum distance between the hand and the part it grasps [m]."""
WIDE_OPEN_ANGLE = np.pi / 2
"""Opening of a hinged part that counts as wide open [rad]."""
WIDE_OPEN_SLIDE = 0.3
"""Opening of a drawer that counts as wide open [m]; its full travel is not visible from outside."""
MAX_KNOB_SIZE = 0.1
"""Maximum extent of a knob or button [m]."""


@dataclass(frozen=True, eq=False)
class TrueWorld:
    """A room, and a task in it."""

    scene: Scene
    task: Task
    """The robot's task in this room: its own object, joint and value."""

    def values(
        self, believed: Float[np.ndarray, " m"], scene: Scene, task: Task
    ) -> Float[np.ndarray, " m"]:
        """Convert values of the believed joint to values of this room's joint [rad] or [m].

        Between a hinge and a slide, the share of the wide-open travel stays the same.

        Args:
            believed: Values of the joint that the robot believes to move.
            scene, task: The robot's scene and task.
        """
        if self.task.joint is None or task.joint is None:
            return believed
        item = self.scene.object(self.task.object)
        ours = opening_of(item.model, self.task.joint)
        other = scene.object(task.object).model
        theirs, joint = opening_of(other, task.joint), item.model.joint(self.task.joint)
        slides = [j.kind == "prismatic" for j in (joint, other.joint(task.joint))]
        moved = theirs.sign * (believed - theirs.closed)
        if slides[0] != slides[1]:
            moved = np.clip(moved / _wide_travel(theirs, slides[1]), 0.0, 1.0) * _wide_travel(
                ours, slides[0]
            )
        values = ours.closed + ours.sign * moved
        return np.clip(values, joint.lower, joint.upper)


def _wide_travel(opening: JointOpening, slides: bool) -> float:
    """Return the travel of a part until it is wide open [rad] or [m]."""
    return min(abs(opening.wide - opening.closed), WIDE_OPEN_SLIDE if slides else WIDE_OPEN_ANGLE)


def true_world(there: Scene, scene: Scene, task: Task, hand: Float[np.ndarray, "3"]) -> TrueWorld:
    """Return the world in which a robot executes a plan made for another scene.

    The hand grasps whatever is there: the nearest part must open as far as the task requests of the
    part that the robot believes to be there.

    Args:
        there: The true scene, in the frame of the plan's scene.
        scene: The scene that the robot believes.
        task: The robot's task.
        hand: Position of the grasp [m].

    Raises:
        InputError: The task has no joint, or no part that opens is near the hand.
    """
    if task.joint is None or task.to is None:
        raise InputError(
            f"a separate true world needs a task that opens or closes a joint, not {task.verb!r}"
        )
    gaps = {
        (item.name, joint): _distance(item, joint, hand)
        for item in there.objects
        for joint in item.model.joints
    }
    name, joint = min(gaps, key=gaps.__getitem__, default=("", ""))
    if not name or gaps[name, joint] > MAX_HAND_DISTANCE:
        x, y, z = hand.tolist()
        raise InputError(
            f"{there.name}: no part that opens is within {100 * MAX_HAND_DISTANCE:.0f} cm of the "
            f"hand at ({x:.2f}, {y:.2f}, {z:.2f}) m; check that the world is in the frame of the "
            "plan's scene"
        )
    same = TrueWorld(there, Task(task.verb, name, joint))
    (to,) = same.values(np.array([task.to]), scene, task).tolist()
    return TrueWorld(there, replace(same.task, to=to))


def moved(scene: Scene, at: Float[np.ndarray, "3"]) -> Scene:
    """Return a room at another pose, without its start: x [m], y [m], yaw [rad] of its origin."""
    T = pose_planar(at)
    objects = tuple(replace(o, T_world_object=T @ o.T_world_object) for o in scene.objects)
    floor = scene.floor_polygon
    if floor is not None:
        floor = apply(T, np.column_stack([floor, np.zeros(len(floor))]))[:, :2]
    return replace(scene, objects=objects, floor_polygon=floor, start=None)


def _distance(item: SceneObject, joint: str, point: Float[np.ndarray, "3"]) -> float:
    """Return the distance of a point from the boxes that a joint moves [m]; inf for a knob."""
    poses = item.link_poses()
    hulls = [
        (link, h.vertices) for link in item.model.moved_by(joint) for h in item.model.hulls[link]
    ]
    world = [apply(poses[link], vertices) for link, vertices in hulls]
    if not world or np.ptp(np.concatenate(world), axis=0).max() < MAX_KNOB_SIZE:
        return np.inf
    away = []
    for link, vertices in hulls:
        at = apply(invert(poses[link]), point[None])[0]
        beyond = np.maximum(vertices.min(0) - at, at - vertices.max(0))
        away.append(float(np.linalg.norm(np.maximum(beyond, 0.0))))
    return min(away)
