"""Expand xacro files to URDFs in a separate process with limits."""

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
from momapos.model.urdf import MAX_MESH_PARENTS

MAX_SECONDS, MAX_MEMORY, MAX_RESULT_BYTES = 60, 2_000_000_000, 50_000_000
"""Limits: total time of all runs of a file [s], memory [bytes], and size of the result [bytes]."""
MAX_RUNS = 30
"""Maximum number of runs; each run can report one missing package [-]."""
_MISSING = re.compile(r"Package not found: (\S+)")
_CHILD = f"""
import json, resource, sys
resource.setrlimit(resource.RLIMIT_CPU, ({MAX_SECONDS}, {MAX_SECONDS}))
resource.setrlimit(resource.RLIMIT_AS, ({MAX_MEMORY}, {MAX_MEMORY}))
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
    """Return whether a file has the suffix of a xacro file."""
    return path.suffix.lower() == ".xacro"


def expand_xacro(
    path: Path, packages: Mapping[str, Path], args: Mapping[str, str]
) -> tuple[str, dict[str, Path]]:
    """Expand a xacro file.

    Args:
        path: The file.
        packages: Package folders by name; other packages are searched in the folders above.
        args: Arguments of the file by name.

    Returns:
        The URDF, with mesh paths by package; and the folders of these packages.

    Raises:
        RobotError: The file cannot be expanded; the message names the reason or missing package.
        MissingExtraError: xacrodoc is not installed.
    """
    with require("xacro"):
        import_module("xacrodoc")
    if not path.is_file():
        raise RobotError(f"{path}: no such file")
    known = {name: folder.resolve() for name, folder in packages.items()}
    until = time.monotonic() + MAX_SECONDS
    for _ in range(MAX_RUNS):
        done = _run(path, known, args, until - time.monotonic())
        last = done.stderr.strip().splitlines()[-1:] or [""]
        if done.returncode == 0:
            return _named_by_packages(done.stdout, path, known)
        missing = _MISSING.search(last[0])
        if missing is None or missing[1] in known:
            raise RobotError(f"{path}: the xacro file cannot be expanded ({last[0]:.300})")
        known[missing[1]] = _package(missing[1], path)
    raise RobotError(f"{path}: names more than {MAX_RUNS} unknown packages")


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
            cwd=path.resolve().parent,  # include paths are relative to it
            capture_output=True,
            text=True,
            timeout=seconds,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise RobotError(f"{path}: expanding it took longer than {MAX_SECONDS} s") from error


def _package(name: str, path: Path) -> Path:
    """Find the folder of a package among or next to the folders above a file."""
    above = list(path.resolve().parents)[: MAX_MESH_PARENTS + 1]
    for folder in above:
        if folder.name == name:
            return folder
        if name == Path(name).name and (folder / name).is_dir():
            return folder / name
    looked = ", ".join(map(str, above))
    raise RobotError(
        f"{path}: package {name!r:.80} was not found (searched {looked}); give its folder: "
        f"--package {name}=DIR of momapos robot check, [packages] in a robot file"
    )


def _named_by_packages(
    text: str, path: Path, known: Mapping[str, Path]
) -> tuple[str, dict[str, Path]]:
    """Name all meshes by package, so that the URDF can be anywhere; return these packages, too."""
    from xml.etree.ElementTree import tostring

    if len(text) > MAX_RESULT_BYTES:
        raise RobotError(f"{path}: expands to more than {MAX_RESULT_BYTES / 1e6:g} MB")
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
    """Return a known package that contains a file, or the file's folder under a new name."""
    for package, folder in known.items():
        if file.is_relative_to(folder):
            return package, folder
    name, count = file.parent.name, 1
    while name in known:
        count += 1
        name = f"{file.parent.name}_{count}"
    return name, file.parent
