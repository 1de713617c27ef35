"""Collect the results of a job over its steps."""

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


@dataclass(eq=False)
class JobTrace:
    """Results of a job, summed over its steps."""

    stages: dict[str, float] = field(default_factory=dict)
    seconds: float = 0.0
    driving: float = 0.0
    checked: int = 0
    sampled: int = 0
    bases: list[Pose] = field(default_factory=list)
    modeled: tuple[str, ...] | None = None
    """Objects that the last step modeled; None for all."""
    verified: bool | None = None
    done: bool | None = None
    clearance: float | None = None
    works: Bool[np.ndarray, "levels n"] | None = None
    """Whether all steps so far work at each disturbed base pose."""
    outcome: Outcome = "solved"
    reason: str = ""

    def add_effort(self, plan: PlacementPlan) -> None:
        """Add the time and the base poses of an answer."""
        self.add_time(plan.timing)
        self.checked += plan.candidates.checked
        self.sampled += plan.candidates.sampled

    def add_time(self, timing: Mapping[str, float]) -> None:
        """Add times by stage and their "total" [s]."""
        for stage, seconds in timing.items():
            if stage != "total":
                self.stages[stage] = self.stages.get(stage, 0.0) + seconds
        self.seconds += timing.get("total", 0.0)

    def add_step(self, plan: PlacementPlan) -> None:
        """Add the drive and the base pose of a step's final plan."""
        self.driving += plan.navigation_cost or 0.0
        self.modeled = None if plan.key_objects is None else plan.key_objects.names
        if plan.base_pose is not None:
            self.bases.append(plan.base_pose)

    def add_run(self, record: RunRecord) -> None:
        """Add the physics run of a step; a job is done if all its steps are."""
        self.done = record.success and self.done is not False
        self.reason = self.reason or record.reason
        values = [self.clearance, *(visit.clearance for visit in record.visits)]
        values.append(None if record.execution is None else record.execution.clearance)
        self.clearance = min((value for value in values if value is not None), default=None)

    def add_disturbed(self, works: Bool[np.ndarray, "levels n"]) -> None:
        """Add whether a step works at each disturbed base pose."""
        self.works = works if self.works is None else self.works & works

    def disturbed_shares(self) -> dict[str, float]:
        """Return the columns `at_2cm` and `at_5cm` of a solved job."""
        if self.works is None or self.outcome != "solved":
            return {}
        at_2cm, at_5cm = self.works.mean(axis=1).tolist()
        return {"at_2cm": at_2cm, "at_5cm": at_5cm}

    def end(self, outcome: Outcome, reason: str) -> None:
        self.outcome, self.reason = outcome, reason
