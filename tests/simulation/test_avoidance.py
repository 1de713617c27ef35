"""The arm avoids nearby obstacles."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from tests.simulation.test_contact import hand_of
from tests.simulation.toy import Toy, gripping
from tests.verification.door_case import BASE, HINGE, make_case

from momapos.core.geometry.transforms import invert, pose_planar
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.model.trajectory import time_motion
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.simulation.arm_control import (
    Bounds,
    CollisionAvoidance,
    CompliantArm,
    Reference,
    pace_trajectory,
)
from momapos.simulation.config import (
    AVOID_RATE,
    NEAR_GRASP,
    NEAR_SPEED,
    PACE_RATE,
    SUBSTEPS,
    ComplianceConfig,
    Ending,
    ExecutionConfig,
)
from momapos.simulation.robot_dynamics import find_hand, read_dynamics
from momapos.simulation.run_record import Execution
from momapos.simulation.simulated_room import PartResistance
from momapos.simulation.simulation import Simulation, build_simulation
from momapos.simulation.true_worlds import TrueWorld
from momapos.simulation.worlds import WorldSetup

CONFIG = ExecutionConfig()
STEP = CONFIG.timestep * SUBSTEPS
POST_CLEARANCE = 0.012
"""Distance from the forearm at the grasp to a post next to it [m]."""


def world_of(case: Toy) -> Simulation:
    """Build the world of a toy, with the arm at its grasp."""
    path = case.robot.model.urdf.path
    return build_simulation(
        case.scene, case.robot, BASE, case.motion.q, case.task, hand_of(case),
        read_dynamics(path), PartResistance(5.0, 0.1, 0.1, 0.0), None, CONFIG,
    )  # fmt: skip


def gap(world: Simulation, q: np.ndarray) -> float:
    """Return the distance from the forearm to the post [m]."""
    data = mujoco.MjData(world.model)
    data.qpos[:] = world.data.qpos
    data.qpos[world.arm_q] = q
    mujoco.mj_kinematics(world.model, data)
    fore, post = (world.names.index(name) for name in ("fore", "post/box"))
    return float(mujoco.mj_geomDistance(world.model, data, fore, post, 0.1, None))


@pytest.fixture
def beside(tmp_path: Path) -> tuple[Toy, Simulation]:
    """Return a toy that holds the handle, with a post close to its forearm."""
    bare = world_of(gripping(tmp_path / "bare"))
    elbow = bare.data.xpos[bare.model.body("robot/fore").id]
    ahead = bare.data.xmat[bare.model.body("robot/fore").id].reshape(3, 3) @ [0.0, 0.0, 0.18]
    case = make_case()
    size = 0.04
    away = np.array([0.0, 0.035 + POST_CLEARANCE + size / 2, 0.0])
    case.obstacle([size] * 3, (elbow + ahead + away).tolist())
    toy = gripping(tmp_path / "beside", case)
    return toy, world_of(toy)


def test_bounds_are_the_derivative_of_the_distance_by_the_joints(
    beside: tuple[Toy, Simulation],
) -> None:
    toy, world = beside
    q = toy.motion.q[0]
    bounds = CollisionAvoidance(world, CONFIG.compliance).bounds(q, 0.0)
    assert len(bounds.rows) == 1
    step = 1e-4
    moved = q + step * np.concatenate([np.zeros((1, 6)), np.eye(6)])
    distance = np.array([gap(world, state) for state in moved])
    slope = (distance[1:] - distance[0]) / step
    np.testing.assert_allclose(bounds.rows[0], slope / np.linalg.norm(slope), atol=0.02)


def into_the_post(world: Simulation, q: np.ndarray) -> np.ndarray:
    """Return a state whose forearm overlaps the post by 5 mm or more."""
    turn = np.eye(6)[0] * np.sign(gap(world, q - 1e-3 * np.eye(6)[0]) - gap(world, q))
    while gap(world, q) > -5e-3:
        q = q + 2e-3 * turn
    return q


def test_the_arm_leaves_an_assumed_overlap_slowly(beside: tuple[Toy, Simulation]) -> None:
    toy, world = beside
    q, config = into_the_post(world, toy.motion.q[0]), CONFIG.compliance
    bounds = CollisionAvoidance(world, config).bounds(q, 0.0)
    assert len(bounds.rows) == 1
    step = 1e-4
    away = (gap(world, q + step * bounds.rows[0]) - gap(world, q)) / step
    assert AVOID_RATE * (config.apart - gap(world, q)) > 1.5 * config.speed
    assert bounds.least[0] * away == pytest.approx(config.speed, rel=0.05)


def test_between_two_obstacles_the_arm_moves_away_from_the_nearer_one(tmp_path: Path) -> None:
    bare = world_of(gripping(tmp_path / "bare"))
    fore = bare.model.body("robot/fore").id
    middle = bare.data.xpos[fore] + 0.18 * bare.data.xmat[fore].reshape(3, 3)[:, 2]
    case, size = make_case(), 0.04
    for side, clearance in ((1.0, 0.008), (-1.0, 0.012)):
        place = middle + side * np.array([0.0, 0.035 + clearance + size / 2, 0.0])
        case.obstacle([size] * 3, place.tolist(), name="nearer" if side > 0 else "other")
    toy = gripping(tmp_path / "between", case)
    near = CollisionAvoidance(world_of(toy), CONFIG.compliance)
    q = toy.motion.q[0]
    (row,), step = near.bounds(q, 0.0).rows, 1e-3
    data = mujoco.MjData(near.known.model)

    def clearance_at(state: np.ndarray, post: str) -> float:
        data.qpos[:] = near.known.data.qpos
        data.qpos[near.known.arm_q] = state
        mujoco.mj_kinematics(near.known.model, data)
        pair = (near.known.names.index(name) for name in ("fore", post))
        return float(mujoco.mj_geomDistance(near.known.model, data, *pair, 0.1, None))

    nearer, other = "nearer/box", "other/box"
    assert clearance_at(q, nearer) < clearance_at(q, other) < CONFIG.compliance.avoid
    assert clearance_at(q + step * row, nearer) > clearance_at(q, nearer)
    assert clearance_at(q + step * row, other) < clearance_at(q, other)


def test_a_bound_does_not_exceed_the_joint_speed_limit(beside: tuple[Toy, Simulation]) -> None:
    toy, world = beside
    arm = CompliantArm(world, CONFIG.compliance, STEP)
    q = toy.motion.q[0].copy()
    arm.go(q, np.zeros(6))
    T, _ = arm.kinematics.at(q)
    hurry = Bounds(np.eye(6)[:1], np.array([400.0]))
    free = np.zeros((3, 3))
    arm.follow(Reference(q, np.zeros(6), T, np.zeros(6), free, free, None, hurry))
    assert np.abs(arm.q - q).max() == pytest.approx(CONFIG.compliance.joint_speed * STEP)


def test_an_arm_whose_reference_enters_a_post_stays_clear_of_it(
    beside: tuple[Toy, Simulation],
) -> None:
    toy, world = beside
    arm = CompliantArm(world, CONFIG.compliance, STEP)
    near = CollisionAvoidance(world, CONFIG.compliance)
    q, least = toy.motion.q[0], []
    for bounded in (False, True):
        arm.go(q.copy(), np.zeros(6))
        T, _ = arm.kinematics.at(q)
        for _ in range(250):
            T = T.copy()
            T[1, 3] += 0.05 * STEP
            bounds = near.bounds(arm.q, 0.0) if bounded else None
            twist = np.array([0.0, 0.05, 0.0, 0.0, 0.0, 0.0])
            arm.follow(
                Reference(arm.q, np.zeros(6), T, twist, np.zeros((3, 3)), np.zeros((3, 3)),
                          None, bounds)
            )  # fmt: skip
        least.append(gap(world, arm.q))
    assert least[0] < 0.0
    assert least[1] > CONFIG.compliance.apart / 2


def test_a_paced_approach_is_slow_near_obstacles_and_never_faster_than_planned(
    beside: tuple[Toy, Simulation],
) -> None:
    toy, world = beside
    plan, _ = time_motion(toy.robot, toy.motion, CONFIG.speed, STEP)
    tool = np.array([CompliantArm(world, ComplianceConfig(), STEP).kinematics.at(q)[0][:3, 3]
                     for q in toy.motion.approach])  # fmt: skip
    way = pace_trajectory(plan, toy.motion.approach, tool, world, CONFIG)
    speed = np.linalg.norm(np.gradient(np.stack([np.interp(
        np.arange(len(plan)), plan.state_times / STEP, tool[:, i]) for i in range(3)], 1),
        axis=0), axis=1) / STEP  # fmt: skip
    assert way.pace.max() <= 1.0
    coming = way.left < NEAR_GRASP / 2
    assert (way.pace * speed)[coming].max() < 1.2 * NEAR_SPEED
    change = np.abs(np.diff(way.pace**2)) / 2
    assert change.max() < 1.01 * PACE_RATE * STEP


@pytest.fixture(scope="module")
def free(tmp_path_factory: pytest.TempPathFactory) -> tuple[Execution, np.ndarray]:
    """Run the toy without obstacles; return also the position of the forearm at the end."""
    seen: list[np.ndarray] = []
    done = gripping(tmp_path_factory.mktemp("free")).run(
        watch=lambda world, *_: seen.append(world.data.geom("robot/fore#0").xpos.copy())
    )
    return done, seen[-1]


def test_a_link_in_contact_stops_the_arm_before_it_presses_hard(
    free: tuple[Execution, np.ndarray], tmp_path: Path
) -> None:
    case = make_case()
    case.obstacle([0.05] * 3, free[1].tolist())  # where the forearm ends
    config = ExecutionConfig(compliance=ComplianceConfig(avoid=0.0))  # no avoidance
    done = gripping(tmp_path / "post", case).run(config=config)
    assert not done.success
    assert "something blocks the arm" in done.reason
    assert {done.collisions[0].one, done.collisions[0].other} == {"fore", "post/box"}
    assert done.collisions[0].force < config.touch_force


def test_the_arm_stops_before_the_part_hits_the_robots_base(
    free: tuple[Execution, np.ndarray], tmp_path: Path
) -> None:
    case, halfway = make_case(), 0.6
    on_door = np.array(HINGE) + 0.5 * np.array([-np.sin(halfway), np.cos(halfway), -0.9])
    x, y, z, _ = invert(pose_planar(np.array(BASE))) @ np.append(on_door, 1.0)
    post = (
        '<link name="post"><collision><geometry><box size="0.04 0.04 0.5"/></geometry></collision>'
        '</link><joint name="stands" type="fixed"><parent link="base"/><child link="post"/>'
        f'<origin xyz="{x} {y} {z}"/></joint></robot>'
    )
    case.robot = case.robot.replace("</robot>", post)
    assert free[0].ending == Ending.DONE
    done = gripping(tmp_path, case).run()
    assert done.ending == Ending.MEETS_ROBOT
    assert 0.5 * halfway < done.reached < halfway
    assert all("post" not in (touch.one, touch.other) for touch in done.collisions)


def test_the_hand_avoids_the_object_to_pick_as_long_as_that_stands(
    kitchen: Scene, segway: Robot
) -> None:
    task = make_task(kitchen, "pick", "apple")
    plan = plan_base_placement(kitchen, segway, task).plan
    path = segway.model.urdf.path
    dynamics = read_dynamics(path)
    setting = WorldSetup(
        kitchen, segway, plan.base_pose, plan.motion, task, find_hand(segway, dynamics.mimics),
        dynamics, CONFIG,
    )  # fmt: skip
    world = setting.build(TrueWorld(kitchen, task), PartResistance(0.2, 0.0, 0.0, 0.0))
    avoidance, q = CollisionAvoidance(world, ComplianceConfig()), plan.motion.q[0]
    # The open fingers are around the apple.
    ignored = avoidance.bounds(q, 0.0, hand=True)
    standing = avoidance.bounds(q, 0.0, hand=True, stands=True)
    assert len(standing.rows) > len(ignored.rows)
