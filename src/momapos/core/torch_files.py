"""Files of `torch.save` that come from strangers, read without running what is in them.

Such a file is a pickle inside a zip archive, and a pickle can run code. torch's reader for weights
alone refuses every name but those of tensors; this module guards the archive around it, and turns
all that can go wrong into one line.
"""

from __future__ import annotations

import os
import re
import zipfile
from pathlib import Path
from typing import Any, BinaryIO

from .errors import FileFormatError, MissingExtraError, require
from .files import open_regular

MAX_BYTES = 4_000_000_000
"""Weights, and an optimizer's two moments of each, fit several times."""
OLDEST = (2, 10)
"""Older versions of torch believe a pickle that claims more numbers than the archive holds."""
_INSTALL = "pip install 'momapos[torch]'"
_GLOBAL = re.compile(r"GLOBAL ([\w.]{1,100})")


def load_tensors(path: Path) -> Any:
    """Read what `torch.save` wrote, on the CPU: tensors, plain values, lists and dictionaries.

    Raises:
        FileFormatError: The file is absent, no archive of torch, damaged, or holds more than
            tensors and plain values.
        MissingExtraError: torch is not installed, or too old.
    """
    with require("torch"):
        import torch
    if tuple(map(int, torch.__version__.split(".")[:2])) < OLDEST:
        raise MissingExtraError(
            f"torch {torch.__version__} cannot read a stranger's file safely; {_INSTALL}"
        )
    with open_regular(path, MAX_BYTES) as file:
        _check_archive(file, path)
        try:
            return torch.load(file, map_location="cpu", weights_only=True)
        except Exception as error:  # a forged pickle can make its reader raise anything
            raise FileFormatError(f"{path}: {_reason(error)}") from error


def _check_archive(file: BinaryIO, path: Path) -> None:
    """Refuse what is no archive, or one that unpacks to more than its own size."""
    try:
        with zipfile.ZipFile(file) as archive:
            entries = archive.infolist()
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError) as error:
        raise FileFormatError(
            f"{path}: not written by torch.save, or cut off; that writes a zip archive ({error})"
        ) from error
    if any(entry.compress_type != zipfile.ZIP_STORED for entry in entries):
        raise FileFormatError(f"{path}: is compressed; torch.save stores its tensors as they are")
    if sum(entry.file_size for entry in entries) > os.fstat(file.fileno()).st_size:
        raise FileFormatError(f"{path}: damaged, its entries are larger than the file")
    file.seek(0)


def _reason(error: Exception) -> str:
    """Say in one line why torch refused a file; its own messages fill a screen."""
    found = _GLOBAL.search(str(error))
    if found:
        return f"would run code when loaded ({found[1]}); save tensors alone by torch.save"
    first = next(iter(str(error).strip().splitlines()), type(error).__name__)
    return f"damaged, or not written by torch.save ({first.split('. ')[0]:.120})"
