"""Rasterize and shade triangles.

A triangle is drawn row by row with the edge functions of Olano and Greer (Triangle Scan Conversion
using 2D Homogeneous Coordinates, 1997). They need no clipping, and give the same distances as ray
casting.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numba import njit

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Float32, Int32, UInt8

    Triple = tuple[float, float, float]

NEAREST = 0.02
"""Minimum depth of drawn surfaces [m]."""
AMBIENT = 0.36
HEADLIGHT = 0.16
"""Light from all directions, and from next to the camera [-]."""
CREVICE = 0.008
"""Radius around a point in which raised surfaces darken it [m]."""
CREVICE_RAYS = 8
"""Largest such radius [rays]."""
RAISED = 0.003
"""Minimum height of a raised surface [m]."""
DEEP = 0.035
"""Maximum depth of a crevice [m]; deeper points belong to another object."""
_RING = ((0, 0), (0, 1), (0, 2), (1, 2), (2, 2), (2, 1), (2, 0), (1, 0))
SHADE = 0.75
"""Share of light that a completely enclosed crevice loses [-]."""


class Buffers(NamedTuple):
    """The nearest triangle along each ray."""

    inverse: Float32[np.ndarray, "h w"]
    """1 / depth [1/m]; 0 for none."""
    nearest: Int32[np.ndarray, "h w"]
    """Index of the triangle; -1 for none."""


class View(NamedTuple):
    """A rasterized image without colors."""

    xs: Float[np.ndarray, " w"]
    ys: Float[np.ndarray, " h"]
    """The rays (x, y, 1)."""
    buffers: Buffers
    rotation: Float[np.ndarray, "3 3"]
    """Rotation of the camera in the world."""
    eye: Float[np.ndarray, "3"]
    """Position of the camera in the world [m]."""


class Surfaces(NamedTuple):
    """Normals and colors of triangles."""

    normals: Float[np.ndarray, "n 3"]
    """Unit normals of the triangles."""
    number: Int32[np.ndarray, " n"]
    """Index of the surface of each triangle."""
    color: Float[np.ndarray, "s 3"]
    """Linear color of each surface."""
    grain: Float[np.ndarray, "s 4"]
    """Strength [-] and frequency along x, y and z [1/m] of each surface's grain."""


class Lamps(NamedTuple):
    """Lamps with their shadow maps."""

    Ts_lamp_world: Float[np.ndarray, "k 4 4"]
    strength: Float[np.ndarray, " k"]
    scale: Float[np.ndarray, " k"]
    """Texels of the shadow map per tangent [-]."""
    maps: Float32[np.ndarray, "k m m"]
    """1 / depth from each lamp [1/m]."""


class Appearance(NamedTuple):
    """Everything that determines the colors."""

    surfaces: Surfaces
    lamps: Lamps
    background: Float[np.ndarray, "3"]
    """Linear color of the background."""


@njit(cache=True, nogil=True, error_model="numpy")
def rasterize(
    corners: Float[np.ndarray, "n 3 3"],
    one_sided: Bool[np.ndarray, " n"],
    xs: Float[np.ndarray, " w"],
    ys: Float[np.ndarray, " h"],
    buffers: Buffers,
) -> None:
    """Find the nearest triangle along each ray (x, y, 1).

    Args:
        corners: Triangles in the camera's frame [m].
        one_sided: Triangles that are visible only from their counterclockwise side.
        xs, ys: The rays; both are evenly spaced and increasing.
        buffers: Output.
    """
    inverse, nearest = buffers.inverse, buffers.nearest
    inverse[:] = 0.0
    nearest[:] = -1
    height, width = inverse.shape
    x0, dx, y0, dy = xs[0], xs[1] - xs[0], ys[0], ys[1] - ys[0]
    edges = np.empty((3, 3))
    for t in range(len(corners)):
        c = corners[t]
        depths = (c[0, 2], c[1, 2], c[2, 2])
        if max(depths) < NEAREST:
            continue
        for k in range(3):
            a, b = c[k], c[(k + 1) % 3]
            edges[k, 0] = a[1] * b[2] - a[2] * b[1]
            edges[k, 1] = a[2] * b[0] - a[0] * b[2]
            edges[k, 2] = a[0] * b[1] - a[1] * b[0]
        volume = edges[0, 0] * c[2, 0] + edges[0, 1] * c[2, 1] + edges[0, 2] * c[2, 2]
        if abs(volume) < 1e-14 or (one_sided[t] and volume > 0):
            continue
        edges /= volume
        first, last = 0, height
        if min(depths) > NEAREST:
            low = min(c[0, 1] / depths[0], c[1, 1] / depths[1], c[2, 1] / depths[2])
            high = max(c[0, 1] / depths[0], c[1, 1] / depths[1], c[2, 1] / depths[2])
            first = int(min(max(np.ceil((low - y0) / dy - 1e-9), 0.0), height))
            last = int(min(max(np.floor((high - y0) / dy + 1e-9) + 1, 0.0), height))
        slope = edges[0, 0] + edges[1, 0] + edges[2, 0]
        for i in range(first, last):
            y = y0 + i * dy
            left, right = 0.0, width - 1.0
            value = 0.0
            for k in range(3):
                at, step = edges[k, 1] * y + edges[k, 2], edges[k, 0]
                value += at
                if step > 1e-300:
                    left = max(left, (-at / step - x0) / dx)
                elif step < -1e-300:
                    right = min(right, (-at / step - x0) / dx)
                elif at < 0:
                    right = -1.0
            if left > right + 2e-9 or right < 0 or left > width:
                continue
            for j in range(int(np.ceil(left - 1e-9)), int(np.floor(right + 1e-9)) + 1):
                inv = value + slope * (x0 + j * dx)
                if inv > inverse[i, j] and inv < 1 / NEAREST:
                    inverse[i, j] = inv
                    nearest[i, j] = t


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def _hash(cell: int) -> float:
    """Return a number in [0, 1) for a cell of a lattice."""
    h = (cell ^ (cell >> 15)) * 0x2C1B3C6D
    h = (h ^ (h >> 12)) * 0x297A2D39
    return ((h ^ (h >> 15)) & 0xFFFF) / 65536.0


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def _grain(x: float, y: float, z: float) -> float:
    """Return smooth noise in [-1, 1] that varies over about one unit."""
    fx, fy, fz = np.floor(x), np.floor(y), np.floor(z)
    u, v, w = x - fx, y - fy, z - fz
    u, v, w = u * u * (3 - 2 * u), v * v * (3 - 2 * v), w * w * (3 - 2 * w)
    cell = int(fx) * 73856093 + int(fy) * 19349669 + int(fz) * 83492791
    total = 0.0
    for b in range(2):
        for c in range(2):
            at = cell + b * 19349669 + c * 83492791
            along = _hash(at) * (1 - u) + _hash(at + 73856093) * u
            total += along * (v if b else 1 - v) * (w if c else 1 - w)
    return 2 * total - 1


@njit(inline="always")
def _crevice(i: int, j: int, normal: Triple, view: View) -> float:
    """Return the share of the directions around a point with a raised surface."""
    xs, ys, inverse = view.xs, view.ys, view.buffers.inverse
    height, width = inverse.shape
    inv = inverse[i, j]
    step = int(min(max(CREVICE * inv / (xs[1] - xs[0]), 2.0), float(CREVICE_RAYS)))
    here = (normal[0] * xs[j] + normal[1] * ys[i] + normal[2]) / inv
    hidden = 0
    for k in range(8):
        a = i + step * ((k > 4) - (0 < k < 4))
        b = j + step * ((k < 2 or k == 7) - (2 < k < 6))
        if 0 <= a < height and 0 <= b < width and inverse[a, b] > inv:
            other = inverse[a, b]
            there = normal[0] * xs[b] + normal[1] * ys[a] + normal[2]
            hidden += other - inv < DEEP * inv * other and there - here * other > RAISED * other
    return hidden / 8


@njit(inline="always")
def _lamp_light(p: Triple, n: Triple, lamps: Lamps) -> float:
    """Return the light of all lamps at a point with a normal."""
    strength, scale, maps = lamps.strength, lamps.scale, lamps.maps
    size = maps.shape[1]
    light = 0.0
    for k in range(len(strength)):
        T = lamps.Ts_lamp_world[k]
        steep = -(T[2, 0] * n[0] + T[2, 1] * n[1] + T[2, 2] * n[2])
        if steep <= 0:
            continue
        depth = T[2, 0] * p[0] + T[2, 1] * p[1] + T[2, 2] * p[2] + T[2, 3]
        factor = scale[k] / depth
        u = (T[0, 0] * p[0] + T[0, 1] * p[1] + T[0, 2] * p[2] + T[0, 3]) * factor
        v = (T[1, 0] * p[0] + T[1, 1] * p[1] + T[1, 2] * p[2] + T[1, 3]) * factor
        a, b = int(v + size / 2), int(u + size / 2)
        # Depth tolerance: a slanted surface varies by this much within a texel of the map.
        slack = 0.004 + 1.5 / (factor * max(steep, 0.15))
        inside = 0 <= a < size and 0 <= b < size
        if not inside or (depth - slack) * maps[k, a, b] < 1:
            light += strength[k] * steep
    return light


@njit(inline="always")
def _shade(
    i: int, j: int, tri: int, view: View, look: Appearance, out: Float[np.ndarray, "3"]
) -> None:
    xs, ys, inverse = view.xs, view.ys, view.buffers.inverse
    R, eye, normals = view.rotation, view.eye, look.surfaces.normals
    colors, grain = look.surfaces.color, look.surfaces.grain
    z = 1 / inverse[i, j]
    x, y = xs[j] * z, ys[i] * z
    dx = R[0, 0] * x + R[0, 1] * y + R[0, 2] * z
    dy = R[1, 0] * x + R[1, 1] * y + R[1, 2] * z
    dz = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z
    nx, ny, nz = normals[tri, 0], normals[tri, 1], normals[tri, 2]
    facing = -(dx * nx + dy * ny + dz * nz)
    if facing < 0:
        nx, ny, nz, facing = -nx, -ny, -nz, -facing
    n_camera = (
        R[0, 0] * nx + R[1, 0] * ny + R[2, 0] * nz,
        R[0, 1] * nx + R[1, 1] * ny + R[2, 1] * nz,
        R[0, 2] * nx + R[1, 2] * ny + R[2, 2] * nz,
    )
    p = (eye[0] + dx, eye[1] + dy, eye[2] + dz)
    light = AMBIENT * (0.85 + 0.15 * nz) + _lamp_light(p, (nx, ny, nz), look.lamps)
    light += HEADLIGHT * facing / np.sqrt(x * x + y * y + z * z)
    light *= 1 - SHADE * _crevice(i, j, n_camera, view)
    s = look.surfaces.number[tri]
    if grain[s, 0] > 0:
        gx, gy, gz = p[0] * grain[s, 1], p[1] * grain[s, 2], p[2] * grain[s, 3]
        noise = 0.65 * _grain(gx, gy, gz) + 0.35 * _grain(2.7 * gx, 2.7 * gy, 2.7 * gz)
        light *= 1 + grain[s, 0] * noise
    for k in range(3):
        out[k] = colors[s, k] * light


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def shade_image(
    view: View,
    look: Appearance,
    shown: UInt8[np.ndarray, " levels"],
    known: Bool[np.ndarray, "h w"],
    image: UInt8[np.ndarray, "h w 3"],
) -> None:
    """Color each pixel from the 3 x 3 rays around its center, with tent weights.

    Each triangle hit by these rays is shaded once, so most pixels need one evaluation.

    Args:
        view: The view, with rays twice as dense as the pixels; the center of pixel (i, j) is the
            ray (2i + 1, 2j + 1).
        look: Everything that determines the colors.
        shown: sRGB values of evenly spaced linear colors in [0, 1].
        known: Pixels that keep the color that they have.
        image: Output.
    """
    nearest = view.buffers.nearest
    height, width, _ = image.shape
    seen, weight = np.empty(9, np.int64), np.empty(9)
    where = np.empty((9, 2), np.int64)
    color, total = np.empty(3), np.empty(3)
    last = len(shown) - 1
    for i in range(height):
        for j in range(width):
            if known[i, j]:
                continue
            seen[0], weight[0] = nearest[2 * i + 1, 2 * j + 1], 0.25
            where[0, 0], where[0, 1] = 2 * i + 1, 2 * j + 1
            count = 1
            # The center comes first, so that its triangle is shaded there.
            for k in range(8):
                a, b = 2 * i + _RING[k][0], 2 * j + _RING[k][1]
                share = 0.125 if k % 2 else 0.0625
                found = 0
                while found < count and seen[found] != nearest[a, b]:
                    found += 1
                if found == count:
                    seen[count], weight[count] = nearest[a, b], 0.0
                    where[count, 0], where[count, 1] = a, b
                    count += 1
                weight[found] += share
            total[:] = 0.0
            for q in range(count):
                if seen[q] < 0:
                    color[:] = look.background
                else:
                    a, b = where[q]
                    _shade(a, b, seen[q], view, look, color)
                for k in range(3):
                    total[k] += weight[q] * color[k]
            for k in range(3):
                image[i, j, k] = shown[int(min(total[k], 1.0) * last + 0.5)]
