"""URDFs with a robot file's frames, mounts and packages, and plans with such robots."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.urdf_parts import box, fixed_arm, joint, link, mobile_manipulator

from momapos.apps.cli.robot import robot_check
from momapos.core.errors import InputError, MomaposError, RobotError, UrdfError
from momapos.model.plan_files.plan_format import read_plan, write_plan
from momapos.model.records.plans import PlacementPlan, Task
from momapos.model.robots.amended_urdf import BOX, AddedFrame, Amendments, Mount
from momapos.model.robots.derive import RobotSource, derive_robot, write_robot
from momapos.model.robots.gripper_guess import points_of
from momapos.model.robots.robot import load_robot
from momapos.model.urdf.reader import read_urdf

MESH = '<mesh filename="package://shapes/plate.stl"/>'


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    path = tmp_path / "arm.urdf"
    path.write_text(fixed_arm())
    return path


def save_mesh(path: Path) -> None:
    import trimesh

    path.parent.mkdir(parents=True)
    trimesh.creation.box((0.1, 0.1, 0.04)).export(path)


def test_an_arm_without_a_base_is_refused_with_a_remedy(arm: Path) -> None:
    with pytest.raises(RobotError, match=r"the arm has no base.*--on-box") as caught:
        write_robot(arm)
    assert "\n" not in str(caught.value)
    assert list(arm.parent.iterdir()) == [arm]


def test_an_arm_on_a_box_stands_on_it(arm: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arm.write_text(fixed_arm().replace('effort="1"', 'effort="200"'))  # else its self-test is long
    assert robot_check(arm, on_box="0.6x0.5x0.9") == 0
    assert "a driving box of 0.6 x 0.5 x 0.9 m" in capsys.readouterr().out
    robot = load_robot(arm.with_suffix(".toml"))
    assert robot.base_link == BOX
    assert_allclose(np.ptp(robot.footprint, axis=0), [0.6, 0.5])
    plate = points_of(robot.model, BOX, ["plate"])
    assert plate[:, 2].min() == pytest.approx(0.9 - 0.02)
    assert robot.drive == "differential"


@pytest.mark.parametrize("size", ["0.6x0.5", "axbxc", "0.6x0.5x-1", "1x1x100"])
def test_an_invalid_box_is_refused(arm: Path, size: str) -> None:
    with pytest.raises(RobotError, match=r"0\.6x0\.5x0\.9"):
        robot_check(arm, on_box=size)


def test_an_arm_on_a_base_keeps_both_and_renames_shared_names(tmp_path: Path, arm: Path) -> None:
    base = tmp_path / "base.urdf"
    wheel = joint("j0", "continuous", "plate", "wheel", "0 0.2 0.1", "0 1 0")
    base.write_text(
        f'<robot name="base">{link("plate", box(0.5, 0.4, 0.3), "0 0 0.15")}'
        f"{link('wheel', box(0.1, 0.1, 0.1))}{wheel}</robot>"
    )
    made, _ = write_robot(
        RobotSource(arm, Mount((0.1, 0.0, 0.3), urdf=base)), tmp_path / "both.toml"
    )
    robot = load_robot(made)
    assert {"plate", "mount_plate", "wheel"} <= set(robot.model.links)
    assert {"j0", "mount_j0"} <= set(robot.model.joints)
    assert robot.base_link == "mount_plate"
    at = robot.model.rest_poses["plate"]
    assert_allclose(at[:3, 3], [0.1, 0.0, 0.3])
    assert robot.amended is not None


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ("[mount]\nbox = [1, 1]", "mount.box must be 3 numbers"),
        ("[mount]\nxyz = [0, 0, 1]", "mount needs either box"),
        ('[mount]\nurdf = "none.urdf"', "no such file"),
        ('[frames.tip]\nparent = "nobody"', "no link 'nobody'"),
        ('[frames.tcp]\nparent = "palm"', "already is a link of the URDF"),
        ('[packages]\nshapes = "none"', "which is no folder"),
        ("[packages]\nshapes = 3", "packages.shapes must be text"),
    ],
)
def test_invalid_additions_are_refused(tmp_path: Path, table: str, words: str) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(mobile_manipulator())
    made, _ = write_robot(path)
    made.write_text(f"{made.read_text()}\n{table}\n")
    with pytest.raises(MomaposError, match=words) as caught:
        load_robot(made)
    assert "\n" not in str(caught.value)


def test_a_package_folder_is_given_once_and_stored_in_the_robot_file(tmp_path: Path) -> None:
    path = tmp_path / "a" / "b" / "c" / "d" / "e" / "f" / "robot.urdf"
    path.parent.mkdir(parents=True)
    path.write_text(mobile_manipulator().replace(box(0.06, 0.12, 0.05), MESH))
    with pytest.raises(UrdfError, match=r"package 'shapes'.*searched in .*--package shapes=DIR"):
        derive_robot(path)
    save_mesh(tmp_path / "elsewhere" / "plate.stl")
    made, _ = write_robot(RobotSource(path, packages={"shapes": tmp_path / "elsewhere"}))
    robot = load_robot(made)
    assert robot.model.urdf.links["palm"].collisions[0].mesh == (
        tmp_path / "elsewhere" / "plate.stl"
    )


def test_visual_meshes_need_not_exist(tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    visual = f"<visual><geometry>{MESH}</geometry></visual></link>"
    path.write_text(mobile_manipulator().replace("</link>", visual, 1))
    assert load_robot(write_robot(path)[0]).model.urdf.links["base_link"].visuals == ()
    path.write_text(path.read_text().replace("visual>", "collision>"))
    with pytest.raises(UrdfError, match=r"package 'shapes'"):
        derive_robot(path)


def test_an_amended_urdf_is_the_same_robot_with_more_frames(tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(mobile_manipulator())
    plain, more = (
        read_urdf(path),
        Amendments((AddedFrame("tip", "palm", (0.1, 0.0, 0.02)),)).read(path)[0],
    )
    assert set(more.links) == {*plain.links, "tip"}
    assert len(more.joints) == len(plain.joints) + 1
    assert_allclose(more.joints[-1].T_parent_joint[:3, 3], [0.1, 0.0, 0.02])


def test_a_plan_includes_the_amended_urdf(tmp_path: Path) -> None:
    path = tmp_path / "robot" / "robot.urdf"
    save_mesh(path.parent / "shapes" / "plate.stl")
    path.write_text(mobile_manipulator(tool=False).replace(box(0.06, 0.12, 0.05), MESH))
    robot = load_robot(write_robot(path)[0])
    scene = tmp_path / "scene.json"
    scene.write_text("{}")
    plan = PlacementPlan(
        scene=str(scene),
        robot_name=robot.name,
        robot_urdf=str(path),
        base_link=robot.base_link,
        tool_link=robot.tool_link,
        task=Task("pick", "cup"),
        status="infeasible",
        joints=robot.moved_joints,
        base_pose=None,
        motion=None,
        navigation_cost=None,
        robot_arm="left",
        robot_amended=robot.amended,
    )
    file = tmp_path / "plans" / "plan.json"
    write_plan(plan, file)
    read = read_plan(file)
    assert read.robot_arm == "left"
    assert Path(read.robot_urdf) == file.with_name("plan.robot.urdf")
    urdf = read_urdf(Path(read.robot_urdf))
    assert robot.tool_link in urdf.links
    assert urdf.links["palm"].collisions[0].mesh == path.parent / "shapes" / "plate.stl"
    assert json.loads(file.read_text())["version"] == 1
    deep = tmp_path / "1" / "2" / "3" / "4" / "5" / "6" / "plan.json"
    with pytest.raises(RobotError, match="is outside"):
        write_plan(replace(plan, robot_arm=None), deep)
    assert not deep.exists()


def test_options_for_a_urdf_are_refused_for_a_robot_file(tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(mobile_manipulator())
    made, _ = write_robot(path)
    with pytest.raises(RobotError, match="need a URDF"):
        robot_check(made, on_box="1x1x1")
    with pytest.raises(InputError, match="is not NAME=VALUE"):
        robot_check(path, package=("shapes",))
    with pytest.raises(InputError, match="no such folder"):
        robot_check(path, package=(f"shapes={tmp_path}/none",))


def test_a_robot_with_the_name_of_a_library_robot_is_renamed(tmp_path: Path) -> None:
    path = tmp_path / "mine.urdf"
    path.write_text(re.sub('robot name="[^"]*"', 'robot name="fetch"', mobile_manipulator()))
    made, derived = write_robot(path)
    assert load_robot(made).name == "mine"
    assert any("because fetch is a library robot" in text for text in derived.assumptions)


def test_undeclared_xml_prefixes_are_ignored(tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(
        mobile_manipulator().replace(
            "</robot>", "<drake:pads drake:count='2' other:a='1'/></robot>"
        )
    )
    assert load_robot(write_robot(path)[0]).tool_link == "tcp"
