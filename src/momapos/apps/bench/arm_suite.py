"""Read and plan arm problems in the format of MotionBenchMaker, and report them.

A problem is a pair `sceneNNNN.yaml` and `requestNNNN.yaml` in a folder KIND_ROBOT, as in
MotionBenchMaker (Chamzas et al., RA-L 2022). Files are not trusted.
"""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import numpy as np

from momapos.core import (
    USER_CACHE,
    Clock,
    FileFormatError,
    InputError,
    parse_yaml,
    read_bytes_bounded,
    unknown_name,
    write_atomic,
)
from momapos.core.geometry import pose
from momapos.model.collision import FREE, arm_spheres, build_motions, build_world, check
from momapos.model.kinematics import build_chain
from momapos.model.robots import library_names, load_robot, read_srdf
from momapos.model.urdf import (
    Articulated,
    Boxes,
    Joint,
    Link,
    MovingBoxes,
    in_convex_pieces,
    read_urdf,
)
from momapos.planning.arm_motion import RESOLUTION, PlannerConfig, plan_with_clearance

from .bench_records import from_plain, to_plain
from .folder import versions
from .metrics import Table, percentile
from .suites import ARM_SUITE

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

    from momapos.model.collision import CollisionWorld, Spheres, StraightMotions
    from momapos.model.kinematics import Chain


MAX_PROBLEM_BYTES = 2_000_000
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
    text = read_bytes_bounded(path, MAX_PROBLEM_BYTES).decode(errors="replace")
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


ARM_FILE = "arm_problems.json"
FORMAT, VERSION = "momapos-arm-problems", 1
MAX_BYTES = 100_000_000
PLANNERS = ("ours", "RRTConnect")
CHECKS = 100_000
"""Motions that our search may check in one problem, 2.5 times as many as in `place`: of the Fetch's
202 valid problems 1 to 30 it then solves 193 instead of 184. VAMP takes up to a million [-]."""
STAND, STAND_HEIGHT = "stand_of_the_benchmark", 2.0
"""Link under an arm given as a URDF, and its height [m]: these problems have no floor."""
MAX_REASONS = 15
"""Lines in a table of reasons [-]."""
LIMIT_SLACK = 1e-3
"""How far an end may be beyond a joint limit [rad] or [m]."""
Result = Literal["solved", "unsolved", "invalid ends", "refused"]
"""unsolved: the search spent its checks; invalid ends: an end collides or is beyond a limit;
refused: a file that momapos can't plan with."""


@dataclass(frozen=True)
class ArmRow:
    """Result of one problem."""

    robot: str
    planner: str
    kind: str
    problem: str
    result: Result
    reason: str = ""
    """Why it was not planned; "" otherwise."""
    seconds: float | None = None
    """Processor time of the search, from the ends to the shortened path [s]."""
    length: float | None = None
    """Length of the path in joint space [rad]; prismatic joints count in meters."""


@dataclass(frozen=True)
class ArmResults:
    """Contents of the results file."""

    format: str
    version: int
    problems: str
    """Folder of the problems."""
    seed: int
    checks: int
    versions: Mapping[str, str]
    rows: tuple[ArmRow, ...]


@dataclass(frozen=True, eq=False)
class _Arm:
    chain: Chain
    spheres: Spheres
    lift: float
    """Height at which the arm stands [m]."""


def check_arm_suite(robots: Sequence[str], planners: Sequence[str]) -> None:
    """Refuse unknown planners and robots that are neither in the library nor a file.

    Raises:
        UnknownNameError: The message offers the nearest names.
        InputError: A file does not exist.
    """
    for planner in planners:
        if planner not in PLANNERS:
            raise unknown_name("arm planner", planner, PLANNERS, ARM_SUITE)
    for robot in robots:
        if robot not in library_names():
            if Path(robot).suffix not in (".toml", ".urdf"):
                raise unknown_name("robot", robot, library_names(), "the library (or give a file)")
            if not Path(robot).is_file():
                raise InputError(f"--robots: there is no file {robot}")


def run_arm_suite(
    problems: Path, robots: Sequence[str], planners: Sequence[str], *, limit: int = 0,
    seed: int = 0, on_row: Callable[[int, int], None] | None = None,
    clock: Clock = time.process_time,
) -> ArmResults:  # fmt: skip
    """Plan problems of several robots with several planners.

    Args:
        problems: Folder with the folders KIND_ROBOT, see `find_problems`.
        robots: Library robots, robot files, or URDFs of arms; the name of the file is ROBOT.
        planners: Of `PLANNERS`.
        limit: Number of problems of each robot, as many of each kind; 0 for all.
        seed: Seed of the planners.
        on_row: Called with the number of results so far and in all.
        clock: Measures the search.

    Raises:
        InputError: There are no problems for a robot, or every one of them is refused.
    """
    files = [spread_problems(find_problems(problems, Path(robot).stem), limit) for robot in robots]
    rows: list[ArmRow] = []
    count = len(planners) * sum(map(len, files))
    for robot, mine in zip(robots, files, strict=True):
        arms, begin = _Arms(robot), len(rows)
        for planner in planners:
            _row(arms, mine[0], planner, seed, clock)  # loads the compiled code
            for one in mine:
                rows.append(_row(arms, one, planner, seed, clock))
                if on_row is not None:
                    on_row(len(rows), count)
        if all(row.result == "refused" for row in rows[begin:]):
            raise InputError(
                f"no problem of {arms.name} is usable; the first: {rows[begin].reason}"
            )
    return ArmResults(FORMAT, VERSION, str(problems), seed, CHECKS, versions(), tuple(rows))


class _Arms:
    """The arms of a robot: of its robot file, or of a URDF by the joints that a problem moves."""

    def __init__(self, robot: str) -> None:
        self.name, path = Path(robot).stem, Path(robot)
        self.by_joints: dict[frozenset[str], _Arm] = {}
        self.urdf = path if path.suffix == ".urdf" else None
        if self.urdf is None:
            found = load_robot(robot)
            arm = _Arm(found.chain, found.spheres.by_hulls, 0.0)
            self.by_joints[frozenset(found.chain.names)] = arm

    def arm_for(self, problem: ArmProblem) -> _Arm:
        """Return the arm of the joints that a problem moves.

        Raises:
            InputError: The robot lacks some of them, or they are not all of its arm's.
        """
        wanted = frozenset(problem.goal)
        if wanted not in self.by_joints:
            if self.urdf is None:
                (own,) = self.by_joints
                raise InputError(_other_group(self.name, problem, own))
            self.by_joints[wanted] = _arm_of_urdf(self.urdf, problem)
        return self.by_joints[wanted]


def _other_group(name: str, problem: ArmProblem, own: frozenset[str]) -> str:
    wanted = set(problem.goal)
    odd = sorted(wanted - own)
    words = f"{name}'s arm has no {', '.join(odd)}"
    if not odd:
        words = f"{name}'s arm also has {', '.join(sorted(own - wanted))}"
    return f"the request is for another joint group, {problem.group!r:.60}: {words}"


def _arm_of_urdf(path: Path, problem: ArmProblem) -> _Arm:
    """Return the arm of a URDF on a stand, with its other joints as at the start of a problem."""
    urdf = in_convex_pieces(read_urdf(path, cache=USER_CACHE, visuals=False), USER_CACHE)
    movable = {joint.name: joint for joint in urdf.joints if joint.movable}
    lacking = sorted(set(problem.goal) - set(movable))
    if lacking:
        raise InputError(f"{path.name} has no movable joint {', '.join(lacking)}")
    names = [name for name in movable if name in problem.goal]
    up = np.eye(4)
    up[2, 3] = STAND_HEIGHT
    stand = Joint(STAND, "fixed", STAND, urdf.root, up, np.array([0.0, 0.0, 1.0]), 0.0, 0.0, np.inf)
    raised = replace(
        urdf, root=STAND, links={STAND: Link(STAND, (), ()), **urdf.links},
        joints=(stand, *urdf.joints),
    )  # fmt: skip
    held = {
        name: value
        for name, value in problem.start.items()
        if name in movable and name not in names and movable[name].mimic is None
    }
    model = Articulated(raised, held, USER_CACHE)
    chain, segments = build_chain(model, STAND, movable[names[-1]].child, names)
    disabled = read_srdf(path.with_suffix(".srdf"))
    spheres = arm_spheres(model, chain, segments, disabled, [])
    return _Arm(chain, spheres.by_hulls, STAND_HEIGHT)


def _row(arms: _Arms, files: ProblemFiles, planner: str, seed: int, clock: Clock) -> ArmRow:
    """Plan one problem."""
    row = ArmRow(arms.name, planner, files.kind, files.number, "refused")
    try:
        problem = read_problem(files)
        arm = arms.arm_for(problem)
    except (FileFormatError, InputError) as error:
        return replace(row, reason=str(error))
    world = _world(arm, problem)
    motions = partial(
        build_motions, world, arm.chain, arm.spheres, np.zeros(3), value=0, holding=False,
        step=RESOLUTION,
    )  # fmt: skip
    start, goal = (
        np.array([values[name] for name in arm.chain.names])
        for values in (problem.start, problem.goal)
    )
    for end, q in (("start", start), ("goal", goal)):
        wrong = _wrong_end(arm, world, motions(fine=True), q)
        if wrong:
            return replace(row, result="invalid ends", reason=f"{end} {wrong}")
    ours = planner == "ours"
    config = PlannerConfig(checks=CHECKS) if ours else PlannerConfig(planner="RRTConnect")
    begin = clock()
    path = plan_with_clearance(
        start, goal, arm.chain.lower, arm.chain.upper, motions, config=config, seed=seed
    )
    spent = clock() - begin
    if path is None:
        return replace(row, result="unsolved", seconds=spent)
    length = float(np.linalg.norm(np.diff(path.corners, axis=0), axis=1).sum())
    return replace(row, result="solved", seconds=spent, length=length)


def _world(arm: _Arm, problem: ArmProblem) -> CollisionWorld:
    """Return the obstacles of a problem."""
    nothing = MovingBoxes(np.zeros((1, 0, 3)), np.zeros((1, 0, 3, 3)), np.zeros((1, 0, 3)))
    boxes = problem.boxes
    boxes = Boxes(boxes.center + np.array([0.0, 0.0, arm.lift]), boxes.rotation, boxes.half)
    return build_world(
        boxes, nothing, np.zeros(0, bool), problem.labels, arm.spheres, clearance=0.0,
        cylinder=problem.cylinder,
    )  # fmt: skip


def _wrong_end(arm: _Arm, world: CollisionWorld, free: StraightMotions, q: np.ndarray) -> str:
    """Return what is wrong with an end of the motion; "" if nothing is."""
    chain = arm.chain
    beyond = np.maximum(chain.lower - q, q - chain.upper)
    if (beyond > LIMIT_SLACK).any():
        return f"is beyond the limit of {chain.names[int(beyond.argmax())]}"
    if free(q, q):
        return ""
    none = np.zeros(1, np.int64)
    codes = check(world, chain, arm.spheres, q[None], np.zeros((1, 3)), none, none > 0)
    return "touches " + ("an obstacle" if codes[0] == FREE else world.reason(int(codes[0])))


# ------------------------------------------------------------------------------------- results


def write_arm_results(found: ArmResults, out: Path) -> None:
    """Write the results file of a folder; it replaces an earlier one."""
    write_atomic(out / ARM_FILE, json.dumps(to_plain(found)).encode())


def read_arm_results(folder: Path) -> ArmResults:
    """Read the results file of a folder.

    Raises:
        FileFormatError: It is damaged, or of another version.
    """
    path = folder / ARM_FILE
    try:
        data = json.loads(read_bytes_bounded(path, MAX_BYTES))
    except (ValueError, RecursionError) as error:
        raise FileFormatError(f"{path}: damaged JSON ({error})") from error
    found = from_plain(data, ArmResults, str(path))
    if (found.format, found.version) != (FORMAT, VERSION):
        raise FileFormatError(
            f'{path}: "format" must be {FORMAT!r} and "version" {VERSION}, not '
            f"{found.format!r:.60} and {found.version}"
        )
    return found


def arm_heading(found: ArmResults) -> list[str]:
    """Return the title of a report, and its conditions."""
    made = ", ".join(f"{name} {version}" for name, version in found.versions.items())
    return [
        f"momapos bench: {ARM_SUITE}",
        f"Problems of {found.problems}; seed {found.seed}. Ours checks up to {found.checks:,} "
        "motions: first with 5 mm of clearance by spheres, then with hulls; without a floor for "
        "an arm given as a URDF. Time: processor time from the ends to the shortened path, of the "
        "solved problems.",
        f"Created with {made}.",
    ]


def arm_tables(found: ArmResults) -> list[Table]:
    """Return a table by kind for each robot and planner, and the problems without valid ends."""
    runs: dict[tuple[str, str], list[ArmRow]] = {}
    for row in found.rows:
        runs.setdefault((row.robot, row.planner), []).append(row)
    tables = []
    for (robot, planner), rows in runs.items():
        kinds = dict.fromkeys(row.kind for row in rows)
        lines = [_line(kind, [row for row in rows if row.kind == kind]) for kind in kinds]
        columns = (
            "scenes", "problems", "both ends valid", "solved", "time, median", "95th percentile",
            "path, median",
        )  # fmt: skip
        tables.append(Table(f"{robot}, {planner}", columns, (*lines, _line("all", rows))))
        reasons = Counter((row.result, row.reason) for row in rows if row.reason)
        if reasons:
            told = tuple(
                (result, reason, str(count))
                for (result, reason), count in reasons.most_common(MAX_REASONS)
            )
            more = sum(reasons.values()) - sum(n for _, n in reasons.most_common(MAX_REASONS))
            note = f"{more} more for other reasons." if more else ""
            title = f"{robot}, {planner}: not planned"
            tables.append(Table(title, ("result", "reason", "problems"), told, note))
    return tables


def _line(name: str, rows: Sequence[ArmRow]) -> tuple[str, ...]:
    solved = [row for row in rows if row.result == "solved"]
    valid = len(solved) + sum(row.result == "unsolved" for row in rows)
    times = [1e3 * (row.seconds or 0.0) for row in solved]
    median, late = percentile(times, 50), percentile(times, 95)
    length = percentile([row.length or 0.0 for row in solved], 50)
    return (
        name.replace("_", " "), str(len(rows)), str(valid), str(len(solved)),
        _number(median, "ms", 2), _number(late, "ms", 1), _number(length, "rad", 1),
    )  # fmt: skip


def _number(value: float | None, unit: str, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f} {unit}"


def arm_outcomes(found: ArmResults) -> Iterator[tuple[str, dict[str, int]]]:
    """Yield the number of problems by result, for each robot and planner."""
    runs = dict.fromkeys((row.robot, row.planner) for row in found.rows)
    for run in runs:
        counts = Counter(row.result for row in found.rows if (row.robot, row.planner) == run)
        yield ", ".join(run), {str(result): count for result, count in counts.items()}
