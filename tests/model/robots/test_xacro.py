"""Xacro files are expanded with their packages in a process with limits."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import pytest
from tests import optional
from tests.urdf_parts import mobile_manipulator

from momapos.core.errors import MomaposError, RobotError
from momapos.model.robots import xacro
from momapos.model.robots.derive import RobotSource, write_robot
from momapos.model.robots.robot import load_robot
from momapos.model.robots.xacro import expand_xacro

HEAD = '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="r">'
needs_xacrodoc = optional.needs("xacrodoc", find_spec("xacrodoc") is not None)


@needs_xacrodoc
def test_a_xacro_file_becomes_a_urdf_next_to_the_robot_file(tmp_path: Path) -> None:
    package = tmp_path / "robots" / "my_description"
    macro, main = package / "parts" / "all.xacro", package / "robots" / "main.urdf.xacro"
    for path in (macro, main):
        path.parent.mkdir(parents=True)
    body = mobile_manipulator().removeprefix('<robot name="test robot">').removesuffix("</robot>")
    macro.write_text(f'{HEAD}<xacro:macro name="all" params="">{body}</xacro:macro></robot>')
    main.write_text(
        f'{HEAD}<xacro:include filename="$(find my_description)/parts/all.xacro"/>'
        "<xacro:all/></robot>"
    )
    made, _ = write_robot(main, tmp_path / "mine" / "robot.toml")
    assert sorted(path.name for path in made.parent.iterdir()) == ["robot.toml", "robot.urdf"]
    assert load_robot(made).arm_joints[0] == "lift"
    assert [path.name for path in main.parent.iterdir()] == ["main.urdf.xacro"]


@needs_xacrodoc
@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            f'{HEAD}<xacro:include filename="$(find nobody)/x.xacro"/></robot>',
            "package 'nobody' was not found",
        ),
        (
            f'{HEAD}<xacro:include filename="$(find nobody)/x.xacro"/><xacro:of_nobody/>'
            '<link name="${of_nobody * 2}"/><xacro:include filename="$(find noone)/y.xacro"/>'
            "</robot>",
            "packages 'nobody', 'noone' were not found.*--package nobody=DIR --package noone=DIR",
        ),
        (f"{HEAD}<xacro:nothing/></robot>", "cannot be expanded"),
        (f'{HEAD}<link name="$(arg name)"/></robot>', "give it: --xacro-arg name=VALUE"),
        ("<robot", "cannot be expanded"),
        (f'{HEAD}<xacro:property name="x" value="${{9**9**9**9}}"/>${{x}}</robot>', "expand"),
    ],
)
def test_a_file_that_cannot_be_expanded_is_refused_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, words: str
) -> None:
    monkeypatch.setattr(xacro, "MAX_SECONDS", 2 if "9**9" in text else 5)  # that one is endless
    path = tmp_path / "robot.xacro"
    path.write_text(text)
    with pytest.raises(RobotError, match=words) as caught:
        write_robot(path)
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == [path]


@needs_xacrodoc
def test_all_runs_of_a_file_share_its_time_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names, given = ("a_description", "b_description", "c_description"), []
    for name in names:
        (tmp_path / name).mkdir()
    path = tmp_path / "robot.xacro"
    path.write_text(HEAD + "".join(f'<link name="$(find {name})"/>' for name in names) + "</robot>")
    run = subprocess.run

    def noted(*words: Any, **options: Any) -> subprocess.CompletedProcess[str]:
        given.append(options["timeout"])
        return run(*words, **options)

    monkeypatch.setattr(xacro.subprocess, "run", noted)
    expand_xacro(path, {}, {})
    assert len(given) == 2  # one run misses all of them
    assert all(later < earlier for earlier, later in pairwise([xacro.MAX_SECONDS, *given]))


@needs_xacrodoc
def test_arguments_reach_the_file(tmp_path: Path) -> None:
    path = tmp_path / "robot.xacro"
    path.write_text(f'{HEAD}<xacro:arg name="a" default="x"/><link name="$(arg a)"/></robot>')
    assert 'name="x"' in expand_xacro(path, {}, {}).urdf
    assert 'name="chosen"' in expand_xacro(path, {}, {"a": "chosen"}).urdf


@needs_xacrodoc
@pytest.mark.parametrize("where", ["", ":", "."])
def test_no_module_next_to_the_file_is_imported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, where: str
) -> None:
    monkeypatch.setenv("PYTHONPATH", where)
    path, trap = tmp_path / "robot.xacro", tmp_path / "run"
    path.write_text(HEAD + "<xacro:property name='a' value=\"${load_yaml('a.yaml')}\"/></robot>")
    (tmp_path / "a.yaml").write_text("a: 1")
    for name in ("json", "re", "xacro", "xacrodoc", "yaml", "resource"):
        (tmp_path / f"{name}.py").write_text(f"open({str(trap)!r}, 'w')\nraise SystemExit(1)")
    assert "<robot" in expand_xacro(path, {}, {}).urdf
    assert not trap.exists()


OLD = (
    '<property name="length" value="0.4"/>'
    '<macro name="{name}" params="at"><link name="link_${{at}}"><collision><geometry>'
    '<box size="${{length}} 1 1"/></geometry></collision></link></macro>'
)
"""Properties and macros as files wrote them until ROS Melodic."""


@needs_xacrodoc
@pytest.mark.parametrize("call", ["part", "xacro:part"])
@pytest.mark.parametrize("tag", ["include", "xacro:include"])
def test_old_tags_without_the_prefix_are_expanded_and_named(
    tmp_path: Path, tag: str, call: str
) -> None:
    path = tmp_path / "robot.xacro"
    (tmp_path / "parts.xacro").write_text(f"{HEAD}{OLD.format(name='part')}</robot>")
    path.write_text(f'{HEAD}<{tag} filename="parts.xacro"/><{call} at="end"/></robot>')
    found = expand_xacro(path, {}, {})
    assert 'name="link_end"' in found.urdf
    assert 'size="0.4 1 1"' in found.urdf
    (note,) = found.notes
    assert "<property>" in note
    assert "<macro>" in note


@needs_xacrodoc
def test_tags_of_other_formats_are_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "robot.xacro"
    inside = '<gazebo><plugin name="p"><property name="a" value="${b}"/></plugin></gazebo>'
    text = f'{HEAD}<xacro:property name="b" value="1"/><link name="a"/>{inside}</robot>'
    path.write_text(text)
    found = expand_xacro(path, {}, {})
    assert '<property name="a" value="1" />' in found.urdf
    assert found.notes == ()


SWITCH = {
    "argument": ('<xacro:arg name="arm" default="false"/>', "$(arg arm)", "--xacro-arg arm=false"),
    "variable": ("", "$(optenv TEST_HAS_ARM false)", "$TEST_HAS_ARM=false"),
    "empty": ("", "$(optenv TEST_HAS_ARM 0)", "$TEST_HAS_ARM=0"),
}


@needs_xacrodoc
@pytest.mark.parametrize("kind", SWITCH)
def test_a_robot_whose_arm_is_switched_off_names_the_switch(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    monkeypatch.delenv("TEST_HAS_ARM", raising=False)
    declared, condition, words = SWITCH[kind]
    body = mobile_manipulator().removeprefix('<robot name="test robot">').removesuffix("</robot>")
    path = tmp_path / "robot.urdf.xacro"
    path.write_text(
        f'{HEAD}{declared}<xacro:if value="{condition}">{body}</xacro:if>'
        f'<xacro:unless value="{condition}"><link name="only"/></xacro:unless></robot>'
    )
    with pytest.raises(MomaposError) as caught:
        write_robot(path)
    assert words in str(caught.value)
    assert str(caught.value).startswith(f"{path}: ")
    monkeypatch.setenv("TEST_HAS_ARM", "true")
    _, derived = write_robot(path, args={"arm": "true"} if declared else {})
    assert words not in " ".join(derived.assumptions)


def test_a_missing_xacrodoc_is_reported_with_its_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "xacrodoc", None)
    path = tmp_path / "robot.xacro"
    path.write_text(HEAD + "</robot>")
    with pytest.raises(MomaposError, match=r"pip install xacrodoc"):
        write_robot(RobotSource(path))


EVIL = {
    "a lambda": "${(lambda: 1)()}",
    "a class": "${().__class__.__base__.__subclasses__()}",
    "a frame": "${(i for i in [1]).gi_frame}",
    "a format": "${'{0.__class__}'.format(1)}",
    "eval": "$(eval [c for c in ().__class__.__base__.__subclasses__()])",
    "eval without underscores": "$(eval (lambda: 1)())",
    "a file outside": "${load_yaml('/etc/hostname')}",
    "a file above": "${load_yaml('../../../../../../etc/hostname')}",
    "a file through a link": "${load_yaml('link.yaml')}",
    "a device": "${load_yaml('/dev/zero')}",
    "a fifo": "${load_yaml('fifo.yaml')}",
    "a package above": "$(find ..)",
    "a folder that is no package": "$(find etc)/x",
    "yaml objects": "${load_yaml('tag.yaml')}",
    "yaml aliases": "${load_yaml('bomb.yaml')}",
    "units of yaml": "${load_yaml('units.yaml')}",
    "a secret": "$(env TEST_API_KEY)",
}
"""Expressions that no file needs."""


@needs_xacrodoc
@pytest.mark.parametrize("kind", EVIL)
def test_no_file_runs_code_or_reads_what_is_not_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    monkeypatch.setenv("TEST_API_KEY", "secret")
    trap = tmp_path / "EXECUTED"
    (tmp_path / "link.yaml").symlink_to("/etc/hostname")
    (tmp_path / "tag.yaml").write_text(f"!!python/object/apply:os.system ['touch {trap}']")
    (tmp_path / "units.yaml").write_text('a: !degrees "(lambda: 1)()"')
    rows = "\n".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 12))
    (tmp_path / "bomb.yaml").write_text(f"a0: &a0 [x]\n{rows}")
    os.mkfifo(tmp_path / "fifo.yaml")
    path = tmp_path / "robot.xacro"
    path.write_text(f'{HEAD}<link name="{escape(EVIL[kind], {chr(34): "&quot;"})}"/></robot>')
    with pytest.raises(RobotError) as caught:
        expand_xacro(path, {}, {})
    assert "\n" not in str(caught.value)
    assert not trap.exists()


@needs_xacrodoc
@pytest.mark.parametrize("name", ["/etc/hostname", "../" * 9 + "etc/hostname", "/etc/*", "link"])
@pytest.mark.parametrize("optional", ["", ' optional="true"'])
def test_no_file_outside_the_folders_of_a_robot_is_included(
    tmp_path: Path, name: str, optional: str
) -> None:
    (tmp_path / "link").symlink_to("/etc/hostname")
    path = tmp_path / "robot.xacro"
    path.write_text(f'{HEAD}<xacro:include filename="{name}"{optional}/><link name="a"/></robot>')
    with pytest.raises(RobotError, match="outside"):
        expand_xacro(path, {}, {})


@needs_xacrodoc
def test_no_document_has_entities(tmp_path: Path) -> None:
    path = tmp_path / "robot.xacro"
    path.write_text(f'<!DOCTYPE r [<!ENTITY a "b">]>{HEAD}<link name="&a;"/></robot>')
    with pytest.raises(RobotError, match="cannot be expanded"):
        expand_xacro(path, {}, {})


@needs_xacrodoc
def test_macros_do_not_multiply_without_end(tmp_path: Path) -> None:
    macros = "".join(
        f'<xacro:macro name="m{i}" params="">{f"<xacro:m{i - 1}/>" * 20}</xacro:macro>'
        for i in range(1, 9)
    )
    path = tmp_path / "robot.xacro"
    path.write_text(f'{HEAD}<xacro:macro name="m0" params=""/>{macros}<xacro:m8/></robot>')
    with pytest.raises(RobotError, match="more than"):
        expand_xacro(path, {}, {})


@needs_xacrodoc
def test_files_of_a_workspace_are_read(tmp_path: Path) -> None:
    one, two = tmp_path / "ws" / "one" / "urdf", tmp_path / "ws" / "repository" / "config"
    for folder in (one, two):
        folder.mkdir(parents=True)
    (two.parent / "package.xml").write_text("<package><name>two</name></package>")
    (two / "a.yaml").write_text("size: {x: !degrees 180, name: arm}\nrows: [1, 2]")
    (one.parent / "c.xacro").write_text(f'{HEAD}<xacro:property name="c" value="7"/></robot>')
    path = one / "robot.xacro"
    path.write_text(
        f"{HEAD}<xacro:include filename=\"../c.xacro\"/><xacro:property name='a' "
        "value=\"${xacro.load_yaml('$(find two)/config/a.yaml')}\"/>"
        '<xacro:arg name="n" default="3"/><link name="${a.size.name}_${a[\'rows\'][1]}_${c}'
        '_$(eval n + 1)" x="${round(a.size.x, 3)}"/></robot>'
    )
    assert 'name="arm_2_7_4" x="3.142"' in expand_xacro(path, {}, {}).urdf


@needs_xacrodoc
def test_a_mesh_outside_the_folders_of_a_robot_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "robot.xacro"
    mesh = '<link name="a"><collision><geometry><mesh filename="{}"/></geometry></collision></link>'
    path.write_text(f"{HEAD}{mesh.format('file:///etc/hostname')}</robot>")
    with pytest.raises(RobotError, match="is outside"):
        expand_xacro(path, {}, {})
