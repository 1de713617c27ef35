"""What a job leaves, step after step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from momapos.model.records import PlacementPlan

from .bench_records import Outcome, Pose

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Bool

    from momapos.simulation import RunRecord


@dataclass
class Trace:
    """What a job leaves, step after step."""

    stages: dict[str, float] = field(default_factory=dict)
    seconds: float = 0.0
    driving: float = 0.0
    checked: int = 0
    sampled: int = 0
    bases: list[Pose] = field(default_factory=list)
    modeled: tuple[str, ...] | None = None
    """What the last step had modeled; None for everything."""
    verified: bool | None = None
    done: bool | None = None
    clearance: float | None = None
    held: Bool[np.ndarray, "levels n"] | None = None
    """From which disturbed base poses all steps so far still work."""
    outcome: Outcome = "solved"
    reason: str = ""

    def spend(self, plan: PlacementPlan) -> None:
        """Add what an answer took to those before."""
        self.add_time(plan.timing)
        self.checked += plan.candidates.checked
        self.sampled += plan.candidates.sampled

    def add_time(self, timing: Mapping[str, float]) -> None:
        """Add stages, and "total", to those before [s]."""
        for stage, seconds in timing.items():
            if stage != "total":
                self.stages[stage] = self.stages.get(stage, 0.0) + seconds
        self.seconds += timing.get("total", 0.0)

    def take(self, plan: PlacementPlan) -> None:
        """Add a step that is done so to those before."""
        self.driving += plan.navigation_cost or 0.0
        self.modeled = None if plan.key_objects is None else plan.key_objects.names
        if plan.base_pose is not None:
            self.bases.append(plan.base_pose)

    def carry_out(self, record: RunRecord) -> None:
        """Add what physics says; a job is done where all its steps are."""
        self.done = record.success and self.done is not False
        self.reason = self.reason or record.reason
        seen = [visit.clearance for visit in record.visits]
        seen.append(None if record.execution is None else record.execution.clearance)
        known = [value for value in (self.clearance, *seen) if value is not None]
        self.clearance = min(known, default=None)

    def disturb(self, held: Bool[np.ndarray, "levels n"]) -> None:
        """Add from which disturbed base poses a step still works."""
        self.held = held if self.held is None else self.held & held

    def shares_held(self) -> dict[str, float]:
        """Columns of the row that say how much of a solved job survives base errors."""
        if self.held is None or self.outcome != "solved":
            return {}
        at_2cm, at_5cm = self.held.mean(axis=1).tolist()
        return {"at_2cm": at_2cm, "at_5cm": at_5cm}

    def end(self, outcome: Outcome, reason: str) -> None:
        """Say how the job ended."""
        self.outcome, self.reason = outcome, reason
