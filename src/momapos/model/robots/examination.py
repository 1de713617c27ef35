"""What looks wrong about a robot whose file is consistent."""

from __future__ import annotations

import numpy as np

from .arm_states import sample_states, self_collision_shares, touches
from .base_guess import FLOOR_TOLERANCE, WHEELS_HIGH, base_links, outside
from .gripper_guess import points_of
from .robot import Robot

MOST_PAIRS, WORTH_TELLING = 5, 0.02
"""How many pairs of links are told, and the share of the states that each blocks [-]."""


def blocking(robot: Robot, *, seed: int = 0) -> list[str]:
    """Say which pairs of links block how many states of the arm, by spheres and by hulls."""
    states = sample_states(robot.chain, np.random.default_rng(seed))
    shares = self_collision_shares(robot.chain, robot.spheres, states)
    return [
        f"{share.links[0]} and {share.links[1]}: {100 * share.by_spheres:.0f} % by spheres, "
        f"{100 * share.by_hulls:.0f} % by hulls"
        + (", which decide" if share.decided_by_hulls else "")
        for share in shares[:MOST_PAIRS]
        if share.by_spheres >= WORTH_TELLING
    ]


def examine(robot: Robot, *, seed: int = 0) -> list[str]:
    """Say what looks wrong about a robot whose file is consistent; mostly nothing."""
    doubts: list[str] = []
    if robot.chain.size < 6:
        doubts.append(
            f"the arm has {robot.chain.size} degrees of freedom: it reaches few tool poses "
            "exactly, and has no reachability map; answers take longer"
        )
    body = base_links(robot.model, robot.arm_joints[:1])
    points = points_of(robot.model, robot.base_link, body)
    if not len(points):
        return [*doubts, "the base has no collision geometry: nothing that it could hit is checked"]
    low = float(points[:, 2].min())
    above = WHEELS_HIGH if robot.base_link == "base_footprint" else FLOOR_TOLERANCE
    if not -FLOOR_TOLERANCE <= low <= above:
        doubts.append(f"the base's lowest point is {low:.3f} m from the z = 0 of {robot.base_link}")
    others = [joint for joint in robot.other_arms if joint not in robot.arm_joints]
    body = base_links(robot.model, [robot.arm_joints[0], *others])
    out = outside(points_of(robot.model, robot.base_link, body), robot.footprint)
    if out > 0.02:
        doubts.append(f"the base sticks {out:.2f} m out of its footprint")
    if touches(robot.chain, robot.spheres, robot.home[None], floor=True)[0]:
        doubts.append("the arm touches the robot or the floor at home")
    states = sample_states(robot.chain, np.random.default_rng(seed))
    share = touches(robot.chain, robot.spheres, states).mean()
    if share > 0.9:
        doubts.append(
            f"the arm touches the robot in {100 * share:.0f} % of its states: are pairs of links "
            "missing in the SRDF?"
        )
    return doubts
