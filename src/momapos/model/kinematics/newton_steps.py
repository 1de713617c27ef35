"""Damped Newton steps, to refine closed-form solutions or to solve from seeds."""

from __future__ import annotations

import numpy as np

from momapos.core.compiled import kernel

from .chain import forward, stand_at_origin
from .kernel_records import NewtonScratch
from .subproblems import dot, mul


@kernel
def solve_spd(A, b):
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


@kernel
def newton(q, active, chain, limits, R_target, p_target, rule, scratch):
    """Move the active joints of q until the tool is at the target.

    Args:
        q: Configuration (n,), changed in place.
        active: The degrees of freedom that may move.
        chain: `ChainArrays`.
        limits: `JointLimits`, for `rule.within`.
        R_target, p_target: Target pose in the base frame.
        rule: `NewtonRule`.
        scratch: `newton_scratch(chain, n)`.

    Returns:
        Squared residual of position [m] and rotation [rad].
    """
    last = len(chain.slides)
    tool_offset, tool_rotation = chain.tool_offset, chain.tool_rotation
    R, p, J, A, e, column = scratch
    m = len(active)
    for i in range(len(q)):
        column[i] = -1
    for a in range(m):
        column[active[a]] = a
    residual = np.inf
    for step in range(rule.steps + 1):
        stand_at_origin(R, p)
        forward(q, chain, R, p)
        tip = mul(R[last], (tool_offset[0], tool_offset[1], tool_offset[2]))
        tool = (p[last, 0] + tip[0], p[last, 1] + tip[1], p[last, 2] + tip[2])
        for k in range(3):
            e[k] = p_target[k] - tool[k]
        rotation_error(R[last], tool_rotation, R_target, e)
        residual = 0.0
        for k in range(6):
            residual += e[k] * e[k]
        if residual < rule.enough or step == rule.steps:
            break
        jacobian(chain, R, p, tool, column, m, J)
        damping = rule.damping * (1e-6 + residual)
        step_toward(q, active, limits, J, A, e, damping, rule.within)
    return residual


@kernel
def step_toward(q, active, limits, J, A, e, damping, within):
    """Take the damped least-norm step J^T (J J^T + damping)^-1 e, at most 0.5 rad per joint.

    Args:
        q: Configuration (n,), changed in place.
        active: The degrees of freedom that move (m,).
        limits: `JointLimits`.
        J: (6, at least m), one column each.
        A: Scratch memory (6, 6).
        e: Error (6,), overwritten.
        damping: Added to the diagonal of J J^T.
        within: Whether to stay within the limits.
    """
    m = len(active)
    for i in range(6):
        for k in range(i + 1):
            s = 0.0
            for a in range(m):
                s += J[i, a] * J[k, a]
            A[i, k] = s
        A[i, i] += damping
    solve_spd(A, e)
    for a in range(m):
        s = 0.0
        for k in range(6):
            s += J[k, a] * e[k]
        j = active[a]
        q[j] += min(0.5, max(-0.5, s))
        if within:
            q[j] = min(max(q[j], limits.lower[j]), limits.upper[j])


@kernel
def jacobian(chain, R, p, tool, column, m, J):
    """Fill the Jacobian of a point on the last segment and of its orientation.

    Args:
        chain: `ChainArrays`.
        R, p: As from `forward`.
        tool: The point, in the same frame.
        column: Column of each degree of freedom, or -1 (n,).
        m: Number of columns.
        J: Output (6, at least m): velocity, then angular velocity.
    """
    h = chain.h
    for a in range(m):
        for k in range(6):
            J[k, a] = 0.0
    for j in range(len(chain.slides)):
        a = column[chain.dof[j]]
        if a < 0:
            continue
        axis, ratio = mul(R[j], (h[j, 0], h[j, 1], h[j, 2])), chain.ratio[j]
        if chain.slides[j]:
            for k in range(3):
                J[k, a] += ratio * axis[k]
        else:
            rx, ry, rz = tool[0] - p[j + 1, 0], tool[1] - p[j + 1, 1], tool[2] - p[j + 1, 2]
            J[0, a] += ratio * (axis[1] * rz - axis[2] * ry)
            J[1, a] += ratio * (axis[2] * rx - axis[0] * rz)
            J[2, a] += ratio * (axis[0] * ry - axis[1] * rx)
            for k in range(3):
                J[k + 3, a] += ratio * axis[k]


@kernel
def newton_scratch(chain, n):
    """Allocate the scratch memory of `newton` for n degrees of freedom."""
    last = len(chain.slides)
    return NewtonScratch(
        np.empty((last + 1, 3, 3)),
        np.empty((last + 1, 3)),
        np.empty((6, n)),
        np.empty((6, 6)),
        np.empty(6),
        np.empty(n, np.int64),
    )


@kernel
def rotation_error(R_last, tool_rotation, R_target, e):
    """Write the rotation vector from the tool's orientation to the target's to e[3:]."""
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
        # Aligned, or half a turn apart, where any axis works.
        e[3], e[4], e[5] = (angle, 0.0, 0.0) if angle > 1.0 else (0.0, 0.0, 0.0)
        return
    e[3], e[4], e[5] = angle * x / length, angle * y / length, angle * z / length
