"""Paint the fields of a face: doors, drawers, controls, shelves, bare sides."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from . import materials
from .canvas import Canvas, Rect, inset, ramp, smooth_noise
from .materials import Material


@dataclass(frozen=True)
class DoorStyle:
    """Common style of the doors and drawers of one piece of furniture."""

    form: str
    """slab, shaker, raised, louvre, bead, print, carved or double."""
    skin: Material
    panel: Material
    frame: float
    """Width of the frame around the panel [m]."""
    deep: float
    """Depth of the panel behind the frame [m]."""
    out: float
    """Height of the front above the body [m]."""
    edge: float
    """Width of the rounded border [m]."""
    window: Material
    uniform: bool
    """Whether it is drawn plainly, like CAD models."""
    mono: bool
    """Whether everything has the color of the body, including handles."""
    corner: float
    """Corner radius of the fronts [m]."""


def random_door_style(
    rng: np.random.Generator, body: Material, appliance: bool, uniform: bool
) -> DoorStyle:
    """Choose how the fronts of one piece of furniture look."""
    forms = ["slab", "shaker", "raised", "louvre", "bead", "print", "carved", "double"]
    odds = [0.4, 0.24, 0.12, 0.03, 0.04, 0.06, 0.05, 0.06]
    form = str(rng.choice(forms, p=odds))
    if (appliance and rng.random() < 0.93) or (uniform and rng.random() < 0.4):
        form = "slab"
    mono = rng.random() < (0.4 if uniform else 0.04)
    draw = rng.random()
    if mono:
        skin = body
    elif draw < 0.6:
        skin = body if rng.random() < 0.5 else materials.like(rng, body)
    else:
        skin = materials.carcass(rng, appliance, uniform)
    other = rng.random()
    panel = skin
    if form == "print" or other < 0.08:
        panel = materials.tiles(rng)
    elif other < 0.25 and not mono:
        panel = materials.carcass(rng, appliance, uniform)
    inset_door = not appliance and rng.random() < 0.35
    out = rng.uniform(-0.006, 0.003) if inset_door else rng.uniform(0.004, 0.03)
    if appliance and rng.random() < 0.6:
        out = rng.uniform(0.01, 0.09)
    return DoorStyle(
        form,
        skin,
        panel,
        rng.uniform(0.03, 0.1),
        rng.uniform(0.003, 0.02),
        out,
        rng.uniform(0.001, 0.006) if rng.random() < 0.7 else rng.uniform(0.006, 0.03),
        materials.glass(rng),
        uniform,
        mono,
        rng.uniform(0.01, 0.12) if rng.random() < (0.15 if appliance else 0.02) else 0.0,
    )


def door(rng: np.random.Generator, canvas: Canvas, rect: Rect, style: DoorStyle, fill: str) -> None:
    """Paint a door or drawer front."""
    tint = 1.0 if style.uniform else rng.normal(1, 0.025)
    if style.corner:
        tone = np.clip(style.skin.base * tint, 0, 1)
        canvas.capsule(rect, style.corner, tone, style.out - 0.004, 0.004, flat=0.0)
    else:
        canvas.fill(
            rect, _texture(style.skin, tint), style.out, style.skin.gloss, min(style.edge, 0.02)
        )
    wide, high = rect[2] - rect[0], rect[3] - rect[1]
    frame = min(style.frame, 0.3 * min(wide, high))
    if fill == "window":
        _window(rng, canvas, rect, style)
    elif fill == "glass":
        _pane(rng, canvas, inset(rect, frame), style)
    elif min(wide, high) > 0.09:
        _panel(rng, canvas, rect, frame, style)


def _texture(material: Material, tint: float) -> materials.Texture:
    return lambda x, y: np.clip(material.texture(x, y) * tint, 0, 1)


def _panel(
    rng: np.random.Generator, canvas: Canvas, rect: Rect, frame: float, style: DoorStyle
) -> None:
    """Paint the panel within the frame of a front."""
    inner = inset(rect, frame)
    level = style.out - style.deep
    if style.form in ("shaker", "bead", "louvre", "print", "double"):
        canvas.fill(inner, style.panel.texture, level, style.panel.gloss)
        if style.form == "double":
            core = inset(inner, frame * 0.4)
            canvas.fill(core, None, level - 0.4 * style.deep)
        if rng.random() < 0.3:
            canvas.rim(inset(inner, canvas.pixel), canvas.pixel, rng.uniform(0.05, 0.3))
    if style.form in ("bead", "louvre"):
        window = canvas.window(inner)
        x, y = canvas.grid(window)
        if style.form == "bead":
            pitch = 0.06 if style.frame < 0.06 else 0.1
            canvas.albedo[window] *= 1 - 0.35 * ((x % pitch) < max(0.005, canvas.dx))[..., None]
        else:
            pitch = 0.03 if style.frame < 0.06 else 0.045
            canvas.height[window] += ((y % pitch) / pitch - 0.5) * 0.012
    elif style.form == "raised":
        canvas.fill(inner, style.panel.texture, level, style.panel.gloss)
        _mound(canvas, inset(inner, frame * 0.12), frame * 0.5, style.deep)
    elif style.form == "carved":
        canvas.fill(inner, style.panel.texture, level, style.panel.gloss)
        window = canvas.window(inner)
        x, y = canvas.grid(window)
        pitch = max(0.02, 3 * canvas.pixel)
        lumps = np.sin(6.28 * x / pitch) * np.sin(6.28 * y / pitch)
        near = 1 - ramp(
            np.minimum(
                np.minimum(x - inner[0], inner[2] - x), np.minimum(y - inner[1], inner[3] - y)
            ),
            pitch,
            1.2 * pitch,
        )
        canvas.height[window] += 0.006 * np.maximum(lumps, 0) * near


def _mound(canvas: Canvas, rect: Rect, slope: float, up: float) -> None:
    window = canvas.window(rect)
    x, y = canvas.grid(window)
    inward = np.minimum(np.minimum(x - rect[0], rect[2] - x), np.minimum(y - rect[1], rect[3] - y))
    canvas.height[window] += up * ramp(inward, 0, max(slope, 1e-3))


def _pane(rng: np.random.Generator, canvas: Canvas, rect: Rect, style: DoorStyle) -> None:
    """Paint glass in a frame, sometimes with bars."""
    canvas.fill(rect, style.window.texture, style.out - style.deep, style.window.gloss)
    if rng.random() < 0.4:
        wide, high = rect[2] - rect[0], rect[3] - rect[1]
        bar = rng.uniform(0.008, 0.025)
        for i in range(1, int(rng.integers(1, 4))):
            x = rect[0] + wide * i / 3
            canvas.fill((x - bar / 2, rect[1], x + bar / 2, rect[3]), style.skin.texture, style.out)
        for i in range(1, int(rng.integers(1, 5))):
            y = rect[1] + high * i / 4
            canvas.fill((rect[0], y - bar / 2, rect[2], y + bar / 2), style.skin.texture, style.out)


def _window(rng: np.random.Generator, canvas: Canvas, rect: Rect, style: DoorStyle) -> None:
    """Paint the window of an oven or microwave door."""
    wide, high = rect[2] - rect[0], rect[3] - rect[1]
    if rng.random() < 0.3:
        canvas.fill(rect, style.window.texture, style.out, style.window.gloss, style.edge)
    left, right = rng.uniform(0.05, 0.2, 2) * wide
    top, bottom = rng.uniform(0.06, 0.3) * high, rng.uniform(0.05, 0.25) * high
    if rng.random() < 0.6:
        right = left
    pane = (rect[0] + left, rect[1] + top, rect[2] - right, rect[3] - bottom)
    corner = rng.choice([0.0, 0.02, 0.06])
    shade = rng.uniform(0.3, 1.6)
    tone = np.clip(style.window.base * shade, 0, 1)
    canvas.capsule(pane, corner, tone, None, 0.0, gloss=style.window.gloss)
    if rng.random() < 0.4:
        canvas.fill(pane, None, style.out - rng.uniform(0.002, 0.02))
    if rng.random() < 0.25:
        canvas.capsule(inset(pane, 0.08 * wide, 0.08 * high), corner, tone * 0.6, None, 0.0)


def hardware(rng: np.random.Generator, canvas: Canvas, rect: Rect, left: bool) -> None:
    """Paint visible hinges on one side of a door."""
    color = materials.metal(rng).base
    high, tall = rect[3] - rect[1], rng.uniform(0.03, 0.07)
    wide = rng.uniform(0.006, 0.014)
    x = rect[0] if left else rect[2]
    for share in (0.12, 0.88) if rng.random() < 0.7 else (0.1, 0.5, 0.9):
        y = rect[1] + share * high
        canvas.fill((x - wide, y - tall / 2, x + wide, y + tall / 2), color, 0.01, 0.4)


def controls(
    rng: np.random.Generator, canvas: Canvas, rect: Rect, skin: Material, out: float, knobs: bool
) -> None:
    """Paint a strip with buttons, a display or knobs."""
    if rng.random() < 0.4:
        skin = materials.plain(np.full(3, rng.uniform(0.02, 0.2), np.float32), 0.5)
    canvas.fill(rect, skin.texture, out * rng.choice([0.0, 0.5, 1.0]), skin.gloss, 0.002)
    wide, high = rect[2] - rect[0], rect[3] - rect[1]
    metal = materials.metal(rng)
    if knobs:
        count = int(rng.integers(2, 8))
        size = min(rng.uniform(0.35, 0.7) * high, 0.06)
        for i in range(count):
            if rng.random() < 0.15:
                continue
            x = rect[0] + wide * (i + 0.5) / count
            y = (rect[1] + rect[3]) / 2
            dial = (x - size / 2, y - size / 2, x + size / 2, y + size / 2)
            canvas.capsule(dial, size, metal.base, out, 0.02, flat=0.7, gloss=metal.gloss)
        return
    if rng.random() < 0.75:
        lit = rng.random() < 0.5
        screen = np.array((0.05, 0.3, 0.3) if lit else (0.03, 0.05, 0.05), np.float32)
        a, b = rng.uniform(0.1, 0.4), rng.uniform(0.06, 0.15)
        if wide > high:
            place = (rect[0] + a * wide, rect[1] + 0.25 * high, rect[0] + (a + 0.2) * wide)
            canvas.fill((*place, rect[3] - 0.25 * high), screen, None, 0.6)
        else:
            place = (rect[0] + 0.12 * wide, rect[1] + b * high, rect[2] - 0.12 * wide)
            canvas.fill((*place, rect[1] + (b + 0.14) * high), screen, None, 0.6)
    if rng.random() < 0.8:
        _buttons(rng, canvas, rect, metal)


def _buttons(rng: np.random.Generator, canvas: Canvas, rect: Rect, metal: Material) -> None:
    wide, high = rect[2] - rect[0], rect[3] - rect[1]
    rows = 1 if wide > 2 * high else int(rng.integers(3, 8))
    columns = int(rng.integers(2, 4)) if wide < 2 * high else int(rng.integers(3, 12))
    fill, out = rng.uniform(0.3, 0.85, 2), rng.uniform(0, 0.006)
    top = 0.3 if rows > 1 else 0.2
    pitch_x, pitch_y = 0.8 * wide / columns, (0.9 - top) * high / rows
    for i in range(rows):
        for j in range(columns):
            x = rect[0] + 0.1 * wide + j * pitch_x
            y = rect[1] + top * high + i * pitch_y
            button = (x, y, x + fill[0] * pitch_x, y + fill[1] * pitch_y)
            canvas.fill(button, metal.base, None, 0.3)
            if out > 0.003:
                canvas.raise_by(button, out)


def opening(rng: np.random.Generator, canvas: Canvas, rect: Rect, body: Material) -> None:
    """Paint an open field: dark inside, with shelves and objects on them."""
    dark = rng.uniform(0.15, 0.8)
    canvas.fill(rect, _texture(body, dark), -rng.uniform(0.1, 0.4))
    wide, high = rect[2] - rect[0], rect[3] - rect[1]
    canvas.darken((rect[0], rect[1], rect[2], rect[1] + 0.2 * high), 0.3)
    for i in range(1, int(rng.integers(1, 5))):
        y = rect[1] + high * i / 4
        canvas.fill((rect[0], y - 0.01, rect[2], y + 0.01), body.texture, 0.0)
    for _ in range(int(rng.integers(0, 8))):
        x, size = rect[0] + rng.uniform(0, 0.8) * wide, rng.uniform(0.05, 0.25)
        y = rect[3] - rng.integers(0, 4) * high / 4
        shape = (x, y - size * high, min(x + size * wide, rect[2]), y)
        canvas.fill(shape, materials.random_color(rng), -0.08, 0.2)


def vent(rng: np.random.Generator, canvas: Canvas, rect: Rect) -> None:
    """Paint slots, or a dark kick plate."""
    canvas.fill(rect, np.full(3, rng.uniform(0.02, 0.25), np.float32), -0.04)
    if rng.random() < 0.5:
        window = canvas.window(rect)
        x, y = canvas.grid(window)
        along = (y if rng.random() < 0.5 else x) % 0.02
        canvas.albedo[window] *= 1 + 0.8 * (along < 0.01)[..., None]


def distractors(rng: np.random.Generator, canvas: Canvas, rect: Rect, fridge: bool) -> None:
    """Paint objects that are not parts: paper, magnets, a logo, a towel, a water dispenser."""
    wide, high = rect[2] - rect[0], rect[3] - rect[1]
    level = float(np.median(canvas.height[canvas.window(rect)])) if wide > 0 and high > 0 else 0.0
    if fridge and rng.random() < 0.25 and wide > 0.25 and high > 0.5:
        x, y = rect[0] + rng.uniform(0.2, 0.4) * wide, rect[1] + rng.uniform(0.25, 0.5) * high
        niche = (x, y, x + 0.45 * wide, y + rng.uniform(0.15, 0.3) * high)
        dark = np.full(3, rng.uniform(0.02, 0.3), np.float32)
        canvas.fill(niche, dark, level - rng.uniform(0, 0.05), 0.4)
        strip = (niche[0], niche[1], niche[2], niche[1] + 0.25 * (niche[3] - niche[1]))
        canvas.fill(strip, dark * 1.8, level, 0.4)
    for _ in range(int(rng.integers(0, 4 if fridge else 2))):
        x, y = rect[0] + rng.uniform(0.1, 0.8) * wide, rect[1] + rng.uniform(0.1, 0.8) * high
        size = np.minimum(rng.uniform(0.02, 0.2, 2), (0.18 * wide, 0.18 * high))
        note = (x, y, x + size[0], y + size[1])
        canvas.fill(note, materials.random_color(rng), level + 0.001, rng.uniform(0, 0.5))


def backdrop(rng: np.random.Generator, canvas: Canvas, plan_rect: Rect, uniform: bool) -> None:
    """Paint the surroundings of a face: wall, floor, worktop, legs, a neighbor, or nothing."""
    left, top, right, bottom = plan_rect
    view = canvas.view
    far = -rng.uniform(0.1, 0.6)
    draw = rng.random()
    whole = (view[0], view[1], view[2], view[3])
    if uniform or draw < 0.35:
        tone = np.full(3, rng.choice([0.98, 0.9, 0.5, 0.1, 0.0]), np.float32)
        wall = materials.plain(tone, 0.0)
    elif draw < 0.7:
        wall = materials.paint(rng)
    else:
        wall = materials.tiles(rng) if rng.random() < 0.5 else materials.wood(rng)
    canvas.fill(whole, wall.texture, far, 0.0)
    if rng.random() < 0.6 and not uniform:
        floor = materials.wood(rng) if rng.random() < 0.6 else materials.paint(rng)
        canvas.fill(
            (view[0], bottom - rng.uniform(0, 0.05), view[2], view[3]), floor.texture, far / 3
        )
    if rng.random() < 0.35:
        for x, sign in ((left, -1), (right, 1)):
            if rng.random() < 0.7:
                side = (
                    (x - 2.0, top, x - 0.004, view[3])
                    if sign < 0
                    else (x + 0.004, top, x + 2, view[3])
                )
                near = materials.carcass(rng, rng.random() < 0.3, uniform)
                canvas.fill(side, near.texture, rng.uniform(-0.05, 0.01), near.gloss, 0.005)
    if rng.random() < 0.35:
        slab = materials.carcass(rng, False, uniform)
        thick = rng.uniform(0.02, 0.06)
        canvas.fill((left - 0.03, top - thick, right + 0.03, top), slab.texture, 0.02, slab.gloss)
        for _ in range(int(rng.integers(0, 4))):
            x, size = rng.uniform(left, right), rng.uniform(0.05, 0.25, 2)
            shape = (x, top - thick - size[1], x + size[0], top - thick)
            canvas.capsule(shape, 0.03, materials.random_color(rng), -0.05, 0.03)


def lumps(rng: np.random.Generator, canvas: Canvas) -> None:
    """Paint an object in front of the face: the back of a chair, a plant, a box."""
    view = canvas.view
    wide, high = view[2] - view[0], view[3] - view[1]
    x = view[0] + rng.uniform(-0.1, 0.95) * wide
    size = rng.uniform(0.06, 0.28, 2) * (wide, high)
    y = view[3] - size[1] * rng.uniform(0.5, 1.2)
    tone = materials.random_color(rng)
    corner = rng.uniform(0, 0.2)
    canvas.capsule((x, y, x + size[0], y + size[1]), corner, tone, 0.15, 0.05, flat=0.5, gloss=0.2)
    window = canvas.window((x, y, x + size[0], y + size[1]))
    shape = canvas.height[window].shape
    if min(shape) > 2:
        canvas.albedo[window] *= 1 + 0.15 * smooth_noise(rng, shape, (4, 4))[..., None]
