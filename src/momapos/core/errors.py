"""Errors for unusable input, and how names from untrusted files are shown.

Each message of an error is one line: what is wrong, where, and what would be right. The command
line prints it and exits with status 2.

A name may hold commands of terminals, marks that reverse the direction of a line, half characters,
or what a figure takes for mathematics. Everything that shows a name passes it through here.
"""

from __future__ import annotations

import difflib
import html
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Literal, Protocol, TypeGuard, runtime_checkable

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


Extra = Literal[
    "bench", "film", "hdf5", "kitchens", "parquet", "physics", "scan", "torch", "usd", "view",
    "xacro",
]  # fmt: skip
"""Names of the package's extras."""
REQUIREMENTS: dict[Extra, tuple[str, ...]] = {
    "bench": ("distributed>=2024.8",),
    "film": ("av>=14",),
    "hdf5": ("h5py>=3.10",),
    "kitchens": ("scene-synthesizer>=1.0",),
    "parquet": ("pyarrow>=15",),
    "physics": ("mujoco>=3.14", "pillow>=10.3"),
    "scan": ("onnxruntime>=1.18", "pillow>=10.3", "rosbags>=0.11"),
    "torch": ("torch>=2.10,<2.14",),
    "usd": ("usd-core>=25.5",),
    "view": ("viser>=1.1,<1.2",),
    "xacro": ("xacrodoc>=2.0",),
}
"""Packages of each extra, as in pyproject.toml."""


class MomaposError(Exception):
    """Base class of momapos errors; its message is always one line."""

    def __str__(self) -> str:
        return one_line(super().__str__())


class InputError(MomaposError):
    """Unusable input."""


class FileFormatError(InputError):
    """A file is missing, unreadable, damaged, or of the wrong format or version."""


class UrdfError(FileFormatError):
    """A URDF is unusable: malformed, malicious, or not a tree."""


class SceneError(InputError):
    """A scene is inconsistent or does not contain what was requested."""


class RobotError(InputError):
    """A robot file is inconsistent with itself or with its URDF."""


class TaskError(InputError):
    """A task does not fit the scene or the robot."""


class TaskDoneError(TaskError):
    """Nothing is left to do: the part is where the task would move it."""


class UnknownNameError(InputError):
    """A name does not exist; the message suggests similar ones."""


class OutOfTimeError(MomaposError):
    """A time limit ended the work before there was an answer."""


class MissingExtraError(MomaposError):
    """An optional package is not installed; the message tells how to install it."""


@contextmanager
def require(extra: Extra) -> Iterator[None]:
    """Guard the import of an extra's packages, as in `with require("scan"): import PIL`.

    Raises:
        MissingExtraError: A package is not installed; the message tells how to install it.
    """
    try:
        yield
    except ImportError as error:
        name = error.name.partition(".")[0] if error.name else "a package"
        raise MissingExtraError(f"{name} is not installed; {install_hint(extra)}") from error


def install_hint(extra: Extra) -> str:
    """Return the command that installs the packages of an extra."""
    names = (
        f"'{requirement}'" if "<" in requirement else requirement.partition(">")[0]
        for requirement in REQUIREMENTS[extra]
    )
    return f"pip install {' '.join(names)}"


def unknown_name(kind: str, name: str, known: Iterable[str], where: str) -> UnknownNameError:
    """Build an error for a name that does not exist; its message suggests similar names.

    Args:
        kind: Kind of the named item, e.g. "object".
        name: The unknown name.
        known: Existing names.
        where: Where they exist, e.g. "scene kitchen".
    """
    names = sorted(known)
    near = difflib.get_close_matches(name, names, n=3, cutoff=0.4)
    offer = near or names[:12]
    more = "" if near or len(names) <= 12 else f" and {len(names) - 12} more"
    hint = f"did you mean {', '.join(offer)}?" if near else f"it has {', '.join(offer)}{more}"
    return UnknownNameError(f"no {kind} {name!r} in {where}; {hint if names else 'it has none'}")
