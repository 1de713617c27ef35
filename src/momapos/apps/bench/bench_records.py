"""Records of the benchmark: suites and their tasks, jobs, rows. Imports nothing heavy."""

from __future__ import annotations

import hashlib
import random
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, TypeVar

import msgspec

from momapos.core import FileFormatError

Verb = Literal["open", "close", "pick", "place"]
Outcome = Literal["solved", "infeasible", "gave up", "failed"]
"""solved: the exact check accepts the plan; infeasible: a complete search finds no plan; gave up:
out of base poses or time, which proves nothing; failed: error, hang, crash, or a plan that the
exact check rejects."""
Commit = Literal["first", "retry"]
"""first: the first base pose that a method proposes counts; retry: a method tries its base poses in
turn."""
GraspSet = Literal["one", "pinch", "all"]
"""one: a straight pinch of the handle's middle, or of the object's; pinch: all pinches, without
turning the hand about the handle; all: every grasp of momapos."""
Pose = tuple[float, float, float]
"""x [m], y [m], yaw [rad]."""
Record = TypeVar("Record")
_URDF, _MESH = re.compile(r'"urdf": "([^"]+)"'), re.compile(r'<mesh[^>]*filename="([^"]+)"')


@dataclass(frozen=True)
class Container:
    """A part that must be opened before an object can be taken out."""

    object: str
    joint: str


@dataclass(frozen=True)
class Protocol:
    """The conditions under which an answer of a method counts."""

    commit: Commit = "retry"
    grasps: GraspSet = "all"

    def __str__(self) -> str:
        return f"{self.commit}, {self.grasps}"

    @classmethod
    def of(cls, words: str) -> Protocol:
        """Return the protocol that `str` describes.

        Raises:
            FileFormatError: There is no such protocol.
        """
        commit, _, grasps = words.partition(", ")
        return from_plain({"commit": commit, "grasps": grasps}, cls, f"protocol {words!r:.60}")


DEFAULT_PROTOCOL = Protocol()


@dataclass(frozen=True)
class SuiteTask:
    """One task of a suite, for one robot."""

    name: str
    """Unique in the suite."""
    group: str
    """Class in reports, such as "in fridge"."""
    scene: str
    """A built-in kitchen, or a scene file relative to the results folder."""
    robot: str
    """A robot of the library."""
    verb: Verb
    object: str
    joint: str | None = None
    to: float | None = None
    """Joint value to reach [rad] or [m]; None for the default of the verb."""
    inside: Container | None = None
    """The container of the object, which is opened first."""
    carried: tuple[str, ...] = ()
    """Objects in the drawer to open: they move with it, and are absent until it is open."""
    joints: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Initial joint values by object where they differ from the scene file [rad] or [m]."""
    start: Pose | None = None
    """Initial base pose; None for the scene's start."""
    seed: int = 0
    """Seed of the method, the noise and the physics."""


@dataclass(frozen=True)
class Suite:
    """Tasks, and everything that determines them."""

    name: str
    revision: int
    """Increases when the same seed gives other tasks."""
    seed: int
    robots: tuple[str, ...]
    methods: tuple[str, ...]
    """Default methods."""
    scenes: Mapping[str, str]
    """Content hash of every scene with its models, by the name in the tasks."""
    tasks: tuple[SuiteTask, ...]

    def limited(self, limit: int | None) -> list[SuiteTask]:
        """Draw some tasks, in their order; a larger number includes the same tasks.

        Args:
            limit: Number of tasks; None for all.
        """
        order = list(range(len(self.tasks)))
        if limit is not None:
            random.Random(self.seed).shuffle(order)
            order = sorted(order[:limit])
        return [self.tasks[k] for k in order]


@dataclass(frozen=True)
class Settings:
    """Settings for every task of a run."""

    timeout: float = 20.0
    """Processor time to search for one answer [s]."""
    limit: float = 300.0
    """Wall time after which a task counts as hung and its process is killed [s]."""
    execute: bool = False
    """Run solved plans in physics, with contact grasping and noise."""
    scan: int = 0
    """Images of a synthetic scan that replaces the true scene; 0 for the true scene."""
    disturbances: int = 0
    """Base poses 2 cm and 2 degrees off the planned one, and as many 5 cm and 5 degrees off it, at
    which the arm motion is replanned."""
    protocols: tuple[Protocol, ...] = (DEFAULT_PROTOCOL,)
    """Each task is run under each of them."""
    problems: str = ""
    """Folder of the user with the objects of the tasks; "" if the suite needs none."""


@dataclass(frozen=True)
class Job:
    """A task for a method."""

    key: str
    """Content hash of everything that determines the row."""
    folder: str
    """The results folder with the scene files."""
    task: SuiteTask
    method: str
    settings: Settings = field(default_factory=Settings)
    protocol: Protocol = DEFAULT_PROTOCOL
    record: str = ""
    """Folder for the plans and records of executed tasks, in a folder for each robot; "" for
    none. Not part of the key: it changes no row."""


@dataclass(frozen=True)
class Row:
    """Result of a job; its fields are the columns of the results file."""

    key: str
    """Hash of all that the answer depends on."""
    task: str
    """Name of the task."""
    group: str
    """Class of the task."""
    robot: str
    """Name of the robot."""
    method: str
    """Method of choosing base poses, with its settings."""
    seed: int
    """Seed of the search."""
    outcome: Outcome
    """How the job ended."""
    reason: str = ""
    """Why the task is unsolved or failed in physics; "" otherwise."""
    verified: bool | None = None
    """Whether the exact check accepts the plan; None without a plan."""
    done: bool | None = None
    """Whether the physics run succeeded; None if not executed."""
    seconds: float | None = None
    """Processor time of the answer, without loading and the benchmark's checks [s]."""
    wall: float | None = None
    """Wall time of the job [s]."""
    stages: Mapping[str, float] = field(default_factory=dict)
    """Processor time by stage [s]."""
    driving: float | None = None
    """Driving length of the plan [m]."""
    checked: int | None = None
    """Base poses with an arm motion search (planner calls) [-]."""
    sampled: int | None = None
    """Proposed base poses [-]."""
    clearance: float | None = None
    """Minimum distance to all other objects in physics [m]; None if not executed."""
    bases: tuple[Pose, ...] = ()
    """Base poses in the room, one per step."""
    at_2cm: float | None = None
    """Share of base poses 2 cm and 2 degrees off at which replanning succeeds, in [0, 1]; None if
    unsolved or not requested."""
    at_5cm: float | None = None
    """The same for 5 cm and 5 degrees."""
    protocol: str = str(DEFAULT_PROTOCOL)
    """How the base pose counts, and the grasps: the words of `Protocol`."""
    host: str = ""
    """Name of the machine."""
    finished: float = 0.0
    """Unix time [s]."""


def to_plain(record: object) -> Any:
    """Convert records to plain lists and dictionaries."""
    return msgspec.to_builtins(record)


def from_plain(data: object, kind: type[Record], where: str) -> Record:
    """Convert plain lists and dictionaries to a record.

    Raises:
        FileFormatError: A member is missing or has the wrong type; the message names it.
    """
    try:
        return msgspec.convert(data, kind, strict=False)
    except msgspec.ValidationError as error:
        raise FileFormatError(f"{where}: not a usable {kind.__name__}: {error}") from error


def scene_digest(path: Path) -> str:
    """Return a content hash of a scene file and its models; a mesh may be missing."""
    text = path.read_text(encoding="utf-8")
    digest = hashlib.sha256(text.encode())
    for urdf in sorted(set(_URDF.findall(text))):
        model = path.parent / urdf
        meshes = sorted(set(_MESH.findall(model.read_text(encoding="utf-8"))))
        for name, file in ((urdf, model), *((mesh, model.parent / mesh) for mesh in meshes)):
            digest.update(name.encode() + b"\n")
            if file.is_file() or file == model:
                digest.update(file.read_bytes())
    return digest.hexdigest()[:32]
