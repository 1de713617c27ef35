"""Records of the search: the problem, its restrictions of the base pose, and the result."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple, Protocol, TypeAlias

import numpy as np

from momapos.core import OutOfTimeError, look
from momapos.core.geometry import all_inside, any_overlap, place_points, wrap_angle
from momapos.model.records import (
    ANYWHERE,
    NO_PATH,
    ArmPathResult,
    Attempt,
    BaseRegion,
    Candidates,
    Motion,
    NearestMiss,
    PoseOutcome,
    PoseStatus,
    ReachScorer,
    TravelCost,
)

from .area import PlacementGeometry, within_reach
from .grasp_scores import GraspModeScorer

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int


class PoseRule(Protocol):
    """One condition on base poses."""

    def keeps(
        self, poses: Float[np.ndarray, "n 3"], travel: Float[np.ndarray, " n"], /
    ) -> Bool[np.ndarray, " n"]:
        """Return which base poses satisfy it, given the driving length to each [m]."""
        ...

    @property
    def otherwise(self) -> PoseOutcome:
        """Return the outcome of the others."""
        ...


class BasePoseRule(NamedTuple):
    """One condition on base poses, see `PoseRule`."""

    keeps: Callable[[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]], Bool[np.ndarray, " n"]]
    """Return which base poses satisfy it, given the driving length to each [m]."""
    otherwise: PoseOutcome
    """Outcome of the others."""


def rules(region: BaseRegion, geometry: PlacementGeometry) -> list[BasePoseRule]:
    """Return the conditions of a region; the base faces the first grasp."""

    def inside(poses: Float[np.ndarray, "n 3"], _: Float[np.ndarray, " n"]) -> np.ndarray:
        outlines = place_points(poses, geometry.robot.footprint)
        each = [all_inside(np.array(area), outlines) for area in region.keep_in]
        return np.asarray(np.array(each).any(0))

    def outside(poses: Float[np.ndarray, "n 3"], _: Float[np.ndarray, " n"]) -> np.ndarray:
        outlines = place_points(poses, geometry.robot.base_outline)
        each = [any_overlap(np.array(area), outlines) for area in region.keep_out]
        return np.asarray(~np.array(each).any(0))

    def faces(poses: Float[np.ndarray, "n 3"], _: Float[np.ndarray, " n"]) -> np.ndarray:
        toward = geometry.Ts_world_tool[0, 1, :2, 3] - poses[:, :2]
        turn = wrap_angle(np.arctan2(toward[:, 1], toward[:, 0]) - poses[:, 2])
        return np.asarray(np.abs(turn) <= region.facing)

    def is_near(_: Float[np.ndarray, "n 3"], travel: Float[np.ndarray, " n"]) -> np.ndarray:
        return np.asarray((travel <= region.most_driving) | np.isinf(travel))

    every = (
        (bool(region.keep_in), inside, PoseStatus.NOT_KEPT_IN),
        (bool(region.keep_out), outside, PoseStatus.NOT_KEPT_OUT),
        (region.facing is not None, faces, PoseStatus.NOT_FACING),
        (region.most_driving is not None, is_near, PoseStatus.TOO_LONG_A_DRIVE),
    )
    return [BasePoseRule(keeps, PoseOutcome(status)) for applies, keeps, status in every if applies]


FitPoses: TypeAlias = (
    "Callable[[Float[np.ndarray, 'n 3']], tuple[Float[np.ndarray, 'n 3'], Int[np.ndarray, ' n']]]"
)
"""Move base poses to feasible ones nearby; return them and the grasp mode of each, or -1."""
_BLOCK = 512
"""Poses fitted between two checks of the time limit [-]."""


def fitted(
    fit: FitPoses | None,
    geometry: PlacementGeometry,
    poses: Float[np.ndarray, "n 3"],
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, " n"] | None]:
    """Fit the base poses within the arm's reach; return them unchanged if `fit` is None.

    Returns:
        The fitted poses and the grasp mode of each (-1: none found; None: not fitted).
    """
    if fit is None:
        return poses, None
    poses, own = poses.copy(), np.full(len(poses), -1)
    near = np.flatnonzero(within_reach(geometry, poses))
    for first in range(0, len(near), _BLOCK):
        look()
        rows = near[first : first + _BLOCK]
        poses[rows], own[rows] = fit(poses[rows])
    return poses, own


_UNCOUNTED = (PoseStatus.FEASIBLE, PoseStatus.PATH_FOUND, PoseStatus.NOT_TRIED)

ScreenPoses: TypeAlias = (
    "Callable[[Float[np.ndarray, 'n 3'], Float[np.ndarray, 'n g'], int | None], "
    "list[ArmPathResult]]"
)
"""Search an arm path at each of many base poses, given the scores of all grasp modes and the
maximum number to try."""
NearPoses: TypeAlias = (
    "Callable[[Float[np.ndarray, '3'], ArmPathResult, Float[np.ndarray, 'n 3']], "
    "Bool[np.ndarray, ' n']]"
)
"""Return at which base poses near one with an arm path the arm follows the same tool path."""
PoseMask: TypeAlias = "Callable[[Float[np.ndarray, 'n 3']], Bool[np.ndarray, ' n']]"
"""Return which base poses have a property."""
PoseCost: TypeAlias = "Callable[[Float[np.ndarray, 'n 3']], Float[np.ndarray, ' n']]"
"""Return a further cost of base poses, as a driving length [m]."""
AttemptPose: TypeAlias = (
    "Callable[[Float[np.ndarray, '3'], ArmPathResult, Int[np.ndarray, ' k']], Attempt]"
)
"""Complete the arm path found at a base pose, or else one in another grasp mode, best first."""


class ApproachCheck(Protocol):
    """Checks that the robot can drive to a base pose, once it could not drive to another."""

    def __call__(self, base: Float[np.ndarray, "3"]) -> bool:
        """Plan a path to a base pose (x [m], y [m], yaw [rad]) unless all poses so far had one."""
        ...

    def known_blocked(self, bases: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Return which base poses earlier results show to have no path."""
        ...

    def no_way(self) -> PoseOutcome:
        """Return the outcome of base poses without a path."""
        ...


class DepartureCheck(Protocol):
    """Checks that the robot can drive on from a base pose after the task."""

    def __call__(self, base: Float[np.ndarray, "3"]) -> bool:
        """Check a completed base pose: x [m], y [m], yaw [rad]."""
        ...

    def is_known_blocked(self, base: Float[np.ndarray, "3"]) -> bool:
        """Check whether earlier results show that the robot cannot drive on from a base pose."""
        ...


class PoseOutcomes:
    """The outcomes of some base poses. Most poses share one, so each has the index of a kind."""

    def __init__(self, outcomes: Sequence[PoseOutcome]) -> None:
        self.kinds: list[PoseOutcome] = []
        self._index: dict[PoseOutcome, int] = {}
        self.kind = np.array([self._kind_of(one) for one in outcomes], np.int32)

    @classmethod
    def all_the_same(cls, outcome: PoseOutcome, count: int) -> PoseOutcomes:
        """Return one outcome for a number of base poses."""
        found = cls([outcome])
        found.kind = np.zeros(count, np.int32)
        return found

    def __setitem__(
        self, rows: int | np.ndarray, outcome: PoseOutcome | Sequence[PoseOutcome]
    ) -> None:
        if isinstance(outcome, PoseOutcome):
            self.kind[rows] = self._kind_of(outcome)
        else:
            self.kind[rows] = [self._kind_of(each) for each in outcome]

    def _kind_of(self, outcome: PoseOutcome) -> int:
        """Return the index of a kind, which may be new."""
        index = self._index.setdefault(outcome, len(self.kinds))
        if index == len(self.kinds):
            self.kinds.append(outcome)
        return index

    def __len__(self) -> int:
        return len(self.kind)

    def __getitem__(self, row: int) -> PoseOutcome:
        return self.kinds[self.kind[row]]

    def __iter__(self) -> Iterator[PoseOutcome]:
        return (self.kinds[k] for k in self.kind.tolist())

    def counts(self) -> dict[PoseOutcome, int]:
        """Return how often each kind occurs."""
        counts = np.bincount(self.kind, minlength=len(self.kinds)).tolist()
        return {one: count for one, count in zip(self.kinds, counts, strict=True) if count}


@dataclass(eq=False)
class Search:
    """The base poses examined so far and the best one."""

    poses: list[Float[np.ndarray, "n 3"]] = field(default_factory=list)
    outcomes: list[PoseOutcomes] = field(default_factory=list)
    """The outcome of each pose."""
    checked: int = 0
    """Number of poses checked for an arm path [-]."""
    base: Float[np.ndarray, "3"] | None = None
    motion: Motion | None = None
    cost: float = np.inf
    """Driving length to `base` [m]."""
    robustness: float | None = None
    """Share of the neighbors of `base` that work; None if it was not measured."""
    timed_out: bool = False
    ended_early: bool = False
    """Whether the time limit ended the search, and its best base pose so far was accepted."""
    blocked_in: bool = False
    """Whether the robot cannot drive on from `base` after the task."""
    fallback: tuple[Float[np.ndarray, "3"], Motion, float] | None = None
    """Base pose, motion and cost [m] of the first that blocks the robot in."""

    @contextmanager
    def in_time(self) -> Iterator[None]:
        """End a block, without an error, when its time limit is over."""
        try:
            yield
        except OutOfTimeError:
            self.timed_out = self.motion is None
            self.ended_early |= self.motion is not None

    def note(self, poses: Float[np.ndarray, "n 3"], outcomes: PoseOutcomes) -> None:
        """Add a round; the caller writes into `outcomes` later."""
        self.poses.append(poses)
        self.outcomes.append(outcomes)

    def accept_fallback(self) -> None:
        """Accept a base pose that blocks the robot in, if no other was found."""
        if self.motion is None and self.fallback is not None:
            self.base, self.motion, self.cost = self.fallback
            self.ended_early |= self.timed_out
            self.blocked_in, self.timed_out = True, False

    @property
    def is_no(self) -> bool:
        """Whether the search is complete and found nothing."""
        return self.motion is None and not self.timed_out

    def without_path(self) -> Float[np.ndarray, "n 3"]:
        """Return base poses of the last round that are within reach but have no arm path."""
        if not self.poses:
            return np.zeros((0, 3))
        last = self.outcomes[-1]
        wanted = np.array([one.status in NO_PATH for one in last.kinds], bool)
        return self.poses[-1][wanted[last.kind]]

    def merge(self, other: Search, *, reasons: bool = False) -> None:
        """Add the result of another search.

        Args:
            other: The search.
            reasons: Whether to add its reasons for failures; not for a search of the same poses.
        """
        if reasons:
            self.poses += other.poses
            self.outcomes += other.outcomes
        self.checked += other.checked
        self.timed_out, self.fallback = other.timed_out, self.fallback or other.fallback
        if other.motion is None:
            return
        self.base, self.motion = other.base, other.motion
        self.cost, self.robustness = other.cost, other.robustness
        if not reasons:
            assert other.base is not None
            self.note(other.base[None], PoseOutcomes([PoseOutcome(PoseStatus.FEASIBLE)]))

    @property
    def progress(self) -> tuple[int, int]:
        """Return how far the checks of any base pose came, see `PoseOutcome.progress`."""
        return max((one.progress for one in self.counts()), default=(-1, 0))

    def counts(self) -> Counter[PoseOutcome]:
        """Count the base poses by outcome."""
        counts: Counter[PoseOutcome] = Counter()
        for group in self.outcomes:
            counts.update(group.counts())
        return counts

    def candidates(self) -> Candidates:
        """Count the outcomes for the plan."""
        counts = self.counts()
        rejected = [one for one in counts if one.status not in _UNCOUNTED]
        words: Counter[str] = Counter()
        for outcome in rejected:
            words[outcome.counted] += counts[outcome]
        nearest = None if self.motion is not None else self._nearest(rejected)
        return Candidates(counts.total(), self.checked, dict(words.most_common()), nearest)

    def _nearest(self, rejected: Sequence[PoseOutcome]) -> NearestMiss | None:
        """Return the first of the base poses whose checks came farthest, up to the arm at least."""
        best = max(rejected, key=lambda one: one.progress, default=None)
        if best is None or best.progress < PoseOutcome(PoseStatus.NO_GRASP_IN_REACH).progress:
            return None
        for poses, group in zip(self.poses, self.outcomes, strict=True):
            rows = np.flatnonzero(np.array([one == best for one in group.kinds], bool)[group.kind])
            if len(rows):
                x, y, yaw = poses[rows[0]].tolist()
                kind = next(one for one in group.kinds if one == best)
                return NearestMiss((x, y, yaw), kind.in_full)
        raise AssertionError("the outcome is one of those that were counted")


@dataclass(frozen=True, eq=False)
class Problem:
    """A search problem; functions stand for the stages behind it."""

    geometry: PlacementGeometry
    reach: ReachScorer
    """The robot's reachability map."""
    grid_reach: ReachScorer
    """The map for the grid: it excludes only what is certainly out of reach."""
    mode_scorers: tuple[GraspModeScorer, ...]
    """Scorers of grasp modes; each is tried if those before fail."""
    travel_cost: TravelCost
    attempt: AttemptPose
    """Checks one base pose completely."""
    screen: ScreenPoses
    """Checks many base poses for an arm path only."""
    start: Float[np.ndarray, "3"]
    """Start pose of the base: x [m], y [m], yaw [rad]."""
    near: NearPoses | None = None
    """Finds base poses near one with an arm path that need no search. None: all are searched."""
    grasp_step: int = 0
    """Index of the arm path's state in which the hand grasps [-]."""
    infeasible_reason: str = ""
    """Why no base pose can solve the task, if known beforehand."""
    keep_poses: PoseMask | None = None
    """Returns which base poses may be tried; None for all."""
    own_cost: PoseCost | None = None
    """A further cost of base poses [m]; None for none."""
    home_is_free: PoseMask | None = None
    """Whether the arm can return home after the task; such base poses come first. None: always."""
    approach: ApproachCheck | None = None
    """Whether the robot can drive to base poses. `attempt` checks that, too; this saves checks of
    the arm. None: not checked."""
    departure: DepartureCheck | None = None
    """Whether the robot can drive on after the task; other base poses are fallbacks. None: not
    checked."""
    region: BaseRegion = ANYWHERE
    """Where the base may stand."""
    way_rules: tuple[PoseRule, ...] = ()
    """Why a base pose has no finite driving length, before it is rejected for that."""
    rules: tuple[PoseRule, ...] = ()
    """Further conditions on base poses."""
    path_rules: tuple[PoseRule, ...] = ()
    """Slower ones, asked only about base poses from which a grasp mode is within reach."""
    fit: FitPoses | None = None
    """Moves base poses to feasible ones nearby, for arms of few joints."""
