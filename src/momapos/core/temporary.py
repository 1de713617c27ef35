"""Temporary files and folders that the next run removes if this one is killed.

Each is locked while its process lives, and named so that a later run recognizes it.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import secrets
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

SUFFIX = ".momapos"
"""Ending of the names of temporary files and folders, which begin with a dot."""
INCOMPLETE = f".incomplete{SUFFIX}"
"""Name of the file that marks a folder as incomplete."""
_RANDOM_BYTES = 6


def write_atomic(path: Path, data: bytes) -> None:
    """Write a file atomically, creating its folder: readers see the old or the new content."""
    path.parent.mkdir(parents=True, exist_ok=True)
    remove_abandoned(path.parent)
    with _locked(path.parent, path.name, folder=False) as (temporary, handle):
        view = memoryview(data)
        while len(view):
            view = view[os.write(handle, view) :]
        os.fsync(handle)
        temporary.replace(path)


@contextmanager
def temporary_folder(parent: Path, name: str) -> Iterator[Path]:
    """Make a folder in another one, and remove it at the end.

    Args:
        parent: The other folder.
        name: What it is for; part of its name.
    """
    remove_abandoned(parent)
    with _locked(parent, name, folder=True) as (temporary, _):
        yield temporary


def remove_abandoned(folder: Path) -> None:
    """Remove the temporary files and folders that killed processes left in a folder."""
    try:
        with os.scandir(folder) as entries:
            names = [e.name for e in entries if e.name.startswith(".") and e.name.endswith(SUFFIX)]
    except OSError:
        return
    for path in (folder / name for name in names if name != INCOMPLETE):
        _remove_if_unused(path, path)


@contextmanager
def incomplete(folder: Path, final: Path) -> Iterator[None]:
    """Mark a new folder as incomplete during a block, which renames it and completes it.

    Args:
        folder: The folder, before the block renames it.
        final: Its name after that.
    """
    handle = os.open(folder / INCOMPLETE, os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o666)
    try:
        _lock(handle)
        yield
        with contextlib.suppress(FileNotFoundError):
            (final / INCOMPLETE).unlink()
    finally:
        os.close(handle)


def remove_if_incomplete(folder: Path) -> None:
    """Remove a folder that a killed process left incomplete."""
    if not folder.is_symlink():
        _remove_if_unused(folder / INCOMPLETE, folder)


@contextmanager
def _locked(parent: Path, name: str, *, folder: bool) -> Iterator[tuple[Path, int]]:
    """Make a temporary file or folder, locked and open; remove what is left of it at the end."""
    while True:
        path = parent / f".{name[:100]}.{secrets.token_hex(_RANDOM_BYTES)}{SUFFIX}"
        if folder:
            path.mkdir()
            flags = os.O_RDONLY | os.O_DIRECTORY
        else:
            flags = os.O_RDWR | os.O_CREAT | os.O_EXCL
        try:
            handle = os.open(path, flags | os.O_CLOEXEC, 0o666)
        except FileNotFoundError:  # another process took the new folder for an abandoned one
            continue
        _lock(handle)
        if os.fstat(handle).st_nlink:
            break
        os.close(handle)
    try:
        yield path, handle
    finally:
        _remove(path)
        os.close(handle)


def _lock(handle: int) -> None:
    with contextlib.suppress(OSError):  # the file system has no locks
        fcntl.flock(handle, fcntl.LOCK_EX)


def _remove_if_unused(locked: Path, path: Path) -> None:
    """Remove a file or folder unless a living process holds a lock, or that is unknown."""
    try:
        handle = os.open(locked, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError:
        return
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        _remove(path)  # before the lock is free, for which its maker waits
    except OSError:
        return
    finally:
        os.close(handle)


def _remove(path: Path) -> None:
    with contextlib.suppress(OSError):
        if stat.S_ISDIR(path.lstat().st_mode):
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink()
