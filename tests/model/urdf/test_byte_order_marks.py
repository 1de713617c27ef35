"""Files of other programs: byte-order marks, and messages of their readers."""

from __future__ import annotations

import json
import logging
import shutil
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from momapos.model.robots.robot import load_robot
from momapos.model.robots.robot_names import library_file
from momapos.model.scene.scene_files import load_scene
from momapos.model.urdf.meshes import mesh_points, mesh_triangles, parse_mesh

BOM = b"\xef\xbb\xbf"
OBJ = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\n"
FACET = """facet normal {}
outer loop
vertex 0 0 0
vertex 1 0 0
vertex 0 1 {}
endloop
endfacet
"""


def stl(*normals: str) -> bytes:
    facets = "".join(FACET.format(normal, k) for k, normal in enumerate(normals))
    return f"solid part\n{facets}endsolid part\n".encode()


def test_a_robot_whose_files_have_byte_order_marks_is_the_same_robot(tmp_path: Path) -> None:
    folder = tmp_path / "fetch"
    shutil.copytree(library_file("fetch").parent, folder)
    for file in folder.glob("fetch.*"):
        if file.suffix in (".toml", ".urdf", ".srdf"):
            file.write_bytes(BOM + file.read_bytes())
    marked, plain = load_robot(folder / "fetch.toml"), load_robot("fetch")
    assert marked.moved_joints == plain.moved_joints
    assert marked.disabled == plain.disabled
    np.testing.assert_array_equal(marked.home, plain.home)


def test_a_scene_with_a_byte_order_mark_is_read(tmp_path: Path) -> None:
    content = {"format": "momapos-scene", "version": 1, "name": "room", "objects": []}
    (tmp_path / "room.json").write_bytes(BOM + json.dumps(content).encode())
    assert load_scene(tmp_path / "room.json").name == "room"


def test_a_mesh_with_a_byte_order_mark_keeps_its_first_vertex(tmp_path: Path) -> None:
    for name, mark in (("plain.obj", b""), ("marked.obj", BOM)):
        (tmp_path / name).write_bytes(mark + OBJ)
    plain, marked = tmp_path / "plain.obj", tmp_path / "marked.obj"
    np.testing.assert_array_equal(mesh_points(marked), mesh_points(plain))
    np.testing.assert_array_equal(mesh_triangles(marked), mesh_triangles(plain))


@pytest.mark.parametrize("normals", [("0 0", "0 0 1"), ("a b c", "0 0 1"), ("", "0 0 1")])
def test_an_stl_with_broken_normals_is_read_without_a_message(
    tmp_path: Path, normals: tuple[str, ...], caplog: pytest.LogCaptureFixture,
    capfd: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    file = tmp_path / "part.stl"
    file.write_bytes(stl(*normals))
    assert len(mesh_points(file)) >= 4
    assert caplog.records == []
    assert capfd.readouterr() == ("", "")


def test_other_programs_still_see_messages_of_the_mesh_reader(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    def read(k: int) -> None:
        parse_mesh(tmp_path / f"{k}.stl", stl("x y z", "0 0 1"))

    filters = list(warnings.filters)
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(read, range(16)))
    assert caplog.records == []
    assert warnings.filters == filters
    logging.getLogger("trimesh").warning("mine")
    logging.getLogger("trimesh.util").warning("mine, too")
    assert [record.message for record in caplog.records] == ["mine", "mine, too"]
