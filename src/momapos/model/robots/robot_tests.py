"""Find likely mistakes in a robot: its home, its gripper, and how it stands."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.collision import build_spheres, contacts
from momapos.model.records import MIN_STABILITY
from momapos.model.urdf import Articulated

from .base_guess import (
    AXLE_TOLERANCE,
    DriveGuess,
    base_links,
    drive_of,
    floor_range,
    off_axle,
    outside,
)
from .fingers import TIP_LENGTH
from .gripper_guess import points_of
from .hand_openings import finger_links, widest_stroke
from .homes import blocked_share
from .joint_tree import find_anchor
from .load_limits import (
    crossing_shares,
    most_crossing,
    robot_loads,
    sample_states,
    self_collision_shares,
    touches,
)
from .robot import Grip, Robot
from .running_gear import drawn_meshes, find_running_gear

if TYPE_CHECKING:
    from jaxtyping import Float


MAX_OPENING_ERROR = 0.01
"""Largest distance by which `opening` may exceed what the fingers open [m]: tips that bow or lean
are hulls here."""


@dataclass(frozen=True)
class RobotTest:
    """A test of one arm of a robot."""

    name: str
    arm: str
    """"" if the robot has only one."""
    passed: bool | None
    """None if the test came to no result."""
    words: str
    """What was found."""
    remedy: str = ""
    """What to correct if the test failed."""


def examine_at_rest(robot: Robot) -> tuple[RobotTest, ...]:
    """Test whether home is free of contact, the gripper opens, and the robot stands upright.

    If its SRDF has pairs of links that never touch, these are tested, too.
    """
    return _home(robot), _gripper(robot), _upright(robot), *_claims(robot)


def _claims(robot: Robot) -> Iterator[RobotTest]:
    """Test the pairs that the SRDF says never touch, by the meshes as they are in the files."""
    if robot.srdf is None or not robot.claimed:
        return
    model, chain, segments = robot.model, robot.chain, robot.segments
    others = robot.disabled - robot.claimed
    spheres = build_spheres(model, segments, others, robot.gripper_links)
    q = np.vstack([robot.home, sample_states(chain, np.random.default_rng(0))])
    shares = crossing_shares(model, chain, segments, spheres, robot.claimed, q)
    if not shares:
        words = f"the pairs that never touch by {robot.srdf.name} are apart in {len(q)} states"
        yield RobotTest("srdf", robot.arm, True, words)
        return
    words = f"{robot.srdf.name} says that they never touch, but {most_crossing(shares)}"
    yield RobotTest("srdf", robot.arm, False, words, f"remove these pairs from {robot.srdf}")


def _home(robot: Robot) -> RobotTest:
    q = robot.home[None]
    found = contacts(robot.chain, robot.spheres, q)
    pairs = [p for p, hit in zip(found.pairs, found.by_hulls[0], strict=True) if hit]
    file = robot.path.name
    low = float(_arm_points(robot, robot.model)[:, 2].min(initial=np.inf))
    if pairs:
        more = f" and {len(pairs) - 1} more pairs" if len(pairs) > 1 else ""
        words = f"{pairs[0][0]} touches {pairs[0][1]}{more}"
        remedy = f"change home in {file}, or disable the pair in its SRDF if it touches by design"
        return RobotTest("home", robot.arm, False, words, remedy)
    if low < 0.0:
        words = f"the arm is {-low:.2f} m below the floor"
        return RobotTest("home", robot.arm, False, words, f"change home in {file}")
    if touches(robot.chain, robot.spheres, q, floor=True)[0]:
        words = (
            "the arm is free of contact, but nearer to the robot or the floor than planning allows"
        )
        return RobotTest("home", robot.arm, False, words, f"change home in {file}")
    shared = [k for k, name in enumerate(robot.chain.names) if name in robot.other_arms]
    share = float(blocked_share(robot.chain, robot.spheres, q, shared)[0])
    if share:
        names = ", ".join(robot.chain.names[k] for k in shared)
        words = (
            f"free of contact, but nearer to the robot than planning allows at {100 * share:.0f} % "
            f"of the values of {names}, which other arms move, too"
        )
        return RobotTest("home", robot.arm, None, words, f"change home in {file}, or give --home")
    return RobotTest("home", robot.arm, True, "free of contact")


def _arm_points(robot: Robot, model: Articulated) -> Float[np.ndarray, "n 3"]:
    """Return the hull vertices of what the arm moves, at home, in the base frame [m]."""
    moved = {link for joint in robot.arm_joints for link in model.moved_by(joint)}
    values = dict(zip(robot.arm_joints, map(float, robot.home), strict=True))
    model = model.changed(held={**model.held, **values})
    return points_of(model, robot.base_link, sorted(moved))


def _gripper(robot: Robot) -> RobotTest:
    """Compare the opening with the distance of the fingertips in the robot's own kinematics."""
    file = robot.path.name
    if robot.grips is not Grip.FINGERS:
        return RobotTest(
            "gripper", robot.arm, True, f"holds with {robot.grips}, no fingers to open"
        )
    fingers = finger_links(robot)
    if not fingers:
        words = "no finger with a collision shape moves, so the tool holds nothing"
        remedy = (
            f"use a URDF with the gripper, set grips to suction or hook in {file}, or let fingers "
            "that are only drawn count: --visual-hulls, or visual_hulls = true in the file"
        )
        return RobotTest("gripper", robot.arm, False, words, remedy)
    widest = widest_stroke(robot)
    stroke = 0.0 if widest is None else widest.opening
    joints = [joint for joint in robot.model.joints.values() if joint.child in fingers]
    roots = sum(joint.parent not in fingers for joint in joints)
    if not stroke and roots > 2:
        words = f"a hand of {roots} fingers; opening {robot.opening:g} m is not measured"
        return RobotTest("gripper", robot.arm, None, words)
    gap = max(_gap_at_rest(robot, fingers), stroke)
    if gap <= 0.0:
        words = f"the gap between the fingers is unclear; opening {robot.opening:g} m is a guess"
        return RobotTest("gripper", robot.arm, None, words)
    words = f"the fingertips open to {gap:.3f} m, opening is {robot.opening:g} m"
    if robot.opening > gap + MAX_OPENING_ERROR:
        remedy = f"correct opening, closing_axis or the fingers in [rest] of {file}"
        return RobotTest("gripper", robot.arm, False, words, remedy)
    return RobotTest("gripper", robot.arm, True, words)


def _gap_at_rest(robot: Robot, fingers: set[str]) -> float:
    """Return the distance between the tips on either side of the tool frame [m]; 0 if unclear."""
    sides: tuple[list[np.ndarray], list[np.ndarray]] = ([], [])
    for link in fingers:
        points = points_of(robot.model, robot.tool_link, [link])
        if len(points):
            sides[int(points.mean(0) @ robot.closing_axis > 0)].append(points)
    if not all(sides):
        return 0.0
    inner = []
    for points, sign in zip(map(np.concatenate, sides), (-1.0, 1.0), strict=True):
        ahead = points @ robot.approach_axis
        tips = points[ahead > ahead.max() - TIP_LENGTH]
        inner.append(float((sign * (tips @ robot.closing_axis)).min()))
    return max(sum(inner), 0.0)


def _upright(robot: Robot) -> RobotTest:
    """Check that the base reaches the floor and not below it, and that the robot stands at home."""
    file = robot.path.name
    body = base_links(robot.model, robot.arm_joints[:1])
    points = points_of(robot.model, robot.base_link, body)
    if not len(points):
        words = "the base has no collision geometry"
        return RobotTest("upright", robot.arm, None, words)
    low, high = float(points[:, 2].min()), float(points[:, 2].max())
    least, most = floor_range(robot.model, robot.base_link, body)
    if not least <= low <= most:
        words = f"the base spans z = {low:.3f} to {high:.2f} m of {robot.base_link}"
        remedy = f"base_link in {file} must lie on the floor, with z up"
        return RobotTest("upright", robot.arm, False, words, remedy)
    stability = float(robot_loads(robot).at(robot.home[None]).stability[0])
    if not np.isfinite(stability):
        why = next((n for n in robot_loads(robot).notes if n.startswith("stability")), "")
        return RobotTest("upright", robot.arm, True, f"on the floor with z up; {why}".rstrip("; "))
    words = f"on the floor with z up, {100 * stability:.0f} cm from tipping over at home"
    return RobotTest("upright", robot.arm, stability >= MIN_STABILITY, words)


def examine_drawn(robot: Robot, drawn: Articulated) -> Iterator[RobotTest]:
    """Test height and drive with what is drawn, which the robot file is not derived from.

    Args:
        robot: The robot.
        drawn: The robot as drawn, see `drawn_model`.

    Yields:
        The test of the drive, and those of others that fail.
    """
    file, arm = robot.path.name, _arm_points(robot, drawn)[:, 2].min(initial=np.inf)
    if arm < -MAX_DRAWN_ERROR:
        words = f"the arm as drawn is {1000 * -arm:.0f} mm below the floor"
        yield RobotTest("home", robot.arm, False, words, f"change home in {file}")
    body = base_links(drawn, robot.arm_joints[:1])
    points = points_of(drawn, robot.base_link, body)
    if len(points):
        low = float(points[:, 2].min())
        least, most = floor_range(drawn, robot.base_link, body)
        if not least - MAX_DRAWN_ERROR <= low <= most + MAX_DRAWN_ERROR:
            words = f"the base as drawn begins at z = {low:.3f} m of {robot.base_link}"
            remedy = f"base_link in {file} must lie on the floor, with z up"
            yield RobotTest("upright", robot.arm, False, words, remedy)
    urdf = robot.model.urdf.path
    assert urdf is not None
    gear = find_running_gear(drawn, find_anchor(drawn, []), drawn_meshes(None, urdf))
    guess = drive_of(gear)
    if guess is None or guess.doubt:
        return
    words = f"{robot.drive}; the wheels as drawn are {guess.drive}: {guess.why}"
    remedy = f"correct base.drive in {file}"
    yield RobotTest("drive", "", guess.drive == robot.drive, words, remedy)


MAX_DRAWN_ERROR = 0.01
"""How far what is drawn may be from where collision shapes are at most [m]."""
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
    least, most = floor_range(robot.model, robot.base_link, body)
    if not least <= low <= most:
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
