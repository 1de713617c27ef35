"""Records of a task and its answer: task, grasps, motions, loads and plan.

All values are in SI units, in the world frame unless a field names another.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Literal, TypeAlias, get_args

import numpy as np

from momapos.core import (
    InputError,
    check_fields,
    compare_by_content,
    expect,
    finite_array,
    finite_number,
    one_of,
    shown,
)

from .outcomes import CostTerm, NearestMiss, PoseOutcome, Tolerance
from .poses import ToolPose
from .scans import Hypothesis, PartKind

if TYPE_CHECKING:
    from jaxtyping import Float


class Family(StrEnum):
    """A family of grasps; plans contain the words."""

    PINCH = "pinch"
    """Pads on both sides; friction transmits the pull."""
    HOOK = "hook"
    """A finger behind a bar, a lip or an edge transmits the pull."""
    PUSH = "push"
    """Fingertips against a front."""
    SUCTION = "suction"
    """A suction cup on a front."""
    UNSTATED = ""
    """What a plan says that does not say it, and what holds a rigid object."""

    @classmethod
    def of(cls, word: str) -> Family:
        """Return the family that a word of a plan names; `UNSTATED` for other words."""
        return cls(word) if word in FAMILIES else cls.UNSTATED

    @property
    def closes(self) -> bool:
        """Whether fingers that can close do so on the part, and bear its load by friction."""
        return self not in (Family.PUSH, Family.SUCTION)

    @property
    def sticks(self) -> bool:
        """Whether the tool holds the face that it touches."""
        return self is Family.SUCTION

    @property
    def is_one_sided(self) -> bool:
        """Whether one finger under load is enough."""
        return self is Family.HOOK

    @property
    def leads(self) -> bool:
        """Whether the hand is behind the part: one that stayed where it is would meet the hand."""
        return self in (Family.PUSH, Family.HOOK)

    @property
    def turns(self) -> bool:
        """Whether the hand may turn about what it holds."""
        return self in (Family.PINCH, Family.HOOK)

    @property
    def tools(self) -> tuple[str, ...]:
        """What a tool may hold with to act like this, as robot files state it."""
        if self is Family.PINCH:
            return ("fingers",)
        if self is Family.SUCTION:
            return ("suction",)
        return ("fingers", "hook") if self is Family.HOOK else ("fingers", "hook", "suction")


FAMILIES: tuple[Family, ...] = tuple(one for one in Family if one)
"""The families that a plan may name."""


JointVerb = Literal["open", "close", "press"]
"""What moves a part by its joint; to press is to push it and to let go."""
PoseVerb = Literal["reach", "follow"]
"""What brings the tool to given poses: to each of a set, or along a path through them."""
Verb = Literal[JointVerb, "pick", "place", PoseVerb]
RequestVerb = Literal[Verb, "bring"]
"""What can be requested; to bring an object is to pick it up and to place it."""


MIN_TOOL_SPEED = 1e-3
"""Least speed of the tool along a path [m/s]; a meter then takes 17 minutes."""
MIN_LEVEL = math.radians(1.0)
"""Least tilt that a request may allow: arms leave their paths by tenths of a degree [rad]."""


@dataclass(frozen=True)
class Task:
    """What must be done; `make_task` makes one.

    Raises:
        InputError: A field has the wrong type or is not finite.
    """

    verb: Verb
    """What to do."""
    object: str
    """The object that is moved, or has the joint; "" if only the robot moves."""
    joint: str | None = None
    """The joint that must move; None for pick, place and reach."""
    to: float | None = None
    """The value the joint must reach [rad] or [m]."""
    farthest: bool = False
    """Whether `to` is an upper bound, up to which the joint must move as far as possible."""
    follower: str = ""
    """The requested joint, if it is a mimic joint that follows `joint`."""
    poses: tuple[ToolPose, ...] = ()
    """The tool poses to reach, in their order in a plan, or the path to follow; none for other
    verbs."""
    level: float | None = None
    """Largest tilt of the object in the hand from how it stands, as of a full cup [rad]; None for
    any."""
    speed: float | None = None
    """Speed of the tool along a path to follow [m/s]; None for the usual limit."""

    def __post_init__(self) -> None:
        one_of("Task.verb", self.verb, get_args(Verb))
        expect("Task.object", self.object, str)
        by_poses = self.verb in get_args(PoseVerb)
        if by_poses != bool(self.poses) or by_poses == bool(self.object):
            raise InputError(
                f"Task: reach and follow need poses and no object, other tasks an object; this is "
                f"{self.verb} {self.object!r:.60} with {len(self.poses)} poses"
            )
        if self.joint is not None:
            expect("Task.joint", self.joint, str)
        if self.to is not None:
            object.__setattr__(self, "to", finite_number("Task.to", self.to))
        if self.level is not None:
            level = finite_number("Task.level", self.level, MIN_LEVEL, math.pi)
            object.__setattr__(self, "level", level)
        if self.speed is not None:
            speed = finite_number("Task.speed", self.speed, MIN_TOOL_SPEED, math.inf)
            object.__setattr__(self, "speed", speed)

    @property
    def touches(self) -> str:
        """Return what the hand may touch: the task's object, or that of all its poses; or ""."""
        contacts = {pose.contact for pose in self.poses}
        return contacts.pop() if len(contacts) == 1 else self.object

    @property
    def pose_names(self) -> tuple[str, ...]:
        """Return the names of the poses, by default their numbers from 1."""
        return tuple(one.name or f"pose {k}" for k, one in enumerate(self.poses, 1))

    @property
    def target(self) -> str:
        """Return what the task is about, in words: an object, its joint, or a number of poses."""
        if self.poses:
            of = "a path of " if self.verb == "follow" else ""
            return f"{of}{len(self.poses)} pose{'s' if len(self.poses) > 1 else ''}"
        return self.object if self.joint is None else f"{self.object}/{self.joint}"


Outline: TypeAlias = tuple[tuple[float, float], ...]
"""Corners of an area on the floor: x, y [m]."""


@dataclass(frozen=True)
class BaseRegion:
    """Where the base may stand and drive, in addition to what the room and the arm allow.

    Raises:
        InputError: An outline is not three or more finite corners, or a bound is negative.
    """

    keep_in: tuple[Outline, ...] = ()
    """At the base pose the whole footprint is in one of these; empty for anywhere."""
    keep_out: tuple[Outline, ...] = ()
    """The outline of the base, `Robot.base_outline`, touches none of these, neither at the base
    pose nor on the way there nor while the base moves. The arm may be over them."""
    facing: float | None = None
    """Largest angle between the base's x axis and the direction to the grasp [rad]."""
    most_driving: float | None = None
    """Longest drive from the start [m]."""

    def __post_init__(self) -> None:
        for name in ("keep_in", "keep_out"):
            object.__setattr__(self, name, _outlines(f"BaseRegion.{name}", getattr(self, name)))
        for name in ("facing", "most_driving"):
            if getattr(self, name) is not None:
                value = finite_number(f"BaseRegion.{name}", getattr(self, name), 0.0)
                object.__setattr__(self, name, value)


def _outlines(name: str, value: object) -> tuple[Outline, ...]:
    if isinstance(value, str) or not isinstance(value, Sequence):
        raise InputError(f"{name} must be a sequence of outlines, not {shown(value)}")
    outlines = []
    for k, corners in enumerate(value):
        points = finite_array(f"{name}[{k}]", corners, (None, 2))
        if len(points) < 3:
            raise InputError(f"{name}[{k}] must have 3 or more corners x, y, not {len(points)}")
        outlines.append(tuple((float(x), float(y)) for x, y in points))
    return tuple(outlines)


ANYWHERE: BaseRegion = BaseRegion()


MAX_EFFORT_SHARE = 0.9
"""Share of an effort limit that a state may need at rest [-]; the rest is for accelerations. In
simulation, a torso that needs 0.92 of its limit for its own weight does not follow its motion."""

MIN_STABILITY = 0.02
"""Least distance from tipping over at rest [m]. In simulation, the accelerations of a UR5e on a
narrow base of 117 kg move the zero moment point by up to 1.6 cm from where it is at rest."""


MOVING_PULL = 4.0
"""What a part pulls in addition while the base moves [N]: wheels slip by 3 %, and a hand that
yields with 400 Ns/m bears that until it has. In simulation, a microwave's door that resists with
7 N pulls a Stretch with up to 11 N, more beyond its resistance than six other parts."""


@compare_by_content
@dataclass(frozen=True, eq=False)
class MotionLoads:
    """The worst loads of a motion, at rest in each of its states."""

    efforts: Mapping[str, float] = field(default_factory=dict)
    """Share of each joint's effort limit, by joint [-]; joints without a limit are missing."""
    stability: float | None = None
    """Distance from the zero moment point to the nearest edge of the area that the wheels stand on
    [m]; None if masses or wheels are unknown."""
    payload: float | None = None
    """Mass of the object in the hand [kg]; None if the task moves a joint."""
    notes: tuple[str, ...] = ()
    """What the robot's files leave open, one line each."""

    @property
    def worst(self) -> tuple[str, float] | None:
        """Return the joint with the largest share, and its share; None if no limit is known."""
        return max(self.efforts.items(), key=lambda item: item[1], default=None)

    def __str__(self) -> str:
        said = []
        if self.payload is not None:
            said.append(f"{self.payload:.3g} kg in the hand")
        if self.worst is not None:
            joint, share = self.worst
            said.append(f"{joint} needs {100 * share:.0f} % of its effort limit")
        if self.stability is not None:
            said.append(f"{100 * self.stability:.0f} cm from tipping over")
        return "; ".join([*said, *self.notes])


MAX_VALUE = 1e5
"""Maximum force, torque, damping, mass, travel or lever; excludes mistaken units [-]."""


@dataclass(frozen=True)
class JointResistance:
    """Known resistance of a joint; None where momapos assumes a value, see `ResistanceConfig`.

    Raises:
        InputError: A value is not finite, negative or larger than 1e5.
    """

    seal_force: float | None = None
    """Pull at the handle that opens the closed part, with its seal, latch or catch [N]."""
    seal_travel: float | None = None
    """Travel of the handle over which this pull fades to nothing [m]."""
    lever: float | None = None
    """Travel of the point where these two are measured per unit of the joint: its distance from a
    hinge [m], 1 for a slide. None for the handle's."""
    friction: float | None = None
    """Dry friction [Nm] or [N]."""
    damping: float | None = None
    """Damping [Nms/rad] or [Ns/m]."""
    mass: float | None = None
    """Mass of all that the joint moves [kg]."""
    balanced: bool | None = None
    """Whether springs bear the weight of the part, as in most dishwashers and lift-up doors."""
    spring: float | None = None
    """What pulls the part back toward its closed value, everywhere [Nm] or [N]."""
    closer: bool | None = None
    """Whether a closer brakes the part that this spring closes."""

    def __post_init__(self) -> None:
        check_fields(self)
        if self.closer and self.spring is None:
            raise InputError(
                "JointResistance.closer needs a spring, the torque [Nm] or force [N] that closes "
                "the part"
            )
        for name in ("seal_force", "seal_travel", "lever", "friction", "damping", "mass", "spring"):
            value = getattr(self, name)
            if value is not None:
                least = 1e-6 if name in ("seal_travel", "lever", "mass") else 0.0
                number = finite_number(f"JointResistance.{name}", value, least, MAX_VALUE)
                object.__setattr__(self, name, number)

    def members(self) -> dict[str, float | bool]:
        """Return the known values by name, as files hold them."""
        return {key: value for key, value in asdict(self).items() if value is not None}


@compare_by_content
@dataclass(frozen=True, eq=False)
class Overrides:
    """What a user has set of forces and masses, against or beyond what the files state."""

    resistance: Mapping[str, Mapping[str, JointResistance]] = field(default_factory=dict)
    """Resistance by object and joint."""
    mass: Mapping[str, float] = field(default_factory=dict)
    """Mass of whole objects [kg]."""
    assumed: Mapping[str, float] = field(default_factory=dict)
    """Settings of `ResistanceConfig` that are not the default, by name."""

    @property
    def any(self) -> bool:
        """Return whether anything is set."""
        return bool(self.resistance or self.mass or self.assumed)


NO_OVERRIDES: Overrides = Overrides()


Status = Literal["solved", "assumed", "infeasible", "timeout"]
"""Answer to a query. "assumed": there is a plan, but only if a joint moves in an improbable way or
in another than the most probable one, so it is not known whether the plan does the task."""


@dataclass(frozen=True)
class Assumption:
    """The joint motion that a plan assumes, and the answer for the most probable one."""

    kind: PartKind
    """Assumed kind of the part."""
    probability: float
    """Probability of that motion in the scene [-]."""
    instead_of: PartKind
    """Most probable kind of the part."""
    instead_probability: float
    feasible_to: float | None = None
    """Farthest feasible value found of the most probable joint [rad] or [m]; None if none was."""

    @classmethod
    def of_first(cls, hypothesis: Hypothesis) -> Assumption:
        """Return the assumption of the most probable motion, which is still improbable."""
        kind, probability = hypothesis.kind, hypothesis.probability
        return cls(kind, probability, kind, probability)

    @property
    def is_first(self) -> bool:
        """Whether the assumed motion is the most probable one."""
        return (self.kind, self.probability) == (self.instead_of, self.instead_probability)

    def __str__(self) -> str:
        return f"{self.kind} ({100 * self.probability:.2g} %)"

    @property
    def instead(self) -> str:
        """Return the answer for the most probable joint, "door_left (96 %): feasible to 73 deg"."""
        most, to = f"{self.instead_of} ({100 * self.instead_probability:.2g} %)", self.feasible_to
        if to is None:
            return f"{most}: not feasible"
        value = f"{100 * to:.0f} cm" if self.instead_of == "drawer" else f"{np.degrees(to):.0f} deg"
        return f"{most}: feasible to {value}"


@dataclass(frozen=True)
class Hold:
    """A phase of a manipulation during which the hand holds the part."""

    first: int
    """Index of the first state in which the hand holds the part."""
    last: int
    """Index of the last state in which it holds it."""
    turn_axis: tuple[float, float, float] | None = None
    """Unit axis through the tool's origin about which the hand may turn, in the moved link's frame;
    None if it may not turn."""
    family: str = ""
    """Grasp mode: pinch, hook, push or suction; "" if unknown."""
    words: str = ""
    """Description of the grasp for users; "" if there is none."""

    @property
    def kind(self) -> Family:
        """Return the family, with what it implies."""
        return Family.of(self.family)


@compare_by_content
@dataclass(frozen=True, eq=False)
class Motion:
    """The robot's motion for a task: at one base pose, or with a base that moves."""

    approach: Float[np.ndarray, "a n"]
    """Arm states from home to the grasp [rad] or [m]."""
    q: Float[np.ndarray, "m n"]
    """Arm states of the manipulation, from the grasp on [rad] or [m]."""
    object_q: Float[np.ndarray, " m"]
    """Value of the object's joint at each state; zeros for pick and place."""
    Ts_world_tool: Float[np.ndarray, "m 4 4"]
    approach_times: Float[np.ndarray, " a"] | None = None
    """Time of each approach state [s]; None if the motion is not timed."""
    times: Float[np.ndarray, " m"] | None = None
    """Time of each manipulation state, from the grasp on [s]."""
    holds: tuple[Hold, ...] = ()
    """Phases in which the hand holds a joint's part, in order; empty for one hold over all states
    without a turn. Between two holds the part does not move."""
    home: Float[np.ndarray, "h n"] | None = None
    """Arm states of the path home after the manipulation; None if the arm stays there."""
    latch_q: Float[np.ndarray, " m"] | None = None
    """Value of the object's latch at each state [rad] or [m]; None if no latch is turned. The hand
    holds the latch from the first state on, and the first hold begins where the part moves."""
    base: Float[np.ndarray, "m 3"] | None = None
    """Base pose at each manipulation state: x [m], y [m], yaw [rad], without jumps of a turn; None
    if the base stands still. Outside the holds the hand is free, also before the first one."""

    def __repr__(self) -> str:
        return f"<Motion: {len(self.approach)} states to the grasp, {len(self.q)} in it>"

    @property
    def moves_base(self) -> bool:
        """Return whether the base moves during the manipulation."""
        return self.base is not None

    def base_poses(self, base_pose: Sequence[float]) -> Float[np.ndarray, "m 3"]:
        """Return the base pose at each manipulation state; `base_pose` if the base stands still."""
        if self.base is not None:
            return self.base
        return np.tile(np.asarray(base_pose, float), (len(self.q), 1))

    @property
    def grasps(self) -> tuple[Hold, ...]:
        """Return the phases in which the hand holds the part or its latch, in order."""
        holds = self.holds or (Hold(0, len(self.q) - 1),)
        return holds if self.latch_q is None else (replace(holds[0], first=0), *holds[1:])


@compare_by_content
@dataclass(frozen=True, eq=False)
class ArmPathResult:
    """Result of the search for an arm path over the waypoints at one base pose."""

    grasp: int
    """The grasp with a path, or whose path came farthest; -1 if none is within reach."""
    q: Float[np.ndarray, "d n"] | None
    """Arm states at every step of the motion; None if no grasp has a path."""
    outcome: PoseOutcome
    bases: Float[np.ndarray, "d 3"] | None = None
    """Base pose at every step; None if the base stands."""


@dataclass(frozen=True)
class Attempt:
    """Result of the full check of one base pose."""

    motion: Motion | None
    outcome: PoseOutcome
    farthest: float | None = None
    """The farthest joint value with a motion [rad] or [m]: the task's value, or a smaller one if
    that has no motion. None if no value works, or it was not requested."""
    base: Float[np.ndarray, "3"] | None = None
    """Where the motion begins, if the base moves: x [m], y [m], yaw [rad]."""

    @property
    def reason(self) -> str:
        """Return why there is no motion, or "" if there is one."""
        return "" if self.motion is not None else str(self.outcome)


@compare_by_content
@dataclass(frozen=True, eq=False)
class Candidates:
    """Statistics of the candidate base poses."""

    sampled: int = 0
    checked: int = 0
    rejections: Mapping[str, int] = field(default_factory=dict)
    """Number of rejected candidates by reason."""
    nearest: NearestMiss | None = None
    """The rejected candidate that came nearest; None if one works or none was checked."""


@compare_by_content
@dataclass(frozen=True, eq=False)
class KeyObjects:
    """The set S of objects with a kinematic model; all others are boxes."""

    scorer: str
    """Name of the importance scorer."""
    alpha: float
    """Final threshold; it decreases while there is no placement [-]."""
    names: tuple[str, ...]
    """The objects of S, most important first."""
    scores: Mapping[str, float]
    """Importance of every object, in (0, 1]."""
    rounds: int = 0
    """How often a plan came near boxes, which were then added to S, and was checked again [-]."""


@compare_by_content
@dataclass(frozen=True, eq=False)
class PlacementPlan:
    """The base pose and motion for a task, or the reasons why there is none."""

    scene: str
    """Path of the scene file."""
    robot_name: str
    robot_urdf: str
    base_link: str
    tool_link: str
    task: Task
    status: Status
    joints: tuple[str, ...]
    """Names of the arm's joints, in the order of all arm states."""
    base_pose: tuple[float, float, float] | None = None
    """x [m], y [m], yaw [rad] of `base_link` on the floor."""
    motion: Motion | None = None
    navigation_cost: float | None = None
    """Driving length from the start [m]."""
    cost: Mapping[str, CostTerm] = field(default_factory=dict)
    """Terms of the base pose's cost by name."""
    candidates: Candidates = Candidates()
    timing: Mapping[str, float] = field(default_factory=dict, compare=False)
    """Time by stage, and "total" without "tolerance", which is measured later [s]; not compared."""
    key_objects: KeyObjects | None = None
    """The modeled objects; None if unknown."""
    method: str = "ours"
    seed: int = 0
    versions: Mapping[str, str] = field(default_factory=dict)
    start: tuple[float, float, float] | None = None
    """Start pose of the base: x [m], y [m], yaw [rad]."""
    base_path: Float[np.ndarray, "k 3"] | None = None
    """Base path from start to base pose, collision-free for the robot with its arm at home."""
    robot_file: str | None = None
    """The robot file, or the robot's name in the library."""
    robot_srdf: str | None = None
    """The SRDF with the disabled link pairs; None for the one next to the URDF, if any."""
    robot_rest: Mapping[str, float] = field(default_factory=dict)
    """Rest values of other joints than the arm's, if not zero [rad] or [m]."""
    robot_arm: str | None = None
    """The arm used, of a robot with several; the others rest."""
    robot_drive: Literal["differential", "omni", "car"] | None = None
    """How the base drives; None in older plans."""
    robot_min_turning_radius: float | None = None
    """Least turning radius of a car-like base [m]; None for others."""
    robot_amended: str | None = field(default=None, repr=False)
    """The URDF with the robot file's additions, if any; it is written next to the plan."""
    scene_joints: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Joint values that differ from the scene file's, by object and joint [rad] or [m]."""
    scene_hypotheses: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    """Index of the motion hypothesis used, by object and joint, from 0 as in the scene file; by
    default the first, which is the most probable. A plan that uses another is `assumed`."""
    assumption: Assumption | None = None
    """What an `assumed` plan assumes of the task's joint; None if unknown."""
    resistance: Mapping[str, Mapping[str, JointResistance]] = field(default_factory=dict)
    """Resistance of the moved part that the plan assumes, by object and joint; empty if unknown."""
    overrides: Overrides = NO_OVERRIDES
    """What the user has set of forces and masses."""
    loads: MotionLoads | None = None
    """The worst loads of the motion; None without a motion, and in older plans."""
    feasible_to: float | None = None
    """If the requested value is infeasible, the farthest feasible value found [rad] or [m]."""
    feasible_from: tuple[float, float, float] | None = None
    """A base pose from which `feasible_to` is reached: x [m], y [m], yaw [rad]."""
    feasible_sure: bool = False
    """Whether it is proved that the part opens no farther: something blocks it right there."""
    advice: str = ""
    """A change with which an infeasible task has a plan; "" if none was found."""
    tolerance: Tolerance | None = None
    """Base-pose robustness; None if not measured."""
    region: BaseRegion = ANYWHERE
    """Where the base was allowed to stand."""
    notes: tuple[str, ...] = ()
    """What the user should know about the answer, such as that the arm leaves the floor."""

    @property
    def feasible(self) -> bool:
        """Whether there is a base pose and a motion in the planned scene: solved or assumed."""
        return self.status in ("solved", "assumed")

    @property
    def moves_base(self) -> bool:
        """Whether the base moves during the manipulation."""
        return self.motion is not None and self.motion.moves_base

    @property
    def final_base_pose(self) -> tuple[float, float, float] | None:
        """Base pose after the manipulation: x [m], y [m], yaw [rad]; None without a base pose."""
        if self.motion is None or self.motion.base is None:
            return self.base_pose
        x, y, yaw = self.motion.base[-1].tolist()
        return x, y, float(np.arctan2(np.sin(yaw), np.cos(yaw)))

    @property
    def base_motion(self) -> str:
        """Return how the base moves in the manipulation, in words; "" if it stands still."""
        if self.motion is None or self.motion.base is None:
            return ""
        steps = np.abs(np.diff(self.motion.base, axis=0))
        held = np.zeros(len(steps), bool)
        for hold in self.motion.grasps:
            held[hold.first : hold.last] = True
        length, turn = np.hypot(steps[:, 0], steps[:, 1]).sum(), np.degrees(steps[:, 2].sum())
        when = "between grasps" if len(self.motion.grasps) > 1 else "before the grasp"
        if steps[held].max(initial=0.0) > 1e-9:
            when = "while the hand holds the part"
        return f"drives {length:.2f} m and turns {turn:.0f} deg {when}"

    @property
    def assumes(self) -> str:
        """Return what an assumed plan assumes about a joint; "" for another status."""
        if self.status != "assumed":
            return ""
        if self.assumption is None:
            return "a joint doesn't move in its most probable way"
        found = self.assumption
        other = f", not a {found.instead_of} ({100 * found.instead_probability:.2g} %)"
        words = f"{self.task.object}/{self.task.joint} is a {found}"
        return words if found.is_first else words + other

    def __repr__(self) -> str:
        what = f"{self.task.verb} {self.task.target}"
        return f"<PlacementPlan of {self.robot_name}: {what}: {self.status}>"


def status_of_all(plans: Sequence[PlacementPlan]) -> Status:
    """Return the status of plans in a row: of the last, or `assumed` if an earlier one is that."""
    assumed = any(plan.status == "assumed" for plan in plans)
    return "assumed" if assumed and plans[-1].status == "solved" else plans[-1].status


@dataclass(frozen=True)
class Latch:
    """A lever, knob or bolt on a part, which keeps the part closed until it is turned."""

    joint: str
    """The joint of the latch, on the part that it holds."""
    to: float
    """Value from which on the part is free [rad] or [m]."""
    holds: str
    """The joint that it holds."""

    def members(self) -> dict[str, str | float]:
        """Return the fields by name, as files hold them."""
        return asdict(self)
