"""A canvas for faces: height, color and gloss of each pixel.

Coordinates are meters, x right and y down, as seen from the front. Rectangles are (left, top,
right, bottom). Everything is painted with area coverage, so that a seam of 2 mm darkens a pixel of
6 mm by a third, as in a camera image.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Rect = tuple[float, float, float, float]
Color = np.ndarray
Window = tuple[slice, slice]


def box(left: float, top: float, right: float, bottom: float) -> Rect:
    """Return a rectangle from its edges."""
    return (left, top, right, bottom)


def inset(rect: Rect, by: float, by_y: float | None = None) -> Rect:
    """Shrink a rectangle by a margin on each side; a negative margin enlarges it."""
    other = by if by_y is None else by_y
    return (rect[0] + by, rect[1] + other, rect[2] - by, rect[3] - other)


def ramp(values: np.ndarray, low: float, high: float) -> np.ndarray:
    """Return 0 below `low`, 1 above `high`, and linear values between."""
    return np.clip((values - low) / (high - low), 0.0, 1.0)


class Canvas:
    """The painted layers over a view of the face's plane."""

    def __init__(self, view: Rect, side: int) -> None:
        self.view, self.side = view, side
        self.dx = (view[2] - view[0]) / side
        self.dy = (view[3] - view[1]) / side
        self.x = (view[0] + (np.arange(side) + 0.5) * self.dx).astype(np.float32)
        self.y = (view[1] + (np.arange(side) + 0.5) * self.dy).astype(np.float32)
        self.height = np.zeros((side, side), np.float32)
        self.albedo = np.full((side, side, 3), 0.5, np.float32)
        self.gloss = np.zeros((side, side), np.float32)

    @property
    def pixel(self) -> float:
        """Return the longer side of a pixel [m]."""
        return max(self.dx, self.dy)

    def window(self, rect: Rect, pad: float = 0.0) -> Window:
        """Return the pixels that a rectangle touches."""
        i = self._span(rect[1] - pad, rect[3] + pad, self.view[1], self.dy)
        j = self._span(rect[0] - pad, rect[2] + pad, self.view[0], self.dx)
        return i, j

    def _span(self, low: float, high: float, origin: float, step: float) -> slice:
        first = int(np.clip(np.floor((low - origin) / step), 0, self.side))
        last = int(np.clip(np.ceil((high - origin) / step), first, self.side))
        return slice(first, last)

    def grid(self, window: Window) -> tuple[np.ndarray, np.ndarray]:
        """Return x as a row and y as a column over a window."""
        return self.x[None, window[1]], self.y[window[0], None]

    def cover(self, rect: Rect, window: Window) -> np.ndarray:
        """Return the share of each pixel of a window that a rectangle covers."""
        x, y = self.grid(window)
        across = np.minimum(x + self.dx / 2, rect[2]) - np.maximum(x - self.dx / 2, rect[0])
        down = np.minimum(y + self.dy / 2, rect[3]) - np.maximum(y - self.dy / 2, rect[1])
        share = np.clip(across / self.dx, 0, 1) * np.clip(down / self.dy, 0, 1)
        return share.astype(np.float32)

    def blend(
        self,
        window: Window,
        cover: np.ndarray,
        color: Color | None = None,
        height: np.ndarray | float | None = None,
        gloss: float | None = None,
    ) -> None:
        """Paint over a window with opacity `cover`."""
        if color is not None:
            area = self.albedo[window]
            area += cover[..., None] * (np.asarray(color, np.float32) - area)
        if height is not None:
            level = self.height[window]
            level += cover * (height - level)
        if gloss is not None:
            shine = self.gloss[window]
            shine += cover * (gloss - shine)

    def fill(
        self,
        rect: Rect,
        color: Color | Callable[[np.ndarray, np.ndarray], Color] | None = None,
        height: float | None = None,
        gloss: float | None = None,
        edge: float = 0.0,
    ) -> None:
        """Paint a rectangle; `edge` is the width of its rounded border [m]."""
        window = self.window(rect)
        if window[0].start == window[0].stop or window[1].start == window[1].stop:
            return
        level: np.ndarray | float | None = height
        if height is not None and edge > 0:
            x, y = self.grid(window)
            inward = np.minimum(
                np.minimum(x - rect[0], rect[2] - x), np.minimum(y - rect[1], rect[3] - y)
            )
            level = height - edge * (1 - ramp(inward, 0, edge)) ** 2 * 0.7
        paint = color(*self.grid(window)) if callable(color) else color
        self.blend(window, self.cover(rect, window), paint, level, gloss)

    def darken(self, rect: Rect, by: float) -> None:
        """Darken a rectangle by a share, for seams and soft shadows."""
        window = self.window(rect)
        self.albedo[window] *= 1 - by * self.cover(rect, window)[..., None]

    def rim(self, rect: Rect, width: float, by: float) -> None:
        """Darken a line along the border of a rectangle, outside of it."""
        left, top, right, bottom = rect
        w = width
        self.darken(box(left - w, top - w, right + w, top), by)
        self.darken(box(left - w, bottom, right + w, bottom + w), by)
        self.darken(box(left - w, top, left, bottom), by)
        self.darken(box(right, top, right + w, bottom), by)

    def raise_by(self, rect: Rect, by: float) -> None:
        """Raise or lower the height in a rectangle."""
        window = self.window(rect)
        self.height[window] += by * self.cover(rect, window)

    def capsule(
        self,
        rect: Rect,
        corner: float,
        color: Color | None,
        base: float | None,
        out: float,
        *,
        flat: float = 0.5,
        gloss: float | None = None,
    ) -> None:
        """Paint a rounded rectangle that bulges out.

        Args:
            rect: Its bounds.
            corner: Radius of its corners [m].
            color: Its color, or None to keep the present one.
            base: Height of its rim; None keeps the height.
            out: Height of its center above the rim [m].
            flat: 0 for a half round, 1 for a flat top.
            gloss: Its gloss.
        """
        window = self.window(rect, self.pixel)
        if window[0].start == window[0].stop or window[1].start == window[1].stop:
            return
        x, y = self.grid(window)
        half_x, half_y = (rect[2] - rect[0]) / 2, (rect[3] - rect[1]) / 2
        corner = min(corner, half_x, half_y)
        across = np.abs(x - (rect[0] + rect[2]) / 2) - (half_x - corner)
        down = np.abs(y - (rect[1] + rect[3]) / 2) - (half_y - corner)
        outside = np.hypot(np.maximum(across, 0), np.maximum(down, 0))
        inside = corner - outside - np.minimum(np.maximum(across, down), 0)
        soft = self.pixel / 2
        cover = ramp(inside, -soft, soft)
        if 2 * half_x < 2 * self.dx or 2 * half_y < 2 * self.dy:
            cover = self.cover(rect, window)
        level = None
        if base is not None:
            deep = max(min(half_x, half_y), 1e-4)
            dome = np.sqrt(np.clip(1 - (1 - np.clip(inside / deep, 0, 1)) ** 2, 0, 1))
            level = base + out * (flat + (1 - flat) * dome)
        self.blend(window, cover, color, level, gloss)


def smooth_noise(
    rng: np.random.Generator, shape: tuple[int, int], cells: tuple[float, float]
) -> np.ndarray:
    """Draw noise of about [-1, 1] with `cells` bumps along each axis."""
    counts = [max(2, round(c) + 1) for c in cells]
    grid = rng.standard_normal(counts).astype(np.float32) * 0.5
    return _spread(shape[0], counts[0]) @ grid @ _spread(shape[1], counts[1]).T


def _spread(length: int, count: int) -> np.ndarray:
    """Return weights that interpolate `count` values smoothly over `length` pixels."""
    at = np.linspace(0, count - 1, length, dtype=np.float32)[:, None]
    away = np.clip(np.abs(at - np.arange(count, dtype=np.float32)), 0, 1)
    return 1 - away * away * (3 - 2 * away)
