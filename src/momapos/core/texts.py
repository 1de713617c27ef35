"""Show names of untrusted files: on a terminal, in a message, in a figure and in a page.

A name may hold commands of terminals, marks that reverse the direction of a line, half characters,
or what a figure takes for mathematics. Everything that shows a name passes it through here.
"""

from __future__ import annotations

import html
import sys
from typing import Protocol, TypeGuard, runtime_checkable

MAX_MESSAGE_LENGTH = 500
"""Largest number of characters in a message; longer ones lose their middle [-]."""
MAX_NAME_LENGTH = 1000
"""Largest number of characters of a name in a file [-]."""
MAX_LABEL_LENGTH = 300
"""Largest number of characters of a text in a figure [-]."""


@runtime_checkable
class Writable(Protocol):
    """A stream of text."""

    def write(self, text: str, /) -> object: ...
    def flush(self) -> object: ...


def is_name(value: object, longest: int = MAX_NAME_LENGTH) -> TypeGuard[str]:
    """Return whether a value of a file is a name: printable, not blank, and not too long."""
    return (
        isinstance(value, str)
        and len(value) <= longest
        and value.isprintable()
        and bool(value.strip())
    )


def printable(text: str) -> str:
    """Return a text in which `?` replaces what controls a terminal or has no shape.

    Lines stay apart; everything else that `str.isprintable` refuses is replaced: control and
    bidirectional characters, halves of characters, private ones.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c == "\n" else "?" for c in text.replace("\t", " "))


def one_line(text: str) -> str:
    """Convert a message to one printable line of limited length."""
    longest = MAX_MESSAGE_LENGTH
    if len(text) > 8 * longest:  # text quoted from a file may have millions of characters
        text = f"{text[: 4 * longest]} ... {text[-4 * longest :]}"
    text = printable(" ".join(text.split()))
    if len(text) <= longest:
        return text
    return f"{text[: longest * 3 // 5]} ... {text[-longest // 3 :]}"


def label(text: str) -> str:
    """Return a text for a figure: printable, of limited length, and no mathematics."""
    if len(text) > MAX_LABEL_LENGTH:
        text = f"{text[:MAX_LABEL_LENGTH]} ..."
    return printable(text).replace("$", r"\$")


def escape_html(text: str) -> str:
    """Return a text for HTML and SVG: printable, and no markup."""
    return html.escape(printable(text))


def escape_markdown(text: str) -> str:
    """Return a text for Markdown: printable, and no markup."""
    return "".join(f"\\{c}" if c in "\\`*_{}[]<>()#+-.!|" else c for c in printable(text))


def say(
    *words: object, sep: str = " ", end: str = "\n", file: Writable | None = None,
    flush: bool = False,
) -> None:  # fmt: skip
    """Print words for people, as `print` does, without what controls their terminal."""
    stream = sys.stdout if file is None else file
    text = printable(sep.join(map(str, words)))
    encoding = getattr(stream, "encoding", None) or "utf-8"
    print(
        text.encode(encoding, "backslashreplace").decode(encoding),
        end=end,
        file=stream,
        flush=flush,
    )
