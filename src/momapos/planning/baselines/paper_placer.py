"""MoMa-Pos as printed: samples in A, the potential map, open tours over groups of T.

Source: Shao et al., MoMa-Pos, sections III-C and III-D. What is not as printed stands in
docs/paper.md with its reason.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import latin_hypercube, rotation
from momapos.model.collision import FREE, base_hits
from momapos.model.scene import upright_boxes
from momapos.model.urdf import Boxes
from momapos.planning.config import PaperConfig
from momapos.planning.placement import arm_radius, sees

from .open_tours import open_tour
from .placer_room import GRASP, Room

if TYPE_CHECKING:
    from jaxtyping import Float

LEAST_DISTANCE = 1e-3
"""1 / distance has no bound at the target itself [m]."""


@dataclass(frozen=True)
class PaperPlacer:
    """The order in which MoMa-Pos tries base poses."""

    config: PaperConfig

    def __call__(self, room: Room, rng: np.random.Generator) -> Iterator[Float[np.ndarray, "n 3"]]:
        """Groups of T of each batch of samples, those of the highest potential first."""
        config = self.config
        boxes = whole_boxes(room)
        for batch in range(config.batches):
            poses = in_area(room, boxes, _samples(room, config.samples * 2**batch, rng))
            scores = room.scores(poses, range(room.Ts_world_tool.shape[1])).max(1)
            if config.inverse_map:
                reached = scores[:, GRASP] > 0
                poses, scores = poses[reached], scores[reached]
            else:
                scores = np.zeros_like(scores)
            heights = np.array(config.heights)
            value = potential(room, boxes, poses, scores, heights, field=config.field)
            ranked = np.argsort(-value, kind="stable")
            for first in range(0, len(ranked), config.group):
                group = ranked[first : first + config.group]
                tour = open_tour(
                    room.start[:2], poses[group, :2], value[group],
                    k_distance=config.k_distance, k_potential=config.k_potential,
                )  # fmt: skip
                yield poses[group[tour]]


def whole_boxes(room: Room) -> Boxes:
    """The bounding box of every object, which are all that the field and the area know of them."""
    task = room.prepared.task
    # A rigid target is in its own box, and no furniture: nothing would ever be seen or stood by.
    items = [o for o in room.prepared.scene.objects if room.articulated or o.name != task.object]
    return upright_boxes(items)


def in_area(room: Room, boxes: Boxes, poses: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "k 3"]:
    """Those in A: on the floor, where the base overlaps no object's bounding box."""
    poses = poses[room.inside(poses)]
    return poses[base_hits(poses, room.robot.base, boxes, clearance=0.0) == FREE]


def potential(
    room: Room,
    boxes: Boxes,
    poses: Float[np.ndarray, "n 3"],
    scores: Float[np.ndarray, "n w"],
    heights: Float[np.ndarray, " z"],
    *,
    field: bool = True,
) -> Float[np.ndarray, " n"]:
    """Inverse reachability + F, summed over the waypoints and the heights.

    F(r, z) is 1 / dist_xy where the segment from (r, z) to the waypoint hits no object's bounding
    box, else 0. The pre-grasp is no waypoint of the paper's.

    Args:
        room: The room.
        boxes: Bounding boxes of the objects.
        poses: Base poses; r is where the axis of the arm stands.
        scores: Inverse reachability at every waypoint, the pre-grasp included, in [0, 1].
        heights: The heights z [m].
        field: Whether F counts.
    """
    total = len(heights) * scores[:, GRASP:].sum(1)
    if not field:
        return total
    targets = np.ascontiguousarray(room.Ts_world_tool[0, GRASP:, :3, 3])
    axis = _arm_axis(room, poses)
    away = np.linalg.norm(axis[:, None] - targets[None, :, :2], axis=-1)
    near = 1 / np.maximum(away, LEAST_DISTANCE)
    for z in heights:
        sources = np.column_stack([axis, np.full(len(axis), z)])
        total = total + (near * sees(sources, targets, boxes)).sum(1)
    return total


def _samples(room: Room, count: int, rng: np.random.Generator) -> Float[np.ndarray, "n 3"]:
    """Latin Hypercube samples of where the arm's axis stands, within Delta_r of the target.

    The base looks at the target; the paper's positions have no yaw.
    """
    geometry = room.prepared.geometry
    radius, target = arm_radius(geometry)[GRASP], room.target[:2]
    offset = radius * (2 * latin_hypercube(rng, count, 2) - 1)
    offset = offset[np.linalg.norm(offset, axis=1) <= radius]
    poses = room.facing(target + offset, target)
    shoulder = rotation(poses[:, 2]) @ geometry.shoulder[:2]
    return poses - np.column_stack([shoulder, np.zeros(len(poses))])


def _arm_axis(room: Room, poses: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
    """Where the axis of the arm stands [m]."""
    return poses[:, :2] + rotation(poses[:, 2]) @ room.prepared.geometry.shoulder[:2]
