"""Flooded maps, of leaning arms and of arms whose last joint does not turn fully."""

from __future__ import annotations

import json
import struct
import zlib
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_store import LINE, MAP, VALUES

from momapos.core.geometry.transforms import invert, pose_planar
from momapos.model.collision.arm_collision import FREE, KNOWN, check_states
from momapos.model.collision.spheres import Spheres
from momapos.model.kinematics.chain import ObstacleArrays, chain_arrays, chain_limits
from momapos.model.kinematics.ik import bounded, build_ik
from momapos.model.robots.robot import Robot, load_robot
from momapos.planning.reachability.aim import ALL, SPAN, TURNS, LineGrid, aim_all, lines_of
from momapos.planning.reachability.arm_axes import arm_frame, is_flooded, no_map
from momapos.planning.reachability.construct import build_map
from momapos.planning.reachability.flood import _aimed
from momapos.planning.reachability.map_store import (
    decode,
    encode,
    evaluate,
    map_key,
    poses_near_reach,
)
from momapos.planning.reachability.reach_map import OUTSIDE, ReachConfig, ReachMap

NO_BOXES = ObstacleArrays(
    np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3)), np.zeros(0, bool)
)
COARSE = ReachConfig(cell=0.1, directions=9, azimuths=16, states=200_000, threshold=-1.5)


def leaning(name: str, angle: float, last: float) -> Robot:
    """Return a robot whose arm leans to the side, with a last joint limited to +-`last` [rad]."""
    robot = load_robot(name)
    chain, segments = robot._parts
    R = Rotation.from_rotvec([angle, 0, 0]).as_matrix()
    d = np.vstack([chain.d[:1], chain.d[1:] @ R.T])
    lower, upper = chain.lower.copy(), chain.upper.copy()
    lower[-1], upper[-1] = -last, last
    turned = replace(
        chain, h=chain.h @ R.T, d=d, lower=lower, upper=upper,
        tool_offset=R @ chain.tool_offset, tool_rotation=R @ chain.tool_rotation,
    )  # fmt: skip
    changed = replace(robot)
    spheres: Spheres = replace(
        robot.spheres, center=robot.spheres.center @ R.T,
        bound_center=robot.spheres.bound_center @ R.T,
    )  # fmt: skip
    changed.__dict__["_parts"], changed.__dict__["spheres"] = (turned, segments), spheres
    changed.__dict__["ik"] = build_ik(turned)
    return changed


@pytest.fixture(scope="module")
def robot() -> Robot:
    return leaning("husky_ur5e", 0.9, 2.0)


@pytest.fixture(scope="module")
def reach(robot: Robot) -> ReachMap:
    return build_map(robot, COARSE)


def test_a_leaning_arm_has_a_map_that_agrees_with_inverse_kinematics(
    robot: Robot, reach: ReachMap
) -> None:
    assert not robot.chain.upright
    found = evaluate(reach, robot, np.random.default_rng(0), 2000, near=True)
    assert 0.2 < found.reachable < 0.8
    assert found.misses < 0.08
    assert found.false_positives < 0.15


def test_a_turn_of_the_tool_that_the_last_joint_cannot_make_is_out_of_reach(
    robot: Robot, reach: ReachMap
) -> None:
    np.testing.assert_array_equal(reach.turned.max(0), reach.values)
    q = np.random.default_rng(1).uniform(-1.5, 1.5, (400, 6))
    q[:, -1] = 0.0
    Ts = robot.chain.tool_poses(q)
    deep = Ts[(reach.score(Ts) > 0.1)]
    assert len(deep) > 20
    # Some turns of a tool are out of reach. Only the turn changes the score.
    about = np.linspace(0, 2 * np.pi, 16, endpoint=False)[:, None] * reach.line_tool[0]
    turns = np.tile(np.eye(4), (16, 1, 1))
    turns[:, :3, :3] = Rotation.from_rotvec(about).as_matrix()
    turns[:, :3, 3] = reach.line_tool[1] - turns[:, :3, :3] @ reach.line_tool[1]
    each = reach.score(deep[:, None] @ turns)
    assert ((each > 0).any(1) & (each == 0).any(1)).mean() > 0.1
    every = replace(reach, turned=None).score(deep[:, None] @ turns)
    np.testing.assert_allclose(every, every[:, :1].repeat(16, 1), atol=1e-5)
    assert (each <= every + 1e-5).all()


def test_the_turn_of_a_tool_is_the_same_for_every_base(robot: Robot, reach: ReachMap) -> None:
    Ts = poses_near_reach(robot, np.random.default_rng(2), 300)
    moved = pose_planar(np.array([0.3, -0.2, 1.3])) @ Ts
    gap = (reach.turns(moved) - reach.turns(Ts) + 0.5) % 1 - 0.5
    np.testing.assert_allclose(gap, 0, atol=1e-9)
    bases = np.random.default_rng(3).uniform(-0.5, 0.5, (20, 3))
    expected = reach.score(invert(pose_planar(bases))[:, None] @ Ts[None])
    np.testing.assert_allclose(reach.min_score(bases, Ts[:, None]), expected, atol=1e-3)


def test_an_aimed_state_is_on_its_line_and_reaches_its_turns(robot: Robot) -> None:
    chain, frame = robot.chain, arm_frame(robot.chain, robot.approach_axis)
    arm, grid = _aimed(robot, frame), LineGrid(-0.1, 0.05, 13, 32)
    q = np.random.default_rng(4).uniform(-1.5, 1.5, (500, 6))
    places = np.empty((500, 5))
    lines_of(q, arm, grid, places)
    rng = np.random.default_rng(5)
    goals = places + rng.uniform(-0.4, 0.4, places.shape)
    goals[:, 2:4] = np.clip(goals[:, 2:4], 0, 12)
    words, states = np.empty(500, np.uint64), np.empty((500, 6), np.float32)
    known = np.zeros(500, np.uint64)
    aim_all(goals, q.astype(np.float32), known, arm, grid, words, states)
    got = np.flatnonzero(words)
    assert len(got) > 100
    back = np.empty((len(got), 5))
    lines_of(states[got].astype(float), arm, grid, back)
    off = back - goals[got]
    off[:, 4] = (off[:, 4] + 16) % 32 - 16
    # The azimuth is ambiguous near the axis, and the direction on the octahedron's border.
    clear = (goals[got, 1] > 2) & (np.abs(goals[got, 2:4] - 6).max(1) < 5.5)
    assert np.abs(off[clear]).max() < 0.05
    # Without contact, the limits of the last joint bound the turns.
    assert (words & ~ALL == 0).all()
    assert np.bitwise_count(words).max() <= TURNS * 4.0 / (2 * np.pi) + 1
    assert chain_arrays(chain).h.shape == (6, 3)


def test_neighboring_lines_are_found_where_joints_stay_at_their_limits() -> None:
    """A Newton step that includes a joint at its limit falls short of the line."""
    robot = load_robot("tiago")
    arm = _aimed(robot, arm_frame(robot.chain, robot.approach_axis))
    grid = LineGrid(-1.0, 0.1, 13, 8)
    rng, (lower, upper) = np.random.default_rng(8), bounded(robot.chain)
    shape = 1000, robot.chain.size
    beyond = 0.3 * (upper - lower)
    q = np.clip(rng.uniform(lower - beyond, upper + beyond, shape), lower, upper)
    held = (q == lower) | (q == upper)
    assert 2 < held.sum(1).mean() < 4
    there = np.clip(np.where(held, q, q + rng.uniform(-0.2, 0.2, shape)), lower, upper)
    places = np.empty((1000, 5))
    lines_of(there, arm, grid, places)
    none = {
        "against_base": np.zeros(0, np.int64), "pairs": np.zeros((0, 2), np.int64),
        "exact": np.zeros(0, bool),
    }  # fmt: skip
    still, turned = (
        spheres._replace(**none, gripper=np.full_like(spheres.gripper, KNOWN))
        for spheres in (arm.still, arm.turned)
    )
    words, states = np.empty(1000, np.uint64), np.empty(shape, np.float32)
    alone = arm._replace(still=still, turned=turned)
    aim_all(places, q.astype(np.float32), np.zeros(1000, np.uint64), alone, grid, words, states)
    assert (words > 0).mean() > 0.9
    assert (states >= lower - 1e-6).all()
    assert (states <= upper + 1e-6).all()


@pytest.mark.parametrize("name", ["husky_ur5e", "tiago", "tiago_dual"])
def test_a_turn_is_free_where_the_arm_touches_nothing_at_that_last_joint_value(name: str) -> None:
    robot = load_robot(name)
    chain, frame = robot.chain, arm_frame(robot.chain, robot.approach_axis)
    arm, grid = _aimed(robot, frame), LineGrid(-0.1, 0.05, 13, 32)
    lower, upper = bounded(chain)
    q = np.random.default_rng(6).uniform(lower, upper, (300, chain.size)).astype(np.float32)
    places = np.empty((300, 5))
    lines_of(q.astype(float), arm, grid, places)
    words, states = np.empty(300, np.uint64), np.empty_like(q)
    aim_all(places, q, np.zeros(300, np.uint64), arm, grid, words, states)
    np.testing.assert_array_equal(states, q)
    expected = [free_turns(robot, state.astype(float)) for state in q]
    sure = [i for i, word in enumerate(expected) if word is not None]
    assert [expected[i] for i in sure] == words[sure].tolist()
    assert len(sure) > 290
    assert 0.2 < (words > 0).mean() < 1


def free_turns(robot: Robot, q: np.ndarray) -> int | None:
    """Reference implementation: check each group of turns once, at its last possible turn.

    Returns None if a turn is so close to a limit that rounding decides.
    """
    chain, frame = robot.chain, arm_frame(robot.chain, robot.approach_axis)
    R = chain.tool_poses(q)[:3, :3]
    d, across = R @ frame.tool[0], R @ frame.tool[1]
    level = np.array([-d[1], d[0], 0.0]) / np.hypot(d[0], d[1])
    lower, upper = (limits[-1] for limits in chain_limits(chain))
    now = np.arctan2(across @ np.cross(d, level), across @ level) / (2 * np.pi)
    word = 0
    for group in np.split(np.arange(TURNS), TURNS // SPAN):
        values = q[-1] + 2 * np.pi * ((group + 0.5) / TURNS - now % 1)
        if not frame.full_roll:
            values = lower + (values - lower) % (2 * np.pi)
            if abs(values - upper).min() < 1e-4:
                return None
            group, values = group[values <= upper], values[values <= upper]
        if not len(group):
            continue
        state = np.append(q[:-1], values[-1])[None]
        code = check_states(
            state, np.zeros(3), chain_arrays(chain), robot.spheres.arrays, NO_BOXES, False, 0.0
        )
        word |= int((1 << group).sum()) if code[0] == FREE else 0
    return word


@pytest.mark.parametrize(
    ("dof", "turns"),
    [((0, 1, 2, 3, 4, 5), True), ((0, 1, 2, 3, 5, 4), True), ((0, 1, 2, 3, 4, 4), False),
     ((0, 1, 2, 3, 5, 3), False)],
)  # fmt: skip
def test_a_last_joint_turns_only_the_tool_if_no_other_joint_moves_with_it(
    dof: tuple[int, ...], turns: bool, husky: Robot
) -> None:
    """The last degree of freedom need not belong to the last joint."""
    chain = husky.chain
    limits = np.where(np.arange(6) == dof[-1], 4.0, 1.0)
    chain = replace(chain, dof=np.array(dof), lower=-limits, upper=limits)
    frame = arm_frame(chain, np.array([1.0, 0.0, 0.0]))
    q = np.tile(np.random.default_rng(0).uniform(-1, 1, 6), (2, 1))
    q[1, dof[-1]] += 0.5
    Ts = chain.tool_poses(q)
    points = Ts[:, :3, :3] @ frame.tool[3] + Ts[:, :3, 3]
    axes = Ts[:, :3, :3] @ frame.tool[0]
    stays = bool(np.allclose(points[0], points[1]) and np.allclose(axes[0], axes[1]))
    assert (stays, chain.ends_turning, frame.full_roll) == (turns, turns, turns)


def test_a_map_with_turns_is_decoded_as_encoded() -> None:
    turned = np.stack([VALUES, VALUES[::-1]])
    across = np.array([1.0, 0.0, 0.0])
    again = decode(encode(replace(MAP, values=turned.max(0), turned=turned, across_tool=across)))
    assert again.turned is not None
    np.testing.assert_array_equal(again.turned, turned)
    np.testing.assert_array_equal(again.values, turned.max(0))
    np.testing.assert_array_equal(again.across_tool, across)
    np.testing.assert_array_equal(again.line_tool, LINE)


def test_a_map_of_the_older_version_with_turns_first_is_decoded() -> None:
    turned = np.stack([VALUES, VALUES[::-1]])
    data = encode(
        replace(MAP, values=turned.max(0), turned=turned, across_tool=np.array([0, 1.0, 0]))
    )
    begin = data.index(b"{")
    header = json.loads(data[begin : begin + struct.unpack_from("<I", data, begin - 4)[0]])
    assert header["version"] == 4
    header["version"] = 3
    text = json.dumps(header).encode()
    older = (
        data[: begin - 4] + struct.pack("<I", len(text)) + text + zlib.compress(turned.tobytes())
    )
    again = decode(older)
    assert again.turned is not None
    np.testing.assert_array_equal(again.turned, turned)


def test_the_number_of_start_states_is_part_of_the_key_of_flooded_maps_only(
    robot: Robot, husky: Robot
) -> None:
    for one, same in ((husky, True), (robot, False)):
        keys = {map_key(one, replace(COARSE, states=n)) for n in (1000, 2000)}
        assert (len(keys) == 1) == same


def test_a_pose_far_from_a_leaning_arm_is_out_of_reach(reach: ReachMap) -> None:
    far = np.eye(4)
    far[:3, 3] = 0.0, 0.0, 3.0
    assert reach.score(far) == 0.0
    assert (reach.values[-1] == OUTSIDE).any()


def test_an_arm_with_few_joints_has_no_map(robot: Robot) -> None:
    assert no_map(robot) == ""
    chain, segments = robot._parts
    short = replace(robot)
    short.__dict__["_parts"] = (replace(chain, names=chain.names[:5]), segments)
    assert "5 degrees of freedom" in no_map(short)


def test_an_arm_without_closed_form_has_a_map_that_agrees_with_inverse_kinematics(
    husky: Robot,
) -> None:
    chain, segments = husky._parts
    bent = chain.d.copy()
    bent[5] += (0.03, 0.02, 0.01)
    other = replace(husky)
    other.__dict__["_parts"] = (replace(chain, d=bent), segments)
    other.__dict__["spheres"] = husky.spheres
    frame = arm_frame(other.chain, other.approach_axis)
    assert frame.turns_alike
    assert is_flooded(other, frame)
    found = evaluate(build_map(other, COARSE), other, np.random.default_rng(0), 500, near=True)
    assert 0.2 < found.reachable < 0.9
    assert found.misses < 0.08
    assert found.false_positives < 0.15


def test_the_map_of_an_arm_with_hull_checks_against_its_torso_is_flooded(fetch: Robot) -> None:
    """A map that is built line by line checks contact with the torso by spheres only."""
    frame, spheres = arm_frame(fetch.chain, fetch.approach_axis), fetch.spheres
    assert not is_flooded(fetch, frame)
    stands = spheres.segment[spheres.pairs] <= frame.first
    for mixed in (True, False):
        rows = np.flatnonzero((stands[:, 0] != stands[:, 1]) == mixed)
        exact = np.zeros(len(spheres.pairs), bool)
        exact[rows[0]] = True
        other = replace(fetch)
        other.__dict__["_parts"], other.__dict__["ik"] = fetch._parts, fetch.ik
        other.__dict__["spheres"] = replace(spheres, exact=exact)
        assert is_flooded(other, frame) == mixed
