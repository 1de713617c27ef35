"""Methods that are compared, and variants of them: `paper:paper.group=1,importance.k0=1`."""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from typing import Any, get_args, get_type_hints

import msgspec

from momapos.core import InputError, unknown_name
from momapos.planning import PipelineConfig
from momapos.planning.placement import Method

METHODS: tuple[str, ...] = get_args(Method)


def method_config(text: str, timeout: float) -> PipelineConfig:
    """The configuration that a method's name stands for.

    Args:
        text: A method of `momapos place`, alone or followed by a colon and settings of the
            pipeline's configuration, as FIELD=VALUE between commas. A field is written as
            `PipelineConfig` has it, such as `paper.samples`; a value as JSON has it, or as a word.
        timeout: Time to search for one answer [s].

    Raises:
        UnknownNameError: There is no such method or field.
        InputError: It is not written so, or the value is none that the field takes.
    """
    name, colon, rest = text.partition(":")
    if name not in METHODS:
        raise unknown_name("method", name, METHODS, "--methods")
    config = PipelineConfig(timeout=timeout)
    config = replace(config, place=replace(config.place, method=name))  # type: ignore[arg-type]
    for setting in rest.split(",") if colon else ():
        path, equals, value = setting.partition("=")
        if not (path and equals and value):
            raise InputError(
                f"method {text!r}: {setting!r} is not FIELD=VALUE, as in "
                "paper:paper.samples=50,importance.k0=1"
            )
        if path in ("timeout", "place.method"):
            raise InputError(f"method {text!r}: {path} is no setting of a variant")
        config = _with(config, path.split("."), value, f"method {text!r}: {path}")
    return config


def _with(config: Any, path: list[str], text: str, where: str) -> Any:
    name, *rest = path
    known = [item.name for item in fields(config)]
    if name not in known:
        raise unknown_name("setting", name, known, where)
    old = getattr(config, name)
    if is_dataclass(old) != bool(rest):
        what = f"{name} holds settings of its own" if not rest else f"{name} has no parts"
        raise InputError(f"{where}: {what}")
    new = _with(old, rest, text, where) if rest else _value(type(config), name, text, where)
    try:
        return replace(config, **{name: new})
    except InputError as error:
        raise InputError(f"{where}: {error}") from error


def _value(kind: type, name: str, text: str, where: str) -> Any:
    """What a text says, as the field's type has it; several numbers stand between plus signs."""
    wanted = get_type_hints(kind)[name]
    parts = [_plain(part) for part in text.split("+")]
    single = not str(wanted).startswith("tuple")
    try:
        return msgspec.convert(parts[0] if single and len(parts) == 1 else parts, wanted)
    except msgspec.ValidationError as error:
        raise InputError(f"{where}: {text!r:.60} cannot be used: {error}") from error


def _plain(text: str) -> Any:
    try:
        return msgspec.json.decode(text.encode())
    except msgspec.DecodeError:
        return text
