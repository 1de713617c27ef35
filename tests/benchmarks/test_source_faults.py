"""Laws of the faults that the benchmark of our tests puts into the sources."""

from __future__ import annotations

import ast
import importlib
from collections import Counter
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

REPOSITORY = Path(__file__).parents[2]


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(REPOSITORY / "benchmarks"))
    return importlib.import_module("source_faults")


def test_faults_change_the_meaning_of_one_line_each(bench: ModuleType) -> None:
    drawn = bench.draw(bench.GROUPS, 40, np.random.default_rng(3))
    assert sorted(Counter(fault.group for fault in drawn).values()) == [13, 13, 14]
    assert len({(fault.file, fault.line) for fault in drawn}) == 40
    for fault in drawn:
        text = (REPOSITORY / "src" / fault.file).read_text()
        lines = text.splitlines()
        assert lines[fault.line - 1] == fault.before
        lines[fault.line - 1] = fault.after
        assert ast.dump(ast.parse("\n".join(lines))) != ast.dump(ast.parse(text))


def test_words_annotations_and_errors_have_no_faults(bench: ModuleType) -> None:
    text = '''
"""1.0 + 2.0"""
Vec = tuple[float, 3]
def f(a: "x + y", b: int = 1) -> "x - y":
    """a + b"""
    if a < b:
        raise ValueError(f"{a + b} is more than {2.0 * b}")
    return f"{a + b}" + "c"
'''
    assert list(bench.faults_in(text, "verification", "f.py")) == []


def test_each_kind_of_fault_is_found(bench: ModuleType) -> None:
    text = "def f(a, b):\n    return min(a[0] * abs(b), 2.5) if not a < b and -b else sin(a) + b\n"
    after = {
        (fault.kind, fault.after.strip()[7:])
        for fault in bench.faults_in(text, "verification", "f.py")
    }
    assert {kind for kind, _ in after} == {
        "+ and -", "* and /", "factor dropped", "< and >", "min and max", "sine and cosine",
        "and, or, not", "sign dropped", "absolute value dropped", "number doubled", "index moved",
    }  # fmt: skip
    assert ("index moved", "min((a[1]) * abs(b), 2.5) if not a < b and -b else sin(a) + b") in after
    assert (
        "number doubled",
        "min(a[0] * abs(b), 5.0) if not a < b and -b else sin(a) + b",
    ) in after
