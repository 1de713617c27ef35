"""Read problems of arm motion planning: MoveIt's planning scenes and motion plan requests.

A problem is a pair `sceneNNNN.yaml` and `requestNNNN.yaml` in a folder KIND_ROBOT, as in
MotionBenchMaker (Chamzas et al., RA-L 2022). Files are not trusted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from momapos.core import FileFormatError, InputError, parse_yaml, read_bytes_bounded
from momapos.core.geometry import pose
from momapos.model.urdf import Boxes

from .bench_records import from_plain

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

MAX_BYTES = 2_000_000
"""Maximum size of a file; those of MotionBenchMaker have up to 12 kB."""
MAX_OBJECTS = 2_000
"""Maximum number of shapes in a scene [-]."""
MAX_SIZE = 100.0
"""Largest coordinate and edge in a scene [m]."""
BOX, CYLINDER = ("box", 1), ("cylinder", 3)
"""Names and numbers of the shapes in shape_msgs/SolidPrimitive."""
Record = TypeVar("Record")


@dataclass(frozen=True)
class ProblemFiles:
    """Files of one problem."""

    kind: str
    """Kind of scene, such as "cage"."""
    number: str
    """Number in the file names, such as "0001"."""
    scene: Path
    request: Path


@dataclass(frozen=True, eq=False)
class ArmProblem:
    """The obstacles, and the two ends of the motion."""

    boxes: Boxes
    """In the frame of the robot's root link, or of its base link on the floor."""
    cylinder: Bool[np.ndarray, " b"]
    """Boxes that stand for the cylinder in them, about their third axis."""
    labels: tuple[str, ...]
    """Object of each box."""
    group: str
    """Joint group that moves."""
    start: Mapping[str, float]
    """Values of all joints at the start [rad] or [m]."""
    goal: Mapping[str, float]
    """Values of the group's joints at the goal [rad] or [m]."""


@dataclass(frozen=True)
class _Pose:
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    orientation: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True)
class _Primitive:
    type: str | int
    dimensions: tuple[float, ...]


@dataclass(frozen=True)
class _Object:
    id: str = ""
    pose: _Pose = _Pose()
    primitives: tuple[_Primitive, ...] = ()
    primitive_poses: tuple[_Pose, ...] = ()
    meshes: tuple[Any, ...] = ()
    planes: tuple[Any, ...] = ()


@dataclass(frozen=True)
class _World:
    collision_objects: tuple[_Object, ...] = ()
    octomap: Any = None


@dataclass(frozen=True)
class _Attached:
    attached_collision_objects: tuple[Any, ...] = ()


@dataclass(frozen=True)
class _Scene:
    world: _World
    robot_state: _Attached = _Attached()


@dataclass(frozen=True)
class _JointState:
    name: tuple[str, ...]
    position: tuple[float, ...]


@dataclass(frozen=True)
class _State:
    joint_state: _JointState
    attached_collision_objects: tuple[Any, ...] = ()


@dataclass(frozen=True)
class _JointConstraint:
    joint_name: str
    position: float


@dataclass(frozen=True)
class _Goal:
    joint_constraints: tuple[_JointConstraint, ...] = ()
    position_constraints: tuple[Any, ...] = ()
    orientation_constraints: tuple[Any, ...] = ()


@dataclass(frozen=True)
class _Request:
    start_state: _State
    goal_constraints: tuple[_Goal, ...]
    group_name: str = ""
    path_constraints: Mapping[str, Any] = field(default_factory=dict)


def find_problems(folder: Path, robot: str) -> list[ProblemFiles]:
    """Return the problems of a robot, by kind, in the order of their numbers.

    Args:
        folder: Contains the folders KIND_ROBOT.
        robot: The robot's name in them.

    Raises:
        InputError: There is no folder for the robot, or no pair of files in it.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: is not a folder; --problems takes one with KIND_ROBOT folders")
    places = sorted(path for path in folder.iterdir() if path.is_dir() and "_" in path.name)
    ending = f"_{robot}"
    found = [
        ProblemFiles(
            place.name.removesuffix(ending), scene.stem.removeprefix("scene"), scene, request
        )
        for place in places
        if place.name.endswith(ending)
        for scene in sorted(place.glob("scene*.yaml"))
        if (request := place / f"request{scene.name.removeprefix('scene')}").is_file()
    ]
    if not found:
        others = sorted({path.name.rpartition("_")[2] for path in places})
        has = f"; it has folders for {', '.join(others[:10])}" if others else ""
        raise InputError(
            f"{folder}: has no pair sceneNNNN.yaml and requestNNNN.yaml in a folder "
            f"KIND{ending}{has}"
        )
    return found


def spread_problems(files: Sequence[ProblemFiles], limit: int) -> list[ProblemFiles]:
    """Return the first problems of each kind, as many of each, at most `limit`; 0 for all."""
    rank: dict[str, int] = {}
    order = []
    for at, one in enumerate(files):
        rank[one.kind] = rank.get(one.kind, -1) + 1
        order.append((rank[one.kind], at))
    chosen = sorted(order)[: limit or None]
    return [files[at] for at in sorted(at for _, at in chosen)]


def read_problem(files: ProblemFiles) -> ArmProblem:
    """Read a problem.

    Raises:
        FileFormatError: A file is unusable, or holds what momapos cannot plan with, such as a mesh
            or a goal for the tool; one line names the file and the element.
    """
    scene = _read(files.scene, _Scene)
    request = _read(files.request, _Request)
    boxes, cylinder, labels = _shapes(scene, files.scene)
    start, goal = _ends(request, files.request)
    return ArmProblem(boxes, cylinder, labels, request.group_name, start, goal)


def _read(path: Path, kind: type[Record]) -> Record:
    text = read_bytes_bounded(path, MAX_BYTES).decode(errors="replace")
    return from_plain(parse_yaml(text, path), kind, str(path))


def _shapes(scene: _Scene, path: Path) -> tuple[Boxes, Bool[np.ndarray, " b"], tuple[str, ...]]:
    """Return the shapes of a scene as boxes, and which of them stand for a cylinder."""
    if scene.robot_state.attached_collision_objects:
        raise FileFormatError(f"{path}: robot_state: attached objects are not supported")
    if (scene.world.octomap or {}).get("octomap", {}).get("data"):
        raise FileFormatError(f"{path}: world: an octomap is not supported, only box and cylinder")
    T, half, rounds, labels = [], [], [], []
    for item in scene.world.collision_objects:
        where = f"{path}: object {item.id!r:.60}"
        if item.meshes or item.planes:
            raise FileFormatError(f"{where}: meshes and planes are not supported")
        if len(item.primitives) != len(item.primitive_poses):
            raise FileFormatError(f"{where}: primitives and primitive_poses differ in number")
        T_object = _pose(item.pose, where)
        for shape, at in zip(item.primitives, item.primitive_poses, strict=True):
            T.append(T_object @ _pose(at, where))
            half.append(_half(shape, where))
            rounds.append(shape.type in CYLINDER)
            labels.append(item.id)
    if len(labels) > MAX_OBJECTS:
        raise FileFormatError(f"{path}: has {len(labels)} shapes; the limit is {MAX_OBJECTS}")
    Ts = np.array(T).reshape(-1, 4, 4)
    boxes = Boxes(
        np.ascontiguousarray(Ts[:, :3, 3]), np.ascontiguousarray(Ts[:, :3, :3]),
        np.array(half).reshape(-1, 3),
    )  # fmt: skip
    return boxes, np.array(rounds, bool), tuple(labels)


def _half(shape: _Primitive, where: str) -> list[float]:
    """Return half the edges of a box, or of the box around a cylinder."""
    if shape.type not in (*BOX, *CYLINDER):
        raise FileFormatError(
            f"{where}: a primitive of type {shape.type!r:.30} is not supported; use box or cylinder"
        )
    size = np.array(shape.dimensions, float)
    count = 3 if shape.type in BOX else 2
    if size.shape != (count,) or not ((size > 0) & (size < MAX_SIZE)).all():
        raise FileFormatError(
            f"{where}: dimensions of a {'box' if count == 3 else 'cylinder'} must be {count} "
            f"numbers above 0 and below {MAX_SIZE:g} m"
        )
    if count == 3:
        return (size / 2).tolist()
    height, radius = size.tolist()
    return [radius, radius, height / 2]


def _pose(at: _Pose, where: str) -> Float[np.ndarray, "4 4"]:
    from scipy.spatial.transform import Rotation

    numbers = np.array([*at.position, *at.orientation])
    if not (np.abs(numbers) < MAX_SIZE).all():
        raise FileFormatError(f"{where}: a pose has a number that is not below {MAX_SIZE:g}")
    if not 0.9 < np.linalg.norm(numbers[3:]) < 1.1:
        raise FileFormatError(f"{where}: the orientation must be a unit quaternion x, y, z, w")
    return pose(numbers[:3], Rotation.from_quat(numbers[3:]).as_matrix())


def _ends(request: _Request, path: Path) -> tuple[dict[str, float], dict[str, float]]:
    """Return the start and the goal of a request."""
    if request.start_state.attached_collision_objects:
        raise FileFormatError(f"{path}: start_state: attached objects are not supported")
    if any(request.path_constraints.values()):
        raise FileFormatError(f"{path}: path_constraints are not supported")
    if len(request.goal_constraints) != 1:
        raise FileFormatError(f"{path}: goal_constraints must be one set of joint constraints")
    wanted = request.goal_constraints[0]
    others = wanted.position_constraints or wanted.orientation_constraints
    if others or not wanted.joint_constraints:
        raise FileFormatError(f"{path}: goal_constraints: only joint_constraints are supported")
    state = request.start_state.joint_state
    if len(state.name) != len(state.position):
        raise FileFormatError(f"{path}: start_state: name and position differ in length")
    start = dict(zip(state.name, state.position, strict=True))
    goal = {one.joint_name: one.position for one in wanted.joint_constraints}
    if not np.isfinite([*start.values(), *goal.values()]).all():
        raise FileFormatError(f"{path}: a joint value is not finite")
    missing = [name for name in goal if name not in start]
    if missing:
        raise FileFormatError(f"{path}: start_state lacks {', '.join(missing[:5])}, of the goal")
    return start, goal
