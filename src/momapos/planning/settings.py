"""Read settings of nested configurations, from TOML files and from texts such as `paper.group=1`.

A setting names a field by its path: `importance.k0` is `PipelineConfig().importance.k0`. In a TOML
file, a table stands for a nested configuration.
"""

from __future__ import annotations

import ast
import contextlib
import difflib
import inspect
import math
import re
import textwrap
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

import msgspec

from momapos.core import (
    FileFormatError,
    InputError,
    UnknownNameError,
    read_text_bounded,
    shown,
    type_words,
)

MAX_BYTES = 1_000_000
"""Size limit of a settings file [bytes]."""
_FIELD = re.compile(r"(?:--)?(?:[A-Za-z_]\w*\.)*(?P<name>[A-Za-z_][\w-]*)(?P<rest>\s.*)", re.DOTALL)

C = TypeVar("C")
"""A frozen dataclass, nested or not."""


@dataclass(frozen=True)
class Setting:
    """A value for one field of a configuration."""

    path: str
    """The field, such as `importance.k0`."""
    value: Any
    """The value, converted to the field's type."""
    where: str
    """Name of the setting in messages, such as `my.toml: importance.k0`."""


@dataclass(frozen=True)
class FieldHelp:
    """A field of a configuration, for listings."""

    path: str
    value: str
    """Its value, in the syntax of `parse_setting`."""
    text: str
    """Its docstring, on one line."""


def read_settings(file: Path, config: object) -> list[Setting]:
    """Read a TOML file of settings.

    Args:
        file: The file.
        config: The configuration with these fields.

    Raises:
        FileFormatError: The file is missing, too large or not valid TOML.
        UnknownNameError: There is no such field.
        InputError: A value has the wrong type.
    """
    try:
        data = tomllib.loads(read_text_bounded(file, MAX_BYTES))
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise FileFormatError(f"{file}: not valid TOML ({error})") from error
    return list(_from_table(data, config, "", config, str(file)))


def parse_setting(text: str, config: object, source: str) -> Setting:
    """Read a setting in the form FIELD=VALUE.

    A value is JSON or a word; several values are joined by plus signs.

    Args:
        text: The setting, such as `paper.heights=0.5+1.5`.
        config: The configuration with this field.
        source: Prefix of messages, such as `--set`.

    Raises:
        UnknownNameError: There is no such field.
        InputError: The text has another form, or the value has the wrong type.
    """
    path, equals, value = text.partition("=")
    if not (path and equals and value):
        raise InputError(f"{source} {text!r:.80}: write FIELD=VALUE, as in importance.k0=1")
    kind, names = type(config), path.split(".")
    for depth, name in enumerate(names):
        hints = _hints(kind) if is_dataclass(kind) else {}
        if name not in hints:
            if not hints:
                owner = ".".join(names[:depth])
                raise InputError(f"{source} {path}: {owner} is a value and has no fields")
            raise _unknown(path, config, source)
        kind = hints[name]
    where = f"{source} {path}"
    if is_dataclass(kind):
        one = f"{path}.{next(iter(_hints(kind)))}"
        raise InputError(f"{where} has several fields; set one of them, such as {one}")
    return Setting(path, _convert(_reading(value, kind), kind, where, value), where)


def apply_settings(config: C, settings: Iterable[Setting]) -> C:
    """Return a configuration with some fields changed; of several for one field the last counts.

    Raises:
        InputError: A value is out of range; the message names the setting.
    """
    return _build(config, "", {setting.path: setting for setting in settings})


def list_fields(config: object, prefix: str = "") -> Iterator[FieldHelp]:
    """List all fields, nested ones included, in the order in which they are documented."""
    docs = _field_docs(type(config))
    for item in fields(config):  # type: ignore[arg-type]
        path, value = f"{prefix}{item.name}", getattr(config, item.name)
        if is_dataclass(value):
            yield from list_fields(value, f"{path}.")
        else:
            yield FieldHelp(path, _written(value), docs.get(item.name, ""))


def _from_table(
    data: Mapping[str, Any], part: object, prefix: str, config: object, file: str
) -> Iterator[Setting]:
    hints = _hints(type(part))
    for name, value in data.items():
        path = f"{prefix}{name}"
        if name not in hints:
            raise _unknown(path, config, file)
        where, kind = f"{file}: {path}", hints[name]
        if not is_dataclass(kind):
            yield Setting(path, _convert(value, kind, where, value), where)
        elif isinstance(value, dict):
            yield from _from_table(value, getattr(part, name), f"{path}.", config, file)
        else:
            raise InputError(f"{where} must be a table of fields, not {shown(value)}")


def _build(config: C, prefix: str, settings: Mapping[str, Setting]) -> C:
    changes: dict[str, Any] = {}
    for item in fields(config):  # type: ignore[arg-type]
        path, value = f"{prefix}{item.name}", getattr(config, item.name)
        if is_dataclass(value):
            if any(one.startswith(f"{path}.") for one in settings):
                changes[item.name] = _build(value, f"{path}.", settings)
        elif path in settings:
            changes[item.name] = settings[path].value
    if not changes:
        return config
    try:
        return replace(config, **changes)  # type: ignore[type-var]
    except InputError as error:
        given = [settings[prefix + name] for name in changes if prefix + name in settings]
        raise InputError(_named(str(error), prefix, given)) from error


def _named(message: str, prefix: str, given: list[Setting]) -> str:
    """A configuration's message, with the name of the setting in place of the field's."""
    found = _FIELD.fullmatch(message)
    if found is not None:
        path = prefix + found["name"].replace("-", "_")
        for setting in given:
            if setting.path == path:
                return f"{setting.where}{found['rest']}"
    where = given[0].where if len(given) == 1 else prefix.rstrip(".")
    return f"{where}: {message}" if where else message


def _unknown(path: str, config: object, source: str) -> UnknownNameError:
    paths = [item.path for item in list_fields(config)]
    names = {one: one.rpartition(".")[2] for one in paths}
    last = path.rpartition(".")[2]
    close = difflib.get_close_matches(last, set(names.values()), n=3, cutoff=0.6)
    alike = [one for one in paths if names[one] in close]
    near = difflib.get_close_matches(path, alike or paths, n=3, cutoff=0.2 if alike else 0.6)
    tables = dict.fromkeys(one.partition(".")[0] for one in paths)
    hint = f"did you mean {' or '.join(near)}?" if near else f"there are {', '.join(tables)}"
    return UnknownNameError(f"no setting {path!r:.80} in {source}; {hint}")


def _reading(text: str, kind: Any) -> Any:
    """Return the first reading of a text, as plain values, that fits a type."""
    if get_origin(kind) is tuple:
        return [_reading(part, get_args(kind)[0]) for part in text.split("+")]
    readings: list[Any] = [text]
    if text.lower() == "none":
        readings.insert(0, None)
    if text == "inf":
        readings.insert(0, math.inf)
    with contextlib.suppress(msgspec.DecodeError, RecursionError, UnicodeError):
        readings.insert(0, msgspec.json.decode(text.encode()))
    for value in readings:
        try:
            msgspec.convert(value, kind)
        except msgspec.ValidationError:
            continue
        return value
    return text


def _convert(value: Any, kind: Any, where: str, written: Any) -> Any:
    try:
        converted = msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        raise InputError(f"{where} must be {type_words(kind)}, not {shown(written)}") from error
    if isinstance(converted, tuple):
        finite = all(math.isfinite(one) for one in converted if isinstance(one, float))
    else:  # some weights may be inf
        finite = not (isinstance(converted, float) and math.isnan(converted))
    if not finite:
        raise InputError(f"{where} must be {type_words(kind)}, not {shown(written)}")
    return converted


def _written(value: Any) -> str:
    """Return a value as `parse_setting` reads it."""
    if isinstance(value, tuple):
        return "+".join(map(_written, value))
    if value is None or isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, float) else str(value)


def _hints(kind: Any) -> dict[str, Any]:
    """Return the types of a dataclass's fields."""
    hints = get_type_hints(kind)
    return {item.name: hints[item.name] for item in fields(kind)}


def _field_docs(kind: type) -> dict[str, str]:
    """Return the docstrings of a dataclass's fields, from its source."""
    docs: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        if not is_dataclass(base):
            continue
        tree = ast.parse(textwrap.dedent(inspect.getsource(base)))
        assert isinstance(tree.body[0], ast.ClassDef)
        for field, doc in pairwise(tree.body[0].body):
            if (
                isinstance(field, ast.AnnAssign)
                and isinstance(field.target, ast.Name)
                and isinstance(doc, ast.Expr)
                and isinstance(doc.value, ast.Constant)
            ):
                docs[field.target.id] = " ".join(str(doc.value.value).split())
    return docs
