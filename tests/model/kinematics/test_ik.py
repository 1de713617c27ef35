"""Inverse kinematics: all solutions are correct and complete."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jaxtyping import Float
from numpy.testing import assert_allclose
from tests import optional
from tests.model.collision.exact_hulls import directions, random_states, rotations

from momapos.core.geometry.transforms import rotation_angle, wrap_angle
from momapos.model.kinematics.chain import Chain
from momapos.model.kinematics.closed_forms import (
    MAX_BRANCHES,
    THREE_PARALLEL,
    WRIST_MEETING,
    WRIST_PARALLEL,
)
from momapos.model.kinematics.ik import IkModel, build_ik, into_limits, solve_ik
from momapos.model.robots.robot import Robot

TURN = 2 * np.pi
PER_JOINT = (
    "names", "joints", "dof", "ratio", "offset", "h", "d", "slides", "lower", "upper", "velocity",
)  # fmt: skip
KINDS = {
    "segway_ur5e": THREE_PARALLEL,
    "husky_ur5e": THREE_PARALLEL,
    "fetch": WRIST_MEETING,
    "ranger_rm63": WRIST_PARALLEL,
}
LOCKED = {
    "segway_ur5e": (),
    "husky_ur5e": (),
    "fetch": ("torso_lift_joint", "shoulder_pan_joint"),
    "ranger_rm63": ("joint_arm_rotary",),
}


def states_on_samples(
    chain: Chain, ik: IkModel, count: int, rng: np.random.Generator
) -> Float[np.ndarray, "m n"]:
    """Return random states with the locked joints at sampled values."""
    q = random_states(chain, count, rng)
    locked = np.setdiff1d(np.arange(chain.size), ik.active)
    q[:, locked] = ik.samples[rng.integers(len(ik.samples), size=count)][:, locked]
    return q


def solutions(
    chain: Chain, ik: IkModel, Ts: Float[np.ndarray, "m 4 4"]
) -> list[Float[np.ndarray, "b n"]]:
    found, counts = solve_ik(chain, ik, Ts)
    return [q[:count] for q, count in zip(found, counts, strict=True)]


def misses(q: Float[np.ndarray, "b n"], wanted: Float[np.ndarray, " n"]) -> float:
    """Return the distance from a state to the nearest solution, up to full turns [rad]."""
    return float(np.abs(wrap_angle(q - wanted)).max(1).min(initial=np.inf))


@pytest.mark.parametrize("name", KINDS)
def test_each_library_arm_has_its_closed_form(robots: Callable[[str], Robot], name: str) -> None:
    robot = robots(name)
    names = np.array(robot.chain.names)
    assert robot.ik.kind == KINDS[name]
    assert tuple(np.delete(names, robot.ik.active)) == LOCKED[name]


def test_every_solution_reproduces_the_pose_within_limits(robot: Robot) -> None:
    chain = robot.chain
    Ts = chain.tool_poses(random_states(chain, 150, np.random.default_rng(0)))
    q, counts = solve_ik(chain, robot.ik, Ts)
    valid = np.arange(q.shape[1]) < counts[:, None]
    assert np.isfinite(q[valid]).all()
    assert np.isnan(q[~valid]).all()
    again, wanted = chain.tool_poses(q[valid]), Ts[np.nonzero(valid)[0]]
    assert_allclose(again[:, :3, 3], wanted[:, :3, 3], atol=1e-6)
    assert rotation_angle(again[:, :3, :3], wanted[:, :3, :3]).max() < 1e-6
    assert (q[valid] >= chain.lower - 1e-8).all()
    assert (q[valid] <= chain.upper + 1e-8).all()
    locked = np.setdiff1d(np.arange(chain.size), robot.ik.active)
    for branches in (row[:count][:, locked] for row, count in zip(q, counts, strict=True)):
        if len(branches):
            assert np.unique(branches, axis=0, return_counts=True)[1].max() <= MAX_BRANCHES


def test_the_solutions_for_a_pose_include_its_state(robot: Robot) -> None:
    """Up to full turns, and with the locked joints at sampled values."""
    q = states_on_samples(robot.chain, robot.ik, 500, np.random.default_rng(1))
    found = solutions(robot.chain, robot.ik, robot.chain.tool_poses(q))
    worst = max(misses(branches, state) for branches, state in zip(found, q, strict=True))
    # Near a singularity, a pose error of 1e-9 gives angle errors of its square root.
    assert worst < 1e-3
    assert np.median([misses(b, s) for b, s in zip(found, q, strict=True)]) < 1e-9


@settings(max_examples=200)
@given(q=st.lists(st.floats(-TURN, TURN), min_size=6, max_size=6))
def test_a_ur5e_has_solutions_in_every_state(
    robots: Callable[[str], Robot], q: list[float]
) -> None:
    """This includes straight arms and aligned wrists, where branches meet."""
    chain, ik = robots("segway_ur5e").chain, robots("segway_ur5e").ik
    state = np.clip(q, chain.lower, chain.upper)
    T = chain.tool_poses(state[None])
    found = solutions(chain, ik, T)[0]
    assert len(found) > 0
    assert_allclose(chain.tool_poses(found), np.broadcast_to(T, (len(found), 4, 4)), atol=1e-6)


def test_singular_states_have_at_least_one_solution(robot: Robot) -> None:
    """Where axes align, branches meet and angles are not unique."""
    rng, chain = np.random.default_rng(8), robot.chain
    q = states_on_samples(chain, robot.ik, 1000, rng)
    corners = rng.choice([0.0, np.pi / 2, -np.pi / 2, 1e-6, 1e-4], q.shape)
    inside = (corners > chain.lower + 1e-3) & (corners < chain.upper - 1e-3)
    change = inside & (rng.random(q.shape) < 0.5)
    change[:, np.setdiff1d(np.arange(chain.size), robot.ik.active)] = False
    Ts = chain.tool_poses(np.where(change, corners, q))
    assert (solve_ik(chain, robot.ik, Ts)[1] > 0).all()


def test_branches_are_distinct(robots: Callable[[str], Robot]) -> None:
    chain, ik = robots("segway_ur5e").chain, robots("segway_ur5e").ik
    Ts = chain.tool_poses(random_states(chain, 100, np.random.default_rng(2)))
    for q in solutions(chain, ik, Ts):
        apart = np.abs(wrap_angle(q[:, None] - q[None])).max(2)
        assert (apart + TURN * np.eye(len(q)) > 1e-4).all()


def test_unreachable_poses_have_no_solution(robot: Robot) -> None:
    rng, chain = np.random.default_rng(3), robot.chain
    first = int(np.argmin(chain.prismatic))
    # The tool's distance from the first revolute axis is at most the total link length.
    q = random_states(chain, 2000, rng)
    tools = chain.tool_poses(q)[:, :3, 3]
    shoulder = chain.d[: first + 1].sum(0) + np.where(
        chain.prismatic[:first, None], q[:, :first, None] * chain.h[:first], 0.0
    ).sum(1)
    assert np.linalg.norm(tools - shoulder, axis=1).max() <= robot.reach
    travel = np.where(chain.prismatic, abs(chain.lower) + abs(chain.upper), 0.0).sum()
    Ts = np.tile(np.eye(4), (200, 1, 1))
    Ts[:, :3, :3] = rotations(200, rng)
    beyond = robot.reach + travel + 0.01
    Ts[:, :3, 3] = chain.d[: first + 1].sum(0) + directions(200, rng) * beyond
    assert (solve_ik(chain, robot.ik, Ts)[1] == 0).all()


def ideal(chain: Chain) -> Chain:
    """Return the arm without rounding errors: axes of 0 and 1, offsets in micrometers."""
    return replace(chain, h=np.round(chain.h, 3), d=np.round(chain.d, 5))


@pytest.mark.parametrize("name", ["segway_ur5e", "ranger_rm63", "fetch"])
def test_reachability_agrees_with_eaik(robots: Callable[[str], Robot], name: str) -> None:
    """The locked joints have one value. EAIK ignores limits, so ours are removed."""
    eaik = optional.module("eaik.IK_HP")
    rng, robot = np.random.default_rng(4), robots(name)
    chain = ideal(robot.chain)
    free = replace(chain, lower=np.full(chain.size, -np.inf), upper=np.full(chain.size, np.inf))
    whole = build_ik(chain)
    parts, one = ("samples", "h", "o", "wrist", "R_tool", "p_tool"), len(whole.samples) // 2
    ik = replace(whole, **{k: getattr(whole, k)[one : one + 1] for k in parts})
    o, tool = axes_of(chain, ik.samples[0], ik.active)
    twin = eaik.HPRobot(ik.h[0], np.diff(np.vstack([np.zeros(3), o, tool[:3, 3]]), axis=0))
    assert twin.hasKnownDecomposition()
    Ts = np.tile(np.eye(4), (400, 1, 1))
    Ts[:, :3, :3] = rotations(400, rng)
    Ts[:, :3, 3] = o[0] + directions(400, rng) * (robot.reach * rng.random((400, 1)) ** (1 / 3))
    ours = solve_ik(free, ik, Ts)[1] > 0
    turned = Ts.copy()
    turned[:, :3, :3] = Ts[:, :3, :3] @ tool[:3, :3].T
    theirs = np.array([not np.all(found.is_LS) for found in map(twin.IK, turned)])
    assert 0.1 < theirs.mean() < 0.9
    assert (ours == theirs).all()


def axes_of(
    chain: Chain, sample: Float[np.ndarray, " n"], active: np.ndarray
) -> tuple[Float[np.ndarray, "a 3"], Float[np.ndarray, "4 4"]]:
    """Return origins of the active joints and the tool pose at a sample, by shortened chains."""
    origins = []
    for j in active:
        cut = {k: getattr(chain, k)[: j + 1] for k in PER_JOINT}
        short = replace(chain, **cut, tool_offset=np.zeros(3))
        origins.append(short.tool_poses(sample[: j + 1])[:3, 3])
    return np.array(origins), chain.tool_poses(sample)


def test_values_of_a_long_rail_are_not_wrapped(robots: Callable[[str], Robot]) -> None:
    """Values beyond pi meters are distances, not angles."""
    chain = robots("segway_ur5e").chain
    along = np.array([[1.0, 0.0, 0.0]])
    railed = replace(
        chain,
        names=("rail", *chain.names), joints=("rail", *chain.joints),
        dof=np.arange(chain.size + 1), ratio=np.r_[1.0, chain.ratio],
        offset=np.r_[0.0, chain.offset], h=np.vstack([along, chain.h]),
        d=np.vstack([0 * along, chain.d]), slides=np.r_[True, chain.slides],
        lower=np.r_[0.0, chain.lower], upper=np.r_[8.0, chain.upper],
        velocity=np.r_[1.0, chain.velocity],
    )  # fmt: skip
    ik = build_ik(railed)
    assert ik.samples[:, 0].max() == 8.0
    q = states_on_samples(railed, ik, 50, np.random.default_rng(6))
    for branches, state in zip(solutions(railed, ik, railed.tool_poses(q)), q, strict=True):
        assert np.isclose(branches[:, 0], state[0]).any()


@settings(max_examples=500)
@given(q=st.floats(-20, 20), lower=st.floats(-TURN, TURN), width=st.floats(0.0, 2 * TURN))
def test_an_angle_is_shifted_into_its_limits_by_full_turns_or_rejected(
    q: float, lower: float, width: float
) -> None:
    upper = min(lower + width, TURN)
    shifts = q + TURN * np.arange(-6, 7)
    inside = (shifts >= lower) & (shifts <= upper)
    near = (np.abs(shifts - lower) < 1e-6) | (np.abs(shifts - upper) < 1e-6)
    value = np.array([q])
    held = into_limits(value, np.array([lower]), np.array([upper]), np.array([False]))
    if not near.any():
        assert held == inside.any()
    if held:
        assert lower - 1e-8 <= value[0] <= upper + 1e-8
        assert abs(wrap_angle(value[0] - q)) < 1e-8


@given(q=st.floats(-100, 100))
def test_a_continuous_joint_is_shifted_into_one_turn(q: float) -> None:
    value, infinite = np.array([q]), np.array([np.inf])
    assert into_limits(value, -infinite, infinite, np.array([False]))
    assert abs(value[0]) <= np.pi + 1e-9
    assert abs(wrap_angle(value[0] - q)) < 1e-9


@given(q=st.floats(-TURN, TURN))
def test_a_joint_of_two_turns_uses_the_value_nearest_to_zero(q: float) -> None:
    value = np.array([q])
    assert into_limits(value, np.array([-TURN]), np.array([TURN]), np.array([False]))
    assert abs(value[0]) <= np.pi + 1e-9
