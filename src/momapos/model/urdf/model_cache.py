"""Cache expensive values of a model under the content that they are computed from."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import numpy as np

from momapos import __version__
from momapos.core import Cache, content_key, geometry, look

T = TypeVar("T")
_ARRAY, _RECORD = 1, 2
_PACKAGES = ("urdf", "kinematics", "collision")
"""Packages of `momapos.model` that compute cached values."""


def once(
    cache: Cache | None,
    what: str,
    parts: tuple[object, ...],
    compute: Callable[[], T],
    records: tuple[type, ...] = (),
) -> T:
    """Compute a value, or return the one cached for the same parts.

    The key includes the code of kinematics and geometry, so that code changes invalidate values.

    Args:
        cache: The cache; None to always compute.
        what: Prefix of the key.
        parts: Everything that the value depends on, see `content_key`.
        compute: Returns the value: numbers, strings, arrays, tuples, dictionaries with string
            keys, and records of these.
        records: Record types that the value may contain.
    """
    look()
    if cache is None:
        return compute()
    key = f"{what}-{content_key(_code(), *parts)}"
    data = cache.get(key)
    if data is not None:
        return _thaw(data, {kind.__name__: kind for kind in records})
    value = compute()
    with contextlib.suppress(OSError):  # a read-only cache is not an error
        cache.put(key, freeze(value))
    return value


def freeze(value: object) -> bytes:
    """Serialize a value deterministically."""
    return msgspec.msgpack.encode(_plain(value))


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        array = np.ascontiguousarray(value)
        content = (array.dtype.str, array.shape, array.tobytes())
        return msgspec.msgpack.Ext(_ARRAY, msgspec.msgpack.encode(content))
    if dataclasses.is_dataclass(value):
        fields = {f.name: getattr(value, f.name) for f in dataclasses.fields(value) if f.init}
        return msgspec.msgpack.Ext(_RECORD, freeze((type(value).__name__, fields)))
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return float(value) if isinstance(value, float) else value  # numpy's floats are floats


def _thaw(data: bytes, records: dict[str, type]) -> Any:
    def extension(code: int, content: memoryview) -> Any:
        if code == _ARRAY:
            dtype, shape, raw = msgspec.msgpack.decode(content)
            return np.frombuffer(raw, dtype).reshape(shape).copy()
        name, fields = _thaw(bytes(content), records)
        return records[name](**fields)

    return _tuples(msgspec.msgpack.decode(data, ext_hook=extension))


def _tuples(value: Any) -> Any:
    """Convert lists to tuples, as in frozen records."""
    if isinstance(value, list):
        return tuple(map(_tuples, value))
    if isinstance(value, dict):
        return {key: _tuples(item) for key, item in value.items()}
    return value


@lru_cache(maxsize=1)
def _code() -> str:
    """Return a hash of all code that computes cached values."""
    model = Path(__file__).parents[1]
    folders = (*(model / name for name in _PACKAGES), *map(Path, geometry.__path__))
    files = sorted(file for folder in folders for file in folder.glob("*.py"))
    return content_key(__version__, *(file.read_bytes() for file in files))
