"""Build suites of tasks from a name and a seed."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from momapos.core import InputError, unknown_name
from momapos.model.robots import library_names

from .bench_records import DEFAULT_PROTOCOL, Commit, GraspSet, Protocol, SuiteTask

if TYPE_CHECKING:
    from momapos.model.robots import Robot
    from momapos.model.scene import Scene

    from .dining_rooms import DiningRoom

Build: TypeAlias = Callable[..., list[SuiteTask]]
"""Builds the tasks from a seed and robots; scene files go below the given folder. A suite that
needs objects takes the user's folder, too."""
Report: TypeAlias = Callable[[float, str], None]
"""Takes the share that is done, in [0, 1], and the current step."""
BASELINES = ("habitat", "m3", "reuleaux", "rm4d", "pycram", "behavior", "momagen")
COMPARED = ("ours", "paper", "habitat", "reuleaux")
PAPER_METHODS = ("ours", "paper", "habitat", "m3", "reuleaux")
TABLE_METHODS = (
    "ours", "paper", "paper:paper.check_stops=false", "authors", "habitat", "m3", "reuleaux",
)  # fmt: skip
SIM_METHODS = ("ours", "paper", "authors", "habitat", "m3", "reuleaux")
ABLATIONS = (
    "paper",
    *(f"paper:paper.group={T}" for T in (1, 5, 20)),
    *(f"paper:paper.samples={M}" for M in (25, 50, 200)),
    *(f"paper:paper.k_distance={k1},paper.k_potential={1 - k1}" for k1 in (0.0, 0.5, 1.0)),
    *(f"paper:paper.heights={z}" for z in (0.4, 1.0, 1.4)),
    *(f"paper:importance.alpha={alpha}" for alpha in (0.0, 0.25, 0.75, 1.0)),
    *(f"paper:importance.k0={k0}" for k0 in (0.0, 1.0)),
    *(f"paper:importance.scorer={name}" for name in ("reach", "distance", "size", "names")),
    "paper:paper.field=false",
    "paper:paper.inverse_map=false",
    "paper:planner.planner=RRTConnect",
    "ours",
    *(f"ours:importance.alpha={alpha}" for alpha in (0.0, 0.75, 1.0)),
    *(f"ours:place.count={count}" for count in (128, 2048)),
    "ours:place.rounds=0",
    "ours:place.grid=false",
    "ours:place.polish=0",
    "ours:place.miss_cost=0.0",
    "exhaustive",
)
"""Variants of `paper`: its options T (1: no tours), M, k1 with k1', z, alpha (0 models everything)
and k0, its scorer and arm planner, without its field, without its inverse map. Variants of `ours`:
importance, samples, rounds (0: grid only), without the grid, without the search for cheaper poses,
ordered only by driving."""
BASE_USES = ("ours", "ours:base=stops", "ours:base=moving")
"""The base stands; it may also stop several times; it may also move with the part."""
PAPER_PROTOCOL = Protocol("first", "pinch")
"""The paper's conditions: its baselines drive to one base pose, and its gripper closes on what it
moves."""
SMOKE_TASKS = 16
SIM_TASKS, ROOMS = 500, 10
DISHWASHER_ANGLE = 0.5
"""Opening angle of dishwashers [rad]; farther, the handle is too close to the floor."""


@dataclass(frozen=True)
class SuiteKind:
    """Definition of a suite."""

    build: Build
    robots: tuple[str, ...]
    methods: tuple[str, ...]
    revision: int = 1
    scannable: bool = True
    """Whether a scan can show the objects of its tasks."""
    protocols: tuple[Protocol, ...] = ()
    """The protocols of the suite; empty if the user chooses one."""
    needs_objects: bool = False
    """Whether its tasks need a folder of the user with objects."""
    rooms: bool = False
    """Whether its scenes are rooms of `dining_rooms`, each drawn when a task needs it."""


def kitchen_tasks(robots: Sequence[str], seed: int) -> list[SuiteTask]:
    """Return tasks for all doors, drawers and graspable objects of the built-in kitchens."""
    from momapos.model.robots import load_robot
    from momapos.model.scene import builtin_names, load_scene

    return [
        task
        for name in robots
        for robot in [load_robot(name)]
        for kitchen in builtin_names()
        for task in _tasks_in(kitchen, load_scene(kitchen), robot, seed)
    ]


def _tasks_in(kitchen: str, scene: Scene, robot: Robot, seed: int) -> Iterator[SuiteTask]:
    from momapos.planning.grasps import make_task, openable, slides

    for name, joint in openable(scene):
        kind = "drawer" if slides(scene, make_task(scene, "open", name, joint)) else "door"
        where = f"{robot.name} {kitchen} {name}/{joint}"
        yield SuiteTask(where, kind, kitchen, robot.name, "open", name, joint, seed=seed)
    for item in scene.objects:
        if can_be_picked(scene, robot, item.name):
            where = f"{robot.name} {kitchen} {item.name}"
            yield SuiteTask(where, "pick", kitchen, robot.name, "pick", item.name, seed=seed)


def can_be_picked(scene: Scene, robot: Robot, name: str) -> bool:
    """Check that an object is movable, fits the hand of a robot, and has nothing on it."""
    from momapos.core import TaskError
    from momapos.planning import PipelineConfig
    from momapos.planning.grasps import LIFT_HEIGHT, make_task, task_motion
    from momapos.verification import PlanVerifier

    try:
        task = make_task(scene, "pick", name)
        config = PipelineConfig().motion
        motion = task_motion(scene, robot, task, config)
        lifted = PlanVerifier(scene, robot, task).blocked(LIFT_HEIGHT)
    except TaskError:
        return False
    return not motion.refusal and lifted is None


def _smoke(seed: int, robots: Sequence[str], _: Path) -> list[SuiteTask]:
    """Select evenly, to include doors, drawers and picks of both kitchens."""
    tasks = kitchen_tasks(robots, seed)
    count = min(SMOKE_TASKS, len(tasks))
    return [tasks[k * len(tasks) // count] for k in range(count)]


def _openings(seed: int, robots: Sequence[str], _: Path) -> list[SuiteTask]:
    return [task for task in kitchen_tasks(robots, seed) if task.verb == "open"]


def _paper_sim(seed: int, robots: Sequence[str], _: Path) -> list[SuiteTask]:
    """Spread the tasks evenly over the classes; all robots get the same."""
    from .dining_rooms import known_room

    by_group: dict[str, list[SuiteTask]] = {}
    for k, scene in enumerate(_room_scenes()):
        for task in _tasks_of_room(known_room(seed, k), scene, f"{k:02d}"):
            by_group.setdefault(task.group, []).append(task)
    chosen = spread(by_group, SIM_TASKS)
    return [
        replace(task, name=f"{robot} {task.name}", robot=robot, seed=seed)
        for robot in robots
        for task in chosen
    ]


def _room_scenes() -> list[str]:
    from .dining_rooms import room_name

    return [f"scenes/{room_name(k)}" for k in range(ROOMS)]


def room_digests(seed: int, report: Report) -> dict[str, str]:
    """Return the content hashes of all rooms; draw those that the package does not store.

    An interrupted call is resumed.
    """
    from .dining_rooms import known_room

    digests = {}
    for k, scene in enumerate(_room_scenes()):
        report(k / ROOMS, f"room {k + 1} of {ROOMS}")
        digests[scene] = known_room(seed, k).digest
    return digests


def write_rooms(seed: int, scenes: Collection[str], folder: Path, report: Report) -> None:
    """Write those rooms of tasks that a folder lacks; draw what the cache lacks.

    An interrupted call is resumed.
    """
    from .dining_rooms import copy_room

    left = [
        (k, scene)
        for k, scene in enumerate(_room_scenes())
        if scene in scenes and not (folder / scene).exists()
    ]
    for done, (k, scene) in enumerate(left):
        report(done / len(left), f"room {done + 1} of {len(left)}")
        copy_room(seed, k, (folder / scene).parent)


def _tasks_of_room(room: DiningRoom, scene: str, number: str) -> Iterator[SuiteTask]:
    """Yield a pick of every object and an opening of every door and drawer, without a robot.

    For picks, dishwashers are already wide open: the handle then is too close to the floor for a
    hand to open them that far.
    """
    wide = {part.container: part.wide for part in room.parts}
    for item in room.objects:
        task = SuiteTask(
            f"{number} {item.name} {item.place}", item.place, scene, "", "pick", item.name,
            inside=item.inside, carried=room.carried(item.inside),
        )  # fmt: skip
        if item.inside is not None and item.place == "in dishwasher":
            box = item.inside
            task = replace(task, inside=None, joints={box.object: {box.joint: wide[box]}})
        yield task
    for part in room.parts:
        box = part.container
        yield SuiteTask(
            f"{number} {part.kind} {box.object}/{box.joint}", part.kind, scene, "", "open",
            box.object, box.joint, DISHWASHER_ANGLE if part.kind == "open dishwasher" else None,
            carried=room.carried(box),
        )  # fmt: skip


def spread(by_group: Mapping[str, Sequence[SuiteTask]], count: int) -> list[SuiteTask]:
    """Select `count` tasks, as evenly as possible from all groups, and evenly within each."""
    share, left = {}, count
    smallest_first = sorted(by_group, key=lambda group: len(by_group[group]))
    for k, group in enumerate(smallest_first):
        share[group] = min(len(by_group[group]), left // (len(by_group) - k))
        left -= share[group]
    return [
        tasks[i * len(tasks) // share[group]]
        for group, tasks in by_group.items()
        for i in range(share[group])
    ]


def _paper_real(seed: int, robots: Sequence[str], folder: Path) -> list[SuiteTask]:
    from .paper_rooms import laboratory_tasks

    return laboratory_tasks(seed, robots, folder)


def _authors_sim(seed: int, robots: Sequence[str], folder: Path) -> list[SuiteTask]:
    from .paper_rooms import simulation_tasks

    return simulation_tasks(seed, robots, folder)


def _articulated(seed: int, robots: Sequence[str], folder: Path, objects: Path) -> list[SuiteTask]:
    from .articulated import articulated_tasks

    return articulated_tasks(seed, robots, folder, objects)


ARM_SUITE = "motionbenchmaker"
"""The suite of arm motions, see `arm_suite`; all others are of base placement."""
SUITES = {
    "smoke": SuiteKind(_smoke, ("segway_ur5e",), COMPARED),
    "openings": SuiteKind(
        _openings, ("segway_ur5e", "husky_ur5e", "fetch"), ("ours", "paper", *BASELINES)
    ),
    "paper-sim": SuiteKind(
        _paper_sim, ("fetch", "segway_ur5e", "husky_ur5e"), PAPER_METHODS, 2, scannable=False,
        rooms=True,
    ),
    "paper-real": SuiteKind(_paper_real, ("ranger_rm63",), PAPER_METHODS),
    "paper-table": SuiteKind(
        _paper_real, ("ranger_rm63",), TABLE_METHODS, scannable=False,
        protocols=(PAPER_PROTOCOL, DEFAULT_PROTOCOL),
    ),
    "authors-sim": SuiteKind(
        _authors_sim, ("segway_ur5e",), SIM_METHODS, scannable=False,
        protocols=(PAPER_PROTOCOL, DEFAULT_PROTOCOL),
    ),
    "ablations": SuiteKind(
        lambda seed, robots, _: kitchen_tasks(robots, seed), ("segway_ur5e",), ABLATIONS,
        protocols=(DEFAULT_PROTOCOL,),
    ),
    "articulated": SuiteKind(
        _articulated, ("ranger_rm63", "tiago"), BASE_USES, scannable=False,
        protocols=(DEFAULT_PROTOCOL,), needs_objects=True,
    ),
}  # fmt: skip


def refuse_unknown(name: str, robots: Sequence[str]) -> None:
    """Refuse a suite that there is not, and robots that are not of the library.

    Robot files are refused too, because rows don't record their content.

    Raises:
        UnknownNameError: The message offers the nearest names.
    """
    if name not in SUITES:
        raise unknown_name("suite", name, (*SUITES, ARM_SUITE), "momapos bench")
    for robot in robots:
        if robot not in library_names():
            raise unknown_name("robot", robot, library_names(), "the library")


def protocols_of(
    name: str, commit: Commit | None = None, grasps: GraspSet | None = None
) -> tuple[Protocol, ...]:
    """Return the protocols of a run.

    Args:
        name: A suite.
        commit, grasps: The user's choice; None for the default.

    Raises:
        InputError: The suite has its own protocols.
    """
    own = SUITES[name].protocols
    if not own:
        default = DEFAULT_PROTOCOL
        return (Protocol(commit or default.commit, grasps or default.grasps),)
    if commit or grasps:
        others = ", ".join(other for other, kind in SUITES.items() if not kind.protocols)
        words = "; ".join(map(str, own))
        raise InputError(
            f"--commit and --grasps: {name} has its own protocols ({words}); use {others}"
        )
    return own
