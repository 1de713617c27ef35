"""The parts that a reachability map is built from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from momapos.model.kinematics.chain import Chain
from momapos.model.kinematics.ik import build_ik
from momapos.model.robots.robot import Robot, load_robot
from momapos.planning.reachability.arm_axes import arm_frame
from momapos.planning.reachability.construct import HALVINGS, _Evaluator, locked_samples
from momapos.planning.reachability.map_kernels import standing_table
from momapos.planning.reachability.reach_map import ReachConfig
from momapos.planning.reachability.signed_distance import nearby


def _freed(robot: Robot, first: int) -> Chain:
    freed = np.arange(robot.chain.size) == first
    lower, upper = robot.chain.lower, robot.chain.upper
    return replace(
        robot.chain, lower=np.where(freed, -np.inf, lower), upper=np.where(freed, np.inf, upper)
    )


@pytest.mark.parametrize("name", ["fetch", "ranger_rm63"])
def test_turned_samples_equal_those_of_ik_built_at_every_value(name: str) -> None:
    robot = load_robot(name)
    frame = arm_frame(robot.chain, robot.approach_axis)
    chain = _freed(robot, frame.first)
    count, heights = 4, 3
    turned, (arcs, value, step) = locked_samples(chain, frame, count, heights)
    samples = turned.samples
    found = (turned.h, turned.o, turned.wrist, turned.R_tool, turned.p_tool)
    values = count << HALVINGS
    assert len(samples) == len(arcs) == len(value) == len(step)
    assert set(value.tolist()) == set(range(values))
    # Straight ahead comes first, and every value comes after the two that it is between.
    assert samples[0, frame.first] == 0.0
    when = np.full(values, len(value))
    np.minimum.at(when, value, np.arange(len(value)))
    for v, s in zip(value, step, strict=True):
        assert s == 0 or max(when[(v - s) % values], when[(v + s) % values]) < when[v]
    ik = build_ik(chain, samples_per_joint=values)
    own = (ik.h, ik.o, ik.wrist, ik.R_tool, ik.p_tool)
    matched = 0
    for i in range(len(samples)):
        same = np.flatnonzero(np.abs(ik.samples - samples[i]).max(1) < 1e-9)
        matched += len(same)
        for theirs, ours in zip(own, found, strict=True):
            # The axes of the robot files are rounded.
            np.testing.assert_allclose(ours[[i] * len(same)], theirs[same], atol=1e-4)
    assert matched >= values


@pytest.mark.parametrize("heights", [3, 9, 17])
def test_each_value_of_the_first_joint_is_tried_at_every_height_of_the_torso(
    heights: int, fetch: Robot
) -> None:
    """Also with more than 128 samples, which IK for planning would spread."""
    frame = arm_frame(fetch.chain, fetch.approach_axis)
    turned, (_, value, _) = locked_samples(_freed(fetch, frame.first), frame, 4, heights)
    for v in np.unique(value):
        assert len(np.unique(turned.samples[value == v, 0])) == heights


def test_evaluating_some_azimuths_gives_those_bits_of_the_full_mask(husky: Robot) -> None:
    rng = np.random.default_rng(0)
    frame = arm_frame(husky.chain, husky.approach_axis)
    evaluate = _Evaluator(husky, frame, ReachConfig(spins=2), lambda _share: None)
    lines = rng.uniform((0.2, 0.1, -1, -1), (1.0, 0.9, 1, 1), (300, 4))
    full = evaluate(lines, np.full(300, ~np.uint64(0)), 0.0, 1.0)
    wanted = rng.integers(0, 1 << 63, 300, np.uint64)
    assert ((full != 0) & (full != ~np.uint64(0))).any()
    np.testing.assert_array_equal(evaluate(lines, wanted, 0.0, 1.0), full & wanted)


def test_nearby_azimuths_are_those_of_neighbors_widened_to_both_sides() -> None:
    masks = np.zeros((3, 4, 5, 5), np.uint64)
    masks[1, 2, 3, 3] = 1
    found = nearby(masks, 2)
    bits = np.uint64(0b111 | 1 << 63 | 1 << 62)
    for at in [(1, 2, 3, 3), (0, 2, 3, 3), (2, 2, 3, 3), (1, 3, 3, 3), (1, 2, 4, 3), (1, 2, 3, 2)]:
        assert found[at] == bits
    assert np.count_nonzero(found) == 9


def test_protruding_spheres_touch_no_more_of_the_base_where_hulls_are_checked(husky: Robot) -> None:
    """As near a shoulder, where links pass so close to the base that spheres always touch."""
    fine = replace(husky.spheres, base_exact=np.zeros_like(husky.spheres.base_exact))
    coarse = replace(fine, radius=fine.radius + 0.014, base_exact=fine.base_pairs)
    first = arm_frame(husky.chain, husky.approach_axis).first
    touched = [
        np.bitwise_count(standing_table(spheres, husky.chain.d, first).words).sum()
        for spheres in (fine, coarse)
    ]
    assert 0 < touched[1] < touched[0]
