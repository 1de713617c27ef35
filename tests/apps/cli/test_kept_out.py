"""Areas that leave no base pose are the reason that a "no" names."""

from __future__ import annotations

import pytest

from momapos.apps.cli.main import main

DRAWER = ["place", "open", "kitchen_small", "cabinet_right/drawer_middle_slide"]
WHY = "breaks a rule about where it may stand"


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["--keep-in", "-9,-9 -8,-9 -8,-8"], "outside the areas to keep in"),
        (["--keep-out", "-9,-9 9,-9 9,9 -9,9"], "in an area to keep out of"),
        (["--most-driving", "0m"], "farther to drive than allowed"),
    ],
)
def test_a_no_names_the_rule_that_leaves_no_base_pose(
    words: list[str], reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*DRAWER, "--robot", "segway_ur5e", *words]) == 3
    said = capsys.readouterr().out
    assert WHY in said
    assert reason in said


def test_a_no_of_the_arm_does_not_name_the_areas(capsys: pytest.CaptureFixture[str]) -> None:
    low = [*DRAWER[:3], "cabinet_right/drawer_bottom_slide", "--robot", "segway_ur5e"]
    assert main([*low, "--most-driving", "9m"]) == 3
    assert WHY not in capsys.readouterr().out
