"""Car-like bases: their turning radius, their base link, and what their files leave out."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests import optional
from tests.model.robots.rovers import CORNERS, FRONT, REAR, Axle, at, derived, guess_of, rover
from tests.real import CASES

from momapos.core.errors import RobotError
from momapos.model.robots.base_guess import ASSUMED_STEERING
from momapos.model.robots.derive import write_robot
from momapos.model.robots.robot import Robot, load_robot
from momapos.model.robots.robot_tests import examine

ACKERMANN = at(REAR) + at(FRONT, steering=0.46)
RADIUS = 0.2 + 0.4 / math.tan(0.46)


def base_place(robot: Robot) -> np.ndarray:
    """Return the position of the base link in the frame of the chassis [m]."""
    return robot.model.rest_poses[robot.base_link][:3, 3]


@pytest.mark.parametrize("turn", [0.3, 0.46, 0.8])
def test_the_turning_radius_is_that_of_ackermann_steering(tmp_path: Path, turn: float) -> None:
    # The axles meet on the rear axle; the inner wheel is steered most.
    car = guess_of(tmp_path, rover(at(REAR) + at(FRONT, steering=turn)))
    assert car.wheelbase == pytest.approx(0.4)
    assert car.radius == pytest.approx(0.2 + 0.4 / math.tan(turn))
    tricycle = guess_of(tmp_path, rover([*at(REAR), Axle((0.2, 0.0), steering=turn)]))
    assert tricycle.radius == pytest.approx(0.4 / math.tan(turn))
    every = guess_of(tmp_path, rover(at(CORNERS, steering=turn)))
    assert every.radius == pytest.approx(0.2 + 0.2 / math.tan(turn))


def test_the_side_that_steers_less_counts(tmp_path: Path) -> None:
    text = rover(at(REAR) + at(FRONT, steering=0.5)).replace('upper="0.5"', 'upper="0.3"')
    guess = guess_of(tmp_path, text)
    assert guess.radius == pytest.approx(0.2 + 0.4 / math.tan(0.3))


@pytest.mark.parametrize(
    ("axles", "x"),
    [
        (ACKERMANN, -0.2),
        (at(FRONT) + at(REAR, steering=0.46), 0.2),
        ([*at(REAR), Axle((0.2, 0.0), steering=0.5)], -0.2),
        (at(CORNERS, steering=0.5), 0.0),
    ],
    ids=["front", "rear", "tricycle", "all"],
)
def test_the_base_link_is_on_the_floor_at_the_middle_of_the_fixed_axle(
    tmp_path: Path, axles: list[Axle], x: float
) -> None:
    robot, said = derived(tmp_path, rover(axles))
    assert robot.drive == "car"
    assert_allclose(base_place(robot)[:2], [x, 0.0], atol=1e-3)
    assert_allclose(robot.model.rest_poses[robot.base_link][:3, :3], np.eye(3), atol=1e-6)
    assert "middle of the fixed axle" in said or x == 0.0
    guess = guess_of(tmp_path, rover(axles))
    assert guess.radius <= robot.min_turning_radius <= guess.radius + 0.001
    assert [doubt for doubt in examine(robot) if "degrees of freedom" not in doubt] == []


def test_a_base_that_looks_along_y_gets_a_frame_at_its_axle(tmp_path: Path) -> None:
    turned = [
        Axle((-axle.xy[1], axle.xy[0]), 0.0 if axle.steering is None else math.pi, axle.steering)
        for axle in ACKERMANN
    ]
    robot, _ = derived(tmp_path, rover(turned))
    T = robot.model.rest_poses[robot.base_link]
    assert_allclose(T[:2, 3], [0.0, -0.2], atol=1e-3)
    assert_allclose(np.abs(T[:3, 0]), [0.0, 1.0, 0.0], atol=1e-6)
    assert robot.min_turning_radius == pytest.approx(RADIUS, abs=1e-3)


def test_a_knuckle_that_follows_the_other_counts_with_its_own_range(tmp_path: Path) -> None:
    text = rover(ACKERMANN)
    head, _, tail = text.partition('<joint name="t3"')
    own, _, rest = tail.partition("</joint>")
    follows = f'{head}<joint name="t3"{own}<mimic joint="t2" multiplier="0.8"/></joint>{rest}'
    robot, said = derived(tmp_path, follows)
    assert robot.drive == "car"
    assert "t2 and t3 steer by at most 0.37 rad" in said
    # The right wheel is the outer one in left turns, and the inner one in right turns.
    assert robot.min_turning_radius == pytest.approx(0.2 + 0.4 / math.tan(0.8 * 0.46), abs=1e-3)


def test_wheels_that_steer_but_do_not_roll_in_the_file_count(tmp_path: Path) -> None:
    text = rover(ACKERMANN).replace('"t', '"steer')
    for index in (2, 3):  # the joint between knuckle and wheel
        text = text.replace(
            f'<joint name="w{index}_spin" type="continuous"',
            f'<joint name="w{index}_spin" type="fixed"',
        )
    robot, said = derived(tmp_path, text)
    assert robot.drive == "car"
    assert robot.min_turning_radius == pytest.approx(RADIUS, abs=1e-3)
    assert "steer2 and steer3 steer by at most 0.46 rad" in said
    assert len(robot.arm_joints) == 6


@pytest.mark.parametrize("limit", ["continuous", "no limits", "fixed", "equal limits"])
def test_steering_without_a_range_gets_an_assumed_one_which_is_said_first(
    tmp_path: Path, limit: str
) -> None:
    text = rover(ACKERMANN).replace('"t', '"steer')
    own = 'lower="-0.46" upper="0.46"'
    assert text.count(own) == 2
    if limit == "equal limits":
        text = text.replace(own, 'lower="0" upper="0"')
    elif limit == "no limits":
        text = text.replace(own, "")
    else:
        old = '" type="revolute"><parent link="chassis"'
        text = text.replace(own, "").replace(old, f'" type="{limit}"><parent link="chassis"')
    robot, said = derived(tmp_path, text)
    assert robot.drive == "car"
    assert robot.min_turning_radius == pytest.approx(
        0.2 + 0.4 / math.tan(ASSUMED_STEERING), abs=1e-3
    )
    assert said.startswith("IMPORTANT: drive: steer2 and steer3 ")
    assert "0.50 rad is assumed" in said.splitlines()[0]
    assert "base.min_turning_radius" in said.splitlines()[0]
    assert_allclose(base_place(robot)[:2], [-0.2, 0.0], atol=1e-3)


@pytest.mark.parametrize(
    ("axles", "change", "why"),
    [
        (at(FRONT, steering=0.46), ("", ""), "no wheel shows the fixed axle"),
        (ACKERMANN, ('lower="-0.46"', 'lower="0"'), "to one side only"),
    ],
)
def test_a_car_whose_radius_nothing_tells_is_refused_with_what_is_missing(
    tmp_path: Path, axles: list[Axle], change: tuple[str, str], why: str
) -> None:
    (tmp_path / "rover.urdf").write_text(rover(axles).replace(*change))
    with pytest.raises(RobotError, match="base is car-like") as caught:
        write_robot(tmp_path / "rover.urdf")
    assert why in str(caught.value)
    assert "base.min_turning_radius" in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("min_turning_radius", "# ", "base.min_turning_radius is missing"),
        ("min_turning_radius = ", "min_turning_radius = -", "base.min_turning_radius must be"),
        ('drive = "car"', 'drive = "omni"', 'base.min_turning_radius is for drive = "car"'),
        (
            'drive = "car"',
            'drive = "cart"',
            "drive must be one of differential, omni, car",
        ),
    ],
)
def test_a_robot_file_gives_a_turning_radius_to_cars_only(
    tmp_path: Path, old: str, new: str, words: str
) -> None:
    robot, _ = derived(tmp_path, rover(ACKERMANN))
    robot.path.write_text(robot.path.read_text().replace(old, new, 1))
    with pytest.raises(RobotError, match=words):
        load_robot(robot.path)


def test_a_radius_or_base_link_that_the_wheels_do_not_have_is_doubted(tmp_path: Path) -> None:
    robot, _ = derived(tmp_path, rover(ACKERMANN))
    text = robot.path.read_text()
    robot.path.write_text(text.replace("min_turning_radius = 1.", "min_turning_radius = 0."))
    (doubt,) = examine(load_robot(robot.path))
    assert doubt.startswith("base.min_turning_radius is 0.0")
    assert "1.01 m" in doubt
    robot.path.write_text(text.replace('base_link = "base_floor"', 'base_link = "chassis"'))
    doubts = " ".join(examine(load_robot(robot.path)))
    assert "base_link chassis is 0.20 m from the middle of the fixed axle" in doubts


@optional.needs("real data", CASES.is_dir())
def test_the_public_car_has_its_radius(tmp_path: Path) -> None:
    robot, _ = derived(tmp_path, (CASES / "robots" / "car.urdf").read_text())
    assert robot.min_turning_radius == pytest.approx(RADIUS, abs=1e-3)
    assert_allclose(base_place(robot)[:2], [-0.2, 0.0], atol=1e-3)
