"""Find base poses near given ones from which an arm reaches several tool poses exactly.

For an arm with few degrees of freedom, such base poses form a curve or a surface, which samples
miss. Levenberg-Marquardt steps move the base and the arm's states together until all tool poses
are reached. Source: Nocedal and Wright, Numerical Optimization (2006), chapter 10.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from momapos.core.compiled import B1, F2, F3, entry, kernel
from momapos.core.geometry import wrap_angle

from .chain import ArmArrays, Chain, forward, stand_at_origin
from .closed_forms import mul
from .ik import (
    SEED_LENGTH,
    IkModel,
    arm_arrays,
    factor_spd,
    ik_scratch,
    insert_nearest,
    jacobian,
    nearest_seeds,
    rotation_error,
    solve_spd,
)

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

MAX_STEPS = 40
"""Largest number of steps from a base pose [-]."""
FIXED_BASE_STEPS = 5
"""Number of first steps in which only the arm moves [-]."""
HALVING_STEPS = 5
"""The fit stops if the residual does not halve within this number of steps [-]."""
MAX_RESIDUAL = 1e-12
"""Largest squared residual over all tool poses of a solution [m^2 + rad^2]."""
MAX_BASE_STEP, MAX_TURN_STEP = 0.15, 0.5
"""Largest step of the base [m] and of its yaw or a joint [rad]."""


@kernel
def _target(base, T, R, p):
    """Write a tool pose in the frame of a base to R and p."""
    c, s = np.cos(base[2]), np.sin(base[2])
    x, y = T[0, 3] - base[0], T[1, 3] - base[1]
    p[0], p[1], p[2] = c * x + s * y, c * y - s * x, T[2, 3]
    for j in range(3):
        R[0, j] = c * T[0, j] + s * T[1, j]
        R[1, j] = c * T[1, j] - s * T[0, j]
        R[2, j] = T[2, j]


@kernel
def _equations(base, q, poses, arm, moves, scratch):
    """Fill the normal equations of all tool poses; return the squared residual.

    The states of two poses have no equation in common, so that the equations consist of a block
    of each pose, a block of the base, and the blocks between these.

    Args:
        base: x [m], y [m], yaw [rad].
        q: A state for each of the tool poses (w, n).
        poses: (w, 4, 4).
        arm: `ArmArrays`.
        moves: Whether the base moves, too.
        scratch: `_fit_scratch(arm, w)`.
    """
    newton, R_to, p_to, A, B, S, g = scratch
    R, p, J, _, e, column = newton
    chain = arm.chain
    n, last, residual = q.shape[1], len(chain.slides), 0.0
    offset = (chain.tool_offset[0], chain.tool_offset[1], chain.tool_offset[2])
    for a in range(3):
        g[a] = 0.0
        for b in range(3):
            S[a, b] = 0.0
    stand_at_origin(R, p)
    c, s = np.cos(base[2]), np.sin(base[2])
    for m in range(len(poses)):
        _target(base, poses[m], R_to, p_to)
        forward(q[m], chain, R, p)
        tip = mul(R[last], offset)
        tool = (p[last, 0] + tip[0], p[last, 1] + tip[1], p[last, 2] + tip[2])
        for k in range(3):
            e[k] = p_to[k] - tool[k]
        rotation_error(R[last], chain.tool_rotation, R_to, e)
        jacobian(chain, R, p, tool, column, n, J)
        for r in range(6):
            residual += e[r] * e[r]
        for a in range(n):
            for b in range(a + 1):
                A[m, a, b] = 0.0
                for r in range(6):
                    A[m, a, b] += J[r, a] * J[r, b]
            B[m, a, 3] = 0.0
            for r in range(6):
                B[m, a, 3] += J[r, a] * e[r]
            for k in range(3):
                B[m, a, k] = 0.0
            if moves:
                B[m, a, 0] = c * J[0, a] - s * J[1, a]
                B[m, a, 1] = s * J[0, a] + c * J[1, a]
                B[m, a, 2] = tool[0] * J[1, a] - tool[1] * J[0, a] + J[5, a]
        if moves:
            x, y = s * tool[0] + c * tool[1], c * tool[0] - s * tool[1]
            S[0, 0] += 1.0
            S[1, 1] += 1.0
            S[2, 2] += tool[0] * tool[0] + tool[1] * tool[1] + 1.0
            S[2, 0] -= x
            S[2, 1] += y
            g[0] += c * e[0] - s * e[1]
            g[1] += s * e[0] + c * e[1]
            g[2] += tool[0] * e[1] - tool[1] * e[0] + e[5]
    return residual


@kernel
def _solve_step(damping, scratch):
    """Solve the damped normal equations; the base's step is then in g, those of the states in B.

    The states are eliminated (Schur complement), and follow from the base's step.
    """
    _, _, _, A, B, S, g = scratch
    for m in range(len(A)):
        n = A.shape[1]
        for i in range(n):
            A[m, i, i] += damping
        factor_spd(A[m])
        for i in range(n):
            for a in range(4):
                for k in range(i):
                    B[m, i, a] -= A[m, i, k] * B[m, k, a]
                B[m, i, a] /= A[m, i, i]
            for a in range(3):
                g[a] -= B[m, i, a] * B[m, i, 3]
                for b in range(a + 1):
                    S[a, b] -= B[m, i, a] * B[m, i, b]
    for a in range(3):
        S[a, a] += damping
    solve_spd(S, g)
    for m in range(len(A)):
        for i in range(A.shape[1] - 1, -1, -1):
            for a in range(3):
                B[m, i, 3] -= B[m, i, a] * g[a]
            for k in range(i + 1, A.shape[1]):
                B[m, i, 3] -= A[m, k, i] * B[m, k, 3]
            B[m, i, 3] /= A[m, i, i]


@kernel
def _meet(base, q, poses, arm, scratch):
    """Move a base pose and arm states in place to reach all poses; return whether they are reached.

    The base does not move in the first steps, so that it moves no farther than necessary.
    """
    B, g, before = scratch[4], scratch[6], np.inf
    lower, upper = arm.limits.lower, arm.limits.upper
    for step in range(MAX_STEPS + 1):
        residual = _equations(base, q, poses, arm, step >= FIXED_BASE_STEPS, scratch)
        if residual < MAX_RESIDUAL:
            return True
        if step == MAX_STEPS or not np.isfinite(residual):
            return False
        if step >= FIXED_BASE_STEPS and (step - FIXED_BASE_STEPS) % HALVING_STEPS == 0:
            if residual > 0.5 * before:
                return False
            before = residual
        _solve_step(1e-9 + 0.01 * min(residual, 1.0), scratch)
        for k in range(3):
            most = MAX_BASE_STEP if k < 2 else MAX_TURN_STEP
            base[k] += min(most, max(-most, g[k]))
        for m in range(len(q)):
            for k in range(q.shape[1]):
                v = q[m, k] + min(MAX_TURN_STEP, max(-MAX_TURN_STEP, B[m, k, 3]))
                q[m, k] = min(max(v, lower[k]), upper[k])
    return False


@kernel
def _fit_scratch(arm, w):
    """Allocate the scratch memory of `_meet` for w tool poses."""
    n, R_to, p_to = len(arm.limits.lower), np.empty((3, 3)), np.empty(3)
    newton = ik_scratch(arm).newton
    for k in range(n):
        newton.column[k] = k
    A, B, S, g = np.empty((w, n, n)), np.empty((w, n, 4)), np.empty((3, 3)), np.empty(3)
    return newton, R_to, p_to, A, B, S, g


@entry
def _fit(bases: F2, poses: F3, tries: int, arm: ArmArrays, moved: F2, met: B1) -> None:
    """Fill `moved` (k, 3) and `met` (k,), see `fit_bases`."""
    base, q = np.empty(3), np.empty((len(poses), len(arm.limits.lower)))
    scratch, seeds = _fit_scratch(arm, len(poses)), arm.ik.seeds
    R_to, p_to = scratch[1], scratch[2]
    tries = min(tries, len(seeds))
    order, distance = np.zeros(tries, np.int64), np.empty(tries)
    for i in range(len(bases)):
        met[i], nearest = False, np.inf
        _target(bases[i], poses[0], R_to, p_to)
        nearest_seeds(R_to, p_to, arm.ik, order, distance)
        for t in range(tries):
            base[:] = bases[i]
            q[:] = seeds[order[t]]
            if not _meet(base, q, poses, arm, scratch):
                continue
            away = 0.0
            for k in range(3):
                away += (base[k] - bases[i, k]) ** 2
            if away < nearest:
                met[i], nearest = True, away
                moved[i] = base


@kernel
def _nearest_upright(T, ik, order, distance):
    """Fill `order` with the seeds whose tool is nearest to a pose in height and tilt."""
    most, poses = len(order), ik.seed_poses
    distance[:] = np.inf
    order[:] = 0
    for i in range(len(poses)):
        s = (poses[i, 2] - T[2, 3] / SEED_LENGTH) ** 2
        if s >= distance[most - 1]:
            continue
        s += (poses[i, 5] - T[2, 0]) ** 2 + (poses[i, 8] - T[2, 1]) ** 2
        if s < distance[most - 1]:
            insert_nearest(i, s, order, distance)


@kernel
def _stand(base, T, seed_pose):
    """Write the base pose from which a seed's tool is nearest to a pose, but for its height."""
    sine, cosine = 0.0, 0.0
    for axis in range(2):
        x, y = seed_pose[3 + 3 * axis], seed_pose[4 + 3 * axis]
        sine += x * T[1, axis] - y * T[0, axis]
        cosine += x * T[0, axis] + y * T[1, axis]
    base[2] = np.arctan2(sine, cosine)
    c, s = np.cos(base[2]), np.sin(base[2])
    x, y = SEED_LENGTH * seed_pose[0], SEED_LENGTH * seed_pose[1]
    base[0] = T[0, 3] - c * x + s * y
    base[1] = T[1, 3] - s * x - c * y


@entry
def _meets_somewhere(poses: F3, count: int, arm: ArmArrays) -> bool:
    """See `meets_somewhere`."""
    base, q = np.empty(3), np.empty((len(poses), len(arm.limits.lower)))
    scratch, ik = _fit_scratch(arm, len(poses)), arm.ik
    count = min(count, len(ik.seeds))
    order, distance = np.zeros(count, np.int64), np.empty(count)
    for m in range(len(poses)):
        _nearest_upright(poses[m], ik, order, distance)
        for t in range(count):
            _stand(base, poses[m], ik.seed_poses[order[t]])
            q[:] = ik.seeds[order[t]]
            if _meet(base, q, poses, arm, scratch):
                return True
    return False


def fit_bases(
    chain: Chain,
    ik: IkModel,
    bases: Float[np.ndarray, "k 3"],
    Ts_world_tool: Float[np.ndarray, "w 4 4"],
    *,
    tries: int = 1,
) -> tuple[Float[np.ndarray, "k 3"], Bool[np.ndarray, " k"]]:
    """Find base poses near given ones from which an arm reaches all of some tool poses.

    Args:
        chain, ik: The arm.
        bases: x, y [m], yaw [rad] to start from.
        Ts_world_tool: The tool poses.
        tries: Number of arm states to start from; the nearest resulting base pose counts [-].

    Returns:
        The new base poses, and whether all tool poses are reached; if not, the base pose is as
        given.
    """
    moved, met = np.array(bases, float), np.zeros(len(bases), bool)
    poses = np.array(Ts_world_tool, float)  # writable, as the entry needs it
    _fit(moved.copy(), poses, tries, arm_arrays(chain, ik), moved, met)
    moved[:, 2] = wrap_angle(moved[:, 2])
    return moved, met


def meets_somewhere(
    chain: Chain, ik: IkModel, Ts_world_tool: Float[np.ndarray, "w 4 4"], count: int
) -> bool:
    """Return whether an arm reaches all of some tool poses from a promising base pose.

    From such a base pose an arm nearly reaches one of the tool poses: it belongs to a seed whose
    tool has nearly the height and the tilt of the tool pose; place and turn about the vertical are
    those of the base.

    Args:
        chain, ik: The arm.
        Ts_world_tool: The tool poses.
        count: Number of base poses for each tool pose, at most that of the seeds [-].
    """
    poses = np.array(Ts_world_tool, float)  # writable, as the entry needs it
    return bool(_meets_somewhere(poses, count, arm_arrays(chain, ik)))
