"""Files that a plan names: relative names, hashes, atomic writing."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

from momapos.core import InputError, read_bytes_bounded, resolved, write_atomic

MAX_HASHED_BYTES = 50_000_000
MAX_PARENTS = 3
"""Files in up to this many folders above the plan get relative names [-]."""


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically.

    Raises:
        InputError: The file cannot be written.
    """
    try:
        write_atomic(path, text.encode())
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from error


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file, in hexadecimal digits."""
    return sha256_of(read_bytes_bounded(path, MAX_HASHED_BYTES, error=InputError))


def sha256_of(data: bytes) -> str:
    """Return the SHA-256 of bytes, in hexadecimal digits."""
    return hashlib.sha256(data).hexdigest()


def portable_name(name: str, plan: Path, what: str) -> str:
    """Return a plan's name for a file: relative if the file is near, otherwise absolute.

    Raises:
        InputError: The file does not exist, so the plan could not be verified.
    """
    target, folder = Path(os.path.abspath(name)), resolved(plan).parent
    if not target.is_file():
        raise InputError(
            f"{plan}: {what} {name!r} does not exist; load it from a file, so that the plan can be "
            "verified"
        )
    near = [folder, *list(folder.parents)[:MAX_PARENTS]]
    shared = [parent for parent in near if parent.parent != parent]
    if any(target.is_relative_to(parent) for parent in shared):
        relative = Path(os.path.relpath(target, folder))
        if (folder / relative).exists() and (folder / relative).samefile(target):
            return relative.as_posix()
    return str(target)
