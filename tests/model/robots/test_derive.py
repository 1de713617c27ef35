"""Robots derived from a URDF alone, compared with known robots."""

from __future__ import annotations

import json
import re
import shutil
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests import optional
from tests.real import DATA
from tests.urdf_parts import LIMIT, box, joint, link, mobile_manipulator

from momapos.apps.cli.robot import robot_check, robot_export, robot_list, robot_show
from momapos.core.errors import MomaposError, RobotError, UnknownNameError
from momapos.model.collision.spheres import build_spheres
from momapos.model.robots.derive import derive_robot, write_robot
from momapos.model.robots.gripper_guess import points_of
from momapos.model.robots.load_limits import sample_states, touches
from momapos.model.robots.robot import ASSUMED_FORCE, Grip, load_arms, load_robot, read_robot
from momapos.model.robots.robot_names import library_names
from momapos.model.robots.robot_tests import examine

FETCH = DATA / "robots" / "fetch"


@pytest.fixture
def urdf(tmp_path: Path) -> Path:
    path = tmp_path / "robot.urdf"
    path.write_text(mobile_manipulator())
    return path


def test_the_arm_includes_the_lift_and_excludes_wheels_head_and_fingers(urdf: Path) -> None:
    path, _ = write_robot(urdf)
    robot = load_robot(path)
    assert robot.arm_joints == ("lift", "j0", "j1", "j2", "j3", "j4", "j5")
    assert (robot.name, robot.base_link, robot.tool_link) == ("test_robot", "base_link", "tcp")
    assert robot.gripper_links == ("palm", "left_finger", "right_finger")
    assert robot.drive == "differential"
    assert_allclose(robot.approach_axis, [1, 0, 0])
    assert_allclose(robot.closing_axis, [0, 1, 0])
    assert robot.opening == pytest.approx(0.09)
    assert examine(robot) == []


def test_every_assumption_is_reported(urdf: Path) -> None:
    words = " ".join(derive_robot(urdf).assumptions)
    for key in ("arm_joints", "base_link", "tool_link", "gripper_links", "approach_axis", "home",
                "footprint", "drive: differential", "opening", "grips"):  # fmt: skip
        assert key in words


def test_home_is_free_and_compact(urdf: Path) -> None:
    robot = load_robot(write_robot(urdf)[0])
    assert not touches(robot.chain, robot.spheres, robot.home[None], floor=True).any()
    tool = robot.chain.tool_poses(robot.home[None])[0, :3, 3]
    assert np.hypot(*tool[:2]) < 0.6, "the arm reaches 1.1 m"


def test_the_footprint_contains_the_whole_base(urdf: Path) -> None:
    robot = load_robot(write_robot(urdf)[0])
    points = points_of(robot.model, "base_link", ["base_link", "wheel_left"])[:, :2]
    edge = np.roll(robot.footprint, -1, 0) - robot.footprint
    normal = np.stack([edge[:, 1], -edge[:, 0]], -1)
    inside = (points[:, None] - robot.footprint[None]) * normal[None]
    assert inside.sum(-1).max() < 1e-6


def test_virtual_driving_joints_are_not_part_of_the_arm(tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(mobile_manipulator(floating=True))
    derived = derive_robot(path)
    assert 'base_link = "base_link"' in derived.toml
    assert '["lift", "j0"' in derived.toml
    assert "drive_x, drive_y slide: use omni" in derived.assumptions[0]
    assert "drive_x, drive_y, drive_yaw represent driving" in derived.assumptions[1]


def test_a_base_above_the_floor_gets_a_frame_there(tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(mobile_manipulator(base_z=0.2))
    robot = load_robot(write_robot(path)[0])
    assert robot.base_link == "base_floor"
    low = points_of(robot.model, "base_floor", ["base_link", "wheel_left"])[:, 2].min()
    assert low == pytest.approx(0.0, abs=1e-4)
    assert examine(robot) == []


def test_a_tool_link_behind_the_fingers_gets_a_frame_between_them(tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(mobile_manipulator(tool=False))
    made, derived = write_robot(path)
    assert any("behind the fingertips" in text for text in derived.assumptions)
    robot = load_robot(made)
    assert robot.tool_link == "grasp_frame"
    fingers = points_of(robot.model, "grasp_frame", ["left_finger", "right_finger"])
    assert fingers[:, 0].max() == pytest.approx(0.02, abs=1e-4)
    assert_allclose((fingers.min(0) + fingers.max(0))[1:], 0.0, atol=1e-4)


def test_a_gripper_without_fingers_points_along_the_arm(tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(mobile_manipulator(fingers=False))
    derived = derive_robot(path)
    assert "approach_axis = [1, 0, 0]" in derived.toml
    assert any("no fingers" in text for text in derived.assumptions)
    read_robot(write_robot(path)[0])


def test_links_in_permanent_contact_are_written_to_an_srdf(tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    thick = mobile_manipulator().replace(
        link("arm_1", box(0.26, 0.06, 0.06), "0.15 0 0"), link("arm_1", '<sphere radius="0.25"/>')
    )
    path.write_text(thick)
    robot = load_robot(write_robot(path)[0])
    assert frozenset(("torso", "arm_1")) in robot.disabled
    assert 'reason="Always"' in path.with_suffix(".srdf").read_text()
    assert examine(robot) == []


def test_an_existing_srdf_is_used_and_unchanged(urdf: Path) -> None:
    srdf = urdf.with_suffix(".srdf")
    srdf.write_text('<robot name="r"><disable_collisions link1="torso" link2="arm_1"/></robot>')
    before = srdf.read_bytes()
    _, derived = write_robot(urdf)
    assert srdf.read_bytes() == before
    assert derived.pairs == {}


def test_nothing_is_overwritten(urdf: Path, tmp_path: Path) -> None:
    (tmp_path / "robot.toml").write_text("mine")
    with pytest.raises(RobotError, match="exists already"):
        write_robot(urdf)
    assert (tmp_path / "robot.toml").read_text() == "mine"
    path, _ = write_robot(urdf, tmp_path / "sub" / "other.toml")
    assert load_robot(path).model.urdf.path == urdf.resolve()
    assert not [p for p in tmp_path.rglob("*") if p.name.startswith(".")]


def test_the_same_urdf_gives_the_same_robot(urdf: Path) -> None:
    assert derive_robot(urdf) == derive_robot(urdf)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ('<robot name="r"><link name="a"/></robot>', "no chain of movable joints"),
        (mobile_manipulator().replace("collision>", "visual>"), "no link below the arm"),
        (f'<robot name="r">{"".join(link(str(i)) for i in range(600))}'
         + "".join(joint(f"j{i}", "fixed", "0", str(i), "0 0 0") for i in range(1, 600))
         + "</robot>", "600 links"),
        ("<robot", "not well-formed"),
    ],
)  # fmt: skip
def test_a_urdf_without_a_robot_is_refused_in_one_line(
    tmp_path: Path, text: str, word: str
) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(text)
    with pytest.raises(MomaposError, match=word) as caught:
        write_robot(path)
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("name", library_names())
def test_library_robots_can_be_derived_from_their_urdf(name: str) -> None:
    arms = load_arms(name)
    robot = arms[0]
    derived = derive_robot(robot.model.urdf.path)
    for arm in arms:
        assert f"arm_joints = {json.dumps(list(arm.arm_joints))}" in derived.toml
    assert f'base_link = "{robot.base_link}"' in derived.toml
    assert f'tool_link = "{robot.tool_link}"' in derived.toml
    assert f'drive = "{robot.drive}"' in derived.toml or robot.drive == "omni"
    doubts = examine(robot)
    if robot.chain.size < 6:
        assert "no reachability map" in doubts.pop()
    assert doubts == []


@pytest.mark.slow
@optional.needs("real data", FETCH.is_dir())
def test_the_manufacturers_fetch_is_derived_correctly(tmp_path: Path) -> None:
    shutil.copytree(FETCH, tmp_path / "fetch", copy_function=shutil.copyfile)
    (tmp_path / "fetch").chmod(0o755)
    (tmp_path / "fetch" / "fetch.srdf").unlink()
    robot = load_robot(write_robot(tmp_path / "fetch" / "fetch.urdf")[0])
    assert robot.arm_joints[:2] == ("torso_lift_joint", "shoulder_pan_joint")
    assert len(robot.arm_joints) == 8
    assert (robot.base_link, robot.tool_link) == ("base_link", "gripper_link")
    assert robot.opening == pytest.approx(0.1, abs=0.01)
    assert examine(robot) == []


def test_checking_a_urdf_prints_the_assumptions(
    urdf: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    picture = tmp_path / "pictures" / "robot.png"
    assert robot_check(urdf, plot=picture) == 0
    text = capsys.readouterr().out
    assert "written to" in text
    assert "arm_joints: a chain that ends in a hand" in text
    assert text.splitlines()[-1].startswith("next: momapos place open ")
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert robot_check(urdf.with_suffix(".toml"), json=True) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["written"] is False
    assert facts["doubts"] == []
    assert [joint["name"] for joint in facts["joints"]][:2] == ["lift", "j0"]
    assert "closed form" in facts["ik"] or "numerical" in facts["ik"]


def test_checking_a_robot_file_reports_likely_mistakes(
    urdf: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, _ = write_robot(urdf)
    text = path.read_text()
    home = load_robot(path).home
    text = re.sub(r"home = .*", f"home = {[0.0, 0.0, 2.4, *[0.0] * (len(home) - 3)]}", text)
    path.write_text(re.sub(r"footprint = .*", "footprint = [[0, 0], [0.1, 0], [0, 0.1]]", text))
    assert robot_check(path) == 0
    out = capsys.readouterr().out
    assert "protrudes" in out
    assert out.startswith("FAILED: home: torso 109 mm in arm_2 at home")
    with pytest.raises(RobotError, match="--out"):
        robot_check(path, out=path.with_name("b.toml"))


def test_the_library_is_listed_shown_and_exported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    robot_list(json=True)
    names = [robot["name"] for robot in json.loads(capsys.readouterr().out)["robots"]]
    assert tuple(names) == library_names()
    robot_list()
    header, fetch = capsys.readouterr().out.splitlines()[:2]
    assert header.split() == [
        "name", "arms", "joints", "reach", "[m]", "payload", "[kg]", "drive", "map",
    ]  # fmt: skip
    assert fetch.split()[:5] == ["fetch", "1", "8", "1.11", "6"]
    for name in names[:1]:
        robot_show(name)
        assert name in capsys.readouterr().out
        robot_export(name, tmp_path / "mine")
        assert load_robot(tmp_path / "mine" / f"{name}.toml").name == name
        with pytest.raises(RobotError, match="exists already"):
            robot_export(name, tmp_path / "mine")
    with pytest.raises(UnknownNameError):
        robot_export("nobody", tmp_path / "other")
    assert not (tmp_path / "other").exists()


def test_with_out_nothing_is_written_next_to_the_urdf(tmp_path: Path) -> None:
    package, mine = tmp_path / "package", tmp_path / "mine"
    package.mkdir()
    path = package / "robot.urdf"
    path.write_text(
        mobile_manipulator().replace(
            link("arm_1", box(0.26, 0.06, 0.06), "0.15 0 0"),
            link("arm_1", '<sphere radius="0.25"/>'),
        )
    )
    made, derived = write_robot(path, mine / "robot.toml")
    assert list(package.iterdir()) == [path]
    assert sorted(p.name for p in mine.iterdir()) == ["robot.srdf", "robot.toml"]
    robot = load_robot(made)
    assert robot.disabled == {frozenset(pair) for pair in derived.pairs}
    assert robot.srdf == (mine / "robot.srdf").resolve()
    (mine / "robot.srdf").unlink()
    with pytest.raises(RobotError, match="which does not exist"):
        load_robot(made)


def test_a_robot_that_cannot_be_read_back_leaves_no_files(
    urdf: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(path: Path, **_: object) -> None:
        assert path.exists()
        raise RobotError(f"{path}: is invalid")

    with monkeypatch.context() as patch:
        patch.setattr("momapos.model.robots.derive.load_arms", broken)
        with pytest.raises(RobotError, match=r"robot\.toml: is invalid"):
            write_robot(urdf)
    assert list(urdf.parent.iterdir()) == [urdf]
    load_robot(write_robot(urdf)[0])


def test_links_that_touch_only_in_the_folded_rest_state_stay_checked(tmp_path: Path) -> None:
    """At zero the forearm touches the lower arm; in other states it does not."""
    text = mobile_manipulator()
    folded = joint("j2", "revolute", "arm_1", "arm_2", "0.3 0 0", "0 1 0", LIMIT.format(-2.5, 2.5))
    assert folded in text
    back = folded.replace('xyz="0.3 0 0"', 'xyz="0.05 0 0"', 1)
    path = tmp_path / "robot.urdf"
    path.write_text(text.replace(folded, back))
    pairs = derive_robot(path).pairs
    shares = {}
    robot = load_robot(write_robot(path)[0])
    spheres = build_spheres(robot.model, robot.segments, frozenset(), robot.gripper_links)
    q = sample_states(robot.chain, np.random.default_rng(0))
    for i, j in spheres.pairs:
        only = replace(
            spheres, pairs=np.array([[i, j]]), exact=np.zeros(1, bool),
            base_pairs=np.zeros_like(spheres.base_pairs),
        )  # fmt: skip
        pair = frozenset((spheres.links[i], spheres.links[j]))
        shares[pair] = touches(robot.chain, only, q).mean()
    assert all(shares.get(frozenset(pair), 1.0) >= 0.1 for pair in pairs)


def test_a_robot_without_wheels_is_first_reported_to_need_a_base(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "robot.urdf"
    text = mobile_manipulator().replace("wheel_left", "foot_left")
    path.write_text(text.replace('name="a" type="continuous"', 'name="a" type="fixed"'))
    assert robot_check(path) == 0
    assert "a mobile robot needs a base" in capsys.readouterr().out.splitlines()[0]


def test_an_arm_of_five_joints_is_reported_to_have_no_reachability_map(tmp_path: Path) -> None:
    text = mobile_manipulator()
    for name in ("lift", "j2"):
        found = re.search(rf'<joint name="{name}".*?</joint>', text)
        text = text.replace(found[0], re.sub('type="[a-z]*"', 'type="fixed"', found[0]))
    path = tmp_path / "robot.urdf"
    path.write_text(text)
    robot = load_robot(write_robot(path)[0])
    assert len(robot.arm_joints) == 5
    assert ["5 degrees of freedom" in text for text in examine(robot)] == [True]


def two_armed() -> str:
    """Return the mobile manipulator with a second, longer arm to the side of its torso."""
    other = [
        link("side_0", box(0.1, 0.06, 0.06), "0.05 0 0"),
        joint("s0", "revolute", "torso", "side_0", "0 -0.25 0.5", "0 0 1", LIMIT.format(-3, 3)),
        link("side_1", box(0.9, 0.05, 0.05), "0.45 0 0"),
        joint("s1", "revolute", "side_0", "side_1", "0.1 0 0", "0 1 0", LIMIT.format(-3, 3)),
    ]
    return mobile_manipulator().replace("</robot>", "".join(other) + "</robot>")


def test_a_passive_arm_does_not_affect_the_compactness_of_home(tmp_path: Path) -> None:
    (tmp_path / "one").mkdir()
    (tmp_path / "two").mkdir()
    (tmp_path / "one" / "robot.urdf").write_text(mobile_manipulator())
    (tmp_path / "two" / "robot.urdf").write_text(two_armed())
    reaches = []
    for name in ("one", "two"):
        robot = load_robot(write_robot(tmp_path / name / "robot.urdf")[0])
        tool = robot.chain.tool_poses(robot.home[None])[0, :3, 3]
        reaches.append(float(np.hypot(*tool[:2])))
    assert reaches[1] < 0.6, "the arm reaches 1.1 m"
    assert reaches[0] < 0.6


def test_home_keeps_away_from_the_limits_of_revolute_joints(urdf: Path) -> None:
    robot = load_robot(write_robot(urdf)[0])
    gap = np.minimum(robot.home - robot.chain.lower, robot.chain.upper - robot.home)
    assert gap[~robot.chain.prismatic].min() > 0.1


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ('"head_joint" = 9', "its limits are -1 to 1"),
        ('"head_joint" = "a"', "must be a number"),
        ('"j0" = 0.1', "is a joint of the arm"),
        ('"nobody" = 0.1', "no movable joint 'nobody'"),
    ],
)
def test_an_invalid_rest_value_is_refused(urdf: Path, line: str, words: str) -> None:
    path, _ = write_robot(urdf)
    derived = path.read_text()
    assert derived.count("\n[rest]\n") == 1
    path.write_text(derived.replace("\n[rest]\n", f"\n[rest]\n{line}\n"))
    with pytest.raises(MomaposError, match=words):
        load_robot(path)


def test_missing_gripper_values_are_assumed_and_reported(urdf: Path) -> None:
    path, _ = write_robot(urdf)
    derived = load_robot(path)
    assert derived.grips is Grip.FINGERS
    assert derived.grip_force == ASSUMED_FORCE
    assert len(derived.assumed) == 1
    assert "60 N" in derived.assumed[0]
    path.write_text(re.sub(r"# force = .*", "force = 80", path.read_text()))
    given = load_robot(path)
    assert (given.grip_force, given.assumed) == (80.0, ())
    path.write_text(re.sub(r"(?m)^opening = .*", "", path.read_text()))
    assert "opening" in load_robot(path).assumed[0]


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("force = -5", "tool.force must be a number > 0"),
        ('force = "strong"', "tool.force must be a number > 0"),
        ('grips = "teeth"', "grips must be one of fingers, suction, hook, not 'teeth'"),
    ],
)
def test_an_invalid_gripper_is_refused(urdf: Path, line: str, words: str) -> None:
    path, _ = write_robot(urdf)
    key = line.split(" ", 1)[0]
    kept = [row for row in path.read_text().splitlines() if not row.startswith(key)]
    path.write_text("\n".join(kept).replace("\n[tool]\n", f"\n[tool]\n{line}\n"))
    with pytest.raises(RobotError, match=words):
        load_robot(path)


@pytest.mark.parametrize(
    ("name", "grips"), [("vacuum_cup", Grip.SUCTION), ("door_hook", Grip.HOOK)]
)
def test_a_tool_without_fingers_holds_by_its_name(tmp_path: Path, name: str, grips: Grip) -> None:
    path = tmp_path / "robot.urdf"
    text = mobile_manipulator(fingers=False).replace('"palm"', f'"{name}"')
    path.write_text(text)
    assert load_robot(write_robot(path)[0]).grips is grips


@pytest.mark.parametrize("name", library_names())
def test_library_robots_state_their_reach_and_payload(name: str) -> None:
    for robot in load_arms(name):
        data = tomllib.loads(robot.path.read_text())
        stated = data["arms"][robot.arm] if robot.arm else data
        assert stated["reach"] == pytest.approx(robot.outreach, abs=0.01)
        assert robot.payload is not None


def test_library_grippers_state_their_force_if_it_is_published() -> None:
    robots = [robot for name in library_names() for robot in load_arms(name)]
    assert all(robot.grips is Grip.FINGERS for robot in robots)
    assert {robot.name: robot.grip_force for robot in robots if not robot.assumed} == {
        "fetch": 60.0, "husky_ur5e": 100.0, "mobile_panda": 70.0, "ranger_rm63": 100.0,
        "segway_ur5e": 100.0, "tiago": 28.0, "tiago_dual": 28.0,
    }  # fmt: skip
    assumed = {robot.name: robot.assumed for robot in robots if robot.assumed}
    assert set(assumed) == {"hsr", "stretch"}
    assert all(len(texts) == 1 and "force" in texts[0] for texts in assumed.values())


def test_a_hand_with_as_many_finger_joints_as_an_arm_is_no_arm(tmp_path: Path) -> None:
    parts = [link("base", box(0.1, 0.1, 0.1), "0 0 0.05")]
    for finger in range(4):
        before = "base"
        for index in range(4):
            name, up = f"link_{finger}_{index}", 0.1 if index == 0 else 0.04
            parts += [
                link(name, box(0.02, 0.02, 0.03), "0 0 0.02"),
                joint(
                    f"joint_{finger}_{index}", "revolute", before, name,
                    f"0 {0.03 * finger if index == 0 else 0} {up}", "1 0 0", LIMIT.format(0, 1.5),
                ),
            ]  # fmt: skip
            before = name
    path = tmp_path / "hand.urdf"
    path.write_text(f'<robot name="hand">{"".join(parts)}</robot>')
    with pytest.raises(RobotError, match="a hand alone: only fingers move; give the URDF"):
        derive_robot(path)
