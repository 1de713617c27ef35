"""The names of the robots that come with momapos; nothing heavy is imported to look one up."""

from __future__ import annotations

import os
from pathlib import Path

from momapos.core import RobotError, unknown_name

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

    A word is a name; what has a slash in it, or ends as files do, is a path.

    Raises:
        UnknownNameError: There is no robot of that name; the message offers the nearest names, or
            the file of that name.
        RobotError: It is a URDF.
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
            f"{path}: is a URDF; run 'momapos robot check {path}' once, it writes the robot file"
        )
    return path


def find_named_robot(source: str) -> Path:
    """What `find_robot` finds for a name that was typed, if it can mean but one robot.

    Raises:
        UnknownNameError, RobotError: As for `find_robot`; or a file of that name lies in the
            working folder beside a robot of the library.
    """
    path = find_robot(source)
    own = next((file for file in (Path(f"{source}.toml"), Path(source)) if file.is_file()), None)
    if source in library_names() and own is not None:
        raise RobotError(
            f"two robots are called {source!r}: one of the library, {path}, and {own.absolute()}; "
            "give the file that is meant"
        )
    return path
