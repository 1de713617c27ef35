"""Laws of arms on a base that slides, and of the closed form for three slides and a wrist."""

from __future__ import annotations

import numpy as np
import pytest

from momapos.core.geometry.transforms import pose_planar
from momapos.model.kinematics.chain import Chain, with_base_slides
from momapos.model.kinematics.closed_forms import NUMERIC, SLIDES
from momapos.model.kinematics.ik import bounded, build_ik, find_slides_and_wrist, solve_ik
from momapos.model.robots.robot import load_robot


def on_slides(name: str, count: int) -> Chain:
    return with_base_slides(load_robot(name).chain, np.eye(3)[:count], 0.8)


def random_states(chain: Chain, count: int) -> np.ndarray:
    lower, upper = bounded(chain)
    return np.random.default_rng(0).uniform(lower, upper, (count, chain.size))


def test_a_slide_of_the_base_moves_the_tool_as_a_base_at_another_position_does() -> None:
    arm, chain = load_robot("stretch").chain, on_slides("stretch", 2)
    q = random_states(chain, 50)
    bases = np.column_stack([q[:, :2], np.zeros(len(q))])
    np.testing.assert_allclose(
        chain.tool_poses(q), pose_planar(bases) @ arm.tool_poses(q[:, 2:]), atol=1e-12
    )
    assert chain.names[2:] == arm.names


@pytest.mark.parametrize(("name", "count", "least"), [("stretch", 1, 1.0), ("hsr", 2, 0.99)])
def test_slides_and_a_wrist_have_a_closed_form(name: str, count: int, least: float) -> None:
    """The telescope of Stretch has four joints; HSR has a revolute joint more, which is locked."""
    chain = on_slides(name, count)
    ik = build_ik(chain)
    assert ik.kind == SLIDES
    T = chain.tool_poses(random_states(chain, 300))
    q, found = solve_ik(chain, ik, T)
    assert (found > 0).mean() >= least
    for states, n, pose in zip(q, found, T, strict=True):
        np.testing.assert_allclose(
            chain.tool_poses(states[:n]), np.broadcast_to(pose, (n, 4, 4)), atol=1e-6
        )


def test_an_arm_with_two_slides_has_no_closed_form() -> None:
    chain = load_robot("stretch").chain
    assert find_slides_and_wrist(chain) is None
    assert build_ik(chain).kind == NUMERIC


def test_slides_that_do_not_span_space_are_no_closed_form() -> None:
    """Both slides of this base and the telescope are horizontal, so nothing lifts the hand."""
    chain = on_slides("stretch", 1)
    flat = with_base_slides(chain, np.eye(3)[:1], 0.8)
    kept = find_slides_and_wrist(flat)
    assert kept is not None
    assert len({0, 1} & set(kept)) == 1  # the other one is locked
