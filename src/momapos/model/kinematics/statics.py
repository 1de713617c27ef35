"""Static loads of an arm on a base: joint efforts and stability, under gravity and a load."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from momapos.core import GRAVITY
from momapos.core.compiled import F1, F2, F3, entry, kernel

from .chain import ChainArrays, forward, stand_at_origin

TIPPING_SCALE = 10.0
"""Excess of a base per meter of tipping: a centimeter counts as a tenth of an effort limit."""
BASE = -1
"""Stands for the base in place of a degree of freedom."""


class LoadArrays(NamedTuple):
    """Masses of the m + 1 segments of a chain, the base first, and what the robot bears."""

    mass: F1
    """[kg]"""
    center: F2
    """Center of mass in the segment's frame [m]."""
    limit: F1
    """Largest effort of each degree of freedom at rest [Nm] or [N]; infinite for none."""
    normals: F2
    """Outward unit normals of the k edges of the area that the wheels stand on, in the base frame;
    without edges the base does not tip over."""
    offsets: F1
    """Distance of each edge from the origin along its normal [m]."""
    least_stability: float
    """Distance that the zero moment point must keep from the edges [m]."""


class LoadScratch(NamedTuple):
    """Scratch memory of `state_loads`."""

    R: F3
    p: F2
    efforts: F1
    """Effort of each degree of freedom, the result."""
    force: F1
    moment: F1
    center: F1


@kernel
def load_scratch(joints, freedoms):
    """Allocate the scratch memory for a chain, with its base at the origin."""
    R, p = np.empty((joints + 1, 3, 3)), np.empty((joints + 1, 3))
    stand_at_origin(R, p)
    return LoadScratch(R, p, np.zeros(freedoms), np.empty(3), np.empty(3), np.empty(3))


@kernel
def state_loads(q, chain, robot, force, point, scratch):
    """Write the efforts that hold a state to the scratch memory, and return its stability.

    The generalized force of a joint is that of all weights and loads beyond it, along or about its
    axis (Lynch and Park, Modern Robotics, section 5.2). A degree of freedom bears those of its
    joints, each times the joint's ratio. The stability is the distance of the zero moment point
    (Vukobratovic 1972), where the floor's reaction acts, from the nearest edge of the area that
    the wheels stand on.

    Args:
        q: Values of the n degrees of freedom.
        chain: The arm; gravity acts along -z of the base.
        robot: `LoadArrays`.
        force: Force on the hand or on what it holds, in the base frame [N].
        point: Where it acts, in the base frame [m].
        scratch: From `load_scratch`.

    Returns:
        The stability [m]; negative if the robot tips over, infinite if the support is unknown.
    """
    R, p, efforts, f, m, c = scratch
    forward(q, chain, R, p)
    for k in range(len(efforts)):
        efforts[k] = 0.0
    for k in range(3):
        f[k] = force[k]
        i, j = (k + 1) % 3, (k + 2) % 3
        m[k] = point[i] * force[j] - point[j] * force[i]
    for s in range(len(chain.slides), -1, -1):
        for k in range(3):
            c[k] = p[s, k]
            for i in range(3):
                c[k] += R[s, k, i] * robot.center[s, i]
        weight = robot.mass[s] * GRAVITY
        f[2] -= weight
        m[0] -= c[1] * weight
        m[1] += c[0] * weight
        if s > 0:
            borne = _along_axis(R[s - 1], p[s], chain.h[s - 1], chain.slides[s - 1], f, m)
            efforts[chain.dof[s - 1]] -= chain.ratio[s - 1] * borne
    return _stability(f, m, robot)


@kernel
def _along_axis(R, origin, axis, slides, force, moment):
    """Return the component of a wrench about the origin along a joint's axis through a point."""
    out = 0.0
    for k in range(3):
        a = R[k, 0] * axis[0] + R[k, 1] * axis[1] + R[k, 2] * axis[2]
        if slides:
            out += a * force[k]
        else:
            i, j = (k + 1) % 3, (k + 2) % 3
            out += a * (moment[k] - (origin[i] * force[j] - origin[j] * force[i]))
    return out


@kernel
def _stability(force, moment, robot):
    """Return the distance inside the support of the reaction to a force and moment."""
    if len(robot.offsets) == 0:
        return np.inf
    if force[2] >= 0.0:
        return -np.inf
    x, y = -moment[1] / force[2], moment[0] / force[2]
    least = np.inf
    for k in range(len(robot.offsets)):
        inside = robot.offsets[k] - robot.normals[k, 0] * x - robot.normals[k, 1] * y
        least = min(least, inside)
    return least


@kernel
def load_excess(efforts, stability, robot):
    """Return by how much a state exceeds its limits, and where: a degree of freedom or BASE.

    The excess is a share of the limit; the state is borne if it is not above 0.
    """
    worst, where = TIPPING_SCALE * (robot.least_stability - stability), BASE
    for k in range(len(efforts)):
        excess = abs(efforts[k]) / robot.limit[k] - 1.0
        if excess > worst:
            worst, where = excess, k
    return worst, where


@entry
def static_loads(
    q: F2, chain: ChainArrays, robot: LoadArrays, force: F2, point: F2
) -> tuple[np.ndarray, ...]:
    """Return the loads of s states, see `state_loads` and `load_excess`.

    Returns:
        Efforts (s, n) [Nm] or [N], stability (s,) [m], excess (s,) [-] and where it is (s,).
    """
    count = len(q)
    efforts, stability = np.empty(q.shape), np.empty(count)
    excess, where = np.empty(count), np.empty(count, np.int64)
    scratch = load_scratch(len(chain.slides), q.shape[1])
    for s in range(count):
        stability[s] = state_loads(q[s], chain, robot, force[s], point[s], scratch)
        for k in range(q.shape[1]):
            efforts[s, k] = scratch.efforts[k]
        excess[s], where[s] = load_excess(scratch.efforts, stability[s], robot)
    return efforts, stability, excess, where
