"""Laws of Infinigen assets: a URDF in meters whose one flap opens toward the front."""

from __future__ import annotations

import importlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image
from trimesh.visual import TextureVisuals
from trimesh.visual.material import SimpleMaterial

from momapos.apps.synthetic_scans.surfaces import patches
from momapos.core.geometry.transforms import apply
from momapos.model.scene.scene_object import SceneObject
from momapos.model.urdf.articulated import Articulated
from momapos.model.urdf.reader import Urdf, read_urdf

REPOSITORY = Path(__file__).parents[2]
UNIT = 2.0
"""Scale of the asset relative to a dishwasher [-]."""
LINKS = {
    "link_0": [("dishwasher_body_0", (0.6, 0.6, 0.85), (0.3, 0.0, 0.425))],
    "link_1": [
        ("rotation_door_0", (0.03, 0.6, 0.8), (0.015, 0.0, 0.425)),
        ("handle_0", (0.03, 0.4, 0.02), (0.045, 0.0, 0.75)),
    ],
    "link_2": [("knob_0", (0.02, 0.03, 0.03), (0.0, 0.0, 0.0))],
    "link_3": [("shelf_0", (0.5, 0.5, 0.02), (0.0, 0.0, 0.0))],
}
"""Meshes of the links: name, size, center, in the link's frame; the front is toward +x."""
JOINTS = {
    "link_1": ("link_0", "revolute", (0.6, 0.0, 0.0), (0.0, 1.0, 0.0)),
    "link_2": ("link_1", "revolute", (0.04, 0.2, 0.8), (1.0, 0.0, 0.0)),
    "link_3": ("link_0", "prismatic", (0.3, 0.0, 0.4), (1.0, 0.0, 0.0)),
}


def write_asset(folder: Path) -> Path:
    """Write a dishwasher like Infinigen: a red door; a knob and a rack also move."""
    home = folder / "dishwasher" / "3"
    (home / "assets").mkdir(parents=True)
    lines = ['<robot name="object"><link name="world"/>']
    lines.append('<joint name="world_joint" type="fixed"><origin xyz="0 0 0"/>')
    lines.append('<parent link="world"/><child link="link_0"/></joint>')
    for name, meshes in LINKS.items():
        lines.append(f'<link name="{name}">')
        for mesh, size, center in meshes:
            box = trimesh.creation.box(UNIT * np.array(size))
            paint = (200, 0, 0) if "door" in mesh else (100, 100, 100)
            material = SimpleMaterial(Image.new("RGB", (4, 4), paint), name=mesh)
            box.visual = TextureVisuals(np.full((8, 2), 0.5), material)
            text, files = trimesh.exchange.obj.export_obj(
                box, return_texture=True, mtl_name=f"{mesh}.mtl"
            )
            (home / "assets" / f"{mesh}.obj").write_text(text)
            for file, data in files.items():
                (home / "assets" / file).write_bytes(data)
            at = " ".join(str(UNIT * v) for v in center)
            lines.append(f'<visual><geometry><mesh filename="assets/{mesh}.obj"/></geometry>')
            lines.append(f'<origin xyz="{at}"/></visual>')
        lines.append("</link>")
    for child, (parent, kind, at, axis) in JOINTS.items():
        place = " ".join(str(UNIT * v) for v in at)
        lines.append(f'<joint name="of_{child}" type="{kind}"><origin xyz="{place}"/>')
        lines.append(f'<parent link="{parent}"/><child link="{child}"/>')
        lines.append(f'<axis xyz="{axis[0]} {axis[1]} {axis[2]}"/>')
        lines.append('<limit lower="0" upper="1.5"/></joint>')
    (home / "dishwasher.urdf").write_text("".join(lines) + "</robot>")
    return folder


@pytest.fixture
def benchmark_module(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Import the benchmark, which imports its neighbors as a script does."""
    monkeypatch.syspath_prepend(str(REPOSITORY / "benchmarks"))
    return importlib.import_module("infinigen_objects")


@pytest.fixture
def urdf(benchmark_module: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Urdf:
    """Return the URDF that the benchmark writes for the asset."""
    out = tmp_path / "out"
    folder = write_asset(tmp_path / "drawn")
    monkeypatch.setattr("sys.argv", ["infinigen_objects.py", str(folder), "--out", str(out)])
    benchmark_module.main()
    (row,) = json.loads((out / "models.json").read_text())
    assert row["name"] == "Infinigen/dishwasher/3"
    return read_urdf(out / row["urdf"])


def test_only_the_door_moves_and_it_opens_downward_in_front(urdf: Urdf) -> None:
    item = SceneObject("it", "", np.eye(4), Articulated(urdf))
    (joint,) = item.model.joints.values()
    low, high = item.bounds
    np.testing.assert_allclose(high[2] - low[2], 0.85, atol=1e-3)
    np.testing.assert_allclose(low[1], -0.66, atol=1e-3)  # the handle, toward -y
    poses = item.model.link_poses({joint.name: np.pi / 2})
    (tip,) = apply(poses[joint.child], np.array([[0.0, 0.0, 0.8]]))
    np.testing.assert_allclose(tip, [0.0, -1.4, 0.0], atol=1e-3)


def test_each_triangle_has_the_color_of_its_texture(urdf: Urdf) -> None:
    child = next(joint.child for joint in urdf.joints if joint.kind == "revolute")
    door = patches(urdf.links[child].visuals[0], None)
    assert len(door) == 1
    np.testing.assert_allclose(door[0].paint, (200 / 255, 0.0, 0.0), atol=0.03)


def test_a_folder_without_assets_is_a_one_line_error(
    benchmark_module: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.argv", ["infinigen_objects.py", str(tmp_path), "--out", "out"])
    with pytest.raises(SystemExit, match="no assets of Infinigen"):
        benchmark_module.main()
