"""Static efforts of an arm: what its joints must bear at rest, under gravity and a load."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from momapos.core import GRAVITY
from momapos.core.compiled import F1, F2, entry, kernel

from .chain import forward, stand_at_origin
from .kernel_records import ChainArrays


class SegmentMasses(NamedTuple):
    """Mass of each of the m + 1 segments of a chain, the base first."""

    mass: F1
    """[kg]"""
    center: F2
    """Center of mass in the segment's frame [m]."""


@entry
def static_efforts(
    q: F2, chain: ChainArrays, masses: SegmentMasses, force: F2, point: F2
) -> tuple[np.ndarray, np.ndarray]:
    """Compute what the degrees of freedom must exert to hold an arm still.

    The generalized force of a joint is that of all weights and loads beyond it, along or about its
    axis (Lynch and Park, Modern Robotics, section 5.2). A degree of freedom bears those of its
    joints, each times the joint's ratio.

    Args:
        q: Values of the n degrees of freedom at s states.
        chain: The arm; gravity acts along -z of the base.
        masses: The masses that it carries.
        force: Force on the hand or on what it holds, in the base frame (s, 3) [N].
        point: Where it acts, in the base frame (s, 3) [m].

    Returns:
        Efforts (s, n) [Nm] or [N], and the center of mass of the whole robot (s, 3) [m].
    """
    count, last = len(q), len(chain.slides)
    efforts, center = np.zeros((count, q.shape[1])), np.zeros((count, 3))
    R, p = np.empty((last + 1, 3, 3)), np.empty((last + 1, 3))
    stand_at_origin(R, p)
    total = max(masses.mass.sum(), 1e-12)
    f, m, c = np.empty(3), np.empty(3), np.empty(3)
    for s in range(count):
        forward(q[s], chain, R, p)
        for k in range(3):
            f[k] = force[s, k]
        _moment(point[s], f, m)
        for j in range(last, -1, -1):
            for k in range(3):
                c[k] = p[j, k]
                for i in range(3):
                    c[k] += R[j, k, i] * masses.center[j, i]
                center[s, k] += masses.mass[j] * c[k] / total
            weight = masses.mass[j] * GRAVITY
            f[2] -= weight
            m[0] -= c[1] * weight
            m[1] += c[0] * weight
            if j > 0:
                borne = _along_axis(R[j - 1], p[j], chain.h[j - 1], chain.slides[j - 1], f, m)
                efforts[s, chain.dof[j - 1]] -= chain.ratio[j - 1] * borne
    return efforts, center


@kernel
def _moment(point, force, out):
    """Write the moment of a force about the origin."""
    out[0] = point[1] * force[2] - point[2] * force[1]
    out[1] = point[2] * force[0] - point[0] * force[2]
    out[2] = point[0] * force[1] - point[1] * force[0]


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
