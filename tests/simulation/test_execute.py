"""A run completes a feasible task, and reports why another one failed."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from tests.simulation.toy import toy, with_goal
from tests.verification.door_case import HANDLE, OPEN, make_case

from momapos.core.errors import InputError, SceneError
from momapos.simulation.config import Ending, ExecutionConfig, FurnitureConfig
from momapos.simulation.run_record import Execution
from momapos.simulation.simulation import Simulation


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> tuple[Execution, np.ndarray]:
    """Run the toy once; return also the position of the hand at the end."""
    seen: list[np.ndarray] = []
    done = toy(tmp_path_factory.mktemp("plain")).run(
        watch=lambda world, *_: seen.append(world.T_world_tool[:3, 3])
    )
    return done, seen[-1]


def test_a_door_pulled_by_its_handle_opens(plain: tuple[Execution, np.ndarray]) -> None:
    done, _ = plain
    assert done.success, done.reason
    assert done.reached == pytest.approx(OPEN, abs=0.05 * OPEN)
    assert done.collisions == ()
    assert done.slip.position < 0.005
    assert 0 < done.load.force < 120
    assert sum(done.time.values()) == pytest.approx(done.simulated)


def test_the_base_yields_slightly(plain: tuple[Execution, np.ndarray]) -> None:
    shift = np.abs(plain[0].base_shift)
    assert 0 < shift.max() < 0.005


def test_a_request_beyond_the_end_of_the_motion_fails(tmp_path: Path) -> None:
    done = with_goal(toy(tmp_path), 1.15).run()
    assert not done.success
    assert "87 %" in done.reason


def test_a_door_with_an_earlier_limit_breaks_the_grasp(tmp_path: Path) -> None:
    case = make_case()
    case.cupboard = case.cupboard.replace('upper="1.2"', 'upper="0.5"')
    done = toy(tmp_path, case).run()
    assert not done.success
    assert Ending.BROKE in done.reason or Ending.TOO_HARD in done.reason
    assert done.reached < 0.6


def test_a_box_that_blocks_the_door_is_named(tmp_path: Path) -> None:
    case = make_case()
    case.obstacle([0.06, 0.06, 0.3], [-0.02, 0.16, 0.55])
    done = toy(tmp_path, case).run()
    assert not done.success
    assert "cupboard/door" in done.reason
    assert "post/box" in done.reason
    assert ("cupboard/door", "post/box") in {(hit.one, hit.other) for hit in done.collisions}
    assert done.collisions[0].force > 20


def test_an_arm_that_hits_a_box_is_a_collision_with_its_force(
    plain: tuple[Execution, np.ndarray], tmp_path: Path
) -> None:
    case = make_case()
    case.obstacle([0.04, 0.04, 0.04], (plain[1] - [0.02, 0.0, 0.0]).tolist())
    done = toy(tmp_path, case).run()
    assert any(hit.other == "post/box" and hit.force > 0 for hit in done.collisions)


def test_a_nan_state_ends_the_run_as_a_failure(tmp_path: Path) -> None:
    def spoil(world: Simulation, time: float, _: str) -> None:
        if time > 1.0:
            world.data.qpos[world.arm_q[0]] = np.nan

    done = toy(tmp_path).run(watch=spoil)
    assert not done.success
    assert "diverged" in done.reason
    assert done.simulated < 1.1
    assert "diverged" in json.dumps(asdict(done), allow_nan=False)


def test_a_motion_with_nan_is_refused(tmp_path: Path) -> None:
    case = toy(tmp_path)
    q = case.motion.q.copy()
    q[3, 2] = np.nan
    case.motion = replace(case.motion, q=q)
    with pytest.raises(InputError, match="NaN"):
        case.run()


def test_a_start_in_collision_is_refused_and_names_the_obstacle(tmp_path: Path) -> None:
    case = make_case()
    case.obstacle([0.3, 0.3, 0.5], [-0.6, 0.15, 0.25])
    with pytest.raises(SceneError, match=r"start in collision: base .* post/box"):
        toy(tmp_path, case).run()


def test_a_seal_stronger_than_the_grasp_keeps_the_door_closed(tmp_path: Path) -> None:
    stuck = ExecutionConfig(furniture=FurnitureConfig(latch_force=400.0))
    done = toy(tmp_path).run(config=stuck)
    assert not done.success
    assert done.reached < 0.05


def test_a_stiffer_latch_loads_the_grasp_more(tmp_path: Path) -> None:
    case = toy(tmp_path)
    loads = [
        case.run(config=ExecutionConfig(furniture=FurnitureConfig(latch_force=force))).load.force
        for force in (0.0, 40.0)
    ]
    assert loads[1] > loads[0] + 20


@pytest.mark.slow
def test_the_seed_determines_the_resistance_of_the_furniture(tmp_path: Path) -> None:
    case, config = toy(tmp_path), ExecutionConfig(furniture=FurnitureConfig(spread=0.3))
    runs = [case.run(config=config, rng=np.random.default_rng(seed)) for seed in (1, 1, 2)]
    assert replace(runs[0], wall=0.0) == replace(runs[1], wall=0.0)
    assert runs[0].resistance != runs[2].resistance


def test_a_hand_without_fingers_uses_a_weld_and_the_record_notes_it(
    plain: tuple[Execution, np.ndarray],
) -> None:
    done, _ = plain
    assert ExecutionConfig().hold == "contact"
    assert done.success, done.reason
    assert done.hold == "weld"
    assert any("a weld replaces the grasp" in note for note in done.notes)


def test_a_grasp_next_to_the_handle_fails(tmp_path: Path) -> None:
    case = toy(tmp_path)
    Ts = case.motion.Ts_world_tool.copy()
    Ts[:, 2, 3] += 0.1
    case.motion = replace(case.motion, Ts_world_tool=Ts)
    done = case.run()
    assert not done.success
    assert "10.0 cm" in done.reason


def test_a_weld_does_not_attach_to_an_object_out_of_reach(tmp_path: Path) -> None:
    case = make_case()
    x, y, z = HANDLE
    case.cupboard = case.cupboard.replace(f'xyz="{x} {y} {z}"', f'xyz="{x} {y} {z + 0.2}"')
    done = toy(tmp_path, case).run()
    assert not done.success
    assert done.ending == Ending.OUT_OF_REACH
    assert done.reached == pytest.approx(0.0, abs=1e-3)
