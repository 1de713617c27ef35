"""Drawing a scan: its points by object or in their original colors, boxes and names."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from momapos.apps.plots import INK
from momapos.core.geometry import rotation
from momapos.model.urdf import Boxes

from .colors import rgb
from .map_layers import box_edges
from .panel import CLOUDS, POINTS, Panel

if TYPE_CHECKING:
    from jaxtyping import Float, Int, UInt8, UInt32
    from viser import SceneApi

    from momapos.core.geometry import UprightBox
    from momapos.model.records import Detection
    from momapos.perception import Modeled


LEVELS = 10
"""Levels of the octree over the cloud: 1,024 cells along each edge, of 4 cm in 40 m [-]."""
MORTON_STEPS = ((16, 0x030000FF), (8, 0x0300F00F), (4, 0x030C30C3), (2, 0x09249249))
"""Shifts and masks that put two zeros between ten bits."""


def spread_order(
    points: Float[np.ndarray, "n 3"], rng: np.random.Generator
) -> Int[np.ndarray, " n"]:
    """Order points by one of each cell of a coarse grid, then of a grid twice as fine, and so on.

    A random order would oversample dense regions and leave holes elsewhere.

    Args:
        points: The cloud [m].
        rng: Chooses the point of a cell.

    Returns:
        Indices into the points.
    """
    count = len(points)
    if count == 0:
        return np.zeros(0, np.int64)
    # The point with the lowest rank in a cell has it in its subcell, too: none is taken twice.
    order = rng.permutation(count)
    rank = np.empty(count, np.int64)
    rank[order] = np.arange(count)
    cells = morton(points)
    sorted_by_cell = np.argsort(cells)
    cells, ranks = cells[sorted_by_cell], rank[sorted_by_cell]
    level = np.full(count, LEVELS + 1)
    for depth in range(LEVELS, -1, -1):
        cell = cells >> np.uint32(3 * (LEVELS - depth))
        begins = np.flatnonzero(np.diff(cell, prepend=cell[0] + 1))
        level[order[np.minimum.reduceat(ranks, begins)]] = depth
    return np.argsort(level * count + rank)


def morton(points: Float[np.ndarray, "n 3"]) -> UInt32[np.ndarray, " n"]:
    """Return the Morton codes of points in the finest grid; those of a larger cell are contiguous.

    By Morton: A computer oriented geodetic data base, 1966.
    """
    low = points.min(axis=0)
    edge = float(np.ptp(points, axis=0).max()) / 2**LEVELS
    cells = ((points - low) / (edge or 1.0)).astype(np.uint32)
    cells = np.minimum(cells, np.uint32(2**LEVELS - 1))
    for shift, mask in MORTON_STEPS:
        cells = (cells | (cells << np.uint32(shift))) & np.uint32(mask)
    return cells[:, 0] | (cells[:, 1] << np.uint32(1)) | (cells[:, 2] << np.uint32(2))


ROOT = "/scan"
FINE, COARSE = f"{ROOT}/fine", f"{ROOT}/coarse"
"""Nodes of all that is selected (points, boxes, names), and of the few points that replace it while
a slow browser's camera moves; see `DetailControl`."""
OBJECT_COLORS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#8c7ae6",
                 "#5a3a00")  # fmt: skip
"""Colors of successive objects (Okabe and Ito, and two more)."""
BACKGROUND = "#c9ced3"
"""Color of points that belong to no object."""
NAME_HEIGHT = 0.08
"""Height of the letters of a name [m]."""
COARSE_POINTS = 8_000
"""Points that are drawn while a slow browser's camera moves [-]."""
POINT_SIZE, MAX_POINT_SIZE = 0.012, 0.024
"""Size of a point if all are shown; larger ones cover the same area if fewer are shown [m]."""
MAX_COARSE_POINT_SIZE = 0.05
"""Maximum size of the coarse points [m]."""
PartKey: TypeAlias = tuple[str, str, int]
"""Key of a part of the points: parent node, coloring, number."""


class ScanView:
    """Draws a scan. Points are sent in parts, each when it is first needed."""

    def __init__(self, api: SceneApi, panel: Panel) -> None:
        self._api, self._panel = api, panel
        self._modeled: Modeled | None = None
        self._parts: dict[PartKey, Any] = {}
        self._boxes: list[Any] = []
        self._rooted = False
        for handle in (panel.cloud, panel.points, panel.boxes):
            panel.on_change(handle, self.changed)

    @property
    def sent(self) -> int:
        """Number of points that the browsers have [-]."""
        return sum(len(part.points) for part in self._parts.values())

    @property
    def many(self) -> bool:
        """Whether more points are shown than the coarse ones."""
        return self._shown > COARSE_POINTS

    def show(self, modeled: Modeled | None) -> None:
        """Draw another scan; None draws none."""
        if modeled is self._modeled:
            return
        for node in (*self._parts.values(), *self._boxes):
            node.remove()
        self._parts, self._boxes, self._modeled = {}, [], modeled
        self._panel.scan_folder.visible = modeled is not None
        if modeled is None:
            return
        if not self._rooted:  # never removed: each browser has its own visibility of them
            self._api.add_frame(FINE, show_axes=False)
            self._api.add_frame(COARSE, show_axes=False, visible=False)
            self._rooted = True
        # One order for every number of points, so that no point is sent twice.
        self._order = spread_order(modeled.cloud.points, np.random.default_rng(0))
        self._draw_boxes([decision.detection for decision in modeled.decisions])
        self.changed()

    def changed(self) -> None:
        """Draw what the panel selects."""
        if self._modeled is None:
            return
        count, shown = len(self._modeled.cloud.points), self._shown
        wanted = self._wanted(shown)
        for part, node in self._parts.items():
            node.visible = part in wanted
        for part, taken in wanted.items():
            if part not in self._parts:
                self._parts[part] = self._draw(part, taken)
        for (root, *_), node in self._parts.items():
            node.point_size = point_size(count, shown) if root == FINE else coarse_point_size(count)
        self._panel.points_shown.content = f"{shown:,} of {count:,} points drawn."
        for node in self._boxes:
            node.visible = bool(self._panel.boxes.value)

    @property
    def _shown(self) -> int:
        """Number of points that the panel selects."""
        if self._modeled is None or self._panel.cloud.value == "none":
            return 0
        count, limit = len(self._modeled.cloud.points), POINTS[self._panel.points.value]
        return min(count, limit or count)

    def _wanted(self, shown: int) -> dict[PartKey, slice]:
        """Return the parts that contain so many points, and their slices of the order."""
        assert self._modeled is not None
        coloring, count = self._panel.cloud.value, len(self._modeled.cloud.points)
        ends = [end for end in POINTS.values() if end is not None and end < count] + [count]
        parts = {
            (FINE, coloring, level): slice(begin, end)
            for level, (begin, end) in enumerate(zip([0, *ends], ends, strict=False))
            if begin < shown
        }
        return parts | ({(COARSE, coloring, 0): slice(0, COARSE_POINTS)} if shown else {})

    def _draw(self, part: PartKey, taken: slice) -> Any:
        assert self._modeled is not None
        root, coloring, level = part
        cloud, picked = self._modeled.cloud, self._order[taken]
        colors = object_colors(self._modeled) if coloring == CLOUDS[0] else cloud.colors
        # 16 bits are half the bytes, and fine enough relative to the middle.
        middle = cloud.points.mean(0)
        return self._api.add_point_cloud(
            f"{root}/{coloring.replace(' ', '_')}{level}", cloud.points[picked] - middle,
            colors[picked], point_size=POINT_SIZE, point_shape="square", precision="float16",
            position=middle,
        )  # fmt: skip

    def _draw_boxes(self, detections: list[Detection]) -> None:
        if not detections:
            return
        edges = box_edges(oriented_boxes([one.box for one in detections])).reshape(-1, 2, 3)
        self._boxes.append(
            self._api.add_line_segments(f"{FINE}/boxes", edges, rgb(INK), thickness=0.008)
        )
        for k, one in enumerate(detections):
            top = one.box.center + np.array([0.0, 0.0, one.box.size[2] / 2])
            self._boxes.append(self._api.add_label(
                f"{FINE}/name{k}", one.name, position=top, font_size_mode="scene",
                font_scene_height=NAME_HEIGHT, anchor="bottom-center",
            ))  # fmt: skip


def point_size(count: int, shown: int) -> float:
    """Return the size of points if so many of `count` are shown: they cover the same area [m]."""
    return min(POINT_SIZE * float(np.sqrt(count / max(shown, 1))), MAX_POINT_SIZE)


def coarse_point_size(count: int) -> float:
    """Return the size of the coarse points of a cloud of `count` points [m]."""
    size = POINT_SIZE * float(np.sqrt(max(count / COARSE_POINTS, 1.0)))
    return min(size, MAX_COARSE_POINT_SIZE)


def oriented_boxes(upright: Sequence[UprightBox]) -> Boxes:
    """Convert upright boxes to oriented ones."""
    yaw = np.array([box.yaw for box in upright])
    turned = np.zeros((len(upright), 3, 3))
    turned[:, :2, :2], turned[:, 2, 2] = rotation(yaw), 1.0
    center = np.array([box.center for box in upright])
    return Boxes(center, turned, np.array([box.size for box in upright]) / 2)


def object_colors(modeled: Modeled) -> UInt8[np.ndarray, "n 3"]:
    """Color each point by the object it belongs to."""
    colors = np.tile(np.array(rgb(BACKGROUND), np.uint8), (len(modeled.cloud.points), 1))
    for k, decision in enumerate(modeled.decisions):
        colors[decision.detection.members] = rgb(OBJECT_COLORS[k % len(OBJECT_COLORS)])
    return colors
