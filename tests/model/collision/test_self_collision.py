"""Self-collision by spheres agrees with that by hulls."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from jaxtyping import Float
from tests.model.collision.exact_hulls import HullPairs, random_states

from momapos.model.collision.arm_collision import place_segments
from momapos.model.collision.self_collision import arm_spheres, contacts, decided_by_hulls
from momapos.model.collision.spheres import Spheres
from momapos.model.kinematics.chain import Chain, build_chain, chain_arrays
from momapos.model.robots.load_limits import (
    inevitable_pairs,
    sample_states,
    self_collision_shares,
    touches,
)
from momapos.model.robots.robot import Robot
from momapos.model.urdf.articulated import Articulated
from momapos.model.urdf.reader import read_urdf

MAX_FALSE_SHARE = 0.03
"""Largest share of states that the planner may block although hulls are disjoint [-]."""


def segment_poses(chain: Chain, q: Float[np.ndarray, " n"]) -> Float[np.ndarray, "segments 4 4"]:
    Ts = np.tile(np.eye(4), (chain.last + 1, 1, 1))
    R, p = np.empty((chain.last + 1, 3, 3)), np.empty((chain.last + 1, 3))
    place_segments(q, np.zeros(3), chain_arrays(chain), R, p)
    Ts[:, :3, :3], Ts[:, :3, 3] = R, p
    return Ts


def close_robot(
    folder: Path, gap: float, limits: tuple[float, float] = (-3.0, 3.0)
) -> tuple[Articulated, tuple[str, ...]]:
    """Build an arm whose third link turns next to the first, a few millimeters from it.

    The second link holds the third at the side of the first; both turn about one axis. The limits
    are those of the third joint.
    """

    def link(name: str, size: str, xyz: str) -> str:
        return (
            f'<link name="{name}"><collision><origin xyz="{xyz}"/>'
            f'<geometry><box size="{size}"/></geometry></collision></link>'
        )

    def joint(
        name: str, parent: str, child: str, xyz: str, axis: str, ends: tuple[float, float] = (-3, 3)
    ) -> str:
        return (
            f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{xyz}"/><axis xyz="{axis}"/>'
            f'<limit lower="{ends[0]}" upper="{ends[1]}" effort="1" velocity="1"/></joint>'
        )

    beside = 0.1 + gap
    parts = [
        link("base_link", "0.4 0.4 0.3", "0 0 0.15"),
        joint("pan", "base_link", "first", "0 0 0.5", "0 0 1"),
        link("first", "0.1 0.1 0.3", "0 0 0"),
        joint("second_joint", "first", "second", "0 0 0.2", "0 1 0"),
        link("second", "0.02 0.02 0.02", "0 0 0.3"),
        joint("third_joint", "second", "third", f"0 {beside} 0", "0 1 0", limits),
        link("third", "0.2 0.1 0.3", "0 0 0"),
    ]
    file = folder / "close.urdf"
    file.write_text(f'<robot name="close">{"".join(parts)}</robot>')
    return Articulated(read_urdf(file)), ("pan", "second_joint", "third_joint")


def arm_of(model: Articulated, joints: tuple[str, ...]) -> tuple[Chain, Spheres]:
    chain, segments = build_chain(model, "base_link", "third", joints)
    return chain, arm_spheres(model, chain, segments, frozenset(), ["third"])


def test_overlap_of_links_agrees_with_the_exact_check(robot: Robot) -> None:
    q = random_states(robot.chain, 60, np.random.default_rng(0))
    found = contacts(robot.chain, robot.spheres, q).by_hulls.any(1)
    pairs = HullPairs(robot.spheres)
    expected = [pairs.meet(segment_poses(robot.chain, state)) for state in q]
    np.testing.assert_array_equal(found, expected)
    assert 0.05 < found.mean() < 0.8


def test_all_contacts_of_hulls_are_found_and_few_other_states_are_blocked(robot: Robot) -> None:
    q = sample_states(robot.chain, np.random.default_rng(1))
    blocked = touches(robot.chain, robot.spheres, q)
    true = contacts(robot.chain, robot.spheres, q).by_hulls.any(1)
    assert not (true & ~blocked).any()
    assert (blocked & ~true).mean() <= MAX_FALSE_SHARE


@pytest.mark.parametrize("margin", [0.001, 0.003, 0.009, 0.011])
def test_links_within_the_margin_touch(tmp_path: Path, margin: float) -> None:
    gap = 0.01
    chain, spheres = arm_of(*close_robot(tmp_path, gap))
    found = contacts(chain, spheres.grown(margin), np.zeros((1, chain.size)))
    touch = found.by_hulls[0, found.pairs.index(("first", "third"))]
    assert touch == (margin > gap)


@pytest.mark.parametrize("gap", [0.002, 0.005, 0.02])
def test_hulls_decide_for_links_that_pass_closely(tmp_path: Path, gap: float) -> None:
    chain, spheres = arm_of(*close_robot(tmp_path, gap))
    q = sample_states(chain, np.random.default_rng(2))
    found = contacts(chain, spheres, q)
    column = found.pairs.index(("first", "third"))
    assert found.by_spheres[:, column].mean() > found.by_hulls[:, column].mean() + MAX_FALSE_SHARE
    assert ("first", "third") in decided_by_hulls(spheres)
    blocked, true = touches(chain, spheres, q), found.by_hulls.any(1)
    assert not (true & ~blocked).any()
    assert (blocked & ~true).mean() <= MAX_FALSE_SHARE
    assert not true.all()


def test_links_that_pass_closely_are_not_disabled(tmp_path: Path) -> None:
    """Spheres touch in nearly all states, but hulls only in few."""
    chain, spheres = arm_of(*close_robot(tmp_path, 0.002))
    q = sample_states(chain, np.random.default_rng(3))
    assert ("first", "third") not in inevitable_pairs(chain, spheres, q)


def test_links_whose_hulls_always_overlap_are_disabled(tmp_path: Path) -> None:
    chain, spheres = arm_of(*close_robot(tmp_path, -0.03))
    q = sample_states(chain, np.random.default_rng(3))
    assert inevitable_pairs(chain, spheres, q)["first", "third"] == "Always"


def test_shares_report_the_states_that_a_pair_blocks_by_spheres_and_by_hulls(
    tmp_path: Path,
) -> None:
    chain, spheres = arm_of(*close_robot(tmp_path, 0.005))
    q = sample_states(chain, np.random.default_rng(4))
    shares = {share.links: share for share in self_collision_shares(chain, spheres, q)}
    close = shares["first", "third"]
    assert close.decided_by_hulls
    assert close.by_hulls < close.by_spheres <= 1.0
    assert all(share.by_hulls <= share.by_spheres for share in shares.values())
    found = contacts(chain, spheres, q)
    assert close.by_hulls == found.by_hulls[:, found.pairs.index(("first", "third"))].mean()
    order = [share.by_spheres for share in self_collision_shares(chain, spheres, q)]
    assert order == sorted(order, reverse=True)


@pytest.mark.parametrize("limits", [(-1.0, 4.5), (3.5, 5.0), (1.0, 9.0), (-9.0, 9.0)])
def test_states_are_sampled_from_the_whole_range_of_a_joint_or_one_turn(
    tmp_path: Path, limits: tuple[float, float]
) -> None:
    chain, _ = arm_of(*close_robot(tmp_path, 0.02, limits))
    drawn = sample_states(chain, np.random.default_rng(5))[:, 2]
    assert limits[0] <= drawn.min() <= drawn.max() <= limits[1]
    assert np.ptp(drawn) == pytest.approx(min(limits[1] - limits[0], 2 * np.pi), abs=0.05)
    assert abs(drawn).max() <= max(abs(limits[0]), 2 * np.pi + limits[0], np.pi)


def test_an_arm_without_pairs_to_check_has_no_pairs_for_hulls(tmp_path: Path) -> None:
    model, joints = close_robot(tmp_path, 0.02)
    chain, segments = build_chain(model, "base_link", "third", joints)
    links = [*model.links]
    pairs = {frozenset((a, b)) for a in links for b in links if a != b}
    spheres = arm_spheres(model, chain, segments, pairs, ["third"])
    assert decided_by_hulls(spheres) == frozenset()
    assert not touches(chain, spheres, np.zeros((1, 3))).any()
