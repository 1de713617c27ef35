"""What is really there, where a plan was made for a scene that is not quite true."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import InputError
from momapos.core.geometry import apply, invert, pose_planar
from momapos.model.records import Task
from momapos.model.scene import Scene, SceneObject
from momapos.model.urdf import Opening, opening_of

if TYPE_CHECKING:
    from jaxtyping import Float

AT_HAND = 0.3
"""The part that a hand closes on is no farther from it [m]."""
WIDE_OPEN = np.pi / 2
"""A hinged part is wide open there [rad]."""
DRAWN = 0.3
"""And a drawer there: how far it slides is not to be seen from before it [m]."""
KNOB = 0.1
"""What is nowhere larger than this is a knob or a button [m]."""


@dataclass(frozen=True, eq=False)
class TrueWorld:
    """A room, and a task in it."""

    scene: Scene
    task: Task
    """What the robot's task means here: its own object, joint and value."""

    def values(
        self, believed: Float[np.ndarray, " m"], scene: Scene, task: Task
    ) -> Float[np.ndarray, " m"]:
        """Values of this world's joint where another one has opened by so much [rad] or [m].

        Where one is hinged and the other slides, as large a share of what is wide open.

        Args:
            believed: Values of the joint that the robot believes to move.
            scene, task: What it believes.
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
            moved = np.clip(moved / _way(theirs, slides[1]), 0.0, 1.0) * _way(ours, slides[0])
        values = ours.closed + ours.sign * moved
        return np.clip(values, joint.lower, joint.upper)


def _way(opening: Opening, slides: bool) -> float:
    """How far a part opens until it is wide open [rad] or [m]."""
    return min(abs(opening.wide - opening.closed), DRAWN if slides else WIDE_OPEN)


def true_world(there: Scene, scene: Scene, task: Task, hand: Float[np.ndarray, "3"]) -> TrueWorld:
    """The world in which a robot does what was planned for another scene.

    The hand closes on whatever is there: the part nearest to it is the one that should open, as
    far as was asked of the part that the robot believes to be there.

    Args:
        there: What is really there, in the frame of the plan's scene.
        scene: What the robot believes.
        task: What it was asked.
        hand: Where it takes hold [m].

    Raises:
        InputError: The task is not about a joint, or there is no part that opens near the hand.
    """
    if task.joint is None or task.to is None:
        raise InputError(f"a world of its own is for doors and drawers, not to {task.verb}")
    gaps = {
        (item.name, joint): _gap(item, joint, hand)
        for item in there.objects
        for joint in item.model.joints
    }
    name, joint = min(gaps, key=gaps.__getitem__, default=("", ""))
    if not name or gaps[name, joint] > AT_HAND:
        x, y, z = hand.tolist()
        raise InputError(
            f"{there.name}: no part that opens is within {100 * AT_HAND:.0f} cm of the hand at "
            f"({x:.2f}, {y:.2f}, {z:.2f}); is the world in the frame of the plan's scene?"
        )
    same = TrueWorld(there, Task(task.verb, name, joint))
    (to,) = same.values(np.array([task.to]), scene, task).tolist()
    return TrueWorld(there, replace(same.task, to=to))


def moved(scene: Scene, at: Float[np.ndarray, "3"]) -> Scene:
    """A room elsewhere on the floor, without its start: x [m], y [m], yaw [rad] of its origin."""
    T = pose_planar(at)
    objects = tuple(replace(o, T_world_object=T @ o.T_world_object) for o in scene.objects)
    floor = scene.floor_polygon
    if floor is not None:
        floor = apply(T, np.column_stack([floor, np.zeros(len(floor))]))[:, :2]
    return replace(scene, objects=objects, floor_polygon=floor, start=None)


def _gap(item: SceneObject, joint: str, point: Float[np.ndarray, "3"]) -> float:
    """Distance of a point from what a joint moves, box by box [m]; infinite from a knob."""
    poses = item.link_poses()
    hulls = [
        (link, h.vertices) for link in item.model.moved_by(joint) for h in item.model.hulls[link]
    ]
    world = [apply(poses[link], vertices) for link, vertices in hulls]
    if not world or np.ptp(np.concatenate(world), axis=0).max() < KNOB:
        return np.inf
    away = []
    for link, vertices in hulls:
        at = apply(invert(poses[link]), point[None])[0]
        beyond = np.maximum(vertices.min(0) - at, at - vertices.max(0))
        away.append(float(np.linalg.norm(np.maximum(beyond, 0.0))))
    return min(away)
