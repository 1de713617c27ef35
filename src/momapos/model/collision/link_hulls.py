"""The collision shapes of a robot as convex hulls, as the kernels climb over them."""

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

from .hull_overlap import CELLS, FEW, PARTS

if TYPE_CHECKING:
    from jaxtyping import Float, Int

_CELL = (np.arange(CELLS) + 0.5) * 2.0 / CELLS - 1.0
MIDDLES = np.array(
    [
        np.roll((along, u, v), k)
        for k, along, u, v in itertools.product(range(3), (1.0, -1.0), _CELL, _CELL)
    ]
)
"""The middles of the parts of space, see `overlap.part_of_space`."""


@dataclass(frozen=True)
class LinkHulls:
    """Convex hulls of the links' shapes, each relative to the joint origin of its segment."""

    vertices: Float[np.ndarray, "v 3"]
    """Of all hulls, one hull after the other [m]."""
    first: Int[np.ndarray, " hulls_plus_1"]
    """Vertices of hull h are first[h]:first[h + 1]."""
    center: Float[np.ndarray, "hulls 3"]
    """A point within each [m]."""
    segment: Int[np.ndarray, " hulls"]
    of_group: Int[np.ndarray, " groups_plus_1"]
    """Hulls of group g are of_group[g]:of_group[g + 1]."""
    of_base: Int[np.ndarray, " b"]
    """The hull that each box of the base covers."""
    beside: Int[np.ndarray, " e"]
    """Of each vertex those that an edge joins it to; none of hulls with few vertices."""
    beside_from: Int[np.ndarray, " v_plus_1"]
    """Those of vertex v are beside[beside_from[v]:beside_from[v + 1]]."""
    begin: Int[np.ndarray, "hulls parts"]
    """The vertex that lies farthest along the middle of each part of space."""
    room: float = 0.0
    """Hulls that are nearer to each other overlap [m]."""

    @cached_property
    def arrays(self) -> HullArrays:
        """The hulls as the kernels take them."""
        return HullArrays(
            self.vertices, self.first, self.center, self.segment, self.of_group, self.of_base,
            self.beside, self.beside_from, self.begin, self.room,
        )  # fmt: skip


def link_hulls(
    model: Articulated, segments: Segments, moving: Sequence[str], standing: Sequence[str]
) -> LinkHulls:
    """Hulls of the links that move, then those of the base.

    Args:
        model: The robot.
        segments: With which segment of the arm each link moves.
        moving: The links that the arm moves, a group each.
        standing: Those of the base.
    """
    links = [(link, hull) for link in (*moving, *standing) for hull in model.hulls[link]]
    vertices = [apply(segments.T_segment_link[link], hull.vertices) for link, hull in links]
    first = np.cumsum([0, *map(len, vertices)])
    counts = [len(model.hulls[link]) for link in moving]
    boxes = [len(boxes) for link in standing for boxes in model.boxes[link]]
    many = [k for k, points in enumerate(vertices) if len(points) > FEW]
    begin = np.zeros((len(links), PARTS), np.int64)
    for k in many:
        used = np.unique(links[k][1].faces)
        begin[k] = first[k] + used[(vertices[k][used] @ MIDDLES.T).argmax(0)]
    faces = [first[k] + links[k][1].faces for k in many]
    beside, beside_from = _neighbors(faces, int(first[-1]))
    return LinkHulls(
        vertices=np.concatenate([np.zeros((0, 3)), *vertices]),
        first=first,
        center=np.array([points.mean(0) for points in vertices]).reshape(-1, 3),
        segment=np.array([segments.of_link[link] for link, _ in links], np.int64),
        of_group=np.cumsum([0, *counts]),
        of_base=np.repeat(sum(counts) + np.arange(len(boxes)), boxes),
        beside=beside,
        beside_from=beside_from,
        begin=begin,
    )


def _neighbors(
    faces: Sequence[Int[np.ndarray, "_ 3"]], count: int
) -> tuple[Int[np.ndarray, " e"], Int[np.ndarray, " v_plus_1"]]:
    """The vertices beside each of so many, one vertex after the other, and where those begin."""
    corners = np.concatenate([np.zeros((0, 3), np.int64), *faces])
    start, end = corners.T.reshape(-1), np.roll(corners, -1, 1).T.reshape(-1)
    # Both ways, though mostly the next face goes back along the edge: flat faces have no sides.
    start, end = np.divmod(
        np.unique(np.r_[start * count + end, end * count + start]), max(1, count)
    )
    return end, np.searchsorted(start, np.arange(count + 1))
