"""Clouds are read equally from every format, and normals face the camera."""

from __future__ import annotations

import os
import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import example, given, settings
from hypothesis import strategies as st
from tests.perception.recordings.recorded import write_ply

from momapos.core.errors import FileFormatError, InputError
from momapos.perception.recordings import pcd, ply
from momapos.perception.recordings.clouds import read_cloud, write_cloud
from momapos.perception.recordings.pcd import unpack_lzf

COLUMNS = np.dtype(
    {
        "names": ["x", "y", "z", "red", "green", "blue", "nx", "ny", "nz"],
        "formats": ["<f4"] * 3 + ["u1"] * 3 + ["<f4"] * 3,
    }
)
NAMES = {"f": "float", "u": "uchar"}


@pytest.fixture
def table() -> np.ndarray:
    rng = np.random.default_rng(5)
    made = np.zeros(60, COLUMNS)
    for name in COLUMNS.names or ():
        color = COLUMNS[name].kind == "u"
        made[name] = rng.integers(0, 256, 60) if color else rng.normal(size=60)
    length = np.sqrt(made["nx"] ** 2 + made["ny"] ** 2 + made["nz"] ** 2)
    for name in ("nx", "ny", "nz"):
        made[name] /= length
    return made


def as_ply(table: np.ndarray, order: str, count: int | None = None) -> bytes:
    names = table.dtype.names or ()
    lines = ["ply", f"format {order} 1.0", "comment made for a test"]
    lines += [f"element vertex {len(table) if count is None else count}"]
    lines += [f"property {NAMES[table.dtype[name].kind]} {name}" for name in names]
    header = "\n".join([*lines, "end_header", ""]).encode()
    if order == "ascii":
        return header + "".join(" ".join(map(repr, row.tolist())) + "\n" for row in table).encode()
    sign = "<" if "little" in order else ">"
    return header + table.astype(table.dtype.newbyteorder(sign)).tobytes()


def packed(table: np.ndarray) -> np.ndarray:
    """Return the fields of a PCD file, with color as the bits of a float."""
    kinds = [(n, "<f4") for n in ("x", "y", "z", "rgb", "normal_x", "normal_y", "normal_z")]
    made = np.zeros(len(table), kinds)
    for ours, theirs in (*((a, a) for a in "xyz"), *((f"n{a}", f"normal_{a}") for a in "xyz")):
        made[theirs] = table[ours]
    bits = table["red"].astype(np.uint32) << 16 | table["green"].astype(np.uint32) << 8
    made["rgb"] = (bits | table["blue"]).astype("<u4").view("<f4")
    return made


def stored_lzf(data: bytes) -> bytes:
    """Return LZF without compression: runs of at most 32 plain bytes."""
    runs = [data[i : i + 32] for i in range(0, len(data), 32)]
    return b"".join(bytes([len(run) - 1]) + run for run in runs)


def as_pcd(table: np.ndarray, data: str) -> bytes:
    made = packed(table)
    names = made.dtype.names or ()
    width = len(names)
    header = (
        f"# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS {' '.join(names)}\n"
        f"SIZE {'4 ' * width}\nTYPE {'F ' * width}\nCOUNT {'1 ' * width}\nWIDTH {len(made)}\n"
        f"HEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(made)}\nDATA {data}\n"
    ).encode()
    if data == "ascii":
        rows = (" ".join(f"{value:.9g}" for value in row.tolist()) for row in made)
        return header + "\n".join(rows).encode() + b"\n"
    if data == "binary":
        return header + made.tobytes()
    plain = b"".join(made[name].tobytes() for name in names)
    squeezed = stored_lzf(plain)
    return header + struct.pack("<II", len(squeezed), len(plain)) + squeezed


FILES = {
    "ply ascii": lambda table: as_ply(table, "ascii"),
    "ply little": lambda table: as_ply(table, "binary_little_endian"),
    "ply big": lambda table: as_ply(table, "binary_big_endian"),
    "pcd ascii": lambda table: as_pcd(table, "ascii"),
    "pcd binary": lambda table: as_pcd(table, "binary"),
    "pcd compressed": lambda table: as_pcd(table, "binary_compressed"),
}


@pytest.mark.parametrize("write", FILES.values(), ids=FILES)
def test_every_file_of_the_same_points_gives_the_same_cloud(
    tmp_path: Path, table: np.ndarray, write: object
) -> None:
    path = tmp_path / "cloud"
    path.write_bytes(write(table))
    cloud, warnings = read_cloud(path)
    assert [line for line in warnings if "is sparse" not in line] == []
    for i, axis in enumerate("xyz"):
        np.testing.assert_allclose(cloud.points[:, i], table[axis], rtol=1e-6)
        np.testing.assert_allclose(cloud.normals[:, i], table[f"n{axis}"], atol=1e-5)
    for i, name in enumerate(("red", "green", "blue")):
        np.testing.assert_array_equal(cloud.colors[:, i], table[name])


def test_a_written_cloud_is_read_unchanged(tmp_path: Path, table: np.ndarray) -> None:
    (tmp_path / "table.ply").write_bytes(as_ply(table, "binary_little_endian"))
    cloud, _ = read_cloud(tmp_path / "table.ply")
    write_cloud(cloud, tmp_path / "new" / "cloud.ply")
    back, warnings = read_cloud(tmp_path / "new" / "cloud.ply")
    np.testing.assert_array_equal(back.points, cloud.points)
    np.testing.assert_allclose(back.normals, cloud.normals, atol=1e-6)
    np.testing.assert_array_equal(back.colors, cloud.colors)
    assert [line for line in warnings if "is sparse" not in line] == []
    with pytest.raises(InputError, match="cannot be written"):
        write_cloud(cloud, tmp_path / "table.ply" / "below.ply")


def test_a_mesh_written_by_trimesh_keeps_the_order_of_its_vertices(tmp_path: Path) -> None:
    mesh = trimesh.creation.box((1, 2, 3))
    for encoding in ("ascii", "binary"):
        path = tmp_path / f"{encoding}.ply"
        mesh.export(path, encoding=encoding, vertex_normal=False)
        cloud, _ = read_cloud(path)
        np.testing.assert_allclose(cloud.points, mesh.vertices, atol=1e-6)
        outward = np.einsum("ni,ni->n", cloud.normals, cloud.points)
        assert outward.min() > 0, "normals follow the triangles, and not the middle of the cloud"


@settings(max_examples=100)
@given(st.lists(st.tuples(st.binary(min_size=1, max_size=20), st.integers(1, 30)), max_size=20))
def test_lzf_of_repeated_bytes_unpacks_to_them(runs: list[tuple[bytes, int]]) -> None:
    squeezed, plain = b"", b""
    for literal, times in runs:
        squeezed += bytes([len(literal) - 1]) + literal
        plain += literal
        # A copy that overlaps itself repeats the bytes just written.
        extra = times + 2
        back = len(literal) - 1
        if extra - 2 < 7:
            squeezed += bytes([(extra - 2) << 5 | back >> 8, back & 255])
        else:
            squeezed += bytes([7 << 5 | back >> 8, extra - 9, back & 255])
        plain += (literal * extra)[:extra]
    out = np.zeros(len(plain), np.uint8)
    assert unpack_lzf(np.frombuffer(squeezed, np.uint8), out) == len(plain)
    assert out.tobytes() == plain


@settings(max_examples=300)
@given(st.binary(max_size=200), st.integers(0, 300))
def test_lzf_never_writes_beyond_its_end(data: bytes, size: int) -> None:
    guard = np.full(size + 64, 7, np.uint8)
    written = unpack_lzf(np.frombuffer(data, np.uint8), guard[:size])
    assert -1 <= written <= size
    assert np.all(guard[size:] == 7)


@pytest.mark.parametrize(
    ("properties", "row"),
    [
        ("", ""),
        ("property uchar n\n", "3"),
        ("property list uchar float vertex_indices\n", "3 0 1 inf"),
        ("property list uchar int vertex_indices\n", "3 0 1 99"),
        ("property list uchar int vertex_indices\n", "3 0 1 -1"),
        ("property list uchar int vertex_indices\n", "3 0 1 1e300"),
        ("property list uchar int vertex_indices\n", "4 0 1 2 3"),
    ],
)
def test_invalid_faces_are_ignored(tmp_path: Path, properties: str, row: str) -> None:
    path = tmp_path / "mesh.ply"
    head = "ply\nformat ascii 1.0\nelement vertex 3\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz")
    head += f"element face 1\n{properties}end_header\n"
    path.write_text(f"{head}0 0 0\n1 0 0\n0 1 0\n{row}\n")
    columns, triangles = ply.read_ply(path)
    assert triangles is None
    np.testing.assert_array_equal(columns["x"], [0, 1, 0])


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("lines", [7, 20, 59, 60])
@pytest.mark.parametrize("write", [FILES["ply ascii"], FILES["pcd ascii"]])
def test_reading_lines_in_blocks_changes_no_point(
    tmp_path: Path, table: np.ndarray, write: object, lines: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "cloud"
    path.write_bytes(write(table) + b"\n1 2\n")
    whole, _ = read_cloud(path)
    monkeypatch.setattr(ply, "_LINES", lines)
    np.testing.assert_array_equal(read_cloud(path)[0].points, whole.points)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("write", [FILES["ply ascii"], FILES["pcd ascii"]])
def test_empty_lines_between_points_are_skipped_without_a_warning(
    tmp_path: Path, table: np.ndarray, write: object
) -> None:
    plain, spaced = tmp_path / "plain", tmp_path / "spaced"
    plain.write_bytes(write(table))
    head, _, rest = write(table).rpartition(b"\n" + write(table).splitlines()[-1])
    spaced.write_bytes(head + b"\n\n \n" + write(table).splitlines()[-1] + rest)
    assert b"\n\n" in spaced.read_bytes()
    np.testing.assert_array_equal(read_cloud(spaced)[0].points, read_cloud(plain)[0].points)


def test_a_fifo_or_a_device_is_refused_before_it_is_opened(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "cloud.ply")
    for path in (tmp_path / "cloud.ply", Path("/dev/zero")):
        with pytest.raises(FileFormatError, match="fifo, socket or device"):
            read_cloud(path)


def wall(count: int = 400) -> np.ndarray:
    rng = np.random.default_rng(2)
    return np.column_stack([rng.uniform(-1, 1, (count, 2)), rng.normal(0, 1e-4, count)])


@pytest.mark.parametrize("side", [-1, 1])
def test_estimated_normals_face_the_nearest_camera(tmp_path: Path, side: int) -> None:
    path = write_ply(tmp_path / "wall.ply", wall())
    cameras = np.array([[0, 0, 2.0 * side], [0, 0, -9.0 * side]])
    cloud, warnings = read_cloud(path, cameras)
    np.testing.assert_allclose(cloud.normals[:, 2] * side, 1.0, atol=1e-3)
    assert "no colors" in warnings[0]


def test_without_cameras_the_walls_of_a_room_face_its_middle(tmp_path: Path) -> None:
    room = trimesh.creation.box((4, 4, 3)).sample(2000, seed=1)
    cloud, _ = read_cloud(write_ply(tmp_path / "room.ply", np.asarray(room)))
    inward = -np.einsum("ni,ni->n", cloud.normals, cloud.points)
    assert np.mean(inward > 0) > 0.99


def test_many_points_in_one_place_get_a_normal_too(tmp_path: Path) -> None:
    points = np.concatenate([wall(), np.zeros((20_000, 3))])
    cloud, _ = read_cloud(write_ply(tmp_path / "zeros.ply", points))
    np.testing.assert_allclose(np.linalg.norm(cloud.normals, axis=1), 1.0)
    np.testing.assert_allclose(np.abs(cloud.normals[:, 2]), 1.0, atol=1e-3)


def test_points_that_are_not_finite_are_dropped_and_counted(tmp_path: Path) -> None:
    points = wall(50)
    points[3, 1], points[7, 0], points[9, 2] = np.nan, np.inf, 1e30
    cloud, warnings = read_cloud(write_ply(tmp_path / "a.ply", points))
    assert len(cloud.points) == 47
    assert any("3 of 50 points" in line for line in warnings)
    assert np.isfinite(cloud.normals).all()


@pytest.mark.parametrize(
    ("points", "says"),
    [
        (np.empty((0, 3)), "empty"),
        (np.full((5, 3), np.nan), "none of its 5 points is finite"),
        (1000 * wall(), "millimeters"),
    ],
)
def test_an_unusable_cloud_is_refused(tmp_path: Path, points: np.ndarray, says: str) -> None:
    path = write_ply(tmp_path / "bad.ply", points)
    with pytest.raises(FileFormatError, match=rf"bad\.ply.*{says}"):
        read_cloud(path)


@pytest.mark.parametrize("write", FILES.values(), ids=FILES)
def test_a_truncated_cloud_is_refused(tmp_path: Path, table: np.ndarray, write: object) -> None:
    data = write(table)
    path = tmp_path / "cut"
    for end in (len(data) - 90, 60):
        path.write_bytes(data[:end])
        with pytest.raises(FileFormatError, match="cut: "):
            read_cloud(path)


def test_an_oversized_header_allocates_no_memory(tmp_path: Path, table: np.ndarray) -> None:
    path = tmp_path / "bomb"
    path.write_bytes(as_ply(table, "binary_little_endian", ply.MAX_POINTS + 1))
    with pytest.raises(FileFormatError, match="the limit is"):
        read_cloud(path)
    path.write_bytes(as_ply(table, "binary_little_endian", ply.MAX_POINTS))
    with pytest.raises(FileFormatError, match="ends after 60"):
        read_cloud(path)
    for kind in ("ascii", "binary", "binary_compressed"):
        many = as_pcd(table, kind).replace(b"POINTS 60", b"POINTS 50000000")
        path.write_bytes(many)
        with pytest.raises(FileFormatError, match="bomb: "):
            read_cloud(path)
    path.write_bytes(as_pcd(table, "binary").replace(b"COUNT 1", b"COUNT 99999999"))
    with pytest.raises(FileFormatError, match="is inconsistent"):
        read_cloud(path)


@settings(max_examples=150)
@example(kind="pcd binary", at=255, byte=127)
@given(kind=st.sampled_from(sorted(FILES)), at=st.integers(0, 400), byte=st.integers(0, 255))
def test_a_damaged_cloud_is_read_or_refused_and_nothing_else(
    tmp_path_factory: pytest.TempPathFactory, kind: str, at: int, byte: int
) -> None:
    made = np.zeros(20, COLUMNS)
    made["x"] = made["ny"] = np.linspace(1, 2, 20)
    data = bytearray(FILES[kind](made))
    data[at % len(data)] = byte
    path = tmp_path_factory.getbasetemp() / "damaged"
    path.write_bytes(bytes(data))
    try:
        count = len(read_cloud(path)[0].points)
    except FileFormatError:
        count = 1
    assert 0 < count <= 20


def test_padding_and_fields_of_many_values_are_skipped(tmp_path: Path) -> None:
    kinds = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("pad", "u1", 4), ("h", "<f4", 3)])
    made = np.zeros(8, kinds)
    made["z"] = np.arange(8)
    header = (
        "VERSION 0.7\nFIELDS x y z _ histogram\nSIZE 4 4 4 1 4\nTYPE F F F U F\nCOUNT 1 1 1 4 3\n"
        "WIDTH 4\nHEIGHT 2\nDATA binary\n"
    )
    (tmp_path / "a.pcd").write_bytes(header.encode() + made.tobytes())
    assert set(pcd.read_pcd(tmp_path / "a.pcd")) == {"x", "y", "z"}
    np.testing.assert_allclose(read_cloud(tmp_path / "a.pcd")[0].points[:, 2], np.arange(8))
