"""Read the records of files: every value is checked, and each message names its place.

A record is a class of msgspec, of which checks, known keys and the schema of a file follow.
"""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, TypeAlias, TypeVar, get_args, get_origin, get_type_hints

import msgspec

from .arguments import UNIONS, shown, type_words
from .errors import FileFormatError, InputError, MomaposError

Record = TypeVar("Record")
REFUSALS = (msgspec.ValidationError, InputError, UnicodeEncodeError)
"""Errors of converting unusable values; the last one is of half a character."""


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


class FileRecord(msgspec.Struct):
    """Base of records of files: their texts are printable and not blank."""

    def __post_init__(self) -> None:
        for name in self.__struct_fields__:
            value = getattr(self, name)
            if isinstance(value, str) and (value.isspace() or not value.isprintable()):
                raise ValueError(f"{name} must be a printable text, not {shown(value)}")


def read_record(
    data: Any,
    record: type[Record],
    place: Callable[[Parents], str],
    error: type[MomaposError] = FileFormatError,
) -> Record:
    """Return a record of the content of a file.

    Args:
        data: The content; further keys are left out.
        record: The record.
        place: Returns where a value stands, in words, such as "robot.toml: base.max_speed".
        error: The error of unusable content.

    Raises:
        MomaposError: As `error`: a value is missing or unusable; the message says where it stands
            and what would be right.
    """
    try:
        return msgspec.convert(data, record)
    except REFUSALS:
        parents, words = _mistake(data, record, ())
    raise error(f"{place(parents)} {words}")


def dotted(parents: Parents) -> str:
    """Return where a value stands in a file: keys and names with dots, and indices."""
    return "".join(
        f"[{part}]" if isinstance(part, int) else f".{part:.80}" for part in parents
    ).removeprefix(".")


def _mistake(value: Any, kind: Any, parents: Parents) -> tuple[Parents, str]:
    """Return where the innermost value that its type refuses stands, and what is wrong with it."""
    inner = _inner(kind)
    members, args = _members(inner), get_args(inner)
    parts: Mapping[str | int, Any] = {}
    error = _refusal(value, kind)
    if isinstance(error, msgspec.ValidationError) and " - at `" not in str(error):
        pass  # the value itself is refused, such as a list of too many items
    elif isinstance(value, Mapping) and members:
        parts = {name: members[name][0] for name in members if name in value}
    elif isinstance(value, Mapping) and args:
        parts = {ChosenName(name): args[1] for name in value}
    elif isinstance(value, list) and (get_origin(inner) is list or args[-1:] == (...,)):
        parts = dict.fromkeys(range(len(value)), args[0])
    for part, its in parts.items():
        if _refusal(value[part], its) is not None:
            return _mistake(value[part], its, (*parents, part))
    if not (isinstance(value, Mapping) and members):
        return parents, f"must be {type_words(kind)}, not {shown(value)}"
    for name, (its, required) in members.items():
        if required and name not in value:
            near = difflib.get_close_matches(name, set(value) - set(members), n=1)
            hint = f"did you mean it by {near[0]!r}?" if near else f"it must be {type_words(its)}"
            return (*parents, name), f"is missing; {hint}"
    if getattr(getattr(inner, "__struct_config__", None), "forbid_unknown_fields", False):
        for name in value:
            if name not in members:
                return (*parents, name), f"is not known; known are {', '.join(members)}"
    words = str(error).removeprefix(f"{inner.__name__}.")
    name, _, rest = words.partition(" ")
    return ((*parents, name), rest) if name in members else (parents, words)


def _refusal(value: Any, kind: Any) -> Exception | None:
    """Return why a type refuses a value; None if it does not."""
    try:
        msgspec.convert(value, kind)
    except REFUSALS as error:
        return error
    return None


def _inner(kind: Any) -> Any:
    """Return a type without its bounds; of several that which has members or items."""
    if get_origin(kind) is Annotated:
        return _inner(get_args(kind)[0])
    if get_origin(kind) in UNIONS:
        inner = [_inner(one) for one in get_args(kind)]
        return next(
            (one for one in inner if _members(one) or get_origin(one) in (dict, list, tuple)),
            inner[0],
        )
    return kind


def _members(kind: Any) -> Mapping[str, tuple[Any, bool]]:
    """Return type and need of the members of a record by their names in a file."""
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        fields = msgspec.structs.fields(kind)
        return {field.encode_name: (field.type, field.required) for field in fields}
    if not dataclasses.is_dataclass(kind):
        return {}
    hints = get_type_hints(kind, include_extras=True)
    nothing = dataclasses.MISSING
    return {
        field.name: (hints[field.name], field.default is field.default_factory is nothing)
        for field in dataclasses.fields(kind)
    }


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
