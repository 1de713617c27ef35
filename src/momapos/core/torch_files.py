"""Read untrusted files of `torch.save` without running code.

Such a file is a pickle inside a zip archive, and a pickle can run code. torch's weights-only reader
accepts tensors alone; this module checks the archive, and turns all failures into one-line errors.
"""

from __future__ import annotations

import os
import re
import zipfile
from pathlib import Path
from typing import Any, BinaryIO

from .errors import FileFormatError, MissingExtraError, install_hint, require
from .files import open_regular

MAX_BYTES = 4_000_000_000
"""Largest file: several times the size of weights with two optimizer moments each [bytes]."""
MIN_TORCH = (2, 10)
"""Older versions of torch accept a pickle that claims more numbers than the archive contains."""
_GLOBAL = re.compile(r"GLOBAL ([\w.]{1,100})")


def load_tensors(path: Path) -> Any:
    """Read a file of `torch.save` on the CPU: tensors, plain values, lists and dictionaries.

    Raises:
        FileFormatError: The file is missing, damaged, not of torch, or contains other types.
        MissingExtraError: torch is not installed, or too old.
    """
    with require("torch"):
        import torch
    if tuple(map(int, torch.__version__.split(".")[:2])) < MIN_TORCH:
        raise MissingExtraError(
            f"torch {torch.__version__} cannot read untrusted files safely; {install_hint('torch')}"
        )
    with open_regular(path, MAX_BYTES) as file:
        check_archive(file, path)
        try:
            return torch.load(file, map_location="cpu", weights_only=True)
        except Exception as error:  # a forged pickle can make its reader raise anything
            raise FileFormatError(f"{path}: {_reason(error)}") from error


def check_archive(file: BinaryIO, path: Path) -> None:
    """Reject files that are not zip archives, or that unpack to more than their size."""
    try:
        with zipfile.ZipFile(file) as archive:
            entries = archive.infolist()
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError) as error:
        raise FileFormatError(
            f"{path}: truncated, or not written by torch.save ({error})"
        ) from error
    if any(entry.compress_type != zipfile.ZIP_STORED for entry in entries):
        raise FileFormatError(f"{path}: is compressed; torch.save does not compress")
    if sum(entry.file_size for entry in entries) > os.fstat(file.fileno()).st_size:
        raise FileFormatError(f"{path}: damaged; its entries are larger than the file")
    file.seek(0)


def _reason(error: Exception) -> str:
    """Summarize torch's error, whose message fills a screen, in one line."""
    found = _GLOBAL.search(str(error))
    if found:
        return f"would run code when loaded ({found[1]}); use torch.save for tensors only"
    first = next(iter(str(error).strip().splitlines()), type(error).__name__)
    return f"damaged, or not written by torch.save ({first.split('. ')[0]:.120})"
