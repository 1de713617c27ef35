"""The search: samples in A, most promising first, checked until nothing cheaper can remain."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.stats import qmc

from momapos.placement.area import BLOCKED, CLEAR, OFF_FLOOR, Site, in_world, sampling_box, standing, task_frame
from momapos.placement.order import by_expected_cost, open_tours
from momapos.placement.potential import attraction
from momapos.protocols import ReachScorer, TravelCost
from momapos.types import Attempt, Candidates, Motion

Method = Literal["ours", "paper", "exhaustive"]
FEASIBLE = "feasible"
REASONS = {BLOCKED: "base blocked", OFF_FLOOR: "base off the floor", 3: "farther than the arm"}
NO_REACH, NO_WAY, NOT_TRIED = "out of reach", "no way to drive there", "not tried"
NO_PATH = "no free arm path over the waypoints"


@dataclass(frozen=True)
class PlaceConfig:
    """How base poses are sampled, ordered and checked."""

    method: Method = "ours"
    """ours: by expected cost; paper: open tours over groups; exhaustive: a grid."""
    count: int = 512
    """Latin Hypercube samples in the first round [-]; each further round has twice as many."""
    rounds: int = 3
    """Rounds before the grid decides [-]."""
    grasps: int = 24
    """Grasps tried at one base pose, best reached first [-]."""
    improve: int = 4
    """Cheaper candidates that are still tried after the first success [-]."""
    miss: float = 2.0
    """Driving length that a certain miss is worth [m]."""
    group: int = 10
    """T: candidates in one open tour (paper) [-]."""
    k_distance: float = 5 / 6
    """k1: weight of distance in the open tour (paper) [-]."""
    k_potential: float = 1 / 6
    """k1': weight of potential in the open tour (paper) [-]."""
    grid_cell: float = 0.05
    """Cell of the exhaustive grid [m]."""
    grid_turn: float = 10.0
    """Turn between yaws of the exhaustive grid [deg]."""
    clearance: float = 0.01
    """Distance that the base keeps from everything [m]."""


AttemptPose = Callable[[Float[np.ndarray, "3"], Int[np.ndarray, " k"]], Attempt]
"""Check one base pose with some grasps, best first."""


ScreenPoses = Callable[
    [Float[np.ndarray, "n 3"], Float[np.ndarray, "n g"]], Bool[np.ndarray, " n"]
]
"""Tell at which base poses some grasp has an arm path, from the scores of all grasps."""


@dataclass
class Search:
    """What has been looked at so far, and the best of it."""

    poses: list[Float[np.ndarray, "n 3"]] = field(default_factory=list)
    reasons: list[np.ndarray] = field(default_factory=list)
    checked: int = 0
    base: Float[np.ndarray, "3"] | None = None
    motion: Motion | None = None
    cost: float = np.inf
    timed_out: bool = False

    def candidates(self) -> Candidates:
        """Counts for the plan."""
        every = np.concatenate(self.reasons) if self.reasons else np.zeros(0, object)
        counts = Counter(r for r in every.tolist() if r not in (FEASIBLE, NOT_TRIED))
        return Candidates(len(every), self.checked, dict(counts.most_common()))


def search(
    site: Site,
    reach: ReachScorer,
    travel_cost: TravelCost,
    attempt: AttemptPose,
    screen: ScreenPoses,
    config: PlaceConfig,
    rng: np.random.Generator,
    *,
    start: Float[np.ndarray, "3"],
    out_of_time: Callable[[], bool],
) -> Search:
    """Find the cheapest base pose that works.

    Args:
        site: Room and task.
        reach: The robot's reachability map.
        travel_cost: Driving lengths.
        attempt: Checks one base pose completely.
        screen: Checks many base poses for an arm path alone; the grid needs it.
        config: How to search.
        rng: Source of the samples.
        start: Where the robot is: x [m], y [m], yaw [rad].
        out_of_time: Asked between candidates.

    Returns:
        The best pose found, if any, and what became of all others.
    """
    found = Search()
    corners = sampling_box(site)
    if corners is None:
        found.poses.append(np.zeros((1, 3)))
        found.reasons.append(np.array([f"{NO_REACH} at any distance"], object))
        return found
    frame = task_frame(site)
    for local, on_grid in _rounds(corners, config, rng):
        _try(
            site, in_world(frame, local), on_grid, reach, travel_cost, attempt, screen, config, start,
            out_of_time, found,
        )  # fmt: skip
        if found.motion is not None or found.timed_out:
            break
    return found


def _rounds(
    corners: Float[np.ndarray, "2 2"], config: PlaceConfig, rng: np.random.Generator
) -> Iterator[tuple[Float[np.ndarray, "n 3"], bool]]:
    """Samples of every round, in the task's frame; the grid last (True), for its "no"."""
    if config.method != "exhaustive":
        for r in range(config.rounds):
            unit = qmc.LatinHypercube(3, rng=rng).random(config.count * 2**r)
            low, high = np.append(corners[0], -np.pi), np.append(corners[1], np.pi)
            yield low + unit * (high - low), False
    x, y = (
        np.arange(np.floor(lo / config.grid_cell), np.ceil(hi / config.grid_cell) + 1)
        * config.grid_cell
        for lo, hi in corners.T
    )
    yaw = np.radians(np.arange(-180.0, 180.0, config.grid_turn))
    yield np.stack(np.meshgrid(x, y, yaw, indexing="ij"), -1).reshape(-1, 3), True


def _try(
    site: Site, poses: np.ndarray, on_grid: bool, reach: ReachScorer, travel_cost: TravelCost,
    attempt: AttemptPose, screen: ScreenPoses, config: PlaceConfig, start: np.ndarray,
    out_of_time: Callable[[], bool], found: Search,
) -> None:  # fmt: skip
    """Cull one round's poses, order what is left, and check it."""
    outcome, _ = standing(site, poses)
    reasons = np.full(len(poses), NOT_TRIED, object)
    for value, word in REASONS.items():
        reasons[outcome == value] = word
    clear = np.flatnonzero(outcome == CLEAR)
    travel = travel_cost(poses[clear, :2])
    reasons[clear[np.isinf(travel)]] = NO_WAY
    clear, travel = clear[np.isfinite(travel)], travel[np.isfinite(travel)]
    scores = reach.weakest(poses[clear], site.Ts_world_tool)
    best = scores.max(1, initial=0.0)
    reasons[clear[best <= 0]] = NO_REACH
    clear, travel, scores = clear[best > 0], travel[best > 0], scores[best > 0]
    if on_grid:
        passed = screen(poses[clear], scores)
        found.checked += len(clear)
        reasons[clear[~passed]] = NO_PATH
        reasons[clear[passed]] = FEASIBLE
        clear, travel, scores = clear[passed], travel[passed], scores[passed]
        order = np.argsort(travel, kind="stable")
    else:
        order = _order(site, poses[clear], travel, scores, config, start)
    left = config.improve
    for i in order:
        if travel[i] >= found.cost - 1e-9:
            continue
        if found.motion is not None:
            if on_grid or config.method == "paper" or left == 0:
                break
            left -= 1
        if out_of_time():
            found.timed_out = found.motion is None
            break
        grasps = np.argsort(-scores[i], kind="stable")
        grasps = grasps[scores[i, grasps] > 0]
        result = attempt(poses[clear[i]], grasps if on_grid else grasps[: config.grasps])
        found.checked += not on_grid
        reasons[clear[i]] = result.reason or FEASIBLE
        if result.motion is not None:
            found.base, found.motion, found.cost = poses[clear[i]], result.motion, travel[i]
    found.poses.append(poses)
    found.reasons.append(reasons)


def _order(
    site: Site, poses: np.ndarray, travel: np.ndarray, scores: np.ndarray, config: PlaceConfig,
    start: np.ndarray,
) -> Int[np.ndarray, " n"]:
    if not len(poses):
        return np.zeros(0, int)
    field_value = attraction(site, poses[:, :2], np.array([site.shoulder[2]]))
    potential = scores.max(1) + field_value
    if config.method == "paper":
        return open_tours(
            start[:2], poses[:, :2], potential, group=config.group,
            k_distance=config.k_distance, k_potential=config.k_potential,
        )
    # A pose that many grasps reach is worth more than one that a single grasp reaches well.
    share = np.clip((scores > 0).mean(1) * 4, 0.0, 1.0)
    odds = np.clip(0.4 * scores.max(1) + 0.4 * share + 0.2 * np.sqrt(field_value), 0.0, 1.0)
    return by_expected_cost(travel, odds, miss=config.miss)


