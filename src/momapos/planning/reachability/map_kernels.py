"""Kernels that build a reachability map by exact IK.

For one line of the last axis (see `grid`), the first joint is freed and IK is solved once. Turning
the first joint turns the line about the vertical axis, so every solution serves a whole arc of
azimuths. Per azimuth, only the limits of the first joint and contact with the parts that do not
turn (base, torso) remain to be checked. The result is a bit mask over `AZIMUTHS` azimuths.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from momapos.core.compiled import B1, F1, F2, I1, U1, entry, kernel
from momapos.model.collision import FREE, hit_floor, hit_self, place_bounds, scratch_of
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

from .base_contact import AZIMUTHS, StandingTable, touched
from .grid import oct_decode

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
