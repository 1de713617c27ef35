"""The progress of a search, stage by stage."""

from __future__ import annotations

from collections.abc import Callable

from momapos.core import Clock

from .card import WORKING, Card

INTERVAL = 0.1
"""Time between updates; a search changes its stage 1,000 times a second [s]."""


class StageCard:
    """Shows which stage runs, and how long the others have taken."""

    def __init__(self, show: Callable[[Card], None], clock: Clock) -> None:
        """Show that a search begins.

        Args:
            show: Shows a card.
            clock: Returns the time [s].
        """
        self._show, self._clock = show, clock
        self._spent: dict[str, float] = {}
        self._stage, self._began, self._shown = "", clock(), 0.0
        show(Card("Searching", progress=WORKING))

    def begin(self, stage: str) -> None:
        """Note that a stage begins, which ends the one before."""
        now = self._clock()
        if self._stage:
            self._spent[self._stage] = self._spent.get(self._stage, 0.0) + now - self._began
        self._stage, self._began = stage, now
        if now - self._shown > INTERVAL:
            self._shown = now
            stages = tuple(self._spent.items())
            self._show(Card(f"Searching: {stage}", progress=WORKING, stages=stages))
