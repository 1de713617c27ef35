"""Configure the planner of free arm motions. Imports nothing heavy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Optional

from momapos.core import refuse_below

Planner = Literal["RRTConnect", "RRTstar", "BITstar"]


@dataclass(frozen=True)
class PlannerConfig:
    """How the arm moves from home to the first waypoint."""

    planner: Optional[Planner] = None  # noqa: UP045 (see cli.options)
    """OMPL planner. RRTstar and BITstar use all checks. None: RRTstar for the placement method of
    the paper, else RRTConnect."""
    checks: int = 7000
    """Maximum number of motions checked per path, about 35 microseconds each [-]."""

    def __post_init__(self) -> None:
        refuse_below(self, 1, "checks")
