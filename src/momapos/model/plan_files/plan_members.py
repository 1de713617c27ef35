"""Members of a plan file with their types, as msgspec reads them."""

from __future__ import annotations

from typing import Annotated, Any

import msgspec

from momapos.model.records import Status, Verb


class Robot(msgspec.Struct):
    """Which robot."""

    name: str
    urdf: str
    base_link: str
    tool_link: str
    file: str | None = None
    srdf: str | None = None
    rest: dict[str, float] = {}
    arm: str | None = None


class Task(msgspec.Struct):
    """What is to be done."""

    verb: Verb
    object: str
    joint: str | None = None
    to: float | None = None
    farthest: bool = False


class Pose(msgspec.Struct):
    """On the floor: x [m], y [m], yaw [rad]."""

    x: float
    y: float
    yaw: float


class Manipulation(msgspec.Struct):
    """What the arm does from the grasp on."""

    q: list[list[float]]
    object_q: list[float]
    T_world_tool: list[list[list[float]]]
    times: list[float] | None = None
    holds: list[tuple[int, int]] = []
    turn_axes: list[tuple[float, float, float] | None] = []
    families: list[str] = []
    hold_words: list[str] = []


class Candidates(msgspec.Struct):
    """What became of the base poses."""

    sampled: int = 0
    checked: int = 0
    rejections: dict[str, int] = {}


class Importance(msgspec.Struct):
    """What was modeled."""

    scorer: str
    alpha: float
    names: list[str]
    scores: dict[str, float]
    rounds: int = 0


class Region(msgspec.Struct):
    """Where the base was allowed to stand."""

    keep_in: tuple[tuple[tuple[float, float], ...], ...] = ()
    keep_out: tuple[tuple[tuple[float, float], ...], ...] = ()
    facing: float | None = None
    most_driving: float | None = None


class Tolerance(msgspec.Struct):
    """How far beside the base pose the robot may stand."""

    radius: Annotated[float, msgspec.Meta(ge=0)]
    turn: Annotated[float, msgspec.Meta(ge=0)]
    samples: Annotated[int, msgspec.Meta(ge=1)]


class CostTerm(msgspec.Struct):
    """One term of what the base pose costs."""

    value: float | None
    weight: float | None


class Plan(msgspec.Struct):
    """All of a plan."""

    scene: str
    robot: Robot
    task: Task
    status: Status
    joints: list[str]
    scene_joints: dict[str, dict[str, float]] = {}
    scene_hypotheses: dict[str, dict[str, int]] = {}
    feasible_to: float | None = None
    feasible_from: Pose | None = None
    feasible_sure: bool = False
    start: Pose | None = None
    base_pose: Pose | None = None
    base_path: list[list[float]] | None = None
    approach: list[list[float]] = []
    approach_times: list[float] | None = None
    home: list[list[float]] | None = None
    manipulation: Manipulation | None = None
    navigation_cost: float | None = None
    cost: dict[str, CostTerm] = {}
    candidates: Candidates = msgspec.field(default_factory=Candidates)
    importance: Importance | None = None
    tolerance: Tolerance | None = None
    region: Region = msgspec.field(default_factory=Region)
    timing: dict[str, float] = {}
    method: str = ""
    seed: int = 0
    versions: dict[str, str] = {}


class Hashes(msgspec.Struct):
    """SHA-256 of files."""

    hashes: dict[str, str] = {}


class PlanHead(msgspec.Struct):
    """What tells a plan from another file."""

    format: Any = None
    version: Any = None
