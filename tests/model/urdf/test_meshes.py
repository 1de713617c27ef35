"""Untrusted mesh files are read correctly, or rejected quickly if damaged or malicious."""

from __future__ import annotations

import json
import os
import struct
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from momapos.core.errors import UrdfError
from momapos.model.urdf.hulls import hull_of
from momapos.model.urdf.meshes import MAX_MESH_BYTES, mesh_points, mesh_triangles, surface_vertices
from momapos.model.urdf.urdf_records import Geometry

TRIANGLE = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)


def glb(**changes: Any) -> bytes:
    head: dict[str, Any] = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "buffers": [{"byteLength": 36}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        **changes,
    }
    text = json.dumps(head).encode()
    text += b" " * (-len(text) % 4)
    data = TRIANGLE.tobytes()
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    chunks += struct.pack("<I4s", len(data), b"BIN\0") + data
    return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks


def collada(nodes: str, scene: str) -> str:
    numbers = " ".join(f"{v:g}" for v in TRIANGLE.ravel())
    return f"""<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit meter="1"/></asset>
<library_geometries><geometry id="g"><mesh>
<source id="s"><float_array id="a" count="9">{numbers}</float_array><technique_common>
<accessor source="#a" count="3" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#s"/></vertices>
<triangles count="1"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2</p></triangles>
</mesh></geometry></library_geometries>
<library_nodes>{nodes}</library_nodes>
<library_visual_scenes><visual_scene id="vs">{scene}</visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#vs"/></scene></COLLADA>"""


SHAPE = '<instance_geometry url="#g"/>'
DOUBLING = "".join(
    f'<node id="n{i}">' + f'<instance_node url="#n{i + 1}"/>' * 2 + "</node>" for i in range(40)
)
MANY = [{"mesh": 0} for _ in range(1_000_000)]
CHAIN = [*({"children": [i + 1]} for i in range(100_000)), {"mesh": 0}]
HUGE = [{"componentType": 5126, "count": 10**11, "type": "VEC3"}]
ACCESSOR = {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.glb", glb()),
        ("a.glb", glb(buffers=[{"byteLength": 36, "uri": "pipe"}])),
        ("a.glb", glb(images=[{"uri": "pipe"}], textures=[{"source": 0}],
                      materials=[{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}])),
        ("a.dae", collada("", f'<node id="n">{SHAPE}</node>').encode()),
        ("a.dae", collada(f'<node id="m">{SHAPE}</node>',
                          '<node id="n"><instance_node url="#m"/></node>').encode()),
        ("a.obj", b"mtllib pipe\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
    ],
)  # fmt: skip
def test_reading_a_mesh_opens_no_other_file(tmp_path: Path, name: str, content: bytes) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / name).write_bytes(content)
    np.testing.assert_allclose(np.unique(mesh_points(tmp_path / name), axis=0),
                               np.unique(TRIANGLE, axis=0))  # fmt: skip


BAD: dict[str, tuple[str, bytes, str]] = {
    "a million nodes": ("a.glb", glb(nodes=MANY), "1000 parts"),
    "a deep chain": ("a.glb", glb(nodes=CHAIN), "1000 parts"),
    "counts without data": ("a.glb", glb(accessors=HUGE), "10000000 points"),
    "a negative count": ("a.glb", glb(accessors=[{**ACCESSOR, "count": -1}]), "count"),
    "no primitives": ("a.glb", glb(meshes=[{}]), "missing"),
    "a list for a table": ("a.glb", glb(nodes=[[1]]), "GLB"),
    "a mesh that is not there": ("a.glb", glb(nodes=[{"mesh": 7}]), "GLB"),
    "a deep header": ("a.glb", glb(extras=0).replace(b'"extras": 0', b'"extras":[' * 1), "GLB"),
    "no GLB": ("a.glb", b"hello", "GLB"),
    "doubling nodes": (
        "a.dae", collada(DOUBLING + f'<node id="n40">{SHAPE}</node>',
                         '<node id="n"><instance_node url="#n0"/></node>').encode(), "1000 parts"),
    "a node in itself": (
        "a.dae", collada('<node id="m"><instance_node url="#m"/></node>',
                         '<node id="n"><instance_node url="#m"/></node>').encode(), "contain them"),
    "deep nodes": ("a.dae", collada("", "<node>" * 5000 + "</node>" * 5000).encode(), "deeper"),
    "an entity": ("a.dae", b'<!DOCTYPE a [<!ENTITY e "x">]><COLLADA>&e;</COLLADA>', "entities"),
    "a zip": ("a.dae", b"PK\x03\x04", "DAE"),
    "no COLLADA": ("a.dae", b"<a/>", "mesh"),
    "ASCII that stops": ("a.stl", b"solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0", "mesh"),
    "ASCII with words": (
        "a.stl", b"solid a\nfacet normal 0 0 1\nouter loop\nvertex a b c\nvertex 0 0 0\n"
        b"vertex 1 0 0\nendloop\nendfacet\nendsolid a\n", "mesh"),
    "ASCII with half a vertex": (
        "a.stl", b"solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 1\nvertex 0 0 0\n"
        b"vertex 1 0 0\nendloop\nendfacet\nendsolid a\n", "mesh"),
    "more triangles than data": ("a.stl", b" " * 80 + struct.pack("<I", 10**9), "mesh"),
    "more points than data": (
        "a.ply", b"ply\nformat binary_little_endian 1.0\nelement vertex 1000000000\n"
        b"property float x\nproperty float y\nproperty float z\nend_header\n", "mesh"),
    "no coordinates": (
        "a.ply", b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n",
        "mesh"),
    "a face without points": ("a.off", b"OFF\n0 1 0\n3 0 1 2\n", "mesh"),
    "words in OFF": ("a.off", b"OFF\na b c\n", "mesh"),
}  # fmt: skip


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("case", BAD)
def test_a_malicious_mesh_is_rejected_quickly_without_output(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], case: str
) -> None:
    name, content, word = BAD[case]
    os.mkfifo(tmp_path / "pipe")
    path = tmp_path / name
    path.write_bytes(content)
    began = time.process_time()
    with pytest.raises(UrdfError) as caught:
        mesh_points(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert word in message
    for noise in ("NoneType", "object has no", "unhashable", "subscriptable"):
        assert noise not in message
    assert time.process_time() - began < 10, "hangs"
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("kind", ["fifo", "folder", "sparse", "gone"])
def test_other_files_are_rejected_without_opening_them(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "a.stl"
    if kind == "fifo":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    elif kind == "sparse":
        with path.open("wb") as file:
            file.truncate(MAX_MESH_BYTES + 1)
    with pytest.raises(UrdfError, match=r"a\.stl"):
        mesh_points(path)


def test_the_triangles_of_an_obj_file_agree_with_trimesh(tmp_path: Path) -> None:
    import trimesh

    file = tmp_path / "mesh.obj"
    file.write_text(
        "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1/1/1 2//2 3/3 4\n"
        "v 0 0 1\nv 1 0 1\nf -2 -1 1\nf 5 6 2\n"
    )
    known = trimesh.load(file, force="mesh", process=False).triangles
    mine = mesh_triangles(file)
    assert mine.shape == (4, 3, 3)

    def keys(triangles: np.ndarray) -> set[tuple[float, ...]]:
        return {tuple(np.sort(t.reshape(3, 3) @ [1.0, 3.0, 9.0]).tolist()) for t in triangles}

    assert keys(mine[2:]) == keys(known[2:])
    area = np.linalg.norm(np.cross(mine[:, 1] - mine[:, 0], mine[:, 2] - mine[:, 0]), axis=1)
    assert area.sum() / 2 == pytest.approx(trimesh.triangles.area(known).sum())


CORNERS = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"


@pytest.mark.parametrize(
    "faces", ["f 1 2 3\nf 1/7 2/7/7 4//7\n", "f -4 -3 -2\nf -4 -3 -1\n", "f 1 2 3 4\nf 1 2 99\n"]
)
def test_vertices_that_no_face_uses_are_not_part_of_the_shape(tmp_path: Path, faces: str) -> None:
    file = tmp_path / "part.obj"
    file.write_text(CORNERS + faces + "v 9 9 9\n")
    assert mesh_points(file).max() == 9.0
    np.testing.assert_array_equal(surface_vertices(file), mesh_points(file)[:4])
    hull = hull_of(Geometry("mesh", (1.0, 1.0, 1.0), np.eye(4), mesh=file))
    assert hull.vertices.max() == 1.0


@pytest.mark.parametrize("face", ["f 1 2 x", f"f 1 2 {10**30}", f"f 1 2 {'9' * 5000}"])
def test_damaged_faces_are_refused_where_triangles_count_only(tmp_path: Path, face: str) -> None:
    file = tmp_path / "part.obj"
    file.write_text(CORNERS + face + "\n")
    np.testing.assert_array_equal(surface_vertices(file), mesh_points(file))
    with pytest.raises(UrdfError, match="not a usable OBJ mesh"):
        mesh_triangles(file)


def test_a_mesh_without_faces_is_all_its_vertices(tmp_path: Path) -> None:
    file = tmp_path / "points.obj"
    file.write_text(CORNERS)
    np.testing.assert_array_equal(surface_vertices(file), mesh_points(file))


def test_a_mesh_without_faces_has_no_triangles(tmp_path: Path) -> None:
    (tmp_path / "cloud.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\n")
    assert mesh_triangles(tmp_path / "cloud.obj").shape == (0, 3, 3)


@pytest.mark.parametrize("face", ["f 1 2 4", "f 1 2 -4", "f 1 2 0"])
def test_a_face_with_an_invalid_vertex_is_rejected_with_its_index(
    face: str, tmp_path: Path
) -> None:
    (tmp_path / "damaged.obj").write_text(f"v 0 0 0\nv 1 0 0\nv 0 1 0\n{face}\n")
    with pytest.raises(UrdfError, match=r"damaged.obj: a face uses vertex -?\d"):
        mesh_triangles(tmp_path / "damaged.obj")
