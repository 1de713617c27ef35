"""Canonical subproblems of inverse kinematics, on tuples, which numba keeps in registers.

Source: Elias and Wen, IK-Geo: Unified robot inverse kinematics using subproblem decomposition
(2022), after Paden (1986) and Kahan (1983).
"""

from __future__ import annotations

import math

from momapos.core.compiled import kernel

Vec = tuple[float, float, float]
_EDGE = 1e-4
"""A cosine may exceed its range by this, relatively; Newton steps reject false solutions [-]."""


@kernel
def dot(a, b):
    """a . b"""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def cross(a, b):
    """a x b"""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@kernel
def add(a, b):
    """a + b"""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


@kernel
def sub(a, b):
    """a - b"""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


@kernel
def neg(a):
    """-a"""
    return (-a[0], -a[1], -a[2])


@kernel
def row(A, i):
    """Return row i of an array (n, 3) as a tuple."""
    return (A[i, 0], A[i, 1], A[i, 2])


@kernel
def mul(R, v):
    """R v for a matrix (3, 3)."""
    return (
        R[0, 0] * v[0] + R[0, 1] * v[1] + R[0, 2] * v[2],
        R[1, 0] * v[0] + R[1, 1] * v[1] + R[1, 2] * v[2],
        R[2, 0] * v[0] + R[2, 1] * v[1] + R[2, 2] * v[2],
    )


@kernel
def mul_t(R, v):
    """R^T v for a matrix (3, 3)."""
    return (
        R[0, 0] * v[0] + R[1, 0] * v[1] + R[2, 0] * v[2],
        R[0, 1] * v[0] + R[1, 1] * v[1] + R[2, 1] * v[2],
        R[0, 2] * v[0] + R[1, 2] * v[1] + R[2, 2] * v[2],
    )


@kernel
def rot(k, angle, v):
    """Rotate v by an angle about the unit axis k."""
    c, s = math.cos(angle), math.sin(angle)
    w = cross(k, v)
    m = dot(k, v) * (1.0 - c)
    return (
        c * v[0] + s * w[0] + m * k[0],
        c * v[1] + s * w[1] + m * k[1],
        c * v[2] + s * w[2] + m * k[2],
    )


@kernel
def sp1(p1, p2, k):
    """Return the angle that rotates p1 onto p2 about k (least squares if lengths differ)."""
    return math.atan2(dot(k, cross(p1, p2)), dot(p1, p2) - dot(k, p1) * dot(k, p2))


@kernel
def sp4(h, p, k, d):
    """Solve h . rot(k, angle) p = d; return the count (0 or 2) and both angles."""
    hk, kp = dot(h, k), dot(k, p)
    a, b = dot(h, p) - hk * kp, dot(h, cross(k, p))
    r = math.hypot(a, b)
    ratio = d - hk * kp
    if r < 1e-9:
        # The angle has no effect: all angles are solutions, or none.
        return (2, 0.0, math.pi) if abs(ratio) < _EDGE else (0, 0.0, 0.0)
    if abs(ratio) > r * (1.0 + _EDGE):
        return 0, 0.0, 0.0
    phi = math.atan2(b, a)
    delta = math.acos(max(-1.0, min(1.0, ratio / r)))
    return 2, phi + delta, phi - delta


@kernel
def sp3(p1, p2, k, d):
    """Solve |rot(k, angle) p1 - p2| = d; return the count (0 or 2) and both angles."""
    return sp4(p2, p1, k, 0.5 * (dot(p1, p1) + dot(p2, p2) - d * d))
