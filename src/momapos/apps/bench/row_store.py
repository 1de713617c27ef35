"""Store rows in SQLite: each job has one row, which is on disk before it is reported."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import Any

from momapos.core import FileFormatError, InputError, resolved

from .bench_records import Row, from_plain, to_plain

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
