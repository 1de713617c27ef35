"""Closed-form inverse kinematics of six-joint arms, and its canonical subproblems.

Source: Elias and Wen, IK-Geo: Unified robot inverse kinematics using subproblem decomposition
(2022), after Paden (1986) and Kahan (1983).
"""

from __future__ import annotations

import math

import numpy as np

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


NUMERIC, WRIST_PARALLEL, WRIST_MEETING, THREE_PARALLEL, SLIDES = 0, 1, 2, 3, 4
NAMES = {
    NUMERIC: "numerical, seeded",
    WRIST_PARALLEL: "closed form: spherical wrist, axes 2 and 3 parallel",
    WRIST_MEETING: "closed form: spherical wrist, axes 1 and 2 meet",
    THREE_PARALLEL: "closed form: axes 2, 3 and 4 parallel",
    SLIDES: "closed form: three slides, then three revolute axes",
}
MAX_BRANCHES = 8
"""Largest number of solutions of any of these arms for one tool pose [-]."""


@kernel
def _first_three_wrist(kind, h, o, c0, c, out):
    """Write values of joints 1 to 3 that move the wrist center c0 to c to out (8, 6).

    Returns the count.
    """
    h1, h2, h3 = row(h, 0), row(h, 1), row(h, 2)
    o1, o2, o3 = row(o, 0), row(o, 1), row(o, 2)
    link, reach = sub(o3, o2), sub(c0, o3)
    w = sub(c, o1)
    count = 0
    if kind == WRIST_PARALLEL:
        n1, a1, b1 = sp4(h2, w, neg(h1), dot(h2, sub(c0, o1)))
        for i in range(n1):
            q1 = a1 if i == 0 else b1
            v = sub(rot(h1, -q1, w), sub(o2, o1))
            n3, a3, b3 = sp3(reach, neg(link), h3, np.sqrt(dot(v, v)))
            for j in range(n3):
                q3 = a3 if j == 0 else b3
                out[count, 0], out[count, 2] = q1, q3
                out[count, 1] = sp1(add(link, rot(h3, q3, reach)), v, h2)
                count += 1
        return count
    n3, a3, b3 = sp3(reach, neg(link), h3, np.sqrt(dot(w, w)))
    for j in range(n3):
        q3 = a3 if j == 0 else b3
        u = add(link, rot(h3, q3, reach))
        n1, a1, b1 = sp4(h2, w, neg(h1), dot(h2, u))
        for i in range(n1):
            q1 = a1 if i == 0 else b1
            out[count, 0], out[count, 2] = q1, q3
            out[count, 1] = sp1(u, rot(h1, -q1, w), h2)
            count += 1
    return count


@kernel
def spherical(kind, h, o, c0, R06, c, out):
    """Write all branches of an arm with a spherical wrist; return the count."""
    count = _first_three_wrist(kind, h, o, c0, c, out)
    h1, h2, h3 = row(h, 0), row(h, 1), row(h, 2)
    h5, h6 = row(h, 4), row(h, 5)
    total = count
    for i in range(count):
        q1, q2, q3 = out[i, 0], out[i, 1], out[i, 2]
        x6 = rot(h3, -q3, rot(h2, -q2, rot(h1, -q1, mul(R06, h6))))
        x5 = rot(h3, -q3, rot(h2, -q2, rot(h1, -q1, mul(R06, h5))))
        if not _last_three(h, x5, x6, i, total, out):
            out[i, 4] = np.nan
            continue
        out[total, 0], out[total, 1], out[total, 2] = q1, q2, q3
        total += 1
    return total


@kernel
def _last_three(h, x5, x6, i, k, out):
    """Write both values of joints 4 to 6 that turn axes 5 and 6 to x5 and x6 to rows i and k.

    Returns whether there are any.
    """
    h4, h5, h6 = row(h, 3), row(h, 4), row(h, 5)
    found, a5, b5 = sp4(h4, h6, h5, dot(h4, x6))
    for j in range(found):
        at, q5 = (i, a5) if j == 0 else (k, b5)
        out[at, 3], out[at, 4] = sp1(rot(h5, q5, h6), x6, h4), q5
        # Given q4: if axes 4 and 6 align, only the sum of both angles is determined.
        out[at, 5] = sp1(h5, rot(h5, -q5, rot(h4, -out[at, 3], x5)), h6)
    return found > 0


@kernel
def slides_and_wrist(h, o, R06, c, out):
    """Write both branches of three slides before three revolute axes; return the count.

    Args:
        h: Directions of the slides [m/m], then unit axes.
        o: Points on the axes in rows 4 to 6.
        R06: The turn of joints 4 to 6.
        c: Where the point on axis 6 must be.
        out: Output (8, 6).
    """
    if not _last_three(h, mul(R06, row(h, 4)), mul(R06, row(h, 5)), 0, 1, out):
        return 0
    s1, s2, s3 = row(h, 0), row(h, 1), row(h, 2)
    o4, o5, o6 = row(o, 3), row(o, 4), row(o, 5)
    across = cross(s2, s3)
    volume = dot(s1, across)
    for i in range(2):
        tip = add(sub(o5, o4), rot(row(h, 4), out[i, 4], sub(o6, o5)))
        left = sub(c, add(o4, rot(row(h, 3), out[i, 3], tip)))
        # Cramer's rule.
        out[i, 0] = dot(left, across) / volume
        out[i, 1] = dot(s1, cross(left, s3)) / volume
        out[i, 2] = dot(s1, cross(s2, left)) / volume
    return 2


@kernel
def _free_turn(h1, h2, offsets, foot, j, turned, sign):
    """Return a value of joint 6 that puts joint 4 in the middle of its reachable positions.

    Args:
        h1, h2: Axes 1 and 2.
        offsets: From joint 2 to 3, 3 to 4, and 4 to the wrist, at zero.
        foot: The wrist relative to joint 2.
        j: Which of the two values, 0 or 1.
        turned: h1 after the turn about h2 for joint 6 at zero.
        sign: Positive if axis 6 points along axis 2.
    """
    upper, lower, tip = offsets
    a, b = _across(upper, h2), _across(lower, h2)
    c, d = _across(tip, h2), _across(foot, h2)
    reach = 0.5 * (max(abs(a - b), abs(c - d)) + min(a + b, c + d))
    along = dot(h2, sub(tip, foot))
    n, one, other = sp3(tip, foot, h2, np.sqrt(reach * reach + along * along))
    if n == 0:
        return 0.0
    turn = sp1(h1, turned, h2) - (one if j == 0 else other)
    return turn if sign > 0 else -turn


@kernel
def _across(v, axis):
    """Return the length of the component of v perpendicular to a unit axis."""
    part = dot(v, axis)
    return np.sqrt(max(0.0, dot(v, v) - part * part))


@kernel
def three_parallel(h, o, c0, R06, c, out):
    """Write all branches of an arm with parallel axes 2, 3 and 4; return the count."""
    h1, h2, h3, h4, h5, h6 = (row(h, 0), row(h, 1), row(h, 2), row(h, 3), row(h, 4), row(h, 5))
    o1, o2, o3, o4 = row(o, 0), row(o, 1), row(o, 2), row(o, 3)
    s3 = 1.0 if dot(h2, h3) > 0 else -1.0
    s4 = 1.0 if dot(h2, h4) > 0 else -1.0
    upper, lower, tip = sub(o3, o2), sub(o4, o3), sub(c0, o4)
    w, z6 = sub(c, o1), mul(R06, h6)
    total = 0
    n1, a1, b1 = sp4(h2, w, neg(h1), dot(h2, sub(c0, o1)))
    for i in range(n1):
        q1 = a1 if i == 0 else b1
        n5, a5, b5 = sp4(h2, h6, h5, dot(h2, rot(h1, -q1, z6)))
        for j in range(n5):
            q5 = a5 if j == 0 else b5
            x2 = rot(h5, -q5, h2)
            across, foot = cross(x2, h6), sub(rot(h1, -q1, w), sub(o2, o1))
            if dot(across, across) < 1e-13:
                # Axis 6 is parallel to the three, so any q6 works that keeps joint 4 within reach.
                turned = rot(h1, -q1, mul(R06, rot(h5, -q5, h1)))
                q6 = _free_turn(h1, h2, (upper, lower, tip), foot, j, turned, dot(x2, h6))
            else:
                q6 = sp1(x2, mul_t(R06, rot(h1, q1, h2)), neg(h6))
            turned = rot(h1, -q1, mul(R06, rot(h6, -q6, rot(h5, -q5, h1))))
            theta = sp1(h1, turned, h2)
            t = sub(foot, rot(h2, theta, tip))
            along = dot(h2, t)
            flat = add(upper, lower)
            # Components along the axes are constant; the rest is the planar 2R problem.
            t = add(
                t,
                (
                    h2[0] * (dot(h2, flat) - along),
                    h2[1] * (dot(h2, flat) - along),
                    h2[2] * (dot(h2, flat) - along),
                ),
            )
            n3, a3, b3 = sp3(lower, neg(upper), h3, np.sqrt(dot(t, t)))
            for m in range(n3):
                q3 = a3 if m == 0 else b3
                q2 = sp1(add(upper, rot(h3, q3, lower)), t, h2)
                out[total, 0], out[total, 1], out[total, 2] = q1, q2, q3
                out[total, 3] = s4 * (theta - q2 - s3 * q3)
                out[total, 4], out[total, 5] = q5, q6
                total += 1
    return total
