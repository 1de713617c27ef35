"""Static loads follow from the potential energy, and stability from the moments about the floor."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from tests.commands import output_of
from tests.urdf_parts import mobile_manipulator

from momapos.core.geometry import contains
from momapos.core.units import GRAVITY
from momapos.model.kinematics.statics import BASE
from momapos.model.records.outcomes import PoseStatus
from momapos.model.records.plans import MAX_EFFORT_SHARE, MIN_STABILITY
from momapos.model.robots.derive import write_robot
from momapos.model.robots.load_limits import robot_loads
from momapos.model.robots.robot import Robot, load_robot
from momapos.model.robots.robot_names import LIBRARY
from momapos.model.robots.running_gear import support_outline

Robots = Callable[[str], Robot]
ROBOTS = ("fetch", "stretch", "ranger_rm63")


def states(robot: Robot, count: int) -> np.ndarray:
    low, high = (np.clip(end, -3.0, 3.0) for end in (robot.chain.lower, robot.chain.upper))
    return np.random.default_rng(0).uniform(low, high, (count, robot.chain.size))


def potential(robot: Robot, q: np.ndarray) -> float:
    """Return the potential energy of all links at a state, by the link poses of the model."""
    values = dict(zip(robot.moved_joints, robot.chain.joint_values(q).tolist(), strict=True))
    poses = robot.model.link_poses(values)
    links = robot.model.urdf.links.values()
    T = poses[robot.base_link]
    heights = [
        (poses[link.name][:3, :3] @ link.center + poses[link.name][:3, 3] - T[:3, 3]) @ T[:3, 2]
        for link in links
    ]
    return GRAVITY * float(sum(link.mass * z for link, z in zip(links, heights, strict=True)))


@pytest.mark.parametrize("name", ROBOTS)
def test_efforts_under_gravity_are_the_slope_of_the_potential(name: str, robots: Robots) -> None:
    robot = robots(name)
    for q in states(robot, 5):
        slope = [
            (potential(robot, q + step) - potential(robot, q - step)) / 2e-5
            for step in 1e-5 * np.eye(len(q))
        ]
        np.testing.assert_allclose(robot_loads(robot).at(q[None]).efforts[0], slope, atol=1e-4)


@pytest.mark.parametrize("name", ROBOTS)
def test_a_force_at_the_tool_adds_its_virtual_work(name: str, robots: Robots) -> None:
    robot = robots(name)
    loads, force = robot_loads(robot), np.array([[11.0, -7.0, 5.0]])
    for q in states(robot, 5):
        tool = robot.chain.tool_poses(q[None])[:, :3, 3]
        moved = [
            robot.chain.tool_poses((q + step)[None])[0, :3, 3]
            - robot.chain.tool_poses((q - step)[None])[0, :3, 3]
            for step in 1e-5 * np.eye(len(q))
        ]
        added = loads.at(q[None], force, tool).efforts - loads.at(q[None]).efforts
        np.testing.assert_allclose(added[0], -np.array(moved) @ force[0] / 2e-5, atol=1e-4)


def test_the_zero_moment_point_balances_all_moments_about_an_edge(robots: Robots) -> None:
    robot = robots("husky_ur5e")
    loads, q = robot_loads(robot), robot.home[None]
    weight = GRAVITY * loads.arrays.mass.sum()
    before = loads.at(q).stability[0]
    # A horizontal force at height h shifts the point by force * h / weight, toward the front edge.
    push = np.array([[0.05 * weight, 0.0, 0.0]])
    after = loads.at(q, push, np.array([[0.3, 0.0, 1.0]])).stability[0]
    assert before - after == pytest.approx(0.05, abs=0.02)
    far = loads.at(q, 10 * push, np.array([[0.3, 0.0, 1.0]]))
    assert far.refused[0]
    assert far.where[0] == BASE
    worst = loads.worst(far, "waypoint 3")
    assert worst.status is PoseStatus.TIPS_OVER
    assert str(worst) == "husky_ur5e would tip over at waypoint 3"


def test_a_robot_that_is_lifted_off_the_floor_tips(robots: Robots) -> None:
    robot = robots("fetch")
    loads = robot_loads(robot)
    up = np.array([[0.0, 0.0, 1.1 * GRAVITY * loads.arrays.mass.sum()]])
    assert loads.at(robot.home[None], up, np.zeros((1, 3))).stability[0] == -np.inf


def test_every_library_robot_stands_at_home_within_its_limits(robot: Robot) -> None:
    loads = robot_loads(robot)
    home = loads.at(robot.home[None])
    assert loads.notes == ()
    assert not home.refused[0]
    assert home.stability[0] > MIN_STABILITY


def test_wheels_outline_the_support_and_an_axle_does_not(robots: Robots) -> None:
    for name, corners in (("husky_ur5e", 4), ("segway_ur5e", 3)):
        robot = robots(name)
        links = [link for link, segment in robot.segments.of_link.items() if segment == 0]
        outline = support_outline(robot.model, robot.base_link, links)
        assert len(outline) == corners
        assert contains(outline, outline.mean(0, keepdims=True)).all()
        axle = [link for link in links if link in ("left_wheel_link", "right_wheel_link")]
        if name == "segway_ur5e":
            assert support_outline(robot.model, robot.base_link, axle) is None


def test_a_drive_unit_that_turns_supports_a_circle_within_its_wheels(robots: Robots) -> None:
    """The base stands on it whatever the angle of the unit."""
    robot = robots("hsr")
    links = [link for link, segment in robot.segments.of_link.items() if segment == 0]
    outline = support_outline(robot.model, robot.base_link, links)
    wheels = np.array([[-0.11, -0.133], [-0.11, 0.133], [0.1495, 0.055], [0.1495, -0.055]])
    for yaw in np.linspace(0, 2 * np.pi, 9):
        c, s = np.cos(yaw), np.sin(yaw)
        turned = wheels @ np.array([[c, s], [-s, c]])
        hull = turned[ConvexHull(turned).vertices]
        assert contains(hull, 0.999 * outline).all()
    assert np.hypot(*outline.T).max() > 0.09


def with_urdf(tmp_path: Path, *changes: tuple[str, str]) -> Robot:
    """Return segway_ur5e with another URDF."""
    folder = tmp_path / "segway_ur5e"
    shutil.copytree(LIBRARY / "segway_ur5e", folder)
    urdf = folder / "segway_ur5e.urdf"
    text = urdf.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    urdf.write_text(text)
    return load_robot(folder / "segway_ur5e.toml")


def test_a_weak_motor_is_named_with_what_it_needs(tmp_path: Path) -> None:
    robot = with_urdf(tmp_path, ('effort="150"', 'effort="10"'))
    loads = robot_loads(robot)
    out = loads.at(np.array([[0.0, -0.3, 0.3, 0.0, 0.0, 0.0]]))
    worst = loads.worst(out, "the pre-grasp")
    assert worst.summary == "shoulder_lift_joint needs more than its effort limit"
    assert str(worst).endswith("of 10 Nm at the pre-grasp")
    need = abs(out.efforts[0, 1])
    assert need > MAX_EFFORT_SHARE * 10
    assert f"needs {need:.3g} of" in str(worst)


def test_efforts_of_zero_do_not_count_and_are_named(tmp_path: Path) -> None:
    robot = with_urdf(tmp_path, ('effort="28"', 'effort="0"'))
    loads = robot_loads(robot)
    assert loads.notes == (
        "no effort limit is known for wrist_1_joint, wrist_2_joint, wrist_3_joint",
    )
    pulled = loads.at(robot.home[None], np.array([[0.0, 0.0, -500.0]]), np.array([[1.0, 0, 0.5]]))
    assert pulled.where[0] in (BASE, 0, 1, 2)


def test_a_base_without_mass_or_out_of_balance_has_no_stability(tmp_path: Path) -> None:
    light = with_urdf(tmp_path / "a", ('<origin xyz="-0.22 0 0"/>', '<origin xyz="2.2 0 0"/>'))
    assert robot_loads(light).notes == (
        "stability does not count: by the masses in its file the robot hardly stands at home",
    )
    assert not robot_loads(light).at(light.home[None]).refused[0]


@pytest.mark.parametrize("mass", ["", '<inertial><mass value="-3"/></inertial>'])
def test_links_without_a_mass_and_joints_without_an_effort_are_named(
    tmp_path: Path, mass: str
) -> None:
    inertial = '<inertial><mass value="2"/></inertial>'
    text = re.sub(r'(<link name="[^"]*">)', rf"\1{inertial}", mobile_manipulator())
    text = text.replace(f'<link name="arm_1">{inertial}', f'<link name="arm_1">{mass}')
    text = re.sub(r'(<joint name="j2".*?effort=)"1"', r'\1"0"', text)
    path = tmp_path / "robot.urdf"
    path.write_text(text)
    notes = robot_loads(load_robot(write_robot(path)[0])).notes
    assert "no mass is known for arm_1: what they weigh does not count" in notes
    assert "no effort limit is known for j2" in notes
    shown = output_of("robot", "show", str(tmp_path / "robot.toml"))
    assert all(f"  loads     {note}\n" in shown for note in notes)
