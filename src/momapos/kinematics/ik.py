"""Inverse kinematics: every branch in closed form where the arm allows it.

Closed forms exist here for six revolute joints with a spherical wrist (axes 4, 5, 6 meet) whose
second and third axes are parallel or whose first two meet, and for three parallel axes (2, 3, 4)
with 5 and 6 meeting (Universal Robots). Longer arms get their extra joints locked at sampled
values. Whatever the closed form leaves as an error (published URDFs round pi/2) Newton removes.
All other arms are solved by damped Newton steps from seeds.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numba import njit

from momapos.errors import RobotError
from momapos.kinematics.chain import Chain, forward, stand_at_origin
from momapos.kinematics.subproblems import (
    add,
    cross,
    dot,
    mul,
    mul_t,
    neg,
    rot,
    row,
    sp1,
    sp3,
    sp4,
    sub,
)

NUMERIC, WRIST_PARALLEL, WRIST_MEETING, THREE_PARALLEL = 0, 1, 2, 3
NAMES = {
    NUMERIC: "numerical, seeded",
    WRIST_PARALLEL: "closed form: spherical wrist, axes 2 and 3 parallel",
    WRIST_MEETING: "closed form: spherical wrist, axes 1 and 2 meet",
    THREE_PARALLEL: "closed form: axes 2, 3 and 4 parallel",
}
_LOOSE = 5e-3
"""How far [m or rad] from the ideal geometry Newton may be asked to bridge."""
_TIGHT = 1e-12
"""Squared residual at which a solution counts as exact [m^2 + rad^2]."""
MAX_BRANCHES = 8


@dataclass(frozen=True)
class IkModel:
    """How to invert one arm."""

    kind: int
    active: Int[np.ndarray, " a"]
    """Indices of the joints that are solved for; the others are locked at a sample."""
    samples: Float[np.ndarray, "s n"]
    """Full configurations that hold the locked values (numerical: the seeds)."""
    h: Float[np.ndarray, "s a 3"]
    """Axes of the active joints with the locked ones in place."""
    o: Float[np.ndarray, "s a 3"]
    """Points on those axes that the closed forms want, in the base frame [m]."""
    wrist: Float[np.ndarray, "s 3"]
    """The point where the last axes meet [m]."""
    R_tool: Float[np.ndarray, "s 3 3"]
    p_tool: Float[np.ndarray, "s 3"]
    """Tool pose with the active joints at zero."""

    @property
    def name(self) -> str:
        """What kind of solution this is, in words."""
        return NAMES[self.kind]

    @property
    def max_solutions(self) -> int:
        """Upper bound on the number of solutions for one pose."""
        return len(self.samples) * (1 if self.kind == NUMERIC else MAX_BRANCHES)


def build_ik(chain: Chain, *, samples_per_joint: int = 9, seeds: int = 48) -> IkModel:
    """Find the closed form that fits an arm, or fall back to seeded Newton steps.

    Args:
        chain: The arm.
        samples_per_joint: Values at which a redundant revolute joint is locked [-]; a prismatic
            one (a torso) gets half as many.
        seeds: Number of seeds for arms without closed form [-].
    """
    revolute = np.flatnonzero(~chain.prismatic)
    if len(revolute) >= 6:
        for active in _active_sets(revolute):
            model = _closed_form(chain, np.array(active), samples_per_joint)
            if model is not None:
                return model
    return _numeric(chain, seeds)


def _active_sets(revolute: np.ndarray) -> list[tuple[int, ...]]:
    """Sets of six revolute joints to solve for; the joints nearest the base are locked first."""
    sets = itertools.combinations(revolute.tolist(), 6)
    return sorted(sets, key=lambda active: -sum(active))


def locked_values(chain: Chain, joint: int, count: int) -> Float[np.ndarray, " k"]:
    """Values at which a redundant joint is held: the whole range, ends included."""
    lower, upper = chain.lower[joint], chain.upper[joint]
    if chain.prismatic[joint]:
        return np.linspace(lower, upper, max(2, (count + 1) // 2))
    if not np.isfinite(upper - lower) or upper - lower >= 2 * np.pi:
        return np.linspace(-np.pi, np.pi, count, endpoint=False)
    return np.linspace(lower, upper, count)


def _closed_form(chain: Chain, active: np.ndarray, count: int) -> IkModel | None:
    locked = [j for j in range(chain.size) if j not in set(active.tolist())]
    grid = list(itertools.product(*(locked_values(chain, j, count) for j in locked)))
    samples = np.zeros((len(grid), chain.size))
    samples[:, locked] = np.array(grid).reshape(len(grid), len(locked))
    folded = [_fold(chain, sample, active) for sample in samples]
    kinds = {_classify(h, o) for h, o, _, _ in folded}
    if len(kinds) != 1 or (kind := kinds.pop()) is None:
        return None
    h = np.array([item[0] for item in folded])
    o = np.array([_points(kind, item[0], item[1]) for item in folded])
    wrist = np.array([_meeting(item[0][4:], item[1][4:])[0] for item in folded])
    R, p = np.array([item[2] for item in folded]), np.array([item[3] for item in folded])
    return IkModel(kind, active.astype(np.int64), samples, h, o, wrist, R, p)


def _fold(
    chain: Chain, sample: np.ndarray, active: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Axes, origins and tool pose of the active joints with the others in place."""
    n = chain.size
    R, p = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3))
    stand_at_origin(R, p)
    forward(sample, chain.h, chain.d, chain.prismatic, R, p)
    h = np.einsum("aij,aj->ai", R[active], chain.h[active])
    return h, p[active + 1], R[n] @ chain.tool_rotation, p[n] + R[n] @ chain.tool_offset


def _meeting(h: np.ndarray, o: np.ndarray) -> tuple[np.ndarray, float]:
    """Point nearest to several lines, and how far the worst line misses it [m]."""
    P = np.eye(3) - h[:, :, None] * h[:, None, :]
    point = np.linalg.lstsq(P.sum(0), np.einsum("nij,nj->i", P, o), rcond=None)[0]
    gaps = np.einsum("nij,nj->ni", P, point - o)
    return point, float(np.linalg.norm(gaps, axis=1).max())


def _classify(h: np.ndarray, o: np.ndarray) -> int | None:
    def parallel(i: int, j: int) -> bool:
        return bool(np.linalg.norm(np.cross(h[i], h[j])) < _LOOSE)

    if parallel(4, 5):
        return None
    if parallel(1, 2) and parallel(2, 3) and not parallel(0, 1):
        return THREE_PARALLEL if _meeting(h[4:], o[4:])[1] < _LOOSE else None
    if parallel(3, 4) or _meeting(h[3:], o[3:])[1] > _LOOSE:
        return None
    if parallel(1, 2) and not parallel(0, 1):
        return WRIST_PARALLEL
    if not parallel(0, 1) and _meeting(h[:2], o[:2])[1] < _LOOSE:
        return WRIST_MEETING
    return None


def _points(kind: int, h: np.ndarray, o: np.ndarray) -> np.ndarray:
    if kind == WRIST_MEETING:
        o = o.copy()
        o[:2] = _meeting(h[:2], o[:2])[0]
    return o


def _numeric(chain: Chain, seeds: int) -> IkModel:
    from scipy.stats import qmc

    if chain.size < 6:
        raise RobotError(
            f"the arm has {chain.size} joints; at least 6 are needed to reach a full tool pose"
        )
    lower = np.where(np.isfinite(chain.lower), chain.lower, -np.pi)
    upper = np.where(np.isfinite(chain.upper), chain.upper, np.pi)
    unit = qmc.Halton(chain.size, scramble=False).random(seeds + 1)[1:]
    samples = np.ascontiguousarray(lower + unit * (upper - lower))
    every = np.arange(chain.size)
    empty, point = np.zeros((len(samples), chain.size, 3)), np.zeros((len(samples), 3))
    return IkModel(
        NUMERIC, every, samples, empty, empty, point, np.zeros((len(samples), 3, 3)), point
    )


@njit(cache=True, nogil=True)
def _first_three_wrist(kind, h, o, c0, c, out):
    """Joints 1 to 3 that bring the wrist centre c0 to c; out (8, 6), returns the count."""
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


@njit(cache=True, nogil=True)
def _spherical(kind, h, o, c0, R06, c, out):
    """All branches of an arm with a spherical wrist; returns the count."""
    count = _first_three_wrist(kind, h, o, c0, c, out)
    h1, h2, h3 = row(h, 0), row(h, 1), row(h, 2)
    h4, h5, h6 = row(h, 3), row(h, 4), row(h, 5)
    total = count
    for i in range(count):
        q1, q2, q3 = out[i, 0], out[i, 1], out[i, 2]
        x6 = rot(h3, -q3, rot(h2, -q2, rot(h1, -q1, mul(R06, h6))))
        x5 = rot(h3, -q3, rot(h2, -q2, rot(h1, -q1, mul(R06, h5))))
        n5, a5, b5 = sp4(h4, h6, h5, dot(h4, x6))
        if n5 == 0:
            out[i, 4] = np.nan
            continue
        for j in range(2):
            q5 = a5 if j == 0 else b5
            k = i if j == 0 else total
            out[k, 0], out[k, 1], out[k, 2], out[k, 4] = q1, q2, q3, q5
            out[k, 3] = sp1(rot(h5, q5, h6), x6, h4)
            # After q4, not beside it: when axes 4 and 6 align only their sum is told.
            out[k, 5] = sp1(h5, rot(h5, -q5, rot(h4, -out[k, 3], x5)), h6)
        total += 1
    return total


@njit(cache=True, nogil=True)
def _free_turn(h1, h2, upper, lower, tip, foot, j, turned, sign):
    """A value of joint 6 that puts joint 4 in the middle of where the arm can have it.

    Args:
        h1, h2: Axes 1 and 2.
        upper, lower, tip: Offsets from joint 2 to 3, 3 to 4, and 4 to the wrist, at zero.
        foot: The wrist as seen from joint 2.
        j: Which of the two values, 0 or 1.
        turned: Where h1 has been turned to about h2 when joint 6 is at zero.
        sign: Positive where axis 6 points along axis 2.
    """
    a, b = _across(upper, h2), _across(lower, h2)
    c, d = _across(tip, h2), _across(foot, h2)
    reach = 0.5 * (max(abs(a - b), abs(c - d)) + min(a + b, c + d))
    along = dot(h2, sub(tip, foot))
    n, one, other = sp3(tip, foot, h2, np.sqrt(reach * reach + along * along))
    if n == 0:
        return 0.0
    turn = sp1(h1, turned, h2) - (one if j == 0 else other)
    return turn if sign > 0 else -turn


@njit(cache=True, nogil=True)
def _across(v, axis):
    """Length of the part of v that is perpendicular to a unit axis."""
    part = dot(v, axis)
    return np.sqrt(max(0.0, dot(v, v) - part * part))


@njit(cache=True, nogil=True)
def _three_parallel(h, o, c0, R06, c, out):
    """All branches of an arm whose axes 2, 3 and 4 are parallel; returns the count."""
    h1, h2, h3, h4, h5, h6 = (
        row(h, 0),
        row(h, 1),
        row(h, 2),
        row(h, 3),
        row(h, 4),
        row(h, 5),
    )
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
                # Axis 6 is parallel to the three, and any q6 will do that keeps joint 4 in reach.
                turned = rot(h1, -q1, mul(R06, rot(h5, -q5, h1)))
                q6 = _free_turn(h1, h2, upper, lower, tip, foot, j, turned, dot(x2, h6))
            else:
                q6 = sp1(x2, mul_t(R06, rot(h1, q1, h2)), neg(h6))
            turned = rot(h1, -q1, mul(R06, rot(h6, -q6, rot(h5, -q5, h1))))
            theta = sp1(h1, turned, h2)
            t = sub(foot, rot(h2, theta, tip))
            along = dot(h2, t)
            flat = add(upper, lower)
            # Components along the axes are carried unchanged; the planar 2R problem is the rest.
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


@njit(cache=True, nogil=True)
def _solve_spd(A, b):
    """Solve A x = b in place for a small positive definite A (Cholesky)."""
    n = len(b)
    for i in range(n):
        for j in range(i + 1):
            s = A[i, j]
            for k in range(j):
                s -= A[i, k] * A[j, k]
            A[i, j] = np.sqrt(max(s, 1e-18)) if i == j else s / A[j, j]
    for i in range(n):
        for k in range(i):
            b[i] -= A[i, k] * b[k]
        b[i] /= A[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            b[i] -= A[k, i] * b[k]
        b[i] /= A[i, i]


@njit(cache=True, nogil=True)
def newton(q, active, chain, R_target, p_target, steps, damping, work):
    """Move the active joints of q until the tool stands at the target.

    Args:
        q: Configuration (n,), changed in place.
        active: Indices of the joints that may move.
        chain: (h, d, prismatic, tool_offset, tool_rotation).
        R_target, p_target: Target pose in the base frame.
        steps: Maximum number of steps [-].
        damping: Levenberg damping [-]; tiny near a solution, larger from far away.
        work: (R (n + 1, 3, 3), p (n + 1, 3)) scratch.

    Returns:
        Squared residual, position [m] and rotation [rad] together.
    """
    h, d, prismatic, tool_offset, tool_rotation = chain
    R, p = work
    n, m = len(q), len(active)
    J, A, e = np.empty((6, m)), np.empty((6, 6)), np.empty(6)
    residual = np.inf
    for step in range(steps + 1):
        stand_at_origin(R, p)
        forward(q, h, d, prismatic, R, p)
        tip = mul(R[n], (tool_offset[0], tool_offset[1], tool_offset[2]))
        tool = (p[n, 0] + tip[0], p[n, 1] + tip[1], p[n, 2] + tip[2])
        for k in range(3):
            e[k] = p_target[k] - tool[k]
        _rotation_error(R[n], tool_rotation, R_target, e)
        residual = 0.0
        for k in range(6):
            residual += e[k] * e[k]
        if residual < 1e-16 or step == steps:
            break
        for a in range(m):
            j = active[a]
            axis = mul(R[j], (h[j, 0], h[j, 1], h[j, 2]))
            if prismatic[j]:
                for k in range(3):
                    J[k, a] = axis[k]
                    J[k + 3, a] = 0.0
            else:
                rx, ry, rz = tool[0] - p[j + 1, 0], tool[1] - p[j + 1, 1], tool[2] - p[j + 1, 2]
                J[0, a] = axis[1] * rz - axis[2] * ry
                J[1, a] = axis[2] * rx - axis[0] * rz
                J[2, a] = axis[0] * ry - axis[1] * rx
                for k in range(3):
                    J[k + 3, a] = axis[k]
        for i in range(6):
            for k in range(i + 1):
                s = 0.0
                for a in range(m):
                    s += J[i, a] * J[k, a]
                A[i, k] = s
            A[i, i] += damping * (1e-6 + residual)
        _solve_spd(A, e)
        for a in range(m):
            s = 0.0
            for k in range(6):
                s += J[k, a] * e[k]
            q[active[a]] += min(0.5, max(-0.5, s))
    return residual


@njit(cache=True, nogil=True)
def _rotation_error(R_last, tool_rotation, R_target, e):
    """Rotation vector from the tool's orientation to the target's, into e[3:]."""
    x, y, z, trace = 0.0, 0.0, 0.0, 0.0
    for i in range(3):
        current = mul(R_last, (tool_rotation[0, i], tool_rotation[1, i], tool_rotation[2, i]))
        target = (R_target[0, i], R_target[1, i], R_target[2, i])
        x += current[1] * target[2] - current[2] * target[1]
        y += current[2] * target[0] - current[0] * target[2]
        z += current[0] * target[1] - current[1] * target[0]
        trace += dot(current, target)
    length = np.sqrt(x * x + y * y + z * z)
    angle = np.arctan2(0.5 * length, 0.5 * (trace - 1.0))
    if length < 1e-12:
        # Aligned, or half a turn off: then any axis is as good.
        e[3], e[4], e[5] = (angle, 0.0, 0.0) if angle > 1.0 else (0.0, 0.0, 0.0)
        return
    e[3], e[4], e[5] = angle * x / length, angle * y / length, angle * z / length


@njit(cache=True, nogil=True)
def into_limits(q, lower, upper, prismatic):
    """Shift revolute joints by full turns into their limits; False where that cannot be."""
    turn = 2.0 * np.pi
    for i in range(len(q)):
        if prismatic[i]:
            if not (lower[i] - 1e-9 <= q[i] <= upper[i] + 1e-9):
                return False
        elif np.isinf(upper[i]):
            q[i] -= turn * np.round(q[i] / turn)
        elif q[i] < lower[i] - 1e-9 or q[i] > upper[i] + 1e-9 or abs(q[i]) > np.pi:
            v = q[i] - turn * np.round(q[i] / turn)
            if v < lower[i] - 1e-9:
                v += turn
            elif v > upper[i] + 1e-9:
                v -= turn
            if not (lower[i] - 1e-9 <= v <= upper[i] + 1e-9):
                return False
            q[i] = min(max(v, lower[i]), upper[i])
    return True


@njit(cache=True, nogil=True)
def solve_sample(s, R_target, p_target, chain, limits, ik, out, scratch):
    """All configurations within limits at one sample of the locked joints (or from one seed).

    Args:
        s: Index of the sample.
        R_target, p_target: Tool pose in the base frame.
        chain, limits, ik: `arrays(...)` of the arm.
        out: (max, n) to be filled.
        scratch: `ik_scratch(n)`.

    Returns:
        Number of configurations written.
    """
    kind, active, samples, h, o, wrist, R_tool, p_tool = ik
    branches, R06, R, p = scratch
    lower, upper = limits
    found = 1
    if kind != NUMERIC:
        for i in range(3):
            for j in range(3):
                R06[i, j] = (
                    R_target[i, 0] * R_tool[s, j, 0]
                    + R_target[i, 1] * R_tool[s, j, 1]
                    + R_target[i, 2] * R_tool[s, j, 2]
                )
        c0 = row(wrist, s)
        shift = mul(R06, sub(c0, row(p_tool, s)))
        c = (p_target[0] + shift[0], p_target[1] + shift[1], p_target[2] + shift[2])
        if kind == THREE_PARALLEL:
            found = _three_parallel(h[s], o[s], c0, R06, c, branches)
        else:
            found = _spherical(kind, h[s], o[s], c0, R06, c, branches)
    # From a seed Newton has far to go; after a closed form it only removes rounding.
    steps, damping = (30, 1.0) if kind == NUMERIC else (8, 1e-6)
    count = 0
    for b in range(found):
        for i in range(samples.shape[1]):
            out[count, i] = samples[s, i]
        if kind != NUMERIC:
            if np.isnan(branches[b, 4]):
                continue
            for a in range(6):
                out[count, active[a]] = branches[b, a]
        residual = newton(out[count], active, chain, R_target, p_target, steps, damping, (R, p))
        if residual < _TIGHT and into_limits(out[count], lower, upper, chain[2]):
            count += 1
    return count


@njit(cache=True, nogil=True)
def ik_scratch(n):
    """Scratch arrays for `solve_sample`."""
    return (
        np.empty((MAX_BRANCHES, 6)),
        np.empty((3, 3)),
        np.empty((n + 1, 3, 3)),
        np.empty((n + 1, 3)),
    )


@njit(cache=True, nogil=True)
def _solve_all(poses, chain, limits, ik, limit):
    n = ik[2].shape[1]
    scratch = ik_scratch(n)
    out = np.full((len(poses), limit, n), np.nan)
    counts = np.zeros(len(poses), np.int64)
    for i in range(len(poses)):
        R, p = poses[i, :3, :3], poses[i, :3, 3]
        for s in range(len(ik[2])):
            counts[i] += solve_sample(s, R, p, chain, limits, ik, out[i, counts[i] :], scratch)
        # What was tried there and refused.
        out[i, counts[i] :] = np.nan
    return out, counts


def chain_arrays(chain: Chain) -> tuple[np.ndarray, ...]:
    """The chain as the kernels take it."""
    return chain.h, chain.d, chain.prismatic, chain.tool_offset, chain.tool_rotation


def ik_arrays(ik: IkModel) -> tuple[int | np.ndarray, ...]:
    """The IK model as the kernels take it."""
    return ik.kind, ik.active, ik.samples, ik.h, ik.o, ik.wrist, ik.R_tool, ik.p_tool


def solve_ik(
    chain: Chain, ik: IkModel, Ts_base_tool: Float[np.ndarray, "m 4 4"]
) -> tuple[Float[np.ndarray, "m b n"], Int[np.ndarray, " m"]]:
    """Solve a batch of tool poses.

    Returns:
        Configurations, NaN beyond each pose's count, and the counts.
    """
    return _solve_all(
        np.ascontiguousarray(Ts_base_tool, float),
        chain_arrays(chain),
        (chain.lower, chain.upper),
        ik_arrays(ik),
        ik.max_solutions,
    )
