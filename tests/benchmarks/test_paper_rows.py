"""The tables of the paper's suites in the docs are those of the rows that are kept."""

from __future__ import annotations

import importlib
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "docs" / "results"
ROWS = RESULTS / "rows"
FILES = sorted(ROWS.glob("*.csv.gz"))
SCANS = [ROWS / f"paper-real-scan{name}.csv.gz" for name in ("", "-other", "-unseen")]
SIMULATION, CHECKS = ROWS / "paper-sim.csv.gz", ROWS / "paper-sim-checks.csv.gz"


@pytest.fixture
def rows(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    return importlib.import_module("paper_rows")


@pytest.fixture(scope="module")
def text() -> str:
    """Return the words of both pages."""
    pages = (RESULTS / "paper.md", ROOT / "docs" / "paper.md")
    words = " ".join(" ".join(page.read_text(encoding="utf-8").split()) for page in pages)
    return words.replace("\\*", "*")


def test_rows_of_all_runs_are_kept() -> None:
    suites = {ROWS / f"{name}.csv.gz" for name in ("authors-sim", "paper-table")}
    assert set(FILES) == {*suites, *SCANS, SIMULATION, CHECKS}


@pytest.mark.parametrize(
    "file", [f for f in FILES if f not in (*SCANS, SIMULATION, CHECKS)], ids=lambda file: file.name
)
def test_every_line_of_a_table_is_computed_from_the_rows(rows: ModuleType, file: Path) -> None:
    answers = rows.read(file)
    text = (RESULTS / "paper.md").read_text(encoding="utf-8").splitlines()
    suite = file.name.partition(".")[0]
    lines = [*rows.table(suite, answers), *rows.medians(suite, answers)]
    assert len(lines) > 12
    assert not [line for line in lines if line not in text]
    assert len({(a.task, a.method, a.protocol) for a in answers}) == len(answers)


@pytest.mark.parametrize(
    ("name", "of"), [("paper-table", "phrases"), ("authors-sim", "kitchen_phrases")]
)
def test_what_the_pages_say_in_words_is_computed_from_the_rows(
    rows: ModuleType, text: str, name: str, of: str
) -> None:
    said = getattr(rows, of)(rows.read(ROWS / f"{name}.csv.gz"))
    assert not [phrase for phrase in said if phrase not in text]


def test_what_the_pages_say_of_scans_is_computed_from_the_rows(rows: ModuleType, text: str) -> None:
    known, *others = map(rows.read, SCANS)
    said = [*rows.scan_phrases(known, *others), *rows.scan_tables(known)]
    assert not [phrase for phrase in said if phrase not in text]


@pytest.mark.parametrize(
    ("file", "of", "phrases"), [(SIMULATION, "simulation_phrases", 7), (CHECKS, "check_phrases", 2)]
)
def test_what_the_pages_say_of_simulation_is_computed_from_the_rows(
    rows: ModuleType, text: str, file: Path, of: str, phrases: int
) -> None:
    answers = rows.read(file)
    said = [*getattr(rows, of)(answers), *rows.simulation_tables(answers)]
    assert len(said) == phrases + 1 + len({a.method for a in answers})
    assert not [phrase for phrase in said if phrase not in text]
    tasks = {}
    for a in answers:
        tasks.setdefault(a.method, []).append(a.task)
    assert len({tuple(sorted(names)) for names in tasks.values()}) == 1  # the same tasks for all


def test_rows_are_kept_without_loss(rows: ModuleType, tmp_path: Path) -> None:
    made = [
        rows.Answer("a 00", "open fridge", "ours", "first, pinch", True, 0.25, 1.5, {}),
        rows.Answer(
            "a 00", "open fridge", "m3", "first, pinch", False, 0.5, np.nan, {"search": 0.5}
        ),
    ]
    rows.write(made, tmp_path / "kept.csv.gz")
    again = rows.read(tmp_path / "kept.csv.gz")
    assert [str(one) for one in again] == [str(one) for one in made]
