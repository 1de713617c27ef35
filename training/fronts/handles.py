"""Place and paint handles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .canvas import Canvas, Rect, inset
from .materials import Material, metal, plain

SHAPES = ("bar", "pro", "knob", "square", "cup", "bow", "recess", "wire", "profile", "block")


@dataclass(frozen=True)
class HandleStyle:
    """Common style of the handles of one piece of furniture."""

    shape: str
    length: float
    """Length of bars [m]."""
    thick: float
    """Thickness [m]."""
    out: float
    """Height above its part [m]."""
    inset: float
    """Distance from the free edge to its center [m]."""
    material: Material
    place: float
    """Position along the free side: 0 is the hinge end or bottom, 1 the top [-]."""


def random_style(
    rng: np.random.Generator, skin: Material, weights: tuple[float, ...], mono: bool
) -> HandleStyle:
    """Choose one kind of handle for a piece of furniture.

    Args:
        rng: Source of randomness.
        skin: Material of the doors.
        weights: Relative frequencies of `SHAPES`.
        mono: Whether handles have the color of the doors.
    """
    odds = np.array(weights, dtype=float)
    shape = str(rng.choice(SHAPES, p=odds / odds.sum()))
    thick = {
        "knob": rng.uniform(0.022, 0.05),
        "square": rng.uniform(0.02, 0.05),
        "cup": rng.uniform(0.028, 0.045),
        "recess": rng.uniform(0.015, 0.045),
        "profile": rng.uniform(0.012, 0.03),
        "block": rng.uniform(0.02, 0.06),
        "wire": rng.uniform(0.005, 0.009),
        "pro": rng.uniform(0.015, 0.035),
    }.get(shape, rng.uniform(0.008, 0.025))
    lowest, highest = {
        "cup": (0.07, 0.12),
        "block": (0.05, 0.2),
        "recess": (0.08, 0.35),
        "pro": (0.3, 0.8),
        "wire": (0.08, 0.14),
        "bow": (0.08, 0.18),
    }.get(shape, (0.08, 0.4))
    same = mono or rng.random() < 0.18
    body = plain(skin.base * rng.uniform(0.85, 1.1), skin.gloss) if same else metal(rng)
    if shape in ("knob", "block") and rng.random() < 0.25:
        body = plain(np.clip(skin.base * rng.uniform(0.6, 1.3), 0, 1), 0.2)
    return HandleStyle(
        shape,
        rng.uniform(lowest, highest),
        thick,
        0.002 if shape in ("recess", "profile") else rng.uniform(0.015, 0.06),
        rng.uniform(0.0, 0.02) if rng.random() < 0.15 else rng.uniform(0.02, 0.07),
        body,
        rng.uniform(0.35, 0.95),
    )


def place(
    rng: np.random.Generator, style: HandleStyle, part: Rect, free: str, along: float
) -> Rect:
    """Return the bounds of a handle on a part.

    Args:
        rng: Source of randomness.
        style: Kind of handle.
        part: The part.
        free: Side at which it opens: "left", "right", "top", "bottom" or "middle".
        along: Position along that side, 0 at its left or top end, 1 at the other.
    """
    left, top, right, bottom = part
    width, height = right - left, bottom - top
    upright = free in ("left", "right")
    side = height if upright else width
    depth = width if upright else height
    thick = min(style.thick, 0.5 * depth)
    long = style.length
    if style.shape in ("knob", "square"):
        long = thick = min(thick, 0.45 * side)
    elif style.shape == "pro":
        long = side * np.clip(style.length + 0.2, 0.4, 0.95)
    elif style.shape == "profile":
        long = side * (0.98 if style.length > 0.2 else style.length * 3)
    if style.shape == "cup" and upright:  # open below, so it stays level, next to the free edge
        return _in_corner(style, part, free, along)
    long = min(long, 0.9 * side)
    middle = np.clip(along * side, long / 2 + 0.01 * side, side - long / 2 - 0.01 * side)
    away = style.inset + thick / 2
    if style.shape in ("recess", "profile"):
        away = thick / 2 + (0.002 if rng.random() < 0.7 else 0.015)
    if free == "middle":
        away = depth / 2
    away = float(np.clip(away, thick / 2, depth - thick / 2))
    if upright:
        x = left + away if free == "left" else right - away
        return (x - thick / 2, top + middle - long / 2, x + thick / 2, top + middle + long / 2)
    y = bottom - away if free == "bottom" else top + away
    return (left + middle - long / 2, y - thick / 2, left + middle + long / 2, y + thick / 2)


def _in_corner(style: HandleStyle, part: Rect, free: str, along: float) -> Rect:
    """Return the bounds of a level handle next to the left or right edge of a part."""
    left, top, right, bottom = part
    long, thick = min(style.length, 0.45 * (right - left)), min(style.thick, 0.5 * (bottom - top))
    away = min(style.inset, right - left - long)
    x = left + away if free == "left" else right - away - long
    y = float(np.clip(top + along * (bottom - top), top + thick / 2, bottom - thick / 2))
    return (x, y - thick / 2, x + long, y + thick / 2)


def draw(
    rng: np.random.Generator, canvas: Canvas, style: HandleStyle, rect: Rect, level: float
) -> None:
    """Paint a handle on a part whose front is at height `level`."""
    color, gloss = style.material.base, style.material.gloss
    wide, high = rect[2] - rect[0], rect[3] - rect[1]
    thick, upright = min(wide, high), high > wide
    if style.shape in ("knob", "square"):
        corner = thick if style.shape == "knob" else thick * rng.uniform(0, 0.2)
        if rng.random() < 0.3:
            canvas.capsule(inset(rect, -0.2 * thick), corner * 1.4, color * 0.8, level, 0.003)
        canvas.capsule(rect, corner, color, level + 0.4 * style.out, 0.6 * style.out, gloss=gloss)
        if rng.random() < 0.4:
            canvas.capsule(
                inset(rect, 0.25 * thick), corner, color * 1.25, level + 0.7 * style.out, 0.01
            )
    elif style.shape == "cup":
        _cup(canvas, style, rect, level)
    elif style.shape == "recess":
        shade = rng.uniform(0.25, 0.8)
        canvas.fill(
            rect, canvas.albedo[canvas.window(rect)] * shade, level - rng.uniform(0.008, 0.03)
        )
    elif style.shape == "profile":
        canvas.fill(rect, color, level + rng.uniform(0, 0.015), gloss, edge=0.003)
    elif style.shape == "block":
        corner = thick * rng.uniform(0, 0.5)
        canvas.capsule(rect, corner, color, level, style.out, flat=rng.random(), gloss=gloss)
    else:
        _bar(rng, canvas, style, rect, level, upright)


def _cup(canvas: Canvas, style: HandleStyle, rect: Rect, level: float) -> None:
    """Paint a half shell, open below."""
    color, gloss = style.material.base, style.material.gloss
    left, top, right, bottom = rect
    canvas.capsule(rect, (right - left) / 2, color, level, style.out, flat=0.1, gloss=gloss)
    lip = bottom - 0.2 * (bottom - top)
    canvas.darken((left + 0.08 * (right - left), lip, right - 0.08 * (right - left), bottom), 0.6)


def _bar(
    rng: np.random.Generator,
    canvas: Canvas,
    style: HandleStyle,
    rect: Rect,
    level: float,
    upright: bool,
) -> None:
    """Paint a bar on two posts; a bow has a thinner center, a wire is thin."""
    color, gloss = style.material.base, style.material.gloss
    wide, high = rect[2] - rect[0], rect[3] - rect[1]
    thick, long = min(wide, high), max(wide, high)
    post = thick * rng.uniform(1.0, 1.5)
    end = long * rng.uniform(0.0, 0.12)
    for start in (end, long - end - post):
        foot = (
            (rect[0], rect[1] + start, rect[2], rect[1] + start + post)
            if upright
            else (rect[0] + start, rect[1], rect[0] + start + post, rect[3])
        )
        canvas.fill(foot, color * 0.8, level + style.out * 0.6, gloss)
    corner = thick * (0.5 if rng.random() < 0.6 else 0.05)
    body = rect
    if style.shape == "bow":
        slim = thick * rng.uniform(0.1, 0.3)
        body = inset(rect, slim, 0.0) if upright else inset(rect, 0.0, slim)
    canvas.capsule(
        body, corner, color, level + style.out - thick / 2, thick / 2, flat=0.2, gloss=gloss
    )
