"""Test the planner of free motions in a plane with an obstacle."""

from __future__ import annotations

import time

import numpy as np
import pytest
from tests.urdf_parts import LIMIT, joint, link

from momapos.model.collision.collision_world import build_world
from momapos.model.collision.self_collision import arm_spheres
from momapos.model.collision.spheres import Spheres
from momapos.model.collision.straight_motions import StraightMotions, build_motions
from momapos.model.kinematics.chain import Chain, build_chain
from momapos.model.urdf.articulated import Articulated
from momapos.model.urdf.hulls import Boxes, MovingBoxes
from momapos.model.urdf.reader import read_urdf
from momapos.planning.arm_motion.arm_planner import (
    PREFERRED_CLEARANCE,
    RESOLUTION,
    _Budget,
    connect,
    interpolate,
    ompl_path,
    plan_motion,
    plan_with_clearance,
)
from momapos.planning.arm_motion.config import Planner, PlannerConfig

LOW, HIGH = np.full(2, -3.0), np.full(2, 3.0)
A, B = np.array([-2.0, 0.0]), np.array([2.0, 0.0])
BALL = 0.01
"""Radius of the ball that the gantry moves [m]."""


@pytest.fixture(scope="module")
def gantry(tmp_path_factory: pytest.TempPathFactory) -> tuple[Chain, Spheres]:
    """Return a ball that two rails move in a plane one meter above the floor."""
    limit = LIMIT.format(-3, 3)
    parts = [
        link("base_link"),
        joint("x", "prismatic", "base_link", "rail", "0 0 1", "1 0 0", limit),
        link("rail"),
        joint("y", "prismatic", "rail", "ball", "0 0 0", "0 1 0", limit),
        link("ball", f'<sphere radius="{BALL}"/>'),
    ]
    file = tmp_path_factory.mktemp("gantry") / "gantry.urdf"
    file.write_text(f'<robot name="gantry">{"".join(parts)}</robot>')
    model = Articulated(read_urdf(file))
    chain, segments = build_chain(model, "base_link", "ball", ["x", "y"])
    return chain, arm_spheres(model, chain, segments, frozenset(), ["ball"])


def motions_of(
    gantry: tuple[Chain, Spheres],
    *boxes: tuple[float, float, float, float],
    extra: float = 0.0,
    fine: bool = False,
) -> StraightMotions:
    """Return the check of the gantry's motions between boxes: center and half edges [m]."""
    chain, spheres = gantry
    rows = np.array(boxes).reshape(-1, 4)
    height, turn = np.ones((len(rows), 1)), np.tile(np.eye(3), (len(rows), 1, 1))
    static = Boxes(np.hstack([rows[:, :2], height]), turn, np.hstack([rows[:, 2:], height]))
    none = MovingBoxes(np.zeros((1, 0, 3)), np.zeros((1, 0, 3, 3)), np.zeros((1, 0, 3)))
    world = build_world(static, none, np.zeros(0, bool), [""] * len(boxes), spheres, clearance=0.0)
    return build_motions(
        world, chain, spheres, np.zeros(3), value=0, holding=False, step=RESOLUTION,
        extra_clearance=extra, fine=fine,
    )  # fmt: skip


BLOCK = (0.0, 0.0, 1.0, 1.0)
WALL = (0.0, 0.0, 0.1, 3.1)
ALGORITHMS: list[Planner | None] = [None, "RRTConnect", "RRTstar", "BITstar"]


def test_a_free_straight_line_is_the_path(gantry: tuple[Chain, Spheres]) -> None:
    free = motions_of(gantry, (0.0, 2.0, 0.5, 0.5))
    path = plan_motion(A, B, LOW, HIGH, free, config=PlannerConfig(), seed=0)
    np.testing.assert_array_equal(path, [A, B])


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_a_path_around_the_obstacle_is_free_and_keeps_its_ends(
    gantry: tuple[Chain, Spheres], algorithm: Planner | None
) -> None:
    free = motions_of(gantry, BLOCK)
    config = PlannerConfig(planner=algorithm, checks=3000)
    path = plan_motion(A, B, LOW, HIGH, free, config=config, seed=3)
    assert len(path) > 2
    np.testing.assert_array_equal(path[[0, -1]], [A, B])
    assert (np.abs(path) <= 3.0 + 1e-9).all()
    # Checked states are RESOLUTION apart, so a corner may be cut by half of it.
    inside = np.abs(interpolate(path, 1e-3)).max(1) < 1.0 + BALL - 0.5 * RESOLUTION
    assert not inside.any()


@pytest.mark.parametrize("seed", range(5))
def test_our_path_is_nearly_the_shortest(gantry: tuple[Chain, Spheres], seed: int) -> None:
    path = plan_motion(
        A, B, LOW, HIGH, motions_of(gantry, BLOCK), config=PlannerConfig(), seed=seed
    )
    length = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
    assert length < 1.1 * (2 * np.hypot(1.0, 1.0) + 2.0)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_the_same_seed_gives_the_same_path(
    gantry: tuple[Chain, Spheres], algorithm: Planner | None
) -> None:
    free, config = motions_of(gantry, BLOCK), PlannerConfig(planner=algorithm, checks=400)
    paths = [plan_motion(A, B, LOW, HIGH, free, config=config, seed=5) for _ in range(2)]
    assert paths[0] is not None
    np.testing.assert_array_equal(*paths)


def test_other_seeds_give_other_paths(gantry: tuple[Chain, Spheres]) -> None:
    free = motions_of(gantry, BLOCK)
    paths = [
        plan_motion(A, B, LOW, HIGH, free, config=PlannerConfig(), seed=seed) for seed in range(4)
    ]
    assert len({path.tobytes() for path in paths if path is not None}) > 1


@pytest.mark.parametrize("algorithm", ["RRTConnect", "RRTstar", "BITstar"])
def test_a_path_of_ompl_does_not_depend_on_speed(
    gantry: tuple[Chain, Spheres], algorithm: Planner
) -> None:
    free = motions_of(gantry, BLOCK)

    def slowly(a: np.ndarray, b: np.ndarray) -> bool:
        time.sleep(5e-4)
        return free(a, b)

    paths = [
        ompl_path(
            A, B, LOW, HIGH, check, planner=algorithm, checks=400, step=RESOLUTION, seed=5
        )
        for check in (free, slowly)
    ]  # fmt: skip
    assert paths[0] is not None
    np.testing.assert_array_equal(*paths)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_there_is_no_path_from_or_to_a_state_in_collision(
    gantry: tuple[Chain, Spheres], algorithm: Planner | None
) -> None:
    free, config = motions_of(gantry, BLOCK), PlannerConfig(planner=algorithm, checks=100)
    for start, goal in ((A, np.zeros(2)), (np.zeros(2), B)):
        assert plan_motion(start, goal, LOW, HIGH, free, config=config, seed=0) is None


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_the_search_for_a_path_through_a_closed_wall_ends(
    gantry: tuple[Chain, Spheres], algorithm: Planner | None
) -> None:
    config = PlannerConfig(planner=algorithm, checks=500)
    free = motions_of(gantry, WALL)
    assert plan_motion(A, B, LOW, HIGH, free, config=config, seed=0) is None


@pytest.mark.parametrize("checks", [1, 2, 50, 500])
def test_our_search_spends_no_more_than_its_checks(
    gantry: tuple[Chain, Spheres], checks: int
) -> None:
    path, spent = connect(A, B, LOW, HIGH, motions_of(gantry, WALL).arrays, checks, 0)
    assert path.shape == (0, 2)
    assert 0 < spent <= checks + 1


def test_ompl_spends_no_more_than_its_checks(gantry: tuple[Chain, Spheres]) -> None:
    checks, free = [], motions_of(gantry, WALL)

    def counted(a: np.ndarray, b: np.ndarray) -> bool:
        checks.append(not np.array_equal(a, b))
        return free(a, b)

    path = ompl_path(
        A, B, LOW, HIGH, counted, planner="RRTConnect", checks=500, step=RESOLUTION, seed=0
    )
    assert path is None
    assert 500 < sum(checks) < 550  # a turn checks several


@pytest.mark.parametrize("algorithm", ["RRTstar", "BITstar"])
def test_a_planner_that_shortens_its_path_ends_with_the_first_one_unless_it_optimizes(
    gantry: tuple[Chain, Spheres], algorithm: Planner
) -> None:
    free = motions_of(gantry, BLOCK)

    def search(*, optimize: bool) -> tuple[int, float]:
        checks = []

        def counted(a: np.ndarray, b: np.ndarray) -> bool:
            checks.append(not np.array_equal(a, b))
            return free(a, b)

        path = ompl_path(
            A, B, LOW, HIGH, counted, planner=algorithm, checks=2000, step=RESOLUTION, seed=2,
            optimize=optimize,
        )  # fmt: skip
        return sum(checks), float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())

    (few, first), (many, shortest) = search(optimize=False), search(optimize=True)
    assert few < 0.5 * many
    assert shortest < first


@pytest.mark.parametrize("gap", [0.2, 0.05])
def test_both_planners_pass_a_narrow_gap(gantry: tuple[Chain, Spheres], gap: float) -> None:
    """OMPL is the reference for our planner."""
    half = 1.5 - gap / 4
    walls = [(0.0, -3.0 + half, 0.1, half), (0.0, 3.0 - half, 0.1, half)]
    free = motions_of(gantry, *walls)
    for algorithm in (None, "RRTConnect"):
        config = PlannerConfig(planner=algorithm, checks=5000)  # type: ignore[arg-type]
        path = plan_motion(
            np.array([-2.0, 2.0]), np.array([2.0, 2.0]), LOW, HIGH, free, config=config, seed=1
        )
        crossing = np.abs(interpolate(path, 1e-3)[:, 0]) < 0.1
        assert np.abs(interpolate(path, 1e-3)[crossing, 1]).max() < gap / 2 + RESOLUTION


def test_a_search_that_checks_nothing_ends() -> None:
    budget = _Budget(20)
    assert sum(1 for _ in iter(budget.spent, True)) == 20 * _Budget.TURNS_PER_CHECK
    assert budget.checks == 20


def test_no_step_of_an_interpolated_path_exceeds_the_resolution() -> None:
    path = np.array([[0.0, 0.0], [1.0, -0.5], [1.0, 0.013]])
    filled = interpolate(path)
    assert np.abs(np.diff(filled, axis=0)).max() <= RESOLUTION + 1e-12
    for corner in path:
        assert np.isclose(filled, corner).all(1).any()


@pytest.mark.parametrize(("gap", "kept"), [(0.1, True), (2.2 * BALL + 0.006, False)])
def test_a_path_keeps_clearance_where_possible(
    gantry: tuple[Chain, Spheres], gap: float, *, kept: bool
) -> None:
    half = 1.5 - gap / 4
    walls = [(0.0, -3.0 + half, 0.1, half), (0.0, 3.0 - half, 0.1, half)]

    def checker(*, extra_clearance: float, fine: bool) -> StraightMotions:
        return motions_of(gantry, *walls, extra=extra_clearance, fine=fine)

    found = plan_with_clearance(A, B, LOW, HIGH, checker, config=PlannerConfig(), seed=1)
    path = found.corners
    near, far = (checker(extra_clearance=extra, fine=True) for extra in (0.0, PREFERRED_CLEARANCE))
    assert all(near(state, state) for state in path)
    states = interpolate(path)
    assert all(far(state, state) for state in states) is kept
