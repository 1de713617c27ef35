"""Picture files: the ending of the name says what is written."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING

from momapos.core import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMATS = {".png": {}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
"""What can be written, and the metadata that would make two equal pictures differ."""


def check_picture(path: Path | None) -> None:
    """Make sure before the work that a picture can be written there.

    Raises:
        InputError: Its ending is none of a picture, or it is a folder.
    """
    if path is None:
        return
    if path.suffix.lower() not in FORMATS:
        raise InputError(f"{path}: a picture ends in {', '.join(FORMATS)}; name it so")
    if path.is_dir():
        raise InputError(f"{path}: cannot be written (it is a folder)")


def save_figure(figure: Figure, path: Path, *, dpi: float) -> None:
    """Write a figure as what the name ends in, the whole file or nothing.

    Args:
        figure: The figure.
        path: A file that ends in .png, .svg or .pdf; its folder is made if it does not exist.
        dpi: Resolution of what is made of pixels.

    Raises:
        InputError: The ending is another one, or the file cannot be written.
    """
    from momapos.core import write_atomic  # numpy's import would slow every command down

    check_picture(path)
    kind = path.suffix.lower()
    buffer = io.BytesIO()
    figure.savefig(buffer, format=kind[1:], dpi=dpi, metadata=FORMATS[kind])
    try:
        write_atomic(path, buffer.getvalue())
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from error
