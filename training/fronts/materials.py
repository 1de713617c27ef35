"""Draw colors and textures: paint, wood, steel, glass, tiles, prints, carvings.

A texture maps metric coordinates (a row of x, a column of y) to colors.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .canvas import smooth_noise

Texture = Callable[[np.ndarray, np.ndarray], np.ndarray]

WOODS = (
    (0.72, 0.52, 0.32),
    (0.55, 0.36, 0.2),
    (0.8, 0.66, 0.46),
    (0.35, 0.2, 0.11),
    (0.86, 0.76, 0.6),
    (0.6, 0.42, 0.28),
    (0.22, 0.14, 0.09),
    (0.66, 0.6, 0.52),
    (0.75, 0.55, 0.25),
)
PAINTS = (
    (0.93, 0.93, 0.92),
    (0.88, 0.86, 0.8),
    (0.15, 0.2, 0.28),
    (0.1, 0.1, 0.11),
    (0.4, 0.48, 0.42),
    (0.5, 0.56, 0.6),
    (0.3, 0.35, 0.4),
    (0.75, 0.77, 0.78),
)
METALS = (
    (0.68, 0.69, 0.7),
    (0.5, 0.5, 0.5),
    (0.08, 0.08, 0.08),
    (0.7, 0.56, 0.26),
    (0.3, 0.22, 0.16),
    (0.85, 0.85, 0.86),
    (0.2, 0.2, 0.2),
)


@dataclass(frozen=True)
class Material:
    """Appearance of a surface."""

    texture: Texture
    gloss: float
    base: np.ndarray
    """Mean color."""


def _vary(rng: np.random.Generator, color: tuple[float, ...], by: float) -> np.ndarray:
    shade = rng.normal(1, by) + rng.normal(0, by / 3, 3)
    return np.clip(np.array(color) * shade, 0.02, 0.97).astype(np.float32)


def random_color(rng: np.random.Generator) -> np.ndarray:
    """Draw any color, mostly grays."""
    gray = rng.uniform(0.03, 0.97)
    tint = rng.normal(0, rng.choice([0.01, 0.03, 0.08, 0.25]), 3)
    return np.clip(gray + tint, 0.02, 0.97).astype(np.float32)


def plain(color: np.ndarray, gloss: float = 0.1) -> Material:
    """Return a uniform material."""
    return Material(lambda x, y: np.broadcast_to(color, (y.size, x.size, 3)), gloss, color)


def paint(rng: np.random.Generator) -> Material:
    """Draw paint, sometimes worn."""
    any_color = rng.random() < 0.3
    color = random_color(rng) if any_color else _vary(rng, PAINTS[rng.integers(len(PAINTS))], 0.06)
    worn = rng.choice([0.0, 0.0, 0.03, 0.15])
    if worn == 0:
        return plain(color, rng.uniform(0, 0.3))

    def texture(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        shape = (y.size, x.size)
        spots = smooth_noise(rng, shape, (np.ptp(y) * 15, np.ptp(x) * 60))
        return color * (1 + worn * np.clip(spots, -1, 0.6)[..., None])

    return Material(texture, rng.uniform(0, 0.15), color)


def wood(rng: np.random.Generator) -> Material:
    """Draw wood: streaks along the grain, with some rings."""
    base = _vary(rng, WOODS[rng.integers(len(WOODS))], 0.1)
    along_x = rng.random() < 0.4
    fine, strength = rng.uniform(40, 160), rng.uniform(0.05, 0.3)
    rings = rng.uniform(0, 0.15) * (rng.random() < 0.6)
    planks = rng.choice([0.0, 0.0, 0.0, 0.12]) * rng.uniform(0.7, 1.5)

    def texture(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        long, cross = (x, y) if along_x else (y, x)
        shape = (cross.size, long.size)
        spans = np.ptp(cross) + 1e-3, np.ptp(long) + 1e-3
        streaks = smooth_noise(rng, shape, (min(spans[0] * fine, cross.size), spans[1] * 3))
        broad = smooth_noise(rng, shape, (spans[0] * 12, spans[1] * 2))
        value = strength * (0.6 * streaks + 0.5 * broad)
        if rings:
            bent = cross.reshape(-1, 1) * 60 + 5 * smooth_noise(rng, shape, (3, 2 + spans[1] * 2))
            value = value + rings * np.sin(bent)
        if planks:
            value = value + 0.1 * np.sin(np.floor(cross.reshape(-1, 1) / planks) * 12.9)
        tone = 1 + (value if along_x else value.T)
        return base * tone[..., None]

    return Material(texture, rng.uniform(0, 0.25), base)


def steel(rng: np.random.Generator) -> Material:
    """Draw brushed metal."""
    gray = rng.uniform(0.35, 0.75)
    base = np.clip(gray + rng.normal(0, 0.015, 3), 0, 1).astype(np.float32)
    upright = rng.random() < 0.5
    strength = rng.uniform(0, 0.06)

    def texture(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        shape = (y.size, x.size)
        cells = (2, x.size / 1.5) if upright else (y.size / 1.5, 2)
        return base * (1 + strength * smooth_noise(rng, shape, cells))[..., None]

    return Material(texture, rng.uniform(0.35, 0.9), base)


def glass(rng: np.random.Generator) -> Material:
    """Draw dark, bright or transparent glass."""
    dark = rng.random() < 0.7
    color = np.full(3, rng.uniform(0.01, 0.12) if dark else rng.uniform(0.3, 0.8), np.float32)
    shelves = rng.uniform(0.15, 0.35) if rng.random() < 0.3 else 0.0
    depth = rng.uniform(0.02, 0.25)

    def texture(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        shape = (y.size, x.size)
        tone = 1 + depth * 3 * smooth_noise(rng, shape, (3, 3))
        if shelves:
            tone = tone + 0.8 * ((y % shelves) < 0.02)
        return np.clip(color * tone[..., None], 0, 1)

    return Material(texture, rng.uniform(0.3, 1.0), color)


def tiles(rng: np.random.Generator) -> Material:
    """Draw a repeated print or a tiled wall."""
    a, b = random_color(rng), random_color(rng)
    pitch = rng.uniform(0.04, 0.2)
    fold = int(rng.integers(1, 5))
    phase = rng.uniform(0, 6.3, 4)
    kind = rng.integers(4)

    def texture(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        u, v = (x / pitch) % 1 - 0.5, (y / pitch) % 1 - 0.5
        if kind == 0:
            mask = np.sin(6.3 * fold * np.hypot(u, v) + phase[0]) + np.cos(
                6.3 * (u * u - v * v) * 4
            )
        elif kind == 1:
            angle = np.arctan2(v, u)
            mask = np.cos(2 * (fold + 1) * angle) * np.cos(12 * np.hypot(u, v) + phase[1])
        elif kind == 2:
            mask = np.minimum(np.abs(u), np.abs(v)) * 20 - 0.6
        else:
            mask = 2 - 16 * np.minimum(0.5 - np.abs(u), 0.5 - np.abs(v) + 0 * u)
        share = np.clip(0.5 + 2 * mask, 0, 1)[..., None]
        return a * (1 - share) + b * share

    return Material(texture, rng.uniform(0, 0.4), (a + b) / 2)


def like(rng: np.random.Generator, material: Material, by: float = 0.06) -> Material:
    """Draw a slightly lighter or darker version of a material."""
    tone = np.clip(rng.normal(1, by, 3) * rng.normal(1, by), 0.6, 1.5).astype(np.float32)
    first = material.texture
    return Material(
        lambda x, y: np.clip(first(x, y) * tone, 0, 1), material.gloss, material.base * tone
    )


def metal(rng: np.random.Generator) -> Material:
    """Draw the material of handles."""
    return plain(_vary(rng, METALS[rng.integers(len(METALS))], 0.08), rng.uniform(0.2, 0.9))


def carcass(rng: np.random.Generator, appliance: bool, uniform: bool) -> Material:
    """Draw the material of a body.

    Args:
        rng: Source of randomness.
        appliance: Whether it is an appliance, not a cabinet.
        uniform: Whether it has one flat color, like CAD models.
    """
    if uniform:
        gray = np.full(3, rng.uniform(0.45, 1.0), np.float32)
        return plain(gray if rng.random() < 0.4 else random_color(rng), rng.uniform(0, 0.3))
    draw = rng.random()
    if appliance:
        if draw < 0.5:
            return steel(rng)
        if draw < 0.65:
            return plain(np.full(3, rng.uniform(0.02, 0.1), np.float32), rng.uniform(0.2, 0.8))
        return paint(rng)
    return wood(rng) if draw < 0.5 else paint(rng)
