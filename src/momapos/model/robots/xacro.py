"""Expand xacro files: macros that become a URDF, in a process of their own with limits."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path

from momapos.core import RobotError, parse_xml, require
from momapos.model.urdf import PARENTS

SECONDS, MEMORY, MOST = 60, 2_000_000_000, 50_000_000
"""What expanding a file may take: time of all its runs together [s], memory [bytes], size of the
result [bytes]."""
MAX_RUNS = 30
"""Packages that are found one after the other [-]."""
_MISSING = re.compile(r"Package not found: (\S+)")
_CHILD = f"""
import json, resource, sys
resource.setrlimit(resource.RLIMIT_CPU, ({SECONDS}, {SECONDS}))
resource.setrlimit(resource.RLIMIT_AS, ({MEMORY}, {MEMORY}))
from xacrodoc import XacroDoc, packages
packages.update_package_cache(json.loads(sys.argv[2]))
try:
    doc = XacroDoc.from_file(
        sys.argv[1], subargs=json.loads(sys.argv[3]), resolve_packages=False
    )
except Exception as error:
    sys.exit(" ".join(str(error).split()) or type(error).__name__)
sys.stdout.write(doc.dom.toxml())
"""


def is_xacro(path: Path) -> bool:
    """Whether a file is named as one."""
    return path.suffix.lower() == ".xacro"


def expand_xacro(
    path: Path, packages: Mapping[str, Path], args: Mapping[str, str]
) -> tuple[str, dict[str, Path]]:
    """Expand a xacro file.

    Args:
        path: The file.
        packages: Folders of packages by name; others are looked for in the folders above the file.
        args: Values of the file's arguments by name.

    Returns:
        The URDF, whose meshes are named by packages; and the folders of these.

    Raises:
        RobotError: It cannot be expanded; the message says why, and which package was not found.
        MissingExtraError: The program that expands is not installed.
    """
    with require("xacro"):
        import_module("xacrodoc")
    if not path.is_file():
        raise RobotError(f"{path}: no such file")
    known = {name: folder.resolve() for name, folder in packages.items()}
    until = time.monotonic() + SECONDS
    for _ in range(MAX_RUNS):
        done = _run(path, known, args, until - time.monotonic())
        last = done.stderr.strip().splitlines()[-1:] or [""]
        if done.returncode == 0:
            return _named_by_packages(done.stdout, path, known)
        missing = _MISSING.search(last[0])
        if missing is None or missing[1] in known:
            raise RobotError(f"{path}: the xacro file cannot be expanded ({last[0]:.300})")
        known[missing[1]] = _package(missing[1], path)
    raise RobotError(f"{path}: names more than {MAX_RUNS} packages")


def _run(
    path: Path, known: Mapping[str, Path], args: Mapping[str, str], seconds: float
) -> subprocess.CompletedProcess[str]:
    folders = {name: str(folder) for name, folder in known.items()}
    try:
        return subprocess.run(
            [
                sys.executable,
                "-c",
                _CHILD,
                str(path.resolve()),
                json.dumps(folders),
                json.dumps(dict(args)),
            ],
            cwd=path.resolve().parent,  # macros are included relative to it
            capture_output=True,
            text=True,
            timeout=seconds,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise RobotError(f"{path}: expanding it takes longer than {SECONDS} s") from error


def _package(name: str, path: Path) -> Path:
    """The folder of a package: one above the file, or beside one of these."""
    above = list(path.resolve().parents)[: PARENTS + 1]
    for folder in above:
        if folder.name == name:
            return folder
        if name == Path(name).name and (folder / name).is_dir():
            return folder / name
    looked = ", ".join(map(str, above))
    raise RobotError(
        f"{path}: package {name!r:.80} was not found (looked in {looked}); say where it is: "
        f"momapos robot check ... --package {name}=DIR"
    )


def _named_by_packages(
    text: str, path: Path, known: Mapping[str, Path]
) -> tuple[str, dict[str, Path]]:
    """Name all meshes by packages, so that the URDF can lie anywhere; and these packages."""
    from xml.etree.ElementTree import tostring

    if len(text) > MOST:
        raise RobotError(f"{path}: expands to more than {MOST / 1e6:g} MB")
    tree = parse_xml(text, path, error=RobotError)
    used: dict[str, Path] = {}
    for mesh in tree.iter("mesh"):
        name = mesh.get("filename", "")
        package = name.removeprefix("package://").partition("/")[0]
        if name.startswith("package://"):
            used[package] = known[package] if package in known else _package(package, path)
            continue
        file = Path(os.path.normpath(path.resolve().parent / name.removeprefix("file://")))
        package, folder = _holding(file, {**known, **used})
        used[package] = folder
        mesh.set("filename", f"package://{package}/{file.relative_to(folder).as_posix()}")
    return tostring(tree, encoding="unicode"), used


def _holding(file: Path, known: Mapping[str, Path]) -> tuple[str, Path]:
    """A package that holds a file: one that is known, else its folder under a name of its own."""
    for package, folder in known.items():
        if file.is_relative_to(folder):
            return package, folder
    name, count = file.parent.name, 1
    while name in known:
        count += 1
        name = f"{file.parent.name}_{count}"
    return name, file.parent
