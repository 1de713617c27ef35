"""Parse the arguments of a command; report a mistake in one line."""

from __future__ import annotations

import contextlib
import functools
import inspect
import io
import os
import re
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from typing import Any, get_type_hints

from momapos.core import InputError

from .bounds import MIN_TIMEOUT, ended_after
from .options import SecondsArg

TIMEOUT = "timeout"
"""Name of the option for the time limit of a command."""
_FRAME = re.compile(r"\x1b\[[0-9;]*m|[\u2500-\u257f]|-{8,}")
"""Colors of tyro's messages, and lines around them and between their parts."""
_NO_NUMBER = re.compile(
    r"Error parsing (?P<option>\S+): (?:no type matching \{None\}\|(?P<kind>INT|FLOAT) could be "
    r"instantiated from \[['\"]|(?P<whole>invalid literal for int)[^:]*: '"
    r"|could not convert string to float: ')(?P<given>.*)['\"]\]?"
)
"""Messages of tyro about a word that is no number."""


def with_time_limit(command: Callable[..., int]) -> Callable[..., int]:
    """Return a command with the option --timeout, unless it has one of its own for its search."""
    signature = inspect.signature(command)
    every = signature.parameters.items()
    if any(name == TIMEOUT or hasattr(one.default, TIMEOUT) for name, one in every):
        return command

    @functools.wraps(command)
    def limited(*values: Any, timeout: float | None = None, **options: Any) -> int:
        if timeout is None:
            return command(*values, **options)
        from momapos.core import finite_number  # msgspec

        with ended_after(finite_number(f"--{TIMEOUT}", timeout, MIN_TIMEOUT)):
            return command(*values, **options)

    kind, hint = inspect.Parameter.KEYWORD_ONLY, SecondsArg
    option = inspect.Parameter(TIMEOUT, kind, default=None, annotation=hint)
    limited.__signature__ = signature.replace(  # type: ignore[attr-defined]
        parameters=[*signature.parameters.values(), option]
    )
    del limited.__wrapped__  # tyro would read the options of the command itself
    limited.__annotations__ = {**get_type_hints(command, include_extras=True), TIMEOUT: hint}
    text = inspect.cleandoc(command.__doc__ or "")
    head = "" if "\nArgs:\n" in text else "\n\nArgs:"
    limited.__doc__ = f"{text}{head}\n    {TIMEOUT}: Processor time after which the command ends."
    return limited


def parse(command: Callable[..., int], args: Sequence[str], prog: str) -> Callable[[], int]:
    """Parse the arguments of a command, and return the call.

    Args:
        command: Its parameters are the options.
        args: The words after its name.
        prog: Its name, for messages.

    Raises:
        InputError: The arguments are wrong; the message says what is wrong, and where help is.
        SystemExit: The help text was requested and is printed.
    """
    import tyro

    # tyro breaks the help text at each indented line of the docstring.
    command.__doc__ = re.sub(r"\n {8,}", " ", inspect.cleandoc(command.__doc__ or ""))

    @functools.wraps(command)
    def call(*values: Any, **options: Any) -> Callable[[], int]:
        return lambda: command(*values, **options)

    printed, plain = io.StringIO(), io.StringIO()
    # tyro colors help on a terminal, and does not know https://no-color.org.
    shown = contextlib.redirect_stdout(plain) if os.environ.get("NO_COLOR") else nullcontext()
    try:
        with contextlib.redirect_stderr(printed), shown:
            ready: Callable[[], int] = tyro.cli(
                call, args=args, prog=prog, config=(tyro.conf.FlagCreatePairsOff,)
            )
    except SystemExit as leaving:
        if leaving.code in (0, None):
            print(plain.getvalue(), end="")
            raise
        raise InputError(f"{in_one_line(printed.getvalue())}; see {prog} --help") from None
    return ready


def in_one_line(printed: str) -> str:
    """Reduce a framed message of tyro to one line, without title, advice and frame.

    Args:
        printed: As tyro prints it: a title, then parts that lines divide.
    """
    parts = [""]
    for line in printed.splitlines()[1:]:
        words = _FRAME.sub("", line).strip()
        if words:
            parts[-1] = f"{parts[-1]} {words}".strip()
        elif parts[-1]:
            parts.append("")
    what = re.sub(r"'None', |, 'None'(?=\))", "", parts[0].rstrip("."))  # an option left out
    what = _NO_NUMBER.sub(_not_a_number, what)
    meant = [
        flag for part in parts if part.startswith("Perhaps you meant") for flag in _flags(part)
    ]
    return f"{what}; did you mean {' or '.join(meant)}?" if meant else what


def _not_a_number(found: re.Match[str]) -> str:
    whole = found["whole"] or found["kind"] == "INT"
    return f"{found['option']} {found['given']!r} is not a {'whole ' if whole else ''}number"


def _flags(text: str) -> list[str]:
    return list(dict.fromkeys(re.findall(r"(?<!\S)--[a-z][\w-]*", text)))
