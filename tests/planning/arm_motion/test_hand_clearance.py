"""Test the collision check of the hand alone: spheres find what is near, boxes decide."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.model.collision.exact_hulls import random_boxes, random_states, rotations
from tests.rooms import Everywhere, cabinet_room

from momapos.core.geometry.transforms import pose_planar
from momapos.model.collision.arm_collision import FLOOR, FREE, OTHER, SELF
from momapos.model.collision.base_collision import base_hits
from momapos.model.collision.collision_world import CollisionWorld, build_world, check
from momapos.model.collision.sphere_cover import MARGIN
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene_files import load_scene
from momapos.model.urdf.hulls import Boxes, MovingBoxes
from momapos.planning.arm_motion.hand_clearance import (
    GAP,
    arm_spheres,
    hand_hits,
    hits_while_closing,
)
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.hand_boxes import hand_of
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.verification.exact_check import PlanVerifier

NOTHING = MovingBoxes(np.zeros((1, 0, 3)), np.zeros((1, 0, 3, 3)), np.zeros((1, 0, 3)))
ORIGIN = np.zeros((1, 3))


def world_of(robot: Robot, boxes: Boxes) -> CollisionWorld:
    labels = [f"box {k}" for k in range(len(boxes))]
    nothing = np.zeros(0, bool)
    return build_world(boxes, NOTHING, nothing, labels, robot.spheres, clearance=0.003)


def hits(
    robot: Robot, world: CollisionWorld, Ts: np.ndarray, *, exact: bool, travel: float = 0.0
) -> np.ndarray:
    count = len(Ts)
    return np.asarray(
        hand_hits(
            robot, world, Ts, np.zeros(count, np.int64), np.ones(count, bool),
            np.full(count, exact), np.full(count, travel),
        )
    )  # fmt: skip


def tool_poses(count: int, rng: np.random.Generator) -> np.ndarray:
    Ts = np.tile(np.eye(4), (count, 1, 1))
    Ts[:, :3, :3] = rotations(count, rng)
    Ts[:, :3, 3] = rng.uniform((-0.3, -0.3, 0.7), (0.3, 0.3, 1.3), (count, 3))
    return Ts


def placed(robot: Robot, T: np.ndarray, travel: float) -> Boxes:
    """Return the gripper's boxes at a tool pose, from the hand model of the grasps."""
    hand = hand_of(robot)
    shift = (travel + hand.rest) * hand.side
    center = hand.boxes.center - shift[:, None] * hand.closing
    return Boxes(center @ T[:3, :3].T + T[:3, 3], T[:3, :3] @ hand.boxes.rotation, hand.boxes.half)


def test_arm_and_hand_are_free_if_and_only_if_the_whole_robot_is(robot: Robot) -> None:
    rng = np.random.default_rng(0)
    world = world_of(robot, random_boxes(12, rng, (-1.0, -1.0, 0.0), (1.0, 1.0, 1.8)))
    q = random_states(robot.chain, 2000, rng)
    bases = rng.uniform((-1.0, -1.0, -np.pi), (1.0, 1.0, np.pi), (len(q), 3))
    state = np.zeros(len(q), np.int64), np.ones(len(q), bool)
    whole = check(world, robot.chain, robot.spheres.by_hulls, q, bases, *state)
    arm = check(world, robot.chain, arm_spheres(robot), q, bases, *state)
    Ts = pose_planar(bases) @ robot.chain.tool_poses(q)
    hand = hits(robot, world, Ts, exact=False)
    assert 0.02 < (whole == FREE).mean() < 0.98
    assert ((arm == FREE) & (hand != FREE)).any()
    np.testing.assert_array_equal(whole == FREE, (arm == FREE) & (hand == FREE))
    np.testing.assert_array_equal(whole[arm == SELF] == FREE, False)


@pytest.mark.parametrize("closed", [0.0, 0.6, 1.0])
def test_the_boxes_of_the_gripper_decide_where_its_spheres_touch(
    robot: Robot, closed: float
) -> None:
    rng = np.random.default_rng(1)
    half = rng.uniform(0.003, 0.03, (60, 3))
    boxes = Boxes(
        rng.uniform((-0.3, -0.3, 0.7), (0.3, 0.3, 1.3), (60, 3)), rotations(60, rng), half
    )
    world = world_of(robot, boxes)
    Ts = tool_poses(600, rng)
    travel = closed * hand_of(robot).travel
    near, exact = (hits(robot, world, Ts, exact=e, travel=travel) != FREE for e in (False, True))
    touched = np.array(
        [base_hits(ORIGIN, placed(robot, T, travel), boxes, clearance=GAP)[0] for T in Ts]
    )
    touched = touched != FREE
    assert (near & ~exact).sum() > 4
    assert not (exact & ~near).any()
    assert not (exact & ~touched & ~by_wrist(robot, world, Ts)).any()
    # Spheres find every overlap deeper than the margin by which they may miss the gripper's shape.
    deep = np.array([deepest(placed(robot, T, travel), boxes) > MARGIN for T in Ts])
    assert deep.sum() > 40
    assert not (deep & ~exact).any()


def deepest(hand: Boxes, boxes: Boxes) -> float:
    """Return the largest depth of the hand's points in another box [m]; 0 far from all."""
    middle = hand.center.mean(axis=0)
    reach = np.linalg.norm(hand.center - middle, axis=1) + np.linalg.norm(hand.half, axis=1)
    apart = np.linalg.norm(boxes.center - middle, axis=1) - np.linalg.norm(boxes.half, axis=1)
    near = apart < reach.max()
    if not near.any():
        return 0.0
    t = np.linspace(-1, 1, 3)
    grid = np.stack(np.meshgrid(t, t, t, indexing="ij"), -1).reshape(-1, 3)
    points = (
        np.einsum("bij,bnj->bni", hand.rotation, grid * hand.half[:, None]) + hand.center[:, None]
    )
    local = np.einsum(
        "oji,onj->oni", boxes.rotation[near], points.reshape(1, -1, 3) - boxes.center[near, None]
    )
    return float((boxes.half[near, None] - np.abs(local)).min(-1).max())


def by_wrist(robot: Robot, world: CollisionWorld, Ts: np.ndarray) -> np.ndarray:
    """Check whether spheres of non-gripper links that move with the hand touch a box."""
    chain, spheres = robot.chain, robot.spheres
    found = np.zeros(len(Ts), bool)
    last = robot.segments.of_link[robot.tool_link]
    for g in np.flatnonzero((spheres.segment == last) & (spheres.gripper == OTHER)):
        rows = slice(*spheres.start[g : g + 2])
        local = (spheres.center[rows] - chain.tool_offset) @ chain.tool_rotation
        points = np.einsum("mij,sj->msi", Ts[:, :3, :3], local) + Ts[:, None, :3, 3]
        still = world.static
        for c, R, h in zip(still.center, still.rotation, still.half, strict=True):
            apart = np.linalg.norm(np.maximum(np.abs((points - c) @ R) - h, 0.0), axis=-1)
            found |= (apart < spheres.radius[rows] + world.clearance).any(1)
    return found


def test_closed_fingers_hit_an_obstacle_between_them(robot: Robot) -> None:
    hand = hand_of(robot)
    across = np.cross(hand.approach, hand.closing)
    R = np.stack([hand.approach, hand.closing, across], axis=-1)
    board = Boxes(
        hand.tip * hand.approach[None] + [0, 0, 1.0], R[None],
        np.array([[0.004, 0.004, 0.05]]),
    )  # fmt: skip
    world = world_of(robot, board)
    T = np.eye(4)[None].copy()
    T[0, 2, 3] = 1.0
    assert hits(robot, world, T, exact=True)[0] == FREE
    assert hits(robot, world, T, exact=True, travel=hand.travel - 0.002)[0] == 0


def test_closing_fingers_hit_an_obstacle_that_they_span(robot: Robot) -> None:
    hand = hand_of(robot)
    face, corners = hand.inner(1)
    travel = hand.travel - hand.rest - 0.002
    assert travel > hand.thickness
    # A sheet just inside the open pad, clear of the closed finger and the palm.
    R = np.stack([hand.approach, hand.closing, np.cross(hand.approach, hand.closing)], axis=-1)
    middle = R @ [corners[1, 0], face - hand.rest - GAP - 0.001, corners.mean(0)[1]]
    up = np.array([0.0, 0.0, 1.0])
    sheet = Boxes(middle[None] + up, R[None], np.array([[0.002, 0.0005, 0.002]]))
    world = world_of(robot, sheet)
    T = np.eye(4)[None].copy()
    T[0, 2, 3] = 1.0
    for closed in (0.0, travel):
        assert hits(robot, world, T, exact=True, travel=closed)[0] == FREE
    one, yes = np.zeros(1, np.int64), np.ones(1, bool)
    assert hits_while_closing(robot, world, T, one, yes, yes, np.array([travel]))[0] == 0
    away = world_of(robot, Boxes(sheet.center + up, sheet.rotation, sheet.half))
    assert hits_while_closing(robot, away, T, one, yes, yes, np.array([travel]))[0] == FREE


def test_a_gripper_below_the_floor_hits_it(robot: Robot) -> None:
    hand = hand_of(robot)
    down = np.stack([hand.closing, np.cross(-hand.approach, hand.closing), -hand.approach])
    T = np.eye(4)[None].copy()
    T[0, :3, :3] = down
    world = world_of(robot, Boxes(np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3))))
    for height, code in ((hand.tip + 0.002, FREE), (hand.tip - 0.002, FLOOR)):
        T[0, 2, 3] = height
        assert hits(robot, world, T, exact=True)[0] == code


def test_a_handle_of_one_centimeter_near_its_carcass_can_be_grasped(
    tmp_path: Path, ranger: Robot
) -> None:
    cabinet_room(tmp_path)
    file = tmp_path / "cabinet.urdf"
    plate = (
        '<collision><origin xyz="0 -0.265 0.8"/><geometry><box size="0.6 0.016 0.6"/></geometry>'
        '</collision>\n</link>\n<link name="door">'
    )
    text = file.read_text().replace('</link>\n<link name="door">', plate)
    text = text.replace('size="0.016 0.016 0.2"', 'size="0.016 0.011 0.05"')
    text = text.replace("-0.065 0", "-0.0265 0")
    file.write_text(text)
    scene = load_scene(tmp_path / "room.json")
    task = make_task(scene, "open", "cabinet", to=1.2)
    answer = plan_base_placement(scene, ranger, task, Everywhere(), config=PipelineConfig())
    assert answer.plan.status == "solved", answer.plan.candidates
    verifier = PlanVerifier(scene, ranger, task)
    assert verifier.check(answer.plan.base_pose, answer.plan.motion).valid
