"""Answer a question with each handle of a part in turn, and with hands that are less open."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

from .narrower_hands import with_narrower_hand
from .other_handles import with_any_handle
from .query import PlacementQuery
from .result import PlacementResult
from .time_limit import unless_late

Answer: TypeAlias = "Callable[[PlacementQuery], PlacementResult]"


def with_any_grasp(query: PlacementQuery, with_first_handle: Answer) -> PlacementResult:
    """Return the first answer with a plan: by the part's handles in turn, then by narrower hands.

    Args:
        query: The question.
        with_first_handle: Answers a question with the first handle in which the hand is free.
    """

    def with_each_handle(query: PlacementQuery) -> PlacementResult:
        return with_any_handle(query, with_first_handle)

    answer = with_each_handle(query)
    if answer.plan.status == "infeasible":
        return unless_late(lambda: with_narrower_hand(query, answer, with_each_handle), answer)
    return answer
