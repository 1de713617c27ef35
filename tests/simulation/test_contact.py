"""Grasps by contact: fingers hold by friction, and the arm follows the sensed forces."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tests.meshes as given
from tests.simulation.toy import Toy, gripping
from tests.verification.door_case import HANDLE, OPEN, cupboard_urdf, make_case

from momapos.simulation.config import (
    ComplianceConfig,
    Ending,
    ExecutionConfig,
    FurnitureConfig,
    GripConfig,
    ModelErrorConfig,
)
from momapos.simulation.robot_dynamics import SimulatedHand, find_hand, read_dynamics
from momapos.simulation.simulated_room import PART, seal_of
from momapos.simulation.simulation import Simulation

SEEDS = (0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2)))
HINGE_OFF = ModelErrorConfig(axis=0.03, tilt=float(np.radians(5.0)))


def test_closed_fingers_open_a_door_by_friction_alone(tmp_path: Path) -> None:
    case = gripping(tmp_path)
    welded: list[bool] = []
    done = case.run(watch=lambda world, *_: welded.append(world.welded))
    assert not any(welded)
    assert done.success, done.reason
    assert (done.hold, done.ending) == ("contact", Ending.DONE)
    assert done.reached == pytest.approx(OPEN, abs=0.05 * OPEN)
    assert 0 < done.load.force < ComplianceConfig().force


@pytest.mark.parametrize("seed", SEEDS)
def test_a_handle_off_by_one_centimeter_is_grasped_and_the_door_opened(
    seed: int, tmp_path: Path
) -> None:
    config = ExecutionConfig(errors=ModelErrorConfig(handle=0.01))
    done = gripping(tmp_path).run(config=config, rng=np.random.default_rng(seed))
    assert done.success, done.reason


@pytest.mark.parametrize("seed", SEEDS)
def test_a_hinge_off_its_modeled_position_is_found_and_the_door_opened(
    seed: int, tmp_path: Path
) -> None:
    true: list[tuple[np.ndarray, np.ndarray]] = []

    def watch(world: Simulation, *_: object) -> None:
        joint = world.model.joint(PART).id
        true[:] = [(world.data.xaxis[joint].copy(), world.data.xanchor[joint].copy())]

    config = ExecutionConfig(errors=HINGE_OFF)
    done = gripping(tmp_path).run(config=config, rng=np.random.default_rng(seed), watch=watch)
    assert done.success, done.reason
    axis, anchor = true[0]
    found = np.array(done.joint.direction)
    assert np.arccos(abs(found @ axis)) < HINGE_OFF.tilt / 2
    off = np.array(done.joint.point) - anchor
    assert np.linalg.norm(off - (off @ axis) * axis) < HINGE_OFF.axis / 2


def test_fingers_that_close_on_nothing_stop_the_run_and_the_door_stays_closed(
    tmp_path: Path,
) -> None:
    case = make_case()
    case.cupboard = cupboard_urdf(handle=False)
    done = gripping(tmp_path, case).run()
    assert not done.success
    assert done.ending == Ending.NOTHING_HELD
    assert done.reached == pytest.approx(0.0, abs=1e-3)


def test_a_force_above_the_limit_stops_the_run_with_the_figures(tmp_path: Path) -> None:
    limit = ComplianceConfig(force=40.0)
    stuck = ExecutionConfig(furniture=FurnitureConfig(latch_force=100.0), compliance=limit)
    done = gripping(tmp_path).run(config=stuck)
    assert not done.success
    assert done.ending == Ending.TOO_HARD
    assert "limits 40 N" in done.reason
    assert done.load.force < 2.0 * limit.force


def test_the_friction_of_the_pads_decides_and_not_that_of_the_handle(tmp_path: Path) -> None:
    slippery = ExecutionConfig(gripper=GripConfig(friction=0.02))
    done = gripping(tmp_path).run(config=slippery)
    assert not done.success
    assert done.slip.position > 0.01 or done.ending == Ending.SLIPPED


def test_rotating_fingers_close_together_by_their_mimic_joint(tmp_path: Path) -> None:
    case = gripping(tmp_path, turning=True)
    hand = hand_of(case)
    assert [f.joint for f in hand.fingers] == ["left_joint"]
    assert set(hand.followers) == {"right_joint"}
    assert hand.pads == {"left": 1.0, "right": -1.0}
    ends: list[tuple[float, float]] = []

    def watch(world: Simulation, *_: object) -> None:
        q = [float(world.data.joint(name).qpos[0]) for name in ("left_joint", "right_joint")]
        ends.append((q[0], q[1]))

    done = case.run(watch=watch)
    assert done.success, done.reason
    left, right = np.array(ends).T
    assert left.max() > 0.1
    np.testing.assert_allclose(left, right, atol=0.02)


def test_the_grip_force_acts_at_the_pads_of_sliding_and_rotating_fingers(tmp_path: Path) -> None:
    (slides,) = {f.lever for f in hand_of(gripping(tmp_path / "slides")).fingers}
    (turns,) = {f.lever for f in hand_of(gripping(tmp_path / "turns", turning=True)).fingers}
    assert slides == pytest.approx(1.0)
    assert turns == pytest.approx(2 * 0.05, rel=0.15)  # two pads with centers 5 cm from the axes


def test_without_a_plan_a_seal_pulls_at_the_free_edge_of_the_door(tmp_path: Path) -> None:
    case = gripping(tmp_path)
    item = case.scene.object("cupboard")
    seal = seal_of(item, item.model.joint("hinge"), 30.0, FurnitureConfig())
    points = [h.vertices for h in item.model.hulls["door"]]
    width = float(np.linalg.norm(np.concatenate(points)[:, :2], axis=1).max())
    assert seal.pull == pytest.approx(30.0 * width, rel=0.02)


def hand_of(case: Toy) -> SimulatedHand:
    """Find the hand of a toy's robot."""
    path = case.robot.model.urdf.path
    return find_hand(case.robot, read_dynamics(path).mimics)


def test_a_handle_in_the_mesh_of_its_door_is_grasped(tmp_path: Path) -> None:
    """The convex hull of door and handle fills the space in which the fingers close."""
    case = make_case()
    (x, y, _), bar, door = HANDLE, 0.01, ((-0.01, 0.0, -0.39), (0.01, 0.58, 0.39))
    ends = [((x + bar, y - bar, z - 0.01), (-0.01, y + bar, z + 0.01)) for z in (-0.11, 0.11)]
    bow = (((x - bar, y - bar, -0.12), (x + bar, y + bar, 0.12)), *ends)
    given.write_obj(tmp_path / "door.obj", given.triangles_of((door, *bow)))
    first, last = (case.cupboard.index(f'<link name="{name}">') for name in ("door", "handle"))
    mesh = '<collision><geometry><mesh filename="door.obj"/></geometry></collision>'
    case.cupboard = (
        f'{case.cupboard[:first]}<link name="door">{mesh}</link>'
        f'<link name="handle"/>{case.cupboard[case.cupboard.index("<joint name=") :]}'
    )
    assert last > first
    done = gripping(tmp_path, case).run()
    assert done.success, done.reason
    assert done.ending == Ending.DONE
