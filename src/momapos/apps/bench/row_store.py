"""Rows in SQLite: what was reported is on the disk, and no job has two rows."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import Any

from momapos.core import FileFormatError, InputError

from .bench_records import Row, from_plain, to_plain

FORMAT_VERSION = 1
"""Stands in the file as `user_version`."""
TYPES = {
    "seed": "INTEGER", "verified": "INTEGER", "done": "INTEGER", "checked": "INTEGER",
    "sampled": "INTEGER", "seconds": "REAL", "wall": "REAL", "driving": "REAL",
    "clearance": "REAL", "at_2cm": "REAL", "at_5cm": "REAL", "finished": "REAL",
}  # fmt: skip
NESTED = ("stages", "bases")
"""Columns that hold JSON."""
COLUMNS = tuple(item.name for item in fields(Row))
ADDED = ("at_2cm", "at_5cm")
"""Columns that older files of this format lack."""
WAIT = 30.0
"""How long a writer waits for another one [s]."""


class Store:
    """The rows of one node, open for writing.

    A row is on the disk when `add` returns: the journal is written ahead and flushed with every
    row, so that a process that is killed loses none.

    Raises:
        FileFormatError: The file is no results file of this version.
        InputError: It cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with self._told():
            self.connection = sqlite3.connect(path, timeout=WAIT, isolation_level=None)
            _refuse_foreign(self.connection, path)
            self.connection.execute("PRAGMA journal_mode = WAL")
            self.connection.execute("PRAGMA synchronous = FULL")
            self.connection.execute(_schema())
            self.connection.execute(f"PRAGMA user_version = {FORMAT_VERSION}")

    def add(self, row: Row) -> bool:
        """Keep a row.

        Returns:
            Whether it is new; a job that has a row keeps it.

        Raises:
            InputError: The disk is full, or cannot be written to; earlier rows are kept.
        """
        marks = ", ".join("?" * len(COLUMNS))
        with self._told():
            done = self.connection.execute(
                f"INSERT OR IGNORE INTO rows ({_names()}) VALUES ({marks})", _values(row)
            )
        return done.rowcount == 1

    def close(self) -> None:
        """Close the file."""
        self.connection.close()

    @contextmanager
    def _told(self) -> Iterator[None]:
        try:
            yield
        except sqlite3.Error as error:
            raise InputError(
                f"{self.path}: cannot be written ({error}); the rows of finished jobs are kept, "
                "and the same command goes on from there"
            ) from error


def read_rows(path: Path) -> list[Row]:
    """All rows of a results file, in the order in which they were written.

    Raises:
        FileFormatError: It is no results file of this version.
    """
    try:
        connection = sqlite3.connect(path.resolve().as_uri() + "?mode=ro", uri=True, timeout=WAIT)
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
            f"{path}: version {version} of the results format; this momapos reads version "
            f"{FORMAT_VERSION}"
        )


def _columns(connection: sqlite3.Connection, path: Path) -> list[str]:
    """The columns that a file has; those that are younger than it have no value.

    None in an empty file: its writer was killed before it had made the table.

    Raises:
        FileFormatError: It lacks one that every file of this version has.
    """
    there = {column[1] for column in connection.execute("PRAGMA table_info(rows)")}
    if not there:
        return []
    lacking = [name for name in COLUMNS if name not in there and name not in ADDED]
    if lacking:  # SQLite takes the quoted name of a column that there is not for a text
        raise FileFormatError(f"{path}: not a usable results file (no column {lacking[0]})")
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
