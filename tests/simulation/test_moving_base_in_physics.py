"""Motions whose base moves, in physics: it follows its path late and slipping, the arm makes up."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from tests.simulation.toy import Toy, gripping, toy, with_goal
from tests.verification.door_case import BASE, Case
from tests.verification.moving_case import moving_case, stops_case

from momapos.core.errors import InputError
from momapos.model.robots.robot import Drive
from momapos.model.trajectory import Trajectory
from momapos.simulation.base_drive import BaseDrive, base_coordinates, base_pose_of
from momapos.simulation.config import BASE_ASIDE, BASE_YIELD, BaseTrackingConfig, ExecutionConfig
from momapos.simulation.execute import attempt
from momapos.simulation.execution_run import MAX_LATE, ExecutionRun
from momapos.simulation.run_record import Execution
from momapos.simulation.run_trace import RunTrace
from momapos.simulation.simulation import Simulation

CASES: dict[str, Callable[[], Case]] = {
    "differential": moving_case,
    "with a lead-in": lambda: moving_case(lead_in=8),
    "omni": lambda: moving_case("omni", sideways=0.1),
    "stops": stops_case,
}


def made(folder: Path, name: str, *, fingers: bool = True) -> Toy:
    case = CASES[name]()
    ready = (gripping if fingers else toy)(folder, case)
    drive = case.plan["robot"]["drive"]
    return replace(ready, robot=replace(ready.robot, drive=drive))


def run(
    ready: Toy, slip: float = 0.03, seed: int = 1, **options: object
) -> tuple[Execution, RunTrace]:
    trace = RunTrace()
    config = ExecutionConfig(base=BaseTrackingConfig(slip=slip), **options)  # type: ignore[arg-type]
    done = ready.run(config=config, rng=np.random.default_rng(seed), watch=trace)
    return done, trace


@pytest.fixture(scope="module")
def standing(tmp_path_factory: pytest.TempPathFactory) -> tuple[Toy, Simulation]:
    """Return a robot and the world of its run, for what moves the base alone."""
    ready = made(tmp_path_factory.mktemp("standing"), "differential", fingers=False)
    return ready, run(with_goal(ready, 0.02), hold="weld")[1].played[0].world


@pytest.mark.parametrize(
    "name",
    ["differential", pytest.param("with a lead-in", marks=pytest.mark.slow), "omni", "stops"],
)
def test_the_door_opens_by_contact_while_or_between_drives(name: str, tmp_path: Path) -> None:
    ready = made(tmp_path, name)
    done, trace = run(ready)
    assert done.success, done.reason
    assert not done.collisions
    bases = np.array(trace.motion().bases)
    np.testing.assert_allclose(bases[0], BASE, atol=1e-3)
    np.testing.assert_allclose(bases[-1], ready.motion.base[-1], atol=0.03)
    assert max(done.base_shift[:2]) < 0.03  # from where it should be, not from where it began


def test_a_base_that_slips_more_ends_farther_from_its_path(tmp_path: Path) -> None:
    ready, off = made(tmp_path, "differential", fingers=False), []
    for slip in (0.0, 0.2):
        _, trace = run(ready, slip, hold="weld")
        state = trace.played[0].states[-1]
        world = trace.played[0].world
        off.append(np.linalg.norm((base_pose_of(world, state.q) - ready.motion.base[-1])[:2]))
    assert off[0] < 0.005
    assert off[1] > 2 * off[0]


@pytest.mark.slow
def test_the_same_seed_gives_the_same_slip(tmp_path: Path) -> None:
    ready = made(tmp_path, "differential", fingers=False)
    reached = [run(ready, 0.1, seed, hold="weld")[0].reached for seed in (3, 3, 4)]
    assert reached[0] == reached[1] != reached[2]


def test_a_base_keeps_its_limits_and_its_drive(standing: tuple[Toy, Simulation]) -> None:
    """Sent far to its left at once, a differential base cannot go there, and an omni base can."""
    (ready, world), step = standing, 0.004
    first = np.array(BASE)
    left = first + np.array([-np.sin(BASE[2]), np.cos(BASE[2]), 0.0])
    for drive in ("differential", "omni"):
        robot = replace(ready.robot, drive=drive, max_speed=0.3)
        base = BaseDrive(
            world, robot, first, BaseTrackingConfig(0.0), step, np.random.default_rng(0)
        )
        places = []
        for _ in range(2000):
            base.go(left)
            base.update()
            places.append(base.odometry.copy())
        speeds = np.hypot(*np.diff(places, axis=0)[:, :2].T) / step
        assert speeds.max() <= 0.3 + 1e-9
        arrived = np.allclose(places[-1], base_coordinates(world, left[None])[0], atol=0.02)
        assert arrived == (drive == "omni")
        late = np.flatnonzero(np.abs(places).max(1) > 0.0)
        if drive == "omni":
            assert late[0] == pytest.approx(BaseTrackingConfig().delay / step, abs=2)


@pytest.mark.parametrize("drive", ["differential", "omni"])
def test_a_base_relieves_the_hand_where_its_drive_goes_and_returns(
    drive: Drive, standing: tuple[Toy, Simulation]
) -> None:
    """The arm has no joint for what it lacks of the hand's velocity; a base has a direction."""
    ready, world = standing
    first, robot = np.array(BASE), replace(ready.robot, drive=drive)
    base = BaseDrive(world, robot, first, BaseTrackingConfig(0.0), 0.004, np.random.default_rng(0))
    ahead, left = (np.array([np.cos(y), np.sin(y), 0.0]) for y in (BASE[2], BASE[2] + np.pi / 2))
    for _ in range(100):
        base.go(first)
        base.relieve(0.02 * ahead + 0.01 * left)
    there = 100 * 0.004 * BASE_YIELD * np.array([0.02, 0.01 if drive == "omni" else 0.0, 0.0])
    np.testing.assert_allclose(base.goal, there * 0.99, atol=1e-9)
    for _ in range(2000):
        base.go(first)
        base.relieve(ahead)
    assert np.hypot(*base.goal[:2]) == pytest.approx(BASE_ASIDE)
    for _ in range(2000):
        base.go(first)
    np.testing.assert_allclose(base.goal, 0.0, atol=1e-4)


def test_the_arm_waits_for_a_base_that_is_late(standing: tuple[Toy, Simulation]) -> None:
    """It goes on where the base is, at most twice as fast, and not forever without it."""
    ready, world = standing
    base = BaseDrive(
        world, ready.robot, np.array(BASE), BaseTrackingConfig(0.0), 0.004, np.random.default_rng(0)
    )
    ahead = np.array([np.cos(BASE[2]), np.sin(BASE[2]), 0.0])
    path = np.array(BASE) + np.outer(np.linspace(0.0, 0.2, 501), ahead)
    path[400:] = path[400]
    known, plan = SimpleNamespace(base=base, step=0.004), SimpleNamespace(base=path)
    late, before = [], 0
    for sample in range(560):
        base.go(path[min(sample, 500)])
        base.update()
        after = ExecutionRun.reached_sample(
            cast("ExecutionRun", known), cast("Trajectory", plan), min(sample, 500), before
        )
        assert before <= after <= before + 2
        late.append(min(sample, 500) - after)
        before = after
    delay = BaseTrackingConfig().delay / 0.004
    assert delay - 3 < late[200] < 3 * delay
    assert late[-1] == 0
    stuck = BaseDrive(
        world, ready.robot, np.array(BASE), BaseTrackingConfig(0.0), 0.004, np.random.default_rng(0)
    )
    known.base = stuck
    reached = ExecutionRun.reached_sample(
        cast("ExecutionRun", known), cast("Trajectory", plan), 300, 0
    )
    assert reached == 300 - round(MAX_LATE / 0.004)


def test_at_a_second_stop_the_robot_knows_where_it_is(tmp_path: Path) -> None:
    """Wheels that slip by a quarter end centimeters off; the hand still finds the handle."""
    ready = made(tmp_path, "stops")
    done, _ = run(ready, 0.25, seed=2)
    assert done.success, done.reason
    assert done.base_shift[0] > 0.01


@pytest.mark.parametrize("wrong", [{"slip": -0.1}, {"delay": -1.0}])
def test_a_base_that_slips_or_waits_less_than_nothing_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(InputError, match=next(iter(wrong))):
        BaseTrackingConfig(**wrong)


def test_a_base_that_begins_elsewhere_is_refused(tmp_path: Path) -> None:
    ready = made(tmp_path, "differential", fingers=False)
    x, y, yaw = BASE
    with pytest.raises(InputError, match="first base pose"):
        attempt(ready.scene, ready.robot, (x + 0.01, y, yaw), ready.motion, ready.task)
