"""Inverse kinematics: all branches in closed form if the arm allows it, otherwise Newton steps.

Newton steps also remove the remaining error of a closed form (published URDFs round pi/2). For arms
without closed form, and if no sample of locked joints has a solution, Newton starts at the seeds
with the nearest tool poses; see `ik_model`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from momapos.core import owner_cache
from momapos.core.compiled import F3, entry, kernel

from .chain import Chain, chain_arrays, chain_limits
from .closed_forms import (
    MAX_BRANCHES,
    NUMERIC,
    SLIDES,
    THREE_PARALLEL,
    slides_and_wrist,
    spherical,
    three_parallel,
)
from .ik_model import SEED_LENGTH, IkModel, build_ik, ik_arrays
from .kernel_records import ArmArrays, IkScratch, NewtonRule
from .newton_steps import newton, newton_scratch
from .subproblems import mul, mul_t, row, sub

if TYPE_CHECKING:
    from jaxtyping import Float, Int

__all__ = ["IkModel", "build_ik", "ik_arrays", "solve_ik"]

_MAX_ROUNDING = 0.05
"""A joint of a closed form may exceed its limits by this before the Newton steps [rad]."""
EXACT, COARSE = 1e-16, 1e-8
"""Squared residuals at which Newton stops: exact, or to 0.1 mm for maps and graphs."""
_MAX_RESIDUAL = 1e-12
"""Largest squared residual of an exact solution [m^2 + rad^2]."""
MAX_POSES = 64
"""Poses solved between two looks at the clock; with a base that slides they take 0.1 s [-]."""
_MIN_DISTANCE = 1e-2
"""Solutions that are nearer in every joint count as equal [rad] or [m]."""


@kernel
def into_limits(q, lower, upper, prismatic):
    """Shift revolute joints by full turns into their limits; return whether that is possible."""
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


@kernel
def _exceeds_limits(branch, active, lower, upper):
    """Return whether a joint of a closed form is too far outside its limits for Newton."""
    turn = 2.0 * np.pi
    for a in range(len(active)):
        low, high = lower[active[a]], upper[active[a]]
        if high - low < turn:
            off = branch[a] - 0.5 * (low + high)
            off -= turn * np.floor(off / turn + 0.5)
            if abs(off) > 0.5 * (high - low) + _MAX_ROUNDING:
                return True
    return False


@kernel
def begin_pose(scratch):
    """Reset the solutions; call this before the first `solve_sample` of each pose."""
    scratch.state[0] = 0


@kernel
def sample_count(ik):
    """Return the number of samples for `solve_sample`: of the locked joints, then of the seeds."""
    return len(ik.samples) + ik.tries


@kernel
def solve_sample(s, R_target, p_target, arm, enough, out, scratch):
    """Find all configurations within limits at one sample of the locked joints, or from one seed.

    For an arm with a closed form, seeds are skipped once a solution for the pose is known.

    Args:
        s: Index of the sample, below `sample_count`; call with the samples of a pose in order.
        R_target, p_target: Tool pose in the base frame.
        arm: `ArmArrays`.
        enough: Sufficient squared residual, `EXACT` or `COARSE` [m^2 + rad^2].
        out: Output (MAX_BRANCHES, n).
        scratch: `ik_scratch(arm)`.

    Returns:
        Number of configurations written.
    """
    ik, state = arm.ik, scratch.state
    active, first = ik.active, len(ik.samples)
    branches = scratch.branches
    lower, upper = arm.limits
    closed = s < first
    if closed:
        found = _branches(s, R_target, p_target, ik, branches, scratch.R06)
        rule = NewtonRule(8, 1e-6, enough, False)
    else:
        if ik.kind != NUMERIC and state[0] > 0:
            return 0
        if s == first:
            nearest_seeds(R_target, p_target, ik, scratch.order, scratch.distance)
        active, found = scratch.every, 1
        # From a seed, Newton needs many steps; after a closed form, it only removes rounding.
        rule = NewtonRule(30, 1.0, enough, True)
    count = 0
    for b in range(found):
        if closed:
            for i in range(len(lower)):
                out[count, i] = ik.samples[s, i]
            if np.isnan(branches[b, 4]):
                continue
            for a in range(6):
                out[count, active[a]] = branches[b, a]
            if _exceeds_limits(branches[b], active, lower, upper):
                continue
        else:
            for i in range(len(lower)):
                out[count, i] = ik.seeds[scratch.order[s - first], i]
        residual = newton(
            out[count], active, arm.chain, arm.limits, R_target, p_target, rule, scratch.newton
        )
        if residual < max(enough, _MAX_RESIDUAL) and into_limits(
            out[count], lower, upper, ik.prismatic
        ):
            if not closed and _known(out[count], scratch.solutions, state[0]):
                continue
            if not closed:
                for i in range(len(lower)):
                    scratch.solutions[state[0], i] = out[count, i]
            if not closed or state[0] == 0:
                state[0] += 1
            count += 1
    return count


@kernel
def _branches(s, R_target, p_target, ik, branches, R06):
    """Write all branches of the closed form at a sample; return their number."""
    kind, h, o, R_tool = ik.kind, ik.h, ik.o, ik.R_tool
    for i in range(3):
        for j in range(3):
            R06[i, j] = (
                R_target[i, 0] * R_tool[s, j, 0]
                + R_target[i, 1] * R_tool[s, j, 1]
                + R_target[i, 2] * R_tool[s, j, 2]
            )
    c0 = row(ik.wrist, s)
    if ik.reverse:
        # From the tool, the arm has the inverse motion: p -> R06^T (p - shift).
        shift = sub((p_target[0], p_target[1], p_target[2]), mul(R06, row(ik.p_tool, s)))
        c = mul_t(R06, sub(c0, shift))
        for i in range(3):
            for j in range(i):
                R06[i, j], R06[j, i] = R06[j, i], R06[i, j]
    else:
        shift = mul(R06, sub(c0, row(ik.p_tool, s)))
        c = (p_target[0] + shift[0], p_target[1] + shift[1], p_target[2] + shift[2])
    if kind == THREE_PARALLEL:
        found = three_parallel(h[s], o[s], c0, R06, c, branches)
    elif kind == SLIDES:
        found = slides_and_wrist(h[s], o[s], R06, c, branches)
    else:
        found = spherical(kind, h[s], o[s], c0, R06, c, branches)
    if ik.reverse:
        for b in range(found):
            for a in range(6):
                branches[b, a] = -branches[b, a]
    return found


@kernel
def nearest_seeds(R, p, ik, order, distance):
    """Fill `order` with the seeds that have the nearest tool poses, nearest first."""
    poses, most = ik.seed_poses, len(order)
    distance[:] = np.inf
    order[:] = 0
    for i in range(len(poses)):
        s = 0.0
        for k in range(3):
            d = poses[i, k] - p[k] / SEED_LENGTH
            s += d * d
        if s >= distance[most - 1]:
            continue
        for k in range(3):
            d, e = poses[i, 3 + k] - R[k, 0], poses[i, 6 + k] - R[k, 1]
            s += d * d + e * e
        j = most - 1
        if s >= distance[j]:
            continue
        while j > 0 and distance[j - 1] > s:
            distance[j], order[j] = distance[j - 1], order[j - 1]
            j -= 1
        distance[j], order[j] = s, i


@kernel
def _known(q, solutions, count):
    """Return whether a configuration equals one found before."""
    for i in range(count):
        worst = 0.0
        for k in range(len(q)):
            worst = max(worst, abs(q[k] - solutions[i, k]))
        if worst < _MIN_DISTANCE:
            return True
    return False


@kernel
def ik_scratch(arm):
    """Allocate the scratch memory of `solve_sample`."""
    n, tries = len(arm.limits.lower), max(1, arm.ik.tries)
    return IkScratch(
        np.empty((MAX_BRANCHES, 6)),
        np.empty((3, 3)),
        np.arange(n),
        np.zeros(tries, np.int64),
        np.empty(tries),
        np.empty((tries, n)),
        np.zeros(1, np.int64),
        newton_scratch(arm.chain, n),
    )


@kernel
def max_solutions(ik):
    """Return an upper bound on the number of solutions for one pose."""
    return max(len(ik.samples) * MAX_BRANCHES, ik.tries)


@entry
def _solve_all(poses: F3, arm: ArmArrays) -> tuple[np.ndarray, np.ndarray]:
    n, most = len(arm.limits.lower), max_solutions(arm.ik)
    scratch = ik_scratch(arm)
    # Space for the rejected candidates after the solutions.
    out = np.full((len(poses), most + MAX_BRANCHES, n), np.nan)
    counts = np.zeros(len(poses), np.int64)
    for i in range(len(poses)):
        R, p = poses[i, :3, :3], poses[i, :3, 3]
        begin_pose(scratch)
        for s in range(sample_count(arm.ik)):
            counts[i] += solve_sample(s, R, p, arm, EXACT, out[i, counts[i] :], scratch)
        out[i, counts[i] :] = np.nan
    return out[:, :most], counts


@owner_cache()
def arm_arrays(chain: Chain, ik: IkModel) -> ArmArrays:
    """Return an arm as an argument of kernels."""
    return ArmArrays(chain_arrays(chain), chain_limits(chain), ik_arrays(ik))


def solve_ik(
    chain: Chain, ik: IkModel, Ts_base_tool: Float[np.ndarray, "m 4 4"]
) -> tuple[Float[np.ndarray, "m b n"], Int[np.ndarray, " m"]]:
    """Solve inverse kinematics for a batch of tool poses.

    Returns:
        Configurations (NaN beyond each pose's count), and the counts.
    """
    poses, arm = np.array(Ts_base_tool, float), arm_arrays(chain, ik)
    blocks = range(0, max(1, len(poses)), MAX_POSES)
    solved = [_solve_all(poses[first : first + MAX_POSES], arm) for first in blocks]
    if len(solved) == 1:
        return solved[0]
    solutions, counts = (np.concatenate(part) for part in zip(*solved, strict=True))
    return solutions, counts
