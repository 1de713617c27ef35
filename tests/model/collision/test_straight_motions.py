"""Motions that are checked eight states at once agree with the check of single states."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from jaxtyping import Float
from tests.model.collision.exact_hulls import random_states
from tests.model.collision.test_collision import segment_poses, world_of

from momapos.core.compiled import LANES
from momapos.core.geometry.transforms import invert, pose
from momapos.model.collision.arm_collision import FREE
from momapos.model.collision.collision_world import CollisionWorld, build_world, check
from momapos.model.collision.spheres import MARGIN, Spheres, box_spheres, carry
from momapos.model.collision.straight_motions import HandLoad, StraightMotions, build_motions
from momapos.model.robots.load_limits import robot_loads
from momapos.model.robots.robot import Robot
from momapos.model.urdf.hulls import Boxes
from momapos.verification.convex import Body, overlap

BASE = np.array([0.2, -0.1, 0.7])
STEP = 0.1


def states_between(
    a: Float[np.ndarray, " n"], b: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "m n"]:
    """Return evenly spaced states, at most a step apart, a multiple of eight of them."""
    count = LANES * int(np.ceil((max(1, np.ceil(np.abs(b - a).max() / STEP)) + 1) / LANES))
    return a + (b - a) * np.linspace(0.0, 1.0, count)[:, None]


def moves(robot: Robot, rng: np.random.Generator, count: int) -> list[np.ndarray]:
    """Return pairs of configurations, a short way apart."""
    ends = random_states(robot.chain, 2 * count, rng).reshape(count, 2, -1)
    return [np.stack([a, a + 0.1 * (b - a)]) for a, b in ends]


def free_states(
    robot: Robot, world: CollisionWorld, spheres: Spheres, base: np.ndarray, q: np.ndarray,
    value: int, *, holding: bool,
) -> bool:  # fmt: skip
    m = len(q)
    codes = check(
        world, robot.chain, spheres, q, np.tile(base, (m, 1)), np.full(m, value),
        np.full(m, holding),
    )  # fmt: skip
    return bool((codes == FREE).all())


@pytest.mark.parametrize(("value", "holding"), [(0, False), (2, True)])
@pytest.mark.parametrize("hulls_decide", [False, True])
def test_a_motion_is_free_if_all_its_states_are(
    robot: Robot, value: int, *, holding: bool, hulls_decide: bool
) -> None:
    rng = np.random.default_rng(8)
    world = world_of(robot, rng, static=5, moving=2, clearance=0.01)
    spheres = robot.spheres.by_hulls if hulls_decide else robot.spheres
    free = build_motions(world, robot.chain, spheres, BASE, value=value, holding=holding, step=STEP)
    pairs = moves(robot, rng, 120)
    found = [free(a, b) for a, b in pairs]
    expected = [
        free_states(robot, world, spheres, BASE, states_between(a, b), value, holding=holding)
        for a, b in pairs
    ]
    assert found == expected
    assert set(found) == {True, False}


@pytest.mark.parametrize("hulls_decide", [False, True])
def test_cylinders_are_hit_between_the_box_around_them_and_the_prism_in_them(
    robot: Robot, *, hulls_decide: bool
) -> None:
    rng = np.random.default_rng(11)
    world = world_of(robot, rng, static=6, moving=0, clearance=0.0)
    half = 1.8 * world.static.half
    half[:, 1] = half[:, 0]
    spheres = robot.spheres.by_hulls if hulls_decide else robot.spheres

    def free_of(half: np.ndarray, *, cylinder: bool) -> list[bool]:
        boxes = replace(world.static, half=half)
        made = build_world(
            boxes, world.moving, world.grasped, world.labels, spheres, clearance=0.0,
            cylinder=np.full(len(half), cylinder),
        )  # fmt: skip
        free = build_motions(
            made, robot.chain, spheres, BASE, value=0, holding=False, step=STEP, fine=hulls_decide
        )
        found = [free(a, b) for a, b in pairs]
        if cylinder and not hulls_decide:
            assert found == [
                free_states(robot, made, spheres, BASE, states_between(a, b), 0, holding=False)
                for a, b in pairs
            ]
        return found

    pairs = moves(robot, rng, 150)
    inner = half * [np.sqrt(0.5), np.sqrt(0.5), 1.0]
    around, exact, inside = (
        np.array(free_of(size, cylinder=round_))
        for size, round_ in ((half, False), (half, True), (inner, False))
    )
    assert not (around & ~exact).any()
    assert not (exact & ~inside).any()
    assert around.sum() < inside.sum() < len(pairs)


def test_a_base_far_from_the_origin_hits_the_same(robot: Robot) -> None:
    """Single precision must not hide a collision."""
    rng = np.random.default_rng(2)
    world = world_of(robot, rng, static=5, moving=2, clearance=0.0)
    shift = np.array([90.0, -70.0, 0.0])
    there = replace(
        world,
        static=replace(world.static, center=world.static.center + shift),
        moving=replace(world.moving, center=world.moving.center + shift),
        grid_origin=world.grid_origin + shift,
    )
    checks = [
        build_motions(w, robot.chain, robot.spheres, base, value=1, holding=False, step=STEP)
        for w, base in ((world, BASE), (there, BASE + shift))
    ]
    both = np.array([[free(a, b) for free in checks] for a, b in moves(robot, rng, 100)])
    assert not (both[:, 1] & ~both[:, 0]).any()
    assert (both[:, 0] != both[:, 1]).mean() < 0.05
    assert both.any()


def test_clearance_counts_against_everything(robot: Robot) -> None:
    rng = np.random.default_rng(5)
    world = world_of(robot, rng, static=4, moving=0, clearance=0.0)
    near, far = (
        build_motions(
            world, robot.chain, robot.spheres, BASE, value=0, holding=False, step=STEP,
            extra_clearance=extra,
        )
        for extra in (0.0, 0.05)
    )  # fmt: skip
    verdicts = np.array([(near(a, b), far(a, b)) for a, b in moves(robot, rng, 300)])
    assert not (verdicts[:, 1] & ~verdicts[:, 0]).any()
    assert verdicts[:, 1].sum() < verdicts[:, 0].sum()


def test_a_carried_object_may_touch_what_it_is_taken_from_but_not_the_arm(robot: Robot) -> None:
    rng = np.random.default_rng(4)
    held = Boxes(np.array([[0.0, 0.0, 0.12]]), np.eye(3)[None], np.array([[0.05, 0.1, 0.15]]))
    center, radius = box_spheres(held)
    in_segment = robot.chain.tool_offset + center @ robot.chain.tool_rotation.T
    loaded = carry(robot.spheres.by_hulls, robot.chain.last, in_segment, radius)
    world = world_of(robot, rng, static=4, moving=2, clearance=0.0)
    free = build_motions(world, robot.chain, loaded, BASE, value=1, holding=True, step=STEP)
    pairs = moves(robot, rng, 60)
    found = [free(a, b) for a, b in pairs]
    assert found == [
        free_states(robot, world, loaded, BASE, states_between(a, b), 1, holding=True)
        for a, b in pairs
    ]
    alone = build_motions(
        world, robot.chain, robot.spheres.by_hulls, BASE, value=1, holding=True, step=STEP
    )
    assert sum(found) < sum(alone(a, b) for a, b in pairs)


def test_motions_keep_to_what_the_motors_and_the_base_bear(robot: Robot) -> None:
    """With a heavy object in the hand, exactly the motions without an overloaded state remain."""
    rng = np.random.default_rng(6)
    world = world_of(robot, rng, static=0, moving=0, clearance=0.0)
    loads, force, in_tool = robot_loads(robot), np.array([0.0, 0.0, -150.0]), np.array([0, 0, 0.1])

    def bears(q: np.ndarray) -> bool:
        Ts = robot.chain.tool_poses(q)
        points = Ts[:, :3, :3] @ in_tool + Ts[:, :3, 3]
        return not loads.at(q, np.tile(force, (len(q), 1)), points).refused.any()

    def motions(load: HandLoad | None) -> StraightMotions:
        return build_motions(
            world, robot.chain, robot.spheres, BASE, value=0, holding=False, step=STEP, load=load
        )

    pairs = moves(robot, rng, 80)
    bounded, free = motions(HandLoad(loads.arrays, force, in_tool)), motions(None)
    found = [bounded(a, b) for a, b in pairs]
    assert found == [free(a, b) and bears(states_between(a, b)) for a, b in pairs]
    assert sum(found) < sum(free(a, b) for a, b in pairs)


def depth_in_boxes(robot: Robot, world: CollisionWorld, q: Float[np.ndarray, " n"]) -> float:
    """Return how deep a hull of the arm is in a static box, by the exact check [m]."""
    hulls, Ts = robot.spheres.hulls, segment_poses(robot.chain, q[None], BASE[None])[0]
    corners = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
    boxes = [
        (Body(half * corners, 0.0, 0.0), pose(center, turn))
        for center, turn, half in zip(
            world.static.center, world.static.rotation, world.static.half, strict=True
        )
    ]
    deepest = 0.0
    for h in range(hulls.of_group[-1]):
        hull = Body(hulls.vertices[hulls.first[h] : hulls.first[h + 1]], 0.0, 0.0)
        for box, T in boxes:
            T_hull_box = np.ascontiguousarray(invert(Ts[hulls.segment[h]]) @ T)
            deepest = max(deepest, overlap(box, hull, T_hull_box))
    return deepest


def test_where_hulls_decide_more_is_free_and_nothing_that_overlaps_a_box(robot: Robot) -> None:
    gained = 0
    for seed in range(6):
        rng = np.random.default_rng(seed)
        world = world_of(robot, rng, static=12, moving=0, clearance=0.0)
        coarse, fine = (
            build_motions(
                world, robot.chain, robot.spheres.by_hulls, BASE, value=0, holding=False,
                step=STEP, fine=fine,
            )
            for fine in (False, True)
        )  # fmt: skip
        for q in random_states(robot.chain, 1000, rng):
            by_spheres, by_hulls = coarse(q, q), fine(q, q)
            assert by_hulls or not by_spheres
            if by_hulls and not by_spheres:
                gained += 1
                # Spheres leave at most MARGIN uncovered, and where they touch nothing, hulls are
                # not queried.
                assert depth_in_boxes(robot, world, q) <= MARGIN
    assert gained >= 3


def test_where_hulls_decide_the_world_keeps_its_clearance(robot: Robot) -> None:
    rng = np.random.default_rng(11)
    near, far = (
        world_of(robot, np.random.default_rng(11), static=3, moving=0, clearance=clearance)
        for clearance in (0.0, 0.04)
    )
    near_free, far_free = (
        build_motions(
            world, robot.chain, robot.spheres.by_hulls, BASE, value=0, holding=False, step=STEP,
            fine=True,
        )
        for world in (near, far)
    )  # fmt: skip
    verdicts = np.array(
        [(near_free(q, q), far_free(q, q)) for q in random_states(robot.chain, 800, rng)]
    )
    assert not (verdicts[:, 1] & ~verdicts[:, 0]).any()
    assert verdicts[:, 1].sum() < verdicts[:, 0].sum()
