"""Select the inverse kinematics of an arm: closed form, locked joints, seeds of Newton steps.

Closed forms exist for six revolute joints with a spherical wrist (axes 4, 5, 6 meet) whose second
and third axes are parallel or whose first two meet, for the same as seen from the tool (spherical
shoulder), for three parallel axes (2, 3, 4) with 5 and 6 meeting (Universal Robots), and for three
slides before three revolute axes. Longer arms have their extra joints locked at sampled values. All
other arms use damped Newton steps from the seeds with the nearest tool poses.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import RobotError
from momapos.core.geometry import halton

from .chain import Chain, chain_arrays, forward, stand_at_origin
from .closed_forms import (
    MAX_BRANCHES,
    NAMES,
    NUMERIC,
    SLIDES,
    THREE_PARALLEL,
    WRIST_MEETING,
    WRIST_PARALLEL,
)
from .kernel_records import IkArrays

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
    slides = slides_and_wrist(chain)
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


def slides_and_wrist(chain: Chain) -> tuple[int, ...] | None:
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
