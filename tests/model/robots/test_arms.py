"""Robots with several arms, telescopes and hands, and their robot files."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from tests.urdf_parts import LIMIT, box, dual_armed, joint, link, mobile_manipulator, telescope

from momapos.apps.cli.robot import robot_check, robot_show
from momapos.core.errors import MomaposError, RobotError, UnknownNameError
from momapos.model.robots.derive import derive_robot, write_robot
from momapos.model.robots.homes import RobotBody, resting_states
from momapos.model.robots.load_limits import sample_states, touches
from momapos.model.robots.robot import Robot, load_arms, load_robot
from momapos.model.robots.robot_names import find_named_robot, find_robot, library_file
from momapos.model.robots.robot_tests import examine


@pytest.fixture(scope="module")
def twin(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("twin") / "robot.urdf"
    path.write_text(dual_armed())
    return write_robot(path)[0]


def test_arms_are_named_by_the_side_of_their_first_link(twin: Path) -> None:
    left, right = load_robot(twin, arm="left"), load_robot(twin, arm="right")
    assert left.arms == right.arms
    assert set(left.arms) == {"left", "right"}
    assert left.arm_joints[-1] == "b_j5"
    assert right.arm_joints[-1] == "j5"


def test_the_other_arm_rests_at_its_home(twin: Path) -> None:
    left, right = load_robot(twin, arm="left"), load_robot(twin, arm="right")
    own = dict(zip(right.arm_joints, right.home, strict=True))
    held = {name: q for name, q in left.model.held.items() if "finger" not in name}
    for name, value in held.items():
        assert value == pytest.approx(own[name])
    assert set(held) == set(right.arm_joints) - set(left.arm_joints)


def test_both_arms_are_free_at_home_and_compact(twin: Path) -> None:
    for robot in load_arms(twin):
        assert not touches(robot.chain, robot.spheres, robot.home[None], floor=True).any()
        assert examine(robot) == []
        tool = robot.chain.tool_poses(robot.home[None])[0, :3, 3]
        assert np.hypot(*tool[:2]) < 0.8, "the arm reaches 1.1 m"


def lowered(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Mark the states that stay free while the joint that the arms share moves end to end."""
    (lift,) = (i for i, name in enumerate(robot.arm_joints) if name in robot.other_arms)
    states = np.repeat(q[:, None], 15, axis=1)
    states[:, :, lift] = np.linspace(robot.chain.lower[lift], robot.chain.upper[lift], 15)
    hit = touches(robot.chain, robot.spheres, states.reshape(-1, q.shape[1]), floor=True)
    return ~hit.reshape(len(q), -1).any(1)


def test_both_arms_of_tiago_dual_let_the_torso_move_end_to_end() -> None:
    for robot in load_arms("tiago_dual"):
        assert lowered(robot, robot.home[None]).all()


def test_the_home_of_an_arm_lets_the_lift_move_end_to_end(twin: Path) -> None:
    robot = load_robot(twin)
    q = sample_states(robot.chain, np.random.default_rng(1))
    q = q[~touches(robot.chain, robot.spheres, q, floor=True)]
    clear = lowered(robot, q)

    body = RobotBody(robot.footprint, 1.0)

    def rest(states: np.ndarray, torso: Sequence[int] = ()) -> np.ndarray:
        every, rng = range(robot.chain.size), np.random.default_rng(0)
        found = resting_states(
            robot.chain, robot.spheres, body, states, torso=torso, held=every, rng=rng
        )
        return next(found).q

    reach = np.hypot(*robot.chain.tool_poses(q[clear])[:, :2, 3].T)
    near, wide = rest(q[~clear]), q[clear][np.argsort(reach)[len(reach) // 4]]
    pair = np.stack([near, wide])
    assert np.array_equal(rest(pair), near), "the compact state, which blocks the lift"
    assert np.array_equal(rest(pair, [0]), wide)


def test_any_arm_is_all_of_them_and_none_is_the_first(twin: Path) -> None:
    assert [robot.arm for robot in load_arms(twin)] == list(load_robot(twin).arms)
    assert load_robot(twin).arm == load_robot(twin).arms[0]
    (left,) = load_arms(twin, "left")
    assert left.arm == "left"


def test_an_arm_that_does_not_exist_is_refused(twin: Path, tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match="no arm 'third'"):
        load_robot(twin, arm="third")
    path = tmp_path / "robot.urdf"
    path.write_text(mobile_manipulator())
    with pytest.raises(RobotError, match="has one arm"):
        load_robot(write_robot(path)[0], arm="left")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda text: text.replace('base_link = "', 'tool_link = "tcp"\nbase_link = "', 1),
         "must be in the tables of arms"),
        (lambda text: re.sub(r"(?m)^home = .*", "home = [0.0]", text),
         "home must have one value per joint"),
        (lambda text: text.replace('[arms."left"', '[arms."any"'),
         "arms must not have the name 'any'"),
        (lambda text: text.replace("version = 1", "version = 2"), "version must be 1, not 2"),
    ],
)  # fmt: skip
def test_an_invalid_file_with_arms_is_refused(
    twin: Path, tmp_path: Path, change: object, words: str
) -> None:
    assert callable(change)
    text = twin.read_text().replace('urdf = "robot.urdf"', f'urdf = "{twin.parent}/robot.urdf"')
    text = re.sub(r"(?m)^srdf = .*\n", "", text)
    path = tmp_path / "robot.toml"
    path.write_text(change(text))
    with pytest.raises(MomaposError, match=words) as caught:
        load_robot(path)
    assert "\n" not in str(caught.value)


def test_stages_of_a_telescope_are_one_joint(tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(telescope())
    made, derived = write_robot(path)
    assert any("t0, t1, t2 are stages of a telescope" in text for text in derived.assumptions)
    robot = load_robot(made)
    assert robot.arm_joints[:3] == ("lift", "t0", "j0")
    assert robot.moved_joints[:5] == ("lift", "t0", "t1", "t2", "j0")
    out, inside = robot.home.copy(), robot.home.copy()
    out[1], inside[1] = 0.1, 0.0
    ends = robot.chain.tool_poses(np.stack([out, inside]))[:, :3, 3]
    assert np.linalg.norm(ends[0] - ends[1]) == pytest.approx(0.3)


def test_joints_that_slide_in_different_directions_are_no_telescope(tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    text = telescope(2)
    t1 = re.search(r'<joint name="t1".*?</joint>', text)
    path.write_text(text.replace(t1[0], t1[0].replace('xyz="1 0 0"', 'xyz="0 1 0"')))
    derived = derive_robot(path)
    assert "[coupled]" not in derived.toml
    assert '"t0", "t1"' in derived.toml


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ('"nobody" = { joint = "t0" }', "nobody"),
        ('"t1" = { joint = "t1" }', "t1"),
        ('"t1" = { joint = "t0", ratio = 0 }', "ratio"),
        ('"t1" = 3', "coupled.t1 must be {joint: ...}, not 3"),
    ],
)
def test_an_invalid_coupling_is_refused(tmp_path: Path, line: str, words: str) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(telescope(2))
    made, _ = write_robot(path)
    kept = re.sub(r'(?m)^"t1" = .*$', line, made.read_text())
    assert line in kept
    made.write_text(kept)
    with pytest.raises(MomaposError, match=words):
        load_robot(made)


def hand(count: int) -> str:
    """Return the mobile manipulator with a hand of long fingers instead of its gripper."""
    text = mobile_manipulator(fingers=False)
    parts = []
    for k in range(count):
        before = "palm"
        name = "thumb" if k == 0 else f"index_{k}"
        y = 0.04 if k == 0 else -0.04
        for segment in range(4):
            child = f"{name}_{segment}"
            xyz = f"0.06 {y} {0.02 * k}" if segment == 0 else "0.02 0 0"
            parts += [
                link(child, box(0.018, 0.012, 0.012), "0.01 0 0"),
                joint(f"{child}_joint", "revolute", before, child, xyz, "0 0 1",
                      LIMIT.format(0, 0.8)),
            ]  # fmt: skip
            before = child
    return text.replace("</robot>", "".join(parts) + "</robot>")


def test_an_arm_ends_where_its_hand_begins(tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(hand(4))
    made, derived = write_robot(path)
    assert load_robot(made).arm_joints == ("lift", "j0", "j1", "j2", "j3", "j4", "j5")
    assert any("a hand of 4 fingers" in text for text in derived.assumptions)
    assert abs(load_robot(made).closing_axis[1]) > 0.7, "thumb and fingers close sideways"


def test_the_closing_force_is_that_of_the_urdf_if_it_is_plausible(tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    text = mobile_manipulator()
    path.write_text(text)
    assert "# force = 60" in derive_robot(path).toml, "an effort of 1 N is a placeholder"
    strong = re.sub(r'(upper="0.045" effort=)"1"', r'\1"35"', text)
    assert strong != text
    path.write_text(strong)
    assert "\nforce = 35\n" in derive_robot(path).toml


def test_a_tool_that_no_arm_moves_is_refused_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(mobile_manipulator())
    made, _ = write_robot(path)
    made.write_text(made.read_text().replace('tool_link = "tcp"', 'tool_link = "head_pan"'))
    with pytest.raises(RobotError, match=r"robot\.toml: .*'head_pan' does not move with") as caught:
        load_robot(made)
    assert "\n" not in str(caught.value)


def test_an_ambiguous_robot_name_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert find_named_robot("fetch") == library_file("fetch")
    (tmp_path / "fetch.toml").write_text("")
    with pytest.raises(RobotError, match="two robots are called 'fetch'") as caught:
        find_named_robot("fetch")
    assert str(library_file("fetch")) in str(caught.value)
    assert find_named_robot("./fetch.toml") == Path("fetch.toml")
    for command in (robot_show, lambda name: robot_check(Path(name))):
        with pytest.raises(RobotError, match="two robots are called 'fetch'"):
            command("fetch")


@pytest.mark.parametrize(
    ("was", "is_"),
    [
        ('tool_link = "tcp"', 'tool_link = "nothing"'),
        ('"lift"', '"nothing"'),
        ("[rest]", "[rest]\nnothing = 0.1"),
    ],
)
def test_an_unknown_name_is_reported_with_the_robot_file(
    tmp_path: Path, was: str, is_: str
) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(mobile_manipulator())
    made, _ = write_robot(path)
    made.write_text(made.read_text().replace(was, is_, 1))
    with pytest.raises(UnknownNameError, match=r"robot\.toml: no .*'nothing' in ") as caught:
        load_robot(made)
    assert "\n" not in str(caught.value)


def test_a_word_is_a_name_and_a_source_with_a_slash_is_a_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine").write_text("")
    (tmp_path / "ours.toml").write_text("")
    assert find_robot("./mine") == Path("mine")
    for word, file in (("mine", "./mine"), ("ours", "ours.toml")):
        with pytest.raises(UnknownNameError, match=f"or give the file: {file}"):
            find_robot(word)
    (tmp_path / "fetch").write_text("")
    assert find_robot("fetch") == library_file("fetch")
    with pytest.raises(RobotError, match="two robots are called 'fetch'"):
        find_named_robot("fetch")
