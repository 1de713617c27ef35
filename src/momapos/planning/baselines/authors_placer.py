"""MoMa-Pos as in the public code of its authors: a ring, an energy, the best five, a fixed yaw.

Source: Project_MoMa-Pos, `MoMa_main.py`, `utils_sample_R.py`, `utils_Potential_R.py` and
`utils_Distance.py`. docs/paper.md compares it with the paper and with our own method.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import Stopwatch
from momapos.core.geometry import apply
from momapos.model.urdf import Boxes
from momapos.planning.config import PaperConfig
from momapos.planning.placement import sees

from .open_tours import open_tour
from .paper_placer import POTENTIAL
from .placer_room import PlacerRoom

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

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
