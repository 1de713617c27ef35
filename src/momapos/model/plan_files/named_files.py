"""The files that a plan names, and how they are written."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

from momapos.core import InputError, read_bytes_bounded, write_atomic

MAX_HASHED_BYTES = 50_000_000
MAX_PARENTS = 3
"""Files are named relative to the plan up to this many folders above it."""


def write_text(path: Path, text: str) -> None:
    """Write a file of a plan, all of it or nothing.

    Raises:
        InputError: It cannot be written.
    """
    try:
        write_atomic(path, text.encode())
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from error


def sha256(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal digits."""
    data = read_bytes_bounded(path, MAX_HASHED_BYTES, error=InputError)
    return sha256_of(data)


def sha256_of(data: bytes) -> str:
    """SHA-256 of bytes, in hexadecimal digits."""
    return hashlib.sha256(data).hexdigest()


def portable_name(name: str, plan: Path, what: str) -> str:
    """How a plan names a file: relative to its folder where that is near, else in full.

    Raises:
        InputError: There is no such file, so that nobody could verify the plan.
    """
    target, folder = Path(os.path.abspath(name)), plan.resolve().parent
    if not target.is_file():
        raise InputError(
            f"{plan}: the plan names {what} as {name!r}, which does not exist; "
            "load it from a file, so that the plan can be verified"
        )
    near = [folder, *list(folder.parents)[:MAX_PARENTS]]
    shared = [parent for parent in near if parent.parent != parent]
    if any(target.is_relative_to(parent) for parent in shared):
        relative = Path(os.path.relpath(target, folder))
        if (folder / relative).exists() and (folder / relative).samefile(target):
            return relative.as_posix()
    return str(target)
