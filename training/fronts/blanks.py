"""Paint faces without parts: sides, walls, tables, shelves, books, screens, machines."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from . import fittings, materials
from .canvas import Canvas, Rect, inset
from .materials import Material

FILLS = (
    "box", "side", "back", "table", "edge", "wall", "shelves", "books", "screen", "machine",
    "clutter", "grille", "framed",
)  # fmt: skip
"""Kinds of faces without parts; blank boxes and sides are the most frequent ones in rooms."""
SHARES = (0.16, 0.08, 0.06, 0.07, 0.08, 0.08, 0.06, 0.1, 0.1, 0.09, 0.05, 0.03, 0.04)
"""Frequencies of `FILLS` [-]."""


def blank(
    rng: np.random.Generator, canvas: Canvas, plan_rect: Rect, fill: str, body: Material
) -> None:
    """Paint a face that has no parts."""
    left, top, right, bottom = plan_rect
    wide, high = right - left, bottom - top
    canvas.fill(plan_rect, body.texture, 0.0, body.gloss, 0.004)
    if fill == "table":
        board, leg = rng.uniform(0.02, 0.15), rng.uniform(0.03, 0.1)
        canvas.fill((left, top + board, right, bottom), materials.random_color(rng), -0.3)
        for x in (left, right - leg):
            canvas.fill((x, top, x + leg, bottom), body.texture, 0.0)
    elif fill == "wall":
        wall = materials.tiles(rng) if rng.random() < 0.6 else materials.paint(rng)
        canvas.fill(plan_rect, wall.texture, 0.0, wall.gloss)
        for _ in range(int(rng.integers(0, 4))):
            x, y = left + rng.uniform(0, 0.7) * wide, top + rng.uniform(0, 0.7) * high
            size = rng.uniform(0.08, 0.5, 2)
            frame = (x, y, x + size[0], y + size[1])
            canvas.fill(frame, materials.random_color(rng), 0.01, 0.2)
            if rng.random() < 0.5:
                canvas.fill(inset(frame, 0.02), materials.random_color(rng), 0.005)
    elif fill == "edge":
        _edge(rng, canvas, plan_rect)
    elif fill == "books":
        _books(rng, canvas, plan_rect, body)
    elif fill == "screen":
        _screen(rng, canvas, plan_rect)
    elif fill == "machine":
        _machine(rng, canvas, plan_rect, body)
    elif fill == "shelves":
        fittings.opening(rng, canvas, inset(plan_rect, 0.02), body)
    elif fill == "clutter":
        for _ in range(int(rng.integers(3, 25))):
            x, y = left + rng.uniform(-0.1, 0.9) * wide, top + rng.uniform(-0.1, 0.9) * high
            size = rng.uniform(0.05, 0.5, 2) * (wide, high)
            corner = rng.uniform(0, 0.3)
            shape = (x, y, x + size[0], y + size[1])
            tone = materials.random_color(rng)
            canvas.capsule(shape, corner, tone, rng.uniform(-0.2, 0.05), 0.03, flat=rng.random())
    elif fill == "grille":
        fittings.vent(rng, canvas, inset(plan_rect, 0.1 * wide, 0.1 * high))
    elif fill == "framed" or (fill == "back" and rng.random() < 0.5):
        rim = rng.uniform(0.02, 0.15)
        inner = inset(plan_rect, min(rim, 0.2 * wide), min(rim, 0.2 * high))
        canvas.fill(inner, body.texture, -rng.uniform(0.003, 0.03))
        if rng.random() < 0.4:
            canvas.fill(inner, materials.carcass(rng, False, False).texture)


def _edge(rng: np.random.Generator, canvas: Canvas, rect: Rect) -> None:
    """Paint the edge of a worktop or table over a plain surface, with a strip of shadow."""
    left, top, right, _ = rect
    slab = materials.carcass(rng, False, False)
    thick, out = rng.uniform(0.02, 0.08), rng.uniform(0.005, 0.05)
    canvas.darken((left, top + thick, right, top + thick + 0.02), rng.uniform(0.1, 0.5))
    canvas.fill((left, top, right, top + thick), slab.texture, out, slab.gloss, 0.004)
    if rng.random() < 0.4:
        foot = (left, rect[3] - rng.uniform(0.05, 0.15), right, rect[3])
        canvas.fill(foot, materials.random_color(rng), -rng.uniform(0.01, 0.06))


def _books(rng: np.random.Generator, canvas: Canvas, rect: Rect, body: Material) -> None:
    """Paint shelves full of books or boxes: upright spines of different colors and sizes."""
    left, top, right, bottom = rect
    boards = np.linspace(top, bottom, int(rng.integers(1, 5)) + 1)
    for high, low in pairwise(boards):
        canvas.fill((left, high, right, low), materials.random_color(rng) * 0.4, -0.25)
        x = left + 0.01
        wide = rng.choice([0.03, 0.06, 0.12])
        while x < right - 0.03:
            size = min(wide * rng.uniform(0.5, 1.5), right - 0.01 - x)
            tall = (low - high) * rng.uniform(0.55, 0.95)
            tone = materials.random_color(rng)
            if rng.random() < 0.9:
                spine = (x, low - tall, x + size, low - 0.01)
                canvas.fill(spine, tone, -rng.uniform(0.0, 0.06), 0.2, 0.003)
                label = inset(spine, 0.2 * size, 0.35 * tall)
                canvas.fill(label, materials.random_color(rng))
            x += size + 0.001
        canvas.fill((left, low - 0.02, right, low), body.texture, 0.0, body.gloss)


def _screen(rng: np.random.Generator, canvas: Canvas, rect: Rect) -> None:
    """Paint a screen: a frame around glass that is dark, or shows windows of bright colors."""
    frame = materials.random_color(rng) * rng.uniform(0.1, 1.0)
    canvas.fill(rect, frame, 0.0, 0.3, 0.004)
    rim = rng.uniform(0.005, 0.04)
    glass = inset(rect, rim)
    dark = np.full(3, rng.uniform(0.01, 0.12), np.float32)
    canvas.fill(glass, dark, -rng.uniform(0.0, 0.006), 0.8)
    wide, high = glass[2] - glass[0], glass[3] - glass[1]
    for _ in range(int(rng.integers(0, 5))):
        x, y = glass[0] + rng.uniform(0, 0.7) * wide, glass[1] + rng.uniform(0, 0.7) * high
        end = min(x + rng.uniform(0.1, 0.8) * wide, glass[2])
        pane = (x, y, end, min(y + rng.uniform(0.1, 0.9) * high, glass[3]))
        canvas.fill(pane, np.clip(materials.random_color(rng) * 1.3, 0, 1))
    if rng.random() < 0.4:
        foot = (rect[0] + 0.4 * wide, rect[3] - 0.03, rect[2] - 0.4 * wide, rect[3])
        canvas.fill(foot, frame, 0.01)


def _machine(rng: np.random.Generator, canvas: Canvas, rect: Rect, body: Material) -> None:
    """Paint a printer or coffee machine: slots, trays, buttons, a display."""
    left, top, right, bottom = rect
    wide, high = right - left, bottom - top
    for _ in range(int(rng.integers(1, 4))):
        y, tall = top + rng.uniform(0.1, 0.8) * high, rng.uniform(0.02, 0.2) * high
        edge = rng.uniform(0.0, 0.2) * wide
        slot = (left + edge, y, right - edge, min(y + tall, bottom))
        tone = materials.random_color(rng) * rng.uniform(0.1, 0.6)
        canvas.fill(slot, tone, -rng.uniform(0.0, 0.15))
    x, y = left + rng.uniform(0.05, 0.5) * wide, top + rng.uniform(0.03, 0.3) * high
    fittings.controls(
        rng, canvas, (x, y, x + 0.4 * wide, y + 0.15 * high), body, 0.0, rng.random() < 0.3
    )
