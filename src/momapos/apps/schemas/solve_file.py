"""The members of the record that `momapos solve` writes, for its schema."""

from __future__ import annotations

from typing import Literal

import msgspec

from momapos.model.plan_files import PlanAssumption
from momapos.model.records import Status, Verb


class SolveFile(msgspec.Struct, kw_only=True):
    """Record of a task in a scanned room; all files are in its folder."""

    format: Literal["momapos-solve"]
    version: Literal[1]
    verb: Verb
    object: str
    joint: str | None
    to: float | None
    """Value that the task requests [rad] or [m]."""
    robot: str
    method: str
    """Method of choosing base poses."""
    seed: int
    status: Status
    """Status of the plan."""
    assumption: PlanAssumption | None = None
    done: bool | None
    """Whether the run did the task; null if nothing was run."""
    reason: str
    """Why the run failed."""
    cloud: str
    """The fused cloud."""
    scene: str
    plan: str
    run: str | None
    """The record of the run."""
    alphas: list[float]
    """Importance thresholds at which the room was modeled, in order [-]."""
    views: str
    """How images of fronts are chosen."""
    stand_ins: dict[str, str] = {}
    """What does the work of networks of the paper, by network."""
    modeled: list[str]
    """Objects with joints."""
    timing: dict[str, float]
    """Computing time by stage, and "total" [s]."""
