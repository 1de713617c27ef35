"""Find keys of a file that its record does not have, at every depth."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, TypeAlias

import msgspec


@dataclass(frozen=True)
class Named:
    """A mapping whose keys are names that the user chooses, such as joints."""

    value: Keys


Keys: TypeAlias = Mapping[str, Any] | Named | None
"""Known keys of a value, or of each item of a list, with those of their values; None for values
without keys."""


class ChosenName(str):
    """A name that the user chose, among the parents of a key."""


Parents: TypeAlias = tuple[str | int, ...]
"""Where a key stands: keys, names and indices from the top of the file."""


@cache
def keys_of(record: type[msgspec.Struct]) -> Mapping[str, Keys]:
    """Return the keys of a record in a file, at every depth; those of dataclasses are left out."""
    keys = _keys(msgspec.inspect.type_info(record))
    assert isinstance(keys, Mapping)
    return keys


def _keys(kind: msgspec.inspect.Type) -> Keys:
    if isinstance(kind, msgspec.inspect.StructType):
        return {field.encode_name: _keys(field.type) for field in kind.fields}
    if isinstance(kind, msgspec.inspect.DictType):
        return Named(_keys(kind.value_type))
    if isinstance(kind, msgspec.inspect.ListType):
        return _keys(kind.item_type)
    if isinstance(kind, msgspec.inspect.UnionType):
        return next((keys for keys in map(_keys, kind.types) if keys is not None), None)
    return None


def unknown_keys(
    data: Any, keys: Keys, parents: Parents = ()
) -> Iterator[tuple[Parents, str, tuple[str, ...]]]:
    """Yield the parents of each unknown key, the key, and the keys that are known there.

    Args:
        data: Content of a file.
        keys: The keys that it may have.
        parents: Where `data` stands in the file.
    """
    if keys is None:
        return
    if isinstance(data, list):
        for index, item in enumerate(data):
            yield from unknown_keys(item, keys, (*parents, index))
    elif isinstance(data, Mapping) and isinstance(keys, Named):
        for name, value in data.items():
            yield from unknown_keys(value, keys.value, (*parents, ChosenName(name)))
    elif isinstance(data, Mapping) and isinstance(keys, Mapping):
        for key in sorted(set(data) - set(keys)):
            yield parents, key, tuple(sorted(keys))
        for key in (known for known in keys if known in data):
            yield from unknown_keys(data[key], keys[key], (*parents, key))
