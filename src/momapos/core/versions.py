"""Versions of installed packages, for the records of plans and runs."""

from __future__ import annotations

from functools import cache
from importlib.util import find_spec
from pathlib import Path

from momapos import __version__


@cache
def version_of(package: str) -> str:
    """Return the version of an installed package without importing it.

    Usually the name of its metadata folder contains the version. importlib.metadata, which reads
    the metadata, is slow to import.

    Raises:
        importlib.metadata.PackageNotFoundError: The package is not installed.
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
