"""Share the time limit of an answer with what follows the search, and say what it ended."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from momapos.core import OutOfTimeError
from momapos.model.records import PlacementPlan

from .result import PlacementResult

FARTHEST, ADVICE = "largest value", "advice"
"""Names of the times of steps after the search, which its total does not contain."""


def time_left(plan: PlacementPlan, timeout: float) -> float:
    """Return the time for what follows the search of a plan [s].

    Args:
        plan: The plan, with the time that its search took.
        timeout: Time limit of the whole answer [s].
    """
    spent = sum(plan.timing.get(step, 0.0) for step in ("total", FARTHEST, ADVICE))
    return max(0.0, timeout - spent)


def unless_late(further: Callable[[], PlacementResult], before: PlacementResult) -> PlacementResult:
    """Return a further answer, or the one before, ended by the time limit.

    Args:
        further: Returns the further answer; may raise `OutOfTimeError`.
        before: The answer so far, which is not certain without the further work.
    """
    try:
        return further()
    except OutOfTimeError:
        ended = replace(
            before.plan, status="timeout", base_path=None, base_pose=None, motion=None,
            navigation_cost=None, cost={}, loads=None,
        )  # fmt: skip
        return replace(before, plan=ended)


def cut_short(what: str) -> str:
    """Return the note that the time limit ended something."""
    return f"the time limit ended {what}; with more time the answer may differ"


def with_note(answer: PlacementResult, note: str) -> PlacementResult:
    """Return an answer with a further note in its plan."""
    return replace(answer, plan=replace(answer.plan, notes=(*answer.notes, note)))
