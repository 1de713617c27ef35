"""Kernels that move an arm onto lines near a known state, and find the free tool turns about them.

The last joint only turns the tool about the line. So one state serves an arc of turns, a word of
`TURNS` bits.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from momapos.core.compiled import F1, F2, I1, S2, S3, U1, entry, kernel
from momapos.model.collision import FREE, hit_floor, hit_self, moved, place_bounds
from momapos.model.kinematics import (
    ChainArrays,
    JointLimits,
    NewtonScratch,
    SphereArrays,
    cross,
    dot,
    forward,
    jacobian,
    mul,
    newton_scratch,
    rotate_by,
    stand_at_origin,
    step_toward,
)

from .grid import TURNS, GridShape, oct_decode, relative_line, turns_of

SPAN = 8
"""Number of turns that one collision check covers [-]."""
ALL = np.uint64((1 << TURNS) - 1)
STEPS, ENOUGH = 8, 1e-6
"""Newton steps from a neighbor's state, and the squared residual that suffices [m^2 + rad^2]."""
EARLY, SLOW = 3, 0.5
"""From step `EARLY` on, stop if a step leaves more than this share of the squared residual [-].
Hardly one in a hundred converging starts is that slow."""


class LineTool(NamedTuple):
    """The line in the frame of the last segment."""

    direction: F1
    across: F1
    """Unit vector across the line; its angle about the line is the tool turn."""
    point: F1


class AimedArm(NamedTuple):
    """An arm, its line, and its spheres for collisions with itself and the floor."""

    chain: ChainArrays
    limits: JointLimits
    line: LineTool
    turns: bool
    """Whether the last joint turns about the line; else each state has one tool turn."""
    still: SphereArrays
    """Spheres with the pairs that the last joint does not move."""
    turned: SphereArrays
    """Spheres with the pairs that the last joint moves."""
    own: I1
    """Groups of spheres that the last joint moves."""
    foot: F1
    """Foot of the vertical axis that the grid is centered on, in the base frame [m]."""


class LineGrid(NamedTuple):
    """The grid of lines, see `grid`."""

    low: float
    cell: float
    directions: int
    azimuths: int


@kernel
def line_at(place, grid):
    """Return the point relative to the foot, and the direction, of a line in the base frame.

    Args:
        place: z, r, u, v and azimuth in grid steps; fractions lie between grid points.
        grid: `LineGrid`.
    """
    half = 0.5 * (grid.directions - 1)
    x, y, w = oct_decode(place[2] / half - 1.0, place[3] / half - 1.0)
    angle = 2.0 * math.pi * place[4] / grid.azimuths
    c, s = math.cos(angle), math.sin(angle)
    r = place[1] * grid.cell
    point = (r * c, r * s, grid.low + place[0] * grid.cell)
    return point, (c * x - s * y, s * x + c * y, w)


@kernel
def horizontal_across(d):
    """Return the horizontal unit vector across a direction: the zero of the tool turn."""
    n = math.hypot(d[0], d[1])
    return (-d[1] / n, d[0] / n, 0.0) if n > 1e-6 else (0.0, 1.0, 0.0)


@kernel
def _aim(q, active, point, direction, arm, scratch):
    """Move the arm's line onto a line within the limits, in place; return whether it converges.

    R and p of the scratch memory then hold the segment poses at q.
    """
    chain, limits = arm.chain, arm.limits
    R, p, J, A, e, column = scratch
    last, m = len(chain.slides), len(active)
    for i in range(len(q)):
        column[i] = -1
    for a in range(m):
        column[active[a]] = a
    stand_at_origin(R, p)
    before = math.inf
    for step in range(STEPS + 1):
        forward(q, chain, R, p)
        d = mul(R[last], (arm.line.direction[0], arm.line.direction[1], arm.line.direction[2]))
        t = mul(R[last], (arm.line.point[0], arm.line.point[1], arm.line.point[2]))
        tool = (p[last, 0] + t[0], p[last, 1] + t[1], p[last, 2] + t[2])
        w = cross(d, direction)
        residual = 0.0
        for k in range(3):
            e[k] = point[k] + arm.foot[k] - tool[k]
            e[k + 3] = w[k]
            residual += e[k] * e[k] + w[k] * w[k]
        if dot(d, direction) < 0.0:
            residual += 1.0
        if residual < ENOUGH:
            return True
        if step == STEPS or (step >= EARLY and residual > SLOW * before):
            return False
        before = residual
        jacobian(chain, R, p, tool, column, m, J)
        for a in range(m):
            # Remove rotation about the line, which is free.
            about = J[3, a] * d[0] + J[4, a] * d[1] + J[5, a] * d[2]
            for k in range(3):
                J[k + 3, a] -= about * d[k]
        _hold_at_limits(q, active, limits, J, e)
        step_toward(q, active, limits, J, A, e, 1e-7 + 0.1 * residual, True)
    return False


@kernel
def _hold_at_limits(q, active, limits, J, e):
    """Zero the columns of J of joints that are at a limit and would move beyond it.

    With them, every step would fall short of the line by the clipped part, and a third fewer
    neighboring lines would be found.
    """
    for a in range(len(active)):
        j = active[a]
        below, above = q[j] <= limits.lower[j], q[j] >= limits.upper[j]
        if not (below or above):
            continue
        toward = 0.0
        for k in range(6):
            toward += J[k, a] * e[k]
        if (above and toward > 0.0) or (below and toward < 0.0):
            for k in range(6):
                J[k, a] = 0.0


@kernel
def _turn_of(R, direction, arm):
    """Return the tool's turn about its line [turns], in [0, 1)."""
    a = mul(R, (arm.line.across[0], arm.line.across[1], arm.line.across[2]))
    e = horizontal_across(direction)
    f = cross(direction, e)
    turn = math.atan2(dot(a, f), dot(a, e)) / (2.0 * math.pi)
    return turn - math.floor(turn)


@kernel
def _free_turns(held, known, direction, arm, R, p, bounds):
    """Return the word of turns that a state on the line serves, without the known ones.

    `held` is the state's value of the last joint. R and p are its segment poses; the last segment
    is turned in place.
    """
    chain, spheres = arm.chain, arm.turned
    last, n = len(chain.slides), len(arm.limits.lower) - 1
    now = _turn_of(R[last], direction, arm)
    lower, upper = arm.limits.lower[n], arm.limits.upper[n]
    place_bounds(R, p, spheres, bounds)
    word, looked = np.uint64(0), False
    for group in range(TURNS // SPAN):
        wanted, middle, count = np.uint64(0), 0.0, 0
        for i in range(group * SPAN, (group + 1) * SPAN):
            bit = np.uint64(1) << np.uint64(i)
            if known & bit:
                continue
            off = (i + 0.5) / TURNS - now
            if not arm.turns:
                if abs(off - math.floor(off + 0.5)) > 0.5 / TURNS + 1e-9:
                    continue
                value = held
            else:
                value = held + 2.0 * math.pi * off
                if not math.isinf(lower):
                    value -= 2.0 * math.pi * math.floor((value - lower) / (2.0 * math.pi))
                if value > upper:
                    continue
            wanted |= bit
            # One turn is checked for the whole group: the last one that is wanted.
            middle = value
            count += 1
        if count:
            if arm.turns:
                # The last joint moves no other segment, nor the origin of its own.
                turned = chain.ratio[last - 1] * middle
                rotate_by(R[last - 1], chain.h[last - 1], turned, R[last])
                for g in arm.own:
                    bounds[g, 0], bounds[g, 1], bounds[g, 2] = moved(
                        R, p, last, spheres.bound_center[g]
                    )
            # Contact of the parts that the turn does not move is the same at all turns.
            if not looked and _hit(R, p, bounds, arm.still):
                break
            looked = True
            if not _hit(R, p, bounds, spheres):
                word |= wanted
    return word


@kernel
def _hit(R, p, bounds, spheres):
    return hit_floor(R, p, bounds, spheres) != FREE or hit_self(R, p, bounds, spheres) != FREE


class Memory(NamedTuple):
    """Memory of `aim_from`."""

    newton: NewtonScratch
    bounds: F2
    """Centers of the bounding spheres."""
    active: I1
    """Joints that are moved toward a line; the last one only if it does more than turn the tool."""
    q: F1
    """The state that the last aim reached."""


@kernel
def memory(arm):
    """Allocate the memory for `aim_from`."""
    n = len(arm.limits.lower)
    return Memory(
        newton_scratch(arm.chain, n),
        np.empty((len(arm.turned.segment), 3)),
        np.arange(n - 1 if arm.turns else n),
        np.empty(n),
    )


@kernel
def aim_from(place, start, known, arm, grid, own):
    """Move an arm onto a line from a nearby state; return the word of new turns that it serves.

    Args:
        place: z, r, u, v, azimuth of the line in grid steps.
        start: The start state (n,).
        known: Word of turns to skip.
        arm: `AimedArm`.
        grid: `LineGrid`.
        own: `Memory`; if the word is not 0, its q is the state on the line.
    """
    for k in range(len(start)):
        own.q[k] = start[k]
    point, direction = line_at(place, grid)
    if not _aim(own.q, own.active, point, direction, arm, own.newton):
        return np.uint64(0)
    return _free_turns(
        own.q[len(start) - 1], known, direction, arm, own.newton.R, own.newton.p, own.bounds
    )


@entry
def aim_all(
    places: F2, starts: S2, known: U1, arm: AimedArm, grid: LineGrid, words: U1, states: S2
) -> None:
    """Move an arm onto lines, each from one state.

    Args:
        places: Lines (k, 5): z, r, u, v, azimuth in grid steps.
        starts: The start state of each (k, n).
        known: Words of turns to skip (k,).
        words: Output: words of new turns (k,).
        states: Output: the state on each line (k, n).
    """
    own = memory(arm)
    for i in range(len(places)):
        words[i] = aim_from(places[i], starts[i], known[i], arm, grid, own)
        for k in range(starts.shape[1]):
            states[i, k] = own.q[k]


@entry
def lines_of(q: F2, arm: AimedArm, grid: LineGrid, places: F2) -> None:
    """Compute the lines of states (k, n), as places (k, 5) in grid steps; see `line_at`."""
    last = len(arm.chain.slides)
    R, p = np.empty((last + 1, 3, 3)), np.empty((last + 1, 3))
    stand_at_origin(R, p)
    half = 0.5 * (grid.directions - 1)
    for i in range(len(q)):
        forward(q[i], arm.chain, R, p)
        d = mul(R[last], (arm.line.direction[0], arm.line.direction[1], arm.line.direction[2]))
        t = mul(R[last], (arm.line.point[0], arm.line.point[1], arm.line.point[2]))
        x = p[last, 0] + t[0] - arm.foot[0]
        y = p[last, 1] + t[1] - arm.foot[1]
        r, u, v = relative_line(x, y, d[0], d[1], d[2])
        places[i, 0] = (p[last, 2] + t[2] - arm.foot[2] - grid.low) / grid.cell
        places[i, 1] = r / grid.cell
        places[i, 2], places[i, 3] = (u + 1.0) * half, (v + 1.0) * half
        places[i, 4] = turns_of(y, x) * grid.azimuths


AZIMUTH = 4
"""The periodic axis of the grid."""
GROUPS = TURNS // SPAN
"""Number of groups of turns; a line stores a state for each [-]."""


class LineStates(NamedTuple):
    """The turns reached on each line of a grid, and arm states that reach them."""

    shape: GridShape
    """Number of lines along each axis."""
    words: U1
    """Tool turns that are reached on each line."""
    states: S3
    """A state per line and group of turns that reaches some of these turns (lines, groups, n).
    Distant turns need different states, and neighboring lines start from each of them."""


@kernel
def group_of_turns(group):
    """Return the word of the turns of a group."""
    return np.uint64(((1 << SPAN) - 1) << (SPAN * group))


@kernel
def _unravel(line, shape, at):
    for k in range(4, -1, -1):
        at[k] = line % shape[k]
        line //= shape[k]


@kernel
def _beside(line, axis, step, shape, at):
    """Return the line some steps along an axis, -1 if outside the grid; `at` becomes its index."""
    _unravel(line, shape, at)
    at[axis] += step
    if axis == AZIMUTH:
        at[AZIMUTH] = (at[AZIMUTH] + shape[AZIMUTH]) % shape[AZIMUTH]
    elif at[axis] < 0 or at[axis] >= shape[axis]:
        return -1
    beside = 0
    for k in range(5):
        beside = beside * shape[k] + int(at[k])
    return beside


@kernel
def _asked_before(states, group, asked):
    """Check whether an earlier group with the same state was already used as a start."""
    for g in range(group):
        if not asked & (1 << g):
            continue
        same = True
        for k in range(states.shape[1]):
            same = same and states[g, k] == states[group, k]
        if same:
            return True
    return False


@entry
def aim_beside(
    rows: I1,
    axis: int,
    step: int,
    fresh: U1,
    known: LineStates,
    arm: AimedArm,
    grid: LineGrid,
    lines: I1,
    words: U1,
    states: S3,
) -> None:
    """Aim the arm at neighboring lines, from the states on the given lines.

    Args:
        rows: The lines that have gained turns (k,).
        axis, step: Where the neighbor of each line is.
        fresh: The turns that each line of the grid has gained; its neighbor is tried for these.
        known: What is known so far. It is not changed, so threads do not see each other's results.
        lines: Output: the neighbor of each line (k,); -1 if outside the grid.
        words: Output: the new turns found on the neighbor (k,).
        states: Output: the states that reach them (k, groups, n), for the groups found.
    """
    own, at = memory(arm), np.empty(5)
    for i in range(len(rows)):
        source = rows[i]
        words[i] = np.uint64(0)
        lines[i] = _beside(source, axis, step, known.shape, at)
        if lines[i] < 0:
            continue
        told, asked = known.words[lines[i]], 0
        for group in range(GROUPS):
            if not fresh[source] & ~told & group_of_turns(group):
                continue
            # One state usually serves several groups.
            if _asked_before(known.states[source], group, asked):
                continue
            asked |= 1 << group
            word = aim_from(at, known.states[source, group], told, arm, grid, own)
            told |= word
            words[i] |= word
            _keep(word, own.q, states[i])


@kernel
def _keep(word, q, states):
    """Store a state for the groups of the turns that it reaches."""
    for group in range(GROUPS):
        if word & group_of_turns(group):
            for k in range(len(q)):
                states[group, k] = q[k]


@entry
def add(lines: I1, words: U1, states: S3, known: LineStates, gained: U1) -> None:
    """Add turns found on lines to `known` and `gained`.

    Args:
        lines: The lines (k,); -1 for none. For a line listed twice the last states are stored;
            threads must not share a line.
        words: Turns found on each line (k,).
        states: The states that reach them (k, groups, n).
        known: What is known so far, changed in place.
        gained: The turns that each line of the grid has gained, changed in place.
    """
    for i in range(len(lines)):
        line, word = lines[i], words[i]
        if not word:
            continue
        known.words[line] |= word
        gained[line] |= word
        for group in range(GROUPS):
            if word & group_of_turns(group):
                for k in range(states.shape[2]):
                    known.states[line, group, k] = states[i, group, k]


@entry
def aim_between(
    low: I1,
    axis: int,
    wanted: np.uint64,
    known: LineStates,
    arm: AimedArm,
    grid: LineGrid,
    words: U1,
) -> None:
    """Find the turns reached half-way between lines and the next ones along an axis.

    Args:
        low: The lines at the lower ends (k,).
        axis: Axis along which the lines are neighbors.
        wanted: Word of the turns that matter; the other bits of the result are undefined.
        known: What is known of the lines.
        words: Output: the turns reached there (k,).
    """
    own, at, to = memory(arm), np.empty(5), np.empty(5)
    ends = np.empty(2, np.int64)
    for i in range(len(low)):
        ends[0], ends[1] = low[i], _beside(low[i], axis, 1, known.shape, to)
        both = known.words[ends[0]] & known.words[ends[1]]
        # Turns on which both ends agree are assumed to agree half-way, too.
        either = known.words[ends[0]] | known.words[ends[1]]
        _unravel(low[i], known.shape, at)
        at[axis] += 0.5
        word = both
        for end in range(2):
            # Start from the end that has turns which the other end lacks.
            for group in range(GROUPS):
                if known.words[ends[end]] & ~word & wanted & group_of_turns(group):
                    start = known.states[ends[end], group]
                    word |= aim_from(at, start, word | ~wanted, arm, grid, own) & either
        words[i] = word
