"""URDFs are read as URDFormer's own code writes them, for one object and in a whole kitchen.

The writer here follows `object_prediction` and `kitchen_prediction` (demo.py) and
`visualization_parts` and `write_urdfs` (utils.py) of the authors' repository: positions are on a
grid of 13 marks over the base, sizes are four times the extent less a gap, handles lie on the grid
of their part, and parts of an object at the right wall are not scaled by the width of its base.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from tests.furnished import Camera, cloud_of, look_at, photograph

from momapos.core.geometry.polygons import UprightBox
from momapos.model.records.scans import Detection, Front
from momapos.model.scene.library import Piece
from momapos.perception.modeling import decide
from momapos.perception.reconstruction.scene_builder import GivenModel
from momapos.perception.reconstruction.urdformer_files import is_predicted_urdf, read_predicted_urdf
from momapos.perception.records import PartSource, ScanConfig, Survey, Tools
from momapos.perception.segmentation.room_shell import RoomShell

PARTS = [("drawer", (0, 9), (12, 12)), ("doorL", (0, 0), (6, 9)), ("doorR", (12, 0), (6, 9))]
"""Class, and marks of start and end; a right door starts at its hinge."""
HANDLES = [("handle", 1, (6, 6)), ("knob", 2, (10, 6)), ("handle", 3, (10, 4))]
"""Class, number of its part from 1, and marks on it."""
BOXES = [(0.0, 0.0, 1.0, 0.25), (0.0, 0.25, 0.5, 1.0), (0.5, 0.25, 1.0, 1.0)]
CENTERS = [(0.5, 0.125), (5 / 12, 0.625), (1 - 5 / 12, 1 - 0.25)]
"""The same parts and their handles as fractions of the front, from its upper left corner."""
GAPS = {"drawer": 0.02, "doorL": 0.01, "doorR": 0.01}
SINGLE, FRONT, LEFT, RIGHT = "single", "front", "left", "right"


def write_urdfs(path: Path, where: str, base: tuple[float, float]) -> Path:
    """Write the parts on a base of this width and height."""
    width, height = base
    sized = 1.0 if where == RIGHT else width
    yaw = {LEFT: math.pi / 2, RIGHT: -math.pi / 2}.get(where, 0.0)
    scales = [np.abs(np.subtract(end, start)) * 4 / 12 * (sized, height) for _, start, end in PARTS]
    rows = [_link("base_link", "../meshes/cabinet.obj", (1, width, height), (0, 0, yaw))]
    for k, (name, start, _) in enumerate(PARTS):
        across, up = np.array(start) / 12 * (width, height)
        rows.append(_link(f"{name}{k}", f"../meshes/parts/{name}.obj",
                          (1, *(scales[k] - GAPS[name]))))  # fmt: skip
        rows.append(_joint(f"{name}{k}", "base_link", (0, across, up), 0.0))
    for k, (name, owner, marks) in enumerate(HANDLES, start=len(PARTS)):
        kind = PARTS[owner - 1][0]
        across, up = 0.25 * scales[owner - 1] * np.array(marks) / 12
        rows.append(_link(f"{name}{k}", f"../meshes/parts/{name}.obj", (1, 1, 1)))
        rows.append(_joint(f"{name}{k}", f"{kind}{owner - 1}",
                           (0, -across if kind == "doorR" else across, up),
                           math.pi / 2 if kind == "drawer" else 0.0))  # fmt: skip
    path.write_text(f"<?xml version='1.0'?>\n<robot name='my_urdf'>{''.join(rows)}</robot>")
    return path


def _link(name: str, mesh: str, scale: object, rpy: object = (0, 0, 0)) -> str:
    shape = f'<geometry><mesh filename="{mesh}" scale="{_text(scale)}" /></geometry>'
    origin = f'<origin xyz="0 0 0" rpy="{_text(rpy)}" />'
    body = "".join(f"<{kind}>{origin}{shape}</{kind}>" for kind in ("visual", "collision"))
    return f'<link name="{name}">{body}</link>'


def _joint(child: str, parent: str, xyz: object, roll: float) -> str:
    kind = "prismatic" if child.startswith("drawer") else "revolute"
    return (
        f'<joint name="{child}_to_{parent}" type="{kind}"><origin xyz="{_text(xyz)}" '
        f'rpy="{roll} 0.0 0.0" /><parent link="{parent}" /><child link="{child}" /></joint>'
    )


def _text(values: object) -> str:
    return " ".join(str(float(v)) for v in np.atleast_1d(np.asarray(values)))


@pytest.mark.parametrize(
    ("where", "base"),
    [(SINGLE, (1, 1)), (SINGLE, (1, 2)), (FRONT, (0.76, 1.3)), (LEFT, (1.9, 0.9)),
     (RIGHT, (0.57, 1.1)), (RIGHT, (1.71, 0.8))],
)  # fmt: skip
def test_parts_and_handles_have_the_places_that_were_predicted(
    tmp_path: Path, where: str, base: tuple[float, float]
) -> None:
    path = write_urdfs(tmp_path / "image_0.urdf", where, base)
    assert is_predicted_urdf(path)
    parts = read_predicted_urdf(path)
    assert [part.kind for part in parts] == ["drawer", "door_left", "door_right"]
    np.testing.assert_allclose([part.box for part in parts], BOXES, atol=1e-9)
    centers = [np.add(part.handle[:2], part.handle[2:]) / 2 for part in parts if part.handle]
    np.testing.assert_allclose(centers, CENTERS, atol=1e-9)


def test_other_models_are_not_taken_for_urdformers(tmp_path: Path) -> None:
    path = write_urdfs(tmp_path / "a.urdf", SINGLE, (1, 1))
    mine = path.read_text().replace("../meshes/parts/drawer.obj", "meshes/drawer.obj")
    (tmp_path / "b.urdf").write_text(mine)
    (tmp_path / "c.urdf").write_text("<robot name='r'><link name='a'/></robot>")
    (tmp_path / "d.urdf").write_text("<robot name='r'/>")
    assert not any(is_predicted_urdf(tmp_path / f"{name}.urdf") for name in "bcd")


def test_an_object_gets_the_parts_of_its_urdformer_file(tmp_path: Path) -> None:
    box = ((-0.4, 0.0, 0.0), (0.4, 0.6, 0.9))
    rng = np.random.default_rng(0)
    cloud = cloud_of([box], rng)
    T = look_at((0.0, -1.6, 0.8), (0.0, 0.0, 0.45))
    frame = photograph([box], T, Camera(320, 240, 260.0))
    around = UprightBox(np.array([0, 0.3, 0.45]), np.array([0.8, 0.6, 0.9]))
    item = Detection("cabinet_1", "cabinet", 0.9, around, np.arange(len(cloud.points)))
    seen = Survey(cloud, (frame,), np.eye(4), RoomShell(), (item,), (), (), None, {})
    tools = Tools(lambda _: [], lambda *_: Front(0.9, ()), lambda *_: Front(0.9, ()))
    given = {"cabinet_1": GivenModel(write_urdfs(tmp_path / "a.urdf", FRONT, (0.76, 1.3)))}
    decision = decide(item, None, seen, tools, given, ScanConfig())
    assert decision.source is PartSource.GIVEN
    assert [part.kind for part in decision.parts] == ["drawer", "door_left", "door_right"]
    assert isinstance(decision.model, Piece)
