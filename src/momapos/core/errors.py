"""The errors that momapos raises on purpose.

Every one of them says in one line what is wrong, where, and what would be right.
The command line prints that line and exits with status 2.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Literal

Extra = Literal[
    "bench", "film", "kitchens", "parquet", "physics", "scan", "torch", "usd", "view", "xacro"
]  # fmt: skip
"""The extras of the package, each with the packages that one kind of work needs."""

LONGEST = 500
"""Messages have at most so many characters; what is cut is the middle."""


def one_line(text: str) -> str:
    """A message as one line that a terminal can show: no control characters, not endless."""
    if len(text) > 8 * LONGEST:  # what a file says may be millions of characters
        text = f"{text[: 4 * LONGEST]} ... {text[-4 * LONGEST :]}"
    text = "".join(c if c.isprintable() else "?" for c in " ".join(text.split()))
    if len(text) <= LONGEST:
        return text
    return f"{text[: LONGEST * 3 // 5]} ... {text[-LONGEST // 3 :]}"


class MomaposError(Exception):
    """Base of all errors raised on purpose; its message is one line, whatever it quotes."""

    def __str__(self) -> str:
        return one_line(super().__str__())


class InputError(MomaposError):
    """Something given from outside cannot be used."""


class FileFormatError(InputError):
    """A file is missing, unreadable, of the wrong format or version, or damaged."""


class UrdfError(FileFormatError):
    """A URDF cannot be used: malformed, hostile, or not a tree."""


class SceneError(InputError):
    """A scene contradicts itself, or does not hold what is asked for."""


class RobotError(InputError):
    """A robot file contradicts itself or its URDF."""


class TaskError(InputError):
    """A task cannot be asked of this scene and robot."""


class UnknownNameError(InputError):
    """A name that does not exist; the message offers the nearest ones."""


class MissingExtraError(MomaposError):
    """An optional package is not installed; the message names the extra."""


def refuse_below(config: object, least: float, *names: str) -> None:
    """Refuse fields of a configuration that are less than something, or no finite number.

    Raises:
        InputError: One is; the message names its option.
    """
    for name in names:
        value = getattr(config, name)
        if not least <= value < math.inf:
            raise InputError(
                f"--{name.replace('_', '-')} must be at least {least:g}, not {value:g}"
            )


@contextmanager
def require(extra: Extra) -> Iterator[None]:
    """Import packages that an extra brings, as in `with require("scan"): import PIL`.

    Raises:
        MissingExtraError: One of them is not installed; the message says how to get it.
    """
    try:
        yield
    except ImportError as error:
        name = error.name.partition(".")[0] if error.name else "a package"
        raise MissingExtraError(
            f"{name} is not installed; pip install 'momapos[{extra}]'"
        ) from error


def unknown_name(kind: str, name: str, known: Iterable[str], where: str) -> UnknownNameError:
    """Build the error for a name that does not exist.

    Args:
        kind: What is named, e.g. "object".
        name: The name that was given.
        known: The names that exist.
        where: Where they exist, e.g. "scene kitchen".

    Returns:
        An error whose message lists the nearest names first.
    """
    names = sorted(known)
    near = difflib.get_close_matches(name, names, n=3, cutoff=0.4)
    offer = near or names[:12]
    more = "" if near or len(names) <= 12 else f" and {len(names) - 12} more"
    hint = f"did you mean {', '.join(offer)}?" if near else f"it has {', '.join(offer)}{more}"
    return UnknownNameError(f"no {kind} {name!r} in {where}; {hint if names else 'it has none'}")
