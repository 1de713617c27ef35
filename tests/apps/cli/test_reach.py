"""momapos reach: the chosen arm, and the comparison with inverse kinematics."""

from __future__ import annotations

from pathlib import Path

from tests.commands import error_of, json_of


def test_an_arm_without_a_map_is_refused() -> None:
    for words in (["reach", "build", "stretch"], ["reach", "eval", "stretch"]):
        assert "stretch has no reachability map: its arm has 5 degrees of freedom" in error_of(
            *words
        )


def test_a_file_contains_the_map_of_one_arm(tmp_path: Path) -> None:
    out = tmp_path / "two.reach"
    assert "can hold the map of one arm only; give --arm left or right" in error_of(
        "reach", "build", "tiago_dual", "--out", str(out)
    )
    assert not out.exists()
    assert "no arm 'middle'" in error_of("reach", "build", "tiago_dual", "--arm", "middle")


def test_errors_of_a_map_are_reported_near_the_boundary_and_in_the_ball() -> None:
    rates = json_of("reach", "eval", "segway_ur5e", "--count", "400", "--json")
    assert rates["misses_near_reach"] < 0.05
    assert rates["false_positives_near_reach"] < 0.08
    assert rates["reachable_near_reach"] > rates["reachable"], "the ball is mostly out of reach"
