"""Laws of the row store: rows are complete, unique, and survive crashes."""

from __future__ import annotations

import os
import random
import re
import select
import signal
import sqlite3
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest
from tests.apps.bench.fakes import row

from momapos.apps.bench.folder import ADDED, RowStore, all_rows, read_rows, rows_file
from momapos.core.errors import FileFormatError, InputError

KILLS, JOBS = 10, 1200
RUNNER = str(Path(__file__).parent / "killed_runner.py")


def test_a_row_is_read_as_it_was_stored(tmp_path: Path) -> None:
    rows = [
        row("full"),
        row("other", done=False, reason="the hold broke; 'quoted' \"words\" \n é", bases=()),
        row("empty", outcome="failed", verified=None, seconds=None, driving=None, checked=None,
            stages={}, clearance=None),
    ]  # fmt: skip
    store = RowStore(tmp_path / "rows.sqlite")
    assert all(store.add(one) for one in rows)
    assert read_rows(store.path) == rows  # while it is open for writing
    store.close()
    assert read_rows(store.path) == rows


def test_files_from_before_a_column_was_added_are_read(tmp_path: Path) -> None:
    store = RowStore(tmp_path / "rows.sqlite")
    store.add(row("one", at_2cm=1.0, at_5cm=0.5))
    for name in ADDED:
        store.connection.execute(f"ALTER TABLE rows DROP COLUMN {name}")
    store.close()
    assert read_rows(store.path) == [row("one")]


def test_an_empty_file_of_a_killed_runner_can_be_used(tmp_path: Path) -> None:
    path = tmp_path / "rows.sqlite"
    path.touch()
    assert read_rows(path) == []
    store = RowStore(path)
    assert store.add(row("one"))
    store.close()
    assert read_rows(path) == [row("one")]


def test_a_file_without_a_required_column_is_refused(tmp_path: Path) -> None:
    store = RowStore(tmp_path / "rows.sqlite")
    store.connection.execute("ALTER TABLE rows DROP COLUMN outcome")
    store.close()
    with pytest.raises(FileFormatError, match="no column outcome"):
        read_rows(store.path)


def test_a_job_keeps_its_first_row(tmp_path: Path) -> None:
    store = RowStore(tmp_path / "rows.sqlite")
    assert store.add(row("one", reason="first"))
    assert not store.add(row("one", reason="second"))
    assert [kept.reason for kept in read_rows(store.path)] == ["first"]


def test_a_full_disk_is_reported_and_loses_no_row(tmp_path: Path) -> None:
    store = RowStore(tmp_path / "rows.sqlite")
    (pages,) = store.connection.execute("PRAGMA page_count").fetchone()
    store.connection.execute(f"PRAGMA max_page_count = {pages + 10}")
    added: list[bool] = []

    def fill() -> None:
        while True:
            added.append(store.add(row(f"key {len(added)}", reason="long " * 200)))

    with pytest.raises(InputError, match=r"rows.sqlite: cannot be written .* full"):
        fill()
    assert added
    assert len(read_rows(store.path)) == len(added)


def test_files_of_another_format_or_version_are_refused(tmp_path: Path) -> None:
    text, other = tmp_path / "text.sqlite", tmp_path / "other.sqlite"
    text.write_text("this is no database, but longer than the header of one " * 10)
    connection = sqlite3.connect(other)
    connection.execute("PRAGMA user_version = 99")
    connection.close()
    with pytest.raises(FileFormatError, match=r"text.sqlite: not a usable results file"):
        read_rows(text)
    with pytest.raises(InputError, match=r"text.sqlite: cannot be written"):
        RowStore(text)
    for use in (read_rows, RowStore):
        with pytest.raises(
            FileFormatError, match=r"other.sqlite: results format version 99; .* reads version 1"
        ):
            use(other)


def test_a_damaged_row_is_reported(tmp_path: Path) -> None:
    store = RowStore(tmp_path / "rows.sqlite")
    store.add(row("one"))
    for change, message in (("stages = '{'", "damaged JSON"), ("outcome = 'won'", "outcome")):
        store.connection.execute(f"UPDATE rows SET {change}")
        with pytest.raises(FileFormatError, match=message):
            read_rows(store.path)
        store.connection.execute("UPDATE rows SET stages = '{}', outcome = 'solved'")


def test_of_two_nodes_the_first_finished_row_counts(tmp_path: Path) -> None:
    for host, finished in (("a", 5.0), ("b", 3.0)):
        store = RowStore(tmp_path / f"rows-{host}.sqlite")
        store.add(row("one", host=host, finished=finished))
        store.close()
    assert [kept.host for kept in all_rows(tmp_path)] == ["b"]


@pytest.mark.timeout(300)
def test_a_run_killed_at_random_moments_loses_no_row_and_repeats_none(tmp_path: Path) -> None:
    rng, printed = random.Random(0), []
    path = [*sys.path, str(Path(__file__).parents[3])]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path)}
    for kill in range(KILLS + 1):
        command = [sys.executable, RUNNER, str(tmp_path), str(JOBS)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, env=environment) as runner:
            assert runner.stdout.readline() == b"begins\n"
            if kill < KILLS:
                with os.fdopen(os.pidfd_open(runner.pid)) as ended:
                    select.select([ended], [], [], rng.uniform(0.0, 0.2))
                runner.send_signal(signal.SIGKILL)
            printed += re.findall(r"(key \d+)\n", runner.stdout.read().decode())
        reported = {one.key for one in read_rows(rows_file(tmp_path))} if printed else set()
        assert set(printed) <= reported
    assert runner.returncode == 0
    assert max(Counter(printed).values()) == 1
    kept = [one.key for one in all_rows(tmp_path)]
    assert sorted(kept) == sorted(f"key {k}" for k in range(JOBS))
