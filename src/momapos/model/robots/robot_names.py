"""Names of the library robots; looking one up imports nothing heavy."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from momapos.core import RobotError, check_outputs, unknown_name

MAP_JOINTS = 6
"""Minimum number of arm joints for a reachability map; fewer joints reach few tool poses [-]."""
LIBRARY = Path(__file__).parent / "library"


def library_names() -> tuple[str, ...]:
    """Return the names of the library robots."""
    return tuple(sorted(p.name for p in LIBRARY.iterdir() if (p / f"{p.name}.toml").is_file()))


def library_file(name: str) -> Path:
    """Return the robot file of a library robot."""
    return LIBRARY / name / f"{name}.toml"


def find_robot(source: str | Path) -> Path:
    """Return the robot file of a library name or a path; the path may not exist.

    A source with a slash or a file suffix is a path, any other one a name.

    Raises:
        UnknownNameError: No library robot has this name; the message suggests similar names or a
            file.
        RobotError: The source is a URDF.
    """
    text = str(source)
    if text in library_names():
        return library_file(text)
    path = Path(source)
    if path.suffix not in (".toml", ".urdf", ".xml") and path.name == text:
        own = [name for name in (f"{text}.toml", f"./{text}") if os.path.isfile(name)]
        where = f"or give the file: {own[0]}" if own else "or give a file"
        raise unknown_name("robot", text[:80], library_names(), f"the library ({where})")
    if path.suffix in (".urdf", ".xml"):
        raise RobotError(
            f"{path}: is a URDF; derive a robot file from it with 'momapos robot check {path}'"
        )
    return path


def find_named_robot(source: str) -> Path:
    """Return the robot file of a name that the user typed, if it is unambiguous.

    Raises:
        UnknownNameError, RobotError: See `find_robot`; or the working folder has a file with the
            name of a library robot.
    """
    path = find_robot(source)
    own = next((file for file in (Path(f"{source}.toml"), Path(source)) if file.is_file()), None)
    if source in library_names() and own is not None:
        raise RobotError(
            f"two robots are called {source!r}: the library's {path} and {own.absolute()}; give "
            "the path of the one to use"
        )
    return path


def export_robot(name: str, folder: Path) -> tuple[Path, ...]:
    """Copy the files of a library robot to a folder; existing files are not overwritten.

    Raises:
        UnknownNameError: No library robot has this name.
        InputError, RobotError: The folder has one of the files, or cannot be written.
    """
    if name not in library_names():
        raise unknown_name("robot", name, library_names(), "the library")
    source = LIBRARY / name
    files = [path for path in sorted(source.rglob("*")) if path.is_file()]
    check_outputs(folders=[folder])
    targets = tuple(folder / path.relative_to(source) for path in files)
    taken = next((path for path in targets if path.exists()), None)
    if taken is not None:
        raise RobotError(f"{taken}: exists already; choose a new folder")
    for path, target in zip(files, targets, strict=True):
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, target)
        except OSError as error:
            raise RobotError(f"{target}: cannot be written ({error.strerror})") from error
    return targets
