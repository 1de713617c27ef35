"""Find likely mistakes in a robot whose file is consistent."""

from __future__ import annotations

import numpy as np

from .arm_states import sample_states, self_collision_shares, touches
from .base_guess import (
    AXLE_TOLERANCE,
    FLOOR_TOLERANCE,
    MAX_WHEEL_HEIGHT,
    base_links,
    off_axle,
    outside,
)
from .drive_guess import DriveGuess, drive_of
from .gripper_guess import points_of
from .joint_tree import find_anchor
from .robot import Robot
from .running_gear import drawn_meshes, find_running_gear

MAX_REPORTED_PAIRS, MIN_REPORTED_SHARE = 5, 0.02
"""Maximum number of reported link pairs, and minimum share of states that each blocks [-]."""
MIN_RADIUS_SHARE = 0.95
"""Share of the radius that the wheels tell from which a robot file's radius is accepted [-]."""


def blocking(robot: Robot, *, seed: int = 0) -> list[str]:
    """Report the pairs of links that block most states of the arm, by spheres and by hulls."""
    states = sample_states(robot.chain, np.random.default_rng(seed))
    shares = self_collision_shares(robot.chain, robot.spheres, states)
    return [
        f"{share.links[0]} and {share.links[1]}: {100 * share.by_spheres:.0f} % of states by "
        f"spheres, {100 * share.by_hulls:.0f} % by hulls"
        + (", which decide" if share.decided_by_hulls else "")
        for share in shares[:MAX_REPORTED_PAIRS]
        if share.by_spheres >= MIN_REPORTED_SHARE
    ]


def examine(robot: Robot, *, seed: int = 0) -> list[str]:
    """Report likely mistakes in a robot; usually none."""
    doubts: list[str] = []
    if robot.chain.size < 6:
        doubts.append(
            f"the arm has {robot.chain.size} degrees of freedom: it reaches few tool poses "
            "exactly and has no reachability map; planning takes longer"
        )
    body = base_links(robot.model, robot.arm_joints[:1])
    points = points_of(robot.model, robot.base_link, body)
    if not len(points):
        return [*doubts, "the base has no collision geometry: its collisions are not checked"]
    low = float(points[:, 2].min())
    above = MAX_WHEEL_HEIGHT if robot.base_link == "base_footprint" else FLOOR_TOLERANCE
    if not -FLOOR_TOLERANCE <= low <= above:
        doubts.append(f"the base's lowest point is {low:.3f} m above z = 0 of {robot.base_link}")
    others = [joint for joint in robot.other_arms if joint not in robot.arm_joints]
    body = base_links(robot.model, [robot.arm_joints[0], *others])
    out = outside(points_of(robot.model, robot.base_link, body), robot.footprint)
    if out > 0.02:
        doubts.append(f"the base protrudes {out:.2f} m from its footprint")
    doubts += _drive_doubts(robot)
    states = sample_states(robot.chain, np.random.default_rng(seed))
    share = touches(robot.chain, robot.spheres, states).mean()
    if share > 0.9:
        doubts.append(
            f"the arm touches the robot in {100 * share:.0f} % of its states: the SRDF may lack "
            "pairs of links"
        )
    return doubts


def _drive_doubts(robot: Robot) -> list[str]:
    """Report a drive of the robot file that the wheels do not have."""
    urdf = robot.model.urdf.path
    assert urdf is not None
    anchor = find_anchor(robot.model, [])
    guess = drive_of(find_running_gear(robot.model, anchor, drawn_meshes(None, urdf)))
    if guess is None or guess.doubt:
        return []
    if guess.drive != robot.drive:
        kind = "car-like" if guess.drive == "car" else guess.drive
        return [f"base.drive is {robot.drive!r}, but the wheels are {kind}: {guess.why}"]
    return _car_doubts(robot, anchor, guess) if robot.drive == "car" else []


def _car_doubts(robot: Robot, anchor: str, guess: DriveGuess) -> list[str]:
    """Report a turning radius or a base link of a car-like base that its wheels do not have."""
    doubts = []
    if robot.min_turning_radius < MIN_RADIUS_SHARE * guess.radius:
        doubts.append(
            f"base.min_turning_radius is {robot.min_turning_radius:.2f} m, but {guess.why}"
        )
    if guess.axle is not None:
        away = off_axle(robot.model, robot.base_link, anchor, guess.axle)
        if away > AXLE_TOLERANCE:
            doubts.append(
                f"base_link {robot.base_link} is {away:.2f} m from the middle of the fixed axle, "
                "about which the base turns; put a frame there ([frames]) and make it base_link"
            )
    return doubts
