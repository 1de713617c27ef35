"""Records handed between stages. Everything is in SI units, in the world frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from jaxtyping import Float

Verb = Literal["open", "close", "pick", "place"]
Status = Literal["solved", "infeasible", "timeout"]


@dataclass(frozen=True)
class Task:
    """What is to be done."""

    verb: Verb
    object: str
    joint: str | None = None
    """The joint that must move; None for pick and place."""
    to: float | None = None
    """The value the joint must reach [rad] or [m]."""


@dataclass(frozen=True)
class Motion:
    """What the robot does at one base pose."""

    approach: Float[np.ndarray, "a n"]
    """Arm states from home to the grasp [rad] or [m]."""
    q: Float[np.ndarray, "m n"]
    """Arm states while it holds the object."""
    object_q: Float[np.ndarray, " m"]
    """Value of the object's joint at each state; zeros for pick and place."""
    Ts_world_tool: Float[np.ndarray, "m 4 4"]


@dataclass(frozen=True)
class Screened:
    """What came of looking for an arm path over the waypoints at one base pose."""

    grasp: int
    """The grasp that has one, or that came farthest; -1 where none is within reach."""
    q: Float[np.ndarray, "d n"] | None
    """Arm states at every step of the motion; None where no grasp has a path."""
    reason: str
    """Why there is no path; "" where there is one."""


@dataclass(frozen=True)
class Attempt:
    """What came of checking one base pose in full."""

    motion: Motion | None
    reason: str
    """Why there is no motion; "" where there is one."""


@dataclass(frozen=True)
class Candidates:
    """What became of the base poses that were looked at."""

    sampled: int = 0
    checked: int = 0
    rejections: Mapping[str, int] = field(default_factory=dict)
    """How many were refused, by reason."""


@dataclass(frozen=True)
class KeyObjects:
    """The set S of objects that got a kinematic model; all others were boxes."""

    scorer: str
    """What importance was measured by."""
    alpha: float
    """Threshold that was reached; it falls when there is no placement [-]."""
    names: tuple[str, ...]
    """S, most important first."""
    scores: Mapping[str, float]
    """Importance of every object, in (0, 1]."""
    rounds: int = 0
    """How often a plan came near boxes, which then joined S, and was checked again [-]."""


@dataclass(frozen=True)
class PlacementPlan:
    """Where the robot stands and how it moves, or why it cannot."""

    scene: str
    """Path of the scene file."""
    robot_name: str
    robot_urdf: str
    base_link: str
    tool_link: str
    task: Task
    status: Status
    joints: tuple[str, ...]
    """Names of the arm's joints, in the order of all configurations."""
    base_pose: tuple[float, float, float] | None = None
    """x [m], y [m], yaw [rad] of `base_link` on the floor."""
    motion: Motion | None = None
    navigation_cost: float | None = None
    """Driving length from the start [m]."""
    candidates: Candidates = Candidates()
    timing: Mapping[str, float] = field(default_factory=dict)
    """Seconds by stage, and "total"."""
    key_objects: KeyObjects | None = None
    """What was modelled; None where nothing says."""
    method: str = "ours"
    seed: int = 0
    versions: Mapping[str, str] = field(default_factory=dict)
