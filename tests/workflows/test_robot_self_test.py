"""The self-test of a robot finds a home in contact, a wrong opening and a wrong base link."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from tests.urdf_parts import dual_armed, mobile_manipulator

from momapos.apps.cli.robot import robot_check
from momapos.model.robots.derive import write_robot
from momapos.model.robots.robot import Robot, load_arms, load_robot
from momapos.model.robots.robot_tests import RobotTest, examine_at_rest
from momapos.workflows import robot_self_test
from momapos.workflows.robot_self_test import self_test


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """First calls check types and shapes, which takes longer than a drawer may."""
    monkeypatch.setattr(robot_self_test, "TIMEOUT", 30.0)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "robot.urdf"
    path.write_text(mobile_manipulator())
    return write_robot(path)[0]


def changed(file: Path, pattern: str, new: str) -> Robot:
    text, count = re.subn(pattern, new, file.read_text(), flags=re.M)
    assert count >= 1
    file.write_text(text)
    return load_robot(file)


def failed(tests: Sequence[RobotTest]) -> list[str]:
    return [test.name for test in tests if test.passed is False]


def test_a_robot_of_boxes_passes_and_opens_a_drawer(file: Path) -> None:
    tests = self_test(load_arms(file))
    assert [(test.name, test.passed) for test in tests] == [
        ("home", True), ("gripper", True), ("upright", True), ("drawer", True),
    ]  # fmt: skip
    assert "opens kitchen_small" in tests[-1].words


def test_each_arm_has_tests_of_its_own(tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(dual_armed())
    tests = [test for robot in load_arms(write_robot(path)[0]) for test in examine_at_rest(robot)]
    assert {test.arm for test in tests} == {"left", "right"}
    assert failed(tests) == []


def test_a_home_in_contact_fails_and_names_the_links(file: Path) -> None:
    robot = changed(file, r"^home = .*", "home = [0.0, 0.0, 0.0, 2.4, 0.0, 2.4, 0.0]")
    home = examine_at_rest(robot)[0]
    assert home.passed is False
    assert re.search(r"arm_\d|palm|torso", home.words)
    assert "change home in robot.toml" in home.remedy
    drawer = self_test([robot])[-1]
    assert (drawer.name, drawer.passed) == ("drawer", None), "it is not tried then"


def test_a_home_below_the_floor_fails(file: Path) -> None:
    robot = changed(file, r"^home = .*", "home = [0.0, 0.0, 1.6, 0.0, 0.0, 0.0, 0.0]")
    assert failed(examine_at_rest(robot)) == ["home"]
    assert re.search("below the floor|touches", examine_at_rest(robot)[0].words)


@pytest.mark.parametrize(("opening", "ok"), [("0.09", True), ("0.05", True), ("0.15", False)])
def test_an_opening_beyond_the_travel_of_the_fingers_fails(
    file: Path, opening: str, ok: bool
) -> None:
    robot = changed(file, r"^opening = .*", f"opening = {opening}")
    test = examine_at_rest(robot)[1]
    assert test.passed is ok
    assert "the fingertips open to 0.090 m" in test.words


@pytest.mark.parametrize(
    ("opening", "ok"), [("0.09", True), ("0.05", True), ("0.099", True), ("0.12", False)]
)
def test_an_object_as_wide_as_the_opening_fits_between_the_shapes_of_the_fingers(
    file: Path, opening: str, ok: bool
) -> None:
    robot = changed(file, r"^opening = .*", f"opening = {opening}")
    (test,) = [one for one in self_test([robot]) if one.name == "gripper"]
    assert test.passed is ok
    if not ok:
        words = r"a box of 0\.110 m, .* 10 mm in (left|right)_finger"
        assert re.match(words, test.words)


def test_a_tool_frame_in_a_finger_fails(tmp_path: Path) -> None:
    """The derivation measures gaps between tips; the test tries an object at the tool."""
    path = tmp_path / "robot.urdf"
    path.write_text(mobile_manipulator(tool=False))
    file = write_robot(path)[0]
    text = file.read_text()
    grasp = re.search(r"xyz = \[([^\]]*)\]", text)
    assert grasp is not None
    x, y, z = (float(v) for v in grasp.group(1).split(","))
    file.write_text(text.replace(grasp.group(0), f"xyz = [{x}, {y + 0.03}, {z}]"))
    robot = load_robot(file)
    (test,) = [one for one in self_test([robot]) if one.name == "gripper"]
    assert test.passed is False
    assert "between the open fingers" in test.words


def test_a_closing_axis_along_the_fingers_fails(file: Path) -> None:
    robot = changed(file, r"^closing_axis = .*", "closing_axis = [0, 0, 1]")
    assert examine_at_rest(robot)[1].passed is not True


@pytest.mark.parametrize("height", [0.2, -0.1])
def test_a_base_link_off_the_floor_fails(tmp_path: Path, height: float) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(mobile_manipulator(base_z=height))
    derived = write_robot(path)[0]
    assert failed(examine_at_rest(load_robot(derived))) == []
    robot = changed(derived, r"^base_link = .*", 'base_link = "base_link"')
    upright = examine_at_rest(robot)[2]
    assert upright.passed is False
    assert "base_link in robot.toml must lie on the floor" in upright.remedy


def test_a_failed_test_is_the_first_line_and_the_file_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(mobile_manipulator(fingers=False))
    assert robot_check(path) == 0
    first, *_ = capsys.readouterr().out.splitlines()
    assert first.startswith("FAILED: gripper: no finger with a collision shape moves")
    assert "set grips to suction or hook in robot.toml" in first
    assert "--visual-hulls" in first
    assert path.with_suffix(".toml").exists()
    assert robot_check(path.with_suffix(".toml"), json=True) == 0
    tests = json.loads(capsys.readouterr().out)["self_test"]
    assert {test["name"]: test["passed"] for test in tests} == {
        "home": True, "gripper": False, "upright": True, "drawer": None,
    }  # fmt: skip


def test_nothing_is_written_if_the_self_test_is_interrupted(tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(mobile_manipulator())

    def interrupted(_arms: Sequence[Robot]) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_robot(path, inspect=interrupted)
    assert list(tmp_path.iterdir()) == [path]


def test_a_drawer_that_a_weak_arm_cannot_open_gives_the_reason(tmp_path: Path) -> None:
    """The arm's lift joints bear a tenth of what the arm weighs."""
    path = tmp_path / "robot.urdf"
    text = re.sub(
        r'(<link name="arm_\d">)',
        r'\1<inertial><mass value="4"/><inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0"'
        r' iyz="0"/></inertial>',
        mobile_manipulator(),
    )
    path.write_text(text)
    robot = load_robot(write_robot(path)[0])
    drawer = self_test([robot])[-1]
    assert drawer.passed is not True
    assert "needs" in drawer.words
    assert np.isfinite(robot.home).all()


DRAWN = '<visual><origin xyz="{at}"/><geometry><box size="{size}"/></geometry></visual>'


@pytest.mark.parametrize(
    ("link", "at", "size", "test", "words"),
    [
        ("base_link", "0 0 -0.1", "0.4 0.3 0.2", "upright", "as drawn begins at z = -0.200 m"),
        ("palm", "0.06 0 0", "0.1 0.03 0.03", "gripper", "mm in palm between the open fingers as"),
        ("palm", "0 0 0", "0.9 0.9 0.01", "home", "base_link and palm cross as they are drawn"),
    ],
)
def test_what_is_drawn_contradicts_what_collision_shapes_say(
    link: str, at: str, size: str, test: str, words: str, tmp_path: Path
) -> None:
    path, text = tmp_path / "robot.urdf", mobile_manipulator()
    path.write_text(text)
    file = write_robot(path)[0]
    body = DRAWN.format(at="0 0 0.2", size="0.6 0.4 0.4")
    for name, shape in ((link, DRAWN.format(at=at, size=size)), ("base_link", body)):
        text = text.replace(f'<link name="{name}">', f'<link name="{name}">{shape}')
    path.write_text(text)
    (found,) = [one for one in self_test(load_arms(file)) if one.name == test]
    assert found.passed is False
    assert words in found.words
