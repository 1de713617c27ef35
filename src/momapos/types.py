"""Records handed between stages. Everything is in SI units, in the world frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float, Float32, Int, UInt8

from momapos.outcomes import CostTerm, PoseOutcome, Tolerance

Verb = Literal["open", "close", "pick", "place"]
Status = Literal["solved", "infeasible", "timeout"]
PartKind = Literal["door_left", "door_right", "door_down", "door_up", "drawer"]
"""How a part opens, seen from the front: a `door_left` has its hinge on the left."""
LabelSource = Literal["size", "segmenter", "detector", "given"]
"""Who says what a thing is: rules about its size, who divided the cloud, a detector in the images,
or the user."""
UNKNOWN: tuple[str, float] = ("object", 0.2)
"""Label and confidence of a thing of which nothing tells what it is."""


@dataclass(frozen=True, eq=False)
class Frame:
    """One picture of a scan and where it was taken from."""

    name: str
    color: UInt8[np.ndarray, "h w 3"]
    depth: Float32[np.ndarray, "h w"] | None
    """Distance along the optical axis [m], 0 where it was not measured; None without a sensor."""
    intrinsics: Float[np.ndarray, "3 3"]
    """Of color and depth, which are registered [px]."""
    T_world_camera: Float[np.ndarray, "4 4"]
    """Camera axes as in OpenCV: x right, y down, z forward."""

    def __repr__(self) -> str:
        height, width = self.color.shape[:2]
        depth = "no depth" if self.depth is None else "depth"
        return f"<Frame {self.name!r}: {width} x {height} pixels, {depth}>"


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points of surfaces."""

    points: Float[np.ndarray, "n 3"]
    normals: Float[np.ndarray, "n 3"]
    """Unit vectors toward the side that was seen."""
    colors: UInt8[np.ndarray, "n 3"]

    def __repr__(self) -> str:
        return f"<Cloud: {len(self.points)} points>"


@dataclass(frozen=True, eq=False)
class Scan:
    """What was recorded of a room: pictures, or a cloud, or both."""

    name: str
    frames: tuple[Frame, ...]
    cloud: Cloud | None = None
    """A cloud that came with the scan; without one it is fused from the frames."""
    warnings: tuple[str, ...] = ()
    """What was skipped or assumed, one line each."""
    notes: tuple[str, ...] = ()
    """What was measured of it, one line each."""

    def __repr__(self) -> str:
        cloud = "no cloud" if self.cloud is None else f"a cloud of {len(self.cloud.points)} points"
        return f"<Scan {self.name!r}: {len(self.frames)} frames, {cloud}>"


@dataclass(frozen=True, eq=False)
class UprightBox:
    """A box with vertical edges."""

    center: Float[np.ndarray, "3"]
    size: Float[np.ndarray, "3"]
    """Along its own x, y, z [m]."""
    yaw: float = 0.0
    """Turn of its x axis about the world's z [rad]."""


@dataclass(frozen=True, eq=False)
class Instance:
    """One thing that a segmenter found."""

    label: str
    """Its class, or "" where the segmenter does not know."""
    score: float
    """Confidence in [0, 1]."""
    members: Int[np.ndarray, " k"] | None = None
    """Indices into the cloud."""
    box: UprightBox | None = None
    """For segmenters that give boxes."""
    guesses: tuple[tuple[str, float], ...] = ()
    """Where the label is a guess by size: all that it allows, with confidences, best first."""


@dataclass(frozen=True, eq=False)
class Detection:
    """One thing in the room, with its box."""

    name: str
    label: str
    score: float
    box: UprightBox
    members: Int[np.ndarray, " k"]
    """Indices into the cloud, outliers removed."""
    label_from: LabelSource = "segmenter"
    guesses: tuple[tuple[str, float], ...] = ()
    """As of an `Instance`."""
    seen: float | None = None
    """Share of the surface that can be seen on which something was measured, in [0, 1]."""
    completed: float = 0.0
    """Share of its points that no depth image shows: a black, mirrored or glass front, completed
    from what is around it [-]."""


@dataclass(frozen=True)
class ImageDetection:
    """One thing that a 2-D detector found in one image."""

    box: tuple[float, float, float, float]
    """Left, top, right, bottom [px]."""
    label: str
    score: float


@dataclass(frozen=True, eq=False)
class FaceImage:
    """One upright face of a box, seen straight on; row 0 is its top, column 0 its left."""

    color: UInt8[np.ndarray, "h w 3"]
    height_map: Float32[np.ndarray, "h w"]
    """How far the surface stands out of the face's plane [m]; NaN where not measured."""
    width: float
    """Size of the face [m]."""
    height: float
    camera_position: Float[np.ndarray, "3"] | None = None
    """Where the camera was that took the colors [m]: x right and y up from the middle of the face,
    z outward. What stands out was seen displaced, away from there. None where it is not known."""


@dataclass(frozen=True)
class Part:
    """A door or drawer on a face; rectangles are (left, top, right, bottom) as fractions of it."""

    kind: PartKind
    box: tuple[float, float, float, float]
    score: float
    """Confidence in [0, 1]."""
    handle: tuple[float, float, float, float] | None = None
    odds: tuple[tuple[PartKind, float], ...] = ()
    """How it may open, each with its probability, the likeliest first, which is its kind; they sum
    to one. Empty where nobody says."""


@dataclass(frozen=True)
class Confidence:
    """How sure a scan is of an object; all numbers in [0, 1]."""

    object: float
    """Share of the surface that can be seen that was seen."""
    label: float
    """That it is what its category says."""
    joints: Mapping[str, float] = field(default_factory=dict)
    """That there is such a part and that it moves so, by joint."""
    handles: Mapping[str, float] = field(default_factory=dict)
    """That there is a handle where the model has one, by the joint of its part."""


@dataclass(frozen=True)
class Hypothesis:
    """One way in which a part may move, in the frame of its object; shut at 0."""

    kind: PartKind
    probability: float
    point: tuple[float, float, float]
    """On its axis [m]."""
    axis: tuple[float, float, float]
    """Unit vector about or along which it moves."""
    upper: float
    """Where it ends [rad] or [m]."""


@dataclass(frozen=True)
class Front:
    """What a predictor sees on a face."""

    score: float
    """Probability that this face is a front, in [0, 1]."""
    parts: tuple[Part, ...]


@dataclass(frozen=True)
class Task:
    """What is to be done."""

    verb: Verb
    object: str
    joint: str | None = None
    """The joint that must move; None for pick and place."""
    to: float | None = None
    """The value the joint must reach [rad] or [m]."""
    farthest: bool = False
    """Whether it must go no farther than `to`, but as far up to there as it can."""


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


Outline: TypeAlias = tuple[tuple[float, float], ...]
"""Corners of an area on the floor: x, y [m]."""


@dataclass(frozen=True)
class BaseRegion:
    """Where the base may stand, beside what the room and the arm allow."""

    keep_in: tuple[Outline, ...] = ()
    """The whole footprint stays in one of these; anywhere where there is none."""
    keep_out: tuple[Outline, ...] = ()
    """No part of the footprint is in any of these."""
    facing: float | None = None
    """Most angle between the base's x and the way to where the hand takes hold [rad]."""
    most_driving: float | None = None
    """Longest drive from the start [m]."""


ANYWHERE = BaseRegion()


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
