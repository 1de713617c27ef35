"""Derived homes are compact, and free for every arm at every height of a torso."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.urdf_parts import LIMIT, box, dual_armed, joint, link, mobile_manipulator

from momapos.apps.cli.main import main
from momapos.model.collision.self_collision import contacts
from momapos.model.collision.spheres import Spheres
from momapos.model.kinematics.chain import Chain
from momapos.model.robots import homes
from momapos.model.robots.derive import write_robot
from momapos.model.robots.homes import RestingState, RobotBody, resting_states
from momapos.model.robots.load_limits import sample_states, touches
from momapos.model.robots.robot import Robot, load_arms, load_robot


def written(folder: Path, text: str) -> Path:
    path = folder / "robot.urdf"
    path.write_text(text)
    return write_robot(path)[0]


def upright_arm(mount: str = "0.1 0 0.6", lengths: tuple[float, ...] = (0.3, 0.26)) -> str:
    """Return an arm that stands straight up at zero, on a box of 0.5 x 0.45 m, 0.6 m high."""
    parts = [
        link("base_link", box(0.5, 0.45, 0.5), "0 0 0.35"),
        *(
            link(f"wheel{k}", '<cylinder radius="0.1" length="0.04"/>', rpy="1.5708 0 0")
            for k in range(2)
        ),
        *(
            joint(f"w{k}", "continuous", "base_link", f"wheel{k}", f"0 {y} 0.1", "0 1 0")
            for k, y in enumerate((0.2, -0.2))
        ),
    ]
    sizes, parent, xyz = (0.16, *lengths, 0.1, 0.1, 0.08), "base_link", mount
    for k, (size, axis) in enumerate(zip(sizes, "zyyzyz", strict=True)):
        way = {"z": "0 0 1", "y": "0 1 0"}[axis]
        shape = f'<cylinder radius="0.035" length="{size}"/>'
        parts += [
            link(f"arm_{k}", shape, f"0 0 {size / 2}"),
            joint(f"j{k}", "revolute", parent, f"arm_{k}", xyz, way, LIMIT.format(-2.9, 2.9)),
        ]
        parent, xyz = f"arm_{k}", f"0 0 {size}"
    parts += [
        link("palm", box(0.04, 0.12, 0.04), "0 0 0.02"),
        joint("mount", "fixed", parent, "palm", xyz),
    ]
    for side, sign in (("left", 1), ("right", -1)):
        parts += [
            link(f"{side}_finger", box(0.02, 0.01, 0.06), f"0 {sign * 0.005} 0.03"),
            joint(f"{side}_finger_joint", "prismatic", "palm", f"{side}_finger", "0 0 0.04",
                  f"0 {sign} 0", LIMIT.format(0, 0.05)),
        ]  # fmt: skip
    return f'<robot name="upright">{"".join(parts)}</robot>'


def arm_points(robot: Robot) -> np.ndarray:
    """Return the hull vertices of the arm at home, in the base's frame, by the model alone."""
    model = robot.model
    poses = model.link_poses(dict(zip(robot.arm_joints, robot.home, strict=True)))
    T = np.linalg.inv(poses[robot.base_link])
    turning = next(j for j in robot.arm_joints if model.joint(j).kind != "prismatic")
    return np.concatenate([
        h.vertices @ (T @ poses[name])[:3, :3].T + (T @ poses[name])[:3, 3]
        for name in model.moved_by(turning)
        for h in model.hulls[name]
    ])  # fmt: skip


def protrusion(robot: Robot) -> float:
    """Return the distance by which the arm protrudes from the footprint [m]."""
    edge = np.roll(robot.footprint, -1, 0) - robot.footprint
    normal = np.stack([edge[:, 1], -edge[:, 0]], -1) / np.linalg.norm(edge, axis=1)[:, None]
    beyond = (arm_points(robot)[:, None, :2] - robot.footprint[None]) * normal[None]
    return float(beyond.sum(-1).max())


@pytest.mark.parametrize(
    ("text", "highest"),
    [
        (upright_arm(), 1.05),  # straight up 1.74 m, its shoulder at 0.76 m
        (upright_arm("0 0 0.6", (0.4, 0.35)), 1.15),  # straight up 1.93 m
        (upright_arm("0.2 0 0.95").replace("0.5 0.45 0.5", "0.5 0.45 0.7"), 1.4),  # 2.09 m
    ],
)
def test_a_home_is_compact_in_height_and_stays_near_the_footprint(
    tmp_path: Path, text: str, highest: float
) -> None:
    robot = load_robot(written(tmp_path, text))
    assert arm_points(robot)[:, 2].max() < highest
    assert protrusion(robot) < 0.1


def test_a_home_is_not_higher_than_needed_next_to_a_tall_torso(tmp_path: Path) -> None:
    robot = load_robot(written(tmp_path, mobile_manipulator()))
    assert arm_points(robot)[:, 2].max() < 1.2, "the head is at 1.18 m"
    assert protrusion(robot) < 0.1


def test_a_lift_rests_low(tmp_path: Path) -> None:
    robot = load_robot(written(tmp_path, mobile_manipulator()))
    assert robot.home[0] < 0.1, "the lift travels 0.3 m and carries a head"


def home_at_every_height(robot: Robot) -> np.ndarray:
    """Return the home at 21 heights of each vertical slide."""
    slides = [i for i, n in enumerate(robot.arm_joints) if robot.model.joint(n).kind == "prismatic"]
    q = np.repeat(robot.home[None], 21, axis=0)
    for i in slides:
        q[:, i] = np.linspace(robot.chain.lower[i], robot.chain.upper[i], 21)
    return q


def free_at_every_height(robot: Robot) -> bool:
    """Return whether no hulls touch at home, whatever the heights of vertical slides."""
    q = home_at_every_height(robot)
    return not contacts(robot.chain, robot.spheres, q).by_hulls.any()


def close_arms(distance: float) -> str:
    """Return two equal arms next to each other on one lift."""
    return dual_armed().replace('xyz="0.15 0.5 0.5"', f'xyz="0.15 {distance} 0.5"')


def stiff_arm(distance: float) -> str:
    """Return two arms on one lift; the joints of the second can hardly turn."""
    text = close_arms(distance)
    return re.sub(
        r'(<joint name="b_j\d".*?)<limit lower="-2.5" upper="2.5"',
        r'\1<limit lower="-0.2" upper="0.2"',
        text,
    )


@pytest.mark.parametrize("text", [close_arms(0.25), close_arms(0.15), stiff_arm(0.2)])
def test_every_arm_is_free_at_home_at_every_height_of_the_lift(tmp_path: Path, text: str) -> None:
    robots = load_arms(written(tmp_path, text))
    assert len(robots) == 2
    for robot in robots:
        assert free_at_every_height(robot)


ACROSS = np.array([0.1, np.pi / 2, 0.0, 0.0, 0.0, 0.0, 0.0])


def reach_across_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make the first candidate reach across the other arm."""

    def candidates(*args: Any, **kwargs: Any) -> list[RestingState]:
        found = list(resting_states(*args, **kwargs))
        return found if kwargs["held"] else [replace(found[0], q=ACROSS), *found]

    monkeypatch.setattr(homes, "resting_states", candidates)


def test_an_arm_takes_another_home_where_the_first_leaves_no_place_for_the_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first candidate reaches across the stiff arm, whose states then all collide."""
    reach_across_first(monkeypatch)
    text = stiff_arm(0.5)
    robots = {robot.arm: robot for robot in load_arms(written(tmp_path, text))}
    assert not np.array_equal(robots["right"].home, ACROSS)
    assert all(map(free_at_every_height, robots.values()))


def test_links_of_two_arms_are_checked_although_they_touch_while_one_rests_at_zero(
    tmp_path: Path,
) -> None:
    """At zero the second arm lies across the shoulder of the first, which always touches it."""
    text = dual_armed().replace('xyz="0.15 0.5 0.5"', 'xyz="-0.5 0 0.5"')
    for robot in load_arms(written(tmp_path, text)):
        crossing = [pair for pair in robot.disabled if len({n[:2] == "b_" for n in pair}) == 2]
        assert not [pair for pair in crossing if "torso" not in pair]
        assert free_at_every_height(robot)


def thick_arms(section: str, mount: str, first: str, second: str) -> str:
    """Return two arms of thick links on one lift.

    Args:
        section: Width and height of the links [m].
        mount: Where the second arm starts [m].
        first, second: Limits of the joints of each arm.
    """
    text = dual_armed().replace('0.06 0.06"', f'{section}"')
    text = text.replace('xyz="0.15 0.5 0.5"', f'xyz="{mount}"')
    for prefix, limits in (("", first), ("b_", second)):
        text = re.sub(
            rf'(<joint name="{prefix}j\d".*?)<limit lower="-2.5" upper="2.5"',
            rf"\1<limit {limits}",
            text,
        )
    return text


THICK = (
    thick_arms(
        "0.14 0.14", "0.15 0.18 0.45", 'lower="-0.6" upper="0.6"', 'lower="-0.6" upper="0.6"'
    ),
    thick_arms(
        "0.05 0.18", "0.15 0.29 0.5", 'lower="-2.5" upper="0.6"', 'lower="-0.6" upper="0.6"'
    ),
)


def accepted_at_every_height(robot: Robot) -> bool:
    """Return whether the planner accepts the home, by its spheres and hulls, and on the floor."""
    q = home_at_every_height(robot)
    return not touches(robot.chain, robot.spheres, q, floor=True).any()


@pytest.mark.parametrize("text", [*THICK, close_arms(0.15)], ids=["square", "flat", "thin"])
def test_the_planner_accepts_the_home_of_every_arm_next_to_all_others(
    tmp_path: Path, text: str
) -> None:
    """Spheres of the second arm's home met the first arm, for which hulls did not decide there."""
    for robot in load_arms(written(tmp_path, text)):
        assert accepted_at_every_height(robot)


def test_where_no_homes_are_accepted_those_farthest_from_contact_are_taken_and_it_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reach_across_first(monkeypatch)
    by_hulls = homes.blocked_share

    def refused(chain: Chain, spheres: Spheres, *args: Any) -> np.ndarray:
        return by_hulls(chain, spheres, *args) if spheres.exact.all() else np.ones(1)

    seen_by = homes._Search._seen_by

    def seen(self: homes._Search, *args: Any) -> Any:
        with monkeypatch.context() as patch:
            patch.setattr(homes, "blocked_share", refused)
            return seen_by(self, *args)

    monkeypatch.setattr(homes._Search, "_seen_by", seen)
    path = tmp_path / "robot.urdf"
    path.write_text(stiff_arm(0.5))
    file, made = write_robot(path)
    assert not np.array_equal(load_robot(file, arm="right").home, ACROSS)
    said = [note for note in made.assumptions if note.startswith("IMPORTANT: right: home")]
    assert len(said) == 1
    assert "at least 20 mm from contact, too near for planning, at 100 %" in said[0]


def test_further_candidates_for_a_home_are_elsewhere(tmp_path: Path) -> None:
    robot = load_robot(written(tmp_path, mobile_manipulator()))
    q = sample_states(robot.chain, np.random.default_rng(0))
    body = RobotBody(robot.footprint, 1.0)
    found = resting_states(
        robot.chain, robot.spheres, body, q, count=3, rng=np.random.default_rng(0)
    )
    tools = robot.chain.tool_poses(np.stack([state.q for state in found]))[:, :3, 3]
    assert len(tools) == 3
    apart = np.linalg.norm(tools[:, None] - tools[None], axis=-1)[np.triu_indices(3, 1)]
    assert (apart > 0.1).all()


def test_arms_that_are_mirror_images_rest_in_mirror_images(tmp_path: Path) -> None:
    text = dual_armed().replace('xyz="0.15 0.5 0.5"', 'xyz="0.15 -0.2 0.5"')
    text = text.replace('xyz="0.15 0 0.5"', 'xyz="0.15 0.2 0.5"')
    robots = load_arms(written(tmp_path, text))
    tools = [
        (robot.model.link_poses(dict(zip(robot.arm_joints, robot.home, strict=True))), robot)
        for robot in robots
    ]
    one, other = (np.linalg.inv(T[r.base_link]) @ T[r.tool_link] for T, r in tools)
    np.testing.assert_allclose(one[:3, 3], other[:3, 3] * [1, -1, 1], atol=1e-6)
    assert all(map(free_at_every_height, robots))


def test_a_torso_that_turns_stays_upright(tmp_path: Path) -> None:
    """Two arms on a torso that leans forward about a level axis."""
    text = close_arms(0.5).replace(
        '<joint name="lift" type="prismatic">', '<joint name="lift" type="revolute">'
    )
    begin = text.index('<joint name="lift"')
    end = text.index("</joint>", begin)
    lift = re.sub(r'<axis xyz="0 0 1"/>', '<axis xyz="0 1 0"/>', text[begin:end])
    lift = re.sub(r'lower="0" upper="0.3"', 'lower="-0.3" upper="0.3"', lift)
    robots = load_arms(written(tmp_path, text[:begin] + lift + text[end:]))
    assert all(robot.arm_joints[0] == "lift" for robot in robots)
    assert all(abs(robot.home[0]) < 0.05 for robot in robots)


def test_a_given_home_is_taken_and_tested(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(upright_arm())
    names = load_robot(write_robot(path, tmp_path / "guess.toml")[0]).arm_joints
    words = [f"--home={names[1]}=0.7", f"--home={names[2]}=-0.4"]
    assert main(["robot", "check", str(path), *words]) == 0
    home = load_robot(path.with_suffix(".toml")).home
    np.testing.assert_array_equal(home[:3], [0.0, 0.7, -0.4])
    assert "home: [0, 0.7, -0.4" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("word", "reason"),
    [("elbow=1", "no joint of an arm 'elbow'"), ("{}=9", "is beyond its limits"),
     ("{}=x", "is not a number"), ("{}", "is not NAME=VALUE")],
)  # fmt: skip
def test_a_given_home_that_cannot_be_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], word: str, reason: str
) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(upright_arm())
    name = re.search(r'<joint name="(\w+)" type="revolute"', path.read_text())[1]
    assert main(["robot", "check", str(path), f"--home={word.format(name)}"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert reason in line
    assert not path.with_suffix(".toml").exists()
