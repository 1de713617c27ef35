"""Test the search with fake stages that decide which poses work and what they cost."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest
from jaxtyping import Bool, Float, Int

from momapos.model.records.outcomes import PoseOutcome, PoseStatus
from momapos.model.records.plans import ArmPathResult, Attempt, Motion
from momapos.model.records.protocols import ReachScorer
from momapos.planning.placement.area import PlacementGeometry, clears_sweep
from momapos.planning.placement.config import Method, PlaceConfig
from momapos.planning.placement.grasp_scores import GraspModeScores, grasp_mode_scorers
from momapos.planning.placement.pose_search import search
from momapos.planning.placement.problem import BasePoseRule, Problem, Search
from rooms import Everywhere

MOTION = Motion(np.zeros((1, 6)), np.zeros((1, 6)), np.zeros(1), np.eye(4)[None])
FEASIBLE, NO_APPROACH = PoseOutcome(PoseStatus.FEASIBLE), PoseOutcome(PoseStatus.NO_APPROACH)
FOUND = ArmPathResult(0, np.zeros((1, 6)), PoseOutcome(PoseStatus.PATH_FOUND))
MISSED = ArmPathResult(-1, None, PoseOutcome(PoseStatus.NO_GRASP_IN_REACH))
NO_PATH = PoseOutcome(PoseStatus.BASE_PATH_BLOCKED)
Works = Callable[[Float[np.ndarray, "n 3"]], Bool[np.ndarray, " n"]]
START = np.array([0.0, -2.5, np.pi / 2])


@dataclass
class FakeDeparture:
    """A departure check that the given poses pass; it may know the failures beforehand."""

    which: Works
    knows: bool = False
    checked: list[np.ndarray] = field(default_factory=list)

    def __call__(self, base: Float[np.ndarray, "3"]) -> bool:
        self.checked.append(base)
        return bool(self.which(base[None])[0])

    def is_known_blocked(self, base: Float[np.ndarray, "3"]) -> bool:
        return self.knows and not self.which(base[None])[0]


def always(poses: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
    return np.ones(len(poses), bool)


def never(poses: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
    return np.zeros(len(poses), bool)


def left(poses: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
    return poses[:, 0] < -0.3


def find(
    geometry: PlacementGeometry,
    path: Works,
    whole: Works,
    *,
    method: Method = "ours",
    seed: int = 0,
    home_is_free: Works | None = None,
    departure: FakeDeparture | None = None,
    reached: Works | None = None,
    path_rule: Works | None = None,
    **changes: int | float,
) -> Search:
    def screen(
        bases: Float[np.ndarray, "n 3"], scores: Float[np.ndarray, "n g"], _most: int | None
    ) -> list[ArmPathResult]:
        assert (scores.max(1) > 0).all()
        good = path(bases)
        return [FOUND if g else MISSED for g in good]

    def attempt(
        base: Float[np.ndarray, "3"], screened: ArmPathResult, _grasps: Int[np.ndarray, " k"]
    ) -> Attempt:
        assert screened.q is not None
        assert path(base[None])[0]
        return Attempt(MOTION, FEASIBLE) if whole(base[None])[0] else Attempt(None, NO_APPROACH)

    def length(places: Float[np.ndarray, "n k"]) -> Float[np.ndarray, " n"]:
        return np.linalg.norm(places[:, :2] - START[:2], axis=1)

    def score(_: ReachScorer, poses: Float[np.ndarray, "n 3"]) -> GraspModeScores:
        return GraspModeScores(reached(poses)[:, None].astype(np.float32), 1)

    scorers = grasp_mode_scorers(geometry.Ts_world_tool, np.zeros((0, 1), int))
    scorers = scorers if reached is None else (score,)
    rule = BasePoseRule(lambda poses, _: (path_rule or always)(poses), NO_PATH)
    problem = Problem(
        geometry, Everywhere(), Everywhere(), scorers, length, attempt, screen, START,
        home_is_free=home_is_free, departure=departure,
        path_rules=() if path_rule is None else (rule,),
    )  # fmt: skip
    coarse = {"grid_cell": 0.2, "grid_turn": 45.0}
    config = PlaceConfig(method=method, **{**coarse, **changes})  # type: ignore[arg-type]
    return search(problem, config, np.random.default_rng(seed))


@pytest.mark.parametrize("method", ["ours", "exhaustive"])
@pytest.mark.parametrize("which", [always, left])
def test_a_pose_that_works_is_found_and_its_cost_is_the_driving_length(
    geometry: PlacementGeometry, method: Method, which: Works
) -> None:
    found = find(geometry, which, which, method=method)
    assert which(found.base[None])[0]
    assert found.cost == pytest.approx(np.linalg.norm(found.base[:2] - START[:2]))
    assert list(np.concatenate(found.outcomes)).count(FEASIBLE) == 1


def test_the_grid_search_returns_its_cheapest_pose(geometry: PlacementGeometry) -> None:
    found = find(geometry, left, left, method="exhaustive", whole_grid=True)
    poses = np.concatenate(found.poses)
    passed = poses[[one in (FOUND.outcome, FEASIBLE) for one in np.concatenate(found.outcomes)]]
    assert len(passed) > 10
    assert found.cost == pytest.approx(np.linalg.norm(passed[:, :2] - START[:2], axis=1).min())


@pytest.mark.parametrize("changes", [{}, {"rounds": 0}, {"polish": 4}])
def test_poses_from_which_the_arm_can_return_home_come_first(
    geometry: PlacementGeometry, changes: dict[str, int]
) -> None:
    """Poses left of the door are farther from the start than poses right of it."""
    free = find(geometry, always, always, **changes)
    assert not left(free.base[None])[0]
    home = find(geometry, always, always, home_is_free=left, **changes)
    assert left(home.base[None])[0]
    assert home.cost > free.cost


@pytest.mark.parametrize("changes", [{}, {"rounds": 0}])
def test_no_solution_is_lost_if_the_arm_cannot_return_home(
    geometry: PlacementGeometry, changes: dict[str, int]
) -> None:
    plain = find(geometry, left, left, **changes)
    no_home = find(geometry, left, left, home_is_free=never, **changes)
    assert plain.base is not None
    assert left(no_home.base[None])[0]

    def right(poses: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        return ~left(poses)

    other_home = find(geometry, left, left, home_is_free=right, **changes)
    assert left(other_home.base[None])[0]


@pytest.mark.parametrize("knows", [False, True])
@pytest.mark.parametrize("changes", [{}, {"rounds": 0}, {"polish": 4}])
def test_poses_from_which_the_robot_can_drive_on_come_first(
    geometry: PlacementGeometry, changes: dict[str, int], knows: bool
) -> None:
    """Poses left of the door are farther from the start than poses right of it."""
    departure = FakeDeparture(left, knows)
    on = find(geometry, always, always, departure=departure, **changes)
    assert left(on.base[None])[0]
    assert not left(on.fallback[0][None])[0]
    assert on.fallback[2] < on.cost
    on.accept_fallback()
    assert left(on.base[None])[0]
    assert not on.blocked_in
    assert len(departure.checked) == 2 or not knows


@pytest.mark.parametrize("changes", [{}, {"rounds": 0}])
def test_a_pose_that_blocks_the_robot_in_is_the_fallback(
    geometry: PlacementGeometry, changes: dict[str, int]
) -> None:
    departure = FakeDeparture(never, knows=True)
    found = find(geometry, always, left, departure=departure, **changes)
    assert found.is_no
    assert len(departure.checked) == 1
    found.accept_fallback()
    assert left(found.base[None])[0]
    assert found.blocked_in
    assert found.cost == pytest.approx(np.linalg.norm(found.base[:2] - START[:2]))


def test_the_chosen_pose_tolerates_position_errors(geometry: PlacementGeometry) -> None:
    def stripes(poses: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        # Works in stripes of 8 cm, every 12 cm.
        return poses[:, 0] % 0.12 < 0.08

    def inside(found: Search) -> bool:
        return bool(0.02 <= found.base[0] % 0.12 < 0.06)

    seeds = range(8)
    options = {"count": 64, "margin": 0.02}
    some = [find(geometry, stripes, always, seed=seed, compared=0, **options) for seed in seeds]
    assert not all(inside(found) for found in some)
    all_of_it = [
        find(geometry, stripes, always, seed=seed, compared=64, **options) for seed in seeds
    ]
    assert all(inside(found) for found in all_of_it)


def test_robustness_costs_little_more_driving_than_the_margin(geometry: PlacementGeometry) -> None:
    grid = find(geometry, left, always, method="exhaustive", grid_cell=0.05, grid_turn=15.0)
    for seed in range(8):
        found = find(geometry, left, always, seed=seed, sweep_clearance=0.0, margin=0.02)
        assert found.robustness == 1.0
        assert found.cost < grid.cost + 0.1


def test_the_search_steps_to_equally_robust_poses_where_none_is_fully_robust(
    geometry: PlacementGeometry,
) -> None:
    everything = 3.0  # wider than the scene: no pose is fully robust
    costs = [
        find(geometry, always, always, sweep_clearance=everything, polish=n, count=64).cost
        for n in (0, 16)
    ]
    assert costs[1] < costs[0] - 0.05


def test_without_polish_the_first_pose_that_works_is_taken_at_once(
    geometry: PlacementGeometry,
) -> None:
    checked = []
    for polish in (0, 16):
        found = find(geometry, always, always, polish=polish, batch=1, count=64)
        assert found.motion is not None
        checked.append(found.checked)
        assert (found.robustness is None) is (polish == 0)
    assert checked[0] == 1 < checked[1]


def test_where_the_grid_reaches_nothing_no_further_round_is_sampled(
    geometry: PlacementGeometry,
) -> None:
    def nowhere(poses: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        return np.zeros(len(poses), bool)

    found = find(geometry, always, always, reached=nowhere, count=64)
    assert found.is_no
    samples, _grid = found.poses
    assert len(samples) == 64
    nothing_works = find(geometry, nowhere, always, reached=left, count=64)
    assert len(nothing_works.poses) == 4  # three rounds and the grid


def test_a_pose_is_found_where_none_is_robust(geometry: PlacementGeometry) -> None:
    def narrow_stripes(poses: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        return poses[:, 0] % 0.03 < 0.01

    found = find(geometry, narrow_stripes, always, compared=2, count=64)
    assert found.base[0] % 0.03 < 0.01


def test_checking_more_candidates_never_costs_more(geometry: PlacementGeometry) -> None:
    costs = [find(geometry, always, always, batch=n, polish=0).cost for n in (1, 2, 8, 32)]
    assert costs == sorted(costs, reverse=True)
    steps = [find(geometry, always, always, batch=1, polish=n, count=32).cost for n in (0, 1, 2, 4)]
    assert steps == sorted(steps, reverse=True)
    assert steps[-1] < steps[0] - 0.05


def test_the_base_keeps_clear_of_the_moving_part_where_possible(
    geometry: PlacementGeometry,
) -> None:
    clearance = 0.5

    def close_passes(sweep_clearance: float) -> int:
        answers = [
            find(
                geometry, always, always, seed=seed, count=64, sweep_clearance=sweep_clearance
            ).base
            for seed in range(8)
        ]
        return sum(
            not clears_sweep(geometry, base[None], clearance)[0]
            for base in answers
            if base is not None
        )

    assert close_passes(clearance) == 0 < close_passes(0.0)


def test_if_a_path_cannot_be_completed_the_next_is_tried(geometry: PlacementGeometry) -> None:
    found = find(geometry, always, left)
    assert found.base[0] < -0.3
    assert NO_APPROACH in np.concatenate(found.outcomes)


def test_where_nothing_works_every_pose_has_a_reason(geometry: PlacementGeometry) -> None:
    for path, whole, reason in ((never, never, MISSED.outcome), (always, never, NO_APPROACH)):
        found = find(geometry, path, whole, count=32, rounds=1)
        assert found.motion is None
        assert not found.timed_out
        rejections = found.candidates().rejections
        assert sum(rejections.values()) == found.candidates().sampled
        assert rejections[str(reason)] == found.checked


@pytest.mark.parametrize("method", ["ours", "exhaustive"])
def test_slow_rules_are_evaluated_only_at_poses_from_which_a_grasp_is_within_reach(
    geometry: PlacementGeometry, method: Method
) -> None:
    queried: list[np.ndarray] = []

    def path_rule(poses: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        queried.append(poses)
        return poses[:, 1] < 0.0

    found = find(
        geometry, never, never, method=method, reached=left, path_rule=path_rule, count=64, rounds=1
    )
    every, outcomes = np.concatenate(found.poses), np.concatenate(found.outcomes)
    assert left(np.concatenate(queried)).all()
    status = np.array([one.status for one in outcomes])
    blocked = every[status == PoseStatus.BASE_PATH_BLOCKED]
    assert len(blocked)
    assert (left(blocked) & (blocked[:, 1] >= 0.0)).all()
    assert not left(every[status == PoseStatus.OUT_OF_REACH]).any()
    assert found.checked == (outcomes == MISSED.outcome).sum() > 0
