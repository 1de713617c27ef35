"""From words to a call of a command; wrong words are told in one line."""

from __future__ import annotations

import contextlib
import functools
import io
import re
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from momapos.core import InputError

if TYPE_CHECKING:
    from tyro.constructors import ConstructorRegistry

_FRAME = re.compile(r"\x1b\[[0-9;]*m|[\u2500-\u257f]|-{8,}")
"""Colors of tyro's messages, and lines around them and between their parts."""


def parse(
    command: Callable[..., int],
    args: Sequence[str],
    prog: str,
    registry: ConstructorRegistry | None = None,
) -> Callable[[], int]:
    """Read the arguments of a command, and leave it to be called.

    Args:
        command: Its parameters are the options.
        args: The words after its name.
        prog: Its name, for messages.
        registry: Further rules for types of parameters.

    Raises:
        InputError: The words make no call; says what is wrong, and where help is.
        SystemExit: Help was asked for and is printed.
    """
    import tyro

    @functools.wraps(command)
    def call(*values: Any, **options: Any) -> Callable[[], int]:
        return lambda: command(*values, **options)

    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            ready: Callable[[], int] = tyro.cli(call, args=args, prog=prog, registry=registry)
    except SystemExit as leaving:
        if leaving.code in (0, None):
            raise
        raise InputError(f"{in_one_line(said.getvalue())}; see {prog} --help") from None
    return ready


def in_one_line(said: str) -> str:
    """What a framed message says, without its title, advice and frame.

    Args:
        said: As tyro prints it: a title, then parts that lines divide.
    """
    parts = [""]
    for line in said.splitlines()[1:]:
        words = _FRAME.sub("", line).strip()
        if words:
            parts[-1] = f"{parts[-1]} {words}".strip()
        elif parts[-1]:
            parts.append("")
    what = parts[0].rstrip(".")
    meant = [
        flag for part in parts if part.startswith("Perhaps you meant") for flag in _flags(part)
    ]
    return f"{what}; did you mean {' or '.join(meant)}?" if meant else what


def _flags(text: str) -> list[str]:
    """The options that a text names, each once."""
    return list(dict.fromkeys(re.findall(r"(?<!\S)--[a-z][\w-]*", text)))
