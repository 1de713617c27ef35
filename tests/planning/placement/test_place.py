"""The search, with stages that are made up: which poses work, and what they cost."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest
from jaxtyping import Bool, Float, Int

from momapos.model.records.outcomes import PoseOutcome, PoseStatus
from momapos.model.records.plans import ArmPathResult, Attempt, Motion
from momapos.planning.placement.area import PlacementGeometry, clear_of_sweep
from momapos.planning.placement.config import Method, PlaceConfig
from momapos.planning.placement.grasp_scores import ways_of_holding
from momapos.planning.placement.pose_search import search
from momapos.planning.placement.problem import Problem, Search
from rooms import Everywhere

MOTION = Motion(np.zeros((1, 6)), np.zeros((1, 6)), np.zeros(1), np.eye(4)[None])
FEASIBLE, NO_APPROACH = PoseOutcome(PoseStatus.FEASIBLE), PoseOutcome(PoseStatus.NO_APPROACH)
FOUND = ArmPathResult(0, np.zeros((1, 6)), PoseOutcome(PoseStatus.PATH_FOUND))
MISSED = ArmPathResult(-1, None, PoseOutcome(PoseStatus.NO_GRASP_IN_REACH))
Works = Callable[[Float[np.ndarray, "n 3"]], Bool[np.ndarray, " n"]]
START = np.array([0.0, -2.5, np.pi / 2])


@dataclass
class Leads:
    """Where base poses lead on, and whether others are known not to once one was looked at."""

    which: Works
    knows: bool = False
    looked: list[np.ndarray] = field(default_factory=list)

    def __call__(self, base: Float[np.ndarray, "3"]) -> bool:
        self.looked.append(base)
        return bool(self.which(base[None])[0])

    def hopeless(self, base: Float[np.ndarray, "3"]) -> bool:
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
    goes_home: Works | None = None,
    leads_on: Leads | None = None,
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

    def length(xy: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
        return np.linalg.norm(xy - START[:2], axis=1)

    ways = ways_of_holding(geometry.Ts_world_tool, np.zeros((0, 1), int))
    problem = Problem(
        geometry, Everywhere(), Everywhere(), ways, length, attempt, screen, START, lambda: False,
        goes_home=goes_home, leads_on=leads_on,
    )  # fmt: skip
    coarse = {"grid_cell": 0.2, "grid_turn": 45.0}
    config = PlaceConfig(method=method, **{**coarse, **changes})  # type: ignore[arg-type]
    return search(problem, config, np.random.default_rng(seed))


@pytest.mark.parametrize("method", ["ours", "exhaustive"])
@pytest.mark.parametrize("which", [always, left])
def test_a_pose_that_works_is_found_and_its_cost_is_the_way_there(
    geometry: PlacementGeometry, method: Method, which: Works
) -> None:
    found = find(geometry, which, which, method=method)
    assert found.base is not None
    assert which(found.base[None])[0]
    assert found.cost == pytest.approx(np.linalg.norm(found.base[:2] - START[:2]))
    assert list(np.concatenate(found.outcomes)).count(FEASIBLE) == 1


def test_the_grid_gives_the_cheapest_of_its_poses(geometry: PlacementGeometry) -> None:
    found = find(geometry, left, left, method="exhaustive", whole_grid=True)
    poses = np.concatenate(found.poses)
    passed = poses[[one in (FOUND.outcome, FEASIBLE) for one in np.concatenate(found.outcomes)]]
    assert len(passed) > 10
    assert found.cost == pytest.approx(np.linalg.norm(passed[:, :2] - START[:2], axis=1).min())


@pytest.mark.parametrize("changes", [{}, {"rounds": 0}, {"improve": 4}])
def test_where_the_arm_can_be_brought_home_afterward_comes_first(
    geometry: PlacementGeometry, changes: dict[str, int]
) -> None:
    """Left of the door poses are farther from the start than right of it."""
    free = find(geometry, always, always, **changes)
    assert free.base is not None
    assert not left(free.base[None])[0]
    home = find(geometry, always, always, goes_home=left, **changes)
    assert home.base is not None
    assert left(home.base[None])[0]
    assert home.cost > free.cost


@pytest.mark.parametrize("changes", [{}, {"rounds": 0}])
def test_no_answer_is_lost_where_the_arm_cannot_be_brought_home(
    geometry: PlacementGeometry, changes: dict[str, int]
) -> None:
    plain = find(geometry, left, left, **changes)
    nowhere = find(geometry, left, left, goes_home=never, **changes)
    assert plain.base is not None
    assert nowhere.base is not None
    assert left(nowhere.base[None])[0]

    def right(poses: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        return ~left(poses)

    elsewhere = find(geometry, left, left, goes_home=right, **changes)
    assert elsewhere.base is not None
    assert left(elsewhere.base[None])[0]


@pytest.mark.parametrize("knows", [False, True])
@pytest.mark.parametrize("changes", [{}, {"rounds": 0}, {"improve": 4}])
def test_where_the_robot_can_drive_on_afterward_comes_first(
    geometry: PlacementGeometry, changes: dict[str, int], knows: bool
) -> None:
    """Left of the door poses are farther from the start than right of it."""
    leads = Leads(left, knows)
    on = find(geometry, always, always, leads_on=leads, **changes)
    assert on.base is not None
    assert left(on.base[None])[0]
    assert on.spare is not None
    assert not left(on.spare[0][None])[0]
    assert on.spare[2] < on.cost
    on.settle()
    assert left(on.base[None])[0]
    assert not on.shut_in
    assert len(leads.looked) == 2 or not knows


@pytest.mark.parametrize("changes", [{}, {"rounds": 0}])
def test_no_answer_is_lost_where_the_robot_cannot_drive_on(
    geometry: PlacementGeometry, changes: dict[str, int]
) -> None:
    leads = Leads(never, knows=True)
    found = find(geometry, always, left, leads_on=leads, **changes)
    assert found.is_no
    assert len(leads.looked) == 1
    found.settle()
    assert found.base is not None
    assert left(found.base[None])[0]
    assert found.shut_in
    assert found.cost == pytest.approx(np.linalg.norm(found.base[:2] - START[:2]))


def test_the_base_may_end_beside_the_pose_that_is_chosen(geometry: PlacementGeometry) -> None:
    def stripes(poses: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        # Works in stripes of 8 cm, every 12 cm.
        return poses[:, 0] % 0.12 < 0.08

    def inside(found: Search) -> bool:
        assert found.base is not None
        return bool(0.02 <= found.base[0] % 0.12 < 0.06)

    seeds = range(8)
    asked = {"count": 64, "margin": 0.02}
    some = [find(geometry, stripes, always, seed=seed, looks=0, **asked) for seed in seeds]
    assert not all(inside(found) for found in some)
    all_of_it = [find(geometry, stripes, always, seed=seed, looks=64, **asked) for seed in seeds]
    assert all(inside(found) for found in all_of_it)


def test_room_beside_the_base_costs_little_more_than_the_room(geometry: PlacementGeometry) -> None:
    grid = find(geometry, left, always, method="exhaustive", grid_cell=0.05, grid_turn=15.0)
    for seed in range(8):
        found = find(geometry, left, always, seed=seed, sweep_room=0.0, margin=0.02)
        assert found.margin == 1.0
        assert found.cost < grid.cost + 0.1


def test_poses_with_as_little_room_are_stepped_to_where_there_is_no_more(
    geometry: PlacementGeometry,
) -> None:
    everything = 3.0  # wider than the room: no pose has all of its margin
    costs = [
        find(geometry, always, always, sweep_room=everything, improve=n, count=64).cost
        for n in (0, 16)
    ]
    assert costs[1] < costs[0] - 0.05


def test_where_no_pose_has_a_margin_the_answer_is_still_found(
    geometry: PlacementGeometry,
) -> None:
    def hair(poses: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        return poses[:, 0] % 0.03 < 0.01

    found = find(geometry, hair, always, looks=2, count=64)
    assert found.base is not None
    assert found.base[0] % 0.03 < 0.01


def test_looking_at_more_candidates_never_makes_the_answer_dearer(
    geometry: PlacementGeometry,
) -> None:
    costs = [find(geometry, always, always, together=n, improve=0).cost for n in (1, 2, 8, 32)]
    assert costs == sorted(costs, reverse=True)
    steps = [
        find(geometry, always, always, together=1, improve=n, count=32).cost for n in (0, 1, 2, 4)
    ]
    assert steps == sorted(steps, reverse=True)
    assert steps[-1] < steps[0] - 0.05


def test_a_base_keeps_room_from_what_sweeps_past_it_where_it_can(
    geometry: PlacementGeometry,
) -> None:
    room = 0.5

    def close(kept: float) -> int:
        answers = [
            find(geometry, always, always, seed=seed, count=64, sweep_room=kept).base
            for seed in range(8)
        ]
        return sum(
            not clear_of_sweep(geometry, base[None], room)[0]
            for base in answers
            if base is not None
        )

    assert close(room) == 0 < close(0.0)


def test_where_a_path_cannot_be_completed_the_next_is_tried(geometry: PlacementGeometry) -> None:
    found = find(geometry, always, left)
    assert found.base is not None
    assert found.base[0] < -0.3
    assert NO_APPROACH in np.concatenate(found.outcomes)


def test_nothing_is_found_where_nothing_works_and_every_pose_has_a_reason(
    geometry: PlacementGeometry,
) -> None:
    for path, whole, reason in ((never, never, MISSED.outcome), (always, never, NO_APPROACH)):
        found = find(geometry, path, whole, count=32, rounds=1)
        assert found.motion is None
        assert not found.timed_out
        rejections = found.candidates().rejections
        assert sum(rejections.values()) == found.candidates().sampled
        assert rejections[str(reason)] == found.checked
