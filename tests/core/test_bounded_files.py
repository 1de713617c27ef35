"""Only regular files of bounded size are read, and outputs are checked before the work."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from momapos.core.errors import MAX_MESSAGE_LENGTH, FileFormatError, InputError, MomaposError
from momapos.core.files import check_outputs, open_regular, read_bytes_bounded


def test_a_file_larger_than_the_limit_is_rejected(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"12345")
    assert read_bytes_bounded(path, 5) == b"12345"
    with open_regular(path) as file:
        assert file.read() == b"12345"
    with pytest.raises(FileFormatError, match="larger"):
        read_bytes_bounded(path, 4)


def special(folder: Path, kind: str) -> Path:
    path = folder / kind
    if kind == "fifo":
        os.mkfifo(path)
    elif kind == "device":
        return Path("/dev/zero")
    elif kind == "folder":
        path.mkdir()
    elif kind == "circle":
        path.symlink_to(path)
    elif kind == "link to a device":
        path.symlink_to("/dev/zero")
    elif kind == "sparse":
        with path.open("wb") as file:
            file.truncate(10**13)
    elif kind == "NUL":
        return folder / "a\0b"
    elif kind == "long":
        return folder / ("a" * 5000)
    return path


KINDS = [
    "fifo", "device", "folder", "circle", "link to a device", "sparse", "NUL", "long", "missing",
]  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_special_files_are_rejected_without_opening_them(tmp_path: Path, kind: str) -> None:
    with pytest.raises(InputError) as caught:
        read_bytes_bounded(special(tmp_path, kind), 1000, error=InputError)
    assert 10 < len(str(caught.value)) <= MAX_MESSAGE_LENGTH


@pytest.mark.parametrize("kind", ["fifo", "device", "folder", "circle", "NUL", "long"])
def test_an_output_path_that_cannot_be_a_file_is_rejected(tmp_path: Path, kind: str) -> None:
    with pytest.raises(InputError):
        check_outputs([special(tmp_path, kind)])


def test_an_output_may_be_in_folders_that_can_be_created(tmp_path: Path) -> None:
    (tmp_path / "old").write_text("")
    check_outputs([None, tmp_path / "old", tmp_path / "a" / "b" / "new"], [tmp_path / "c", None])
    assert [path.name for path in tmp_path.iterdir()] == ["old"]
    for bad in ({"files": [tmp_path / "old" / "x"]}, {"folders": [tmp_path / "old"]}):
        with pytest.raises(InputError, match="not a folder"):
            check_outputs(**bad)


def test_a_long_message_becomes_one_line_that_keeps_both_ends() -> None:
    text = str(MomaposError("/a/b.json:\n name \x1b[31m" + "x" * 10_000_000 + "\nmust be short"))
    assert len(text) <= MAX_MESSAGE_LENGTH
    assert text.isprintable()
    assert text.startswith("/a/b.json: name")
    assert text.endswith("must be short")
    assert str(MomaposError("as it is")) == "as it is"
