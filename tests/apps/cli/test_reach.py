"""momapos reach: the chosen arm, and the comparison with inverse kinematics."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from momapos.apps.cli.main import main


def test_an_arm_without_a_map_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    for words in (["reach", "build", "stretch"], ["reach", "eval", "stretch"]):
        assert main(words) == 2
        shown = capsys.readouterr()
        assert "stretch has no reachability map: its arm has 5 degrees of freedom" in shown.err
        assert shown.err.count("\n") == 1


def test_a_file_contains_the_map_of_one_arm(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "two.reach"
    assert main(["reach", "build", "tiago_dual", "--out", str(out)]) == 2
    assert "can hold the map of one arm only; give --arm left or right" in capsys.readouterr().err
    assert not out.exists()
    assert main(["reach", "build", "tiago_dual", "--arm", "middle"]) == 2
    assert "no arm 'middle'" in capsys.readouterr().err


def test_errors_of_a_map_are_reported_near_the_boundary_and_in_the_ball(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["reach", "eval", "segway_ur5e", "--count", "400", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["misses_near_reach"] < 0.05
    assert told["false_positives_near_reach"] < 0.08
    assert told["reachable_near_reach"] > told["reachable"], "the ball is mostly out of reach"
