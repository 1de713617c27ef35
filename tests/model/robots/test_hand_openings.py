"""Laws of hands that do not come fully open."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from momapos.model.robots.hand_openings import opened_as, opened_to
from momapos.model.robots.robot import Robot
from momapos.planning.grasps.hand_boxes import hand_of
from momapos.planning.reachability.map_store import default_config, map_key
from momapos.verification.robot_collision_model import robot_collision_model

LIBRARY = (
    "fetch", "tiago", "tiago_dual", "stretch", "mobile_panda", "segway_ur5e", "husky_ur5e",
    "ranger_rm63",
)  # fmt: skip


@pytest.fixture(params=LIBRARY)
def whole(request: pytest.FixtureRequest, robots: Callable[[str], Robot]) -> Robot:
    """Return each robot of the library."""
    return robots(request.param)


def test_the_pads_of_a_hand_are_as_far_apart_as_given(whole: Robot) -> None:
    for width in (0.03, 0.061, 0.078):
        robot = opened_to(whole, width)
        hand = hand_of(robot)
        assert hand.inner(1)[0] - hand.inner(-1)[0] == pytest.approx(width, abs=1e-5)
        assert hand.rest == pytest.approx(0.0, abs=1e-5), "it rests there"
        assert robot.opening == width


def test_only_the_fingers_rest_elsewhere(whole: Robot) -> None:
    robot = opened_to(whole, 0.05)
    before, after = whole.model.rest_poses, robot.model.rest_poses
    moved = {link for link, T in before.items() if np.abs(T - after[link]).max() > 1e-9}
    fingers = {link for link in moved if whole.model.hulls[link]}
    assert len(fingers) == 2
    assert moved <= {*whole.gripper_links}
    assert robot.chain is whole.chain
    assert robot.ik is whole.ik


def test_planner_and_exact_check_see_the_same_hand(whole: Robot) -> None:
    robot = opened_to(whole, 0.05)
    old, new = whole.spheres, robot.spheres
    one, other = (robot_collision_model(r) for r in (whole, robot))
    q = np.zeros((1, len(one.joints)))
    Ts, Ts_narrow = (m.poses(m.body_poses((0.0, 0.0, 0.0), q))[2][0] for m in (one, other))
    for link, center, moved in zip(new.links, old.bound_center, new.bound_center, strict=True):
        shapes = [k for k, name in enumerate(one.arm.names) if name == link]
        by = np.linalg.norm(Ts_narrow[shapes, :3, 3] - Ts[shapes, :3, 3], axis=1)
        np.testing.assert_allclose(by, np.linalg.norm(moved - center), atol=1e-6)


def test_a_hand_that_is_less_open_has_the_map_of_the_robot(whole: Robot) -> None:
    robot = opened_to(whole, 0.05)
    config = default_config(whole)
    assert map_key(robot, config) == map_key(whole, config)


def test_a_plan_tells_how_far_the_hand_is_open(whole: Robot) -> None:
    robot = opened_to(whole, 0.061)
    again = opened_as(whole, robot.model.held)
    assert again.model.rest == robot.model.rest
    assert again.opening == pytest.approx(0.061, abs=1e-4)
    assert again.fully_open is whole
    assert opened_as(again, robot.model.held) is again
    assert opened_as(whole, whole.model.held) is whole
    assert opened_as(whole, {}) is whole, "a plan that names no finger"


def test_no_hand_opens_farther_than_it_can(whole: Robot) -> None:
    assert opened_to(whole, whole.opening) is None
    assert opened_to(whole, whole.opening + 0.01) is None
    assert opened_to(whole, -0.05) is None
