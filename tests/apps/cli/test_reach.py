"""`momapos reach`: of which arm, and against what."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from momapos.apps.cli.main import main


def test_an_arm_that_can_have_no_map_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    for words in (["reach", "build", "stretch"], ["reach", "eval", "stretch"]):
        assert main(words) == 2
        said = capsys.readouterr()
        assert "stretch has no reachability map: its arm has 5 degrees of freedom" in said.err
        assert said.err.count("\n") == 1


def test_a_file_holds_the_map_of_one_arm(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "two.reach"
    assert main(["reach", "build", "tiago_dual", "--out", str(out)]) == 2
    assert "holds the map of one arm: give --arm left or right" in capsys.readouterr().err
    assert not out.exists()
    assert main(["reach", "build", "tiago_dual", "--arm", "middle"]) == 2
    assert "no arm 'middle'" in capsys.readouterr().err


def test_what_a_map_misses_is_told_near_reach_and_in_the_ball(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["reach", "eval", "segway_ur5e", "--count", "400", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["misses_near_reach"] < 0.05
    assert told["false_positives_near_reach"] < 0.08
    assert told["reachable_near_reach"] > told["reachable"], "the ball is mostly out of reach"
