"""Expand xacro files to URDFs in a separate process with limits."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

from momapos.core import RobotError, parse_xml, require, resolved
from momapos.model.urdf import MAX_MESH_PARENTS, find_package, not_found

MAX_SECONDS, MAX_MEMORY, MAX_RESULT_BYTES = 60, 2_000_000_000, 50_000_000
"""Limits: total time of all runs of a file [s], memory [bytes], and size of the result [bytes]."""
MAX_RUNS = 30
"""Maximum number of runs; each run reports the missing packages of the files that it has [-]."""
MAX_SWITCHES = 6
"""Maximum number of switches that a message names [-]."""
_SCHEME = "package://"
_UNSET = re.compile(r"Undefined substitution argument\W+(\w+)")
_PACKAGE = re.compile(r"[\w.-]*\w[\w.-]*")
_SECRET = re.compile("AUTH|CREDENTIAL|KEY|PASS|SECRET|TOKEN", re.IGNORECASE)
"""Environment variables that no file can read."""
_PROGRAM = "momapos.model.robots.xacro_program"


@dataclass(frozen=True)
class Expanded:
    """A URDF that a xacro file, or one of another format, expanded to."""

    urdf: str
    """Its text, with mesh paths by package."""
    packages: dict[str, Path]
    """Folders of these packages."""
    notes: tuple[str, ...]
    """Old syntax that was expanded."""
    off: str
    """Arguments and environment variables of the file that leave parts out by default, in words;
    "" for none."""
    meshes: Mapping[str, str] = field(default_factory=dict)
    """Content of mesh files to write, by their paths from the URDF, for formats with meshes of
    their own."""


def off_by_default(path: Path, expanded: Expanded) -> str:
    """Return the words for what a file leaves out by default."""
    return f"{path.name} leaves parts out by default: {expanded.off}"


def is_xacro(path: Path) -> bool:
    """Return whether a file has the suffix of a xacro file."""
    return path.suffix.lower() == ".xacro"


def expand_xacro(path: Path, packages: Mapping[str, Path], args: Mapping[str, str]) -> Expanded:
    """Expand a xacro file.

    Tags and macros without the prefix `xacro:` are expanded, as xacro did until ROS Melodic, if
    nothing else gives a whole URDF.

    Args:
        path: The file.
        packages: Package folders by name; other packages are searched in the folders above.
        args: Arguments of the file by name.

    Raises:
        RobotError: The file cannot be expanded; the message names the reason or missing package.
        MissingExtraError: xacrodoc is not installed.
    """
    with require("xacro"):
        import_module("xacrodoc")
    file = resolved(path, error=RobotError)
    if not file.is_file():
        raise RobotError(f"{path}: no such file")
    known = {name: resolved(folder, error=RobotError) for name, folder in packages.items()}
    until = time.monotonic() + MAX_SECONDS
    done = _with_packages(path, known, args, until, old=False)
    notes: tuple[str, ...] = ()
    if done["old_tags"] and not done.get("whole"):
        again = _with_packages(path, known, args, until, old=True)
        if "urdf" in again or "error" in done:
            tags = ", ".join(f"<{tag}>" for tag in again["old_tags"])
            notes = (
                f"{path.name}: tags without the prefix xacro: ({tags}) are expanded, as before "
                "ROS Noetic",
            )
            done = again
    if "error" in done:
        unset = _UNSET.search(done["error"])
        how = f"; give it: --xacro-arg {unset[1]}=VALUE of momapos robot check" if unset else ""
        raise RobotError(f"{path}: the xacro file cannot be expanded ({done['error']:.300}){how}")
    urdf, used = _named_by_packages(done["urdf"], path, known)
    return Expanded(urdf, used, notes, _off(done["off"]))


def _off(switches: Mapping[str, str]) -> str:
    """Name switches with their values, as a shell writes them."""
    names = [f"{name}={value or repr('')}" for name, value in switches.items()]
    more = f" and {len(names) - MAX_SWITCHES} more" if len(names) > MAX_SWITCHES else ""
    return ", ".join(names[:MAX_SWITCHES]) + more


def _with_packages(
    path: Path, known: dict[str, Path], args: Mapping[str, str], until: float, *, old: bool
) -> dict[str, Any]:
    """Run the program until it misses no package; adds those that it missed."""
    for _ in range(MAX_RUNS):
        done = _run(path, known, args, until - time.monotonic(), old=old)
        missing = [name for name in done["missing"] if name not in known]
        if not missing:
            return done
        known |= _packages(missing, path)
    raise RobotError(f"{path}: needs packages of packages more than {MAX_RUNS} times")


def _run(
    path: Path, known: Mapping[str, Path], args: Mapping[str, str], seconds: float, *, old: bool
) -> dict[str, Any]:
    asked = {
        "file": str(resolved(path)), "folder": str(_folders(path)[0]), "args": dict(args),
        "roots": [str(_folders(path)[-1])],
        "packages": {name: str(folder) for name, folder in known.items()}, "old": old,
        "seconds": MAX_SECONDS, "memory": MAX_MEMORY, "largest": MAX_RESULT_BYTES,
    }  # fmt: skip
    plain = {name: value for name, value in os.environ.items() if not _SECRET.search(name)}
    places = [str(Path(__file__).parents[3]), *filter(None, [plain.get("PYTHONPATH")])]
    plain["PYTHONPATH"] = os.pathsep.join(places)
    try:
        # -P: this folder is not searched for modules.
        done = subprocess.run(
            [sys.executable, "-P", "-m", _PROGRAM, json.dumps(asked)],
            capture_output=True, text=True, timeout=seconds, check=False, env=plain,
        )  # fmt: skip
    except subprocess.TimeoutExpired as error:
        raise RobotError(f"{path}: expanding it took longer than {MAX_SECONDS} s") from error
    if done.returncode < 0:
        limits = f"{MAX_SECONDS} s and {MAX_MEMORY / 1e9:g} GB"
        raise RobotError(f"{path}: the xacro file cannot be expanded within {limits}")
    if done.returncode:
        last = done.stderr.strip().splitlines()[-1:] or [f"exit status {done.returncode}"]
        raise RobotError(f"{path}: the xacro file cannot be expanded ({last[0]:.300})")
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def _folders(path: Path) -> list[Path]:
    """Return the folder of a file, and those above it that its files may be in.

    A workspace is neither a home folder, nor directly below `/`, nor above one of them.
    """
    first, *above = resolved(path, error=RobotError).parents
    outer = {*resolved(Path.home()).parents, resolved(Path.home())}
    inner = [one for one in above[:MAX_MESH_PARENTS] if len(one.parts) > 2 and one not in outer]
    return [first, *inner]


def _packages(names: Sequence[str], path: Path) -> dict[str, Path]:
    """Find the folders of packages among, next to or below the folders above a file.

    Raises:
        RobotError: Some are missing; the message names all of them.
    """
    folders = _folders(path)
    found = {
        name: find_package(name, folders) if _PACKAGE.fullmatch(name) else None for name in names
    }
    if missing := [name for name, folder in found.items() if folder is None]:
        raise RobotError(f"{path}: {not_found(missing, folders)}")
    return {name: resolved(folder, error=RobotError) for name, folder in found.items() if folder}


def _named_by_packages(
    text: str, path: Path, known: Mapping[str, Path]
) -> tuple[str, dict[str, Path]]:
    """Name all meshes by package, so that the URDF can be anywhere; return these packages, too."""
    from xml.etree.ElementTree import tostring

    tree = parse_xml(text, path, error=RobotError)
    names = [mesh.get("filename", "") for mesh in tree.iter("mesh")]
    needed = dict.fromkeys(
        name.removeprefix(_SCHEME).partition("/")[0] for name in names if name.startswith(_SCHEME)
    )
    used = {name: known[name] for name in needed if name in known}
    used |= _packages([name for name in needed if name not in known], path)
    for mesh in tree.iter("mesh"):
        name = mesh.get("filename", "")
        if name.startswith(_SCHEME):
            continue
        file = Path(os.path.normpath(_folders(path)[0] / name.removeprefix("file://")))
        package, folder = _holding(file, {**known, **used}, path)
        used[package] = folder
        mesh.set("filename", f"package://{package}/{file.relative_to(folder).as_posix()}")
    return tostring(tree, encoding="unicode"), used


def _holding(file: Path, known: Mapping[str, Path], path: Path) -> tuple[str, Path]:
    """Return a known package that contains a file, or the file's folder under a new name."""
    for package, folder in known.items():
        if file.is_relative_to(folder):
            return package, folder
    root = _folders(path)[-1]
    if not resolved(file, error=RobotError).is_relative_to(root):
        raise RobotError(
            f"{path}: mesh {str(file)!r:.200} is outside {root}; move it inside, or give the "
            f"folder of its package: --package NAME=DIR of momapos robot check"
        )
    name, count = file.parent.name, 1
    while name in known:
        count += 1
        name = f"{file.parent.name}_{count}"
    return name, file.parent


def with_relative_meshes(expanded: Expanded, urdf: Path) -> str:
    """Return the URDF with meshes named by their paths from a file, instead of by package."""
    from xml.etree.ElementTree import tostring

    tree = parse_xml(expanded.urdf, urdf, error=RobotError)
    for mesh in tree.iter("mesh"):
        package, _, rest = mesh.get("filename", "").removeprefix(_SCHEME).partition("/")
        if package in expanded.packages:
            file = os.path.relpath(expanded.packages[package] / rest, resolved(urdf).parent)
            mesh.set("filename", Path(file).as_posix())
    return tostring(tree, encoding="unicode")
