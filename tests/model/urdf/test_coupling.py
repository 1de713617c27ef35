"""Mimic joints of URDFs, and joints coupled by a robot file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from momapos.core.errors import MomaposError, RobotError, UrdfError
from momapos.model.kinematics.chain import build_chain
from momapos.model.kinematics.ik import build_ik, solve_ik
from momapos.model.robots.amended_urdf import Amendments
from momapos.model.urdf.articulated import Articulated
from momapos.model.urdf.reader import Mimic, read_urdf

HEAD = '<robot name="r"><link name="base"/>'


def joint(
    name: str, kind: str, parent: str, child: str, axis: str, more: str = "", limits: str = ""
) -> str:
    limits = limits or 'lower="-2.6" upper="2.6" velocity="1"'
    return (
        f'<link name="{child}"/><joint name="{name}" type="{kind}"><parent link="{parent}"/>'
        f'<child link="{child}"/><origin xyz="0.05 0.02 0.1" rpy="0.1 0.2 0.3"/>'
        f'<axis xyz="{axis}"/><limit {limits}/>{more}</joint>'
    )


def telescope(mimics: bool) -> str:
    """Return a revolute base, a telescope of a leader and two mimic joints, and a wrist."""
    slide = 'lower="0" upper="0.13" velocity="0.2"'
    follows = '<mimic joint="s0"/>' if mimics else ""
    half = '<mimic joint="s0" multiplier="0.5" offset="0.01"/>' if mimics else ""
    parts = [
        joint("turn", "revolute", "base", "l0", "0 0 1"),
        joint("lift", "prismatic", "l0", "l1", "0 0 1", limits='lower="0" upper="1"'),
        joint("s0", "prismatic", "l1", "l2", "1 0 0", limits=slide),
        joint("s1", "prismatic", "l2", "l3", "1 0 0", follows, slide),
        joint("s2", "prismatic", "l3", "l4", "1 0 0", half, 'lower="0" upper="0.05"'),
        joint("yaw", "revolute", "l4", "l5", "0 0 1"),
        joint("pitch", "revolute", "l5", "l6", "0 1 0"),
        joint("elbow", "revolute", "l6", "l7", "0 1 1", '<mimic joint="pitch" multiplier="-1"/>'),
        joint("roll", "revolute", "l7", "tool", "1 0 0"),
    ]
    return HEAD + "".join(parts) + "</robot>"


LEADERS = ["turn", "lift", "s0", "yaw", "pitch", "roll"]


def model_of(text: str, folder: Path) -> Articulated:
    path = folder / "r.urdf"
    path.write_text(text)
    return Articulated(read_urdf(path))


@pytest.fixture
def model(tmp_path: Path) -> Articulated:
    return model_of(telescope(mimics=True), tmp_path)


def test_a_chain_with_mimic_joints_has_the_poses_of_the_tree(model: Articulated) -> None:
    chain, segments = build_chain(model, "base", "tool", LEADERS)
    assert (chain.size, chain.last, chain.coupled) == (6, 9, True)
    rng = np.random.default_rng(0)
    q = rng.uniform(chain.lower, chain.upper, (20, 6))
    every = chain.joint_values(q)
    assert_allclose(chain.freedom_values(every), q)
    for state, values, T in zip(q, every, chain.tool_poses(q), strict=True):
        by_leader = model.link_poses(dict(zip(LEADERS, state, strict=True)))
        assert_allclose(T, by_leader["tool"], atol=1e-12)
        loose = Articulated(coupled_off(model).urdf)
        by_joint = loose.link_poses(dict(zip(chain.joints, values, strict=True)))
        assert_allclose(by_joint["tool"], T, atol=1e-12)
    assert segments.of_link["l4"] == 5


def coupled_off(model: Articulated) -> Articulated:
    """Return the same model without mimic relations."""
    from dataclasses import replace

    joints = tuple(replace(joint, mimic=None) for joint in model.urdf.joints)
    return Articulated(replace(model.urdf, joints=joints))


def test_a_leader_keeps_the_limits_of_its_mimic_joints(model: Articulated) -> None:
    chain, _ = build_chain(model, "base", "tool", LEADERS)
    # s2 = 0.5 s0 + 0.01 <= 0.05 leaves s0 at most 0.08, and its speed that of s1.
    assert chain.upper[2] == pytest.approx(0.08)
    ends = chain.joint_values(np.stack([chain.lower, chain.upper]))
    for name, values in zip(chain.joints, ends.T, strict=True):
        record = model.joint(name)
        assert record.lower - 1e-12 <= values.min() <= values.max() <= record.upper + 1e-12


def test_inverse_kinematics_of_a_chain_with_mimic_joints_finds_its_poses(
    model: Articulated,
) -> None:
    chain, _ = build_chain(model, "base", "tool", LEADERS)
    rng = np.random.default_rng(1)
    Ts = chain.tool_poses(rng.uniform(chain.lower, chain.upper, (200, 6)))
    q, counts = solve_ik(chain, build_ik(chain), Ts)
    assert (counts > 0).mean() >= 0.99
    for pose, states, count in zip(Ts, q, counts, strict=True):
        assert_allclose(chain.tool_poses(states[:count]), np.tile(pose, (count, 1, 1)), atol=1e-6)
        assert (states[:count] >= chain.lower - 1e-8).all()
        assert (states[:count] <= chain.upper + 1e-8).all()


FOLLOWS = {"s1": Mimic("s0"), "s2": Mimic("s1", 0.5, 0.01)}


def tied_model(text: str, folder: Path, follows: dict[str, Mimic]) -> Articulated:
    path = folder / "r.urdf"
    path.write_text(text)
    return Articulated(Amendments(coupled=follows).read(path)[0])


def test_a_robot_file_can_couple_independent_joints(tmp_path: Path) -> None:
    tied = tied_model(telescope(mimics=False), tmp_path, FOLLOWS)
    assert tied.joint("s2").mimic == Mimic("s0", 0.5, 0.01)
    assert tied.rest["s2"] == 0.01
    assert "l4" in tied.moved_by("s0")
    assert tied.followers("s0") == (tied.joint("s1"), tied.joint("s2"))


def test_coupling_a_joint_to_a_new_leader_restores_the_limits_of_the_old_one(
    tmp_path: Path,
) -> None:
    """In the URDF, s2 <= 0.05 follows s0 at half its travel, which limits s0 to 0.08 of 0.13."""
    tied = tied_model(telescope(mimics=True), tmp_path, {"s2": Mimic("lift", 0.1)})
    assert tied.joint("s2").mimic == Mimic("lift", 0.1)
    assert tied.joint("s0").upper == pytest.approx(0.13)
    assert tied.joint("lift").upper == pytest.approx(0.5)


def test_an_amended_urdf_contains_the_couplings(tmp_path: Path) -> None:
    path = tmp_path / "r.urdf"
    path.write_text(telescope(mimics=False))
    text = Amendments(coupled=FOLLOWS).text(path)
    path.write_text(text)
    again = read_urdf(path)
    tied = tied_model(telescope(mimics=False), tmp_path, FOLLOWS)
    for joint in again.joints:
        other = tied.joint(joint.name)
        assert (joint.mimic, joint.lower, joint.upper) == (other.mimic, other.lower, other.upper)
    assert sum(joint.mimic is not None for joint in again.joints) == 3


def test_an_impossible_coupling_is_rejected_in_one_line(tmp_path: Path, model: Articulated) -> None:
    wrong = {
        "follows itself": {"s1": Mimic("s2"), "s2": Mimic("s1")},
        "no movable joint 's9'": {"s1": Mimic("s9")},
        "nonzero ratio": {"s1": Mimic("s0", 0.0)},
        "no range": {"s1": Mimic("s0", -1.0)},
    }
    for words, follows in wrong.items():
        with pytest.raises(MomaposError, match=words) as caught:
            tied_model(telescope(mimics=False), tmp_path, follows)
        assert "\n" not in str(caught.value)
    with pytest.raises(RobotError, match="'s1' follows 's0'"):
        build_chain(model, "base", "tool", ["turn", "s1", "yaw"])
    chain, segments = build_chain(model, "base", "l3", ["turn", "lift", "s0"])
    assert (chain.joints, segments.side_followers) == (("turn", "lift", "s0", "s1"), ("s2",))
    for mimic, words in (
        ('<mimic joint="none"/>', "'none', which does not exist"),
        ('<mimic joint="s0" multiplier="much"/>', "finite numbers"),
        ('<mimic joint="s1"/>', "follows itself"),
    ):
        text = telescope(mimics=True).replace('<mimic joint="s0"/>', mimic)
        with pytest.raises(UrdfError, match=words):
            model_of(text, tmp_path)


def test_mimic_relations_scale_with_the_model(tmp_path: Path) -> None:
    path = tmp_path / "r.urdf"
    path.write_text(telescope(mimics=True))
    assert Articulated(read_urdf(path, scale=2.0)).joint("s2").mimic == Mimic("s0", 0.5, 0.02)


@pytest.mark.parametrize("kind", ["planar", "floating"])
def test_a_planar_or_floating_joint_at_the_root_is_fixed(tmp_path: Path, kind: str) -> None:
    drive = joint("drive", kind, "world", "base", "0 0 1")
    text = telescope(mimics=True).replace(HEAD, '<robot name="r"><link name="world"/>')
    model = model_of(text.replace("</robot>", drive + "</robot>"), tmp_path)
    assert model.urdf.rigid == ("drive",)
    assert "drive" not in model.joints
    loose = joint("loose", kind, "l4", "l9", "0 0 1")
    with pytest.raises(UrdfError, match=f"'loose' is '{kind}'"):
        model_of(text.replace("</robot>", drive + loose + "</robot>"), tmp_path)
