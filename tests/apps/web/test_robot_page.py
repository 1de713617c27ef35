"""The page of a robot: sliders of all its joints, contacts in red, and a home that is saved."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import redirect_stdout
from pathlib import Path

import numpy as np
import pytest
from tests.commands import error_of

from momapos.apps.cli.view import kind_of, robot_file
from momapos.apps.web import colors
from momapos.apps.web.robot_page import FREE, RobotPage, joint_groups, served_robot
from momapos.model.robots.robot import load_arms, load_robot
from momapos.model.robots.robot_names import library_file, library_names
from momapos.verification.robot_collision_model import link_contacts

LONG = 60.0


@pytest.fixture
def page(tmp_path: Path) -> Iterator[RobotPage]:
    with served_robot(load_arms("segway_ur5e"), tmp_path, "127.0.0.1", 0) as (page, _):
        assert page.work.wait(LONG)
        yield page


def move(page: RobotPage, **degrees: float) -> None:
    """Move sliders as a user does."""
    for name, value in degrees.items():
        page.sliders[name][1].value = value
        page.moved(name)
    assert page.work.wait(LONG)


def red_links(page: RobotPage) -> set[str]:
    red = colors.rgb(colors.INFEASIBLE)
    return {link for link, node in page.view._links if tuple(node.color) == red}


def save(page: RobotPage) -> str:
    page.save_home()
    assert page.files.wait(LONG)
    return str(page.saved.content)


@pytest.mark.parametrize("name", library_names())
def test_every_joint_of_arms_and_hands_has_one_slider(name: str) -> None:
    arms = load_arms(name)
    joints = [joint.name for group in joint_groups(arms).values() for joint in group]
    assert len(joints) == len(set(joints))
    fingers = {
        leader
        for leader, joint in arms[0].model.joints.items()
        if joint.mimic is None
        and any(joint.child in robot.gripper_links for robot in arms)
        and leader not in arms[0].arm_joints + arms[0].other_arms
    }
    assert set(joints) == {j for robot in arms for j in robot.arm_joints} | fingers


def test_arms_share_the_sliders_of_their_torso() -> None:
    groups = joint_groups(load_arms("tiago_dual"))
    assert list(groups) == ["Torso", "Arm left", "Arm right", "Hand"]
    assert [joint.name for joint in groups["Torso"]] == ["torso_lift_joint"]


def test_links_that_touch_are_red_and_named_until_they_are_apart(page: RobotPage) -> None:
    assert page.card.text == FREE
    assert red_links(page) == set()
    move(page, shoulder_lift_joint=90.0)  # the arm points down, into its base
    assert page.card.shown.headline.endswith("contacts")
    first = page.card.shown.notes[0]
    assert " mm in " in first
    assert {link for link in red_links(page) if link in first}
    page.shapes.value = True
    page.draw()
    assert page.work.wait(LONG)
    assert red_links(page)  # also where the collision shapes are drawn
    home = np.degrees(page.arms[0].home[1])
    move(page, shoulder_lift_joint=float(home))
    assert page.card.text == FREE
    assert red_links(page) == set()


def test_both_arms_of_a_robot_move_and_may_touch_each_other(tmp_path: Path) -> None:
    arms = load_arms("tiago_dual")
    joints = [joint for group in joint_groups(arms).values() for joint in group]
    rng = np.random.default_rng(0)
    crossed = next(
        values
        for values in ({j.name: rng.uniform(j.low, j.high) for j in joints} for _ in range(500))
        if any(
            {"left", "right"} == {link.split("_")[1] for link in contact.links}
            for contact in link_contacts(arms[0], values)
        )
    )
    with served_robot(arms, tmp_path, "127.0.0.1", 0) as (page, _):
        for joint in joints:
            page.sliders[joint.name][1].value = joint.to_slider(crossed[joint.name])
            page.moved(joint.name)
        assert page.work.wait(LONG)
        assert any("_left_" in note and "_right_" in note for note in page.card.shown.notes)
        assert {"left", "right"} <= {link.split("_")[1] for link in red_links(page)}


def test_the_home_of_a_library_robot_is_saved_in_a_copy(page: RobotPage, tmp_path: Path) -> None:
    before = library_file("segway_ur5e").read_text()
    move(page, wrist_3_joint=30.0)
    said = save(page)
    file = tmp_path / "my_segway_ur5e" / "segway_ur5e.toml"
    assert "Home is written to" in said
    assert load_robot(file).home[-1] == pytest.approx(np.radians(30.0), abs=1e-6)
    assert load_robot(file).home[:-1] == pytest.approx(page.arms[0].home[:-1])
    assert library_file("segway_ur5e").read_text() == before
    move(page, wrist_3_joint=40.0)
    assert "Error" not in save(page)  # the same copy
    assert load_robot(file).home[-1] == pytest.approx(np.radians(40.0), abs=1e-6)
    with served_robot(page.arms, tmp_path, "127.0.0.1", 0) as (other, _):
        assert "exists already" in save(other)
    assert load_robot(file).home[-1] == pytest.approx(np.radians(40.0), abs=1e-6)


def test_a_home_that_cannot_be_saved_is_reported_on_the_page(
    page: RobotPage, caplog: pytest.LogCaptureFixture
) -> None:
    save(page)
    page.file.write_text("name = ")
    assert "not a robot file in TOML" in save(page)
    (line,) = caplog.messages
    assert line.startswith(f"momapos: {page.file}")


def test_furniture_in_a_urdf_is_a_scene_and_a_robot_is_a_robot(shared: Path) -> None:
    assert kind_of("fetch") == kind_of("my.toml") == "robot"
    assert kind_of(str(library_file("stretch").with_suffix(".urdf"))) == "robot"
    assert kind_of("kitchen_small") == kind_of("no.urdf") == "scene"
    furniture = sorted((shared / "bestman").rglob("mobility.urdf"))
    assert {kind_of(str(file)) for file in furniture} <= {"scene"}


def test_unusable_robots_are_reported_in_one_line(tmp_path: Path) -> None:
    assert "no such" in error_of("view", "nothing.toml").lower()
    assert "no kitchen or robot 'fetc'" in error_of("view", "fetc")
    broken = tmp_path / "broken.toml"
    broken.write_text("name = ")
    assert "not a robot file in TOML" in error_of("view", str(broken))
    assert "--robot is for a scene" in error_of("view", "fetch", "--robot", "hsr")
    static = str(tmp_path / "page.html")
    assert "--static needs a plan or a run" in error_of("view", "fetch", "--static", static)
    no_base = tmp_path / "arm.urdf"
    links = "".join(f'<link name="l{k}"/>' for k in range(6))
    joints = "".join(
        f'<joint name="j{k}" type="continuous"><parent link="l{k}"/>'
        f'<child link="l{k + 1}"/></joint>'
        for k in range(5)
    )
    no_base.write_text(f'<robot name="arm">{links}{joints}</robot>')
    assert "base" in error_of("view", str(no_base))
    assert not no_base.with_suffix(".toml").exists()


def test_the_robot_file_of_a_urdf_is_derived_once(tmp_path: Path) -> None:
    urdf = tmp_path / "my_robot.urdf"
    urdf.write_text(library_file("segway_ur5e").with_suffix(".urdf").read_text())
    assert "robot file written to" in output(urdf)
    file = urdf.with_suffix(".toml")
    file.write_text("# mine\n" + file.read_text())
    assert output(urdf) == ""
    assert file.read_text().startswith("# mine")


def output(urdf: Path) -> str:
    with redirect_stdout(io.StringIO()) as out:
        assert robot_file(str(urdf)) == str(urdf.with_suffix(".toml"))
    return out.getvalue()
