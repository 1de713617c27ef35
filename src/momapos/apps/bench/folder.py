"""Results folder: the suite, its scenes, and the rows of every node in SQLite.

suite.json            tasks, settings and versions
scenes/               generated scene files and models
rows-HOST.sqlite      rows of the runner on node HOST
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import re
import shutil
import socket
import sqlite3
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path
from typing import Any

from momapos.core import (
    FileFormatError,
    InputError,
    check_outputs,
    read_bytes_bounded,
    resolved,
    temporary_folder,
    version_of,
    write_atomic,
)
from momapos.model.scene import builtin_names, find_scene

from .bench_records import Row, Settings, Suite, from_plain, scene_digest, to_plain
from .suites import SUITES, Report, refuse_unknown, room_digests, write_rooms

FORMAT_VERSION = 1
"""Value of SQLite's `user_version` in the file."""
TYPES = {
    "seed": "INTEGER", "verified": "INTEGER", "done": "INTEGER", "checked": "INTEGER",
    "sampled": "INTEGER", "seconds": "REAL", "wall": "REAL", "driving": "REAL",
    "clearance": "REAL", "at_2cm": "REAL", "at_5cm": "REAL", "finished": "REAL",
}  # fmt: skip
NESTED = ("stages", "bases")
"""Columns that hold JSON."""
COLUMNS = tuple(item.name for item in fields(Row))
ADDED = ("at_2cm", "at_5cm", "protocol")
"""Columns that older files of this format lack."""
LOCK_TIMEOUT = 30.0
"""Time to wait for another writer [s]."""


class RowStore:
    """The rows of one node, open for writing.

    A row is on disk when `add` returns: every row flushes the write-ahead log, so that a killed
    process loses none.

    Raises:
        FileFormatError: The file is no results file of this version.
        InputError: The file can't be written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with self._write_errors():
            self.connection = sqlite3.connect(path, timeout=LOCK_TIMEOUT, isolation_level=None)
            _refuse_foreign(self.connection, path)
            self.connection.execute("PRAGMA journal_mode = WAL")
            self.connection.execute("PRAGMA synchronous = FULL")
            self.connection.execute(_schema())
            self.connection.execute(f"PRAGMA user_version = {FORMAT_VERSION}")

    def add(self, row: Row) -> bool:
        """Store a row, unless its job has one.

        Returns:
            Whether the row is new.

        Raises:
            InputError: The disk is full or can't be written; earlier rows remain.
        """
        marks = ", ".join("?" * len(COLUMNS))
        with self._write_errors():
            done = self.connection.execute(
                f"INSERT OR IGNORE INTO rows ({_names()}) VALUES ({marks})", _values(row)
            )
        return done.rowcount == 1

    def close(self) -> None:
        self.connection.close()

    @contextmanager
    def _write_errors(self) -> Iterator[None]:
        try:
            yield
        except sqlite3.Error as error:
            raise InputError(
                f"{self.path}: cannot be written ({error}); finished rows are saved, and the same "
                "command resumes the run"
            ) from error


def read_rows(path: Path) -> list[Row]:
    """Read all rows of a results file in the order of writing.

    Raises:
        FileFormatError: The file is no results file of this version.
    """
    try:
        connection = sqlite3.connect(
            resolved(path).as_uri() + "?mode=ro", uri=True, timeout=LOCK_TIMEOUT
        )
        try:
            _refuse_foreign(connection, path)
            names = _columns(connection, path)
            if not names:
                return []
            query = f"SELECT {_names(names)} FROM rows ORDER BY rowid"
            found = connection.execute(query).fetchall()
        finally:
            connection.close()
        return [_row(dict(zip(names, values, strict=True)), path) for values in found]
    except sqlite3.Error as error:
        raise FileFormatError(f"{path}: not a usable results file ({error})") from error


def _refuse_foreign(connection: sqlite3.Connection, path: Path) -> None:
    (version,) = connection.execute("PRAGMA user_version").fetchone()
    tables = {name for (name,) in connection.execute("SELECT name FROM sqlite_master")}
    if version != FORMAT_VERSION and (version or tables):
        raise FileFormatError(
            f"{path}: results format version {version}; this momapos reads version {FORMAT_VERSION}"
        )


def _columns(connection: sqlite3.Connection, path: Path) -> list[str]:
    """Return the columns of a file; none if its writer was killed before it created the table."""
    there = {column[1] for column in connection.execute("PRAGMA table_info(rows)")}
    if not there:
        return []
    missing = [name for name in COLUMNS if name not in there and name not in ADDED]
    if missing:  # SQLite would read the quoted name of a missing column as a string
        raise FileFormatError(f"{path}: not a usable results file (no column {missing[0]})")
    return [name for name in COLUMNS if name in there]


def _schema() -> str:
    columns = ", ".join(
        f'"{name}" {TYPES.get(name, "TEXT")}' + (" PRIMARY KEY" if name == "key" else "")
        for name in COLUMNS
    )
    return f"CREATE TABLE IF NOT EXISTS rows ({columns})"


def _names(columns: Sequence[str] = COLUMNS) -> str:
    return ", ".join(f'"{name}"' for name in columns)


def _values(row: Row) -> list[Any]:
    plain = to_plain(row)
    return [json.dumps(plain[name]) if name in NESTED else plain[name] for name in COLUMNS]


def _row(plain: dict[str, Any], path: Path) -> Row:
    try:
        plain |= {name: json.loads(plain[name]) for name in NESTED}
    except (TypeError, ValueError, RecursionError) as error:
        raise FileFormatError(f"{path}: row {plain['key']!r:.60}: damaged JSON") from error
    return from_plain(plain, Row, f"{path}: row {plain['key']!r:.60}")


FORMAT, VERSION = "momapos-bench", 1
MAX_BYTES = 100_000_000
PACKAGE = Path(__file__).parents[2]
DEPENDS_ON = ("momapos", "numpy", "ompl")


@dataclass(frozen=True)
class Contents:
    """Contents of suite.json."""

    suite: Suite
    settings: Settings
    versions: Mapping[str, str]
    digest: str
    """Content hash of the suite."""


@cache
def versions() -> dict[str, str]:
    """Return the versions that rows depend on; "code" is a hash of the package source."""
    digest = hashlib.sha256()
    for path in sorted(PACKAGE.rglob("*.py")):
        digest.update(path.relative_to(PACKAGE).as_posix().encode() + b"\n" + path.read_bytes())
    return {**{name: version_of(name) for name in DEPENDS_ON}, "code": digest.hexdigest()[:12]}


def _silent(*_: object) -> None:
    """Show no progress."""


def open_folder(
    folder: Path,
    name: str,
    seed: int,
    robots: Sequence[str],
    settings: Settings,
    limit: int | None = None,
    report: Report = _silent,
) -> Contents:
    """Open a results folder, or create it.

    Args:
        folder: The results folder.
        name: Name of the suite.
        seed: Seed of its tasks.
        robots: Robots of the run; the suite's robots if empty.
        settings: Settings for every task.
        limit: Number of tasks, drawn from the suite, whose rooms are written; None for all.
        report: Shows the progress of drawing rooms.

    Raises:
        UnknownNameError: There is no such suite or robot.
        InputError: The folder holds results of another suite, version or settings.
    """
    refuse_unknown(name, robots)
    kind = SUITES[name]
    chosen = tuple(dict.fromkeys(robots)) or kind.robots
    check_outputs(folders=[folder])
    if not (folder / "suite.json").exists():
        _make(folder, name, seed, chosen, settings, report)
    found = read_folder(folder)
    suite = found.suite
    differences = (
        ("suite", suite.name, name),
        ("seed", suite.seed, seed),
        ("robots", " ".join(suite.robots), " ".join(chosen)),
        ("revision", suite.revision, kind.revision),
        *(
            (item.name, getattr(found.settings, item.name), getattr(settings, item.name))
            for item in fields(Settings)
        ),
    )
    for what, there, wanted in differences:
        if there != wanted:
            raise InputError(
                f"{folder}: contains results of another run with {what} {_words(there)}, not "
                f"{_words(wanted)}; use another folder"
            )
    for package, version in versions().items():
        if found.versions.get(package) != version:
            raise InputError(
                f"{folder}: contains results of {package} {found.versions.get(package, '?')}, but "
                f"this is {version}; use another folder ('momapos bench report' still reads it)"
            )
    needed = {task.scene for task in suite.limited(limit)}
    if kind.rooms:
        write_rooms(seed, needed, folder, report)
    _refuse_changed_scenes(folder, suite, needed)
    return found


def read_folder(folder: Path) -> Contents:
    """Read the suite.json of a results folder.

    Raises:
        FileFormatError: The folder is no results folder of this version.
    """
    path = folder / "suite.json"
    if not path.exists():
        raise FileFormatError(f"{folder}: not a results folder (it has no suite.json)")
    try:
        data = json.loads(read_bytes_bounded(path, MAX_BYTES))
    except (ValueError, RecursionError) as error:
        raise FileFormatError(f"{path}: damaged JSON ({error})") from error
    head = (data.get("format"), data.get("version")) if isinstance(data, dict) else (None, None)
    if head != (FORMAT, VERSION):
        raise FileFormatError(
            f'{path}: unsupported suite file: "format" is {head[0]!r:.60}, "version" is '
            f"{head[1]!r:.60}; supported: {FORMAT!r}, {VERSION}"
        )
    found = from_plain(data, Contents, str(path))
    if found.digest != _digest(found.suite):
        raise FileFormatError(f"{path}: its tasks were modified; use another folder")
    return found


def all_rows(folder: Path) -> list[Row]:
    """Return the rows of all nodes; of several rows of one job, the first finished."""
    rows: dict[str, Row] = {}
    for path in sorted(folder.glob("rows-*.sqlite")):
        for row in read_rows(path):
            other = rows.setdefault(row.key, row)
            if row.finished < other.finished:
                rows[row.key] = row
    return list(rows.values())


def rows_file(folder: Path) -> Path:
    """Return the results file of this node."""
    host = re.sub(r"[^A-Za-z0-9_.-]", "_", socket.gethostname()) or "node"
    return folder / f"rows-{host}.sqlite"


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Lock a results folder against other runners of this node.

    Raises:
        InputError: Another runner uses the folder, or it can't be written.
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
            raise InputError(f"{folder}: in use by another 'momapos bench run'") from error
        yield


def scene_path(folder: Path, name: str) -> Path:
    """Return the file of a task's scene."""
    return find_scene(name if name in builtin_names() else folder / name)


def _make(
    folder: Path,
    name: str,
    seed: int,
    robots: tuple[str, ...],
    settings: Settings,
    report: Report,
) -> None:
    """Build a suite and write it without its rooms, or nothing."""
    kind = SUITES[name]
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with temporary_folder(folder, "suite") as new:
            objects = (Path(settings.problems),) if kind.needs_objects else ()
            known = room_digests(seed, report) if kind.rooms else {}
            tasks = tuple(kind.build(seed, robots, new, *objects))
            names = sorted({task.scene for task in tasks})
            scenes = {
                scene: known.get(scene) or scene_digest(scene_path(new, scene)) for scene in names
            }
            suite = Suite(name, kind.revision, seed, robots, kind.methods, scenes, tasks)
            if (new / "scenes").exists():
                shutil.rmtree(folder / "scenes", ignore_errors=True)
                (new / "scenes").rename(folder / "scenes")
        made = Contents(suite, settings, versions(), _digest(suite))
        text = json.dumps({"format": FORMAT, "version": VERSION, **to_plain(made)}, indent=1)
        write_atomic(folder / "suite.json", f"{text}\n".encode())
    except OSError as error:
        raise InputError(f"{folder}: cannot be written ({error.strerror or error})") from error


def _words(value: object) -> str:
    return "; ".join(map(str, value)) if isinstance(value, tuple) else str(value)


def _digest(suite: Suite) -> str:
    return hashlib.sha256(json.dumps(to_plain(suite), sort_keys=True).encode()).hexdigest()[:32]


def _refuse_changed_scenes(folder: Path, suite: Suite, names: Collection[str]) -> None:
    for name in sorted(names):
        try:
            same = scene_digest(scene_path(folder, name)) == suite.scenes[name]
        except OSError as error:
            raise InputError(f"{folder}: {name}: cannot be read ({error.strerror})") from error
        if not same:
            raise InputError(f"{folder}: scene {name} was modified; use another folder")
