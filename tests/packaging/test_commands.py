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


def everything() -> set[str]:
    """Return the targets that `make test-all` runs."""
    found = re.search(r"^test-all:(.*)$", read("Makefile"), re.MULTILINE)
    return set(found[1].split())


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


def test_test_all_runs_the_targets_of_optional_dependencies() -> None:
    left_out = {target for how in optional.GET.values() for target in TARGET.findall(how)}
    assert left_out <= everything()
    assert len(left_out) > 3


def test_test_all_runs_all_that_ci_runs() -> None:
    in_ci = {found[1] for line in ci_commands() if (found := TARGET.fullmatch(line))}
    assert in_ci - {"demo"} <= everything()


def test_the_developers_page_lists_every_target_of_tests() -> None:
    *commands, with_data = development_commands()
    assert with_data == "MOMAPOS_SHARED=FOLDER make test"
    listed = {found[1] for line in commands if (found := TARGET.match(line))}
    assert listed == {name for name in targets() if name.startswith("test")}
