"""SRDFs are found in the usual folders and read."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.urdf_parts import mobile_manipulator

from momapos.core.errors import RobotError
from momapos.model.robots.derive import derive_robot, write_robot
from momapos.model.robots.robot import load_robot
from momapos.model.robots.srdf import find_srdf, read_srdf, srdf_text

TEXT = (
    '<robot name="test robot"><disable_collisions link1="torso" link2="arm_1" reason="Never"/>'
    '<group_state name="home" group="arm"><joint name="j0" value="0.5"/></group_state>'
    '<group name="hand"><link name="palm"/><link name="left_finger"/></group>'
    '<end_effector name="hand" parent_link="arm_5" group="hand"/>'
    '<group name="arm"><chain base_link="torso" tip_link="arm_5"/></group>'
    '<group name="wrist"><joint name="j4"/><joint name="no such joint"/></group></robot>'
)
PAIR = frozenset(("torso", "arm_1"))


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
    assert found.reasons == {("torso", "arm_1"): "Never"}
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
