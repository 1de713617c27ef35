"""SRDFs are found in the usual folders and read."""

from __future__ import annotations

import itertools
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.commands import error_of
from tests.meshes import Box, triangles_of, write_obj
from tests.urdf_parts import box, joint, link, mobile_manipulator

from momapos.core.errors import RobotError
from momapos.model.collision.self_collision import contacts, surfaces_cross
from momapos.model.collision.spheres import build_spheres
from momapos.model.kinematics.chain import build_chain
from momapos.model.robots.derive import derive_robot, write_robot
from momapos.model.robots.robot import load_arms, load_robot
from momapos.model.robots.robot_tests import examine_at_rest
from momapos.model.robots.srdf import find_srdf, read_srdf, srdf_text
from momapos.model.urdf.articulated import Articulated
from momapos.model.urdf.reader import read_urdf
from momapos.verification.plan_check import UrdfArm
from momapos.verification.robot_collision_model import self_contacts
from momapos.workflows.robot_self_test import self_test

TEXT = (
    '<robot name="test robot"><disable_collisions link1="torso" link2="arm_1" reason="User"/>'
    '<group_state name="home" group="arm"><joint name="j0" value="0.5"/></group_state>'
    '<group name="hand"><link name="palm"/><link name="left_finger"/></group>'
    '<end_effector name="hand" parent_link="arm_5" group="hand"/>'
    '<group name="arm"><chain base_link="torso" tip_link="arm_5"/></group>'
    '<group name="wrist"><joint name="j4"/><joint name="no such joint"/></group></robot>'
)
PAIR = frozenset(("torso", "arm_1"))
ADJACENT = '<disable_collisions link1="torso" link2="arm_1" reason="Adjacent"/>'


@pytest.mark.parametrize(
    "place",
    [
        "urdf/robot.srdf", "srdf/robot.srdf", "srdf/other.srdf", "config/other.srdf",
        "my_moveit_config/config/other.srdf", "../my_moveit_config/config/other.srdf",
    ],
)  # fmt: skip
def test_an_srdf_is_found_in_the_usual_folders(tmp_path: Path, place: str) -> None:
    package = tmp_path / "package"
    urdf = package / "urdf" / "robot.urdf"
    srdf = (package / place).resolve()
    for path in (urdf, srdf):
        path.parent.mkdir(parents=True, exist_ok=True)
    urdf.write_text(mobile_manipulator())
    srdf.write_text(TEXT)
    assert find_srdf(urdf, "test robot").path == srdf
    robot = load_robot(write_robot(urdf, tmp_path / "mine.toml")[0])
    assert robot.srdf == srdf
    assert robot.disabled == {PAIR}


def test_an_srdf_of_another_robot_is_ignored(tmp_path: Path) -> None:
    urdf = tmp_path / "robot.urdf"
    urdf.write_text(mobile_manipulator())
    (tmp_path / "other.srdf").write_text(TEXT.replace("test robot", "other"))
    (tmp_path / "damaged.srdf").write_text("<robot")
    assert find_srdf(urdf, "test robot").path is None
    (tmp_path / "robot.srdf").write_text("<robot")
    with pytest.raises(RobotError, match="not well-formed"):
        find_srdf(urdf, "test robot")


def test_pairs_hands_states_and_groups_are_read(tmp_path: Path) -> None:
    urdf = tmp_path / "robot.urdf"
    (tmp_path / "robot.srdf").write_text(TEXT)
    found = find_srdf(urdf, "test robot")
    assert found.disabled == {PAIR}
    assert found.reasons == {("torso", "arm_1"): "User"}
    assert found.hands == {"arm_5": ("palm", "left_finger")}
    assert found.states == ({"j0": 0.5},)
    assert found.groups["arm"].chains == (("torso", "arm_5"),)
    assert found.groups["wrist"].joints == ("j4", "no such joint")


@pytest.mark.parametrize(
    ("inner", "words"),
    [
        ('<chain base_link="torso" tip_link="palm"/>', "no lift"),
        ('<joint name="lift"/><chain base_link="torso" tip_link="palm"/>', "the same joints"),
        (
            '<joint name="head_joint"/><chain base_link="base_link" tip_link="palm"/>',
            "head_joint too",
        ),
        ('<chain base_link="arm_5" tip_link="palm"/><joint name="j5"/>', None),
    ],
)
def test_arms_are_compared_with_the_groups_of_an_srdf(
    tmp_path: Path, inner: str, words: str | None
) -> None:
    urdf = tmp_path / "robot.urdf"
    urdf.write_text(mobile_manipulator())
    urdf.with_suffix(".srdf").write_text(f'<robot name="r"><group name="g">{inner}</group></robot>')
    found = [note for note in derive_robot(urdf).assumptions if "SRDF's group" in note]
    assert found == ([] if words is None else [f"arm_joints: the SRDF's group 'g' has {words}"])


def test_a_written_srdf_round_trips(tmp_path: Path) -> None:
    path = tmp_path / "robot.srdf"
    path.write_text(srdf_text('a "b" & c', {("x<y", "z"): "Always"}))
    assert read_srdf(path) == {frozenset(("x<y", "z"))}
    assert read_srdf(tmp_path / "none.srdf") == frozenset()


ALL = "".join(
    f'<disable_collisions link1="{a}" link2="{b}" reason="{{why}}"/>'
    for a, b in itertools.combinations(
        ["base_link", "torso", "head_pan", *(f"arm_{k}" for k in range(6)), "palm",
         "left_finger", "right_finger", "wheel_left"], 2,
    )
)  # fmt: skip


@pytest.mark.parametrize("why", ["Never", "User", "Adjacent"])
def test_an_srdf_that_disables_all_pairs_is_refused_by_a_pair_that_touches(
    tmp_path: Path, why: str
) -> None:
    urdf = tmp_path / "robot.urdf"
    urdf.write_text(mobile_manipulator())
    urdf.with_suffix(".srdf").write_text(f'<robot name="r">{ALL.format(why=why)}</robot>')
    line = error_of("robot", "check", str(urdf))
    assert re.search(r"robot\.srdf: disables all \d+ pairs .*, but \w+ and \w+ overlap in", line)
    assert not urdf.with_suffix(".toml").exists()


@pytest.mark.parametrize("out", ["robot.toml", "mine.toml"])
def test_pairs_that_touch_are_checked_although_an_srdf_says_they_never_do(
    tmp_path: Path, out: str
) -> None:
    urdf = tmp_path / "robot.urdf"
    urdf.write_text(mobile_manipulator())
    apart = '<disable_collisions link1="head_pan" link2="wheel_left" reason="Never"/>'
    lies = "".join(
        f'<disable_collisions link1="{a}" link2="{b}" reason="Never"/>'
        for a, b in (("palm", "torso"), ("arm_2", "base_link"))
    )
    old = urdf.with_suffix(".srdf")
    old.write_text(f'<robot name="r">{apart}{lies}{ADJACENT}</robot>')
    file, derived = write_robot(urdf, tmp_path / out)
    (first,) = [text for text in derived.assumptions if "never touch" in text]
    assert first.startswith(f"IMPORTANT: self-collision: {old} says that they never touch, but ")
    assert "and 1 more pairs do" in first
    robot = load_robot(file)
    assert robot.srdf == tmp_path / ("robot_checked.srdf" if out == "robot.toml" else "mine.srdf")
    assert frozenset(("palm", "torso")) not in robot.disabled
    assert {frozenset(("head_pan", "wheel_left")), PAIR} <= robot.disabled
    assert [test.passed for test in examine_at_rest(robot) if test.name == "srdf"] == [True]


def test_a_robot_file_with_an_untrue_srdf_fails_its_self_test(tmp_path: Path) -> None:
    urdf = tmp_path / "robot.urdf"
    urdf.write_text(mobile_manipulator())
    file, _ = write_robot(urdf)
    lie = '<disable_collisions link1="arm_2" link2="torso" reason="Never"/>'
    urdf.with_suffix(".srdf").write_text(f'<robot name="r">{lie}</robot>')
    text = re.sub(r"home = .*", "home = [0.0, 0.0, 2.4, 0.0, 0.0, 0.0, 0.0]", file.read_text())
    file.write_text(text)
    tests = {test.name: test for test in self_test(load_arms(file))}
    assert tests["srdf"].passed is False
    assert "robot.srdf says that they never touch, but arm_2 and torso" in tests["srdf"].words
    assert tests["home"].passed is False
    assert re.search("torso [1-9][0-9]+ mm in arm_2 at home", tests["home"].words)


FORK: tuple[Box, ...] = (
    ((-0.1, -0.06, 0.0), (0.1, 0.06, 0.02)),
    ((-0.1, -0.06, 0.02), (0.1, -0.04, 0.2)),
    ((-0.1, 0.04, 0.02), (0.1, 0.06, 0.2)),
)


@pytest.mark.parametrize("width", [0.05, 0.11])
def test_surfaces_decide_about_links_whose_hulls_overlap(tmp_path: Path, width: float) -> None:
    """A tongue turns in a fork, of which one prong is too thin to be cut apart."""
    write_obj(tmp_path / "fork.obj", triangles_of(FORK))
    limit = '<limit lower="-1" upper="1" effort="1" velocity="1"/>'
    parts = [
        link("fork", '<mesh filename="fork.obj"/>'),
        link("hub"),
        link("tongue", box(0.04, width, 0.1)),
        joint("one", "revolute", "fork", "hub", "0 0 0.15", "0 1 0", limit),
        joint("two", "revolute", "hub", "tongue", "0 0 0", "0 1 0", limit),
    ]
    path = tmp_path / "robot.urdf"
    path.write_text(f'<robot name="r">{"".join(parts)}</robot>')
    model = Articulated(read_urdf(path))  # the fork is its hull
    chain, segments = build_chain(model, "fork", "tongue", ("one", "two"))
    spheres = build_spheres(model, segments, (), ())
    q = np.random.default_rng(0).uniform(-0.5, 0.5, (20, 2))
    assert contacts(chain, spheres, q).by_hulls.all()
    crossing = surfaces_cross(model, chain, segments, spheres, ("tongue", "fork"), q)
    assert crossing.all() if width > 0.08 else not crossing.any()
    robot = UrdfArm(
        model, "fork", "tongue", ("one", "two"), frozenset({frozenset(("fork", "tongue"))})
    )
    claimed = replace(robot, claimed=robot.disabled)
    assert self_contacts(robot, q, str).ok
    assert self_contacts(claimed, q, str).ok is (width < 0.08)
