"""What a plan states about robot and scene is compared with their files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from damaged_plans import MUTATIONS
from door_case import BASE, Case, make_case, tool_poses
from tests.verification.moving_case import case_of

from momapos.apps.cli.main import main
from momapos.core.errors import FileFormatError, RobotError, UnknownNameError
from momapos.model.plan_files.plan_format import read_plan, sha256, write_plan
from momapos.model.robots.hand_openings import opened_as
from momapos.model.robots.robot import load_robot
from momapos.model.scene.scene_files import load_scene
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.planning.placement.config import PlaceConfig
from momapos.verification.plan_check import check_plan_numbers, verify_files
from momapos.verification.report import Report

FINGER_AND_HEAD = """
<link name="finger"><collision><origin xyz="0 0.09 0"/><geometry><box size="0.02 0.02 0.06"/>
</geometry></collision></link>
<joint name="jaw" type="prismatic"><parent link="palm"/><child link="finger"/>
  <origin xyz="0 0 0.1"/><axis xyz="0 -1 0"/>
  <limit lower="0" upper="0.05" effort="9" velocity="1"/></joint>
<link name="head"><collision><geometry><box size="0.06 0.06 0.06"/></geometry></collision></link>
<joint name="neck" type="revolute"><parent link="base"/><child link="head"/>
  <origin xyz="-0.15 0 0.64"/><axis xyz="0 0 1"/>
  <limit lower="-1" upper="1" effort="9" velocity="1"/></joint>
</robot>"""
ROBOT_FILE = """
name = "toy"
urdf = "robot.urdf"
base_link = "base"
tool_link = "tool"
arm_joints = ["pan", "lift", "elbow", "roll", "pitch", "twist"]
gripper_links = ["palm", "finger"]
home = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
[rest]
neck = 0.3
[base]
footprint = [[0.2, 0.2], [-0.2, 0.2], [-0.2, -0.2], [0.2, -0.2]]
drive = "differential"
[tool]
approach_axis = [0.0, 0.0, 1.0]
closing_axis = [0.0, 1.0, 0.0]
opening = 0.08
force = 60.0
"""
CAR = 'drive = "car"\nmin_turning_radius = 0.8'
WHEELS = "".join(
    f"""<link name="wheel_{side}"><collision><geometry><cylinder radius="0.05" length="0.02"/>
</geometry></collision></link><joint name="wheel_{side}_joint" type="continuous">
<parent link="base"/><child link="wheel_{side}"/><origin xyz="0 {y} 0.05" rpy="1.5708 0 0"/>
<axis xyz="0 0 1"/></joint>"""
    for side, y in (("left", 0.22), ("right", -0.22))
)


def case_with_robot_file() -> Case:
    """Return the case of the door with a robot that has a finger, a head and a robot file."""
    case = make_case()
    case.robot = case.robot.replace("</robot>", FINGER_AND_HEAD)
    case.plan["robot"] |= {"rest": {"neck": 0.3}, "drive": "differential"}
    manipulation = case.plan["manipulation"]
    manipulation |= {"holds": [[0, len(manipulation["q"]) - 1]], "families": ["pinch"]}
    return case


def verified(case: Case, folder: Path, robot_file: str | None = ROBOT_FILE) -> Report:
    path = case.write(folder)
    if robot_file is not None:
        (folder / "robot.toml").write_text(robot_file)
    return verify_files(path)


def failed(report: Report) -> dict[str, str]:
    return {check.name: check.detail for check in report.violations}


def driven(case: Case, drive: str | None, way: np.ndarray) -> None:
    """Let the base come along a path, as a plan with a drive."""
    case.plan["robot"]["drive"] = drive
    case.plan["base_path"] = way.tolist()
    case.plan["start"] = dict(zip(("x", "y", "yaw"), way[0].tolist(), strict=True))


def sideways() -> np.ndarray:
    along = np.linspace(-0.3, 0.0, 11)[:, None]
    return np.array(BASE) + along * [-np.sin(BASE[2]), np.cos(BASE[2]), 0.0]


def turning() -> np.ndarray:
    return np.array(BASE) + np.linspace(-0.5, 0.0, 11)[:, None] * [0.0, 0.0, 1.0]


def test_a_plan_that_agrees_with_its_files_is_valid(tmp_path: Path) -> None:
    report = verified(case_with_robot_file(), tmp_path)
    assert failed(report) == {}
    assert not [note for note in report.notes if "robot file" in note]


def rest(**values: float) -> Callable[[Case], None]:
    return lambda case: case.plan["robot"]["rest"].update(values)


def robot(**members: object) -> Callable[[Case], None]:
    return lambda case: case.plan["robot"].update(members)


def task(**members: object) -> Callable[[Case], None]:
    return lambda case: case.plan["task"].update(members)


def family(name: str) -> Callable[[Case], None]:
    return lambda case: case.plan["manipulation"].update(families=[name])


def joint_limits(case: Case) -> None:
    case.robot = case.robot.replace('lower="-2.8" upper="2.8"', 'lower="-3" upper="3"')


def weight_of_the_door(case: Case) -> None:
    case.scene["objects"][0]["resistance"] = {"hinge": {"friction": 5.0}}
    case.plan["resistance"] = {"cupboard": {"hinge": {"friction": 0.1}}}


def friction_of_the_file(case: Case) -> None:
    case.cupboard = case.cupboard.replace("</joint>", '<dynamics friction="5"/></joint>')
    case.plan["resistance"] = {"cupboard": {"hinge": {"friction": 0.1}}}


WRONG: dict[str, tuple[Callable[[Case], None], str, str]] = {
    "finger beyond its limit": (
        rest(jaw=0.5), "rest values within joint limits (excess)", "jaw at 0.5; limits 0 to 0.05",
    ),
    "finger beyond its lower limit": (
        rest(jaw=-0.01), "rest values within joint limits (excess)", "jaw at -0.01",
    ),
    "head turned another way": (
        rest(neck=-0.3), "rest values are those of the robot file (difference)", "neck at -0.3",
    ),
    "rest of an unknown joint": (
        rest(tail=0.1), "rest values are of joints that the plan does not move", "'tail'",
    ),
    "rest of a joint of the arm": (
        rest(pan=0.1), "rest values are of joints that the plan does not move", "'pan'",
    ),
    "another drive": (
        robot(drive="omni"), "drive is that of the robot file", "omni, robot.toml differential",
    ),
    "a car": (
        robot(drive="car", min_turning_radius=0.1), "drive is that of the robot file", "car",
    ),
    "another tool link": (
        robot(tool_link="palm"), "robot is that of its robot file", "tool_link palm",
    ),
    "a tool that sucks": (
        family("suction"), "the tool can hold as the plan states", "fingers can pinch, hook, push",
    ),
    "a family that does not exist": (
        family("glue"), "the tool can hold as the plan states", "'glue'",
    ),
    "close": (
        task(verb="close"), "the task's values close the part", "from 0 to 1, closed at 0",
    ),
    "a joint that does not follow": (
        task(follower="bar"), "task.follower follows task.joint", "'bar'",
    ),
    "friction below the scene's": (
        weight_of_the_door, "resistance and mass are as the scene states", "friction 0.1",
    ),
    "friction below that of the furniture's file": (
        friction_of_the_file, "resistance and mass are as the scene states", "friction 0.1",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_a_statement_against_the_files_is_a_violation(name: str, tmp_path: Path) -> None:
    change, check, detail = WRONG[name]
    case = case_with_robot_file()
    change(case)
    found = failed(verified(case, tmp_path))
    assert detail in found[check]


@pytest.mark.parametrize(
    "name",
    [name for name in WRONG if name not in ("another tool link", "rest of an unknown joint")],
)
def test_commands_that_use_a_plan_refuse_it_in_one_line(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    case = case_with_robot_file()
    WRONG[name][0](case)
    path = case.write(tmp_path)
    (tmp_path / "robot.toml").write_text(ROBOT_FILE)
    assert main(["export", str(path), "--to", "csv", "--out", str(tmp_path / "plan.csv")]) == 2
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    assert not (tmp_path / "plan.csv").exists()


def test_limits_of_the_robot_file_bind_a_plan_with_an_older_urdf(tmp_path: Path) -> None:
    limits = ROBOT_FILE.replace("[base]", "[limits.lift]\nupper = 0.5\n[base]")
    found = failed(verified(case_with_robot_file(), tmp_path, limits))
    assert "joint lift: upper limit 2.8, the robot file has 0.5" in found.values()


def test_an_srdf_that_disables_more_than_the_robots_own_is_a_violation(tmp_path: Path) -> None:
    case = case_with_robot_file()
    case.plan["robot"]["srdf"] = "more.srdf"
    tmp_path.joinpath("more.srdf").write_text(
        '<robot name="toy"><disable_collisions link1="palm" link2="base"/></robot>'
    )
    found = failed(verified(case, tmp_path))
    assert found == {
        "disabled pairs of links are those of the robot's SRDF": "base-palm and 0 more"
    }


@pytest.mark.parametrize(("height", "hits"), [(0.0045, False), (0.0075, True)])
def test_the_base_drives_over_what_is_up_to_five_millimeters_high(
    height: float, hits: bool, tmp_path: Path
) -> None:
    case = case_with_robot_file()
    case.robot = case.robot.replace('xyz="0 0 0.3"', 'xyz="0 0 0.25"', 1)  # down to the floor
    ahead = np.array([np.cos(BASE[2]), np.sin(BASE[2]), 0.0])
    driven(case, "differential", np.array(BASE) - np.linspace(1.4, 0.0, 57)[:, None] * ahead)
    middle = np.array([BASE[0], BASE[1], height / 2]) - 0.8 * ahead
    case.obstacle([0.4, 0.4, height], middle.tolist())
    found = failed(verified(case, tmp_path))
    assert ("start and base path collision, arm at home" in found) == hits


@pytest.mark.parametrize("stated", ["differential", None])
def test_the_drive_of_the_robot_file_counts(stated: str | None, tmp_path: Path) -> None:
    case = case_with_robot_file()
    driven(case, stated, sideways())
    name = "base path moves sideways, which its drive cannot"
    assert set(failed(verified(case, tmp_path))) == {name}
    omni = ROBOT_FILE.replace("differential", "omni")
    case.plan["robot"]["drive"] = None if stated is None else "omni"
    assert failed(verified(case, tmp_path, omni)) == {}


def test_the_turning_radius_of_the_robot_file_counts(tmp_path: Path) -> None:
    car = ROBOT_FILE.replace('drive = "differential"', CAR)
    case = case_with_robot_file()
    case.plan["robot"] |= {"drive": "car", "min_turning_radius": 0.8}
    assert failed(verified(case, tmp_path / "same", car)) == {}
    case.plan["robot"]["min_turning_radius"] = 0.4
    name = "turning radius is that of the robot file (difference)"
    assert set(failed(verified(case, tmp_path / "less", car))) == {name}
    driven(case, None, turning())
    found = failed(verified(case, tmp_path / "none", car))
    assert "base path turns tighter than its drive can" in found


def test_without_a_robot_file_the_wheels_of_the_urdf_decide(tmp_path: Path) -> None:
    name = "the wheels can drive as the plan states"
    for drive, wheels, wrong in (
        ("omni", WHEELS, {name}), ("differential", WHEELS, set()), ("omni", "", set()),
    ):  # fmt: skip
        case = make_case()
        case.robot = case.robot.replace("</robot>", f"{wheels}</robot>")
        driven(case, drive, np.array([BASE]))
        report = verified(case, tmp_path / f"{drive}{len(wheels)}", None)
        assert set(failed(report)) == wrong
        assert any(note.startswith("there is no robot file") for note in report.notes)


def test_a_moving_base_drives_as_the_robot_file_says(tmp_path: Path) -> None:
    values = np.linspace(0.0, 1.0, 41)
    base = np.array(BASE) + np.linspace(0.0, 1.0, 41)[:, None] * [0.0, 0.05, 0.0]
    case = case_of(values, tool_poses(values), base, [[0, 40]], "omni")
    case.robot = case.robot.replace("</robot>", FINGER_AND_HEAD)
    case.plan["robot"]["rest"] = {"neck": 0.3}
    names = failed(verified(case, tmp_path))
    assert "drive is that of the robot file" in names
    assert "base moves sideways, which its drive cannot" in names


def test_files_that_changed_since_planning_are_named(tmp_path: Path) -> None:
    case = case_with_robot_file()
    path = case.write(tmp_path)
    case.plan["hashes"] = {
        "scene": sha256(tmp_path / "scene.json"), "robot": sha256(tmp_path / "robot.urdf"),
    }  # fmt: skip
    assert not [note for note in verified(case, tmp_path).notes if "has changed" in note]
    case.scene["name"] = "another room"
    (note,) = (note for note in verified(case, tmp_path).notes if "has changed" in note)
    assert f"the scene ({path.with_name('scene.json')})" in note


def test_joints_that_stand_elsewhere_than_in_the_scene_file_are_named(tmp_path: Path) -> None:
    case = case_with_robot_file()
    case.scene["objects"][0]["joints"] = {"hinge": 0.2}
    case.plan["scene_joints"] = {"cupboard": {"hinge": 0.0}}
    report = verified(case, tmp_path)
    assert failed(report) == {}
    note = "the plan begins with cupboard/hinge at 0, where the scene file has 0.2"
    assert note in report.notes


def test_a_resistance_that_no_file_states_is_checked_beside_the_usual_one(tmp_path: Path) -> None:
    case = case_with_robot_file()
    case.robot = case.robot.replace('effort="300"', 'effort="1"')
    case.plan["resistance"] = {"cupboard": {"hinge": {"seal_force": 0.1}}}
    report = verified(case, tmp_path)
    assert any("seal_force 0.1, usually 6" in note for note in report.notes)
    assert "joint effort with the usual resistance" in failed(report)


def test_a_plan_without_resistance_is_checked_with_the_usual_one(tmp_path: Path) -> None:
    report = verified(case_with_robot_file(), tmp_path)
    assert any("states no resistance of cupboard/hinge" in note for note in report.notes)


def test_pick_of_a_joint_is_refused(tmp_path: Path) -> None:
    case = case_with_robot_file()
    case.plan["task"]["verb"] = "pick"
    with pytest.raises(FileFormatError, match=r"task\.joint must be null to pick"):
        read_plan(case.write(tmp_path))


def test_a_hand_is_not_opened_beyond_its_limits(tmp_path: Path) -> None:
    case_with_robot_file().write(tmp_path)
    (tmp_path / "robot.toml").write_text(ROBOT_FILE)
    with pytest.raises(RobotError, match=r"jaw rests at 0\.5 in the plan; its limits are 0 to"):
        opened_as(load_robot(tmp_path / "robot.toml"), {"jaw": 0.5})


def test_what_the_user_has_set_is_named_and_counts(tmp_path: Path) -> None:
    case = case_with_robot_file()
    case.scene["objects"][0]["resistance"] = {"hinge": {"friction": 5.0}}
    case.plan["resistance"] = {"cupboard": {"hinge": {"friction": 0.1, "seal_force": 2.0}}}
    name = "resistance and mass are as the scene states"
    assert set(failed(verified(case, tmp_path / "alone"))) == {name}
    case.plan["overrides"] = {
        "resistance": {"cupboard": {"hinge": {"friction": 0.1}}}, "assumed": {"latch_force": 2.0},
    }  # fmt: skip
    report = verified(case, tmp_path / "set")
    assert failed(report) == {}
    note = "the user of the plan has set friction of cupboard/hinge to 0.1, the assumed latch_force"
    assert any(one.startswith(note) for one in report.notes)
    case.plan["overrides"]["assumed"] = {"latch_farce": 2.0}
    with pytest.raises(UnknownNameError, match="latch_force"):
        verified(case, tmp_path / "wrong")


def test_a_plan_records_what_its_user_has_set(tmp_path: Path) -> None:
    kitchen, robot = load_scene("kitchen_small").with_mass("bottle", 0.3), load_robot("fetch")
    task = make_task(kitchen, "pick", "bottle")
    config = PipelineConfig(place=PlaceConfig(count=256, polish=1))
    plan = plan_base_placement(kitchen, robot, task, config=config).plan
    assert plan.overrides.mass == {"bottle": 0.3}
    write_plan(plan, tmp_path / "plan.json")
    assert read_plan(tmp_path / "plan.json").overrides == plan.overrides
    report = verify_files(tmp_path / "plan.json")
    assert "resistance and mass are as the scene states" not in failed(report)
    assert "the user of the plan has set the mass of bottle to 0.3 kg" in report.notes


@pytest.mark.parametrize(("edge", "inside"), [(1.0, True), (0.2, False)])
def test_the_base_stands_in_the_areas_to_keep_in(edge: float, inside: bool, tmp_path: Path) -> None:
    case, (x, y, _) = case_with_robot_file(), BASE
    e = edge / 2
    area = [[x - e, y - e], [x + e, y - e], [x + e, y + e], [x - e, y + e]]
    case.plan["region"] = {"keep_in": [area, [[9, 9], [10, 9], [9, 10]]]}
    names = failed(verified(case, tmp_path))
    assert ("base outside the areas to keep in" in names) != inside


NUMBERS = (
    "base_shifted", "base_turned", "tool_poses_turned", "tool_poses_scaled", "a_step_back",
    "approach_ends_elsewhere", "a_joint_beyond_its_limit", "another_goal",
    "the_door_stands_open_in_the_scene", "the_door_turns_less_far",
)  # fmt: skip
COLLISIONS = (
    "furniture_under_the_base", "an_obstacle_in_the_way_of_the_door",
    "an_obstacle_in_the_way_of_the_forearm",
)  # fmt: skip


def check_numbers(case: Case, folder: Path) -> None:
    path = case.write(folder)
    (folder / "robot.toml").write_text(ROBOT_FILE)
    scene, robot = load_scene(folder / "scene.json"), load_robot(folder / "robot.toml")
    check_plan_numbers(read_plan(path), scene, robot, "plan.json")


@pytest.mark.parametrize("name", NUMBERS)
def test_a_plan_is_refused_for_a_number_that_its_verification_rejects(
    name: str, tmp_path: Path
) -> None:
    case = case_with_robot_file()
    MUTATIONS[name][0](case)
    with pytest.raises(FileFormatError, match=r"^plan\.json: not a usable plan: ") as refused:
        check_numbers(case, tmp_path)
    words = str(refused.value)
    rejected = failed(verify_files(tmp_path / "plan.json"))
    assert any(words.startswith(f"plan.json: not a usable plan: {one}") for one in rejected)


def test_a_plan_is_not_refused_for_its_collisions(tmp_path: Path) -> None:
    """It can be shown and simulated."""
    check_numbers(case_with_robot_file(), tmp_path / "valid")
    for name in COLLISIONS:
        case = case_with_robot_file()
        MUTATIONS[name][0](case)
        check_numbers(case, tmp_path / name)
        assert MUTATIONS[name][1] in failed(verify_files(tmp_path / name / "plan.json"))
