"""Draw random faces of furniture and appliances, with labels of their parts.

The same seed gives the same image. A face is a height field that is painted, lit and seen slightly
from the side; there is no ray tracing.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from momapos.model.records.scans import FaceImage, Part, PartKind

from . import blanks, camera, fittings, handles, layouts, materials, plans
from .canvas import Canvas, Rect, inset

SIDE = 320
"""Side of a drawn face [px]."""
FREE_SIDE = {
    "door_left": "right",
    "door_right": "left",
    "door_down": "top",
    "door_up": "bottom",
    "drawer": "middle",
}
"""Side of the handle, unless the plan sets another."""


@dataclass(frozen=True)
class Mix:
    """Frequencies of the drawn families and styles."""

    families: dict[layouts.Maker, float] = field(default_factory=lambda: layouts.FAMILIES)
    uniform: float = 0.38
    """Share that is drawn plainly, like CAD models [-]."""
    bare: float = 0.07
    """Share without handles [-]."""


ORDINARY = Mix()
HARD = Mix(layouts.HARD_FAMILIES, uniform=0.5, bare=0.25)
"""Plain fronts without handles, and many fields that only look like parts."""
LAST = Mix(layouts.LAST_FAMILIES, bare=0.12)
"""Wall cabinets, many with lifted doors, and faces without parts, among all other families."""
MIN_BARE_SEAM = 0.25
"""Least darkness of the seams of fronts without handles: with neither, nothing tells a front from
a panel [-]."""


@dataclass(frozen=True)
class Drawn:
    """A face and its labels."""

    face: FaceImage
    parts: tuple[Part, ...]
    false_parts: tuple[tuple[float, float, float, float], ...]
    """Fields that look like parts but do not move."""
    family: str

    @property
    def front(self) -> bool:
        """Return whether any part of it moves."""
        return len(self.parts) > 0


@dataclass(frozen=True)
class _Fitted:
    """A painted field of the plan."""

    cell: plans.Cell
    handle: Rect | None
    level: float
    handle_level: float


def draw(rng: np.random.Generator, mix: Mix = ORDINARY) -> Drawn:
    """Draw one face."""
    plan = layouts.random_plan(rng, mix.families)
    uniform = rng.random() < mix.uniform
    whole: Rect = (0.0, 0.0, plan.width, plan.height)
    canvas = Canvas(_view(rng, plan), SIDE)
    body = materials.carcass(rng, plan.appliance, uniform)
    fittings.backdrop(rng, canvas, whole, uniform)
    if plan.family == "nothing":
        blanks.blank(rng, canvas, whole, plan.cells[0].fill, body)
        fitted: list[_Fitted] = []
        level = 0.0
    else:
        fitted, level = _furnish(rng, canvas, plan, body, uniform, mix.bare)
    if rng.random() < 0.1:
        fittings.lumps(rng, canvas)
    pose = camera.random_pose(rng, canvas, level)
    stack = np.concatenate(
        (camera.shade(rng, canvas, uniform=uniform), canvas.height[..., None]), axis=-1
    )
    stack = camera.warp(stack.astype(np.float32), canvas.height, pose)
    color = camera.photograph(rng, stack[..., :3], uniform=uniform)
    relief = camera.measured(rng, stack[..., 3], level + _plane(rng))
    face = FaceImage(
        color, relief, canvas.view[2] - canvas.view[0], canvas.view[3] - canvas.view[1]
    )
    parts, false_parts = _truth(canvas, pose, fitted)
    return Drawn(face, parts, false_parts, plan.family)


def _view(rng: np.random.Generator, plan: plans.Plan) -> Rect:
    """Draw the view of the rectified image: the face with the errors of a detected box."""
    scale = rng.choice([0.01, 0.04, 0.1], p=[0.45, 0.3, 0.25])
    grow = np.clip(np.abs(rng.normal(0, scale, 4)), 0, 0.22)
    cut = rng.random(4) < 0.3
    grow = np.where(cut, -np.minimum(grow, 0.03), grow)
    if plan.stretch is not None:
        grow[[0, 2]] = 0.0
    begin, end = plan.stretch or (0.0, plan.width)
    left, top, right, bottom = grow * np.tile((end - begin, plan.height), 2)
    return (begin - left, -top, end + right, plan.height + bottom)


def _plane(rng: np.random.Generator) -> float:
    """Draw the distance of the box's face from the fronts; it may be at the tips of the handles."""
    return float(rng.normal(0, 0.012) + (rng.uniform(0.01, 0.06) if rng.random() < 0.3 else 0.0))


def _furnish(
    rng: np.random.Generator,
    canvas: Canvas,
    plan: plans.Plan,
    body: materials.Material,
    uniform: bool,
    bare: float,
) -> tuple[list[_Fitted], float]:
    """Paint a piece of furniture; return its fields and the height of its fronts."""
    whole: Rect = (0.0, 0.0, plan.width, plan.height)
    style = fittings.random_door_style(rng, body, plan.appliance, uniform)
    canvas.fill(whole, body.texture, 0.0, body.gloss, 0.004)
    if rng.random() < 0.08 and not plan.appliance:
        other = replace(style, skin=materials.carcass(rng, plan.appliance, uniform))
    else:
        other = style
    seam = _Seam.draw(rng, uniform)
    grip = _handle_style(rng, plan, style, bare)
    if grip is None:
        seam = replace(seam, dark=max(seam.dark, MIN_BARE_SEAM))
    second = _handle_style(rng, plan, style, bare) if rng.random() < 0.12 else grip
    fixed = rng.random() < 0.12 and not plan.appliance
    same_free = rng.choice(["", "top", "middle", "bottom"], p=[0.7, 0.14, 0.12, 0.04])
    fitted = []
    for cell in plan.cells:
        seam.paint(canvas, cell, style.out)
        skin = style if rng.random() < 0.6 else other
        if cell.kind is None:
            _fixed_cell(rng, canvas, cell, skin, body)
            fitted.append(_Fitted(cell, None, style.out, 0.0))
            continue
        fittings.door(rng, canvas, cell.rect, skin, cell.fill)
        if fixed and cell.kind in ("door_left", "door_right"):
            fittings.hardware(rng, canvas, cell.rect, cell.kind == "door_left")
        if rng.random() < 0.15:
            fittings.distractors(rng, canvas, cell.rect, plan.family == "fridge")
        if cell.kind == "drawer" and same_free and not plan.appliance:
            cell = replace(cell, free=str(same_free))
        style_here = second if cell.kind == "drawer" else grip
        rect = _handle(rng, canvas, cell, style_here, style.out)
        fitted.append(_Fitted(cell, rect, style.out, style_here.out if style_here else 0.0))
    return fitted, style.out


@dataclass(frozen=True)
class _Seam:
    """Appearance of the gap around a field."""

    width: float
    dark: float
    deep: float

    @staticmethod
    def draw(rng: np.random.Generator, uniform: bool) -> _Seam:
        dark = rng.uniform(0.2, 0.95) if rng.random() < 0.8 else rng.uniform(0.0, 0.2)
        if uniform and rng.random() < 0.3:
            dark = 0.0
        return _Seam(rng.uniform(0.001, 0.006), dark, rng.uniform(0.0, 0.03))

    def paint(self, canvas: Canvas, cell: plans.Cell, out: float) -> None:
        if cell.fill in ("open", "knees"):
            return
        ring = inset(cell.rect, -self.width)
        canvas.rim(cell.rect, self.width, self.dark)
        canvas.fill(ring, None, min(out, 0.0) - self.deep)


def _handle_style(
    rng: np.random.Generator, plan: plans.Plan, style: fittings.DoorStyle, bare: float
) -> handles.HandleStyle | None:
    """Draw the handle style of a piece of furniture; None without handles."""
    if rng.random() < bare:
        return None
    weights = (0.3, 0.03, 0.3, 0.06, 0.1, 0.1, 0.06, 0.03, 0.04, 0.04)
    if plan.family == "fridge":  # many have flush grips: recesses and profiles along the edge
        weights = (0.36, 0.18, 0.01, 0.0, 0.0, 0.05, 0.26, 0.0, 0.08, 0.06)
    elif plan.appliance:
        weights = (0.45, 0.22, 0.01, 0.0, 0.0, 0.06, 0.12, 0.0, 0.04, 0.14)
    return handles.random_style(rng, style.skin, weights, style.mono)


def _fixed_cell(
    rng: np.random.Generator,
    canvas: Canvas,
    cell: plans.Cell,
    style: fittings.DoorStyle,
    body: materials.Material,
) -> None:
    """Paint a field that does not move."""
    if cell.fill == "open":
        fittings.opening(rng, canvas, cell.rect, body)
    elif cell.fill == "knees":
        canvas.fill(cell.rect, materials.random_color(rng), -rng.uniform(0.2, 0.6))
    elif cell.fill in ("controls", "knobs"):
        knobs = cell.fill == "knobs"
        fittings.controls(rng, canvas, cell.rect, style.skin, max(style.out, 0.0), knobs)
    elif cell.fill == "vent":
        fittings.vent(rng, canvas, cell.rect)
    elif cell.fill == "basin":
        white = np.full(3, rng.uniform(0.7, 0.95), np.float32)
        canvas.fill(cell.rect, white, 0.03, 0.5, 0.01)
    else:
        canvas.fill(cell.rect, style.skin.texture, style.out, style.skin.gloss, 0.003)


def _handle(
    rng: np.random.Generator,
    canvas: Canvas,
    cell: plans.Cell,
    style: handles.HandleStyle | None,
    level: float,
) -> Rect | None:
    """Paint a handle on a part and return its rectangle."""
    if style is None or not cell.handle or cell.kind is None:
        return None
    free = cell.free or FREE_SIDE[cell.kind]
    upright = free in ("left", "right")
    along = cell.along
    if not upright and cell.kind in ("door_down", "door_up") and rng.random() < 0.05:
        along = rng.uniform(0.2, 0.8)
    rect = handles.place(rng, style, cell.rect, free, along)
    if style.shape in ("knob", "cup", "bow") and cell.kind == "drawer":
        wide = cell.rect[2] - cell.rect[0]
        if wide > 0.55 and rng.random() < 0.6:
            return _two_handles(rng, canvas, cell, style, level)
    handles.draw(rng, canvas, style, rect, level)
    return rect


def _two_handles(
    rng: np.random.Generator,
    canvas: Canvas,
    cell: plans.Cell,
    style: handles.HandleStyle,
    level: float,
) -> Rect:
    """Paint two handles on a wide drawer; the left one is the label, since it is grasped."""
    free = cell.free or "middle"
    places = [handles.place(rng, style, cell.rect, free, along) for along in (0.22, 0.78)]
    for rect in places:
        handles.draw(rng, canvas, style, rect, level)
    return places[0]


def _truth(
    canvas: Canvas, pose: camera.Pose, fitted: list[_Fitted]
) -> tuple[tuple[Part, ...], tuple[tuple[float, float, float, float], ...]]:
    """Return true and false parts, as fractions of the image."""
    parts, false_parts = [], []
    for item in fitted:
        full = _seen_box(canvas, pose, item.cell.rect, item.level)
        box = np.clip(full, 0.0, 1.0)
        shown = np.prod(box[2:] - box[:2]) / max(np.prod(full[2:] - full[:2]), 1e-9)
        if shown < 0.5:
            continue
        rect = _four(box)
        if item.cell.kind is None:
            if item.cell.fill in ("blank", "open", "knees", "controls", "knobs", "basin"):
                false_parts.append(rect)
            continue
        handle = None
        if item.handle is not None:
            grip = _seen_box(canvas, pose, item.handle, item.level + 0.7 * item.handle_level)
            grip = np.clip(grip, np.tile(box[:2], 2), np.tile(box[2:], 2))
            if (grip[2:] > grip[:2]).all():
                handle = _four(grip)
        parts.append(Part(item.cell.kind, rect, 1.0, handle))
    return tuple(parts), tuple(false_parts)


def _seen_box(
    canvas: Canvas, pose: camera.Pose, rect: Rect, height: float
) -> Float[np.ndarray, "4"]:
    """Return a rectangle in the image, with its sides at the mean of the projected edges."""
    left, top, right, bottom = rect
    corners = np.array([[left, top], [right, top], [right, bottom], [left, bottom]])
    pixels = (corners - canvas.view[:2]) / (canvas.dx, canvas.dy)
    x, y = camera.seen(pose, pixels, height).T / canvas.side
    return np.array([(x[0] + x[3]) / 2, (y[0] + y[1]) / 2, (x[1] + x[2]) / 2, (y[2] + y[3]) / 2])


def _four(box: np.ndarray) -> tuple[float, float, float, float]:
    return (float(box[0]), float(box[1]), float(box[2]), float(box[3]))


def mirrored_kind(kind: PartKind) -> PartKind:
    """Return the kind of a mirrored part."""
    swap: dict[PartKind, PartKind] = {"door_left": "door_right", "door_right": "door_left"}
    return swap.get(kind, kind)
