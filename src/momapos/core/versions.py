"""Versions of installed packages, for the records of answers and runs."""

from __future__ import annotations

from functools import cache
from importlib.util import find_spec
from pathlib import Path

from momapos import __version__


@cache
def version_of(package: str) -> str:
    """Version of an installed package, without importing it.

    Most often the name of the folder that holds its metadata tells it; importlib.metadata, which
    reads the metadata themselves, takes longer to import than many a stage of an answer.

    Raises:
        importlib.metadata.PackageNotFoundError: It is not installed.
    """
    if package == "momapos":
        return __version__
    spec = find_spec(package)
    if spec is not None and spec.origin is not None:
        folders = list(Path(spec.origin).parents[1].glob(f"{package}-*.dist-info"))
        if len(folders) == 1:
            return folders[0].name.removesuffix(".dist-info").partition("-")[2]
    from importlib import metadata

    return metadata.version(package)
