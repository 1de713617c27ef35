"""Inverse kinematics: all branches in closed form if the arm allows it, otherwise Newton steps.

Closed forms exist for six revolute joints with a spherical wrist (axes 4, 5, 6 meet) whose second
and third axes are parallel or whose first two meet, for the same as seen from the tool (spherical
shoulder), for three parallel axes (2, 3, 4) with 5 and 6 meeting (Universal Robots), and for three
slides before three revolute axes. Longer arms have their extra joints locked at sampled values. All
other arms use damped Newton steps from the seeds with the nearest tool poses.

Newton steps also remove the remaining error of a closed form (published URDFs round pi/2). For arms
without closed form, and if no sample of locked joints has a solution, Newton starts at the seeds
with the nearest tool poses.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import RobotError, owner_cache
from momapos.core.compiled import F3, entry, kernel
from momapos.core.geometry import halton

from .chain import (
    ArmArrays,
    Chain,
    IkArrays,
    IkScratch,
    NewtonRule,
    NewtonScratch,
    chain_arrays,
    chain_limits,
    forward,
    stand_at_origin,
)
from .closed_forms import (
    MAX_BRANCHES,
    NAMES,
    NUMERIC,
    SLIDES,
    THREE_PARALLEL,
    WRIST_MEETING,
    WRIST_PARALLEL,
    dot,
    mul,
    mul_t,
    row,
    slides_and_wrist,
    spherical,
    sub,
    three_parallel,
)

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int


_MIN_VOLUME = 0.1
"""Three slides span space if their directions span at least this volume [-]."""
_MAX_DEVIATION = 5e-3
"""Largest deviation from the ideal geometry of a closed form [m] or [rad]."""
MIN_FREEDOMS = 4
"""Smallest number of degrees of freedom of an arm [-]."""
MAX_SAMPLES = 128
"""Largest number of samples of the locked joints; larger grids become evenly spread samples [-]."""
SEEDS, TRIES = 16384, 48
"""Number of seeds of an arm without closed form, and of those tried per pose [-]."""
FALLBACK_SEEDS, FALLBACK_TRIES = 4096, 12
"""The same with locked joints, for poses that no sample reaches [-]."""
SEED_LENGTH = 0.3
"""Distance between tool positions that counts like a turn of about 0.5 rad [m]."""


@dataclass(frozen=True, eq=False)
class IkModel:
    """The inverse kinematics of one arm."""

    kind: int
    reverse: bool
    """Whether the closed form is applied from the tool to the base."""
    active: Int[np.ndarray, " a"]
    """Degrees of freedom to solve for; the others are locked at a sample."""
    prismatic: Bool[np.ndarray, " n"]
    """Which degrees of freedom are prismatic."""
    samples: Float[np.ndarray, "s n"]
    """Full configurations with the locked values; empty for numerical solutions."""
    h: Float[np.ndarray, "s a 3"]
    """Axes of the active joints at each sample, in the closed form's order."""
    o: Float[np.ndarray, "s a 3"]
    """Points on these axes for the closed form, in the base frame [m]."""
    wrist: Float[np.ndarray, "s 3"]
    """Intersection of the closed form's last axes [m]."""
    R_tool: Float[np.ndarray, "s 3 3"]
    p_tool: Float[np.ndarray, "s 3"]
    """Tool pose with the active joints at zero."""
    seeds: Float[np.ndarray, "k n"]
    """Configurations spread over the joint limits; every model has some."""
    seed_poses: Float[np.ndarray, "k 9"]
    """Their tool poses as `pose_features`."""
    tries: int
    """Number of nearest seeds for Newton if no sample has a solution."""

    @property
    def name(self) -> str:
        """Return a description of the solution method."""
        return NAMES[self.kind] + (", seen from the tool" if self.reverse else "")

    @property
    def complete(self) -> bool:
        """Return whether all solutions are found: by a closed form without locked joints."""
        return len(self.samples) == 1

    @property
    def max_solutions(self) -> int:
        """Return an upper bound on the number of solutions for one pose."""
        return max(len(self.samples) * MAX_BRANCHES, self.tries)


def build_ik(
    chain: Chain, *, samples_per_joint: int = 9, max_samples: int = MAX_SAMPLES
) -> IkModel:
    """Find the closed form of an arm, or prepare seeds for Newton steps.

    Args:
        chain: The arm.
        samples_per_joint: Number of locked values of a redundant revolute joint; a prismatic joint
            (a torso) has half as many [-].
        max_samples: Largest number of samples of all locked joints [-].

    Raises:
        RobotError: The arm has too few degrees of freedom.
    """
    if chain.size < MIN_FREEDOMS:
        raise RobotError(
            f"the arm has {chain.size} degrees of freedom; at least {MIN_FREEDOMS} are needed"
        )
    alone = np.bincount(chain.dof, minlength=chain.size) == 1
    revolute = np.flatnonzero(~chain.prismatic & alone)
    if len(revolute) >= 6:
        for active in _active_sets(revolute):
            model = _closed_form(chain, np.array(active), samples_per_joint, max_samples)
            if model is not None:
                return model
    slides = find_slides_and_wrist(chain)
    if slides is not None:
        return _with_slides(chain, np.array(slides), samples_per_joint, max_samples)
    return _numeric(chain)


def fine_ik(chain: Chain) -> IkModel:
    """Build more thorough inverse kinematics than for planning, which takes 10 times as long.

    Redundant joints are locked at 33 values instead of 9, and 4 times as many seeds are tried.
    """
    ik = build_ik(chain, samples_per_joint=33, max_samples=1000)
    return replace(ik, tries=4 * ik.tries)


def ik_arrays(ik: IkModel) -> IkArrays:
    """Return the IK model as an argument of kernels."""
    return IkArrays(
        ik.kind, ik.reverse, ik.active, ik.prismatic, ik.samples, ik.h, ik.o, ik.wrist, ik.R_tool,
        ik.p_tool, ik.seeds, ik.seed_poses, ik.tries,
    )  # fmt: skip


def pose_features(Ts: Float[np.ndarray, "k 4 4"]) -> Float[np.ndarray, "k 9"]:
    """Return features whose Euclidean distance measures the distance of tool poses."""
    return np.concatenate([Ts[:, :3, 3] / SEED_LENGTH, Ts[:, :3, 0], Ts[:, :3, 1]], axis=1)


def bounded(chain: Chain) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Return the limits of the degrees of freedom; one turn for unlimited ones."""
    lower = np.where(np.isfinite(chain.lower), chain.lower, -np.pi)
    return lower, np.where(np.isfinite(chain.upper), chain.upper, np.pi)


def one_turn(chain: Chain) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Return limits that contain each posture of the arm once.

    Revolute ranges of more than one turn are reduced to the turn nearest to zero.
    """
    lower, upper = bounded(chain)
    more = ~chain.prismatic & (upper - lower > 2 * np.pi)
    half = np.where(more, np.pi, (upper - lower) / 2)
    middle = np.where(more, 0.0, (lower + upper) / 2)
    middle = np.clip(middle, lower + half, upper - half)
    return middle - half, middle + half


def _seeds(chain: Chain, count: int) -> tuple[np.ndarray, np.ndarray]:
    lower, upper = bounded(chain)
    seeds = np.ascontiguousarray(lower + halton(count + 1, chain.size)[1:] * (upper - lower))
    return seeds, pose_features(chain.tool_poses(seeds))


def _active_sets(revolute: np.ndarray) -> list[tuple[int, ...]]:
    """Return sets of six revolute joints to solve for; joints near the base are locked first."""
    sets = itertools.combinations(revolute.tolist(), 6)
    return sorted(sets, key=lambda active: -sum(active))


def locked_values(chain: Chain, joint: int, count: int) -> Float[np.ndarray, " k"]:
    """Return the values at which a redundant joint is locked, over its whole range."""
    lower, upper = chain.lower[joint], chain.upper[joint]
    if chain.prismatic[joint]:
        return np.linspace(lower, upper, max(2, (count + 1) // 2))
    if not np.isfinite(upper - lower) or upper - lower >= 2 * np.pi:
        return np.linspace(-np.pi, np.pi, count, endpoint=False)
    return np.linspace(lower, upper, count)


def _samples(chain: Chain, locked: list[int], count: int, most: int) -> Float[np.ndarray, "s n"]:
    """Return configurations with the locked joints on a grid, or evenly spread if too many."""
    values = [locked_values(chain, j, count) for j in locked]
    total = int(np.prod([len(v) for v in values], dtype=float)) if values else 1
    if total > most:
        lower, upper = (limit[locked] for limit in bounded(chain))
        grid = lower + halton(most + 1, len(locked))[1:] * (upper - lower)
    else:
        grid = np.array(list(itertools.product(*values))).reshape(total, len(locked))
    samples = np.zeros((len(grid), chain.size))
    samples[:, locked] = grid
    return samples


def _closed_form(chain: Chain, active: np.ndarray, count: int, most: int) -> IkModel | None:
    locked = [j for j in range(chain.size) if j not in set(active.tolist())]
    # Check one arm state before computing all.
    first = _axes_at(chain, _samples(chain, locked, 2, 1)[0], active)
    reverse, kind = False, _classify(first[0], first[1])
    if kind is None:
        reverse, kind = True, _classify(first[0][::-1], first[1][::-1])
    if kind is None:
        return None
    samples = _samples(chain, locked, count, most)
    placed = [_axes_at(chain, sample, active) for sample in samples]
    turned = [(h[::-1], o[::-1]) if reverse else (h, o) for h, o, _, _ in placed]
    if any(_classify(h, o) != kind for h, o in turned):
        return None
    h, o = (np.array(part) for part in zip(*turned, strict=True))
    wrist = np.array([_meeting(h[4:], o[4:])[0] for h, o in turned])
    o = np.array([_points(kind, h, o) for h, o in turned])
    tools = [(R, p) for _, _, R, p in placed]
    return _of_axes(
        chain, kind, reverse, active[::-1] if reverse else active, samples, h, o, wrist, tools
    )


def find_slides_and_wrist(chain: Chain) -> tuple[int, ...] | None:
    """Return three slides that span space and the last three revolute joints, if they come after.

    Among several such slides, those near the tool are chosen: the others are locked.
    """
    alone = np.bincount(chain.dof, minlength=chain.size) == 1
    wrist = np.flatnonzero(~chain.prismatic & alone)[-3:]
    last = {int(k): int(np.flatnonzero(chain.dof == k)[-1]) for k in range(chain.size)}
    slides = np.flatnonzero(chain.prismatic).tolist()
    if len(wrist) < 3 or any(last[k] > chain.leads[wrist[0]] for k in slides):
        return None
    directions = _slide_directions(chain, np.zeros(chain.size))
    for three in itertools.combinations(slides[::-1], 3):
        if abs(np.linalg.det(directions[list(three)])) > _MIN_VOLUME:
            return (*sorted(three), *wrist.tolist())
    return None


def _slide_directions(chain: Chain, sample: np.ndarray) -> Float[np.ndarray, "n 3"]:
    """Return how the tool moves with each prismatic degree of freedom at a sample [m/m]."""
    R, p = np.empty((chain.last + 1, 3, 3)), np.empty((chain.last + 1, 3))
    stand_at_origin(R, p)
    forward(sample, chain_arrays(chain), R, p)
    h = chain.ratio[:, None] * np.einsum("mij,mj->mi", R[:-1], chain.h)
    out = np.zeros((chain.size, 3))
    np.add.at(out, chain.dof[chain.slides], h[chain.slides])
    return out


def _with_slides(chain: Chain, active: np.ndarray, count: int, most: int) -> IkModel:
    """Return the closed form of three slides before three revolute joints."""
    samples = _samples(chain, sorted(set(range(chain.size)) - set(active.tolist())), count, most)
    placed = [_axes_at(chain, sample, active) for sample in samples]
    h, o = np.array([h for h, _, _, _ in placed]), np.array([o for _, o, _, _ in placed])
    h[:, :3] = [_slide_directions(chain, sample)[active[:3]] for sample in samples]
    spans = np.abs(np.linalg.det(h[:, :3])) > _MIN_VOLUME
    tools = [(R, p) for _, _, R, p in placed]
    model = _of_axes(chain, SLIDES, False, active, samples, h, o, o[:, 5], tools)
    names = ("samples", "h", "o", "wrist", "R_tool", "p_tool")
    return replace(model, **{name: getattr(model, name)[spans] for name in names})


def _of_axes(
    chain: Chain,
    kind: int,
    reverse: bool,
    active: np.ndarray,
    samples: np.ndarray,
    h: np.ndarray,
    o: np.ndarray,
    wrist: np.ndarray,
    tools: list[tuple[np.ndarray, np.ndarray]],
) -> IkModel:
    """Return the inverse kinematics of a closed form, with seeds where joints are locked."""
    seeds, poses = _seeds(chain, FALLBACK_SEEDS)
    return IkModel(
        kind=kind,
        reverse=reverse,
        active=active.astype(np.int64),
        prismatic=chain.prismatic,
        samples=samples,
        h=h,
        o=o,
        wrist=wrist,
        R_tool=np.array([R for R, _ in tools]),
        p_tool=np.array([p for _, p in tools]),
        seeds=seeds,
        seed_poses=poses,
        tries=FALLBACK_TRIES if chain.size > len(active) else 0,
    )


def _axes_at(
    chain: Chain, sample: np.ndarray, active: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return axes and origins of the active joints at a sample, and the tool pose."""
    n = chain.last
    R, p = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3))
    stand_at_origin(R, p)
    forward(sample, chain_arrays(chain), R, p)
    joints = chain.leads[active]
    h = np.einsum("aij,aj->ai", R[joints], chain.h[joints])
    return h, p[joints + 1], R[n] @ chain.tool_rotation, p[n] + R[n] @ chain.tool_offset


def _meeting(h: np.ndarray, o: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the point nearest to several lines, and its largest distance from a line [m]."""
    P = np.eye(3) - h[:, :, None] * h[:, None, :]
    point = np.linalg.lstsq(P.sum(0), np.einsum("nij,nj->i", P, o), rcond=None)[0]
    gaps = np.einsum("nij,nj->ni", P, point - o)
    return point, float(np.linalg.norm(gaps, axis=1).max())


def _classify(h: np.ndarray, o: np.ndarray) -> int | None:
    def parallel(i: int, j: int) -> bool:
        return bool(np.linalg.norm(np.cross(h[i], h[j])) < _MAX_DEVIATION)

    if parallel(4, 5):
        return None
    if parallel(1, 2) and parallel(2, 3) and not parallel(0, 1):
        return THREE_PARALLEL if _meeting(h[4:], o[4:])[1] < _MAX_DEVIATION else None
    if parallel(3, 4) or _meeting(h[3:], o[3:])[1] > _MAX_DEVIATION:
        return None
    if parallel(1, 2) and not parallel(0, 1):
        return WRIST_PARALLEL
    if not parallel(0, 1) and _meeting(h[:2], o[:2])[1] < _MAX_DEVIATION:
        return WRIST_MEETING
    return None


def _points(kind: int, h: np.ndarray, o: np.ndarray) -> np.ndarray:
    if kind == WRIST_MEETING:
        o = o.copy()
        o[:2] = _meeting(h[:2], o[:2])[0]
    return o


def _numeric(chain: Chain) -> IkModel:
    n, seeds = chain.size, _seeds(chain, SEEDS)
    axes, points, turns = np.zeros((0, n, 3)), np.zeros((0, 3)), np.zeros((0, 3, 3))
    return IkModel(
        kind=NUMERIC,
        reverse=False,
        active=np.arange(n),
        prismatic=chain.prismatic,
        samples=np.zeros((0, n)),
        h=axes,
        o=axes,
        wrist=points,
        R_tool=turns,
        p_tool=points,
        seeds=seeds[0],
        seed_poses=seeds[1],
        tries=TRIES,
    )


@kernel
def factor_spd(A):
    """Replace the lower triangle of a small positive definite A by its Cholesky factor."""
    for i in range(len(A)):
        for j in range(i + 1):
            s = A[i, j]
            for k in range(j):
                s -= A[i, k] * A[j, k]
            A[i, j] = np.sqrt(max(s, 1e-18)) if i == j else s / A[j, j]


@kernel
def solve_spd(A, b):
    """Solve A x = b in place for a small positive definite A."""
    n = len(b)
    factor_spd(A)
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
def insert_nearest(i, s, order, distance):
    """Insert item i of a distance s into sorted items, all but the last of which remain."""
    j = len(order) - 1
    while j > 0 and distance[j - 1] > s:
        distance[j], order[j] = distance[j - 1], order[j - 1]
        j -= 1
    distance[j], order[j] = s, i


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
        if s < distance[most - 1]:
            insert_nearest(i, s, order, distance)


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
