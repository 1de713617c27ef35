"""Figure files, whose format is that of the file ending."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING

from momapos.core import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMATS = {".png": {}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
"""Formats, and the metadata that would make two equal figures differ."""


def check_figure_path(path: Path | None) -> None:
    """Check, before the work, that a figure can be written to a path; None needs no check.

    Raises:
        InputError: The format is not supported, or the path is a folder.
    """
    if path is None:
        return
    if path.suffix.lower() not in FORMATS:
        raise InputError(f"{path}: unsupported figure format; use {', '.join(FORMATS)}")
    if path.is_dir():
        raise InputError(f"{path}: cannot be written (it is a folder)")


def save_figure(figure: Figure, path: Path, *, dpi: float) -> None:
    """Write a figure in the format of the file ending, completely or not at all.

    Args:
        figure: The figure.
        path: A file that ends in .png, .svg or .pdf; its folder is created if needed.
        dpi: Resolution of pixel images [1/in].

    Raises:
        InputError: The format is not supported, or the file cannot be written.
    """
    from momapos.core import write_file  # imports numpy, which would slow down every command

    check_figure_path(path)
    kind = path.suffix.lower()
    buffer = io.BytesIO()
    figure.savefig(buffer, format=kind[1:], dpi=dpi, metadata=FORMATS[kind])
    write_file(path, buffer.getvalue())
