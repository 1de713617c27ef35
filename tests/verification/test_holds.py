"""The hand may turn about a bar or let go only where the plan says so."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from door_case import UP, Case, make_case

from momapos.core.errors import FileFormatError
from momapos.model.plan_files.plan_format import plan_to_dict, read_plan
from momapos.verification.plan_check import verify_files
from momapos.verification.report import Report

TURN = -0.6
"""Turn of the hand about the bar per turn of the door [-]."""
ALL = [0, 40]


def turning_case(**holds: Any) -> Case:
    case = make_case(TURN)
    case.plan["manipulation"] |= holds
    return case


def verify(case: Case, folder: Path) -> Report:
    return verify_files(case.write(folder))


def violations(report: Report) -> list[str]:
    return [check.name for check in report.violations]


def test_the_hand_may_turn_about_the_axis_that_the_plan_names(tmp_path: Path) -> None:
    report = verify(turning_case(holds=[ALL], turn_axes=[UP.tolist()]), tmp_path)
    assert not report.violations
    assert "grasp slips: rotation in the moved part" in {check.name for check in report.checks}


@pytest.mark.parametrize(
    "holds",
    [
        {},
        {"holds": [ALL]},
        {"holds": [ALL], "turn_axes": [None]},
        {"holds": [ALL], "turn_axes": [[1.0, 0.0, 0.0]]},
        {"holds": [ALL], "turn_axes": [[0.0, np.sin(0.3), np.cos(0.3)]]},
    ],
)
def test_a_turn_that_the_plan_does_not_name_is_a_slip(
    holds: dict[str, Any], tmp_path: Path
) -> None:
    found = violations(verify(turning_case(**holds), tmp_path))
    assert found == ["grasp slips: rotation in the moved part"]


def test_the_hand_may_not_slide_along_its_turn_axis(tmp_path: Path) -> None:
    case = turning_case(holds=[ALL], turn_axes=[UP.tolist()])
    case.set_door_values(np.linspace(0.0, 1.0, 41) ** 1.2)
    assert "grasp slips: translation in the moved part" in violations(verify(case, tmp_path))


def test_a_door_may_not_move_while_nothing_holds_it(tmp_path: Path) -> None:
    case = make_case()
    case.plan["manipulation"]["holds"] = [[0, 20], [25, 40]]
    assert violations(verify(case, tmp_path)) == ["object moves while nothing holds it"]


def test_a_hand_that_let_go_may_grasp_elsewhere(tmp_path: Path) -> None:
    """The second hold starts from a grasp that differs from the first."""
    case = make_case()
    manipulation = case.plan["manipulation"]
    for key in ("q", "object_q", "T_world_tool"):
        rows = manipulation[key]
        manipulation[key] = [*rows[:21], rows[20], rows[20], *rows[20:]]
    manipulation["holds"] = [[0, 20], [22, 43]]
    assert not violations(verify(case, tmp_path))


@pytest.mark.parametrize(
    "holds", [[[0, 41]], [[20, 10]], [[0, 20], [20, 40]], [[-1, 40]], [[25, 40], [0, 20]]]
)
def test_holds_that_are_not_ordered_ranges_are_rejected(
    holds: list[list[int]], tmp_path: Path
) -> None:
    case = make_case()
    case.plan["manipulation"]["holds"] = holds
    with pytest.raises(FileFormatError, match="holds must be"):
        read_plan(case.write(tmp_path))


@pytest.mark.parametrize("axes", [[[0.0, 0.0, 2.0]], [None, None], [[0.0, 0.0, 0.0]]])
def test_turn_axes_must_be_one_unit_vector_per_hold(axes: list[Any], tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match="turn_axes must be"):
        read_plan(turning_case(holds=[ALL], turn_axes=axes).write(tmp_path))


def test_holds_round_trip_through_a_plan_file(tmp_path: Path) -> None:
    case = turning_case(holds=[[0, 12], [13, 40]], turn_axes=[UP.tolist(), None])
    case.plan["manipulation"]["object_q"][13] = case.plan["manipulation"]["object_q"][12]
    manipulation = plan_to_dict(read_plan(case.write(tmp_path)))["manipulation"]
    assert manipulation["holds"] == [[0, 12], [13, 40]]
    assert [list(axis) if axis else axis for axis in manipulation["turn_axes"]] == [
        UP.tolist(),
        None,
    ]
