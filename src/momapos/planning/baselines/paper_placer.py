"""MoMa-Pos as printed: samples in A, potential map, open tours over groups of T.

Source: Shao et al., MoMa-Pos, sections III-C and III-D. docs/paper.md lists each difference and its
reason.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import Stopwatch
from momapos.core.geometry import latin_hypercube, rotation
from momapos.model.collision import FREE, base_hits
from momapos.model.urdf import Boxes
from momapos.planning.config import PaperConfig
from momapos.planning.placement import PlacementGeometry, sees

from .open_tours import open_tour
from .placer_room import GRASP_WAYPOINT, PlacerRoom

if TYPE_CHECKING:
    from jaxtyping import Float

MIN_DISTANCE = 1e-3
"""Bounds 1 / distance at the target [m]."""
MAX_DESIGN = 64
"""Largest Latin Hypercube design as a multiple of M; in kitchens 3 to 8 times M is enough [-]."""
POTENTIAL = "potential"
"""Stage of section III-C: the area, the inverse reachability and the field."""


@dataclass(frozen=True)
class PaperPlacer:
    """Proposes base poses in the order of MoMa-Pos."""

    config: PaperConfig
    watch: Stopwatch = field(default_factory=lambda: Stopwatch(lambda: 0.0))
    """Measures the stage `POTENTIAL`."""

    def __call__(
        self, room: PlacerRoom, rng: np.random.Generator
    ) -> Iterator[Float[np.ndarray, "n 3"]]:
        """Propose groups of T of each batch of samples, the highest potential first."""
        config = self.config
        for batch in range(config.batches):
            with self.watch.stage(POTENTIAL):
                poses, value = self._candidates(room, config.samples * 2**batch, rng)
            ranked = np.argsort(-value, kind="stable")
            for first in range(0, len(ranked), config.group):
                group = ranked[first : first + config.group]
                tour = open_tour(
                    room.start[:2], poses[group, :2], value[group],
                    k_distance=config.k_distance, k_potential=config.k_potential,
                )  # fmt: skip
                yield poses[group[tour]]

    def _candidates(
        self, room: PlacerRoom, count: int, rng: np.random.Generator
    ) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]:
        """Return samples in A, and the potential of each."""
        config = self.config
        poses = samples_in_area(room, count, rng)
        scores = room.scores(poses, range(room.Ts_world_tool.shape[1])).max(1)
        if config.early_cull:
            reached = scores[:, GRASP_WAYPOINT] > 0
            poses, scores = poses[reached], scores[reached]
        if not config.inverse_map:
            scores = np.zeros_like(scores)
        heights = np.array(config.heights)
        return poses, potential(room, room.whole_boxes, poses, scores, heights, field=config.field)


def printed_radius(geometry: PlacementGeometry) -> float | None:
    """Return Delta_r = sqrt(r_l^2 - dz^2) [m]; None if the target is too high or too low.

    r_l is the length of the arm and its tool, with the travel of an arm that telescopes; dz is the
    height of the target above the arm's axis, a lift being at the middle of its range.
    """
    target = geometry.Ts_world_tool[0, GRASP_WAYPOINT, 2, 3]
    squared = (geometry.robot.reach + geometry.telescope) ** 2 - (
        target - geometry.shoulder[2]
    ) ** 2
    return float(np.sqrt(squared)) if squared > 0.0 else None


def samples_in_area(
    room: PlacerRoom, count: int, rng: np.random.Generator
) -> Float[np.ndarray, "n 3"]:
    """Return Latin Hypercube samples in A; fewer than `count` only if A is nearly empty.

    If too few points of a design over the disc are in A, another has twice as many points.
    """
    radius = printed_radius(room.prepared.geometry)
    if radius is None:
        return np.zeros((0, 3))
    size = count
    while True:
        poses = in_area(room, room.whole_boxes, _design(room, radius, size, rng))
        if len(poses) >= count or size >= MAX_DESIGN * count:
            return poses[:count]
        size *= 2


def in_area(
    room: PlacerRoom, boxes: Boxes, poses: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "k 3"]:
    """Return the poses in A: on the floor, without overlap with an object's bounding box."""
    poses = poses[room.inside(poses)]
    return poses[base_hits(poses, room.robot.base, boxes, clearance=0.0) == FREE]


def potential(
    room: PlacerRoom,
    boxes: Boxes,
    poses: Float[np.ndarray, "n 3"],
    scores: Float[np.ndarray, "n w"],
    heights: Float[np.ndarray, " z"],
    *,
    field: bool = True,
) -> Float[np.ndarray, " n"]:
    """Return inverse reachability + F, summed over the waypoints and the heights.

    F(r, z) is 1 / dist_xy if the segment from (r, z) to the waypoint hits no bounding box of an
    object, else 0. The paper has no pre-grasp waypoint.

    Args:
        room: Scene, robot and task.
        boxes: Bounding boxes of the objects.
        poses: Base poses; r is the position of the arm's axis.
        scores: Inverse reachability at every waypoint, including the pre-grasp, in [0, 1].
        heights: The heights z [m].
        field: Whether F counts.
    """
    total = len(heights) * scores[:, GRASP_WAYPOINT:].sum(1)
    if not field:
        return total
    targets = np.ascontiguousarray(room.Ts_world_tool[0, GRASP_WAYPOINT:, :3, 3])
    axis = _arm_axis(room, poses)
    away = np.linalg.norm(axis[:, None] - targets[None, :, :2], axis=-1)
    near = 1 / np.maximum(away, MIN_DISTANCE)
    for z in heights:
        sources = np.column_stack([axis, np.full(len(axis), z)])
        total = total + (near * sees(sources, targets, boxes)).sum(1)
    return total


def _design(
    room: PlacerRoom, radius: float, count: int, rng: np.random.Generator
) -> Float[np.ndarray, "n 3"]:
    """Return Latin Hypercube samples of the arm's axis that are within Delta_r of the target.

    The base faces the target; the paper's positions have no yaw.
    """
    geometry, target = room.prepared.geometry, room.target[:2]
    offset = radius * (2 * latin_hypercube(rng, count, 2) - 1)
    offset = offset[np.linalg.norm(offset, axis=1) <= radius]
    poses = room.facing(target + offset, target)
    shoulder = rotation(poses[:, 2]) @ geometry.shoulder[:2]
    return poses - np.column_stack([shoulder, np.zeros(len(poses))])


def _arm_axis(room: PlacerRoom, poses: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
    """Return the positions of the arm's axis [m]."""
    return poses[:, :2] + rotation(poses[:, 2]) @ room.prepared.geometry.shoulder[:2]
