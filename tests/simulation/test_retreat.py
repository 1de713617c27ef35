"""After a failed motion the arm comes home, and the state of the part is known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.simulation.toy import gripping
from tests.verification.door_case import BASE, OPEN, cupboard_urdf, make_case

from momapos.core.geometry.transforms import apply, rotation_of
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_object import SceneObject
from momapos.simulation.config import ComplianceConfig, Ending, ExecutionConfig, GripConfig
from momapos.simulation.execute import AttemptOutcome, RetryState, attempt
from momapos.simulation.joint_estimate import Axis, JointEstimate, LearnedPart
from momapos.simulation.simulation import Simulation
from momapos.simulation.true_worlds import true_world

SLIPPERY = ExecutionConfig(gripper=GripConfig(friction=0.02))


@pytest.mark.parametrize("slides", [False, True])
def test_the_joint_value_follows_from_the_position_of_the_hand(slides: bool) -> None:
    direction = rotation_of(np.array([0.3, -0.2, 0.4])) @ np.array([0.0, 0.0, 1.0])
    axis, start = Axis(slides, direction, np.array([0.1, 0.2, 0.3])), np.array([0.6, 0.1, 0.9])
    estimate = JointEstimate(axis, start, ComplianceConfig())
    for value in (-1.2, 0.0, 0.4, 1.4):
        point = apply(axis.moved(value), start[None])[0]
        assert estimate.value_at(point) == pytest.approx(value, abs=1e-9)


def test_a_hand_that_closed_on_nothing_retraces_its_approach(tmp_path: Path) -> None:
    case = make_case()
    case.cupboard = cupboard_urdf(handle=False)
    toy = gripping(tmp_path, case)

    def never(*_: object) -> np.ndarray | None:
        raise AssertionError("the hand must retrace its approach")

    came = attempt(toy.scene, toy.robot, BASE, toy.motion, toy.task, way_home=never)
    assert came.ending == Ending.NOTHING_HELD
    assert came.at_home
    assert came.nothing_there
    assert came.execution.time["retreat"] > 0
    assert max((c.force for c in came.collisions.values()), default=0.0) < 150


@pytest.fixture(scope="module")
def slipped(
    tmp_path_factory: pytest.TempPathFactory,
) -> tuple[AttemptOutcome, list[LearnedPart], float]:
    """Let a door slip out of the hand halfway; return also its true value at that time."""
    toy, replanned, last = gripping(tmp_path_factory.mktemp("slipped")), [], [0.0]
    oiled = 0.5

    def watch(world: Simulation, _: float, stage: str) -> None:
        value = float(world.data.qpos[world.part_q])
        if stage == "manipulate":
            last[0] = value
            if value > oiled:
                world.model.geom_friction[world.pad_side != 0] = 0.0

    def way_home(q: np.ndarray, learned: LearnedPart) -> np.ndarray:
        replanned.append(learned)
        home = toy.robot.home
        aside = np.concatenate([home[:1], q[1:]])  # off the handle before the arm folds
        return np.concatenate([np.linspace(q, aside, 40), np.linspace(aside, home, 40)])

    came = attempt(toy.scene, toy.robot, BASE, toy.motion, toy.task, way_home=way_home, watch=watch)
    return came, replanned, last[0]


def test_a_hand_that_lost_its_grasp_draws_back_goes_home_and_knows_the_door_value(
    slipped: tuple[AttemptOutcome, list[LearnedPart], float],
) -> None:
    came, replanned, true = slipped
    assert came.ending == Ending.SLIPPED
    assert came.at_home
    assert came.learned is replanned[0]
    assert came.learned.value == pytest.approx(true, abs=0.1)
    assert np.linalg.norm(came.learned.offset) < 0.03


def test_a_hand_that_meets_an_obstacle_on_its_path_home_goes_back_and_replans(
    tmp_path: Path,
) -> None:
    toy, replanned = gripping(tmp_path), []

    def way_home(q: np.ndarray, _: LearnedPart) -> np.ndarray:
        replanned.append(q)
        home = toy.robot.home
        if len(replanned) == 1:  # into the door
            ahead = q + 2.0 * (toy.motion.q[0] - q)
            return np.linspace(q, ahead, 40)
        aside = np.concatenate([home[:1], q[1:]])
        return np.concatenate([np.linspace(q, aside, 40), np.linspace(aside, home, 40)])

    came = attempt(toy.scene, toy.robot, BASE, toy.motion, toy.task, SLIPPERY, way_home=way_home)
    assert len(replanned) == 2
    assert np.abs(replanned[1] - replanned[0]).max() < 0.1
    assert came.at_home


def test_an_overloaded_hand_opens_under_load_and_goes_home(tmp_path: Path) -> None:
    toy, replanned = gripping(tmp_path), []
    file = tmp_path / "stuck.urdf"
    file.write_text(cupboard_urdf().replace('upper="1.2"', 'upper="0.1"'))
    stuck = Scene("stuck", (SceneObject.from_urdf("chest", file, (0.4, 0.0, 0.8)),))
    world = true_world(stuck, toy.scene, toy.task, toy.motion.Ts_world_tool[0, :3, 3])
    strong = ExecutionConfig(gripper=GripConfig(friction=5.0))

    def way_home(q: np.ndarray, _: LearnedPart) -> np.ndarray:
        replanned.append(q)
        home = toy.robot.home
        aside = np.concatenate([home[:1], q[1:]])
        return np.concatenate([np.linspace(q, aside, 40), np.linspace(aside, home, 40)])

    came = attempt(
        toy.scene, toy.robot, BASE, toy.motion, toy.task, strong,
        true_world=world, way_home=way_home,
    )  # fmt: skip
    assert came.ending == Ending.TOO_HARD
    assert came.at_home
    assert replanned


def test_a_retry_starts_with_the_part_where_the_last_attempt_left_it(
    slipped: tuple[AttemptOutcome, list[LearnedPart], float], tmp_path: Path
) -> None:
    (came, _, _), toy = slipped, gripping(tmp_path)
    assert came.learned is not None
    begun: list[float] = []

    def watch(world: Simulation, *_: object) -> None:
        begun.append(float(world.data.qpos[world.part_q]))

    again = RetryState(toy.scene, came.value, came.collisions)
    before = len(came.collisions)
    then = attempt(
        toy.scene, toy.robot, BASE, toy.motion, toy.task, again=again, watch=watch,
    )  # fmt: skip
    assert begun[0] == pytest.approx(came.value, abs=0.01)
    assert len(then.collisions) >= before


def test_without_a_path_home_a_failed_motion_ends_where_it_failed(tmp_path: Path) -> None:
    toy = gripping(tmp_path)
    came = attempt(toy.scene, toy.robot, BASE, toy.motion, toy.task, SLIPPERY)
    assert not came.execution.success
    assert not came.at_home
    assert came.execution.time["retreat"] == 0


def test_a_grasp_lost_near_the_goal_is_no_failure(tmp_path: Path) -> None:
    toy = gripping(tmp_path)

    def watch(world: Simulation, *_: object) -> None:
        if float(world.data.qpos[world.part_q]) > 0.98 * OPEN:
            world.model.geom_friction[world.pad_side != 0] = 0.0
            for _, motor in world.fingers:
                world.model.actuator_forcerange[motor] = 0.0

    task = replace(toy.task, to=OPEN)
    done = attempt(toy.scene, toy.robot, BASE, toy.motion, task, watch=watch).execution
    assert done.success, done.reason
