"""Detect the format of another program's file from its content."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from momapos.core import open_regular, resolved

if TYPE_CHECKING:
    from .imported_room import ImportedRoom

Kind = Literal["MJCF", "MoveIt", "MoveIt message", "SDF", "USD"]
_ROOTS: dict[str, Kind] = {"mujoco": "MJCF", "sdf": "SDF"}
"""Formats by their XML root element."""
_FIRST = re.compile(
    r"\s*(?:<\?.*?\?>\s*|<!--.*?-->\s*|<!DOCTYPE[^>\[]*>\s*)*<([A-Za-z][\w.-]*)", re.S
)
_PLANNING_SCENE = re.compile(r"[^\n]*\n\s*(\*\s|\.\s*\Z)")
"""A name, followed by an object or the end."""
_MESSAGE = re.compile(
    r"^(world|collision_objects|fixed_frame_transforms|allowed_collision_matrix|robot_model_name)"
    r"\s*:(\s|$)", re.M,
)  # fmt: skip
"""A field of a planning scene's message, at the start of a line."""
_USD = ("#usda", "PXR-USDC")
_DETECTION_BYTES = 1 << 16
"""Number of bytes that determine the format [bytes]."""


def foreign_kind(text: str) -> Kind | None:
    """Return the format of another program that a text starts with; None if unknown."""
    text = text.lstrip("\ufeff")
    if text.startswith(_USD):
        return "USD"
    first = _FIRST.match(text)
    if first is not None:
        return _ROOTS.get(first[1])
    if _PLANNING_SCENE.match(text):
        return "MoveIt"
    plain = not text.lstrip().startswith(("{", "[", "<"))
    return "MoveIt message" if plain and _MESSAGE.search(text) else None


def kind_of_file(path: Path) -> Kind | None:
    """Return the format of a file, see `foreign_kind`.

    Raises:
        FileFormatError: The file cannot be read.
    """
    with open_regular(path) as file:
        return foreign_kind(file.read(_DETECTION_BYTES).decode("utf-8", errors="replace"))


def read_room(kind: Kind, path: Path, root: Path | None) -> ImportedRoom:
    """Read a room in the format of another program.

    Args:
        kind: The format.
        path: The file.
        root: Folder that no file may leave; None for the file's folder.

    Raises:
        FileFormatError: The file is invalid; one line says what is wrong and where.
        MissingExtraError: The reader of the format is not installed.
    """
    return _reader(kind)(path, (root or resolved(path).parent))


def _reader(kind: Kind) -> Callable[[Path, Path], ImportedRoom]:
    """Return the reader of a format, imported on demand."""
    from . import mjcf, moveit, sdf, usd

    readers: dict[Kind, Callable[[Path, Path], ImportedRoom]] = {
        "MJCF": mjcf.read_room,
        "MoveIt": moveit.read_room,
        "MoveIt message": moveit.read_message,
        "SDF": sdf.read_room,
        "USD": usd.read_room,
    }
    return readers[kind]
