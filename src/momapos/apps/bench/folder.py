"""The results folder: the suite as it was made, its scenes, and one results file a node.

suite.json            what the tasks are, and the versions of what answers them
scenes/               scene files and models, where the suite made any
rows-HOST.sqlite      the rows that this node's runner wrote
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import re
import shutil
import socket
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path

from momapos.core import (
    FileFormatError,
    InputError,
    check_outputs,
    read_bytes_bounded,
    version_of,
    write_atomic,
)
from momapos.model.scene import builtin_names, find_scene

from .bench_records import Row, Settings, Suite, from_plain, to_plain
from .row_store import read_rows
from .suites import SUITES, refuse_unknown

FORMAT, VERSION = "momapos-bench", 1
MAX_BYTES = 100_000_000
PACKAGE = Path(__file__).parents[2]
DEPENDS_ON = ("momapos", "numpy", "ompl")
_URDF, _MESH = re.compile(r'"urdf": "([^"]+)"'), re.compile(r'<mesh[^>]*filename="([^"]+)"')


@dataclass(frozen=True)
class Contents:
    """What a results folder was made for, and with."""

    suite: Suite
    settings: Settings
    versions: Mapping[str, str]
    digest: str
    """Content hash of the suite."""


@cache
def versions() -> dict[str, str]:
    """Versions of all that rows depend on; "code" is a hash of the package's own source."""
    digest = hashlib.sha256()
    for path in sorted(PACKAGE.rglob("*.py")):
        digest.update(path.relative_to(PACKAGE).as_posix().encode() + b"\n" + path.read_bytes())
    return {**{name: version_of(name) for name in DEPENDS_ON}, "code": digest.hexdigest()[:12]}


def open_folder(
    folder: Path, name: str, seed: int, robots: Sequence[str], settings: Settings
) -> Contents:
    """What a results folder is for; it is made where there is none.

    Args:
        folder: The results folder.
        name: Which suite.
        seed: What its tasks are drawn from.
        robots: Its robots; those of the suite where empty.
        settings: How its tasks are asked.

    Raises:
        UnknownNameError: There is no such suite or robot.
        InputError: The folder holds another suite, or results of another version or of other
            settings.
    """
    refuse_unknown(name, robots)
    kind = SUITES[name]
    chosen = tuple(dict.fromkeys(robots)) or kind.robots
    check_outputs(folders=[folder])
    if not (folder / "suite.json").exists():
        _make(folder, name, seed, chosen, settings)
    found = read_folder(folder)
    suite = found.suite
    differences = (
        ("suite", suite.name, name),
        ("seed", suite.seed, seed),
        ("robots", " ".join(suite.robots), " ".join(chosen)),
        ("revision", suite.revision, kind.revision),
        *(
            (f"--{item.name.replace('_', '-')}", getattr(found.settings, item.name), value)
            for item in fields(Settings)
            for value in [getattr(settings, item.name)]
        ),
    )
    for what, there, asked in differences:
        if there != asked:
            raise InputError(
                f"{folder}: holds results of another run: {what} is {there} there, not {asked}; "
                "give another folder"
            )
    for package, version in versions().items():
        if found.versions.get(package) != version:
            raise InputError(
                f"{folder}: holds results of {package} {found.versions.get(package, '?')}, and "
                f"this is {version}; give another folder ('momapos bench report' still reads it)"
            )
    _refuse_changed_scenes(folder, suite)
    return found


def read_folder(folder: Path) -> Contents:
    """What a results folder was made for, and with.

    Raises:
        FileFormatError: It is none, or none of this version.
    """
    path = folder / "suite.json"
    if not path.exists():
        raise FileFormatError(f"{folder}: no results folder, for it holds no suite.json")
    try:
        data = json.loads(read_bytes_bounded(path, MAX_BYTES))
    except (ValueError, RecursionError) as error:
        raise FileFormatError(f"{path}: damaged JSON ({error})") from error
    head = (data.get("format"), data.get("version")) if isinstance(data, dict) else (None, None)
    if head != (FORMAT, VERSION):
        raise FileFormatError(
            f'{path}: not a suite of this version; it has "format": {head[0]!r:.60}, "version": '
            f"{head[1]!r:.60}, not {FORMAT!r} and {VERSION}"
        )
    found = from_plain(data, Contents, str(path))
    if found.digest != _digest(found.suite):
        raise FileFormatError(f"{path}: its tasks were changed since; give another folder")
    return found


def all_rows(folder: Path) -> list[Row]:
    """The rows of all nodes, one a job: the first that was finished."""
    rows: dict[str, Row] = {}
    for path in sorted(folder.glob("rows-*.sqlite")):
        for row in read_rows(path):
            other = rows.setdefault(row.key, row)
            if row.finished < other.finished:
                rows[row.key] = row
    return list(rows.values())


def rows_file(folder: Path) -> Path:
    """The results file of this node."""
    host = re.sub(r"[^A-Za-z0-9_.-]", "_", socket.gethostname()) or "node"
    return folder / f"rows-{host}.sqlite"


@contextmanager
def held(folder: Path) -> Iterator[None]:
    """Keep other runners of this node out of a results folder.

    Raises:
        InputError: Another one works in it.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        file = rows_file(folder).with_suffix(".lock").open("w")
    except OSError as error:
        raise InputError(f"{folder}: cannot be written ({error.strerror})") from error
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise InputError(f"{folder}: another 'momapos bench run' works in it") from error
        yield


def scene_path(folder: Path, name: str) -> Path:
    """The file of a scene that a task names."""
    return find_scene(name if name in builtin_names() else folder / name)


def scene_digest(path: Path) -> str:
    """Content hash of a scene file and the models that it names."""
    text = path.read_text(encoding="utf-8")
    digest = hashlib.sha256(text.encode())
    for urdf in sorted(set(_URDF.findall(text))):
        model = path.parent / urdf
        meshes = sorted(set(_MESH.findall(model.read_text(encoding="utf-8"))))
        for name, file in ((urdf, model), *((mesh, model.parent / mesh) for mesh in meshes)):
            digest.update(name.encode() + b"\n" + file.read_bytes())
    return digest.hexdigest()[:32]


def _make(folder: Path, name: str, seed: int, robots: tuple[str, ...], settings: Settings) -> None:
    """Make a suite and write it, the whole of it or nothing."""
    kind = SUITES[name]
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with tempfile.TemporaryDirectory(prefix=".suite_", dir=folder) as temporary:
            new = Path(temporary)
            tasks = tuple(kind.build(seed, robots, new))
            names = sorted({task.scene for task in tasks})
            scenes = {scene: scene_digest(scene_path(new, scene)) for scene in names}
            suite = Suite(name, kind.revision, seed, robots, kind.methods, scenes, tasks)
            if (new / "scenes").exists():
                shutil.rmtree(folder / "scenes", ignore_errors=True)
                (new / "scenes").rename(folder / "scenes")
        made = Contents(suite, settings, versions(), _digest(suite))
        text = json.dumps({"format": FORMAT, "version": VERSION, **to_plain(made)}, indent=1)
        write_atomic(folder / "suite.json", f"{text}\n".encode())
    except OSError as error:
        raise InputError(f"{folder}: cannot be written ({error.strerror or error})") from error


def _digest(suite: Suite) -> str:
    return hashlib.sha256(json.dumps(to_plain(suite), sort_keys=True).encode()).hexdigest()[:32]


def _refuse_changed_scenes(folder: Path, suite: Suite) -> None:
    for name, digest in suite.scenes.items():
        try:
            same = scene_digest(scene_path(folder, name)) == digest
        except OSError as error:
            raise InputError(f"{folder}: {name}: cannot be read ({error.strerror})") from error
        if not same:
            raise InputError(f"{folder}: scene {name} was changed since; give another folder")
