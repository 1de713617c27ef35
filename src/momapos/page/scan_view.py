"""A scan on the page: its points, by thing or as they were seen, boxes and names."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.geometry.planar import rotation
from momapos.kinematics.hulls import Boxes
from momapos.page.layers import box_edges
from momapos.page.panel import POINTS, Panel
from momapos.page.room_view import rgb
from momapos.page.spread import spread_order
from momapos.viewer.palette import INK

if TYPE_CHECKING:
    from jaxtyping import UInt8
    from viser import SceneApi

    from momapos.scan_records import Modeled
    from momapos.types import Detection, UprightBox

ROOT = "/scan"
THINGS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#8c7ae6", "#5a3a00")
"""Colors of things, one after the other (Okabe and Ito, and two more)."""
ROOM = "#c9ced3"
"""Of points that are in no thing."""
NAME = 0.08
"""Height of the letters of a name [m]."""
SIZE, LARGEST = 0.012, 0.024
"""Edge of a point where all are shown; and at most, where fewer are to cover as much [m]."""


class ScanView:
    """Draws a scan. Points are sent in parts, each only when it is asked for."""

    def __init__(self, api: SceneApi, panel: Panel) -> None:
        self._api, self._panel = api, panel
        self._modeled: Modeled | None = None
        self._parts: dict[tuple[str, int], Any] = {}
        self._boxes: list[Any] = []

    @property
    def sent(self) -> int:
        """How many points are at the browsers [-]."""
        return sum(len(part.points) for part in self._parts.values())

    def show(self, modeled: Modeled | None) -> None:
        """Draw another scan; None: there is none."""
        if modeled is self._modeled:
            return
        for node in (*self._parts.values(), *self._boxes):
            node.remove()
        self._parts, self._boxes, self._modeled = {}, [], modeled
        self._panel.scan_folder.visible = modeled is not None
        if modeled is not None:
            # The same points for every number, so that more of them are sent and none again.
            self._order = spread_order(modeled.cloud.points, np.random.default_rng(0))
            self._draw_boxes([decision.detection for decision in modeled.decisions])
            self.changed()

    def changed(self) -> None:
        """Something else is to be seen of it."""
        if self._modeled is None:
            return
        coloring, most = self._panel.cloud.value, POINTS[self._panel.points.value]
        count = len(self._modeled.cloud.points)
        ends = [end for end in POINTS.values() if end is not None and end < count] + [count]
        for level, (begin, end) in enumerate(zip([0, *ends], ends, strict=False)):
            wanted = coloring != "none" and (most is None or begin < most)
            for other in ("by thing", "as seen"):
                part = self._parts.get((other, level))
                if part is not None:
                    part.visible = wanted and other == coloring
            if wanted and (coloring, level) not in self._parts:
                self._parts[coloring, level] = self._draw(coloring, level, begin, end)
        shown = min(count, most or count)
        for part in self._parts.values():
            part.point_size = min(SIZE * float(np.sqrt(count / max(shown, 1))), LARGEST)
        if coloring == "none":
            shown = 0
        self._panel.points_shown.content = f"{shown:,} of {count:,} points are drawn."
        for node in self._boxes:
            node.visible = bool(self._panel.boxes.value)

    def _draw(self, coloring: str, level: int, begin: int, end: int) -> Any:
        assert self._modeled is not None
        cloud, picked = self._modeled.cloud, self._order[begin:end]
        colors = cloud.colors if coloring == "as seen" else thing_colors(self._modeled)
        # Half the bytes in 16 bits, which are fine enough about the middle.
        middle = cloud.points.mean(0)
        return self._api.add_point_cloud(
            f"{ROOT}/{coloring.replace(' ', '_')}{level}", cloud.points[picked] - middle,
            colors[picked], point_size=SIZE, point_shape="square", precision="float16",
            position=middle,
        )  # fmt: skip

    def _draw_boxes(self, things: list[Detection]) -> None:
        if not things:
            return
        edges = box_edges(boxes_of([one.box for one in things])).reshape(-1, 2, 3)
        self._boxes.append(
            self._api.add_line_segments(f"{ROOT}/boxes", edges, rgb(INK), thickness=0.008)
        )
        for k, one in enumerate(things):
            top = one.box.center + np.array([0.0, 0.0, one.box.size[2] / 2])
            self._boxes.append(self._api.add_label(
                f"{ROOT}/name{k}", one.name, position=top, font_size_mode="scene",
                font_scene_height=NAME, anchor="bottom-center",
            ))  # fmt: skip


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
