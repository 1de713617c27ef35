"""Suites of tasks by name and seed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from momapos.core import unknown_name
from momapos.model.robots import library_names

from .bench_records import SuiteTask

if TYPE_CHECKING:
    from momapos.model.robots import Robot
    from momapos.model.scene import Scene

    from .dining_rooms import Room

Build: TypeAlias = Callable[[int, Sequence[str], Path], list[SuiteTask]]
"""Makes the tasks of a seed and robots; scene files go below the folder that it is given."""
BASELINES = ("habitat", "m3", "reuleaux", "rm4d", "pycram", "behavior", "momagen")
COMPARED = ("ours", "paper", "habitat", "reuleaux")
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
    "ours:place.improve=0",
    "ours:place.miss=0.0",
    "exhaustive",
)
"""Variants of the paper's options T (1: no tours), M, k1 with k1', z, alpha and k0 (alpha 0 models
everything), of its scorer and its arm planner, without its field and without its inverse map; and
of ours: importance, samples, rounds (0: the grid alone), without the grid, without looking for
cheaper poses, and ordered by driving alone."""
SMOKE_TASKS = 16
SIM_TASKS, ROOMS = 500, 10
DISHWASHER = 0.5
"""How far dishwashers are opened [rad]; see `_tasks_of_room`."""


@dataclass(frozen=True)
class SuiteKind:
    """How a suite is made."""

    about: str
    build: Build
    robots: tuple[str, ...]
    methods: tuple[str, ...]
    revision: int = 1
    scannable: bool = True
    """Whether a scan shows what its tasks are about."""


def kitchen_tasks(robots: Sequence[str], seed: int) -> list[SuiteTask]:
    """All doors, drawers, and things that fit the hand, of the built-in kitchens."""
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

    for item, joint in openable(scene):
        kind = "drawer" if slides(scene, make_task(scene, "open", item, joint)) else "door"
        where = f"{robot.name} {kitchen} {item}/{joint}"
        yield SuiteTask(where, kind, kitchen, robot.name, "open", item, joint, seed=seed)
    for thing in scene.objects:
        if can_be_picked(scene, robot, thing.name):
            where = f"{robot.name} {kitchen} {thing.name}"
            yield SuiteTask(where, "pick", kitchen, robot.name, "pick", thing.name, seed=seed)


def can_be_picked(scene: Scene, robot: Robot, name: str) -> bool:
    """Whether a thing is loose, fits the hand of a robot, and has nothing on it."""
    from momapos.core import TaskError
    from momapos.planning import PipelineConfig
    from momapos.planning.grasps import LIFT, make_task, task_motion
    from momapos.verification import PlanVerifier

    try:
        task = make_task(scene, "pick", name)
        config = PipelineConfig().motion
        motion = task_motion(scene, robot, task, config)
        lifted = PlanVerifier(scene, robot, task).blocked(LIFT)
    except TaskError:
        return False
    return not motion.refusal and lifted is None


def _smoke(seed: int, robots: Sequence[str], _: Path) -> list[SuiteTask]:
    """Spread over all tasks, so that doors, drawers and picks of both kitchens are among them."""
    every = kitchen_tasks(robots, seed)
    count = min(SMOKE_TASKS, len(every))
    return [every[k * len(every) // count] for k in range(count)]


def _ablations(seed: int, robots: Sequence[str], _: Path) -> list[SuiteTask]:
    return kitchen_tasks(robots, seed)


def _openings(seed: int, robots: Sequence[str], _: Path) -> list[SuiteTask]:
    return [task for task in kitchen_tasks(robots, seed) if task.verb == "open"]


def _paper_sim(seed: int, robots: Sequence[str], folder: Path) -> list[SuiteTask]:
    """As many tasks of every class as there are, or as make 500, asked of every robot."""
    import numpy as np

    from .dining_rooms import make_room, room_layouts

    by_group: dict[str, list[SuiteTask]] = {}
    for k, layout in enumerate(room_layouts(ROOMS)):
        name = f"scenes/room_{k:02d}.json"
        room = make_room(layout, np.random.default_rng([seed, k]), folder / name)
        for task in _tasks_of_room(room, name, f"{k:02d}"):
            by_group.setdefault(task.group, []).append(task)
    chosen = spread(by_group, SIM_TASKS)
    return [
        replace(task, name=f"{robot} {task.name}", robot=robot, seed=seed)
        for robot in robots
        for task in chosen
    ]


def _tasks_of_room(room: Room, scene: str, number: str) -> Iterator[SuiteTask]:
    """Every thing picked, and every door and drawer opened, by no robot yet.

    A dishwasher stands open where something is taken out of it: its door's handle ends so near the
    floor that no hand brings it there.
    """
    wide = {opening.part: opening.wide for opening in room.openings}
    for thing in room.things:
        task = SuiteTask(
            f"{number} {thing.name} {thing.place}", thing.place, scene, "", "pick", thing.name,
            inside=thing.inside, carried=room.carried(thing.inside),
        )  # fmt: skip
        if thing.inside is not None and thing.place == "in dishwasher":
            box = thing.inside
            task = replace(task, inside=None, joints={box.object: {box.joint: wide[box]}})
        yield task
    for opening in room.openings:
        box = opening.part
        yield SuiteTask(
            f"{number} {opening.kind} {box.object}/{box.joint}", opening.kind, scene, "", "open",
            box.object, box.joint, DISHWASHER if opening.kind == "open dishwasher" else None,
            carried=room.carried(box),
        )  # fmt: skip


def spread(by_group: Mapping[str, Sequence[SuiteTask]], count: int) -> list[SuiteTask]:
    """So many tasks, as evenly from all groups as these allow, and evenly from each; in order."""
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
    from .laboratory import laboratory_tasks

    return laboratory_tasks(seed, robots, folder)


SUITES: dict[str, SuiteKind] = {
    "smoke": SuiteKind("16 tasks of the built-in kitchens", _smoke, ("segway_ur5e",), COMPARED),
    "openings": SuiteKind(
        "all doors and drawers of the built-in kitchens",
        _openings,
        ("segway_ur5e", "husky_ur5e", "fetch"),
        ("ours", "paper", *BASELINES),
    ),
    "paper-sim": SuiteKind(
        "500 tasks with 30 objects in generated kitchens",
        _paper_sim,
        ("fetch", "segway_ur5e", "husky_ur5e"),
        ("ours", "paper", "habitat", "m3", "reuleaux"),
        scannable=False,
    ),
    "paper-real": SuiteKind(
        "the paper's four tasks in 50 layouts of its laboratory",
        _paper_real,
        ("ranger_rm63",),
        ("ours", "paper", "habitat", "m3", "reuleaux"),
    ),
    "ablations": SuiteKind(
        "the tasks of the built-in kitchens by variants of the paper's method, and of ours",
        _ablations,
        ("segway_ur5e",),
        ABLATIONS,
    ),
}


def refuse_unknown(name: str, robots: Sequence[str]) -> None:
    """Refuse a suite that there is not, and robots that are not of the library.

    Robot files are refused too, for rows do not tell apart what is in them.

    Raises:
        UnknownNameError: The message offers the nearest names.
    """
    if name not in SUITES:
        raise unknown_name("suite", name, SUITES, "momapos bench")
    for robot in robots:
        if robot not in library_names():
            raise unknown_name("robot", robot, library_names(), "the library")
