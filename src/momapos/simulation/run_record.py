"""What came of a run, and its file: momapos-run, version 1."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from momapos.core import FileFormatError, InputError, read_bytes_bounded, write_atomic
from momapos.model.records import Task

from .run_motion import RunMotion, Triple

if TYPE_CHECKING:
    from jaxtyping import Float

FORMAT, VERSION = "momapos-run", 1
MAX_BYTES = 10_000_000
Pose = tuple[float, float, float]


@dataclass(frozen=True)
class Collision:
    """Two things that touched and should not."""

    one: str
    """A link of the robot or OBJECT/LINK."""
    other: str
    force: float
    """Largest normal force [N]."""
    depth: float
    """Deepest overlap; the engine's contacts are soft [m]."""
    seconds: float
    """How long they touched [s]."""
    first: float
    """When they first touched, from the beginning of the run [s]."""
    stage: str


@dataclass(frozen=True)
class Slip:
    """How far the tool moved in what it held, from the moment it took hold."""

    position: float = 0.0
    """[m]"""
    angle: float = 0.0
    """[rad]"""


@dataclass(frozen=True)
class Load:
    """The largest load of the hand while it held something."""

    force: float = 0.0
    """[N]"""
    torque: float = 0.0
    """[Nm]"""


@dataclass(frozen=True)
class Tracking:
    """How well the motors followed."""

    worst: float = 0.0
    """Largest error of a joint [rad] or [m]."""
    rms: float = 0.0
    """Root of the mean square over joints and time [rad] or [m]."""
    effort: float = 0.0
    """Largest share of a joint's effort limit that was used [-]; 0 where no limit is known."""


@dataclass(frozen=True)
class JointFound:
    """Where the arm found the joint of the part that it moved."""

    direction: Triple
    """Of the axis, in the world."""
    point: Triple
    """On the axis of a hinge [m]."""
    tilt: float
    """Angle to the axis as modeled [rad]."""
    shift: float
    """Distance of a hinge from where it is modeled [m]."""


@dataclass(frozen=True)
class Execution:
    """One motion, executed in physics."""

    success: bool
    """Whether the joint reached the value asked for, or the object is where it should be."""
    reason: str
    """Why not; "" where it did."""
    hold: str
    """weld or contact."""
    start: float
    """Value of the joint at first [rad] or [m]; for loose objects the height [m]."""
    asked: float
    reached: float
    collisions: tuple[Collision, ...] = ()
    """Hardest first."""
    slip: Slip = Slip()
    load: Load = Load()
    tracking: Tracking = Tracking()
    clearance: float | None = None
    """Least distance of the robot from everything but floor and part [m]; None: out of sight."""
    base_shift: Pose = (0.0, 0.0, 0.0)
    """How far the base yielded at most: forward, left [m], yaw [rad]."""
    resistance: Mapping[str, float] = field(default_factory=dict)
    """Of the part in this run: mass, friction, damping, pull."""
    time: Mapping[str, float] = field(default_factory=dict)
    """Simulated seconds by stage."""
    simulated: float = 0.0
    """Simulated time in all [s]."""
    wall: float = 0.0
    """Time that the simulation took, without building the world [s]."""
    ending: str = ""
    """How the run ended, one of `Ending`."""
    base_pose: Pose | None = None
    """Where the base stood: x [m], y [m], yaw [rad]; None in records of before."""
    joint: JointFound | None = None
    """None for loose objects, and where the hand took no hold."""
    notes: tuple[str, ...] = ()
    """What was left out or assumed, one line each."""


@dataclass(frozen=True)
class Visit:
    """One drive to a base pose, and whether the arm found a motion there."""

    planned: Pose
    """x [m], y [m], yaw [rad]."""
    reached: Pose
    length: float
    """Driven [m]."""
    seconds: float
    """[s]"""
    reason: str
    """Why nothing was executed there; "" where it was."""
    arrived: bool = True
    """Whether the drive ended at the base pose; else the reason is why it did not."""
    way: float | None = None
    """Length of the way as first planned [m]; None where there was none."""
    clearance: float | None = None
    """Smallest distance of the driving base, its arm at home, to anything [m], at most 0.5."""
    hit: str = ""
    """What the base touched, which ended the drive; "" where it touched nothing."""


@dataclass(frozen=True)
class RunRecord:
    """What came of a plan."""

    scene: str
    robot: str
    task: Task
    visits: tuple[Visit, ...]
    """All drives; where something was executed after one, `Execution.base_pose` says."""
    execution: Execution | None
    """The last one; None where no arm motion was found at any pose reached."""
    failed: tuple[Execution, ...] = ()
    """Those before, which failed and after which the arm came home, in order."""
    kinds: tuple[str, ...] = ()
    """As what kind of part each motion took its part, one of `PartKind`; empty where the scene
    knows how it moves."""
    seed: int = 0
    noise: bool = False
    time: Mapping[str, float] = field(default_factory=dict)
    """Seconds of computing by stage: drive, plan, execute."""
    versions: Mapping[str, str] = field(default_factory=dict)
    plan: str = ""
    """The plan's file, seen from the folder of the record; "" where nobody said."""
    world: str = ""
    """Likewise the scene that was really there; "" where that is the plan's own."""
    world_at: Pose | None = None
    """Where its origin lies in the plan's scene: x [m], y [m], yaw [rad]."""
    true_task: Task | None = None
    """What the task means in that world."""
    motion: RunMotion | None = None
    """What moved; None where nobody watched."""

    @property
    def success(self) -> bool:
        """Whether the task was done."""
        return self.execution is not None and self.execution.success

    @property
    def reason(self) -> str:
        """Why it was not; "" where it was."""
        if self.execution is not None:
            return self.execution.reason
        return self.visits[-1].reason if self.visits else "nothing was driven"

    @property
    def driven(self) -> float:
        """Driven length [m]."""
        return sum(visit.length for visit in self.visits)


def run_to_dict(record: RunRecord) -> dict[str, Any]:
    """Turn a record into what its file holds."""
    return {
        "format": FORMAT,
        "version": VERSION,
        "success": record.success,
        "reason": record.reason,
        "driven": record.driven,
        **asdict(record),
    }


def write_run(record: RunRecord, path: Path) -> None:
    """Write a record, the whole file or nothing.

    Raises:
        InputError: It holds NaN, or the file cannot be written.
    """
    try:
        text = json.dumps(run_to_dict(record), allow_nan=False) + "\n"
    except ValueError as error:
        raise InputError(f"{path}: the record holds NaN or infinity and was not written") from error
    try:
        write_atomic(path, text.encode())
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from error


def with_files(
    record: RunRecord,
    out: Path,
    plan: Path,
    world: str | None = None,
    world_at: Float[np.ndarray, "3"] | None = None,
) -> RunRecord:
    """A record that says from which files it came, so that it can be shown again.

    Args:
        record: The record.
        out: Where it will be written; what it names is seen from there.
        plan: The plan's file.
        world: A scene file, or the name of a built-in scene, that was really there.
        world_at: Where its origin lies: x [m], y [m], yaw [rad].
    """

    def seen(path: Path) -> str:
        return os.path.relpath(path.resolve(), out.resolve().parent)

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
        FileFormatError: It is none that can be used; one line says why.
    """
    content = read_bytes_bounded(path, MAX_BYTES)
    try:
        head = msgspec.json.decode(content, type=_RunHead)
        if (head.format, head.version) != (FORMAT, VERSION):
            raise FileFormatError(
                f'{path}: not a run record of this version; it has "format": {head.format!r:.60}, '
                f'"version": {head.version!r:.60}, not {FORMAT!r} and {VERSION}'
            )
        return msgspec.json.decode(content, type=RunRecord)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise FileFormatError(f"{path}: not a usable run record: {error}") from error
