"""What the search is given, and what it has found."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol, TypeAlias

import numpy as np

from momapos.model.records import (
    ANYWHERE,
    NO_PATH,
    ArmPathResult,
    Attempt,
    BaseRegion,
    Candidates,
    Motion,
    PoseOutcome,
    PoseStatus,
    ReachScorer,
    TravelCost,
)

from .area import PlacementGeometry
from .fitting import FitPoses
from .grasp_scores import ScoreWays
from .region import Rule

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

_UNCOUNTED = (PoseStatus.FEASIBLE, PoseStatus.PATH_FOUND, PoseStatus.NOT_TRIED)

ScreenPoses: TypeAlias = (
    "Callable[[Float[np.ndarray, 'n 3'], Float[np.ndarray, 'n g'], int | None], "
    "list[ArmPathResult] | None]"
)
"""Look for an arm path at each of many base poses, from the scores of all grasps and the number
of grasps to be tried; None: out of time."""
PoseMask: TypeAlias = "Callable[[Float[np.ndarray, 'n 3']], Bool[np.ndarray, ' n']]"
"""Which of some base poses have a property."""
PoseFilter: TypeAlias = PoseMask
"""Which of some base poses are no candidates, for reasons that this stage does not know."""
AttemptPose: TypeAlias = (
    "Callable[[Float[np.ndarray, '3'], ArmPathResult, Int[np.ndarray, ' k']], Attempt]"
)
"""Complete the arm path found at a base pose, or else one with the other grasps, best first."""


class LeadsOn(Protocol):
    """Whether a robot can drive on from base poses once its task is done."""

    def __call__(self, base: Float[np.ndarray, "3"]) -> bool:
        """Look at a base pose that was completed: x [m], y [m], yaw [rad]."""
        ...

    def hopeless(self, base: Float[np.ndarray, "3"]) -> bool:
        """Whether it is known beforehand that it cannot, from those that were looked at."""
        ...


@dataclass
class Search:
    """What has been looked at so far, and the best of it."""

    poses: list[Float[np.ndarray, "n 3"]] = field(default_factory=list)
    outcomes: list[np.ndarray] = field(default_factory=list)
    """A `PoseOutcome` of each."""
    checked: int = 0
    base: Float[np.ndarray, "3"] | None = None
    motion: Motion | None = None
    cost: float = np.inf
    """Driving length to it [m]."""
    margin: float | None = None
    """Share of the poses beside it that work; None where nobody has looked."""
    timed_out: bool = False
    shut_in: bool = False
    """Whether the robot cannot drive on from there when the task is done."""
    spare: tuple[Float[np.ndarray, "3"], Motion, float] | None = None
    """Base pose, motion and cost [m] of the first that shuts the robot in."""

    def note(self, poses: Float[np.ndarray, "n 3"], outcomes: np.ndarray) -> None:
        """Remember a round; what becomes of its poses is written into `outcomes` later."""
        self.poses.append(poses)
        self.outcomes.append(outcomes)

    def settle(self) -> None:
        """Be content with a base pose that shuts the robot in, where no other was found."""
        if self.motion is None and self.spare is not None:
            self.base, self.motion, self.cost = self.spare
            self.shut_in, self.timed_out = True, False

    @property
    def is_no(self) -> bool:
        """Whether all was looked at, and nothing found."""
        return self.motion is None and not self.timed_out

    def without_path(self) -> Float[np.ndarray, "n 3"]:
        """Base poses of the last round within reach from which no arm path was found."""
        if not self.poses:
            return np.zeros((0, 3))
        return self.poses[-1][[one.status in NO_PATH for one in self.outcomes[-1]]]

    def join(self, other: Search) -> None:
        """Add what another search of the same poses has found; why it found nothing does not
        count beside why this one did not."""
        self.checked += other.checked
        self.timed_out, self.spare = other.timed_out, self.spare or other.spare
        if other.motion is not None:
            self.base, self.motion = other.base, other.motion
            self.cost, self.margin = other.cost, other.margin
            assert other.base is not None
            feasible = PoseOutcome(PoseStatus.FEASIBLE)
            self.note(other.base[None], np.array([feasible], object))

    def candidates(self) -> Candidates:
        """Counts for the plan."""
        every = np.concatenate([np.zeros(0, object), *self.outcomes]).tolist()
        # Most poses share an outcome: told apart by identity first, which needs no hashing of text.
        shared = dict(zip(map(id, every), every, strict=True))
        counts: Counter[PoseOutcome] = Counter()
        for key, count in Counter(map(id, every)).items():
            if shared[key].status not in _UNCOUNTED:
                counts[shared[key]] += count
        words = {str(outcome): count for outcome, count in counts.most_common()}
        return Candidates(len(every), self.checked, words)


@dataclass(frozen=True)
class Problem:
    """What the search is given; the stages behind the functions are not its business."""

    geometry: PlacementGeometry
    reach: ReachScorer
    """The robot's reachability map."""
    grid_reach: ReachScorer
    """The same for the grid, whose "no" counts: it rules out only what is surely out of reach."""
    ways: tuple[ScoreWays, ...]
    """Ways of holding, each of which is tried where those before fail."""
    travel_cost: TravelCost
    attempt: AttemptPose
    """Checks one base pose completely."""
    screen: ScreenPoses
    """Checks many base poses for an arm path alone; the grid needs it."""
    start: Float[np.ndarray, "3"]
    """Where the robot is: x [m], y [m], yaw [rad]."""
    out_of_time: Callable[[], bool]
    """Asked between candidates."""
    takes_hold: int = 0
    """Index of the state of an arm path in which the hand takes hold [-]."""
    infeasible_reason: str = ""
    """Why no base pose can help, where that is known beforehand."""
    pose_filter: PoseFilter | None = None
    """Rules base poses out."""
    goes_home: PoseMask | None = None
    """From which base poses the arm can be brought home once the task is done; others are answers
    where none of these is one. None: from all."""
    leads_on: LeadsOn | None = None
    """Whether the robot can drive on from a base pose once the task is done; others are answers
    where no search finds one. None: nobody asks."""
    region: BaseRegion = ANYWHERE
    """Where the base is allowed to stand."""
    rules: tuple[Rule, ...] = ()
    """Further conditions on base poses."""
    fit: FitPoses | None = None
    """Finds base poses beside given ones from which an arm of few joints can do the task."""
