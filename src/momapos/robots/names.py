"""The names of the robots that come with momapos; nothing heavy is imported to look one up."""

from __future__ import annotations

import os
from pathlib import Path

from momapos.errors import RobotError, unknown_name

MAP_JOINTS = 6
"""An arm of fewer degrees of freedom takes few tool poses, and has no reachability map [-]."""
LIBRARY = Path(__file__).parent / "library"


def library_names() -> tuple[str, ...]:
    """Names of the robots that come with the package."""
    return tuple(sorted(p.name for p in LIBRARY.iterdir() if (p / f"{p.name}.toml").is_file()))


def library_file(name: str) -> Path:
    """The file of a robot that comes with the package."""
    return LIBRARY / name / f"{name}.toml"


def find_robot(source: str | Path) -> Path:
    """The robot file that a library name or a path stands for; a path may not exist.

    Raises:
        UnknownNameError: It is neither; the message offers the nearest names.
        RobotError: It is a URDF.
    """
    text = str(source)
    if text in library_names():
        return library_file(text)
    path = Path(source)
    if path.suffix not in (".toml", ".urdf", ".xml") and not os.path.exists(path):
        raise unknown_name("robot", text[:80], library_names(), "the library (or give a file)")
    if path.suffix in (".urdf", ".xml"):
        raise RobotError(
            f"{path}: is a URDF; run 'momapos robot check {path}' once, it writes the robot file"
        )
    return path


def find_named_robot(source: str) -> Path:
    """What `find_robot` finds for a name that was typed, if it can mean but one robot.

    Raises:
        UnknownNameError, RobotError: As for `find_robot`; or two robots are called so.
    """
    path, own = find_robot(source), Path(f"{source}.toml")
    if source in library_names() and own.is_file():
        raise RobotError(
            f"two robots are called {source!r}: one of the library, {path}, and {own.absolute()}; "
            "give the file that is meant"
        )
    return path
