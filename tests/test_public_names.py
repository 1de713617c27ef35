"""Laws of the public interface: typed, documented, quick to import."""

from __future__ import annotations

import inspect
import re
import subprocess
import sys
from pathlib import Path

import pytest

import momapos

PAGE = Path(__file__).parents[1] / "docs" / "api.md"


@pytest.mark.parametrize("name", momapos.__all__)
def test_a_public_name_has_a_docstring_of_its_own(name: str) -> None:
    text = inspect.getdoc(getattr(momapos, name))
    assert text
    assert not text.startswith(f"{name}("), "a dataclass without a docstring"


def test_the_page_lists_every_public_name_and_no_other() -> None:
    sections = re.findall(r"^Names: (.+(?:\n.+)*)", PAGE.read_text(), re.MULTILINE)
    listed = re.findall(r"`(\w+)`", " ".join(sections))
    assert sorted(listed) == sorted(momapos.__all__)


@pytest.mark.slow
def test_a_type_checker_knows_the_public_names(tmp_path: Path) -> None:
    program = tmp_path / "program.py"
    program.write_text("import momapos\nreveal_type(momapos.plan_base_placement)\n")
    command = [sys.executable, "-m", "mypy", "--cache-dir", str(tmp_path / "cache"), str(program)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
    assert "PlacementResult" in done.stdout, done.stdout + done.stderr


def test_importing_the_package_loads_nothing_heavy() -> None:
    program = "import momapos, sys; print(*{'numpy', 'numba', 'scipy'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.stdout.strip() == "", done.stdout + done.stderr
