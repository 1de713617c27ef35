"""Laws of the benchmark scripts: each starts, so that no rename breaks one silently."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]
FOLDER = REPOSITORY / "benchmarks"
SCRIPTS = tuple(p.name for p in sorted(FOLDER.glob("*.py")) if "__main__" in p.read_text())
RUNS = re.findall(
    r'^    f?"(\w+\.py(?: [a-z][a-z-]+(?= |"))?)(.*)",',
    (FOLDER / "run.py").read_text(),
    re.MULTILINE,
)
"""What `make bench` runs: script, with the name of its measurement if it has several; options."""
PRINT_HELP = """
import contextlib, io, json, runpy, sys
found = {}
folder, *commands = sys.argv[1:]
for command in commands:
    script, *words = command.split()
    sys.argv, text = [f"{folder}/{script}", *words, "--help"], io.StringIO()
    try:
        with contextlib.redirect_stdout(text):
            runpy.run_path(sys.argv[0], run_name="__main__")
    except SystemExit as end:
        found[command] = end.code or 0, text.getvalue()
print(json.dumps(found))
"""
SMALLEST = {
    "placement.py --robots fetch --scenes kitchen_small --only microwave --out out": "fetch: ",
    "execution.py --robots segway_ur5e --rooms built-in --tasks 1 --seed 1 --out out": (
        "noise off: "
    ),
    "drive.py --robots segway_ur5e --drives 1 --layouts 0": "arrived: within",
    "parts.py --drawn 1 --shared nowhere --pictures out": "fronts recognized: ",
    "importance.py ranking --repeats 1": "| kitchen_small | 17 |",
}
"""Smallest inputs, and a text of their reports. The other scripts take more than 10 s."""


def run(*command: str, folder: Path, shared: Path) -> str:
    path = os.pathsep.join(map(str, (FOLDER, REPOSITORY, REPOSITORY / "src")))
    environment = {**os.environ, "PYTHONPATH": path, "MOMAPOS_SHARED": str(shared)}
    done = subprocess.run(
        [sys.executable, *command], capture_output=True, text=True, cwd=folder, env=environment
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def help_of(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[int, str]]:
    """Return exit status and help text of every script and run, from one process."""
    folder = tmp_path_factory.mktemp("help")
    commands = {*SCRIPTS, *(command for command, _ in RUNS)}
    found: dict[str, tuple[int, str]] = json.loads(
        run("-c", PRINT_HELP, str(FOLDER), *commands, folder=folder, shared=folder)
    )
    return found


@pytest.mark.parametrize("script", SCRIPTS)
def test_a_script_has_a_help_text(script: str, help_of: dict[str, tuple[int, str]]) -> None:
    status, text = help_of[script]
    assert status == 0
    assert "--help" in text


def test_make_bench_passes_existing_options(help_of: dict[str, tuple[int, str]]) -> None:
    assert len(RUNS) > 10
    for command, rest in RUNS:
        for option in re.findall(r"--[a-z-]+", rest):
            assert option in help_of[command][1], f"{command} {option}"


@pytest.mark.slow
@pytest.mark.parametrize("command", SMALLEST, ids=lambda command: command.split()[0])
def test_a_benchmark_runs_on_its_smallest_input(command: str, tmp_path: Path) -> None:
    script, *options = shlex.split(command)
    out = run(str(FOLDER / script), *options, folder=tmp_path, shared=tmp_path)
    assert SMALLEST[command] in out
