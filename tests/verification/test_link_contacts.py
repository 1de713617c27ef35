"""What touches in a state, by the shapes and pairs of the exact check."""

from __future__ import annotations

import numpy as np
import pytest

from momapos.model.collision.self_collision import contacts
from momapos.model.robots.robot import Robot, load_robot
from momapos.verification.robot_collision_model import link_contacts, self_contacts


def states(robot: Robot, count: int) -> np.ndarray:
    low, high = np.maximum(robot.chain.lower, -3.0), np.minimum(robot.chain.upper, 3.0)
    return np.random.default_rng(0).uniform(low, high, (count, len(low)))


@pytest.mark.parametrize("name", ["fetch", "segway_ur5e", "tiago"])
def test_links_that_touch_are_those_of_check_and_planner(name: str) -> None:
    robot = load_robot(name)
    q = states(robot, 60)
    planned, some = contacts(robot.chain, robot.spheres, q), 0
    for state, touch in zip(q, planned.by_hulls, strict=True):
        found = link_contacts(robot, dict(zip(robot.arm_joints, state.tolist(), strict=True)))
        own = [contact for contact in found if len(contact.links) == 2]
        some += len(own)
        check = self_contacts(robot, robot.chain.joint_values(state)[None], lambda _: "state")
        assert max((c.depth for c in own), default=0.0) == pytest.approx(check.value / 1000)
        known = {frozenset(p) for p, hit in zip(planned.pairs, touch, strict=True) if hit}
        assert {frozenset(contact.links) for contact in own} <= known
    assert some > 10


def test_an_arm_below_the_floor_is_named(fetch: Robot) -> None:
    found = (
        link_contacts(fetch, dict(zip(fetch.arm_joints, state.tolist(), strict=True)))
        for state in states(fetch, 1000)
    )
    low = next(one for contacts in found for one in contacts if len(one.links) == 1)
    assert low.words == f"{low.links[0]} is {1000 * low.depth:.0f} mm below the floor"
