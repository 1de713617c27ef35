"""What the benchmark writes: tasks of a suite, jobs, rows; nothing heavy is imported."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, TypeVar

import msgspec

from momapos.core import FileFormatError

Verb = Literal["open", "close", "pick", "place"]
Outcome = Literal["solved", "infeasible", "gave up", "failed"]
"""solved: a plan that the exact check accepts; infeasible: the method says that there is none;
gave up: out of poses or of time, which proves nothing; failed: an error, a hang, a crash, or a plan
that the exact check refuses."""
Pose = tuple[float, float, float]
"""x [m], y [m], yaw [rad]."""
Record = TypeVar("Record")


@dataclass(frozen=True)
class Container:
    """The part that has to be opened before a thing can be taken out."""

    object: str
    joint: str


@dataclass(frozen=True)
class SuiteTask:
    """One task of a suite, for one robot."""

    name: str
    """Unique in its suite."""
    group: str
    """The class under which reports count it, such as "in fridge"."""
    scene: str
    """A built-in kitchen, or a scene file relative to the results folder."""
    robot: str
    """A robot of the library."""
    verb: Verb
    object: str
    joint: str | None = None
    to: float | None = None
    """Value the joint must reach [rad] or [m]; None for the default of the verb."""
    inside: Container | None = None
    """What holds the object, and is opened first."""
    carried: tuple[str, ...] = ()
    """Things in the drawer that is opened: they move with it, and are left out until it is open."""
    joints: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Joints that stand elsewhere than in the scene file at first, by object [rad] or [m]."""
    start: Pose | None = None
    """Where the base is at first; None for the scene's start."""
    seed: int = 0
    """Of the method, the noise and the physics."""


@dataclass(frozen=True)
class Suite:
    """Tasks, and all that decides what they are."""

    name: str
    revision: int
    """Counts up whenever the same seed gives other tasks."""
    seed: int
    robots: tuple[str, ...]
    methods: tuple[str, ...]
    """Asked where nobody names others."""
    scenes: Mapping[str, str]
    """Content hash of every scene and its models, by the name that tasks use."""
    tasks: tuple[SuiteTask, ...]


@dataclass(frozen=True)
class Settings:
    """How every task of a run is asked."""

    timeout: float = 20.0
    """Processor time that a method may search for one answer [s]."""
    limit: float = 300.0
    """Wall time after which a task counts as hung, and its process is ended [s]."""
    execute: bool = False
    """Whether solved plans are carried out in physics, held by contact, with noise."""
    scan: int = 0
    """Images of the synthetic scan from which the robot knows the room; 0: it knows the room."""
    disturbances: int = 0
    """Base poses 2 cm and 2 degrees, and as many 5 cm and 5 degrees off the planned one, from which
    the arm's motion is planned anew."""


@dataclass(frozen=True)
class Job:
    """A task to be answered by a method."""

    key: str
    """Content hash of everything that decides the row."""
    folder: str
    """The results folder, in which scene files are found."""
    task: SuiteTask
    method: str
    settings: Settings = field(default_factory=Settings)


@dataclass(frozen=True)
class Row:
    """What came of a job; the columns of the table in the results file."""

    key: str
    task: str
    group: str
    robot: str
    method: str
    seed: int
    outcome: Outcome
    reason: str = ""
    """Why it is not solved, or why physics did not do it; "" otherwise."""
    verified: bool | None = None
    """Whether the exact check accepts the plan; None where there is none."""
    done: bool | None = None
    """Whether it was done in physics; None where nothing was executed."""
    seconds: float | None = None
    """Processor time of the answer, without loading and checks of the benchmark [s]."""
    wall: float | None = None
    """Wall time of the whole job [s]."""
    stages: Mapping[str, float] = field(default_factory=dict)
    """Processor time by stage of the answer [s]."""
    driving: float | None = None
    """Driving length of the plan [m]."""
    checked: int | None = None
    """Base poses at which an arm motion was looked for: calls of the planner [-]."""
    sampled: int | None = None
    """Base poses that were proposed [-]."""
    clearance: float | None = None
    """Least distance to everything else in physics [m]; None where nothing was executed."""
    bases: tuple[Pose, ...] = ()
    """Where the robot stands in the room, one pose a step."""
    at_2cm: float | None = None
    """Share of base poses 2 cm and 2 degrees off from which the arm still does it, in [0, 1]; None
    where it is not solved, or none was asked."""
    at_5cm: float | None = None
    """The same 5 cm and 5 degrees off."""
    host: str = ""
    finished: float = 0.0
    """Unix time [s]."""


def to_plain(record: object) -> Any:
    """A record, or several, as plain lists and dictionaries."""
    return msgspec.to_builtins(record)


def from_plain(data: object, kind: type[Record], where: str) -> Record:
    """A record from plain lists and dictionaries.

    Raises:
        FileFormatError: A member is missing or of the wrong type; the message says which.
    """
    try:
        return msgspec.convert(data, kind, strict=False)
    except msgspec.ValidationError as error:
        raise FileFormatError(f"{where}: not a usable {kind.__name__}: {error}") from error
