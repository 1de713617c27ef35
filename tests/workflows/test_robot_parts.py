"""A robot that is built from descriptions of its parts is the robot of the whole description."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests import optional
from tests.real import DATA
from tests.urdf_parts import box, fixed_arm, joint, link, mobile_manipulator

from momapos.apps.cli.robot import robot_check
from momapos.apps.cli.robot_build import robot_build
from momapos.core.errors import InputError, MomaposError, RobotError
from momapos.model.robots.parts import RobotPart, join_parts, read_part
from momapos.model.robots.robot import load_arms, load_robot
from momapos.model.urdf.articulated import Articulated
from momapos.model.urdf.reader import read_urdf
from momapos.workflows.robot_parts import read_description

WHOLE = mobile_manipulator()
ARM = WHOLE.index('<link name="arm_0">')
HAND = WHOLE.index('<link name="palm">')
POINTER = "version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n"


def write(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def without(text: str, name: str) -> str:
    return re.sub(f'<joint name="{name}".*?</joint>', "", text)


@pytest.fixture
def files(tmp_path: Path) -> dict[str, Path]:
    base = f"{WHOLE[:ARM]}</robot>"
    arm = f'<robot name="arm">{link("foot")}{WHOLE[ARM:HAND]}</robot>'
    arm = arm.replace('<parent link="torso"/>', '<parent link="foot"/>')
    arm = arm.replace('xyz="0.15 0 0.5"', 'xyz="0 0 0"', 1)
    hand = f'<robot name="hand">{without(WHOLE[HAND:], "mount")}'
    return {
        "base": write(tmp_path / "base.urdf", base),
        "arm": write(tmp_path / "arm.urdf", arm),
        "hand": write(tmp_path / "hand.urdf", hand),
        "mast": write(
            tmp_path / "mast.urdf",
            f'<robot name="mast">{link("base_link", box(0.1, 0.1, 0.5), "0 0 0.25")}{link("top")}'
            f"{link('side')}{joint('t', 'fixed', 'base_link', 'top', '0 0 0.5')}"
            f"{joint('s', 'fixed', 'base_link', 'side', '0 0.05 0.4')}</robot>",
        ),
    }


def part(name: str, file: Path, on: str = "", **place: object) -> RobotPart:
    return RobotPart(name, file, read_part(file, file.read_text(), {}), on, **place)  # type: ignore[arg-type]


def whole(files: dict[str, Path]) -> list[RobotPart]:
    return [
        part("base", files["base"]),
        part("arm", files["arm"], "base", link="torso", xyz=(0.15, 0.0, 0.5)),
        part("gripper", files["hand"], "arm", xyz=(0.1, 0.0, 0.0)),
    ]


def model_of(text: str) -> Articulated:
    return Articulated(read_urdf(Path("joined.urdf"), text=text, find_mesh=Path))


def test_the_joined_parts_move_as_the_whole(files: dict[str, Path]) -> None:
    joined, single = model_of(join_parts("r", whole(files)).urdf), model_of(WHOLE)
    rng = np.random.default_rng(0)
    for _ in range(5):
        values = {
            name: rng.uniform(max(one.lower, -3), min(one.upper, 3))
            for name, one in single.joints.items()
            if one.movable
        }
        poses, expected = joined.link_poses(values), single.link_poses(values)
        for name, T in expected.items():
            assert_allclose(poses[name], T, atol=1e-12)
    assert set(joined.links) == {*single.links, "foot"}


def test_the_base_keeps_its_names_and_other_parts_get_theirs_as_a_prefix(
    files: dict[str, Path],
) -> None:
    parts = [
        part("base", files["base"]),
        part("mast", files["mast"], "base", xyz=(0.0, 0.0, 0.3)),
        part("left", files["arm"], "mast", link="top"),
        part("right", files["arm"], "mast", link="side"),
        part("right_gripper", files["hand"], "right"),
    ]
    links = model_of(join_parts("two", parts).urdf).links
    assert {"base_link", "mast_base_link", "top", "left_arm_5", "right_arm_5", "palm"} <= set(links)
    assert "arm_5" not in links


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ({"arm": {"link": "nobody"}}, r"no link 'nobody' in .*base\.urdf \(carries 'arm'\)"),
        ({"arm": {"on": "gripper"}}, r"arm on gripper on arm: these parts carry each other"),
        ({"arm": {"on": "leg"}}, "no part 'leg'"),
        (
            {"arm": {"on": "mast", "link": None}},
            r"several frames can carry 'arm': side, top; .*--on",
        ),
    ],
)
def test_impossible_mounts_are_refused_in_one_line(
    files: dict[str, Path], place: dict[str, dict[str, str]], words: str
) -> None:
    parts = [
        replace(one, **place.get(one.name, {}))
        for one in (*whole(files), part("mast", files["mast"], "base"))
    ]
    with pytest.raises(MomaposError, match=words) as caught:
        join_parts("r", parts)
    assert "\n" not in str(caught.value)


def test_packages_of_one_name_in_two_folders_stay_apart(
    tmp_path: Path, files: dict[str, Path]
) -> None:
    import trimesh

    parts = [part("base", files["base"])]
    for name, side in (("one", 0.1), ("two", 0.2)):
        folder = tmp_path / name / "meshes"
        folder.mkdir(parents=True)
        trimesh.creation.box((side,) * 3).export(folder / "plate.stl")
        shape = '<mesh filename="../meshes/plate.stl"/>'
        file = write(
            tmp_path / name / "urdf" / "p.urdf", f'<robot name="p">{link(name, shape)}</robot>'
        )
        parts.append(part(name, file, "base"))
    joined = join_parts("r", parts)
    assert set(joined.packages) == {"meshes", "meshes_2"}
    assert {folder.parent.name for folder in joined.packages.values()} == {"one", "two"}
    assert "package://meshes_2/plate.stl" in joined.urdf


MJCF = """<mujoco model="arm"><compiler angle="radian"/>
<asset><mesh name="plate" vertex="0 0 0 0.1 0 0 0 0.1 0 0 0 0.1"/></asset>
<worldbody><geom type="plane" size="1 1 1"/><body name="foot">{bodies}</body></worldbody>
<actuator><position joint="j0" kp="9" forcerange="-80 80"/>
<motor joint="j1" gear="5" ctrllimited="true" ctrlrange="-2 2"/></actuator></mujoco>"""


def mjcf_arm() -> str:
    """Return the arm of the mobile manipulator, with a mesh at its last link, as MJCF."""
    axes = ["0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0"]
    bodies, end = "", ""
    for k, axis in enumerate(axes):
        length = 0.3 if k in (1, 2) else 0.1
        x = 0.0 if k == 0 else 0.3 if k in (2, 3) else 0.1
        half = f"{(length - 0.04) / 2} 0.03 0.03"
        bodies += (
            f'<body name="arm_{k}" pos="{x} 0 0"><joint name="j{k}" axis="{axis}" limited="true" '
            f'range="-2.5 2.5"/><geom type="box" size="{half}" pos="{length / 2} 0 0"/>'
        )
        end += "</body>"
    tip = '<geom type="mesh" mesh="plate"/><site name="flange" pos="0.1 0 0"/>'
    return MJCF.replace("{bodies}", bodies + tip + end)


def test_an_arm_in_mjcf_moves_as_the_one_in_urdf(tmp_path: Path, files: dict[str, Path]) -> None:
    file = write(tmp_path / "arm.xml", mjcf_arm())
    content = read_description(file, {}, {}, "r_meshes/arm_")
    single, arm = model_of(files["arm"].read_text()), model_of(content.urdf)
    values = dict(zip((f"j{k}" for k in range(6)), np.linspace(-1.0, 1.0, 6), strict=True))
    poses = arm.link_poses(values)
    for name, T in single.link_poses(values).items():
        assert_allclose(poses[name], T, atol=1e-12)
    assert_allclose(poses["flange"][:3, 3], (poses["arm_5"] @ [0.1, 0.0, 0.0, 1.0])[:3])
    assert [arm.joint(f"j{k}").effort for k in (0, 1, 2)] == [80.0, 10.0, np.inf]
    assert list(content.meshes) == ["r_meshes/arm_mesh0_plate.obj"]
    assert not content.notes  # nothing is left out


@pytest.mark.parametrize("bodies", [2, 0])
def test_an_mjcf_file_with_other_than_one_robot_is_refused(tmp_path: Path, bodies: int) -> None:
    one = '<body name="b"><joint name="j" type="hinge"/><geom size="0.1"/></body>'
    world = "".join(one.replace('"b"', f'"b{k}"').replace('"j"', f'"j{k}"') for k in range(bodies))
    file = write(tmp_path / "a.xml", f"<mujoco><worldbody>{world}</worldbody></mujoco>")
    with pytest.raises(MomaposError, match=f"one body of the world; there are {bodies}"):
        read_description(file, {}, {}, "")


def test_the_command_writes_one_urdf_and_a_robot_that_can_be_loaded(
    tmp_path: Path, files: dict[str, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    write(tmp_path / "arm.xml", mjcf_arm())
    out = tmp_path / "new" / "built.toml"
    status = robot_build(
        base=files["base"], arm=(str(tmp_path / "arm.xml"),), gripper=(str(files["hand"]),),
        at=("0.15,0,0.5,0,0,0deg",), on=("arm=torso",), out=out,
    )  # fmt: skip
    assert status == 0
    assert "written to" in capsys.readouterr().out
    robot = load_robot(out)
    assert robot.name == "built"
    assert list(robot.arm_joints) == ["lift", *(f"j{k}" for k in range(6))]
    assert {"palm", "flange", "arm_5"} <= set(robot.model.links)
    shapes = robot.model.urdf.links["arm_5"].collisions
    assert [shape.mesh for shape in shapes if shape.mesh] == [
        out.parent / "built_meshes" / "arm_mesh0_plate.obj"
    ]
    with pytest.raises(RobotError, match="exists already"):
        robot_build(base=files["base"], arm=(str(files["arm"]),), at=("0,0,0",), out=out)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({}, "arm: give its place on the base: --at arm=X,Y,Z"),
        ({"at": ("1,2",)}, "is not .PART=.X,Y,Z"),
        ({"at": ("leg=1,2,3",)}, "no part 'leg'"),
        ({"on": ("arm=leg/top",)}, "no part 'leg'"),
        ({"on": ("",)}, "is not .PART=..OTHER/.LINK"),
        ({"arm": ()}, "--arm is missing"),
        ({"arm": ("arm.urdf", "arm.urdf")}, "several arms need names"),
        ({"gripper": ("left=hand.urdf",)}, "no arm 'left'"),
        ({"xacro_arg": ("leg/a=b",)}, "no part 'leg'"),
        ({"at": ("0,0,1",), "arm": ("none.urdf",)}, "none.urdf: no such file"),
        ({"at": ("0,0,1",), "arm": ("lfs.urdf",)}, r"plate\.stl: .* pointer.*git lfs pull"),
        ({"at": ("0,0,1",), "arm": ("broken.urdf",)}, r"broken\.stl: "),
        ({"at": ("0,0,1",), "arm": ("lost.urdf",)}, "packages 'a', 'b' were not found"),
        ({"at": ("0,0,1",), "arm": ("lfs.xml",)}, r"plate\.stl: is a Git LFS pointer"),
        ({"at": ("0,0,1",), "arm": ("broken.xml",)}, r"MuJoCo rejects it: .*/broken\.stl"),
        ({"at": ("0,0,1",), "arm": ("base.urdf",)}, "the base has no arm"),
    ],
)  # fmt: skip
def test_wrong_words_and_files_are_refused_in_one_line_and_nothing_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, files: dict[str, Path],
    options: dict[str, tuple[str, ...]], words: str,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "meshes" / "plate.stl", POINTER)
    write(tmp_path / "meshes" / "broken.stl", "nonsense")
    arm = files["arm"].read_text()
    for name, mesh in (("lfs", "meshes/plate.stl"), ("broken", "meshes/broken.stl")):
        shape = f'<mesh filename="{mesh}"/>'
        write(tmp_path / f"{name}.urdf", re.sub("<box.*?/>", shape, arm, count=1))
        text = mjcf_arm().replace('vertex="0 0 0 0.1 0 0 0 0.1 0 0 0 0.1"', f'file="{mesh}"')
        write(tmp_path / f"{name}.xml", text)
    lost = [f'<mesh filename="package://{name}/x.stl"/>' for name in "ab"]
    shapes = "".join(link(f"lost{k}", mesh) for k, mesh in enumerate(lost))
    write(tmp_path / "lost.urdf", f'<robot name="lost">{shapes}</robot>')
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(InputError, match=words) as caught:
        robot_build(**{"base": files["base"], "arm": ("arm.urdf",), **options})  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)
    assert sorted(tmp_path.rglob("*")) == before


@optional.needs("xacrodoc", optional.has("xacrodoc"))
def test_the_urdf_of_a_base_alone_is_written_where_it_is_asked_for(
    tmp_path: Path, files: dict[str, Path]
) -> None:
    head = '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="b">'
    text = files["base"].read_text().replace('<robot name="test robot">', head)
    file = write(tmp_path / "b.urdf.xacro", text)
    before = sorted(tmp_path.iterdir())
    with pytest.raises(RobotError, match="robot build"):
        robot_check(file)
    assert sorted(tmp_path.iterdir()) == before
    with pytest.raises(RobotError, match="its URDF is written to"):
        robot_check(file, out=tmp_path / "new" / "base.toml")
    assert set(read_urdf(tmp_path / "new" / "base.urdf").links) == set(
        read_urdf(files["base"]).links
    )
    assert len(list((tmp_path / "new").iterdir())) == 1


def test_a_published_base_and_arm_become_a_robot(tmp_path: Path) -> None:
    base = optional.there(DATA / "robots" / "husky" / "husky.urdf")
    arm = write(tmp_path / "arm.urdf", fixed_arm().replace('effort="1"', 'effort="300"'))
    out = tmp_path / "husky.toml"
    names = ("left", "right")
    assert robot_build(
        base=base, arm=tuple(f"{name}={arm}" for name in names),
        at=("left=0.2,0.2,0.3", "right=0.2,-0.2,0.3"), out=out,
    ) == 0  # fmt: skip
    arms = load_arms(out)
    assert [one.arm for one in arms] == ["left", "right"]
    feet = [
        one.model.rest_poses[f"{name}_plate"][:3, 3] for one, name in zip(arms, names, strict=True)
    ]
    assert all(abs(a - b).max() == pytest.approx(0.4) for a, b in pairwise(feet))
