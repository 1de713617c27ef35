"""Find ROS packages: near a file, in the workspace around it, and where ROS looks for them."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import islice
from pathlib import Path

from momapos.core import UrdfError, parse_xml, read_text_bounded, resolved

MAX_MESH_PARENTS = 4
"""Meshes may be up to this many folders above the URDF's; packages have them next to `urdf` [-]."""
MAX_PACKAGES = 2000
"""Number of folders that are searched for a package below one folder [-]."""
MAX_DEPTH = 3
"""Packages are at most this many folders below a workspace: `src/REPOSITORY/PACKAGE` [-]."""
MAX_MANIFEST_BYTES = 100_000
_MANIFEST = "package.xml"


def find_package(name: str, folders: Sequence[Path], root: Path | None = None) -> Path | None:
    """Find the folder of a package: by its own name, or as in its `package.xml`.

    Args:
        name: Name of the package.
        folders: The folder of the file that needs it, and those above, the nearest first. Each is
            searched like a workspace. Then come `ROS_PACKAGE_PATH` and `AMENT_PREFIX_PATH`.
        root: Folder that links may not leave; None for any. It does not bind what ROS names.
    """
    for folder in folders:
        for one in _candidates(name, folder):
            if root is None or resolved(one).is_relative_to(root):
                return one
    return _of_environment(name, os.environ)


def _candidates(name: str, folder: Path) -> Iterator[Path]:
    """Yield what may be a package in a folder, the nearest first."""
    if folder.name == name or package_name(folder) == name:
        yield folder
    if (folder / name).is_dir():
        yield folder / name
    yield from (one for one in packages_below(folder) if package_name(one) == name)


def packages_below(folder: Path) -> Iterator[Path]:
    """Yield the folders with a `package.xml` below a folder; none is inside another."""
    level = [folder]
    left = MAX_PACKAGES
    for _ in range(MAX_DEPTH):
        below = list(islice((one for top in level for one in _subfolders(top)), left))
        left -= len(below)
        yield from (one for one in below if (one / _MANIFEST).is_file())
        level = [one for one in below if not (one / _MANIFEST).is_file()]


def _subfolders(folder: Path) -> Iterator[Path]:
    """Yield the folders in a folder that are not hidden, as far as they can be listed."""
    with suppress(OSError):
        every = sorted(folder.iterdir())
        yield from (one for one in every if not one.name.startswith(".") and one.is_dir())


def _of_environment(name: str, environment: Mapping[str, str]) -> Path | None:
    """Return the folder of a package that ROS would use, by its environment variables."""
    for prefix in _paths(environment, "AMENT_PREFIX_PATH"):
        if package_name(prefix / "share" / name) == name:
            return prefix / "share" / name
    for place in _paths(environment, "ROS_PACKAGE_PATH"):
        for folder in (place, *packages_below(place)):
            if package_name(folder) == name:
                return folder
    return None


def _paths(environment: Mapping[str, str], variable: str) -> list[Path]:
    return [Path(one) for one in environment.get(variable, "").split(os.pathsep) if one]


def package_name(folder: Path) -> str | None:
    """Return the name in the `package.xml` of a folder; None without one."""
    manifest = folder / _MANIFEST
    try:
        if not manifest.is_file():
            return None
        text = read_text_bounded(manifest, MAX_MANIFEST_BYTES, error=UrdfError)
        tree = parse_xml(text, manifest, error=UrdfError)
    except (OSError, UrdfError):
        return None
    return (tree.findtext("name") or "").strip() or None


def not_found(names: Sequence[str], folders: Sequence[Path]) -> str:
    """Return the words for packages that were not found, and how to give their folders.

    Args:
        names: The packages.
        folders: Where they were searched.
    """
    looked = ", ".join(map(str, folders))
    options = " ".join(f"--package {name:.80}=DIR" for name in names)
    if len(names) == 1:
        return (
            f"package {names[0]!r:.80} was not found (searched in {looked} and below, "
            f"ROS_PACKAGE_PATH, AMENT_PREFIX_PATH); give its folder: {options} of momapos robot "
            "check, [packages] in a robot file"
        )
    every = ", ".join(f"{name!r:.80}" for name in names)
    return (
        f"packages {every} were not found (searched in {looked} and below, ROS_PACKAGE_PATH, "
        f"AMENT_PREFIX_PATH); give their folders: {options} of momapos robot check, [packages] in "
        "a robot file"
    )
