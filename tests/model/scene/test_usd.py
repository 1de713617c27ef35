"""Rooms in USD: joints move as in the equivalent URDF, and dropped elements are counted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests import optional
from tests.commands import output_of
from tests.model.scene.cabinet import assert_moves_alike, assert_refused, expected

from momapos.core.errors import FileFormatError, MissingExtraError
from momapos.model.scene.formats.importing import write_room
from momapos.model.scene.formats.kinds import kind_of_file
from momapos.model.scene.formats.usd import read_room
from momapos.model.scene.scene import Scene

# The same cabinet in centimeters with y up, its door drawn at 30 degrees.
STAGE = """#usda 1.0
(defaultPrim = "World"
 metersPerUnit = 0.01
 upAxis = "Y")
def Xform "World" {
  def PhysicsScene "physics" {}
  def Plane "ground" (prepend apiSchemas = ["PhysicsCollisionAPI"]) {}
  def Xform "cabinet" {
    double3 xformOp:translate = (100, 40, -200)
    float3 xformOp:rotateXYZ = (-90, 0, 0)
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ"]
    def Xform "body" (prepend apiSchemas = ["PhysicsRigidBodyAPI"]) {
      def Cube "shell" (prepend apiSchemas = ["PhysicsCollisionAPI"]) {
        double size = 1
        float3 xformOp:scale = (40, 60, 80)
        uniform token[] xformOpOrder = ["xformOp:scale"]
      }
      def Sphere "knob" {
        double radius = 3
      }
    }
    def Xform "door" (prepend apiSchemas = ["PhysicsRigidBodyAPI"]) {
      double3 xformOp:translate = (21, -30, 20)
      float3 xformOp:rotateXYZ = (0, 0, 30)
      uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ"]
      def Mesh "door_handle" (prepend apiSchemas = ["PhysicsCollisionAPI"]) {
        point3f[] points = [(-1,0,-15),(1,0,-15),(1,60,-15),(-1,60,-15),
          (-1,0,15),(1,0,15),(1,60,15),(-1,60,15)]
        int[] faceVertexCounts = [4,4,4,4,4,4]
        int[] faceVertexIndices = [0,3,2,1, 4,5,6,7, 0,1,5,4, 2,3,7,6, 1,2,6,5, 0,4,7,3]
      }
    }
    def Xform "drawer" (prepend apiSchemas = ["PhysicsRigidBodyAPI"]) {
      double3 xformOp:translate = (21, 0, -20)
      uniform token[] xformOpOrder = ["xformOp:translate"]
      def Cube "front" (prepend apiSchemas = ["PhysicsCollisionAPI"]) {
        double size = 2
        float3 xformOp:scale = (1, 30, 15)
        uniform token[] xformOpOrder = ["xformOp:scale"]
      }
      def Cylinder "bar" (prepend apiSchemas = ["PhysicsCollisionAPI"]) {
        uniform token axis = "Y"
        double radius = 1
        double height = 20
        double3 xformOp:translate = (3, 0, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
      }
    }
    def PhysicsRevoluteJoint "hinge" {
      uniform token physics:axis = "Z"
      rel physics:body0 = </World/cabinet/body>
      rel physics:body1 = </World/cabinet/door>
      point3f physics:localPos0 = (21, -30, 20)
      float physics:lowerLimit = -10
      float physics:upperLimit = 90
      }
    def PhysicsPrismaticJoint "slide" {
      uniform token physics:axis = "X"
      rel physics:body0 = </World/cabinet/body>
      rel physics:body1 = </World/cabinet/drawer>
      point3f physics:localPos0 = (21, 0, -20)
      float physics:lowerLimit = 0
      float physics:upperLimit = 40
      }
  }
  def "cup" (references = @./cup.usda@</cup>) {}
}
"""
CUP = """#usda 1.0
def Xform "cup" {
  double3 xformOp:translate = (0, 50, 0)
  uniform token[] xformOpOrder = ["xformOp:translate"]
  def Capsule "c" (prepend apiSchemas = ["PhysicsCollisionAPI"]) {
    double radius = 2
    double height = 10
    uniform token axis = "X"
      }
  def PhysicsSphericalJoint "ball" {
    rel physics:body1 = </cup>
      }
}
"""


@pytest.fixture(autouse=True)
def _usd() -> None:
    optional.module("pxr")


def write(folder: Path, text: str = STAGE) -> Path:
    (folder / "cup.usda").write_text(CUP)
    (folder / "room.usda").write_text(text)
    return folder / "room.usda"


def read(folder: Path, text: str = STAGE) -> Scene:
    path = write(folder, text)
    return write_room(read_room(path, folder), path, folder / "out.json")


def test_joints_move_parts_as_in_the_urdf_of_the_same_cabinet(tmp_path: Path) -> None:
    truth = expected(
        tmp_path, (1, 2, 0.4), bar=-np.pi / 2, turn=0.0, axis="0 0 1", lower=np.radians(-10),
        upper=np.pi / 2,
    )  # fmt: skip
    found = read(tmp_path).object("cabinet")
    assert found.values() == {"hinge": pytest.approx(np.deg2rad(30)), "slide": 0.0}
    assert_moves_alike(found, truth, ((0.0, 0.0), (-0.1, 0.1), (1.5, 0.4)))


def test_referenced_layers_are_included(tmp_path: Path) -> None:
    low, high = read(tmp_path).object("cup").bounds
    assert_allclose(high - low, [0.14, 0.04, 0.04], atol=1e-3)
    assert_allclose((low + high) / 2, [0, 0, 0.5], atol=1e-6)


def test_dropped_elements_are_counted(tmp_path: Path) -> None:
    report = read_room(write(tmp_path), tmp_path).final_report()
    assert report.kept["objects"] == 2
    assert report.kept["visual shapes"] == 1
    assert report.dropped["planes"] == 1


def test_drives_and_materials_are_counted(tmp_path: Path) -> None:
    from pxr import Usd, UsdPhysics

    path = write(tmp_path)
    stage = Usd.Stage.Open(str(path))
    hinge = next(prim for prim in stage.Traverse() if prim.GetName() == "hinge")
    UsdPhysics.DriveAPI.Apply(hinge, "angular")
    stage.DefinePrim("/steel", "Material")
    stage.GetRootLayer().Save()
    report = read_room(path, tmp_path).final_report()
    assert report.dropped["drives"] == 1
    assert report.dropped["materials"] == 1


def test_the_command_converts_a_stage(tmp_path: Path) -> None:
    path = write(tmp_path)
    assert kind_of_file(path) == "USD"
    assert "1 hinges, 1 slides" in output_of(
        "scene", "convert", str(path), str(tmp_path / "out.json")
    )


ONE = '#usda 1.0\ndef {} "a" (prepend apiSchemas = ["PhysicsCollisionAPI"]) {{\n{}\n}}\n'
BAD = {
    "damaged": (STAGE[:300], "USD rejects it|is not a USD layer"),
    "a layer outside": (STAGE.replace("./cup.usda", "../secret.usda"), "leaves"),
    "a layer elsewhere": (STAGE.replace("./cup.usda", "https://x/y.usda"), "is not a file"),
    "a layer that is not there": (STAGE.replace("./cup.usda", "./gone.usda"), "does not exist"),
    "no unit": (STAGE.replace("metersPerUnit = 0.01", "metersPerUnit = 0"), "metersPerUnit is 0"),
    "no size": (ONE.format("Cube", "double size = -1"), "size must be > 0"),
    "a corner that is not there": (
        ONE.format("Mesh", "point3f[] points = [(0,0,0),(1,0,0),(0,1,0),(0,0,1)]\n"
                   "int[] faceVertexCounts = [3]\nint[] faceVertexIndices = [0,1,9]"),
        "names a vertex that does not exist",
    ),
    "limits the wrong way round": (STAGE.replace("Limit = -10", "Limit = 100"), "lower limit"),
    "nowhere": (STAGE.replace("(100, 40, -200)", "(nan, 40, -200)"), "transform must be finite"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_bad_files_are_refused_in_one_line_and_leave_nothing(tmp_path: Path, case: str) -> None:
    text, message = BAD[case]
    (tmp_path / "secret.usda").write_text(CUP)
    assert_refused(tmp_path, read, text, message)


@pytest.mark.parametrize(
    "place", ["#usda 1.0", "metersPerUnit", 'def "cup"', "physics:lowerLimit", "xformOp:translate"]
)
def test_bytes_that_are_no_utf8_are_refused_in_one_line(tmp_path: Path, place: str) -> None:
    path = write(tmp_path)
    assert place in STAGE
    path.write_bytes(STAGE.encode().replace(place.encode(), place.encode()[:-2] + b"\x81\xff"))
    with pytest.raises(FileFormatError) as refused:
        read_room(path, tmp_path)
    assert "\n" not in str(refused.value)
    assert str(path) in str(refused.value)


def test_a_value_of_a_wrong_type_is_refused_in_one_line(tmp_path: Path) -> None:
    path = write(tmp_path, STAGE.replace("metersPerUnit = 0.01", 'metersPerUnit = "wide"'))
    with pytest.raises(FileFormatError):
        read_room(path, tmp_path)


def test_a_missing_package_is_reported_with_its_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write(tmp_path)
    monkeypatch.setitem(__import__("sys").modules, "pxr", None)
    with pytest.raises(MissingExtraError, match="pip install usd-core"):
        read_room(path, tmp_path)


def test_links_have_the_mass_of_the_stage_at_its_center(tmp_path: Path) -> None:
    """The stage is in centimeters and grams."""
    from pxr import Usd, UsdPhysics

    path = write(tmp_path)
    stage = Usd.Stage.Open(str(path))
    UsdPhysics.SetStageKilogramsPerUnit(stage, 1e-3)
    drawer = stage.GetPrimAtPath("/World/cabinet/drawer")
    stated = UsdPhysics.MassAPI.Apply(drawer)
    stated.CreateMassAttr(2500.0)
    stated.CreateCenterOfMassAttr((0.0, 10.0, 0.0))
    stage.GetRootLayer().Save()
    item = write_room(read_room(path, tmp_path), path, tmp_path / "out.json").object("cabinet")
    link = item.model.urdf.links["drawer"]
    assert link.mass == pytest.approx(2.5)
    assert_allclose(link.center, (0, 0.1, 0), atol=1e-9)
    assert item.model.urdf.links["door"].mass == 0.0


@pytest.mark.parametrize("shown", [True, False])
def test_what_is_drawn_far_out_of_the_colliders_collides(tmp_path: Path, shown: bool) -> None:
    sphere = "double radius = 3"
    words = sphere.replace("3", "55") + (
        "" if shown else '\n        uniform token purpose = "guide"'
    )
    top = read(tmp_path, STAGE.replace(sphere, words)).object("cabinet").bounds[1, 2]
    assert top == pytest.approx(0.95 if shown else 0.8, abs=0.02)
