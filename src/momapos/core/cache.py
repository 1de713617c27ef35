"""A folder that caches expensive results under keys made from their inputs.

Entries carry a checksum and are written atomically. So damaged, truncated or foreign files are
never used, and several processes may share a folder.
"""

from __future__ import annotations

import hashlib
import logging
import os
import re
from pathlib import Path

import numpy as np

from .errors import FileFormatError
from .files import read_bytes_bounded, write_atomic

log = logging.getLogger(__name__)
MAX_ENTRY_BYTES = 500_000_000
_MAGIC = b"momapos-cache 1\n"
_KEY = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,199}")


def default_cache_dir() -> Path:
    """Return $MOMAPOS_CACHE, or `momapos` in the user's cache folder (XDG)."""
    if folder := os.environ.get("MOMAPOS_CACHE"):
        return Path(folder).expanduser()
    home = os.environ.get("XDG_CACHE_HOME")
    # The XDG specification asks to ignore relative paths.
    root = Path(home) if home and Path(home).is_absolute() else Path.home() / ".cache"
    return root / "momapos"


def content_key(*parts: object) -> str:
    """Hash values into a key of 32 hexadecimal digits.

    Args:
        parts: Bytes and arrays, hashed by content; other values, such as numbers, strings, tuples
            and frozen records of these, by `repr`.
    """
    digest = hashlib.sha256()
    for part in parts:
        if isinstance(part, np.ndarray):
            kind = f"array {part.dtype.str} {part.shape}"
            data = np.ascontiguousarray(part).tobytes()
        elif isinstance(part, bytes):
            kind, data = "bytes", part
        else:
            kind, data = type(part).__name__, repr(part).encode()
        # The length keeps neighbors apart: ("ab", "c") is not ("a", "bc").
        digest.update(f"{kind} {len(data)}\n".encode())
        digest.update(data)
    return digest.hexdigest()[:32]


class Cache:
    """Checksummed entries in a folder."""

    def __init__(self, folder: Path | None = None) -> None:
        """Set the folder; None for the user's, looked up at each use."""
        self._folder = folder

    @property
    def folder(self) -> Path:
        """Return the folder."""
        return default_cache_dir() if self._folder is None else self._folder

    def path(self, key: str) -> Path:
        """Return the file of an entry.

        Raises:
            ValueError: The key is not a portable file name.
        """
        if not _KEY.fullmatch(key):
            raise ValueError(f"cache key {key!r} must be letters, digits, '.', '_' and '-'")
        return self.folder / key

    def get(self, key: str) -> bytes | None:
        """Return the content of an entry, or None if it is missing or damaged."""
        path = self.path(key)
        if not path.exists():
            return None
        try:
            data = read_bytes_bounded(path, MAX_ENTRY_BYTES)
        except FileFormatError as error:
            log.warning("ignoring a cache entry: %s", error)
            return None
        head = len(_MAGIC) + 32
        body = data[head:]
        whole = data.startswith(_MAGIC) and data[len(_MAGIC) : head] == _digest(key, body)
        if not whole:
            log.warning("%s: ignoring a damaged or foreign cache entry", path)
            return None
        return body

    def put(self, key: str, data: bytes) -> Path:
        """Store an entry, replacing an older one; return its file."""
        path = self.path(key)
        write_atomic(path, _MAGIC + _digest(key, data) + data)
        return path


USER_CACHE = Cache()
"""The cache in the user's folder; `load_scene` and `load_robot` use it unless given another."""


def _digest(key: str, data: bytes) -> bytes:
    """Return a checksum of key and content, so that a renamed file does not match."""
    return hashlib.sha256(key.encode() + b"\n" + data).digest()
