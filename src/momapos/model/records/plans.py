"""Records of an answer: motions, attempts and placement plans.

All values are in SI units, in the world frame unless a field names another.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np

from .outcomes import CostTerm, PoseOutcome, Tolerance
from .tasks import ANYWHERE, BaseRegion, Task

if TYPE_CHECKING:
    from jaxtyping import Float


Status = Literal["solved", "infeasible", "timeout"]


@dataclass(frozen=True)
class Hold:
    """A stretch of a manipulation during which the hand holds the part."""

    first: int
    """Index of the state in which it takes hold."""
    last: int
    """Index of the last state in which it holds."""
    turn_axis: tuple[float, float, float] | None = None
    """Unit axis through the tool's origin, fixed in the moved link's frame, about which the hand
    may turn; None where it may not."""
    family: str = ""
    """How it holds: pinch, hook, push or suction; "" where nobody says."""
    words: str = ""
    """What it holds and how, for people; "" where nobody says."""


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
    approach_times: Float[np.ndarray, " a"] | None = None
    """When the arm passes each state of the approach [s]; None where nobody has timed it."""
    times: Float[np.ndarray, " m"] | None = None
    """Likewise while it holds the object, from the grasp on [s]."""
    holds: tuple[Hold, ...] = ()
    """When the hand holds the part of a joint, in order; empty where it does so all along, and
    does not turn. Between two holds the part stands still."""
    home: Float[np.ndarray, "h n"] | None = None
    """Arm states from the last of these home, with what was picked; None where it stays there."""

    def __repr__(self) -> str:
        return f"<Motion: {len(self.approach)} states to the grasp, {len(self.q)} in it>"


@dataclass(frozen=True)
class ArmPathResult:
    """What came of looking for an arm path over the waypoints at one base pose."""

    grasp: int
    """The grasp that has one, or that came farthest; -1 where none is within reach."""
    q: Float[np.ndarray, "d n"] | None
    """Arm states at every step of the motion; None where no grasp has a path."""
    outcome: PoseOutcome


@dataclass(frozen=True)
class Attempt:
    """What came of checking one base pose in full."""

    motion: Motion | None
    outcome: PoseOutcome
    farthest: float | None = None
    """The farthest value of the joint that was found to work there [rad] or [m]: the task's, or
    where there is no motion one before it. None where none was found, or none was asked for."""

    @property
    def reason(self) -> str:
        """Why there is no motion, in words; "" where there is one."""
        return "" if self.motion is not None else str(self.outcome)


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
    cost: Mapping[str, CostTerm] = field(default_factory=dict)
    """Terms of what the base pose costs, by name, with their weights."""
    candidates: Candidates = Candidates()
    timing: Mapping[str, float] = field(default_factory=dict)
    """Seconds by stage, and "total"; "tolerance" is measured after the answer and not in it."""
    key_objects: KeyObjects | None = None
    """What was modeled; None where nothing says."""
    method: str = "ours"
    seed: int = 0
    versions: Mapping[str, str] = field(default_factory=dict)
    start: tuple[float, float, float] | None = None
    """Where the base is at first: x [m], y [m], yaw [rad]."""
    base_path: Float[np.ndarray, "k 3"] | None = None
    """The way from there to the base pose, free for the whole robot with its arm at home."""
    robot_file: str | None = None
    """The robot file, or the robot's name in the library."""
    robot_srdf: str | None = None
    """The SRDF whose pairs of links are not checked; None for the one beside the URDF, if any."""
    robot_rest: Mapping[str, float] = field(default_factory=dict)
    """Where joints beside the arm's rest that do not rest at zero [rad] or [m]."""
    robot_arm: str | None = None
    """Which arm it is for, of a robot with several; the others rest."""
    robot_amended: str | None = field(default=None, repr=False)
    """The URDF where the robot file adds to it; it is written beside the plan."""
    scene_joints: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Joint values that differ from the scene file's, by object and joint [rad] or [m]."""
    scene_hypotheses: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    """Which hypothesis of how it moves a joint was taken for, by object and joint, counted from 0
    as in the scene file; the first, the likeliest, by default."""
    feasible_to: float | None = None
    """Where the value asked for is out of reach: the farthest found that is not [rad] or [m]."""
    feasible_from: tuple[float, float, float] | None = None
    """The base pose from which that one is reached: x [m], y [m], yaw [rad]."""
    feasible_sure: bool = False
    """Whether the grid has ruled out what lies a waypoint beyond; else the time ended before."""
    tolerance: Tolerance | None = None
    """How far beside the base pose it may stand; None where nobody has measured it."""
    region: BaseRegion = ANYWHERE
    """Where the base was allowed to stand."""

    def __repr__(self) -> str:
        what = (
            self.task.object if self.task.joint is None else f"{self.task.object}/{self.task.joint}"
        )
        return f"<PlacementPlan of {self.robot_name}: {self.task.verb} {what}: {self.status}>"
