"""A scan on the page: its points, by thing or as they were seen, boxes and names."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from momapos.apps.plots import INK
from momapos.core.geometry import rotation
from momapos.model.urdf import Boxes

from .map_layers import box_edges
from .panel import POINTS, Panel
from .point_order import spread_order
from .room_view import rgb

if TYPE_CHECKING:
    from jaxtyping import UInt8
    from viser import SceneApi

    from momapos.core.geometry import UprightBox
    from momapos.model.records import Detection
    from momapos.perception import Modeled

ROOT = "/scan"
FINE, COARSE = f"{ROOT}/fine", f"{ROOT}/coarse"
"""Nodes of what is asked for: points, boxes and names; and of few points that stand for all of it,
see `Moving`."""
THINGS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#8c7ae6", "#5a3a00")
"""Colors of things, one after the other (Okabe and Ito, and two more)."""
ROOM = "#c9ced3"
"""Of points that are in no thing."""
NAME = 0.08
"""Height of the letters of a name [m]."""
FEW = 8_000
"""Points that stand for all of them while a camera moves [-]."""
SIZE, LARGEST = 0.012, 0.024
"""Size of a point where all are shown; and at most, where fewer are to cover as much [m]."""
LARGEST_OF_FEW = 0.05
"""The same of a point that stands for many while a camera moves [m]."""
Part: TypeAlias = tuple[str, str, int]
"""Of the points: under which node it hangs, how it is colored, and its number."""


class ScanView:
    """Draws a scan. Points are sent in parts, each only when it is asked for."""

    def __init__(self, api: SceneApi, panel: Panel) -> None:
        self._api, self._panel = api, panel
        self._modeled: Modeled | None = None
        self._parts: dict[Part, Any] = {}
        self._boxes: list[Any] = []
        self._rooted = False

    @property
    def sent(self) -> int:
        """How many points are at the browsers [-]."""
        return sum(len(part.points) for part in self._parts.values())

    @property
    def many(self) -> bool:
        """Whether more points are shown than stand for them while a camera moves."""
        return self._shown > FEW

    def show(self, modeled: Modeled | None) -> None:
        """Draw another scan; None: there is none."""
        if modeled is self._modeled:
            return
        for node in (*self._parts.values(), *self._boxes):
            node.remove()
        self._parts, self._boxes, self._modeled = {}, [], modeled
        self._panel.scan_folder.visible = modeled is not None
        if modeled is None:
            return
        if not self._rooted:  # kept from then on, for browsers may show the one or the other
            self._api.add_frame(FINE, show_axes=False)
            self._api.add_frame(COARSE, show_axes=False, visible=False)
            self._rooted = True
        # The same points for every number, so that more of them are sent and none again.
        self._order = spread_order(modeled.cloud.points, np.random.default_rng(0))
        self._draw_boxes([decision.detection for decision in modeled.decisions])
        self.changed()

    def changed(self) -> None:
        """Something else is to be seen of it."""
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
            node.point_size = edge(count, shown) if root == FINE else edge_of_few(count)
        self._panel.points_shown.content = f"{shown:,} of {count:,} points are drawn."
        for node in self._boxes:
            node.visible = bool(self._panel.boxes.value)

    @property
    def _shown(self) -> int:
        """How many points are asked for."""
        if self._modeled is None or self._panel.cloud.value == "none":
            return 0
        count, most = len(self._modeled.cloud.points), POINTS[self._panel.points.value]
        return min(count, most or count)

    def _wanted(self, shown: int) -> dict[Part, slice]:
        """The parts that so many points are in, and which they are in the order of the points."""
        assert self._modeled is not None
        coloring, count = self._panel.cloud.value, len(self._modeled.cloud.points)
        ends = [end for end in POINTS.values() if end is not None and end < count] + [count]
        parts = {
            (FINE, coloring, level): slice(begin, end)
            for level, (begin, end) in enumerate(zip([0, *ends], ends, strict=False))
            if begin < shown
        }
        return parts | ({(COARSE, coloring, 0): slice(0, FEW)} if shown else {})

    def _draw(self, part: Part, taken: slice) -> Any:
        assert self._modeled is not None
        root, coloring, level = part
        cloud, picked = self._modeled.cloud, self._order[taken]
        colors = cloud.colors if coloring == "as seen" else thing_colors(self._modeled)
        # Half the bytes in 16 bits, which are fine enough about the middle.
        middle = cloud.points.mean(0)
        return self._api.add_point_cloud(
            f"{root}/{coloring.replace(' ', '_')}{level}", cloud.points[picked] - middle,
            colors[picked], point_size=SIZE, point_shape="square", precision="float16",
            position=middle,
        )  # fmt: skip

    def _draw_boxes(self, things: list[Detection]) -> None:
        if not things:
            return
        edges = box_edges(boxes_of([one.box for one in things])).reshape(-1, 2, 3)
        self._boxes.append(
            self._api.add_line_segments(f"{FINE}/boxes", edges, rgb(INK), thickness=0.008)
        )
        for k, one in enumerate(things):
            top = one.box.center + np.array([0.0, 0.0, one.box.size[2] / 2])
            self._boxes.append(self._api.add_label(
                f"{FINE}/name{k}", one.name, position=top, font_size_mode="scene",
                font_scene_height=NAME, anchor="bottom-center",
            ))  # fmt: skip


def edge(count: int, shown: int) -> float:
    """Size of points of which so many are shown of so many [m]: they cover as much as all do."""
    return min(SIZE * float(np.sqrt(count / max(shown, 1))), LARGEST)


def edge_of_few(count: int) -> float:
    """Size of the few that stand for all of so many points [m]."""
    return min(SIZE * float(np.sqrt(max(count / FEW, 1.0))), LARGEST_OF_FEW)


def boxes_of(upright: Sequence[UprightBox]) -> Boxes:
    """Upright boxes as oriented ones."""
    yaw = np.array([box.yaw for box in upright])
    turned = np.zeros((len(upright), 3, 3))
    turned[:, :2, :2], turned[:, 2, 2] = rotation(yaw), 1.0
    center = np.array([box.center for box in upright])
    return Boxes(center, turned, np.array([box.size for box in upright]) / 2)


def thing_colors(modeled: Modeled) -> UInt8[np.ndarray, "n 3"]:
    """A color for each point: that of the thing it is in."""
    colors = np.tile(np.array(rgb(ROOM), np.uint8), (len(modeled.cloud.points), 1))
    for k, decision in enumerate(modeled.decisions):
        colors[decision.detection.members] = rgb(THINGS[k % len(THINGS)])
    return colors
