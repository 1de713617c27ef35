"""The members of a plan file and their types, for msgspec."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec

from momapos.model.records import (
    NO_OVERRIDES,
    JointResistance,
    MotionLoads,
    Overrides,
    PartKind,
    Status,
    Verb,
)


class PlanRobot(msgspec.Struct):
    """The robot."""

    name: str
    urdf: str
    base_link: str
    tool_link: str
    file: str | None = None
    srdf: str | None = None
    rest: dict[str, float] = {}
    arm: str | None = None
    drive: Literal["differential", "omni", "car"] | None = None
    min_turning_radius: Annotated[float, msgspec.Meta(gt=0)] | None = None


class PlanTask(msgspec.Struct):
    """The task."""

    verb: Verb
    object: str
    joint: str | None = None
    to: float | None = None
    farthest: bool = False
    follower: str = ""


class PlanPose(msgspec.Struct):
    """A base pose: x [m], y [m], yaw [rad]."""

    x: float
    y: float
    yaw: float


class Manipulation(msgspec.Struct):
    """The arm's motion from the grasp on."""

    q: list[list[float]]
    object_q: list[float]
    T_world_tool: list[list[list[float]]]
    base: list[tuple[float, float, float]] | None = None
    latch_q: list[float] | None = None
    times: list[float] | None = None
    holds: list[tuple[int, int]] = []
    turn_axes: list[tuple[float, float, float] | None] = []
    families: list[str] = []
    hold_words: list[str] = []


class PlanNearestMiss(msgspec.Struct):
    """The rejected base pose that came nearest, and what stopped it."""

    base_pose: PlanPose
    reason: str


class PlanCandidates(msgspec.Struct):
    """Statistics of the candidate base poses."""

    sampled: int = 0
    checked: int = 0
    rejections: dict[str, int] = {}
    nearest: PlanNearestMiss | None = None


class PlanImportance(msgspec.Struct):
    """The modeled objects."""

    scorer: str
    alpha: float
    names: list[str]
    scores: dict[str, float]
    rounds: int = 0


class PlanRegion(msgspec.Struct):
    """Where the base was allowed to stand."""

    keep_in: tuple[tuple[tuple[float, float], ...], ...] = ()
    keep_out: tuple[tuple[tuple[float, float], ...], ...] = ()
    facing: float | None = None
    most_driving: float | None = None


class PlanTolerance(msgspec.Struct):
    """Base-pose robustness."""

    radius: Annotated[float, msgspec.Meta(ge=0)]
    turn: Annotated[float, msgspec.Meta(ge=0)]
    samples: Annotated[int, msgspec.Meta(ge=1)]


class PlanCostTerm(msgspec.Struct):
    """One term of the base pose's cost."""

    value: float | None
    weight: float | None


class PlanAssumption(msgspec.Struct):
    """The joint motion that an assumed plan is for, and the answer for the most probable one."""

    kind: PartKind
    probability: Annotated[float, msgspec.Meta(ge=0, le=1)]
    instead_of: PartKind
    instead_probability: Annotated[float, msgspec.Meta(ge=0, le=1)]
    feasible_to: float | None = None


class Plan(msgspec.Struct):
    """The whole plan."""

    scene: str
    robot: PlanRobot
    task: PlanTask
    status: Status
    joints: list[str]
    scene_joints: dict[str, dict[str, float]] = {}
    scene_hypotheses: dict[str, dict[str, int]] = {}
    assumption: PlanAssumption | None = None
    resistance: dict[str, dict[str, JointResistance]] = {}
    overrides: Overrides = NO_OVERRIDES
    loads: MotionLoads | None = None
    feasible_to: float | None = None
    feasible_from: PlanPose | None = None
    feasible_sure: bool = False
    advice: str = ""
    start: PlanPose | None = None
    base_pose: PlanPose | None = None
    base_path: list[list[float]] | None = None
    approach: list[list[float]] = []
    approach_times: list[float] | None = None
    home: list[list[float]] | None = None
    manipulation: Manipulation | None = None
    navigation_cost: float | None = None
    cost: dict[str, PlanCostTerm] = {}
    candidates: PlanCandidates = msgspec.field(default_factory=PlanCandidates)
    importance: PlanImportance | None = None
    tolerance: PlanTolerance | None = None
    region: PlanRegion = msgspec.field(default_factory=PlanRegion)
    notes: tuple[str, ...] = ()
    timing: dict[str, float] = {}
    method: str = ""
    seed: int = 0
    versions: dict[str, str] = {}


class Hashes(msgspec.Struct):
    """SHA-256 hashes of the scene and robot files."""

    hashes: dict[str, str] = {}


class PlanHead(msgspec.Struct):
    """Format and version of a file."""

    format: Any = None
    version: Any = None
