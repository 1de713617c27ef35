"""How an arm is inverted: which closed form fits it, what is locked, and where Newton begins.

Closed forms exist here for six revolute joints with a spherical wrist (axes 4, 5, 6 meet) whose
second and third axes are parallel or whose first two meet, for the same seen from the tool (a
spherical shoulder), and for three parallel axes (2, 3, 4) with 5 and 6 meeting (Universal Robots).
Longer arms get their extra joints locked at sampled values. All other arms are solved by damped
Newton steps from the seeds whose tool poses are nearest.
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
    THREE_PARALLEL,
    WRIST_MEETING,
    WRIST_PARALLEL,
)
from .kernel_records import IkArrays

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

_LOOSE = 5e-3
"""How far [m or rad] from the ideal geometry Newton may be asked to bridge."""
FEWEST = 4
"""Degrees of freedom that an arm must have [-]."""
MOST_SAMPLES = 128
"""Samples of the locked joints [-]: beyond, they are spread evenly instead of on a grid."""
SEEDS, TRIES = 16384, 48
"""Seeds of an arm without closed form, and how many of them are tried for a pose [-]."""
SPARE_SEEDS, SPARE_TRIES = 4096, 12
"""The same where joints are locked, for poses that no sample reaches [-]."""
SEED_LENGTH = 0.3
"""Distance between tools that counts as much as a turn of half a radian or so [m]."""


@dataclass(frozen=True)
class IkModel:
    """How to invert one arm."""

    kind: int
    reverse: bool
    """Whether the closed form sees the arm from its tool."""
    active: Int[np.ndarray, " a"]
    """The degrees of freedom that are solved for; the others are locked at a sample."""
    prismatic: Bool[np.ndarray, " n"]
    """Which degrees of freedom slide."""
    samples: Float[np.ndarray, "s n"]
    """Full configurations that hold the locked values; none where all is numerical."""
    h: Float[np.ndarray, "s a 3"]
    """Axes of the active joints with the locked ones in place, in the closed form's order."""
    o: Float[np.ndarray, "s a 3"]
    """Points on those axes that the closed forms want, in the base frame [m]."""
    wrist: Float[np.ndarray, "s 3"]
    """The point where the closed form's last axes meet [m]."""
    R_tool: Float[np.ndarray, "s 3 3"]
    p_tool: Float[np.ndarray, "s 3"]
    """Tool pose with the active joints at zero."""
    seeds: Float[np.ndarray, "k n"]
    """Configurations spread over all that the arm can take; every model has some."""
    seed_poses: Float[np.ndarray, "k 9"]
    """Their tool poses, as `pose_features` compares them."""
    tries: int
    """How many of the nearest seeds Newton begins at, where no sample gives a solution."""

    @property
    def name(self) -> str:
        """What kind of solution this is, in words."""
        return NAMES[self.kind] + (", seen from the tool" if self.reverse else "")

    @property
    def complete(self) -> bool:
        """Whether every solution is found: by a closed form, and no joint is locked."""
        return len(self.samples) == 1

    @property
    def max_solutions(self) -> int:
        """Upper bound on the number of solutions for one pose."""
        return max(len(self.samples) * MAX_BRANCHES, self.tries)


def build_ik(
    chain: Chain, *, samples_per_joint: int = 9, most_samples: int = MOST_SAMPLES
) -> IkModel:
    """Find the closed form that fits an arm, or spread seeds for Newton steps.

    Args:
        chain: The arm.
        samples_per_joint: Values at which a redundant revolute joint is locked [-]; a prismatic
            one (a torso) gets half as many.
        most_samples: Samples of all locked joints together [-].

    Raises:
        RobotError: The arm has too few degrees of freedom.
    """
    if chain.size < FEWEST:
        raise RobotError(
            f"the arm has {chain.size} degrees of freedom; at least {FEWEST} are needed"
        )
    alone = np.bincount(chain.dof, minlength=chain.size) == 1
    revolute = np.flatnonzero(~chain.prismatic & alone)
    if len(revolute) >= 6:
        for active in _active_sets(revolute):
            model = _closed_form(chain, np.array(active), samples_per_joint, most_samples)
            if model is not None:
                return model
    return _numeric(chain)


def fine_ik(chain: Chain) -> IkModel:
    """Inverse kinematics that finds what planning's own overlooks, and takes some ten times as
    long: redundant joints are locked at 33 values instead of 9, and four times as many seeds tried.
    """
    ik = build_ik(chain, samples_per_joint=33, most_samples=1000)
    return replace(ik, tries=4 * ik.tries)


def ik_arrays(ik: IkModel) -> IkArrays:
    """The IK model as the kernels take it."""
    return IkArrays(
        ik.kind, ik.reverse, ik.active, ik.prismatic, ik.samples, ik.h, ik.o, ik.wrist, ik.R_tool,
        ik.p_tool, ik.seeds, ik.seed_poses, ik.tries,
    )  # fmt: skip


def pose_features(Ts: Float[np.ndarray, "k 4 4"]) -> Float[np.ndarray, "k 9"]:
    """Numbers whose distance tells how far tool poses are apart."""
    return np.concatenate([Ts[:, :3, 3] / SEED_LENGTH, Ts[:, :3, 0], Ts[:, :3, 1]], axis=1)


def bounded(chain: Chain) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Limits of the degrees of freedom, one turn for those that have none."""
    lower = np.where(np.isfinite(chain.lower), chain.lower, -np.pi)
    return lower, np.where(np.isfinite(chain.upper), chain.upper, np.pi)


def one_turn(chain: Chain) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Limits of the degrees of freedom, for one that turns farther the full turn nearest to zero.

    What lies in them is all that the arm can look like, each posture once.
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


def _samples(chain: Chain, locked: list[int], count: int, most: int) -> Float[np.ndarray, "s n"]:
    """Configurations that hold the locked joints on a grid, or spread evenly if those are many."""
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
    # A few arm states tell whether the form fits, before all are folded.
    first = _fold(chain, _samples(chain, locked, 2, 1)[0], active)
    reverse, kind = False, _classify(first[0], first[1])
    if kind is None:
        reverse, kind = True, _classify(first[0][::-1], first[1][::-1])
    if kind is None:
        return None
    samples = _samples(chain, locked, count, most)
    folded = [_fold(chain, sample, active) for sample in samples]
    turned = [(h[::-1], o[::-1]) if reverse else (h, o) for h, o, _, _ in folded]
    if any(_classify(h, o) != kind for h, o in turned):
        return None
    seeds, poses = _seeds(chain, SPARE_SEEDS)
    return IkModel(
        kind=kind,
        reverse=reverse,
        active=(active[::-1] if reverse else active).astype(np.int64),
        prismatic=chain.prismatic,
        samples=samples,
        h=np.array([h for h, _ in turned]),
        o=np.array([_points(kind, h, o) for h, o in turned]),
        wrist=np.array([_meeting(h[4:], o[4:])[0] for h, o in turned]),
        R_tool=np.array([R for _, _, R, _ in folded]),
        p_tool=np.array([p for _, _, _, p in folded]),
        seeds=seeds,
        seed_poses=poses,
        tries=SPARE_TRIES if locked else 0,
    )


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
