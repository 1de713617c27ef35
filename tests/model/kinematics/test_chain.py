"""Forward kinematics agrees with pinocchio, and with the motions of geared joints in turn."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose
from tests.model.collision.exact_hulls import random_states, rotations
from tests.model.kinematics import arms
from tests.real import BUILT_IN, furniture

from momapos.core.errors import RobotError, UnknownNameError
from momapos.core.geometry.transforms import invert
from momapos.model.kinematics.chain import build_chain
from momapos.model.robots.robot import Robot
from momapos.model.urdf.articulated import Articulated
from momapos.model.urdf.reader import read_urdf


class Twin:
    """A URDF in pinocchio."""

    def __init__(self, path: Path) -> None:
        # Pinocchio requires effort and velocity in every limit.
        text = re.sub(
            r"<limit (?![^>]*effort)", '<limit effort="1" velocity="1" ', path.read_text()
        )
        self.model = pin.buildModelFromXML(text)
        self.data = self.model.createData()

    def poses(self, values: dict[str, float]) -> dict[str, np.ndarray]:
        """Return link poses in the root's frame; other joints are at zero."""
        q = pin.neutral(self.model)
        for name, value in values.items():
            joint = self.model.joints[self.model.getJointId(name)]
            turn = [np.cos(value), np.sin(value)]
            q[joint.idx_q : joint.idx_q + joint.nq] = turn if joint.nq == 2 else value
        pin.framesForwardKinematics(self.model, self.data, q)
        return {
            frame.name: self.data.oMf[i].homogeneous
            for i, frame in enumerate(self.model.frames)
            if frame.type == pin.FrameType.BODY
        }


def random_values(model: Articulated, rng: np.random.Generator) -> dict[str, float]:
    lower = {n: max(j.lower, -np.pi) for n, j in model.joints.items()}
    upper = {n: min(j.upper, np.pi) for n, j in model.joints.items()}
    return {n: rng.uniform(lower[n], upper[n]) for n in model.joints}


def test_tool_poses_of_a_batch_agree_with_pinocchio(robot: Robot) -> None:
    q = random_states(robot.chain, 60, np.random.default_rng(0)).reshape(3, 20, -1)
    twin, expected = Twin(robot.model.urdf.path), np.empty((3, 20, 4, 4))
    for index in np.ndindex(3, 20):
        values = robot.model.rest | dict(zip(robot.arm_joints, q[index], strict=True))
        poses = twin.poses(values)
        expected[index] = invert(poses[robot.base_link]) @ poses[robot.tool_link]
    assert_allclose(robot.chain.tool_poses(q), expected, atol=1e-9)


def test_link_poses_of_a_robot_agree_with_pinocchio(robot: Robot) -> None:
    rng, twin = np.random.default_rng(1), Twin(robot.model.urdf.path)
    for _ in range(5):
        values = random_values(robot.model, rng)
        expected = twin.poses(values)
        for link, T in robot.model.link_poses(values).items():
            assert_allclose(T, expected[link], atol=1e-9)


@pytest.mark.parametrize("name", [*BUILT_IN, "OvenCounter/101773", "Microwave/7128"])
@pytest.mark.parametrize("scale", [1.0, 0.7])
def test_link_poses_of_furniture_scale_with_the_model(name: str, scale: float) -> None:
    path, rng = furniture(name), np.random.default_rng(2)
    model, twin = Articulated(read_urdf(path, scale=scale)), Twin(path)
    for _ in range(10):
        values = random_values(model, rng)
        plain = {
            n: v / scale if model.joints[n].kind == "prismatic" else v for n, v in values.items()
        }
        expected = twin.poses(plain)
        for link, T in model.link_poses(values).items():
            assert_allclose(T[:3, :3], expected[link][:3, :3], atol=1e-9)
            assert_allclose(T[:3, 3], scale * expected[link][:3, 3], atol=1e-9)


def test_links_are_rigidly_attached_to_their_segments(robot: Robot) -> None:
    """Each link keeps its pose relative to its segment."""
    rng, chain = np.random.default_rng(3), robot.chain
    q = random_states(chain, 1, rng)[0]
    still = robot.model.link_poses(robot.model.rest | dict.fromkeys(robot.arm_joints, 0.0))
    moved = robot.model.link_poses(robot.model.rest | dict(zip(robot.arm_joints, q, strict=True)))
    T_base_root = invert(moved[robot.base_link])
    for link, segment in robot.segments.of_link.items():
        T_base_link = T_base_root @ moved[link]
        T_segment_link = robot.segments.T_segment_link[link]
        assert_allclose(T_segment_link[:3, :3], (T_base_root @ still[link])[:3, :3], atol=1e-9)
        T_base_segment = T_base_link @ invert(T_segment_link)
        if segment == 0:
            assert_allclose(T_base_segment, np.eye(4), atol=1e-9)
        else:
            joint = robot.model.joints[robot.arm_joints[segment - 1]]
            origin = T_base_root @ moved[joint.child]
            assert_allclose(T_base_segment[:3, 3], origin[:3, 3], atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_joints_with_a_ratio_move_one_after_the_other(seed: int) -> None:
    rng = np.random.default_rng(seed)
    chain = replace(arms.geared(seed), tool_rotation=rotations(1, rng)[0])
    q = rng.uniform(-2.0, 2.0, (5, chain.size))
    for state, T in zip(q, chain.tool_poses(q), strict=True):
        R, p = arms.segments(chain, state)
        assert_allclose(T[:3, 3], p[-1] + R[-1] @ chain.tool_offset, atol=1e-12)
        assert_allclose(T[:3, :3], R[-1] @ chain.tool_rotation, atol=1e-12)


def test_joints_move_about_the_middle_of_their_range_by_half_their_travel() -> None:
    rng = np.random.default_rng(0)
    chain = replace(arms.geared(0), offset=rng.normal(size=7))
    lower, upper = rng.uniform(-3.0, 0.0, 4), rng.uniform(0.0, 1.0, 4)
    chain = replace(chain, lower=lower, upper=upper)
    ends = chain.joint_values(np.stack([lower, upper])) - chain.offset
    assert_allclose(chain.middle - chain.half_travel, ends.min(0))
    assert_allclose(chain.middle + chain.half_travel, ends.max(0))
    assert_allclose(replace(chain, lower=-np.inf * np.ones(4), upper=upper * np.inf).middle, 0.0)
    assert_allclose(chain.freedom_values(chain.joint_values(lower)) - chain.offset[:4], lower)
    assert chain.coupled
    assert not chain.ends_turning  # its last joint moves with the third one


def test_joints_that_form_no_chain_are_rejected(robot: Robot) -> None:
    model, joints = robot.model, list(robot.arm_joints)
    ends = robot.base_link, robot.tool_link
    for wrong, words in (
        ([], "empty"),
        (joints[::-1], "does not move with"),
        ([joints[1], joints[0], *joints[2:]], "does not move with"),
        ([*joints, joints[-1]], "twice"),
    ):
        with pytest.raises(RobotError, match=words):
            build_chain(model, *ends, wrong)
    with pytest.raises(RobotError, match="does not move with"):
        build_chain(model, robot.base_link, robot.base_link, joints)
    with pytest.raises(RobotError, match="base must come before"):
        build_chain(model, model.joints[joints[0]].child, robot.tool_link, joints)
    with pytest.raises(UnknownNameError, match="did you mean"):
        build_chain(model, robot.base_link, robot.tool_link + "x", joints)


@pytest.mark.parametrize("slides", [(), (0,)])
@pytest.mark.parametrize(
    ("axes", "upright"),
    [
        ((arms.UP, arms.UP, arms.LEFT), True),
        (((0.0, 0.0, -1.0), (0.0, 0.0, -1.0), arms.LEFT), True),
        ((arms.LEFT, arms.LEFT, arms.UP), False),
        (((0.0, 0.1, 1.0), arms.LEFT, arms.UP), False),
    ],
)
def test_an_arm_whose_first_axes_are_vertical_is_upright_whichever_way_they_point(
    axes: tuple[tuple[float, ...], ...], upright: bool, slides: tuple[int, ...]
) -> None:
    assert arms.arm(axes, 3 * [(0.0, 0.1, 0.1)], (0.1, 0.0, 0.0), slides=slides).upright == upright
