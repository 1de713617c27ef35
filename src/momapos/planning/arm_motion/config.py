"""How the arm gets from home to the first waypoint; nothing heavy is imported."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Optional

from momapos.core import refuse_below

Planner = Literal["RRTConnect", "RRTstar", "BITstar"]


@dataclass(frozen=True)
class PlannerConfig:
    """How the arm gets from home to the first waypoint."""

    planner: Optional[Planner] = None  # noqa: UP045 (see cli.options)
    """OMPL's planner; RRTstar and BITstar check as many motions as they may. None: RRTstar for the
    paper's method of placement, else RRTConnect."""
    checks: int = 7000
    """Motions of the arm checked for one way at most, some 35 microseconds each [-]."""

    def __post_init__(self) -> None:
        refuse_below(self, 1, "checks")
