"""Laws of CI: it runs the commands of the README first."""

from __future__ import annotations

import re
from pathlib import Path

from tests import optional

REPOSITORY = Path(__file__).parents[2]
TARGET = re.compile(r"make ([a-z-]+)")


def read(name: str) -> str:
    return (REPOSITORY / name).read_text()


def readme_commands() -> list[str]:
    """Return the commands of the README's first block, without comments."""
    block = read("README.md").split("```")[1]
    return [line.partition("#")[0].strip() for line in block.splitlines() if line.strip()]


def ci_commands() -> list[str]:
    """Return every command of .ci/run."""
    lines = (line.strip() for line in read(".ci/run").splitlines())
    return [line for line in lines if line and not line.startswith("#")]


def development_commands() -> list[str]:
    """Return the commands of DEVELOPMENT.md's table."""
    return re.findall(r"^\| `([^`]*make [^`]*)` \|", read("DEVELOPMENT.md"), re.MULTILINE)


def targets() -> set[str]:
    return set(re.findall(r"^([a-z-]+):", read("Makefile"), re.MULTILINE))


def test_the_readme_begins_with_two_existing_commands() -> None:
    assert readme_commands() == ["make demo", "make test"]
    assert {"demo", "test"} <= targets()


def test_ci_runs_the_commands_of_the_readme_first() -> None:
    setup, commands = ci_commands()[:2], ci_commands()[2:]
    assert setup == ["set -euo pipefail", 'cd "$(dirname "$0")/.."']
    assert commands[: len(readme_commands())] == readme_commands()


def test_a_failure_of_any_command_fails_ci() -> None:
    makes = [line for line in ci_commands() if "make " in line]
    assert all(re.fullmatch(r"make [a-z-]+", line) for line in makes), makes
    assert {TARGET.fullmatch(line).group(1) for line in makes} <= targets()  # type: ignore[union-attr]


def test_ci_runs_the_targets_of_optional_dependencies() -> None:
    left_out = {f"make {target}" for how in optional.GET.values() for target in TARGET.findall(how)}
    assert left_out - {"make test"} <= set(ci_commands())
    assert len(left_out) > 3
    installed = [how for how in optional.GET.values() if how.startswith("apt-get")]
    assert all(how.removeprefix("apt-get install") in read(".ci/run") for how in installed)


def test_ci_runs_every_developer_command_that_needs_no_data() -> None:
    *commands, with_data = development_commands()
    assert with_data == "MOMAPOS_SHARED=FOLDER make test"
    assert commands == [line for line in ci_commands() if line.startswith("make test-")]
