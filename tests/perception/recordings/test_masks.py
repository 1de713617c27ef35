"""Instances from other programs are read as written, and no file runs code."""

from __future__ import annotations

import contextlib
import json
import os
import pickle
import struct
import sys
import zipfile
from collections import OrderedDict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests import optional

from momapos.core.errors import FileFormatError, MissingExtraError
from momapos.model.records.scans import Instance
from momapos.perception.recordings.masks import SCANNET20, SCANNET200, read_instances

SIZE = 50
needs_torch = optional.needs("torch", optional.has("torch"))


@pytest.fixture
def masks() -> np.ndarray:
    found = np.random.default_rng(3).random((SIZE, 4)) < 0.3
    found[:, 3] = False
    return found


def write_mask3d(folder: Path, masks: np.ndarray, rows: list[str]) -> Path:
    (folder / "pred_mask").mkdir()
    for index, column in enumerate(masks.T):
        np.savetxt(folder / "pred_mask" / f"s_{index:03d}.txt", column, fmt="%d")
    listing = folder / "scene.txt"
    listing.write_text("".join(f"pred_mask/s_{i:03d}.txt {row}\n" for i, row in enumerate(rows)))
    return listing


def write_archive(path: Path, program: bytes, data: bytes, compression: int = 0) -> Path:
    with zipfile.ZipFile(path, "w", compression) as archive:
        archive.writestr("archive/data.pkl", program)
        archive.writestr("archive/byteorder", "little")
        archive.writestr("archive/version", "3\n")
        archive.writestr("archive/data/0", data)
    return path


def tensor_program(shape: tuple[int, ...], strides: tuple[int, ...], count: int) -> bytes:
    """Return what torch.save writes for a float tensor, built by hand."""

    def number(n: int) -> bytes:
        return b"J" + struct.pack("<i", n)

    def numbers(values: tuple[int, ...]) -> bytes:
        return b"(" + b"".join(map(number, values)) + b"t"

    def text(value: str) -> bytes:
        return b"X" + struct.pack("<I", len(value)) + value.encode()

    storage = b"(" + text("storage") + b"ctorch\nFloatStorage\n" + text("0") + text("cpu")
    storage += number(count) + b"tQ"
    hooks = b"ccollections\nOrderedDict\n)R"
    arguments = b"(" + storage + number(0) + numbers(shape) + numbers(strides) + b"\x89" + hooks
    return b"\x80\x02ctorch._utils\n_rebuild_tensor_v2\n" + arguments + b"tR."


def test_the_export_of_mask3d_is_read_with_names_scores_and_members(
    tmp_path: Path, masks: np.ndarray
) -> None:
    listing = write_mask3d(tmp_path, masks, ["24 0.9", "7 0.25", "5 1.0", "3 0.5"])
    found = read_instances(listing, SIZE)
    assert [(i.label, i.score) for i in found] == [
        ("refrigerator", 0.9),
        ("table", 0.25),
        ("chair", 1.0),
        ("cabinet", 0.5),
    ], "the empty mask is counted, too"
    for instance, column in zip(found, masks.T, strict=True):
        np.testing.assert_array_equal(instance.members, np.flatnonzero(column))


def test_class_numbers_outside_of_the_20_are_those_of_the_200(
    tmp_path: Path, masks: np.ndarray
) -> None:
    listing = write_mask3d(tmp_path, masks, ["59 0.9", "7 0.5", "9999 0.5"])
    assert [i.label for i in read_instances(listing, SIZE)] == [
        "microwave",
        "cabinet",
        "class 9999",
    ]
    forced = read_instances(listing, SIZE, classes="scannet20")
    assert [i.label for i in forced] == ["class 59", "table", "class 9999"]


def test_both_benchmarks_know_the_furniture_that_opens() -> None:
    for name in ("refrigerator", "cabinet", "table", "counter", "sink"):
        assert name in SCANNET20.values()
        assert name in SCANNET200.values()
    assert len(SCANNET20) == 20
    assert {"microwave", "oven", "dishwasher", "kitchen cabinet"} <= set(SCANNET200.values())
    assert len(set(SCANNET200.values())) == len(SCANNET200)


@pytest.mark.parametrize(
    ("row", "says"),
    [
        ("../secret.txt 24 0.9", "outside its folder"),
        ("/etc/hostname 24 0.9", "outside its folder"),
        ("pred_mask/none.txt 24 0.9", "no such file"),
        ("pred_mask/s_000.txt fridge 0.9", "line 1"),
        ("pred_mask/s_000.txt 24 nan", "line 1"),
        ("pred_mask/\0.txt 24 0.9", "line 2"),
        ("pred_mask/round.txt 24 0.9", "line 1"),
        (f"pred_mask/{300 * 'x'}.txt 24 0.9", "cannot be read"),
    ],
)
def test_a_bad_row_of_a_scene_file_is_refused_by_name(
    tmp_path: Path, masks: np.ndarray, row: str, says: str
) -> None:
    listing = write_mask3d(tmp_path, masks, ["24 0.9"])
    (tmp_path / "pred_mask" / "round.txt").symlink_to("round.txt")
    # The first row is valid, because a NUL at the beginning means a binary file.
    first = "pred_mask/s_000.txt 24 0.9" + " " * 4096 + "\n" if "\0" in row else ""
    listing.write_text(first + row + "\n")
    with pytest.raises(FileFormatError, match=says):
        read_instances(listing, SIZE)


def test_a_link_out_of_the_folder_is_not_followed(tmp_path: Path, masks: np.ndarray) -> None:
    inside = tmp_path / "export"
    inside.mkdir()
    (tmp_path / "secret.txt").write_text("1\n" * SIZE)
    listing = write_mask3d(inside, masks, ["24 0.9"])
    (inside / "pred_mask" / "s_000.txt").unlink()
    (inside / "pred_mask" / "s_000.txt").symlink_to(tmp_path / "secret.txt")
    with pytest.raises(FileFormatError, match="outside its folder"):
        read_instances(listing, SIZE)


def test_masks_of_another_cloud_are_refused_with_both_lengths(
    tmp_path: Path, masks: np.ndarray
) -> None:
    np.save(tmp_path / "labels.npy", np.zeros(40, int))
    (tmp_path / "labels.txt").write_text("1\n" * 40)
    listing = write_mask3d(tmp_path, masks[:40], ["24 0.9"])
    for file in (tmp_path / "labels.npy", tmp_path / "labels.txt", listing):
        with pytest.raises(FileFormatError, match=r"40 points.* has 50"):
            read_instances(file, SIZE)
    (tmp_path / "labels.txt").write_text("1\n" * 100_000)
    with pytest.raises(FileFormatError, match="larger cloud"):
        read_instances(tmp_path / "labels.txt", SIZE)


def test_a_mask_file_with_other_values_than_0_and_1_is_refused(
    tmp_path: Path, masks: np.ndarray
) -> None:
    listing = write_mask3d(tmp_path, masks, ["24 0.9"])
    for line in ("2", "0.5", "10", "yes"):
        (tmp_path / "pred_mask" / "s_000.txt").write_text("1\n" * (SIZE - 1) + line + "\n")
        with pytest.raises(FileFormatError, match="0 or 1"):
            read_instances(listing, SIZE)


@needs_torch
def test_a_tensor_of_another_cloud_is_refused_with_both_lengths(tmp_path: Path) -> None:
    path = write_archive(tmp_path / "a_masks.pt", tensor_program((40, 5), (5, 1), 200), bytes(800))
    with pytest.raises(FileFormatError, match=r"40 points.* has 50"):
        read_instances(path, SIZE)


def test_an_error_about_missing_torch_names_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_archive(tmp_path / "m.pt", tensor_program((SIZE, 4), (4, 1), 200), bytes(800))
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(MissingExtraError, match="torch is not installed; pip install"):
        read_instances(path, SIZE)


@needs_torch
@pytest.mark.parametrize("kind", ["bool", "float32", "bfloat16", "int64", "uint8", "transposed"])
def test_masks_saved_by_torch_are_read_unchanged(
    tmp_path: Path, masks: np.ndarray, kind: str
) -> None:
    import torch

    tensor = torch.from_numpy(masks)
    if kind == "transposed":
        tensor = torch.from_numpy(np.ascontiguousarray(masks.T)).T
    elif kind != "bool":
        tensor = tensor.to(getattr(torch, kind))
    path = tmp_path / "scene_masks.pt"
    torch.save(tensor, path)
    found = read_instances(path, SIZE)
    assert [i.label for i in found] == [""] * 4
    for instance, column in zip(found, masks.T, strict=False):
        np.testing.assert_array_equal(instance.members, np.flatnonzero(column))


@needs_torch
def test_a_tensor_file_written_by_hand_is_read_as_one_by_torch(
    tmp_path: Path, masks: np.ndarray
) -> None:
    data = masks.astype("<f4").tobytes()
    path = write_archive(tmp_path / "m.pt", tensor_program((SIZE, 4), (4, 1), SIZE * 4), data)
    found = read_instances(path, SIZE)
    np.testing.assert_array_equal(found[0].members, np.flatnonzero(masks[:, 0]))


class Attack:
    """Writes a file when it is unpickled."""

    def __init__(self, target: Path) -> None:
        self.target = target

    def __reduce__(self) -> tuple[Any, ...]:
        return (exec, (f"open({str(self.target)!r}, 'w').write('run')",))


@needs_torch
@pytest.mark.filterwarnings("ignore:Detected pickle protocol")
@pytest.mark.parametrize("protocol", [0, 1, 2, 4])
def test_a_masks_file_that_would_run_code_is_refused_without_running_it(
    tmp_path: Path, protocol: int
) -> None:
    target = tmp_path / "run"
    program = pickle.dumps(Attack(target), protocol)
    path = write_archive(tmp_path / "evil.pt", program, b"")
    with pytest.raises(FileFormatError, match=r"evil\.pt: (would run code|damaged)"):
        read_instances(path, SIZE)
    assert not target.exists()


def test_a_bare_pickle_and_objects_in_an_array_are_refused(tmp_path: Path) -> None:
    (tmp_path / "old.pt").write_bytes(pickle.dumps(Attack(tmp_path / "run"), 2))
    np.save(tmp_path / "objects.npy", np.array([Attack(tmp_path / "run")]), allow_pickle=True)
    with pytest.raises(FileFormatError, match="bare pickle"):
        read_instances(tmp_path / "old.pt", SIZE)
    with pytest.raises(FileFormatError, match=r"objects\.npy"):
        read_instances(tmp_path / "objects.npy", 1)
    assert not (tmp_path / "run").exists()


@needs_torch
@pytest.mark.parametrize(
    ("shape", "strides", "count", "says"),
    [
        ((SIZE, 2**30), (0, 0), 4, "at most 10000"),
        ((SIZE, 8), (8, 1), 200, "damaged"),
        ((SIZE, -4), (4, 1), 200, "damaged"),
        ((SIZE,), (4, 1), 200, "damaged"),
        ((2**31 - 1, 2**31 - 1), (2**31 - 1, 1), 200, "damaged"),
        ((SIZE,), (1,), 200, "one tensor or array"),
    ],
)
def test_a_tensor_of_an_absurd_shape_is_refused(
    tmp_path: Path, shape: tuple[int, ...], strides: tuple[int, ...], count: int, says: str
) -> None:
    path = write_archive(tmp_path / "m.pt", tensor_program(shape, strides, count), bytes(4 * count))
    with pytest.raises(FileFormatError, match=says):
        read_instances(path, SIZE)


@needs_torch
def test_a_tensor_larger_than_its_archive_is_refused(tmp_path: Path) -> None:
    path = write_archive(tmp_path / "m.pt", tensor_program((SIZE, 4), (4, 1), 2**30), bytes(800))
    with pytest.raises(FileFormatError, match="damaged"):
        read_instances(path, SIZE)


@needs_torch
def test_a_tensor_that_is_not_dense_is_refused(tmp_path: Path) -> None:
    import torch

    torch.save(torch.eye(SIZE, dtype=torch.complex64), tmp_path / "complex.pt")
    torch.save(torch.eye(SIZE).to_sparse(), tmp_path / "sparse.pt")
    for name in ("complex.pt", "sparse.pt"):
        with pytest.raises(FileFormatError, match="one dense tensor"):
            read_instances(tmp_path / name, SIZE)


@needs_torch
def test_other_objects_saved_by_torch_are_refused(tmp_path: Path) -> None:
    for program in (pickle.dumps(OrderedDict(), 2), pickle.dumps((1, 2), 2), b"\x80\x02.", b""):
        path = write_archive(tmp_path / "other.pt", program, b"")
        with pytest.raises(FileFormatError, match=r"other\.pt"):
            read_instances(path, SIZE)
    program = tensor_program((SIZE, 4), (4, 1), SIZE * 4)
    squeezed = write_archive(tmp_path / "bomb.pt", program, bytes(800), zipfile.ZIP_DEFLATED)
    with pytest.raises(FileFormatError, match="compressed"):
        read_instances(squeezed, SIZE)


@needs_torch
@pytest.mark.filterwarnings("ignore:Detected pickle protocol")
@settings(max_examples=200)
@given(cut=st.integers(0, 200), byte=st.integers(0, 255), at=st.integers(0, 200))
def test_a_damaged_program_is_read_or_refused_and_nothing_else(
    tmp_path_factory: pytest.TempPathFactory, cut: int, byte: int, at: int
) -> None:
    program = bytearray(tensor_program((SIZE, 4), (4, 1), SIZE * 4))
    program[at % len(program)] = byte
    path = tmp_path_factory.getbasetemp() / "damaged.pt"
    write_archive(path, bytes(program[: len(program) - cut % 3]), bytes(4 * SIZE * 4))
    found: list[Instance] = []
    with contextlib.suppress(FileFormatError):
        found = read_instances(path, SIZE)
    assert all(i.members is not None and i.members.max() < SIZE for i in found)


@pytest.mark.parametrize("suffix", ["npy", "txt"])
def test_labels_of_points_become_one_instance_each(tmp_path: Path, suffix: str) -> None:
    labels = np.random.default_rng(0).integers(-1, 4, SIZE)
    path = tmp_path / f"labels.{suffix}"
    if suffix == "npy":
        np.save(path, labels)
    else:
        np.savetxt(path, labels, fmt="%d")
    found = read_instances(path, SIZE)
    assert len(found) == 3
    for value, instance in enumerate(found, start=1):
        np.testing.assert_array_equal(instance.members, np.flatnonzero(labels == value))


@pytest.mark.parametrize(
    "header",
    [
        "{'descr': '<i8', 'fortran_order': False, 'shape': (1e999,)}",
        "{'descr': '<i8', 'fortran_order': False, 'shape': (99999999999999999999,)}",
        "{'descr': '<i8', 'fortran_order': False, 'shape': (-1,)}",
        "{'descr': '<i8', 'fortran_order': False, 'shape': (50,",
        "{'descr': 'V99999999999', 'fortran_order': False, 'shape': (50,)}",
        "{'descr': " + "[" * 200 + "]" * 200 + "}",
        "-" * 900 + "1",
        "{'descr': '<i8', 'fortran_order': False, 'shape': (50,)}" + " " * 60_000,
        "\0",
    ],
)
def test_a_forged_header_of_an_array_is_refused(tmp_path: Path, header: str) -> None:
    path = tmp_path / "labels.npy"
    text = header.encode() + b"\n"
    path.write_bytes(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + bytes(8 * SIZE))
    with pytest.raises(FileFormatError, match=r"labels\.npy"):
        read_instances(path, SIZE)


def test_an_array_that_ends_early_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "labels.npy"
    np.save(path, np.ones(SIZE, int))
    path.write_bytes(path.read_bytes()[:-9])
    with pytest.raises(FileFormatError, match="ends after 48 of 50"):
        read_instances(path, SIZE)


def test_a_fifo_is_refused_without_blocking(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "labels.npy")
    with pytest.raises(FileFormatError, match="fifo"):
        read_instances(tmp_path / "labels.npy", SIZE)


def test_labels_that_are_not_integers_are_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.zeros(SIZE))
    (tmp_path / "b.txt").write_text("chair\n" * SIZE)
    (tmp_path / "c.txt").write_text("1.5\n" * SIZE)
    for name in ("a.npy", "b.txt", "c.txt"):
        with pytest.raises(FileFormatError, match="integer"):
            read_instances(tmp_path / name, SIZE)


def boxes(**changes: Any) -> dict[str, Any]:
    box = {
        "label": "fridge",
        "center": [1, 2, 0.9],
        "size": [0.6, 0.6, 1.8],
        "yaw": 0.1,
        "score": 0.7,
    }
    box.update(changes)
    return {"format": "momapos-boxes", "version": 1, "boxes": [box]}


def test_written_boxes_are_read_unchanged(tmp_path: Path) -> None:
    path = tmp_path / "boxes.json"
    path.write_text(json.dumps(boxes()))
    (found,) = read_instances(path, SIZE)
    assert (found.label, found.score, found.members) == ("fridge", 0.7, None)
    np.testing.assert_allclose(found.box.center, [1, 2, 0.9])
    np.testing.assert_allclose(found.box.size, [0.6, 0.6, 1.8])
    assert found.box.yaw == 0.1


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"size": [0.6, 0, 1]}, "size"),
        ({"center": [0, 1]}, "center"),
        ({"center": [0, 1, 1e6]}, "center"),
        ({"center": [0, True, 1]}, "center"),
        ({"label": 3}, "label"),
        ({"score": 1.5}, "score"),
        ({"yaw": "0"}, "yaw"),
        ({"height": 1}, "only"),
    ],
)
def test_an_error_about_a_bad_box_names_the_fault(
    tmp_path: Path, change: dict[str, Any], says: str
) -> None:
    path = tmp_path / "boxes.json"
    path.write_text(json.dumps(boxes(**change)))
    with pytest.raises(FileFormatError, match=says):
        read_instances(path, SIZE)


@pytest.mark.parametrize("text", ["", "{", '{"format": 1}', '{"boxes": NaN}', "\0\0\0\0"])
def test_unrelated_files_are_refused_by_name(tmp_path: Path, text: str) -> None:
    path = tmp_path / "what.json"
    path.write_text(text)
    with pytest.raises(FileFormatError, match=r"what\.json"):
        read_instances(path, SIZE)
    with pytest.raises(FileFormatError, match="no such file"):
        read_instances(tmp_path / "none.json", SIZE)
