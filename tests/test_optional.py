"""Laws of skipped tests: every skip names the command that runs the test."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest
from tests import optional

TESTS = Path(__file__).parent
REPOSITORY = TESTS.parent
COMMAND = re.compile(
    r"^(MOMAPOS_SHARED=FOLDER )?make (?P<target>[a-z-]+)|^apt-get install \S|pip install \S"
)
SKIPS = {"skip", "skipif", "importorskip", "xfail"}


def skips_of(path: Path) -> list[int]:
    """Return the lines of a file that skip with pytest's own functions."""
    calls = (n for n in ast.walk(ast.parse(path.read_text())) if isinstance(n, ast.Attribute))
    return [n.lineno for n in calls if n.attr in SKIPS and ast.unparse(n).startswith("pytest.")]


@pytest.mark.parametrize("what", optional.GET)
def test_each_reason_names_an_existing_command(what: str) -> None:
    found = COMMAND.search(optional.GET[what])
    assert found is not None, f"{optional.GET[what]!r} is no command"
    target = found.group("target")
    if target is not None:
        assert re.search(rf"^{target}:", (REPOSITORY / "Makefile").read_text(), re.MULTILINE)
    assert optional.GET[what] in optional.reason(what)


def test_every_skip_takes_its_reason_from_the_table() -> None:
    direct = {
        f"{path.relative_to(TESTS)}:{line}"
        for path in TESTS.rglob("*.py")
        if path != TESTS / "optional.py"
        for line in skips_of(path)
    }
    assert direct == set()
    assert len(skips_of(TESTS / "optional.py")) == 2


def test_the_list_of_skips_counts_the_tests_of_each_reason() -> None:
    def report(reason: str) -> pytest.TestReport:
        where = ("test_x.py", 1, f"Skipped: {reason}")
        return pytest.TestReport(
            "test_x.py::y", ("test_x.py", 1, "y"), {}, "skipped", where, "call"
        )

    torch, egl = optional.reason("torch"), optional.reason("EGL")
    lines = optional.skipped([report(torch), report(egl), report(torch)])
    assert lines == [f"   2 {torch}", f"   1 {egl}"]


def test_a_run_ends_with_the_list_of_skipped_tests(pytester: pytest.Pytester) -> None:
    """The tests run in another process than the summary, as in `make test`."""
    pytester.makeconftest((TESTS / "conftest.py").read_text())
    pytester.makepyfile(
        """
        import pytest
        from tests import optional

        @optional.needs("EGL", False)
        @pytest.mark.parametrize("k", range(3))
        def test_a(k):
            pass

        def test_b(tmp_path):
            optional.there(tmp_path / "nothing")
        """
    )
    pytester.makeini(f"[pytest]\npythonpath = {REPOSITORY}")
    out = pytester.runpytest_subprocess("-q", "-n", "1", "-p", "no:cacheprovider")
    reasons = ["EGL", "real data"]
    expected = [
        f"*{count} {optional.reason(what)}" for count, what in zip((3, 1), reasons, strict=True)
    ]
    out.stdout.fnmatch_lines(["*not run here*", *expected])
