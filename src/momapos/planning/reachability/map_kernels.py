"""Kernels that build a reachability map by exact IK.

The base (and a torso, which only rises) stays still while the arm turns about a vertical axis. So a
table over height and distance from that axis stores, as a word of bits, the azimuths at which a
sphere of a given radius touches. The word is rotated by the sphere's own azimuth. One lookup per
sphere replaces a collision check per azimuth.

For one line of the last axis (see `grid`), the first joint is freed and IK is solved once. Turning
the first joint turns the line about the vertical axis, so every solution serves a whole arc of
azimuths. Per azimuth, only the limits of the first joint and contact with the parts that do not
turn (base, torso) remain to be checked. The result is a bit mask over `AZIMUTHS` azimuths.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from momapos.core.compiled import B1, F1, F2, F3, I1, I2, U1, U3, U4, entry, kernel
from momapos.model.collision import FREE, Spheres, hit_floor, hit_self, place_bounds, scratch_of
from momapos.model.kinematics import (
    COARSE,
    MAX_BRANCHES,
    ArmArrays,
    ArmScratch,
    IkScratch,
    SphereArrays,
    begin_pose,
    forward,
    ik_scratch,
    solve_sample,
)

from .grid import oct_decode, turns_of

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


EVERY = np.uint64(0xFFFFFFFFFFFFFFFF)


class FirstJointArm(NamedTuple):
    """The arm as it turns with the first joint, and its collision shapes."""

    first: int
    """Index of the first joint."""
    turn: float
    lower: float
    upper: float
    """Of the first joint, see `ArmAxes`."""
    axis: F1
    turning: SphereArrays
    table: StandingTable


class Tool(NamedTuple):
    """The tool, and its turns about the line that are checked."""

    frame: F2
    """(4, 3): axis, two vectors that complete it to a right-handed frame, and the line's point."""
    spins: F1
    """Angles that are added to the last joint after IK is solved [rad]."""


class MaskScratch(NamedTuple):
    """Memory of `_line_mask`."""

    R_tool: F2
    p_tool: F1
    solutions: F2
    ik: IkScratch
    placed: ArmScratch
    works: B1
    votes: U1


class ShoulderSamples(NamedTuple):
    """For each sample, the value at which it locks the first joint."""

    arcs: U1
    """Azimuths that the value can serve, 0 if the sample does not lock the first joint."""
    value: I1
    """Index of the value."""
    step: I1
    """The values this far to both sides are evaluated before it; 0 for the first ones."""


@kernel
def line_pose(line, tool, R, p):
    """Compute a tool pose whose last axis is the given line at azimuth 0.

    Args:
        line: Coordinates z, r, u, v of the line, see `grid`.
        tool: Frame of the tool, see `Tool`.
        R, p: Output: the tool pose, relative to the foot of the first axis.
    """
    x, y, w = oct_decode(line[2], line[3])
    # A vector across the line: horizontal unless the line is vertical.
    n = math.hypot(x, y)
    if n > 1e-6:
        ex, ey, ez = -y / n, x / n, 0.0
    else:
        ex, ey, ez = 0.0, 1.0, 0.0
    fx, fy, fz = y * ez - w * ey, w * ex - x * ez, x * ey - y * ex
    for k in range(3):
        R[0, k] = x * tool[0, k] + ex * tool[1, k] + fx * tool[2, k]
        R[1, k] = y * tool[0, k] + ey * tool[1, k] + fy * tool[2, k]
        R[2, k] = w * tool[0, k] + ez * tool[1, k] + fz * tool[2, k]
    for i in range(3):
        p[i] = -(R[i, 0] * tool[3, 0] + R[i, 1] * tool[3, 1] + R[i, 2] * tool[3, 2])
    p[0] += line[1]
    p[2] += line[0]


@entry
def arc_mask(q: float, turn: float, lower: float, upper: float) -> np.uint64:
    """Return the mask of azimuths within the first joint's limits, from its value at azimuth 0."""
    if upper - lower >= 2.0 * math.pi - 1e-6:
        return EVERY
    mask = np.uint64(0)
    for b in range(AZIMUTHS):
        v = q + turn * (2.0 * math.pi / AZIMUTHS) * b
        v -= 2.0 * math.pi * math.floor((v - lower + 1e-9) / (2.0 * math.pi))
        if v <= upper + 1e-9:
            mask |= np.uint64(1) << np.uint64(b)
    return mask


@kernel
def _majority(votes):
    """Return the bits that are set in at least half of the words."""
    mask = np.uint64(0)
    for b in range(AZIMUTHS):
        bit, count = np.uint64(1) << np.uint64(b), 0
        for k in range(len(votes)):
            count += 2 if votes[k] & bit else 0
        if count >= len(votes):
            mask |= bit
    return mask


@kernel(inline="always")  # compiled once instead of twice: 3 s
def _line_mask(closed, spins, arm, freed, shoulder_samples, scratch):
    """Return the azimuths at which a tool pose is reachable with at least half of the spins.

    `closed` azimuths are skipped, as are locked values between two that agree or that cannot add an
    azimuth. The scratch memory holds the tool pose at azimuth 0 in the base frame.
    """
    first, turn, lower, upper, axis, turning, table = arm
    arcs, value, step = shoulder_samples
    R_tool, p_tool, out, ik, placed, works, votes = scratch
    R, p, bounds = placed
    chain = freed.chain
    works[:] = False
    votes[:] = closed
    done = closed
    last = out.shape[1] - 1
    begin_pose(ik)
    for s in range(len(arcs)):
        arc, v = arcs[s], value[s]
        if arc:
            if arc & ~done == np.uint64(0):
                works[v] = True
                continue
            if step[s] > 0:
                left = works[(v - step[s]) % len(works)]
                if left == works[(v + step[s]) % len(works)]:
                    works[v] = left
                    continue
        count = solve_sample(s, R_tool, p_tool, freed, COARSE, out, ik)
        for k in range(count):
            serves = arc if arc else arc_mask(out[k, first], turn, lower, upper)
            if serves & ~done == np.uint64(0):
                continue
            done = EVERY
            for i in range(len(spins)):
                gain = serves & ~votes[i]
                if gain:
                    out[k, last] += spins[i]
                    R[0], p[0] = np.eye(3), 0.0
                    forward(out[k], chain, R, p)
                    out[k, last] -= spins[i]
                    place_bounds(R, p, turning, bounds)
                    if (
                        hit_floor(R, p, bounds, turning) == FREE
                        and hit_self(R, p, bounds, turning) == FREE
                    ):
                        works[v] = True
                        votes[i] |= gain & ~touched(gain, R, p, turning, first, axis, table)
                done &= votes[i]
            if done == EVERY:
                return ~closed
    return _majority(votes) & ~closed


@entry
def line_masks(
    lines: F2,
    wanted: U1,
    tool: Tool,
    arm: FirstJointArm,
    freed: ArmArrays,
    shoulder_samples: ShoulderSamples,
    masks: U1,
) -> None:
    """Compute which of the wanted azimuths (m,) of lines (m, 4: z, r, u, v) can be reached.

    An azimuth counts if it is reachable with at least half of the spins.
    """
    n = freed.ik.samples.shape[1]
    axis, spins = arm.axis, tool.spins
    R, p = np.empty((3, 3)), np.empty(3)
    scratch = MaskScratch(
        R,
        p,
        np.empty((MAX_BRANCHES, n)),
        ik_scratch(freed),
        scratch_of(len(freed.chain.slides), arm.turning),
        np.zeros(np.max(shoulder_samples.value) + 1, np.bool_),
        np.empty(len(spins), np.uint64),
    )
    for i in range(len(lines)):
        line_pose(lines[i], tool.frame, R, p)
        p[0] += axis[0]
        p[1] += axis[1]
        masks[i] = _line_mask(~wanted[i], spins, arm, freed, shoulder_samples, scratch)
