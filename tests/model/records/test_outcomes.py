"""Outcomes of base poses have texts that name the obstacle and the waypoint."""

from __future__ import annotations

import pytest

from momapos.model.records.outcomes import PoseOutcome, PoseStatus


@pytest.mark.parametrize(
    ("outcome", "words", "summary"),
    [
        (PoseOutcome(PoseStatus.BASE_BLOCKED), "base in collision", "base in collision"),
        (
            PoseOutcome(PoseStatus.WAYPOINT_OUT_OF_REACH, where="waypoint 12"),
            "out of reach at waypoint 12", "out of reach at a waypoint",
        ),
        (
            PoseOutcome(PoseStatus.ARM_COLLISION, "oven/door", "the pre-grasp"),
            "arm hits oven/door at the pre-grasp", "arm hits oven/door",
        ),
        (
            PoseOutcome(PoseStatus.HOME_COLLISION, "oven/door"),
            "arm at home hits oven/door", "arm at home hits oven/door",
        ),
        (
            PoseOutcome(PoseStatus.EXACT_CHECK, "finger in {wall} at 0.31"),
            "exact check: finger in {wall} at 0.31", "exact check",
        ),
        (
            PoseOutcome(PoseStatus.TASK_INFEASIBLE, "the hand hits x in every grasp"),
            "the hand hits x in every grasp", "the hand hits x in every grasp",
        ),
    ],
)  # fmt: skip
def test_an_outcome_has_a_full_text_and_a_summary(
    outcome: PoseOutcome, words: str, summary: str
) -> None:
    assert str(outcome) == words
    assert outcome.summary == summary
