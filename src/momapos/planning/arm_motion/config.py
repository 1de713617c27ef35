"""Configure the planner of free arm motions. Imports nothing heavy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Optional

from momapos.core import refuse_above, refuse_below

OWN_CHECKS, OMPL_CHECKS = 40_000, 7_000
"""Maximum number of motions checked, of ours and of OMPL's planners. Ours take a tenth of the time,
and a search without a path ends within 0.15 s [-]."""
MAX_CHECKS = 100_000_000
"""Bound of the number of checked motions; so many take minutes [-]."""
Planner = Literal["RRTConnect", "RRTstar", "BITstar"]


@dataclass(frozen=True)
class PlannerConfig:
    """How the arm moves from home to the first waypoint."""

    planner: Optional[Planner] = None  # noqa: UP045 (see cli.options)
    """None: our RRT-Connect, or RRTstar for the placement method of the paper and OMPL's RRTConnect
    for that of its authors' code. A name: that planner of OMPL."""
    checks: Optional[int] = None  # noqa: UP045
    """Maximum number of motions checked per path [-]. None: 40,000 of about 3 microseconds each,
    with OMPL 7,000 of about 30."""
    optimize: bool = False
    """Whether RRTstar and BITstar spend all checks to shorten their path, instead of ending with
    their first one (paper)."""

    def __post_init__(self) -> None:
        if self.checks is not None:
            refuse_below(self, 1, "checks")
        refuse_above(self, MAX_CHECKS, "checks")

    @property
    def budget(self) -> int:
        """Return the maximum number of motions checked."""
        if self.checks is not None:
            return self.checks
        return OWN_CHECKS if self.planner is None else OMPL_CHECKS
