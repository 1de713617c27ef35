"""Temporary files and folders: what killed runs leave, the next run removes, and nothing else."""

from __future__ import annotations

import os
import signal
import stat
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

import pytest

from momapos.core import files
from momapos.core.files import incomplete, remove_if_incomplete, temporary_folder, write_atomic

_HANG = """
import os, sys, time
from pathlib import Path
from momapos.core import files
folder = Path(sys.argv[1])

def stop(*_):
    print("ready", flush=True)
    time.sleep(600)

if sys.argv[2] == "file":
    files.os.fsync = stop
    files.write_atomic(folder / "plan.json", b"half")
elif sys.argv[2] == "folder":
    with files.temporary_folder(folder, "room") as inside:
        (inside / "mesh.obj").write_text("v 0 0 0")
        stop()
else:
    (folder / "draft").mkdir()
    with files.incomplete(folder / "draft", folder / "room_files"):
        (folder / "draft").rename(folder / "room_files")
        stop()
"""


def hanging(folder: Path, kind: str) -> subprocess.Popen[str]:
    """Start a process that stops before it has finished writing."""
    call = [sys.executable, "-c", _HANG, str(folder), kind]
    process = subprocess.Popen(call, stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "ready\n"
    return process


def kill(process: subprocess.Popen[str]) -> None:
    process.send_signal(signal.SIGKILL)
    process.wait()
    process.stdout.close()


@pytest.mark.parametrize("kind", ["file", "folder"])
def test_what_a_killed_run_leaves_is_removed_by_the_next_and_not_before(
    tmp_path: Path, kind: str
) -> None:
    process = hanging(tmp_path, kind)
    (left,) = tmp_path.iterdir()
    write_atomic(tmp_path / "other.json", b"{}")
    assert left.exists()  # its process lives
    kill(process)
    write_atomic(tmp_path / "other.json", b"{}")
    assert [path.name for path in tmp_path.iterdir()] == ["other.json"]


def test_a_folder_that_a_killed_run_left_incomplete_is_removed(tmp_path: Path) -> None:
    process = hanging(tmp_path, "incomplete")
    target = tmp_path / "room_files"
    remove_if_incomplete(target)
    assert target.exists()
    kill(process)
    remove_if_incomplete(target)
    assert not target.exists()


def test_a_complete_folder_is_never_removed(tmp_path: Path) -> None:
    target = tmp_path / "room_files"
    (tmp_path / "draft").mkdir()
    with incomplete(tmp_path / "draft", target):
        (tmp_path / "draft").rename(target)
    remove_if_incomplete(target)
    assert list(target.iterdir()) == []
    assert target.is_dir()


def test_hidden_files_of_others_and_links_stay(tmp_path: Path) -> None:
    outside = tmp_path / "outside"
    outside.mkdir()
    folder = tmp_path / "here"
    folder.mkdir()
    (folder / ".plan.json.ab12cd34").write_text("not ours")
    (folder / "plan.momapos").write_text("not hidden")
    (folder / ".link.momapos").symlink_to(outside)
    write_atomic(folder / "plan.json", b"{}")
    names = {".plan.json.ab12cd34", "plan.momapos", ".link.momapos", "plan.json"}
    assert {path.name for path in folder.iterdir()} == names
    assert outside.is_dir()


def test_a_file_has_the_permissions_of_the_users_other_files(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        write_atomic(tmp_path / "a.json", b"{}")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "a.json").stat().st_mode) == 0o640


def test_threads_write_one_file_whole_and_leave_nothing(tmp_path: Path) -> None:
    contents = [bytes([k]) * 50_000 for k in range(8)]
    path = tmp_path / "new" / "file.bin"
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda data: write_atomic(path, data), contents * 5))
    assert path.read_bytes() in contents
    assert list(path.parent.iterdir()) == [path]


def test_a_failure_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> int:
        raise OSError("disk full")

    with monkeypatch.context() as patch:
        patch.setattr(files.os, "write", refuse)
        with pytest.raises(OSError, match="disk full"):
            write_atomic(tmp_path / "a.json", b"{}")
    with suppress(ZeroDivisionError), temporary_folder(tmp_path, "room") as folder:
        (folder / "a").write_text("")
        raise ZeroDivisionError
    assert list(tmp_path.iterdir()) == []
