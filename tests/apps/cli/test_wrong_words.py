"""Wrong arguments are one line that says what is wrong and where help is."""

from __future__ import annotations

import pytest
from tests.commands import error_of

from momapos.apps.cli.parse import in_one_line

DOOR = ("place", "open", "kitchen_small", "fridge/door_hinge")


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        (
            (*DOOR, "--robto", "fetch"),
            ["Unrecognized options: --robto", "mean --robot or --robust?"],
        ),
        ((*DOOR, "again"), ["Unrecognized options: again"]),
        ((*DOOR, "--robot"), ["--robot", "Missing value"]),
        ((*DOOR, "--timeout", "three"), ["--timeout", "three"]),
        ((*DOOR, "--method", "gess"), ["--method", "'gess'", "habitat"]),
        (("place", "open"), ["Missing", "OBJECT[/JOINT]", "built-in kitchen"]),
        (("rank",), ["Missing", "OBJECT[/JOINT]"]),
    ],
)
@pytest.mark.parametrize("columns", ["40", "200"])
def test_wrong_arguments_are_reported_in_one_line(
    words: tuple[str, ...], parts: list[str], columns: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", columns)
    shown = error_of(*words)
    prog = " ".join(["momapos", *words[: 2 if words[0] == "place" else 1]])
    assert shown.endswith(f"; see {prog} --help")
    assert [text for text in parts if text not in shown] == []


@pytest.mark.parametrize(
    "lines",
    [
        ["╭─ Title ──╮", "│ what is  │", "│ wrong.   │", "│ ──────── │", "│ more     │", "╰──╯"],
        [" Title    ", " -------- ", "  what is ", "  wrong.  ", "  --------", "  more    "],
        ["\x1b[31m╭─\x1b[0m Title", "\x1b[31m│\x1b[0m what is wrong.", "│ ──────── │", "│ more │"],
    ],
)  # fmt: skip
def test_frames_and_colors_are_removed(lines: list[str]) -> None:
    assert in_one_line("\n".join(lines)) == "what is wrong"
