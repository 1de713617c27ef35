"""Find base poses near given ones from which an arm reaches several tool poses exactly.

For an arm with few degrees of freedom, such base poses form a curve or a surface, which samples
miss. Levenberg-Marquardt steps move the base and the arm's states together until all tool poses
are reached. Source: Nocedal and Wright, Numerical Optimization (2006), chapter 10.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from momapos.core.compiled import B1, F2, F3, entry, kernel
from momapos.core.geometry import rotation, wrap_angle

from .chain import ArmArrays, Chain, forward, stand_at_origin
from .closed_forms import mul
from .ik import (
    SEED_LENGTH,
    IkModel,
    arm_arrays,
    ik_scratch,
    jacobian,
    nearest_seeds,
    pose_features,
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

    Args:
        base: x [m], y [m], yaw [rad].
        q: A state for each of the tool poses (w, n).
        poses: (w, 4, 4).
        arm: `ArmArrays`.
        moves: Whether the base moves, too.
        scratch: `_scratch(arm, w)`.
    """
    newton, R_to, p_to, A, g, full = scratch
    R, p, J, _, e, column = newton
    chain = arm.chain
    n, last, size, residual = q.shape[1], len(chain.slides), len(g), 0.0
    offset = (chain.tool_offset[0], chain.tool_offset[1], chain.tool_offset[2])
    for a in range(size):
        g[a] = 0.0
        for b in range(size):
            A[a, b] = 0.0
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
            for a in range(size):
                full[r, a] = 0.0
            for k in range(n):
                full[r, 3 + m * n + k] = J[r, k]
        if moves:
            full[0, 0], full[1, 0] = c, -s
            full[0, 1], full[1, 1] = s, c
            full[0, 2], full[1, 2], full[5, 2] = -tool[1], tool[0], 1.0
        for r in range(6):
            for a in range(size):
                if full[r, a] == 0.0:
                    continue
                g[a] += full[r, a] * e[r]
                for b in range(a + 1):
                    A[a, b] += full[r, a] * full[r, b]
    return residual


@kernel
def _meet(base, q, poses, arm, scratch):
    """Move a base pose and arm states in place to reach all poses; return whether they are reached.

    The base does not move in the first steps, so that it moves no farther than necessary.
    """
    A, g, before = scratch[3], scratch[4], np.inf
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
        for a in range(len(g)):
            A[a, a] += 1e-9 + 0.01 * min(residual, 1.0)
        solve_spd(A, g)
        for k in range(3):
            most = MAX_BASE_STEP if k < 2 else MAX_TURN_STEP
            base[k] += min(most, max(-most, g[k]))
        for m in range(len(q)):
            for k in range(q.shape[1]):
                v = q[m, k] + min(MAX_TURN_STEP, max(-MAX_TURN_STEP, g[3 + m * q.shape[1] + k]))
                q[m, k] = min(max(v, lower[k]), upper[k])
    return False


@entry
def _fit(bases: F2, poses: F3, tries: int, arm: ArmArrays, moved: F2, met: B1) -> None:
    """Fill `moved` (k, 3) and `met` (k,), see `fit_bases`."""
    n, w = len(arm.limits.lower), len(poses)
    ik, size = ik_scratch(arm), 3 + w * n
    R_to, p_to, base, q = np.empty((3, 3)), np.empty(3), np.empty(3), np.empty((w, n))
    A, g, full = np.empty((size, size)), np.empty(size), np.empty((6, size))
    scratch = (ik.newton, R_to, p_to, A, g, full)
    for k in range(n):
        ik.newton.column[k] = k
    for i in range(len(bases)):
        met[i], nearest = False, np.inf
        _target(bases[i], poses[0], R_to, p_to)
        nearest_seeds(R_to, p_to, arm.ik, ik.order, ik.distance)
        for t in range(min(tries, len(ik.order))):
            for k in range(3):
                base[k] = bases[i, k]
            # All states start at the same seed.
            for m in range(w):
                for k in range(n):
                    q[m, k] = arm.ik.seeds[ik.order[t], k]
            if not _meet(base, q, poses, arm, scratch):
                continue
            away = 0.0
            for k in range(3):
                away += (base[k] - bases[i, k]) ** 2
            if away < nearest:
                met[i], nearest = True, away
                for k in range(3):
                    moved[i, k] = base[k]


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


def promising_bases(
    ik: IkModel, T_world_tool: Float[np.ndarray, "4 4"], count: int
) -> Float[np.ndarray, "k 3"]:
    """Return base poses from which an arm nearly reaches a tool pose.

    These belong to the seeds whose tool has nearly the height and the tilt of the tool pose; place
    and turn about the vertical are those of the base.

    Args:
        ik: The arm.
        T_world_tool: The tool pose.
        count: Number of base poses, at most that of the seeds [-].
    """
    wanted, seeds = pose_features(T_world_tool[None])[0].reshape(3, 3), ik.seed_poses
    off = ((seeds.reshape(-1, 3, 3)[..., 2] - wanted[:, 2]) ** 2).sum(1)
    nearest = np.argpartition(off, min(count, len(off)) - 1)[:count]
    near = seeds[np.sort(nearest)].reshape(-1, 3, 3)
    # The turn that brings the first two axes of the tool nearest to the wanted ones.
    x, y = near[:, 1:, 0], near[:, 1:, 1]
    sine = (x * wanted[1:, 1] - y * wanted[1:, 0]).sum(1)
    cosine = (x * wanted[1:, 0] + y * wanted[1:, 1]).sum(1)
    yaw = np.arctan2(sine, cosine)
    tool = np.einsum("kij,kj->ki", rotation(yaw), near[:, 0, :2])
    return np.column_stack([(wanted[0, :2] - tool) * SEED_LENGTH, yaw])
