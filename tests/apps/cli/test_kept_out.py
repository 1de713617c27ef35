"""If restrictions of the base pose leave none, the output says so."""

from __future__ import annotations

import pytest
from tests.commands import output_of

DRAWER = ["place", "open", "kitchen_small", "cabinet_right/drawer_middle_slide", "--no-advice"]
WHY = "violate a restriction"
AREA = "no way to drive there outside the keep-out area around (0.00, 0.00), where the robot starts"


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["--keep-in", "-9,-9 -8,-9 -8,-8"], "outside the keep-in areas"),
        (["--keep-out", "-9,-9 9,-9 9,9 -9,9"], AREA),
        (["--most-driving", "0m"], "longer drive than allowed"),
    ],
)
def test_the_output_names_the_restriction_that_leaves_no_base_pose(
    words: list[str], reason: str
) -> None:
    shown = output_of(*DRAWER, "--robot", "segway_ur5e", *words, status=3)
    assert WHY in shown or f"infeasible  {AREA}" in shown
    assert reason in shown


def test_the_output_names_no_restriction_if_the_arm_is_the_reason() -> None:
    low = [*DRAWER[:3], "cabinet_right/drawer_bottom_slide", *DRAWER[4:], "--robot", "segway_ur5e"]
    assert WHY not in output_of(*low, "--most-driving", "9m", status=3)
