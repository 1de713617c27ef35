"""Drives, base links and turning radii from the kinematics of wheels."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests import optional
from tests.real import CASES
from tests.urdf_parts import LIMIT, box, fixed_arm, joint, link

from momapos.apps.cli.main import main
from momapos.core.errors import RobotError
from momapos.model.robots.amended_urdf import Amendments
from momapos.model.robots.drive_guess import DriveGuess, drive_of
from momapos.model.robots.examination import examine
from momapos.model.robots.robot import Robot, load_robot
from momapos.model.robots.robot_writer import write_robot
from momapos.model.robots.running_gear import drawn_meshes, find_running_gear
from momapos.model.urdf.articulated import Articulated

DISC = '<cylinder radius="0.1" length="0.05"/>'
CORNERS = [(0.2, 0.2), (0.2, -0.2), (-0.2, 0.2), (-0.2, -0.2)]
FRONT, REAR = CORNERS[:2], CORNERS[2:]
ENDLESS = ""


@dataclass(frozen=True)
class Axle:
    """A wheel at a place, with the direction of its axle, and its steering."""

    xy: tuple[float, float]
    yaw: float = math.pi / 2
    """Direction of the axle; pi / 2 rolls along x [rad]."""
    steering: float | None = None
    """Largest steering angle [rad]; infinite for a joint without limits; None without steering."""
    trail: float = 0.0
    """Distance of the wheel behind its steering axis [m]."""
    name: str = "w"
    rollers: int = 0
    mesh: str = ""


def wheel(index: int, axle: Axle, root: str) -> str:
    """Return a wheel whose axis is z of its frame, drawn as a disc 10 cm above the floor."""
    name, (x, y) = f"{axle.name}{index}", axle.xy
    shape = link(name, DISC)
    if axle.mesh:
        visual = f'<visual><geometry><mesh filename="{axle.mesh}"/></geometry></visual>'
        shape = shape.replace("</link>", f"{visual}</link>")
    parts, parent, xyz = [shape], root, f"{x} {y} 0.1"
    if axle.steering is not None:
        kind = "continuous" if math.isinf(axle.steering) else "revolute"
        limit = "" if kind == "continuous" else LIMIT.format(-axle.steering, axle.steering)
        parts += [
            link(f"k{index}"),
            joint(f"t{index}", kind, root, f"k{index}", xyz, "0 0 1", limit),
        ]
        parent, xyz = f"k{index}", f"{-axle.trail} 0 0"
    # Roll by 90 degrees about x puts z of the wheel along y; the yaw turns it from there.
    turned = joint(f"{name}_spin", "continuous", parent, name, xyz, "0 0 1")
    turned = turned.replace("/><axis", f' rpy="{math.pi / 2} 0 {axle.yaw - math.pi / 2}"/><axis')
    parts.append(turned)
    for k in range(axle.rollers):
        angle = 2 * math.pi * k / axle.rollers
        place = f"{0.09 * math.cos(angle)} {0.09 * math.sin(angle)} 0"
        parts += [
            link(f"{name}_r{k}"),
            joint(f"{name}_p{k}", "continuous", name, f"{name}_r{k}", place, "1 0 1"),
        ]
    return "".join(parts)


def rover(axles: list[Axle], root: str = "chassis", more: str = "") -> str:
    """Return an arm on a base with wheels, without a word about the drive in a name."""
    text = fixed_arm().replace(
        '<link name="plate">', f'{link(root, box(0.6, 0.5, 0.3), "0 0 0.25")}<link name="plate">', 1
    )
    wheels = "".join(wheel(index, axle, root) for index, axle in enumerate(axles))
    mount = joint("bolts", "fixed", root, "plate", "0 0 0.42")
    return text.replace("</robot>", f"{mount}{wheels}{more}</robot>")


def guess_of(folder: Path, text: str) -> DriveGuess | None:
    path = folder / "rover.urdf"
    path.write_text(text)
    model = Articulated(Amendments().read(path)[0])
    return drive_of(find_running_gear(model, model.urdf.root, drawn_meshes(None, path)))


def derived(folder: Path, text: str) -> tuple[Robot, str]:
    path = folder / "rover.urdf"
    path.write_text(text)
    made, words = write_robot(path)
    return load_robot(made), "\n".join(words.assumptions)


def ring(count: int, **more: object) -> list[Axle]:
    """Return wheels around the middle, with axles that point away from it."""
    turns = [2 * math.pi * k / count + 0.3 for k in range(count)]
    return [Axle((0.25 * math.cos(a), 0.25 * math.sin(a)), a, **more) for a in turns]  # type: ignore[arg-type]


def at(places: list[tuple[float, float]], **more: object) -> list[Axle]:
    return [Axle(xy, **more) for xy in places]  # type: ignore[arg-type]


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
    assert guess is not None
    assert guess.drive == drive
    assert words in guess.why
    if drive == "car":
        with pytest.raises(RobotError, match="the base is car-like") as caught:
            write_robot(tmp_path / "rover.urdf")
        assert guess.why in str(caught.value)
        return
    robot, said = derived(tmp_path, rover(axles))
    assert robot.drive == drive
    assert f"drive: {drive}: {guess.why}" in said
    assert robot.base_link == "chassis"
    assert len(robot.arm_joints) == 6
    assert [doubt for doubt in examine(robot) if "degrees of freedom" not in doubt] == []


@pytest.mark.parametrize("turn", [0.3, 0.46, 0.8])
def test_the_turning_radius_is_that_of_ackermann_steering(tmp_path: Path, turn: float) -> None:
    # The axles meet on the rear axle; the inner wheel is steered most.
    car = guess_of(tmp_path, rover(at(REAR) + at(FRONT, steering=turn)))
    assert car is not None
    assert car.wheelbase == pytest.approx(0.4)
    assert car.radius == pytest.approx(0.2 + 0.4 / math.tan(turn))
    tricycle = guess_of(tmp_path, rover([*at(REAR), Axle((0.2, 0.0), steering=turn)]))
    assert tricycle is not None
    assert tricycle.radius == pytest.approx(0.4 / math.tan(turn))
    every = guess_of(tmp_path, rover(at(CORNERS, steering=turn)))
    assert every is not None
    assert every.radius == pytest.approx(0.2 + 0.2 / math.tan(turn))


def test_the_side_that_steers_less_counts(tmp_path: Path) -> None:
    text = rover(at(REAR) + at(FRONT, steering=0.5)).replace('upper="0.5"', 'upper="0.3"')
    guess = guess_of(tmp_path, text)
    assert guess is not None
    assert guess.radius == pytest.approx(0.2 + 0.4 / math.tan(0.3))


@pytest.mark.parametrize("limit", ["fixed", "equal limits"])
def test_steering_that_is_fixed_makes_no_base_that_turns_on_the_spot(
    tmp_path: Path, limit: str
) -> None:
    text = rover(at(REAR) + at(FRONT, steering=0.46)).replace('"t', '"steer')
    if limit == "fixed":
        text = text.replace(
            '" type="revolute"><parent link="chassis"', '" type="fixed"><parent link="chassis"'
        )
    else:
        text = text.replace('lower="-0.46" upper="0.46"', 'lower="0" upper="0"')
    (tmp_path / "rover.urdf").write_text(text)
    with pytest.raises(RobotError, match=r"car-like: steer\d and steer\d would steer"):
        write_robot(tmp_path / "rover.urdf")


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


def test_a_wheel_without_an_axis_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = rover(at([(0.0, 0.2), (0.0, -0.2)], name="wheel"))
    path = tmp_path / "rover.urdf"
    path.write_text(text.replace('<axis xyz="0 0 1"/></joint>', "</joint>"))
    assert main(["robot", "check", str(path)]) == 2
    said = capsys.readouterr().err
    assert "joint 'wheel0_spin' of a wheel has no <axis>" in said
    assert said.count("\n") == 1


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
        ("plate_down", "differential"),
    ],
)
def test_public_bases_are_recognized(tmp_path: Path, name: str, drive: str) -> None:
    robot, _ = derived(tmp_path, (CASES / "robots" / f"{name}.urdf").read_text())
    assert robot.drive == drive
    assert robot.model.rest_poses[robot.base_link][2, 2] > 0.999


@optional.needs("real data", CASES.is_dir())
def test_the_public_car_is_refused_with_its_radius(
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = CASES / "robots" / "car.urdf"
    assert main(["robot", "check", str(path), "--json"]) == 2
    assert "least turning radius is 1.01 m" in capsys.readouterr().err
    assert json.dumps("car") not in capsys.readouterr().out


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
