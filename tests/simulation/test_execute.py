"""Laws of a run: what can be done is done, and what cannot be done is told with its reason."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from tests.simulation.toy import asked, toy
from tests.verification.door_case import HANDLE, OPEN, make_case

from momapos.core.errors import InputError, SceneError
from momapos.simulation.config import Ending, ExecutionConfig, FurnitureConfig
from momapos.simulation.simulation import Simulation


def test_a_door_pulled_by_its_handle_opens(tmp_path: Path) -> None:
    done = toy(tmp_path).run()
    assert done.success, done.reason
    assert done.reached == pytest.approx(OPEN, abs=0.05 * OPEN)
    assert done.collisions == ()
    assert done.slip.position < 0.005
    assert 0 < done.load.force < 120
    assert sum(done.time.values()) == pytest.approx(done.simulated)


def test_the_base_yields_a_little_and_holds(tmp_path: Path) -> None:
    shift = np.abs(toy(tmp_path).run().base_shift)
    assert 0 < shift.max() < 0.005


def test_a_joint_asked_beyond_what_the_motion_reaches_is_not_done(tmp_path: Path) -> None:
    done = asked(toy(tmp_path), 1.15).run()
    assert not done.success
    assert "87 %" in done.reason


def test_a_door_that_ends_earlier_breaks_the_hold(tmp_path: Path) -> None:
    case = make_case()
    case.cupboard = case.cupboard.replace('upper="1.2"', 'upper="0.5"')
    done = toy(tmp_path, case).run()
    assert not done.success
    assert Ending.BROKE in done.reason or Ending.TOO_HARD in done.reason
    assert done.reached < 0.6


def test_a_box_in_the_way_of_the_door_is_named(tmp_path: Path) -> None:
    case = make_case()
    case.obstacle([0.06, 0.06, 0.3], [-0.02, 0.16, 0.55])
    done = toy(tmp_path, case).run()
    assert not done.success
    assert "cupboard/door" in done.reason
    assert "post/box" in done.reason
    assert ("cupboard/door", "post/box") in {(hit.one, hit.other) for hit in done.collisions}
    assert done.collisions[0].force > 20


def test_an_arm_in_a_box_is_a_collision_with_its_force(tmp_path: Path) -> None:
    plain = toy(tmp_path / "plain")
    seen: list[np.ndarray] = []
    plain.run(watch=lambda world, *_: seen.append(world.T_world_tool[:3, 3]))
    case = make_case()
    case.obstacle([0.04, 0.04, 0.04], (seen[-1] - [0.02, 0.0, 0.0]).tolist())
    done = toy(tmp_path / "hit", case).run()
    assert any(hit.other == "post/box" and hit.force > 0 for hit in done.collisions)


def test_a_state_that_is_no_number_ends_the_run_as_a_failure(tmp_path: Path) -> None:
    def spoil(world: Simulation, time: float, _: str) -> None:
        if time > 1.0:
            world.data.qpos[world.arm_q[0]] = np.nan

    done = toy(tmp_path).run(watch=spoil)
    assert not done.success
    assert "diverged" in done.reason
    assert done.simulated < 1.1
    assert "diverged" in json.dumps(asdict(done), allow_nan=False)


def test_a_motion_that_holds_nan_is_refused(tmp_path: Path) -> None:
    case = toy(tmp_path)
    q = case.motion.q.copy()
    q[3, 2] = np.nan
    case.motion = replace(case.motion, q=q)
    with pytest.raises(InputError, match="NaN"):
        case.run()


def test_a_robot_that_stands_in_something_is_refused_and_the_thing_named(tmp_path: Path) -> None:
    case = make_case()
    case.obstacle([0.3, 0.3, 0.5], [-0.6, 0.15, 0.25])
    with pytest.raises(SceneError, match=r"start in collision: base .* post/box"):
        toy(tmp_path, case).run()


def test_a_seal_stronger_than_the_hold_keeps_the_door_shut(tmp_path: Path) -> None:
    stuck = ExecutionConfig(furniture=FurnitureConfig(latch_force=400.0))
    done = toy(tmp_path).run(config=stuck)
    assert not done.success
    assert done.reached < 0.05


def test_a_stiffer_latch_loads_the_hold_more(tmp_path: Path) -> None:
    case = toy(tmp_path)
    loads = [
        case.run(config=ExecutionConfig(furniture=FurnitureConfig(latch_force=force))).load.force
        for force in (0.0, 40.0)
    ]
    assert loads[1] > loads[0] + 20


@pytest.mark.slow
def test_the_same_seed_draws_the_same_furniture_and_another_seed_another(tmp_path: Path) -> None:
    case, config = toy(tmp_path), ExecutionConfig(furniture=FurnitureConfig(spread=0.3))
    runs = [case.run(config=config, rng=np.random.default_rng(seed)) for seed in (1, 1, 2)]
    assert replace(runs[0], wall=0.0) == replace(runs[1], wall=0.0)
    assert runs[0].resistance != runs[2].resistance


def test_a_hand_without_fingers_holds_by_a_weld_and_the_record_says_so(tmp_path: Path) -> None:
    done = toy(tmp_path).run(config=ExecutionConfig(hold="contact"))
    assert done.success, done.reason
    assert done.hold == "weld"
    assert any("a weld stands for its hold" in note for note in done.notes)


def test_a_grasp_beside_the_handle_is_noticed(tmp_path: Path) -> None:
    case = toy(tmp_path)
    Ts = case.motion.Ts_world_tool.copy()
    Ts[:, 2, 3] += 0.1
    case.motion = replace(case.motion, Ts_world_tool=Ts)
    done = case.run()
    assert not done.success
    assert "10.0 cm" in done.reason


def test_a_weld_takes_no_hold_of_what_is_out_of_the_hand(tmp_path: Path) -> None:
    case = make_case()
    x, y, z = HANDLE
    case.cupboard = case.cupboard.replace(f'xyz="{x} {y} {z}"', f'xyz="{x} {y} {z + 0.2}"')
    done = toy(tmp_path, case).run()
    assert not done.success
    assert done.ending == Ending.OUT_OF_REACH
    assert done.reached == pytest.approx(0.0, abs=1e-3)
