"""Find where an object that is in the way can be moved instead, and how little is enough."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import all_inside, place_points, pose_planar
from momapos.model.collision import FREE, base_hits
from momapos.model.scene import Scene, SceneObject, upright_boxes
from momapos.model.urdf import Boxes
from momapos.planning.grasps import scene_boxes

from .query import PlacementQuery
from .result import PlacementResult
from .trials import Trials

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

DISTANCES = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0, 1.25, 1.5, 2.0, 2.5, 3.0)
"""Distances over which an object is moved for a trial [m]."""
DIRECTIONS = 16
"""Directions in which it is moved [-]."""
MAX_DIRECTIONS = 2
"""Directions that are planned for at each distance, those that leave a known plan the most room."""
CONTACT = 0.02
"""An object this near above another one stands on it [m]."""
FLUSH = 2e-3
"""Boxes that overlap less only touch [m]."""
MAX_EDGE = 2.5
"""Nobody moves a longer object; longer than beds and most sofas and tables [m]."""
ARM_ROOM = 0.15
"""Distance from the line between shoulder and hand that an arm takes up [m]."""
BUILT_IN = (
    "cabinet", "counter", "dishwasher", "door", "fridge", "hood", "island", "oven", "radiator",
    "refrigerator", "shelf", "sink", "stove", "toilet", "tub", "wardrobe",
)  # fmt: skip
"""Words in the categories of rigid objects that nobody moves for a task."""


@dataclass(frozen=True, eq=False)
class Move:
    """A displacement of an object with a plan."""

    distance: float
    """Its length [m]."""
    offset: Float[np.ndarray, "2"]
    """Displacement in the world, to a centimeter [m]."""
    answer: PlacementResult

    def words(self, name: str) -> str:
        """Return the move in words."""
        x, y = (self.offset + 0.0).tolist()
        return f"with {name} moved {100 * self.distance:.0f} cm, by ({x:+.2f}, {y:+.2f})"


def can_be_moved(scene: Scene, item: SceneObject) -> bool:
    """Return whether a person can easily move an object.

    Furniture with joints, walls, what is usually built in and what is very long stay, as do
    objects that carry or contain others, and those that stand neither on the floor nor on another
    object.
    """
    if item.wall is not None or item.model.joints or np.ptp(item.bounds, axis=0).max() > MAX_EDGE:
        return False
    if any(word in item.category.lower() for word in BUILT_IN):
        return False
    low, high = item.bounds
    others = np.array([o.bounds for o in scene.objects if o is not item]).reshape(-1, 2, 3)
    middle, bottom = others.mean(1), others[:, 0, 2]
    above = ((middle > low) & (middle < high))[:, :2].all(1)
    carried = above & (bottom > low[2] + CONTACT) & (bottom < high[2] + CONTACT)
    stands = low[2] <= CONTACT or bool(_on_support(scene, item, np.zeros((1, 2)))[0])
    return stands and not carried.any()


def smallest_move(
    query: PlacementQuery, name: str, without: PlacementResult, trials: Trials
) -> Move | None:
    """Return the smallest tried displacement of an object with which a plan exists, or None.

    The plan without the object bounds the displacement: it stays valid with the object out of its
    way. Then bisection looks for a smaller one, with this plan or another.

    Args:
        query: The infeasible query.
        name: Name of the object.
        without: The answer without the object.
        trials: Plans, and limits the time.
    """
    item = query.scene.object(name)
    if not can_be_moved(query.scene, item):
        return None
    offsets, number = free_offsets(query, item, without)
    room = _room_beside(without, item, offsets)
    found: dict[int, Float[np.ndarray, "2"]] = {}

    def solve(size: int, plans_again: bool = True) -> PlacementResult | None:
        """Answer with the object moved over distance number `size`."""
        rows = np.flatnonzero(number == size)
        rows = rows[np.argsort(-room[rows], kind="stable")][:MAX_DIRECTIONS]
        for again in (False, True)[: 1 + plans_again]:
            for row in rows:
                found[size], moved = offsets[row], _moved(query, item, offsets[row])
                answer = trials.solve(moved) if again else without
                if answer is not None and (again or trials.keeps(without, moved.scene)):
                    return answer
        return None

    crowded = np.setdiff1d(number, number[room >= 0.0])
    for size in (*np.unique(number[room >= 0.0]).tolist(), *crowded.tolist()):
        known = solve(size, plans_again=False)
        if known is not None:
            size, known = trials.smallest(solve, size, known)
            return Move(DISTANCES[size - 1], found[size], known)
    return None


def _moved(
    query: PlacementQuery, item: SceneObject, offset: Float[np.ndarray, "2"]
) -> PlacementQuery:
    T = item.T_world_object.copy()
    T[:2, 3] += offset
    other = replace(item, T_world_object=T)
    objects = tuple(other if one is item else one for one in query.scene.objects)
    return replace(query, scene=replace(query.scene, objects=objects))


def free_offsets(
    query: PlacementQuery, item: SceneObject, without: PlacementResult
) -> tuple[Float[np.ndarray, "k 2"], Int[np.ndarray, " k"]]:
    """Return the displacements that keep an object free [m], and the number of each distance.

    It stays on the floor, or on what it stands on, and away from other objects, from the moving
    part and from the robot at its start.
    """
    angle = np.arange(DIRECTIONS) * (2 * np.pi / DIRECTIONS)
    around = np.stack([np.cos(angle), np.sin(angle)], 1)
    offsets = (np.array(DISTANCES)[:, None, None] * around).reshape(-1, 2).round(2)
    scene = query.scene
    objects = tuple(one for one in scene.objects if one is not item)
    base = query.robot.base.moved(pose_planar(without.start))
    boxes = Boxes.join([
        scene_boxes(replace(scene, objects=objects)), without.prepared.motion.sweep(), base,
    ])  # fmt: skip
    own = Boxes.join(item.static_boxes.values())
    middle = item.bounds.mean(0) * [1.0, 1.0, 0.0]
    local = Boxes(own.center - middle, own.rotation, np.maximum(own.half - FLUSH, 1e-4))
    poses = np.column_stack([middle[:2] + offsets, np.zeros(len(offsets))])
    free = base_hits(poses, local, boxes, clearance=0.0) == FREE
    if scene.floor_polygon is not None:
        free &= all_inside(scene.floor_polygon, _outline(item) + offsets[:, None])
    if item.bounds[0, 2] > CONTACT:
        free &= _on_support(scene, item, offsets)
    return offsets[free], (1 + np.arange(len(offsets)) // DIRECTIONS)[free]


def _outline(item: SceneObject) -> Float[np.ndarray, "4 2"]:
    """Return the corners of the upright box around an object [m]."""
    box = upright_boxes([item])
    corners = box.half[0] * [[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]]
    return np.asarray((corners @ box.rotation[0].T + box.center[0])[:, :2])


def _on_support(
    scene: Scene, item: SceneObject, offsets: Float[np.ndarray, "n 2"]
) -> Bool[np.ndarray, " n"]:
    """Return with which displacements an object stays on a top that is at its bottom."""
    outlines = _outline(item) + offsets[:, None]
    on = np.zeros(len(offsets), bool)
    for other in scene.objects:
        if other is item or abs(other.bounds[1, 2] - item.bounds[0, 2]) > CONTACT:
            continue
        on |= all_inside(_outline(other), outlines)
    return on


def _room_beside(
    answer: PlacementResult, item: SceneObject, offsets: Float[np.ndarray, "k 2"]
) -> Float[np.ndarray, " k"]:
    """Return how far a moved object stays from the robot of a plan; negative if it may touch [m].

    The robot counts as discs along its path, and as the line from its shoulder to its hand.
    """
    plan, robot = answer.plan, answer.prepared.robot
    assert plan.base_pose is not None
    assert plan.motion is not None
    radius = float(np.linalg.norm(robot.footprint, axis=1).max())
    path = np.array([plan.base_pose]) if plan.base_path is None else plan.base_path
    bases = np.array([plan.base_pose]) if plan.motion.base is None else plan.motion.base
    path = np.concatenate([path, bases])
    shoulder = place_points(bases, answer.prepared.geometry.shoulder[None, :2])[:, 0]
    tool = plan.motion.Ts_world_tool[:, :2, 3]
    share = np.linspace(0.0, 1.0, 5)[:, None, None]
    arm = (share * tool + (1.0 - share) * shoulder).reshape(-1, 2)
    points = np.concatenate([path[:, :2], arm])
    taken = np.repeat([radius, ARM_ROOM], [len(path), len(arm)])
    corners = item.bounds[None, :, None, :2] + offsets[:, None, None]
    beyond = np.maximum(np.maximum(corners[:, 0] - points, points - corners[:, 1]), 0.0)
    return np.asarray((np.linalg.norm(beyond, axis=2) - taken).min(1))
