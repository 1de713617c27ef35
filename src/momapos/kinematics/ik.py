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
from typing import TYPE_CHECKING

import numpy as np

from momapos.compiled import F3, entry, kernel
from momapos.errors import RobotError
from momapos.geometry.samples import halton
from momapos.kinematics.chain import Chain, chain_arrays, chain_limits, forward, stand_at_origin
from momapos.kinematics.closed_forms import (
    MAX_BRANCHES,
    NAMES,
    NUMERIC,
    THREE_PARALLEL,
    WRIST_MEETING,
    WRIST_PARALLEL,
    spherical,
    three_parallel,
)
from momapos.kinematics.newton import newton, newton_scratch
from momapos.kinematics.records import ArmArrays, IkArrays, IkScratch, NewtonRule
from momapos.kinematics.subproblems import mul, row, sub

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

_LOOSE = 5e-3
"""How far [m or rad] from the ideal geometry Newton may be asked to bridge."""
_SLACK = 0.05
"""How far outside its limits a joint may be before Newton has removed rounding [rad]."""
EXACT, COARSE = 1e-16, 1e-8
"""Squared residuals at which Newton stops: a solution, or one to 0.1 mm, for a map or a graph."""
_TIGHT = 1e-12
"""Squared residual at which a solution counts as exact [m^2 + rad^2]."""


@dataclass(frozen=True)
class IkModel:
    """How to invert one arm."""

    kind: int
    active: Int[np.ndarray, " a"]
    """The degrees of freedom that are solved for; the others are locked at a sample."""
    prismatic: Bool[np.ndarray, " n"]
    """Which degrees of freedom slide."""
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
    alone = np.bincount(chain.dof, minlength=chain.size) == 1
    revolute = np.flatnonzero(~chain.prismatic & alone)
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
    active = active.astype(np.int64)
    return IkModel(kind, active, chain.prismatic, samples, h, o, wrist, R, p)


def _fold(
    chain: Chain, sample: np.ndarray, active: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Axes, origins and tool pose of the active joints with the others in place."""
    n = chain.last
    R, p = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3))
    stand_at_origin(R, p)
    forward(sample, chain_arrays(chain), R, p)
    joints = chain.leads[active]
    h = np.einsum("aij,aj->ai", R[joints], chain.h[joints])
    return h, p[joints + 1], R[n] @ chain.tool_rotation, p[n] + R[n] @ chain.tool_offset


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
    if chain.size < 6:
        raise RobotError(
            f"the arm has {chain.size} joints; at least 6 are needed to reach a full tool pose"
        )
    lower = np.where(np.isfinite(chain.lower), chain.lower, -np.pi)
    upper = np.where(np.isfinite(chain.upper), chain.upper, np.pi)
    unit = halton(seeds + 1, chain.size)[1:]
    samples = np.ascontiguousarray(lower + unit * (upper - lower))
    every = np.arange(chain.size)
    empty, point = np.zeros((len(samples), chain.size, 3)), np.zeros((len(samples), 3))
    return IkModel(
        NUMERIC,
        every,
        chain.prismatic,
        samples,
        empty,
        empty,
        point,
        np.zeros((len(samples), 3, 3)),
        point,
    )


@kernel
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


@kernel
def _hopeless(branch, active, lower, upper):
    """Whether a joint of a closed form is farther outside its limits than Newton will move it."""
    turn = 2.0 * np.pi
    for a in range(len(active)):
        low, high = lower[active[a]], upper[active[a]]
        if high - low < turn:
            off = branch[a] - 0.5 * (low + high)
            off -= turn * np.round(off / turn)
            if abs(off) > 0.5 * (high - low) + _SLACK:
                return True
    return False


@kernel
def solve_sample(s, R_target, p_target, arm, enough, out, scratch):
    """All configurations within limits at one sample of the locked joints (or from one seed).

    Args:
        s: Index of the sample.
        R_target, p_target: Tool pose in the base frame.
        arm: `ArmArrays`.
        enough: Squared residual that will do [m^2 + rad^2], `EXACT` or `COARSE`.
        out: (max, n) to be filled.
        scratch: `ik_scratch(arm)`.

    Returns:
        Number of configurations written.
    """
    chain, ik = arm.chain, arm.ik
    kind, active, samples = ik.kind, ik.active, ik.samples
    h, o, wrist, R_tool, p_tool = ik.h, ik.o, ik.wrist, ik.R_tool, ik.p_tool
    branches, R06 = scratch.branches, scratch.R06
    lower, upper = arm.limits
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
            found = three_parallel(h[s], o[s], c0, R06, c, branches)
        else:
            found = spherical(kind, h[s], o[s], c0, R06, c, branches)
    # From a seed Newton has far to go; after a closed form it only removes rounding.
    steps, damping = (30, 1.0) if kind == NUMERIC else (8, 1e-6)
    rule = NewtonRule(steps, damping, enough)
    count = 0
    for b in range(found):
        for i in range(samples.shape[1]):
            out[count, i] = samples[s, i]
        if kind != NUMERIC:
            if np.isnan(branches[b, 4]):
                continue
            for a in range(6):
                out[count, active[a]] = branches[b, a]
            if _hopeless(branches[b], active, lower, upper):
                continue
        residual = newton(out[count], active, chain, R_target, p_target, rule, scratch.newton)
        if residual < max(enough, _TIGHT) and into_limits(out[count], lower, upper, ik.prismatic):
            count += 1
    return count


@kernel
def ik_scratch(arm):
    """Memory for `solve_sample`."""
    n = arm.ik.samples.shape[1]
    return IkScratch(np.empty((MAX_BRANCHES, 6)), np.empty((3, 3)), newton_scratch(arm.chain, n))


@kernel
def max_solutions(ik):
    """Upper bound on the number of solutions for one pose."""
    return len(ik.samples) * (1 if ik.kind == NUMERIC else MAX_BRANCHES)


@entry
def _solve_all(
    poses: F3,
    arm: ArmArrays,
) -> tuple[np.ndarray, np.ndarray]:
    n = arm.ik.samples.shape[1]
    scratch = ik_scratch(arm)
    out = np.full((len(poses), max_solutions(arm.ik), n), np.nan)
    counts = np.zeros(len(poses), np.int64)
    for i in range(len(poses)):
        R, p = poses[i, :3, :3], poses[i, :3, 3]
        for s in range(len(arm.ik.samples)):
            counts[i] += solve_sample(s, R, p, arm, EXACT, out[i, counts[i] :], scratch)
        # What was tried there and refused.
        out[i, counts[i] :] = np.nan
    return out, counts


def ik_arrays(ik: IkModel) -> IkArrays:
    """The IK model as the kernels take it."""
    return IkArrays(
        ik.kind, ik.active, ik.prismatic, ik.samples, ik.h, ik.o, ik.wrist, ik.R_tool, ik.p_tool
    )


def arm_arrays(chain: Chain, ik: IkModel) -> ArmArrays:
    """An arm as the kernels take it."""
    return ArmArrays(chain_arrays(chain), chain_limits(chain), ik_arrays(ik))


def solve_ik(
    chain: Chain, ik: IkModel, Ts_base_tool: Float[np.ndarray, "m 4 4"]
) -> tuple[Float[np.ndarray, "m b n"], Int[np.ndarray, " m"]]:
    """Solve a batch of tool poses.

    Returns:
        Configurations, NaN beyond each pose's count, and the counts.
    """
    return _solve_all(np.ascontiguousarray(Ts_base_tool, float), arm_arrays(chain, ik))
