"""The collision shapes of a robot as convex hulls, with the neighbors of their vertices."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import apply
from momapos.model.kinematics import HullArrays, Segments
from momapos.model.urdf import Articulated

from .hull_overlap import DIRECTION_BINS, DIRECTION_CELLS, MAX_SCANNED_VERTICES

if TYPE_CHECKING:
    from jaxtyping import Float, Int

_CELL = (np.arange(DIRECTION_CELLS) + 0.5) * 2.0 / DIRECTION_CELLS - 1.0
BIN_CENTERS = np.array(
    [
        np.roll((along, u, v), k)
        for k, along, u, v in itertools.product(range(3), (1.0, -1.0), _CELL, _CELL)
    ]
)
"""Central direction of each bin, see `hull_overlap.direction_bin`."""


@dataclass(frozen=True, eq=False)
class LinkHulls:
    """Convex hulls of the links' shapes, relative to the joint origins of their segments."""

    vertices: Float[np.ndarray, "v 3"]
    """Vertices of all hulls, concatenated [m]."""
    first: Int[np.ndarray, " hulls_plus_1"]
    """Vertices of hull h are first[h]:first[h + 1]."""
    center: Float[np.ndarray, "hulls 3"]
    """An interior point of each hull [m]."""
    segment: Int[np.ndarray, " hulls"]
    of_group: Int[np.ndarray, " groups_plus_1"]
    """Hulls of group g are of_group[g]:of_group[g + 1]."""
    of_base: Int[np.ndarray, " b"]
    """The hull that each box of the base covers."""
    neighbors: Int[np.ndarray, " e"]
    """Neighbors of each vertex along edges; none for hulls with few vertices."""
    neighbors_from: Int[np.ndarray, " v_plus_1"]
    """Neighbors of vertex v are neighbors[neighbors_from[v]:neighbors_from[v + 1]]."""
    begin: Int[np.ndarray, "hulls parts"]
    """The vertex farthest along the central direction of each bin."""
    margin: float = 0.0
    """Hulls that are nearer to each other count as overlapping [m]."""

    @cached_property
    def arrays(self) -> HullArrays:
        """Return the hulls as an argument of kernels."""
        return HullArrays(
            self.vertices, self.first, self.center, self.segment, self.of_group, self.of_base,
            self.neighbors, self.neighbors_from, self.begin, self.margin,
        )  # fmt: skip


def link_hulls(
    model: Articulated, segments: Segments, moving: Sequence[str], standing: Sequence[str]
) -> LinkHulls:
    """Return the hulls of the moving links, then those of the base.

    Args:
        model: The robot.
        segments: The segment of the arm with which each link moves.
        moving: The links that the arm moves, one group each.
        standing: The links of the base.
    """
    links = [(link, hull) for link in (*moving, *standing) for hull in model.hulls[link]]
    vertices = [apply(segments.T_segment_link[link], hull.vertices) for link, hull in links]
    first = np.cumsum([0, *map(len, vertices)])
    counts = [len(model.hulls[link]) for link in moving]
    boxes = [len(boxes) for link in standing for boxes in model.boxes[link]]
    many = [k for k, points in enumerate(vertices) if len(points) > MAX_SCANNED_VERTICES]
    begin = np.zeros((len(links), DIRECTION_BINS), np.int64)
    for k in many:
        used = np.unique(links[k][1].faces)
        begin[k] = first[k] + used[(vertices[k][used] @ BIN_CENTERS.T).argmax(0)]
    faces = [first[k] + links[k][1].faces for k in many]
    neighbors, neighbors_from = _neighbors(faces, int(first[-1]))
    return LinkHulls(
        vertices=np.concatenate([np.zeros((0, 3)), *vertices]),
        first=first,
        center=np.array([points.mean(0) for points in vertices]).reshape(-1, 3),
        segment=np.array([segments.of_link[link] for link, _ in links], np.int64),
        of_group=np.cumsum([0, *counts]),
        of_base=np.repeat(sum(counts) + np.arange(len(boxes)), boxes),
        neighbors=neighbors,
        neighbors_from=neighbors_from,
        begin=begin,
    )


def _neighbors(
    faces: Sequence[Int[np.ndarray, "_ 3"]], count: int
) -> tuple[Int[np.ndarray, " e"], Int[np.ndarray, " v_plus_1"]]:
    """Return the neighbors of all vertices, concatenated, and where those of each vertex begin."""
    corners = np.concatenate([np.zeros((0, 3), np.int64), *faces])
    start, end = corners.T.reshape(-1), np.roll(corners, -1, 1).T.reshape(-1)
    # Both directions: flat hulls may lack the face on the other side of an edge.
    start, end = np.divmod(
        np.unique(np.r_[start * count + end, end * count + start]), max(1, count)
    )
    return end, np.searchsorted(start, np.arange(count + 1))
