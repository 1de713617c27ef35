"""Which format of another program a file has, as its content says."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from momapos.core import open_regular

if TYPE_CHECKING:
    from .imported_room import Room

Kind = Literal["MJCF", "MoveIt", "SDF", "USD"]
_ROOTS: dict[str, Kind] = {"mujoco": "MJCF", "sdf": "SDF"}
"""Formats by the root element of their XML."""
_FIRST = re.compile(
    r"\s*(?:<\?.*?\?>\s*|<!--.*?-->\s*|<!DOCTYPE[^>\[]*>\s*)*<([A-Za-z][\w.-]*)", re.S
)
_PLANNING_SCENE = re.compile(r"[^\n]*\n\s*(\*\s|\.\s*\Z)")
"""A name, then an object or the end."""
_USD = ("#usda", "PXR-USDC")
_LOOKED_AT = 1 << 16
"""How much of a file tells what it is [bytes]."""


def foreign_kind(text: str) -> Kind | None:
    """The format of another program that a text begins in; None where it is none that is known."""
    text = text.lstrip("\ufeff")
    if text.startswith(_USD):
        return "USD"
    first = _FIRST.match(text)
    if first is not None:
        return _ROOTS.get(first[1])
    return "MoveIt" if _PLANNING_SCENE.match(text) else None


def kind_of_file(path: Path) -> Kind | None:
    """The format of a file, as `foreign_kind` tells it.

    Raises:
        FileFormatError: It cannot be read.
    """
    with open_regular(path) as file:
        return foreign_kind(file.read(_LOOKED_AT).decode("utf-8", errors="replace"))


def read_room(kind: Kind, path: Path, root: Path | None) -> Room:
    """Read a room in a format of another program.

    Args:
        kind: The format.
        path: The file.
        root: Folder that no file may leave; the file's own where None.

    Raises:
        FileFormatError: It cannot be used; one line says what is wrong and where.
        MissingExtraError: What reads it is not installed.
    """
    return _reader(kind)(path, (root or path.resolve().parent))


def _reader(kind: Kind) -> Callable[[Path, Path], Room]:
    """What reads a format; imported when it is needed."""
    from . import mjcf, moveit, sdf, usd

    readers: dict[Kind, Callable[[Path, Path], Room]] = {
        "MJCF": mjcf.read_room,
        "MoveIt": moveit.read_room,
        "SDF": sdf.read_room,
        "USD": usd.read_room,
    }
    return readers[kind]
