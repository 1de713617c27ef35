"""Plan the arm problems of MotionBenchMaker, and report them by kind of scene."""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from momapos.core import (
    USER_CACHE,
    Clock,
    FileFormatError,
    InputError,
    read_bytes_bounded,
    unknown_name,
    write_atomic,
)
from momapos.model.collision import FREE, arm_spheres, build_motions, build_world, check
from momapos.model.kinematics import build_chain
from momapos.model.robots import library_names, load_robot, read_srdf
from momapos.model.urdf import Articulated, Boxes, Joint, Link, MovingBoxes, read_urdf
from momapos.planning.arm_motion import RESOLUTION, PlannerConfig, plan_with_clearance

from .arm_problems import ArmProblem, ProblemFiles, find_problems, read_problem, spread_problems
from .bench_records import from_plain, to_plain
from .folder import versions
from .markdown_report import Table
from .metrics import percentile
from .suites import ARM_SUITE

if TYPE_CHECKING:
    from momapos.model.collision import CollisionWorld, Spheres, StraightMotions
    from momapos.model.kinematics import Chain

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
    urdf = read_urdf(path, cache=USER_CACHE, visuals=False)
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
