"""The tables of the paper's suites in the docs are those of the rows that are kept."""

from __future__ import annotations

import importlib
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "docs" / "results"
FILES = sorted((RESULTS / "rows").glob("*.csv.gz"))


@pytest.fixture
def rows(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    return importlib.import_module("paper_rows")


def test_rows_of_both_suites_are_kept() -> None:
    assert [file.name for file in FILES] == ["authors-sim.csv.gz", "paper-table.csv.gz"]


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.name)
def test_every_line_of_a_table_is_computed_from_the_rows(rows: ModuleType, file: Path) -> None:
    answers = rows.read(file)
    text = (RESULTS / "paper.md").read_text(encoding="utf-8").splitlines()
    suite = file.name.partition(".")[0]
    lines = [*rows.table(suite, answers), *rows.medians(suite, answers)]
    assert len(lines) > 12
    assert not [line for line in lines if line not in text]
    assert len({(a.task, a.method, a.protocol) for a in answers}) == len(answers)


def test_rows_are_kept_without_loss(rows: ModuleType, tmp_path: Path) -> None:
    made = [
        rows.Answer("a 00", "open fridge", "ours", "first, pinch", True, 0.25, 1.5),
        rows.Answer("a 00", "open fridge", "m3", "first, pinch", False, 0.5, np.nan),
    ]
    rows.write(made, tmp_path / "kept.csv.gz")
    again = rows.read(tmp_path / "kept.csv.gz")
    assert [str(one) for one in again] == [str(one) for one in made]
