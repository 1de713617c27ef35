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
    ToolPose,
    Verb,
)


class PlanRobot(msgspec.Struct):
    """The robot."""

    name: str
    """Name of the robot."""
    urdf: str
    """Path of its URDF, relative to the plan."""
    base_link: str
    """Link on the floor."""
    tool_link: str
    """Link whose frame is the tool frame."""
    file: str | None = None
    """Name of a library robot, or path of a robot file."""
    srdf: str | None = None
    """Path of an SRDF that is not next to the URDF."""
    rest: dict[str, float] = {}
    """Values of joints that the plan does not move, by joint [rad] or [m]."""
    arm: str | None = None
    """The arm, of a robot with several."""
    drive: Literal["differential", "omni", "car"] | None = None
    """How the base drives."""
    min_turning_radius: Annotated[float, msgspec.Meta(gt=0)] | None = None
    """Least turning radius of a car-like base [m]."""


class PlanTask(msgspec.Struct):
    """The task."""

    verb: Verb
    """What to do."""
    object: str | None
    """The object; null if only the robot moves."""
    joint: str | None = None
    """The joint to move; null for a rigid object."""
    to: float | None = None
    """Value that it must reach [rad] or [m]."""
    farthest: bool = False
    """Whether this is the largest value that works."""
    follower: str = ""
    """Joint that the user named, which follows `joint`; empty if none."""
    poses: tuple[ToolPose, ...] = ()
    """Tool poses to reach or to follow; each of `manipulation.holds` is the state at one."""
    level: float | None = None
    """Largest tilt of the object in the hand [rad]; null for any."""
    speed: float | None = None
    """Speed of the tool along a path [m/s]; null for the usual limit."""


class PlanPose(msgspec.Struct):
    """A base pose: x [m], y [m], yaw [rad]."""

    x: float
    """[m]"""
    y: float
    """[m]"""
    yaw: float
    """[rad]"""


class Manipulation(msgspec.Struct):
    """The arm's motion from the grasp on."""

    q: list[list[float]]
    """States of the arm, in the order of `joints` [rad] or [m]."""
    object_q: list[float]
    """Value of the moved joint at each state [rad] or [m]."""
    T_world_tool: list[list[list[float]]]
    """Pose of the tool frame in the world at each state, 4 x 4."""
    base: list[tuple[float, float, float]] | None = None
    latch_q: list[float] | None = None
    """Value of the latch at each state [rad] or [m]."""
    times: list[float] | None = None
    """Time of each state from the grasp on [s]."""
    holds: list[tuple[int, int]] = []
    """First and last state of each phase in which the hand holds the part."""
    turn_axes: list[tuple[float, float, float] | None] = []
    """Axis about which the hand may turn in each phase, in the moved link's frame."""
    families: list[str] = []
    """Kind of grasp of each phase: pinch, hook, push or suction."""
    hold_words: list[str] = []
    """What is held and how, of each phase."""


class PlanNearestMiss(msgspec.Struct):
    """The rejected base pose that came nearest, and what stopped it."""

    base_pose: PlanPose
    """The base pose."""
    reason: str
    """What stopped it."""


class PlanCandidates(msgspec.Struct):
    """Statistics of the candidate base poses."""

    sampled: int = 0
    """Number of base poses [-]."""
    checked: int = 0
    """Number of base poses that were checked for an arm path [-]."""
    rejections: dict[str, int] = {}
    """Number of rejected base poses, by reason [-]."""
    nearest: PlanNearestMiss | None = None
    """The rejected base pose that came nearest."""


class PlanImportance(msgspec.Struct):
    """The modeled objects."""

    scorer: str
    """How objects were scored."""
    alpha: float
    """Score from which objects are modeled [-]."""
    names: list[str]
    """Modeled objects."""
    scores: dict[str, float]
    """Score of each object [-]."""
    rounds: int = 0
    """How often a plan was checked again with more objects [-]."""


class PlanRegion(msgspec.Struct):
    """Where the base was allowed to stand."""

    keep_in: tuple[tuple[tuple[float, float], ...], ...] = ()
    """Areas in which the base must stand: corners x, y [m]."""
    keep_out: tuple[tuple[tuple[float, float], ...], ...] = ()
    """Areas that it must not touch, standing or driving: corners x, y [m]."""
    facing: float | None = None
    """Largest angle between its x axis and the direction to the grasp [rad]."""
    most_driving: float | None = None
    """Longest drive [m]."""


class PlanTolerance(msgspec.Struct):
    """Base-pose robustness."""

    radius: Annotated[float, msgspec.Meta(ge=0)]
    """Distance within which replanning succeeded from all sampled poses [m]."""
    turn: Annotated[float, msgspec.Meta(ge=0)]
    """Yaw error to either side within which it did [rad]."""
    samples: Annotated[int, msgspec.Meta(ge=1)]
    """Number of sampled poses [-]."""


class PlanCostTerm(msgspec.Struct):
    """One term of the base pose's cost."""

    value: float | None
    """Before weighting."""
    weight: float | None
    """Its weight."""


class PlanAssumption(msgspec.Struct):
    """The joint motion that an assumed plan is for, and the answer for the most probable one."""

    kind: PartKind
    """Assumed kind of the part."""
    probability: Annotated[float, msgspec.Meta(ge=0, le=1)]
    """Its probability [-]."""
    instead_of: PartKind
    """Most probable kind."""
    instead_probability: Annotated[float, msgspec.Meta(ge=0, le=1)]
    """Its probability [-]."""
    feasible_to: float | None = None
    """How far the most probable joint opens [rad] or [m]."""


class Plan(msgspec.Struct):
    """The whole plan."""

    scene: str
    """Path of the scene file, relative to the plan."""
    robot: PlanRobot
    """The robot."""
    task: PlanTask
    """The task."""
    status: Status
    """Whether there is a motion; `assumed`: for a less probable joint."""
    joints: list[str]
    """Names of the joints in each state: arm, and what follows it."""
    scene_joints: dict[str, dict[str, float]] = {}
    """Joint values that differ from the scene file, by object and joint [rad] or [m]."""
    scene_hypotheses: dict[str, dict[str, int]] = {}
    """Index of the assumed hypothesis, by object and joint."""
    assumption: PlanAssumption | None = None
    """What an assumed plan assumes."""
    resistance: dict[str, dict[str, JointResistance]] = {}
    """Known resistance of the moved part, by object and joint."""
    overrides: Overrides = NO_OVERRIDES
    """Forces and masses that the user has set, against or beyond the files."""
    loads: MotionLoads | None = None
    """Worst loads of the motion."""
    feasible_to: float | None = None
    """Largest feasible value of an infeasible task [rad] or [m]."""
    feasible_from: PlanPose | None = None
    """A base pose from which it is feasible."""
    feasible_sure: bool = False
    """Whether the part itself is blocked beyond this value."""
    advice: str = ""
    """A change with which a plan exists."""
    start: PlanPose | None = None
    """Pose of the base before the task."""
    base_pose: PlanPose | None = None
    """Pose of the base at which the arm moves."""
    base_path: list[list[float]] | None = None
    """Poses of the base from the start to the base pose: x [m], y [m], yaw [rad]."""
    approach: list[list[float]] = []
    """States of the arm from home to the grasp [rad] or [m]."""
    approach_times: list[float] | None = None
    """Time of each state of the approach [s]."""
    home: list[list[float]] | None = None
    """States of the arm on its way home after the task [rad] or [m]."""
    manipulation: Manipulation | None = None
    """The motion from the grasp on."""
    navigation_cost: float | None = None
    """Length of the drive [m]."""
    cost: dict[str, PlanCostTerm] = {}
    """Terms of the cost of the base pose, by name."""
    candidates: PlanCandidates = msgspec.field(default_factory=PlanCandidates)
    """The base poses that were examined."""
    importance: PlanImportance | None = None
    """The objects that were modeled with joints."""
    tolerance: PlanTolerance | None = None
    """How far the base may be from its pose."""
    region: PlanRegion = msgspec.field(default_factory=PlanRegion)
    """Where the base was allowed to stand."""
    notes: tuple[str, ...] = ()
    """What a user should know, one line each."""
    timing: dict[str, float] = {}
    """Computing time by stage, and `total` of the search [s]."""
    method: str = ""
    """Method of choosing base poses."""
    seed: int = 0
    """Seed of the search."""
    versions: dict[str, str] = {}
    """Versions of the packages that the answer depends on."""


class Hashes(msgspec.Struct):
    """SHA-256 hashes of the scene and robot files."""

    hashes: dict[str, str] = {}


class PlanHead(msgspec.Struct):
    """Format and version of a file."""

    format: Any = None
    version: Any = None
