"""Render a canvas like a camera: light, shadow, parallax, noise, holes in depth."""

from __future__ import annotations

import io
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32
from numba import njit
from PIL import Image
from scipy.ndimage import gaussian_filter, uniform_filter

from .canvas import Canvas, smooth_noise


@dataclass(frozen=True)
class Pose:
    """Errors of a rectified face: an inexact box and a view that is not quite frontal."""

    homography: Float[np.ndarray, "3 3"]
    """Maps pixels of the image to pixels of the canvas."""
    shift: Float[np.ndarray, "2"]
    """Shift of a surface per meter of its height [px/m]."""
    level: float
    """Height of the rectified plane [m]."""


def random_pose(rng: np.random.Generator, canvas: Canvas, level: float) -> Pose:
    """Draw a pose with the errors of a scan."""
    side = canvas.side
    spread = rng.choice([0.0, 0.006, 0.02]) * side
    corners = np.array([[0, 0], [side, 0], [side, side], [0, side]], dtype=float)
    moved = corners + rng.uniform(-1, 1, (4, 2)) * spread
    if rng.random() < 0.15:
        moved[:, 1] += (moved[:, 0] / side - 0.5) * rng.normal(0, 0.02) * side
    angles = np.radians(rng.normal(0, (11, 9)).clip(-27, 27))
    shift = np.tan(angles) / (canvas.dx, canvas.dy)
    return Pose(_four_points(corners, moved), shift, level)


def _four_points(
    source: Float[np.ndarray, "4 2"], target: Float[np.ndarray, "4 2"]
) -> Float[np.ndarray, "3 3"]:
    """Return the homography that maps four points to four others."""
    rows = []
    for (x, y), (u, v) in zip(source, target, strict=True):
        rows.append([x, y, 1, 0, 0, 0, -u * x, -u * y])
        rows.append([0, 0, 0, x, y, 1, -v * x, -v * y])
    solution = np.linalg.solve(np.array(rows), target.ravel())
    return np.append(solution, 1.0).reshape(3, 3)


def seen(pose: Pose, points: Float[np.ndarray, "n 2"], height: float) -> Float[np.ndarray, "n 2"]:
    """Return the image positions of canvas points [px] at a height [m]."""
    raised = points + (height - pose.level) * pose.shift
    flat = np.column_stack((raised, np.ones(len(raised)))) @ np.linalg.inv(pose.homography).T
    return flat[:, :2] / flat[:, 2:]


@njit(cache=True, fastmath=True)
def _warp(
    stack: np.ndarray, height: np.ndarray, m: np.ndarray, sx: float, sy: float, level: float
) -> np.ndarray:  # pragma: no cover
    """Sample every pixel bilinearly where its ray meets the height field."""
    rows, columns, planes = stack.shape
    out = np.empty_like(stack)
    for i in range(rows):
        for j in range(columns):
            x, y = j + 0.5, i + 0.5
            w = m[2, 0] * x + m[2, 1] * y + m[2, 2]
            u0 = (m[0, 0] * x + m[0, 1] * y + m[0, 2]) / w
            v0 = (m[1, 0] * x + m[1, 1] * y + m[1, 2]) / w
            u, v = u0, v0
            # Down the ray from above: the first surface that it meets hides those behind.
            for k in range(7):
                probe = level + 0.06 - 0.02 * k
                a = u0 - (probe - level) * sx
                b = v0 - (probe - level) * sy
                ii = min(max(int(b), 0), rows - 1)
                jj = min(max(int(a), 0), columns - 1)
                if height[ii, jj] >= probe or k == 6:
                    z = max(height[ii, jj], level - 0.3)
                    u = u0 - (z - level) * sx
                    v = v0 - (z - level) * sy
                    break
            u = min(max(u - 0.5, 0.0), columns - 1.001)
            v = min(max(v - 0.5, 0.0), rows - 1.001)
            jj, ii = int(u), int(v)
            p, q = u - jj, v - ii
            for c in range(planes):
                out[i, j, c] = (1 - q) * (
                    (1 - p) * stack[ii, jj, c] + p * stack[ii, jj + 1, c]
                ) + q * ((1 - p) * stack[ii + 1, jj, c] + p * stack[ii + 1, jj + 1, c])
    return out


def warp(
    stack: Float32[np.ndarray, "h w c"], height: Float32[np.ndarray, "h w"], pose: Pose
) -> Float32[np.ndarray, "h w c"]:
    """Render a height field and its colors from a pose."""
    sx, sy = float(pose.shift[0]), float(pose.shift[1])
    return _warp(stack, height, pose.homography, sx, sy, pose.level)


@njit(cache=True)
def _shadow(
    height: np.ndarray, dx: float, dy: float, drop: float, steps: int
) -> np.ndarray:  # pragma: no cover
    """Return each pixel's depth below the shadow's edge, by marching toward the light [m]."""
    rows, columns = height.shape
    out = np.zeros_like(height)
    for i in range(rows):
        for j in range(columns):
            deepest = 0.0
            for k in range(1, steps + 1):
                ii, jj = int(i + dy * k + 0.5), int(j + dx * k + 0.5)
                if ii < 0 or jj < 0 or ii >= rows or jj >= columns:
                    break
                deepest = max(deepest, height[ii, jj] - drop * k - height[i, j])
            out[i, j] = deepest
    return out


@njit(cache=True, fastmath=True)
def _light(
    height: np.ndarray, dx: float, dy: float, lamp: np.ndarray, half: np.ndarray, power: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # pragma: no cover
    """Return how much each pixel faces the lamp and the viewer, and its highlight."""
    rows, columns = height.shape
    facing, upright = np.empty_like(height), np.empty_like(height)
    glint = np.zeros_like(height)
    for i in range(rows):
        above, below = max(i - 1, 0), min(i + 1, rows - 1)
        for j in range(columns):
            left, right = max(j - 1, 0), min(j + 1, columns - 1)
            x = (height[i, left] - height[i, right]) * dx
            y = (height[above, j] - height[below, j]) * dy
            norm = 1.0 / np.sqrt(x * x + y * y + 1.0)
            upright[i, j] = norm
            facing[i, j] = max((x * lamp[0] + y * lamp[1] + lamp[2]) * norm, 0.0)
            toward = (x * half[0] + y * half[1] + half[2]) * norm
            if toward > 0.5:
                glint[i, j] = np.exp(power * np.log(toward))
    return facing, upright, glint


def shade(
    rng: np.random.Generator, canvas: Canvas, *, uniform: bool
) -> Float32[np.ndarray, "h w 3"]:
    """Shade a canvas: one lamp with a shadow, ambient light, reflections."""
    height = canvas.height
    soft = rng.uniform(0.25, 0.5)
    if uniform and rng.random() < 0.5:
        lamp = np.array([*rng.normal(0, 0.2, 2), 1.0])
    else:
        lamp = np.array([rng.normal(0, 0.7), -abs(rng.normal(0.5, 0.5)), rng.uniform(0.6, 1.4)])
    lamp /= np.linalg.norm(lamp)
    half = lamp + np.array([0, 0, 1])
    half /= np.linalg.norm(half)
    power = rng.uniform(8, 60)
    facing, upright, glint = _light(
        height,
        soft / canvas.dx,
        soft / canvas.dy,
        lamp.astype(np.float32),
        half.astype(np.float32),
        power,
    )
    if rng.random() < 0.8:
        facing *= 1 - rng.uniform(0.3, 1.0) * _shadow_of(canvas, lamp)
    near = np.clip((uniform_filter(height, 9) - height) / rng.uniform(0.01, 0.05), 0, 1)
    far = np.clip((uniform_filter(height, 31) - height) / rng.uniform(0.05, 0.2), 0, 1)
    around = 1 - rng.uniform(0.1, 0.6) * near - rng.uniform(0, 0.4) * far
    key = rng.uniform(0.3, 0.9)
    light = key / max(float(lamp[2]), 0.3) * facing + (1 - key) * around * (0.6 + 0.4 * upright)
    if not uniform:
        light *= 1 + rng.uniform(0, 0.3) * smooth_noise(rng, height.shape, (2, 2))
    shine = (0.7 * (float(half[2]) < 0.97)) * glint
    if not uniform:
        shine += 0.25 * rng.uniform(0, 1) * _surroundings(rng, height.shape)
    shine *= canvas.gloss * rng.uniform(0.1, 0.8)
    return canvas.albedo * light[..., None] + shine[..., None]


def _shadow_of(canvas: Canvas, lamp: np.ndarray) -> np.ndarray:
    """Return the hidden share of the lamp, by pixel."""
    along = np.array([lamp[0] / canvas.dx, lamp[1] / canvas.dy]) / lamp[2]
    fastest = max(float(np.abs(along).max()), 1e-6)
    drop = 1 / fastest
    steps = int(np.clip(0.12 / drop, 1, 14))
    step = along / fastest
    below = _shadow(canvas.height, float(step[0]), float(step[1]), float(drop), steps)
    return np.clip(below / max(float(drop), 0.004), 0, 1)


def _surroundings(rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    """Draw the environment that glossy surfaces reflect: soft lights and bright windows."""
    env = np.clip(smooth_noise(rng, shape, (rng.uniform(1, 4), rng.uniform(1, 6))) + 0.5, 0, 2)
    for _ in range(int(rng.integers(0, 3))):
        i, j = (rng.uniform(0, 0.8, 2) * shape).astype(int)
        h, w = (rng.uniform(0.05, 0.4, 2) * shape).astype(int)
        env[i : i + h, j : j + w] += rng.uniform(0.5, 2)
    return env


def photograph(
    rng: np.random.Generator, light: Float32[np.ndarray, "h w 3"], *, uniform: bool
) -> Float32[np.ndarray, "h w 3"]:
    """Expose, tint, blur, add noise, compress; values in [0, 255]."""
    side = light.shape[0]
    if rng.random() < 0.8:
        light = (
            light * rng.uniform(0.7, 1.25) / max(float(np.percentile(light[::5, ::5], 97)), 0.15)
        )
    light = light * rng.normal(1, 0.02 if uniform else 0.07, 3).astype(np.float32)
    curve = (np.linspace(0, 1, 1025) ** rng.uniform(0.45, 1.0)).astype(np.float32)
    image = curve[(np.clip(light, 0, 1) * 1024).astype(np.int32)]
    if not uniform and rng.random() < 0.5:
        center = float(image.mean())
        image = center + (image - center) * rng.uniform(0.6, 1.2)
        image += rng.uniform(-0.08, 0.08)
    blur = rng.choice([0.0, 0.0, 0.5, 1.0, 1.6])
    if blur:
        image = gaussian_filter(image, (blur, blur, 0))
    if rng.random() < (0.3 if uniform else 0.7):
        noise = rng.standard_normal((side, side, 1), dtype=np.float32)
        image = image + rng.uniform(0.003, 0.035) * noise
    image = (np.clip(image, 0, 1) * 255).astype(np.uint8)
    if rng.random() < 0.35:
        less = int(side * rng.uniform(0.3, 0.9)), int(side * rng.uniform(0.3, 0.9))
        small = Image.fromarray(image).resize(less, Image.Resampling.BOX)
        image = np.asarray(small.resize((side, side), Image.Resampling.BILINEAR))
    if rng.random() < 0.35:
        buffer = io.BytesIO()
        Image.fromarray(image).save(buffer, "JPEG", quality=int(rng.integers(25, 92)))
        image = np.asarray(Image.open(buffer))
    return image


def measured(
    rng: np.random.Generator, height: Float32[np.ndarray, "h w"], plane: float
) -> Float32[np.ndarray, "h w"]:
    """Return the relief as measured by a depth camera or a fused cloud; NaN where unknown."""
    shape = height.shape
    relief = height - np.float32(plane)
    if rng.random() < 0.15:
        return relief
    smear = rng.uniform(0.5, 4.0)
    relief = gaussian_filter(relief, smear)
    coarse = rng.uniform(15, 90)
    sigma = rng.uniform(0.001, 0.011)
    relief = relief + sigma * 2 * smooth_noise(rng, shape, (coarse, coarse))
    relief += sigma * rng.uniform(0, 0.7) * rng.standard_normal(shape, dtype=np.float32)
    tilt = rng.normal(0, 0.006, 2)
    ramp = np.linspace(-0.5, 0.5, shape[0], dtype=np.float32)
    relief += (tilt[0] * ramp[:, None] + tilt[1] * ramp).astype(np.float32)
    if rng.random() < 0.5:
        holes = smooth_noise(rng, shape, (coarse / 2, coarse / 2)) > rng.uniform(0.8, 1.6)
        relief[holes] = np.nan
    if rng.random() < 0.3:
        jumps = np.abs(height - uniform_filter(height, 5)) > 0.015
        relief[jumps] = np.nan
    return relief
