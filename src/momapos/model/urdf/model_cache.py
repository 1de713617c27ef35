"""What is dear to compute about a model, kept in the cache under the content it came from."""

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
from momapos.core import Cache, content_key, geometry

T = TypeVar("T")
_ARRAY, _RECORD = 1, 2
_PACKAGES = ("urdf", "kinematics", "collision")
"""Packages of `momapos.model` that compute what is cached here."""


def once(
    cache: Cache | None,
    what: str,
    parts: tuple[object, ...],
    compute: Callable[[], T],
    records: tuple[type, ...] = (),
) -> T:
    """Compute a value, or take the one that was computed from the same parts before.

    The key holds the code of kinematics and geometry too, so that no older way to compute it is
    ever believed.

    Args:
        cache: Where values are kept; None: nowhere.
        what: Begins the key.
        parts: All that the value depends on, as `content_key` takes it.
        compute: Makes the value: numbers, texts, arrays, tuples, dictionaries with texts as keys,
            and records of these.
        records: The kinds of records that may be in it.
    """
    if cache is None:
        return compute()
    key = f"{what}-{content_key(_code(), *parts)}"
    data = cache.get(key)
    if data is not None:
        return _thaw(data, {kind.__name__: kind for kind in records})
    value = compute()
    with contextlib.suppress(OSError):  # a cache that cannot be written is no reason to stop
        cache.put(key, freeze(value))
    return value


def freeze(value: object) -> bytes:
    """A value as bytes, the same ones for the same value."""
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
    """Sequences come back as lists; frozen records hold tuples."""
    if isinstance(value, list):
        return tuple(map(_tuples, value))
    if isinstance(value, dict):
        return {key: _tuples(item) for key, item in value.items()}
    return value


@lru_cache(maxsize=1)
def _code() -> str:
    """Version of all that computes what is kept."""
    model = Path(__file__).parents[1]
    folders = (*(model / name for name in _PACKAGES), *map(Path, geometry.__path__))
    files = sorted(file for folder in folders for file in folder.glob("*.py"))
    return content_key(__version__, *(file.read_bytes() for file in files))
