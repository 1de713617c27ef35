"""`python -m momapos` is the command line."""

from __future__ import annotations

import subprocess
import sys


def test_the_package_runs_as_a_module() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "momapos", "--version"], capture_output=True, text=True, check=True
    )
    assert done.stdout.startswith("momapos ")
    wrong = subprocess.run(
        [sys.executable, "-m", "momapos", "plcae"], capture_output=True, text=True
    )
    assert wrong.returncode == 2
    assert "place" in wrong.stderr
