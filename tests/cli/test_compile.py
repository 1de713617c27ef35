"""Compiling once after installation: shared by two processes, and safe with one."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from momapos.cli.compile_arm import path_of_an_arm_at_rest
from momapos.cli.main import main
from momapos.manipulation.arm_path import FOUND


def test_the_helper_comes_to_the_end_of_an_arm_path() -> None:
    assert path_of_an_arm_at_rest().status == FOUND


def test_the_helper_is_silent() -> None:
    command = [sys.executable, "-m", "momapos.cli.compile_arm"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("", "")


@pytest.mark.parametrize("executable", ["", "/no/such/python"])
def test_an_answer_needs_no_helper(
    executable: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MOMAPOS_CACHE", str(tmp_path))
    monkeypatch.setattr(sys, "executable", executable)
    assert main(["place", "open", "kitchen_small", "microwave", "--robot", "segway_ur5e"]) == 0
    assert any(entry.name.startswith("compiled-") for entry in tmp_path.iterdir())
