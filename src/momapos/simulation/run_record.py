"""Record of a run, and its file: momapos-run, version 1."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import chain, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from momapos.core import FileFormatError, InputError, read_bytes_bounded, resolved, write_file
from momapos.model.records import Task

if TYPE_CHECKING:
    from jaxtyping import Float


Triple = tuple[float, float, float]
DRIVE = "drive"
"""Stage in which the base drives."""
DIGITS = 4
"""Decimal digits of recorded lengths and angles [-]."""
MAX_SECONDS = 3600.0
"""Longest motion; at 10 samples a second, a longer one hardly fits into a file [s]."""
MAX_COORDINATE = 1e4
"""Largest joint value and coordinate [rad] or [m]."""
MAX_UNIT_ERROR = 0.01
"""Largest error of the length of a rounded unit quaternion [-]."""
MAX_FORCE = 1e6
"""Largest component of a force [N]."""


@dataclass(frozen=True)
class RunMotion:
    """Samples of a run; every list has the length of `times`, or is empty."""

    times: tuple[float, ...]
    """Time since the start of the run, non-decreasing [s]."""
    stages: tuple[str, ...]
    """drive, or one of `Stage`."""
    bases: tuple[Triple, ...]
    """Pose of the base: x [m], y [m], yaw [rad]."""
    joints: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    """Values of the robot's moving joints by name: arm and fingers [rad] or [m]."""
    part: tuple[float, ...] = ()
    """Value of the joint that the task moves [rad] or [m]; empty for movable objects."""
    poses: tuple[tuple[float, ...], ...] = ()
    """Pose of a movable object's root link in the world: x, y, z [m], then quaternion wxyz."""
    forces: tuple[Triple, ...] = ()
    """Force of the held object on the hand, in the world [N]; 0 without a grasp."""
    latch: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    """Values of the part's latch by the name of its joint [rad] or [m]; empty if none is turned."""

    def __post_init__(self) -> None:
        """Check the lengths and the times."""
        lists = (self.stages, self.bases, *self.joints.values(), self.part, self.poses, self.forces)
        if any(len(one) not in (0, len(self.times)) for one in lists):
            raise ValueError(f"each list of a motion must be empty or have {len(self.times)} items")
        if any(len(one) != len(self.times) for one in self.latch.values()):
            raise ValueError("the values of a latch must be as long as the times of its motion")
        if len(self.bases) != len(self.times) or len(self.stages) != len(self.times):
            raise ValueError("stages and bases of a motion must be as long as its times")
        if any(b < a for a, b in pairwise(self.times)):
            raise ValueError("the times of a motion must not decrease")
        if any(len(pose) != 7 for pose in self.poses):
            raise ValueError("each pose of a motion must have 7 numbers")

    def check_numbers(self) -> None:
        """Check that all numbers of a file are of a possible size.

        Raises:
            ValueError: One is not; the message names its kind.
        """
        values = (self.part, *self.joints.values(), *self.latch.values(), *self.bases, *self.poses)
        for name, most, numbers in (
            ("times [s]", MAX_SECONDS, iter(self.times)),
            ("values and poses [rad], [m]", MAX_COORDINATE, chain.from_iterable(values)),
            ("forces [N]", MAX_FORCE, chain.from_iterable(self.forces)),
        ):
            _check_range(name, most, numbers)
        if any(abs(math.hypot(*pose[3:]) - 1.0) > MAX_UNIT_ERROR for pose in self.poses):
            raise ValueError("each pose of a motion must end with a unit quaternion")


def _check_range(name: str, most: float, numbers: Iterable[float]) -> None:
    for number in numbers:
        if not abs(number) <= most:
            raise ValueError(
                f"the {name} of a motion must be finite and at most {most:g}, not {number:g}"
            )


def rounded(values: Sequence[float], digits: int = DIGITS) -> tuple[float, ...]:
    """Round numbers to the digits that a record keeps."""
    return tuple(round(float(value), digits) for value in values)


FORMAT, VERSION = "momapos-run", 1
MAX_BYTES = 10_000_000
MAX_NUMBER = 1e9
"""Largest result of a run in a file, in its unit."""
Pose = tuple[float, float, float]


@dataclass(frozen=True)
class Collision:
    """Contact between two bodies that should not touch."""

    one: str
    """Link of the robot, or OBJECT/LINK."""
    other: str
    """What it touched, in the same form."""
    force: float
    """Maximum normal force [N]."""
    depth: float
    """Maximum overlap, which the engine's soft contacts allow [m]."""
    seconds: float
    """Duration of the contact [s]."""
    first: float
    """Time of the first contact, since the start of the run [s]."""
    stage: str
    """Stage of the run, see `RunMotion.stages`."""


@dataclass(frozen=True)
class Slip:
    """Maximum motion of the tool relative to the grasped object since the grasp."""

    position: float = 0.0
    """[m]"""
    angle: float = 0.0
    """[rad]"""


@dataclass(frozen=True)
class Load:
    """Maximum load of the hand during a grasp."""

    force: float = 0.0
    """[N]"""
    torque: float = 0.0
    """[Nm]"""


@dataclass(frozen=True)
class Tracking:
    """Tracking errors of the motors."""

    worst: float = 0.0
    """Maximum error of a joint [rad] or [m]."""
    rms: float = 0.0
    """Root mean square over joints and time [rad] or [m]."""
    effort: float = 0.0
    """Maximum used share of a joint's effort limit [-]; 0 without known limits."""


@dataclass(frozen=True)
class JointFound:
    """Estimated joint of the moved part."""

    direction: Triple
    """Direction of the axis, in the world."""
    point: Triple
    """Point on a hinge axis [m]."""
    tilt: float
    """Angle to the modeled axis [rad]."""
    shift: float
    """Distance of a hinge from its modeled position [m]."""


@dataclass(frozen=True)
class Execution:
    """One motion, executed in physics."""

    success: bool
    """Whether the joint reached the requested value, or the object its goal."""
    reason: str
    """Why it failed; "" on success."""
    hold: str
    """weld or contact."""
    start: float
    """Initial value of the joint [rad] or [m]; for movable objects the height [m]."""
    asked: float
    """Requested value of the joint [rad] or [m], or height of the object [m]."""
    reached: float
    """Final value of it."""
    collisions: tuple[Collision, ...] = ()
    """Hardest first."""
    slip: Slip = Slip()
    """How far the object moved in the hand."""
    load: Load = Load()
    """How hard the object pulled at the hand."""
    tracking: Tracking = Tracking()
    """How well the motors followed."""
    stability: float | None = None
    """Least distance from tipping over: of the zero moment point from the edge of the area that the
    wheels stand on [m]; None if masses or wheels are unknown, and in older records."""
    clearance: float | None = None
    """Minimum distance from the robot to the room [m]; None if above the observed range."""
    base_shift: Pose = (0.0, 0.0, 0.0)
    """Maximum displacement of the base from where it should be: forward, left [m], yaw [rad], in
    the frame of its first pose."""
    resistance: Mapping[str, float] = field(default_factory=dict)
    """Resistance of the part in this run: mass, friction, damping, pull."""
    time: Mapping[str, float] = field(default_factory=dict)
    """Simulated time by stage [s]."""
    simulated: float = 0.0
    """Total simulated time [s]."""
    wall: float = 0.0
    """Computing time of the simulation, without building the world [s]."""
    ending: str = ""
    """How the run ended, one of `Ending`."""
    base_pose: Pose | None = None
    """Pose of the base: x [m], y [m], yaw [rad]; None in older records."""
    final_base_pose: Pose | None = None
    """Pose of the base at the end; None if it stood still, and in older records."""
    joint: JointFound | None = None
    """None for movable objects, and without a grasp."""
    notes: tuple[str, ...] = ()
    """Assumptions and omissions, one line each."""


@dataclass(frozen=True)
class Visit:
    """One drive to a base pose, and whether the arm found a motion there."""

    planned: Pose
    """x [m], y [m], yaw [rad]."""
    reached: Pose
    """The pose at which the drive ended, in the same form."""
    length: float
    """Driven distance [m]."""
    seconds: float
    """[s]"""
    reason: str
    """Why nothing was executed there; "" otherwise."""
    arrived: bool = True
    """Whether the drive ended at the base pose; otherwise `reason` explains it."""
    way: float | None = None
    """Length of the planned path [m]; None without a path."""
    clearance: float | None = None
    """Minimum clearance of the driving base with its arm at home [m], at most 0.5."""
    hit: str = ""
    """Obstacle that the base touched, which ended the drive; "" without contact."""


@dataclass(frozen=True)
class RunRecord:
    """Result of executing a plan."""

    scene: str
    """Path or name of the plan's scene."""
    robot: str
    """Name of the robot."""
    task: Task
    """The task of the plan."""
    visits: tuple[Visit, ...]
    """All drives; `Execution.base_pose` tells after which one a motion was executed."""
    execution: Execution | None
    """Last motion; None if no arm motion was found at any pose reached."""
    failed: tuple[Execution, ...] = ()
    """Earlier motions that failed and after which the arm came home, in order."""
    kinds: tuple[str, ...] = ()
    """Kind of part that each motion assumed, one of `PartKind`; empty if the scene knows the
    part's joint."""
    seed: int = 0
    """Seed of the noise."""
    noise: bool = False
    """Whether drives and resistances have noise."""
    time: Mapping[str, float] = field(default_factory=dict)
    """Computing time by stage [s]: drive, plan, execute."""
    versions: Mapping[str, str] = field(default_factory=dict)
    """Versions of the packages that the run depends on."""
    plan: str = ""
    """Path of the plan file, relative to the record's folder; "" if unknown."""
    world: str = ""
    """Path or name of the true scene; "" for the plan's own scene."""
    world_at: Pose | None = None
    """Pose of that scene's origin in the plan's scene: x [m], y [m], yaw [rad]."""
    true_task: Task | None = None
    """The task in that scene."""
    motion: RunMotion | None = None
    """Recorded motion; None if the run was not watched."""
    assumed: str = ""
    """Assumed kind of the part if the simulated room is only an assumption, because the plan is
    `assumed` and no true scene was given; "" otherwise."""
    exact: bool = False
    """Whether the plan's own states were followed, without replanning; see `run_exactly`."""

    @property
    def success(self) -> bool:
        """Whether the part or object moved as the plan requests, in the simulated room."""
        return self.execution is not None and self.execution.success

    @property
    def verdict(self) -> str:
        """Return "done", "failed", or "moved as assumed" if the room is only an assumption."""
        if not self.success:
            return "failed"
        return "moved as assumed" if self.assumed else "done"

    @property
    def reason(self) -> str:
        """Why the task was not done; "" on success."""
        if self.execution is not None:
            return self.execution.reason
        return self.visits[-1].reason if self.visits else "nothing was driven"

    @property
    def final_base_pose(self) -> Pose | None:
        """Pose of the base at the end: x [m], y [m], yaw [rad]; None if nothing was driven."""
        if self.execution is not None and self.execution.final_base_pose is not None:
            return self.execution.final_base_pose
        return self.visits[-1].reached if self.visits else None

    @property
    def driven(self) -> float:
        """Driven distance [m]."""
        return sum(visit.length for visit in self.visits)


def run_to_dict(record: RunRecord) -> dict[str, Any]:
    """Convert a record to the content of its file."""
    members = asdict(record)
    if record.motion is not None and not record.motion.latch:
        del members["motion"]["latch"]
    return {
        "format": FORMAT,
        "version": VERSION,
        "success": record.success,
        "reason": record.reason,
        "driven": record.driven,
        **members,
    }


def write_run(record: RunRecord, path: Path) -> None:
    """Write a record atomically.

    Raises:
        InputError: The record has NaN or infinity, or the file cannot be written.
    """
    try:
        text = json.dumps(run_to_dict(record), allow_nan=False) + "\n"
    except ValueError as error:
        raise InputError(f"{path}: not written, the record contains NaN or infinity") from error
    write_file(path, text)


def with_files(
    record: RunRecord,
    out: Path,
    plan: Path,
    world: str | None = None,
    world_at: Float[np.ndarray, "3"] | None = None,
) -> RunRecord:
    """Return a record with the files it came from, so that it can be replayed.

    Args:
        record: The record.
        out: File of the record; the paths in it are relative to its folder.
        plan: The plan file.
        world: True scene: a scene file, or the name of a built-in scene.
        world_at: Pose of its origin: x [m], y [m], yaw [rad].
    """

    def seen(path: Path) -> str:
        return os.path.relpath(resolved(path), resolved(out).parent)

    there = "" if world is None else seen(Path(world)) if Path(world).is_file() else world
    at = None
    if world_at is not None:
        x, y, yaw = world_at.tolist()
        at = (x, y, yaw)
    return replace(record, plan=seen(plan), world=there, world_at=at)


class _RunHead(msgspec.Struct):
    format: Any = None
    version: Any = None


def read_run(path: Path) -> RunRecord:
    """Read a record.

    Raises:
        FileFormatError: The file is not a valid run record of this version.
    """
    content = read_bytes_bounded(path, MAX_BYTES).removeprefix(b"\xef\xbb\xbf")
    try:
        head = msgspec.json.decode(content, type=_RunHead)
        if (head.format, head.version) != (FORMAT, VERSION):
            raise FileFormatError(
                f'{path}: not a {FORMAT} file of version {VERSION}; it has "format": '
                f'{head.format!r:.60}, "version": {head.version!r:.60}'
            )
        record = msgspec.json.decode(content, type=RunRecord)
        _check_numbers(record)
        return record
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError, ValueError) as error:
        raise FileFormatError(f"{path}: invalid run record: {error}") from error


def _check_numbers(record: RunRecord) -> None:
    """Check that all numbers of a record are of a possible size.

    Raises:
        ValueError: One is not.
    """
    if record.motion is not None:
        record.motion.check_numbers()
    left = [msgspec.to_builtins(replace(record, motion=None))]
    while left:
        value = left.pop()
        if isinstance(value, dict | list | tuple):
            left.extend(value.values() if isinstance(value, dict) else value)
        elif isinstance(value, float) and not abs(value) <= MAX_NUMBER:
            raise ValueError(f"numbers must be at most {MAX_NUMBER:g}, not {value:g}")
