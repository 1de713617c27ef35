"""MoMa-Pos as printed, and as in the public code of its authors.

Source: Shao et al., MoMa-Pos, sections III-C and III-D. docs/paper.md lists each difference and its
reason.

Source: Project_MoMa-Pos, `MoMa_main.py`, `utils_sample_R.py`, `utils_Potential_R.py` and
`utils_Distance.py`. docs/paper.md compares it with the paper and with our own method.
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import Stopwatch
from momapos.core.geometry import apply, latin_hypercube, rotation
from momapos.model.collision import FREE, base_hits
from momapos.model.urdf import Boxes
from momapos.planning.config import PaperConfig
from momapos.planning.placement import PlacementGeometry, sees

from .placer_room import GRASP_WAYPOINT, PlacerRoom

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int


MAX_EXACT = 10
"""Largest group whose open tour is solved exactly [-]."""


def open_tour(
    start: Float[np.ndarray, "2"],
    positions: Float[np.ndarray, "n 2"],
    potential: Float[np.ndarray, " n"],
    *,
    k_distance: float,
    k_potential: float,
) -> Int[np.ndarray, " n"]:
    """Order one group of candidates by an open tour from the start.

    The edge weight is `k1 dist(i, j) + k1' (F(j) - F(i))` as printed. The second term
    telescopes to `k1' (F_last - F_first)` along a tour. So it only decides which candidate comes
    last, and as printed this is the worst one.

    Source: MoMa-Pos, section III-D.

    Args:
        start: Position of the robot [m].
        positions: Candidates [m]; more than `MAX_EXACT` are ordered by local search.
        potential: Potential of each.
        k_distance, k_potential: k1 and k1'.
    """
    if len(positions) <= 1:
        return np.arange(len(positions))
    points = np.vstack([start, positions])
    field = np.concatenate([[0.0], potential])
    distance = np.linalg.norm(points[:, None] - points[None], axis=-1)
    weight = k_distance * distance + k_potential * (field[None] - field[:, None])
    if len(positions) <= MAX_EXACT:
        return _exact(weight[0, 1:], weight[1:, 1:])
    weight[:, 0] = 0.0  # no cost to return: the tour is open
    np.fill_diagonal(weight, 0.0)
    return _local_search(weight)


def _exact(first: Float[np.ndarray, " n"], weight: Float[np.ndarray, "n n"]) -> np.ndarray:
    """Solve for the cheapest order by dynamic programming over visited sets (Held and Karp 1962).

    Takes 2 ms for ten candidates; the library function takes tens of milliseconds.

    Args:
        first: Weight from the start to each candidate.
        weight: Weight between candidates.
    """
    count = len(first)
    sets = np.arange(2**count)
    sizes = (sets[:, None] >> np.arange(count) & 1).sum(1)
    cost = np.full((2**count, count), np.inf)
    before = np.zeros((2**count, count), int)
    cost[1 << np.arange(count), np.arange(count)] = first
    for size in range(2, count + 1):
        of_size = sets[sizes == size]
        for last in range(count):
            visited = of_size[of_size >> last & 1 == 1]
            costs = cost[visited ^ (1 << last)] + weight[:, last]
            before[visited, last] = costs.argmin(1)
            cost[visited, last] = costs.min(1)
    visited, last = 2**count - 1, int(cost[-1].argmin())
    tour = []
    for _ in range(count):
        tour.append(last)
        visited, last = visited ^ (1 << last), int(before[visited, last])
    return np.array(tour[::-1])


def _local_search(weight: Float[np.ndarray, "m m"]) -> np.ndarray:
    from python_tsp.heuristics import solve_tsp_local_search

    # The library draws from the global generator: seed it and restore its state.
    state = random.getstate()
    random.seed(len(weight))
    try:
        tour, _ = solve_tsp_local_search(weight, x0=list(range(len(weight))))
    finally:
        random.setstate(state)
    return np.array(tour[1:]) - 1


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


RING = (0.4, 1.2)
"""Distance of the base from the target [m]; uniform, so that the middle is denser than the rim."""
SAMPLES, BEST = 50, 5
"""Positions that are drawn, and those of the lowest energy among them, which are visited [-]."""
MAX_DRAWS = 200 * SAMPLES
"""The authors' code draws until it has enough, without end [-]."""
YAW = -np.pi / 2
"""The only yaw at which the base stands [rad]."""
FLOOR = 0.1
"""Objects that begin below this height stand on the floor [m]."""


@dataclass(frozen=True)
class AuthorsPlacer:
    """Proposes base poses as the authors' public code."""

    config: PaperConfig
    """The heights and the weights of the tour are as in the paper."""
    container: str
    """The object that holds a rigid target; "" if none does."""
    watch: Stopwatch = field(default_factory=lambda: Stopwatch(lambda: 0.0))

    def __call__(
        self, room: PlacerRoom, rng: np.random.Generator
    ) -> Iterator[Float[np.ndarray, "n 3"]]:
        """Propose the best five samples in the order of an open tour, or else the start."""
        config = self.config
        with self.watch.stage(POTENTIAL):
            positions = _ring(room, rng)
            energy = self._energy(room, positions)
            seen = np.flatnonzero(energy < 0.0)
            best = seen[np.argsort(energy[seen], kind="stable")[:BEST]]
        if not len(best):
            yield np.array([[*room.start[:2], YAW]])
            return
        tour = open_tour(
            room.start[:2], positions[best], energy[best],
            k_distance=config.k_distance, k_potential=config.k_potential,
        )  # fmt: skip
        stops = positions[best[tour]]
        yield np.column_stack([stops, np.full(len(stops), YAW)])

    def _energy(
        self, room: PlacerRoom, positions: Float[np.ndarray, "n 2"]
    ) -> Float[np.ndarray, " n"]:
        """Return minus the sum of 1 / distance over the heights that see the target [1/m].

        Only the object that holds the target hides it, by the upright boxes of its links.
        """
        task = room.prepared.task
        holder = task.object if room.articulated else self.container
        names = {item.name for item in room.prepared.scene.objects}
        links = _link_boxes(room, [holder] if holder in names else [])
        total = np.zeros(len(positions))
        for z in self.config.heights:
            sources = np.column_stack([positions, np.full(len(positions), z)])
            away = np.maximum(np.linalg.norm(sources - room.target, axis=1), RING[0])
            total -= sees(sources, room.target[None], links)[:, 0] / away
        return total


def _ring(room: PlacerRoom, rng: np.random.Generator) -> Float[np.ndarray, "n 2"]:
    """Return positions around the target at which the base's square touches no object's box."""
    angle = rng.uniform(0.0, 2 * np.pi, MAX_DRAWS)
    radius = rng.uniform(*RING, MAX_DRAWS)
    drawn = room.target[:2] + radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    return drawn[_is_clear(room, drawn)][:SAMPLES]


def _is_clear(room: PlacerRoom, positions: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, " n"]:
    """Check a square as wide as the base is long, parallel to the axes, against upright boxes."""
    task = room.prepared.task
    side = float(np.ptp(room.robot.footprint, axis=0).max())
    objects = [item for item in room.prepared.scene.objects if item.bounds[0, 2] < FLOOR]
    standing = [o.name for o in objects if room.articulated or o.name != task.object]
    boxes = _link_boxes(room, standing)
    apart = np.abs(positions[:, None] - boxes.center[:, :2]) > boxes.half[:, :2] + side / 2
    return np.asarray(apart.any(2).all(1) & room.on_floor(positions))


def _link_boxes(room: PlacerRoom, names: list[str]) -> Boxes:
    """Return the upright boxes, parallel to the axes, around the links of some objects."""
    bounds = []
    for item in map(room.prepared.scene.object, names):
        for link, T in item.link_poses().items():
            if item.model.hulls[link]:
                points = np.concatenate(
                    [apply(T, hull.vertices) for hull in item.model.hulls[link]]
                )
                bounds.append((points.min(0), points.max(0)))
    low, high = np.reshape(bounds, (-1, 2, 3)).swapaxes(0, 1)
    return Boxes((low + high) / 2, np.tile(np.eye(3), (len(low), 1, 1)), (high - low) / 2)
