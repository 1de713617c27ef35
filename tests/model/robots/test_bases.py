"""Drives, base links and turning radii from the kinematics of wheels."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose
from tests import optional
from tests.commands import error_of
from tests.model.robots.rovers import (
    CORNERS,
    DISC,
    FRONT,
    REAR,
    Axle,
    at,
    derived,
    guess_of,
    ring,
    rover,
)
from tests.real import CASES
from tests.urdf_parts import box, fixed_arm, joint, link

from momapos.core.errors import RobotError
from momapos.model.robots.robot import load_robot
from momapos.model.robots.robot_tests import examine, examine_at_rest

PAIR = at([(0.0, 0.2), (0.0, -0.2)])
DRIVES: dict[str, tuple[list[Axle], str, str]] = {
    "two wheels": (PAIR, "differential", "share one axle"),
    "two wheels and trailing casters": (
        PAIR + at(FRONT, steering=math.inf, trail=0.04), "differential", "share one axle",
    ),
    "two wheels and a named caster": (
        [*PAIR, Axle((-0.25, 0.0), name="caster", steering=math.inf)], "differential", "one axle",
    ),
    "four fixed wheels": (at(CORNERS), "differential", "skid"),
    "three wheels in a ring": (ring(3), "omni", "3 wheels point in different directions"),
    "four wheels in a ring": (ring(4), "omni", "4 wheels point in different directions"),
    "wheels with rollers": (at(CORNERS, rollers=6), "omni", "rollers"),
    "wheels named so": (at(CORNERS, name="mecanum_"), "omni", "rollers"),
    "meshes named so": (
        at(CORNERS, mesh="package://base/meshes/mecanum_left.dae"), "omni", "rollers",
    ),
    "four steered wheels": (at(CORNERS, steering=math.inf), "omni", "4 steering joints"),
    "two modules of half a turn": (
        at([(0.2, 0.0), (-0.2, 0.0)], steering=1.6), "omni", "2 steering joints",
    ),
    "a front wheel that turns across": (
        [*at(REAR), Axle((0.2, 0.0), steering=1.58)], "differential", "share one axle",
    ),
    "front wheels that turn far": (at(REAR) + at(FRONT, steering=1.2), "car", "1.20 rad"),
    "a car": (at(REAR) + at(FRONT, steering=0.46), "car", "0.46 rad"),
    "a tricycle": ([*at(REAR), Axle((0.2, 0.0), steering=0.5)], "car", "0.50 rad"),
    "all wheels steered a little": (at(CORNERS, steering=0.5), "car", "0.50 rad"),
    "steered behind": (at(FRONT) + at(REAR, steering=0.46), "car", "0.46 rad"),
}  # fmt: skip


@pytest.mark.parametrize("name", DRIVES)
def test_the_drive_follows_from_axles_and_steering(tmp_path: Path, name: str) -> None:
    axles, drive, words = DRIVES[name]
    guess = guess_of(tmp_path, rover(axles))
    assert guess.drive == drive
    assert words in guess.why
    robot, said = derived(tmp_path, rover(axles))
    assert robot.drive == drive
    assert f"drive: {drive}: {guess.why}" in said
    assert (robot.base_link == "chassis") is (
        drive != "car" or name == "all wheels steered a little"
    )
    assert len(robot.arm_joints) == 6
    assert [doubt for doubt in examine(robot) if "degrees of freedom" not in doubt] == []


def test_a_base_that_skids_is_doubted_first(tmp_path: Path) -> None:
    said = derived(tmp_path, rover(at(CORNERS)))[1]
    assert said.startswith("IMPORTANT: drive: its wheels share no axle and do not steer")


def upside_down(parent: str, child: str) -> str:
    turned = joint("flip", "fixed", parent, child, "0 0 0")
    return turned.replace("/></joint>", ' rpy="3.14159265 0 0"/></joint>')


@pytest.mark.parametrize("name", ["base_link", "base_plate"])
def test_a_link_that_looks_down_is_no_base_link(tmp_path: Path, name: str) -> None:
    down = link(name, box(0.2, 0.2, 0.02)) + upside_down("chassis", name)
    robot, said = derived(tmp_path, rover(PAIR, more=down))
    T = robot.model.rest_poses[robot.base_link]
    assert_allclose(T[:3, 2], [0, 0, 1], atol=1e-6)
    assert_allclose(T[:3, 0], [1, 0, 0], atol=1e-6)
    assert "drives along x" in said


def test_a_base_drawn_upside_down_gets_a_frame_on_the_floor(tmp_path: Path) -> None:
    root = link("root", box(0.1, 0.1, 0.1), "0 0 -0.3") + upside_down("root", "chassis")
    axles = at([(0.0, 0.2), (0.0, -0.2)], name="wheel")
    robot, _ = derived(tmp_path, rover(axles, more=root))
    T = robot.model.rest_poses[robot.base_link]
    assert_allclose(T[:3, 2], robot.model.rest_poses["chassis"][:3, 2], atol=1e-6)
    assert robot.model.rest_poses["root"][2, 2] == 1.0


@pytest.mark.parametrize("way", [math.pi / 2, -math.pi / 2])
def test_a_base_that_drives_along_y_gets_a_frame_that_looks_ahead(
    tmp_path: Path, way: float
) -> None:
    axles = [Axle((0.2, 0.0), 0.0 if way > 0 else math.pi), Axle((-0.2, 0.0), 0.0)]
    robot, said = derived(tmp_path, rover(axles))
    assert robot.base_link == "base_floor"
    assert_allclose(np.abs(robot.model.rest_poses["base_floor"][:3, 0]), [0, 1, 0], atol=1e-6)
    assert "x is not ahead" in said
    assert len(robot.arm_joints) == 6


def test_a_wheel_without_an_axis_is_refused_in_one_line(tmp_path: Path) -> None:
    text = rover(at([(0.0, 0.2), (0.0, -0.2)], name="wheel"))
    path = tmp_path / "rover.urdf"
    path.write_text(text.replace('<axis xyz="0 0 1"/></joint>', "</joint>"))
    assert "joint 'wheel0_spin' of a wheel has no <axis>" in error_of("robot", "check", str(path))


def test_a_robot_with_steering_keeps_its_wheels_out_of_its_arm(tmp_path: Path) -> None:
    robot, _ = derived(tmp_path, rover(at(CORNERS, steering=math.inf)))
    assert robot.arm_joints == ("j0", "j1", "j2", "j3", "j4", "j5")


@optional.needs("real data", CASES.is_dir())
@pytest.mark.parametrize(
    ("name", "drive"),
    [
        ("plain", "differential"),
        ("kiwi", "omni"),
        ("swerve", "omni"),
        ("car", "car"),
        ("plate_down", "differential"),
    ],
)
def test_public_bases_are_recognized(tmp_path: Path, name: str, drive: str) -> None:
    robot, _ = derived(tmp_path, (CASES / "robots" / f"{name}.urdf").read_text())
    assert robot.drive == drive
    assert robot.model.rest_poses[robot.base_link][2, 2] > 0.999


FIXED = "".join(
    link(f"wheel{k}", DISC, rpy="1.5707963 0 0")
    + joint(f"axle{k}", "fixed", "chassis", f"wheel{k}", f"{x} {y} 0.1")
    for k, (x, y) in enumerate(CORNERS)
)
"""Wheels that a file only draws."""
PLUGINS = {
    "libgazebo_ros_planar_move.so": ("omni", False),
    "libgazebo_ros_force_based_move.so": ("omni", False),
    "gz-sim-mecanum-drive-system": ("omni", False),
    "libgazebo_ros_diff_drive.so": ("differential", False),
    "libgazebo_ros_skid_steer_drive.so": ("differential", False),
    "libgazebo_ros_range.so": ("differential", True),
}
"""Plugins, and the drive of wheels with parallel axles with each; whether that is doubted."""


@pytest.mark.parametrize("plugin", PLUGINS)
@pytest.mark.parametrize("wheels", ["fixed", "rolling"])
def test_wheels_with_parallel_axles_and_the_plugin_of_the_simulation_are_weighed_together(
    tmp_path: Path, plugin: str, wheels: str
) -> None:
    gazebo = f'<gazebo><plugin name="drive" filename="{plugin}"/></gazebo>'
    axles, more = ([], FIXED) if wheels == "fixed" else (at(CORNERS), "")
    robot, words = derived(tmp_path, rover(axles, more=more + gazebo))
    drive, doubted = PLUGINS[plugin]
    assert robot.drive == drive
    assert (plugin in words) is not doubted
    assert ("IMPORTANT: drive" in words) is doubted


@pytest.mark.parametrize(
    ("axles", "drive"), [(PAIR, "differential"), (ring(3), "omni"), (at(REAR), "differential")]
)
def test_wheels_that_contradict_the_plugin_of_the_simulation_are_doubted(
    tmp_path: Path, axles: list[Axle], drive: str
) -> None:
    plugin = "planar_move" if drive == "differential" else "diff_drive"
    gazebo = f'<gazebo><plugin name="drive" filename="libgazebo_ros_{plugin}.so"/></gazebo>'
    robot, words = derived(tmp_path, rover(axles, more=gazebo))
    assert robot.drive == drive
    assert words.startswith(f"IMPORTANT: drive: libgazebo_ros_{plugin}.so drives it")


def test_fixed_wheels_show_the_axle_of_a_car(tmp_path: Path) -> None:
    rear = FIXED[FIXED.index('<link name="wheel2">') :]
    robot, words = derived(tmp_path, rover(at(FRONT, steering=0.46), more=rear))
    assert robot.drive == "car"
    assert robot.min_turning_radius == pytest.approx(0.4 / math.tan(0.46) + 0.2, rel=0.02)
    assert "wheel2 and wheel3 cannot roll in this file" in words


@pytest.mark.parametrize("mesh", [False, True])
def test_the_axle_of_a_fixed_wheel_is_that_of_its_shape(tmp_path: Path, *, mesh: bool) -> None:
    """A wheel that is 12 cm high and 9 cm wide is round about one axis only."""
    shape = '<cylinder radius="0.06" length="0.09"/>'
    if mesh:
        trimesh.creation.cylinder(0.06, 0.09).export(tmp_path / "wheel.stl")
        shape = '<mesh filename="wheel.stl"/>'
    more = "".join(
        link(name, shape, rpy="1.5707963 0 0") + joint(name, "fixed", "chassis", name, place)
        for name, place in (("left_wheel", "0 0.2 0.06"), ("right_wheel", "0 -0.2 0.06"))
    )
    robot, words = derived(tmp_path, rover([], more=more))
    assert robot.base_link == "chassis"
    assert "its 2 driven wheels share one axle" in words


LOW = {
    "rolling wheels": (at([(0.0, 0.2), (0.0, -0.2)], name="wheel"), "", "0.126"),
    "wheels without a name": (at(CORNERS), "", "0.126"),
    "fixed wheels": ([], FIXED, "0.126"),
    "wheels 8 mm below": (PAIR, "", "0.108"),
}


@pytest.mark.parametrize("name", LOW)
def test_wheels_below_the_base_link_lift_the_robot(tmp_path: Path, name: str) -> None:
    axles, more, radius = LOW[name]
    text = rover(axles, more=more).replace('radius="0.1"', f'radius="{radius}"')
    robot, words = derived(tmp_path, text)
    assert robot.base_link == "base_floor"
    poses = robot.model.rest_poses
    height = poses["chassis"][2, 3] - poses["base_floor"][2, 3]
    assert height == pytest.approx(float(radius) - 0.1, abs=0.0015)
    assert "below chassis" in words
    assert examine(robot) == []


def test_a_robot_file_whose_wheels_are_below_the_floor_is_doubted(tmp_path: Path) -> None:
    robot, _ = derived(tmp_path, rover(PAIR))
    path = tmp_path / "rover.urdf"
    path.write_text(path.read_text().replace('radius="0.1"', 'radius="0.12"'))
    lowered = load_robot(robot.path)
    (doubt,) = [text for text in examine(lowered) if "lowest point" in text]
    assert "-0.021 m above z = 0 of chassis" in doubt
    assert examine_at_rest(lowered)[2].passed is False


def foot(shape: str, xyz: str) -> str:
    """Return an arm whose plate stands on another body that nothing drives."""
    body = link("body", shape, xyz) + joint("bolts", "fixed", "body", "plate", "0 0 0.2")
    return fixed_arm().replace("</robot>", f"{body}</robot>")


SMALL = {
    "box": foot(box(0.19, 0.17, 0.18), "0 0 0.09"),
    "box under the arm": fixed_arm().replace(
        link("plate", box(0.1, 0.1, 0.04)), link("plate", box(0.19, 0.19, 0.12), "0 0 0.06")
    ),
    "drum": foot('<cylinder radius="0.09" length="0.18"/>', "0 0 0.09"),
}


@pytest.mark.parametrize("name", SMALL)
def test_a_small_body_that_stands_on_the_floor_is_a_base(tmp_path: Path, name: str) -> None:
    robot, words = derived(tmp_path, SMALL[name])
    assert np.ptp(robot.footprint, axis=0).max() < 0.2
    assert "IMPORTANT: there are no wheels" in words


FEET = {
    "plate": fixed_arm(),
    "plate on the floor": foot(box(0.15, 0.15, 0.04), "0 0 0.02"),
    "round foot": fixed_arm().replace(
        box(0.1, 0.1, 0.04), '<cylinder radius="0.08" length="0.1"/>'
    ),
}


@pytest.mark.parametrize("name", FEET)
def test_the_foot_of_an_arm_is_no_base(tmp_path: Path, name: str) -> None:
    with pytest.raises(RobotError, match="the arm has no base"):
        derived(tmp_path, FEET[name])


@pytest.mark.parametrize("name", ["three wheels in a ring", "two wheels"])
def test_a_robot_file_with_another_drive_than_its_wheels_is_doubted(
    tmp_path: Path, name: str
) -> None:
    axles, drive, _ = DRIVES[name]
    robot, _ = derived(tmp_path, rover(axles))
    other = "differential" if drive == "omni" else "omni"
    text = robot.path.read_text()
    robot.path.write_text(text.replace(f'drive = "{drive}"', f'drive = "{other}"'))
    (doubt,) = examine(load_robot(robot.path))
    assert f"base.drive is '{other}', but the wheels are {drive}" in doubt
