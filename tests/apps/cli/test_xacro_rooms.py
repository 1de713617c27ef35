"""Conversion of furniture in xacro files."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import pytest
import trimesh
from tests import optional
from tests.commands import error_of

from momapos.apps.cli.main import main
from momapos.model.scene.scene_files import load_scene

needs_xacrodoc = optional.needs("xacrodoc", find_spec("xacrodoc") is not None)
CABINET = """<robot name="cab" xmlns:xacro="http://www.ros.org/wiki/xacro">
<xacro:property name="width" value="0.6"/>
<link name="body"><collision><origin xyz="0.2 0 0.4"/>
  <geometry><mesh filename="package://furniture/meshes/body.stl"/></geometry></collision></link>
<link name="door"><collision><origin xyz="0 ${width / 2} 0.4"/>
  <geometry><box size="0.02 ${width} 0.78"/></geometry></collision></link>
<joint name="hinge" type="revolute"><parent link="body"/><child link="door"/>
  <origin xyz="-0.015 ${-width / 2} 0"/><axis xyz="0 0 1"/>
  <limit lower="0" upper="1.6" effort="1" velocity="1"/></joint></robot>"""


@pytest.fixture
def cabinet(tmp_path: Path) -> Path:
    """A cabinet in a ROS package."""
    package = tmp_path / "furniture"
    for name in ("urdf", "meshes"):
        (package / name).mkdir(parents=True)
    (package / "package.xml").write_text("<package><name>furniture</name></package>")
    trimesh.creation.box((0.4, 0.6, 0.8)).export(package / "meshes" / "body.stl")
    path = package / "urdf" / "cab.urdf.xacro"
    path.write_text(CABINET)
    return path


@needs_xacrodoc
def test_a_xacro_file_becomes_a_scene_with_its_meshes(cabinet: Path, tmp_path: Path) -> None:
    out = tmp_path / "mine" / "room.json"
    out.parent.mkdir()
    assert main(["scene", "convert", str(cabinet), str(out)]) == 0
    item = load_scene(out).object("cab")
    assert item.model.joint("hinge").upper == pytest.approx(1.6)
    low, high = item.bounds
    assert high[1] - low[1] == pytest.approx(0.6)
    assert [path.name for path in cabinet.parent.iterdir()] == [cabinet.name]


@needs_xacrodoc
def test_a_xacro_file_that_cannot_be_expanded_is_reported_in_one_line(
    cabinet: Path, tmp_path: Path
) -> None:
    cabinet.write_text(CABINET.replace("width / 2}", "height / 2}", 1))
    out = tmp_path / "room.json"
    assert "height" in error_of("scene", "convert", str(cabinet), str(out))
    assert not out.exists()
    assert [path.name for path in cabinet.parent.iterdir()] == [cabinet.name]
