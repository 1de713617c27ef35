"""Contact between the arm and the parts that do not turn with its first joint, for every azimuth.

The base (and a torso, which only rises) stays still while the arm turns about a vertical axis. So a
table over height and distance from that axis stores, as a word of bits, the azimuths at which a
sphere of a given radius touches. The word is rotated by the sphere's own azimuth. One lookup per
sphere replaces a collision check per azimuth.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from momapos.core.compiled import F1, F2, F3, I2, U3, U4, entry, kernel
from momapos.model.collision import Spheres

from .grid import turns_of

AZIMUTHS = 64
"""Number of azimuths, the bits of a word [-]."""
PHASES = 4
"""Words per cell, shifted by fractions of a bit: azimuths have a resolution of 1/256 turn."""
CELL = 0.02
"""Edge of a cell of the table [m]."""
RADIUS_STEP = 0.002
"""Radii are rounded to this, so that spheres share tables [m]."""
SPHERE_EXCESS = 0.02
"""Largest protrusion of an arm's spheres from its links [m]. It is subtracted from the gap of pairs
that are checked by hulls."""


class StandingTable(NamedTuple):
    """The contact table that `touched` reads, see `standing_table`."""

    words: U4
    low: float
    kind: I2


@entry
def fill_words(
    center: F2, rotation: F3, half: F2, radius: F1, reach: float, low: float, words: U3
) -> None:
    """Set the bits of the azimuths at which a sphere touches rounded boxes.

    Args:
        center, rotation, half, radius: Boxes (b, 3), (b, 3, 3), (b, 3) grown by (b,), relative to
            the first axis; a sphere is a box of size 0.
        reach: Radius of the moving sphere [m].
        low: Height of the first row [m].
        words: Output (heights, distances, PHASES).
    """
    for r in range(words.shape[1]):
        for a in range(AZIMUTHS * PHASES):
            angle = 2.0 * math.pi * a / (AZIMUTHS * PHASES)
            px, py = r * CELL * math.cos(angle), r * CELL * math.sin(angle)
            bit = np.uint64(1) << np.uint64(a // PHASES)
            for b in range(len(center)):
                x, y = px - center[b, 0], py - center[b, 1]
                far = reach + radius[b]
                extent = far + half[b, 0] + half[b, 1] + half[b, 2]
                if x * x + y * y > extent * extent:
                    continue
                first = math.floor((center[b, 2] - extent - low) / CELL)
                last = math.ceil((center[b, 2] + extent - low) / CELL)
                for z in range(max(0, first), min(words.shape[0], last + 1)):
                    dz = low + z * CELL - center[b, 2]
                    s = 0.0
                    for k in range(3):
                        local = (
                            x * rotation[b, 0, k] + y * rotation[b, 1, k] + dz * rotation[b, 2, k]
                        )
                        excess = abs(local) - half[b, k]
                        if excess > 0.0:
                            s += excess * excess
                    if s < far * far:
                        words[z, r, a % PHASES] |= bit


@kernel
def touched(wanted, R, p, spheres, first, axis, table):
    """Return the wanted azimuths at which the arm touches a part that does not turn.

    Args:
        wanted: Mask of azimuths.
        R, p: Segment poses at azimuth 0, base at the origin.
        spheres: `Spheres.arrays`.
        first: Index of the first turning joint.
        axis: Foot of its axis (3,) [m].
        table: (words (classes, heights, distances, PHASES), low [m], kind (bodies, spheres)).
    """
    center, start, segment = spheres.center, spheres.start, spheres.segment
    bound_center, bound_radius = spheres.bound_center, spheres.bound_radius
    words, low, kind = table
    heights, distances = words.shape[1], words.shape[2]
    hit = np.uint64(0)
    for g in range(len(segment)):
        m = segment[g]
        if m <= first:
            continue
        x, y, z = _point(R, p, m, bound_center[g], axis)
        far = distances * CELL + bound_radius[g]
        if x * x + y * y > far * far or z - bound_radius[g] > low + p[first, 2] + heights * CELL:
            continue
        for s in range(start[g], start[g + 1]):
            x, y, z = 0.0, 0.0, np.nan
            for body in range(first + 1):
                c = kind[body, s]
                if c < 0:
                    continue
                if np.isnan(z):
                    x, y, z = _point(R, p, m, center[s], axis)
                rise = p[body, 2] if body > 0 else 0.0
                iz = math.floor((z - rise - low) / CELL + 0.5)
                ir = int(math.sqrt(x * x + y * y) / CELL + 0.5)
                if iz < 0 or iz >= heights or ir >= distances:
                    continue
                a = int(turns_of(y, x) * (AZIMUTHS * PHASES) + 0.5) % (AZIMUTHS * PHASES)
                word = words[c, iz, ir, a % PHASES]
                shift = np.uint64(a // PHASES)
                if shift > np.uint64(0):
                    word = (word >> shift) | (word << (np.uint64(AZIMUTHS) - shift))
                hit |= word
                if wanted & ~hit == np.uint64(0):
                    return wanted
    return hit & wanted


@kernel
def _point(R, p, m, local, axis):
    """Return a point of segment m relative to the foot of the first axis."""
    return (
        p[m, 0] + R[m, 0, 0] * local[0] + R[m, 0, 1] * local[1] + R[m, 0, 2] * local[2] - axis[0],
        p[m, 1] + R[m, 1, 0] * local[0] + R[m, 1, 1] * local[1] + R[m, 1, 2] * local[2] - axis[1],
        p[m, 2] + R[m, 2, 0] * local[0] + R[m, 2, 1] * local[1] + R[m, 2, 2] * local[2] - axis[2],
    )


def standing_table(spheres: Spheres, d: np.ndarray, first: int) -> StandingTable:
    """Build the table that `touched` reads.

    Body 0 is the base. Body i moves with joint i, a lift below the first turning joint. A class is
    a body, the parts of it that count for a link, and a radius.

    Args:
        spheres: The robot's spheres.
        d: Offsets of the joints (n, 3), see `Chain`.
        first: Index of the first joint that turns.

    Returns:
        Words (classes, heights, distances, PHASES), height of the first row [m], and the class of
        each sphere against each body (bodies, spheres), -1 if no part counts.
    """
    group = np.repeat(np.arange(len(spheres.segment)), np.diff(spheres.start))
    radii = RADIUS_STEP * np.round(spheres.radius / RADIUS_STEP)
    axis = np.append(d[: first + 1, :2].sum(0), 0.0)
    kind = np.full((first + 1, len(radii)), -1, np.int64)
    classes: dict[tuple[int, bytes, bytes, float], int] = {}
    shapes: list[tuple[tuple[np.ndarray, ...], float]] = []
    for body in range(first + 1):
        parts, matters, exact = _body(spheres, body, d[:body, :2].sum(0))
        for s in np.flatnonzero(spheres.segment[group] > first):
            g, radius = group[s], float(radii[s])
            if matters[g].any():
                name = (body, matters[g].tobytes(), exact[g].tobytes(), radius)
                if name not in classes:
                    classes[name] = len(shapes)
                    keep = np.flatnonzero(matters[g])
                    center, rotation, half, grown = (part[keep] for part in parts)
                    grown = np.maximum(grown - SPHERE_EXCESS * exact[g, keep], -radius)
                    shapes.append(((center, rotation, half, grown), radius))
                kind[body, s] = classes[name]
    if not shapes:
        return StandingTable(np.zeros((1, 1, 1, PHASES), np.uint64), 0.0, kind)
    low, high, far = np.inf, -np.inf, 0.0
    for (center, _, half, grown), reach in shapes:
        extent = np.linalg.norm(half, axis=1) + grown + reach
        low = min(low, float((center[:, 2] - extent).min()))
        high = max(high, float((center[:, 2] + extent).max()))
        far = max(far, float((np.linalg.norm((center - axis)[:, :2], axis=1) + extent).max()))
    size = (int((high - low) / CELL) + 2, int(far / CELL) + 2, PHASES)
    words = np.zeros((len(shapes), *size), np.uint64)
    for i, ((center, rotation, half, grown), reach) in enumerate(shapes):
        fill_words(center - axis, rotation, half, grown, reach, low, words[i])
    return StandingTable(words, low, kind)


def _body(
    spheres: Spheres, body: int, xy: np.ndarray
) -> tuple[tuple[np.ndarray, ...], np.ndarray, np.ndarray]:
    """Return a body as rounded boxes, which of them count for each group, and which of these pairs
    are checked by hulls (groups, boxes).

    The base has boxes; other bodies have spheres, with their joint at height 0.
    """
    if body == 0:
        base = spheres.base
        boxes = (base.center, base.rotation, base.half, np.zeros(len(base)))
        return boxes, spheres.base_pairs, spheres.base_exact
    group = np.repeat(np.arange(len(spheres.segment)), np.diff(spheres.start))
    own = np.flatnonzero(spheres.segment[group] == body)
    paired = np.zeros((2, len(spheres.segment), len(spheres.segment)), bool)
    paired[0, spheres.pairs[:, 0], spheres.pairs[:, 1]] = True
    paired[1, spheres.pairs[:, 0], spheres.pairs[:, 1]] = spheres.exact
    matters, exact = (paired | paired.transpose(0, 2, 1))[:, :, group[own]]
    center = spheres.center[own] + np.append(xy, 0.0)
    rotation = np.tile(np.eye(3), (len(own), 1, 1))
    boxes = (center, rotation, np.zeros((len(own), 3)), spheres.radius[own])
    return boxes, matters, exact
