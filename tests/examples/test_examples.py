"""Laws of the examples: each runs unchanged."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = sorted((Path(__file__).parents[2] / "examples").glob("*.py"))
EXPECTED = {
    "01": "solved",
    "02": "infeasible",
    "03": "solved and valid",
    "04": "(1.25, -1.0, 2.98) feasible",
    "05": "27.3%",
    "06": "14.4 s",
    "07": "fridge",
    "08": "solved",
    "09": "(2.00 m, -1.43 m, 0.78 rad) after 0.17 m",
}
SLOW = ("08",)
"""Examples that take 30 s; a notebook does the same."""
MAX_LINES = 15
"""Maximum number of lines of an example, without its docstring and blank lines."""


def test_there_are_examples() -> None:
    assert len(EXAMPLES) == len(EXPECTED)


@pytest.mark.parametrize(
    "path",
    [
        pytest.param(path, id=path.stem, marks=pytest.mark.slow if path.name[:2] in SLOW else ())
        for path in EXAMPLES
    ],
)
def test_an_example_runs_and_prints_the_expected_text(path: Path) -> None:
    done = subprocess.run(
        [sys.executable, str(path)], capture_output=True, text=True, timeout=300,
        env={**os.environ, "PYTHONWARNINGS": "error::RuntimeWarning"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(EXPECTED[path.name[:2]]), done.stdout


@pytest.mark.parametrize(
    "path", [path for path in EXAMPLES if path.name[:2] != "08"], ids=lambda path: path.stem
)
def test_an_example_is_short_and_imports_public_names_only(path: Path) -> None:
    tree = ast.parse(path.read_text())
    doc, *_ = tree.body
    assert doc.end_lineno is not None
    lines = path.read_text().splitlines()[doc.end_lineno :]
    assert len([line for line in lines if line.strip()]) <= MAX_LINES
    modules = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert not [name for name in modules if name and name.startswith("momapos.")]
