"""Links outside the arm's chain that follow its joints, such as a head that follows the torso."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.urdf_parts import box, joint, link, mobile_manipulator

from momapos.core.errors import RobotError
from momapos.core.geometry.transforms import apply, invert
from momapos.model.collision.self_collision import contacts
from momapos.model.collision.spheres import never_touching, with_swept_followers
from momapos.model.robots.derive import write_robot
from momapos.model.robots.robot import Robot, load_robot
from momapos.verification.plan_check import UrdfArm

WIDE = '<limit lower="-9" upper="9" effort="1" velocity="1"/>'


def with_mast(kind: str, parent: str, leader: str, ratio: float) -> str:
    """Return the mobile manipulator with a mast and a camera on it that follow an arm joint."""
    follow = f'<mimic joint="{leader}" multiplier="{ratio}"/>'
    parts = [
        link("mast", box(0.05, 0.05, 0.3), "0 0 0.15"),
        joint("mast_joint", kind, parent, "mast", "-0.3 0 0.4", "0 0 1", WIDE + follow),
        link("camera", box(0.1, 0.05, 0.05), "0.1 0 0"),
        joint("camera_mount", "fixed", "mast", "camera", "0 0 0.3"),
    ]
    return mobile_manipulator().replace("</robot>", "".join(parts) + "</robot>")


def robot_of(folder: Path, text: str) -> Robot:
    path = folder / "robot.urdf"
    path.write_text(text)
    return load_robot(write_robot(path)[0])


KINDS = [
    ("prismatic", "base_link", "j1", 0.1), ("revolute", "base_link", "j0", -0.4),
    ("prismatic", "torso", "lift", 0.5), ("revolute", "arm_0", "j2", 0.3),
]  # fmt: skip


@pytest.mark.parametrize(("kind", "parent", "leader", "ratio"), KINDS)
def test_a_swept_follower_contains_it_in_every_state(
    tmp_path: Path, kind: str, parent: str, leader: str, ratio: float
) -> None:
    robot = robot_of(tmp_path, with_mast(kind, parent, leader, ratio))
    assert robot.segments.side_followers == ("mast_joint",)
    assert "mast_joint" not in robot.moved_joints
    model = with_swept_followers(robot.model, robot.segments.side_followers)
    rng = np.random.default_rng(0)
    rest = robot.model.rest_poses
    for q in rng.uniform(robot.chain.lower, robot.chain.upper, (20, robot.chain.size)):
        poses = robot.model.link_poses(dict(zip(robot.arm_joints, q.tolist(), strict=True)))
        for name in ("mast", "camera"):
            # The link moves with its parent's segment, in which it is swept.
            T = invert(rest[name]) @ rest[parent] @ invert(poses[parent]) @ poses[name]
            for hull in robot.model.hulls[name]:
                points = apply(T, hull.vertices)
                inside = np.zeros(len(points), bool)
                for swept in model.hulls[name]:
                    a, b, c = swept.vertices[swept.faces].transpose(1, 0, 2)
                    normal = np.cross(b - a, c - a)
                    normal /= np.linalg.norm(normal, axis=1)[:, None]
                    out = points @ normal.T - (a * normal).sum(1)
                    inside |= out.max(1) < 1e-3
                assert inside.all()


def with_hood(ratio: float) -> str:
    """Return the mobile manipulator with a hood above its head, which follows the lift."""
    follow = f'<mimic joint="lift" multiplier="{ratio}"/>'
    parts = [
        link("hood", box(0.3, 0.3, 0.05), "-0.15 0 1.275"),
        joint("hood_joint", "prismatic", "base_link", "hood", "0 0 0", "0 0 1", WIDE + follow),
    ]
    return mobile_manipulator().replace("</robot>", "".join(parts) + "</robot>")


@pytest.mark.parametrize(("ratio", "apart"), [(0.9, True), (1.2, True), (0.5, False)])
def test_a_follower_is_not_in_the_way_of_what_its_leader_moves_below_it(
    tmp_path: Path, ratio: float, apart: bool
) -> None:
    """The head rises by 30 cm and begins 7 cm below the hood."""
    robot = robot_of(tmp_path, with_hood(ratio))
    pairs = never_touching(robot.model, robot.segments)
    assert (frozenset(("hood", "head_pan")) in pairs) is apart
    assert frozenset(("hood", "torso")) in pairs, "the torso stays below in any case"
    q = np.repeat(robot.home[None], 20, axis=0)
    q[:, 0] = np.linspace(robot.chain.lower[0], robot.chain.upper[0], 20)
    hits = contacts(robot.chain, robot.spheres, q)
    touching = {frozenset(p) for p, h in zip(hits.pairs, hits.by_hulls.T, strict=True) if h.any()}
    assert (frozenset(("hood", "head_pan")) in touching) is not apart


@pytest.mark.parametrize(("kind", "parent", "leader", "ratio"), KINDS[:2])
def test_a_follower_outside_the_arm_changes_nothing_of_the_arm(
    tmp_path: Path, kind: str, parent: str, leader: str, ratio: float
) -> None:
    plain, more = tmp_path / "plain", tmp_path / "more"
    plain.mkdir()
    more.mkdir()
    one = robot_of(plain, mobile_manipulator())
    other = robot_of(more, with_mast(kind, parent, leader, ratio))
    assert one.moved_joints == other.moved_joints
    assert one.tool_link == other.tool_link
    q = np.random.default_rng(1).uniform(one.chain.lower, one.chain.upper, (9, one.chain.size))
    assert_allclose(one.chain.tool_poses(q), other.chain.tool_poses(q), atol=1e-12)


def test_the_exact_check_moves_the_follower(tmp_path: Path) -> None:
    robot = robot_of(tmp_path, with_mast("prismatic", "base_link", "j1", 0.1))
    arm = UrdfArm(robot.model, robot.base_link, robot.tool_link, robot.moved_joints, robot.disabled)
    assert "mast" in arm.model.moved_by("j1")
    low, high = (robot.model.link_poses({"j1": v})["mast"][2, 3] for v in (-1.0, 1.0))
    assert high - low == pytest.approx(0.2)


def test_a_follower_of_an_endless_joint_is_refused_in_one_line(tmp_path: Path) -> None:
    text = with_mast("revolute", "base_link", "j0", 1.0)
    endless = 'name="j0" type="continuous"'
    with pytest.raises(RobotError, match=r"'mast_joint' follows 'j0', which has no limits"):
        robot_of(tmp_path, text.replace('name="j0" type="revolute"', endless).replace(WIDE, ""))
