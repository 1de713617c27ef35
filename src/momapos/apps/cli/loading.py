"""Load what commands need: scenes, arms with their maps, plans, tours and runs."""

from __future__ import annotations

import math
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from momapos.core import (
    FileFormatError,
    InputError,
    MomaposError,
    open_regular,
    owner_cache,
    resolved,
    say,
)

if TYPE_CHECKING:
    from momapos.model.records import PlacementPlan
    from momapos.model.robots import Robot
    from momapos.model.scene import Scene
    from momapos.planning.reachability import ArmLength, ReachMap
    from momapos.simulation import RunRecord

T = TypeVar("T")


def print_warnings(warnings: Iterable[str]) -> None:
    """Print warnings on stderr, one per line."""
    for warning in warnings:
        say(f"momapos: {warning}", file=sys.stderr)


def load_scene_with_joints(name: str, joints: Sequence[str]) -> Scene:
    """Load a scene, set its joints and print its warnings.

    Args:
        name: A scene file or a built-in kitchen.
        joints: As OBJECT/JOINT=VALUE.

    Raises:
        MomaposError: The scene is unusable, or has no such joint.
    """
    from momapos.model.scene import load_scene, set_joints

    scene = set_joints(load_scene(name), joints)
    print_warnings(scene.warnings)
    return scene


def load_arms_with_maps(
    robot: str, arm: str
) -> tuple[tuple[Robot, ...], list[ReachMap | ArmLength]]:
    """Load arms of a robot and their reachability maps; build missing maps.

    Args:
        robot: A library robot or a robot file.
        arm: The name of an arm, or any.

    Raises:
        RobotError: The robot is unusable.
    """
    from momapos.model.robots import load_arms
    from momapos.planning.reachability import load_reach

    from .console import progress

    arms = load_arms(robot, arm)
    maps = []
    for one in arms:
        with progress(f"reachability map of {one.title}") as report:
            maps.append(load_reach(one, None, report))
    return arms, maps


FIRST_TIME = 10.0
"""Processor time of the search with each arm before its map is built [s], which takes 20 to 110 s:
of 35 solved openings of fetch and segway_ur5e, 30 take at most 1.4 s without a map, and 4 up to
8 s."""
BEHIND = "MOMAPOS_MAPS_BEHIND"
"""Environment variable; 0 lets commands build no maps behind."""


def plan_before_maps(
    robot: str,
    arm: str,
    plan: Callable[[Sequence[tuple[Robot, ReachMap | ArmLength]], float], T],
    is_solved: Callable[[T], bool],
    *,
    quick: bool = True,
) -> T:
    """Plan with a robot; for a new one first without maps, which take a minute to build.

    If that solves the task, another process builds the maps meanwhile, for later commands.

    Args:
        robot: A library robot or a robot file.
        arm: The name of an arm, or any.
        plan: Plans with arms and their maps, with a limit of processor time for each arm [s].
        is_solved: Whether an answer needs no map any more.
        quick: Whether an answer without maps is of use; it may be farther from the best one.
    """
    from momapos.core import OutOfTimeError, time_left
    from momapos.model.robots import load_arms
    from momapos.planning.reachability import by_arm_length, has_reach, load_reach

    arms = load_arms(robot, arm)
    new = [one for one in arms if not has_reach(one)] if quick else []
    if new:
        ready = [
            (one, by_arm_length(one, "it is being built") if one in new else load_reach(one))
            for one in arms
        ]
        try:
            found = plan(ready, FIRST_TIME)
            if is_solved(found):
                _build_behind(robot, new)
                return found
        except OutOfTimeError:
            if time_left() <= 0.0:
                raise
    return plan(tuple(zip(*load_arms_with_maps(robot, arm), strict=True)), math.inf)


def _build_behind(robot: str, arms: Sequence[Robot]) -> None:
    """Let a process of low priority build the maps of arms, which outlives this one."""
    if os.environ.get(BEHIND) == "0":
        return
    words = [f"--arm={arms[0].arm}"] if len(arms) == 1 and arms[0].arm else []
    with suppress(OSError):
        subprocess.Popen(
            [sys.executable, "-P", "-m", "momapos", "reach", "build", robot, *words],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            start_new_session=True, preexec_fn=partial(os.nice, 10),
        )  # fmt: skip
    print_warnings([
        f"{arms[0].name}: answered without its reachability map, which is being built for later "
        "commands; these answer faster, and may answer differently"
    ])  # fmt: skip


def other_robots(
    robot: str,
) -> Iterator[tuple[str, Callable[[], tuple[Robot, ReachMap | ArmLength]]]]:
    """Yield the other robots of the library, with functions that load each and its map."""
    from momapos.model.robots import library_names, load_arms
    from momapos.planning.reachability import load_reach

    def load(name: str) -> tuple[Robot, ReachMap | ArmLength]:
        one = load_arms(name)[0]
        return one, load_reach(one)

    for name in library_names():
        if name != robot:
            yield name, partial(load, name)


_HEAD = 400
"""Bytes at the beginning of a file that usually hold its format [-]."""
_FORMAT = re.compile(rb'"format"\s*:\s*"(momapos-[a-z]+)"')
MAX_SHARED = 16
"""Kitchens and robots of the package that plans opened by one process share [-]."""


def file_format(path: Path, most: int = 20_000_000) -> str:
    """Return the momapos format of a file by its beginning, or by its member "format".

    Its beginning suffices for a file that is truncated, and for one that is larger than `most`
    [bytes]; "" if the file has none.
    """
    try:
        with open_regular(path) as file:
            found = _FORMAT.search(file.read(_HEAD))
        if found is not None or path.stat().st_size > most:
            return "" if found is None else found[1].decode()
        from momapos.model.plan_files import format_of

        name = format_of(path)
    except (OSError, ValueError, MomaposError):
        return ""
    return name if isinstance(name, str) and name.startswith("momapos-") else ""


def check_plan_file(plan: Path) -> None:
    """Check that a file exists, before anything heavy is imported.

    Raises:
        FileFormatError: The file is missing.
    """
    if not plan.exists():
        raise FileFormatError(f"{plan}: no such plan file")


def plans_of(path: Path, purpose: str) -> list[Path]:
    """Return the plan files of a tour in order, or the plan file itself.

    Args:
        path: A plan or a tour file.
        purpose: What an unsolved tour has nothing for, such as "to execute".

    Raises:
        InputError: The tour is not solved, or a plan file is missing.
    """
    check_plan_file(path)
    from momapos.model.plan_files import is_tour, read_tour

    if not is_tour(path):
        return [path]
    tour = read_tour(path)
    if tour.status not in ("solved", "assumed"):  # whether an assumed plan may be used: open_plan
        raise InputError(f"{path}: the tour is {tour.status!r}; there is nothing {purpose}")
    plans = [path.with_name(step.plan) for step in tour.steps]
    for plan in plans:
        check_plan_file(plan)
    return plans


def numbered(path: Path, count: int, k: int) -> Path:
    """Return the output file of a task: NAME for a single plan, else NAME_1 and so on."""
    return path if count == 1 else path.with_name(f"{path.stem}_{k + 1}{path.suffix}")


def open_plans(
    plans: Sequence[Path], scene_root: Path | None, robot: str | None, purpose: str,
    *, allow_assumed: bool,
) -> list[tuple[PlacementPlan, Scene, Robot]]:  # fmt: skip
    """Read several plans like `open_plan`; plans of one scene share it."""
    read: dict[Path, Scene] = {}
    return [
        open_plan(plan, scene_root, robot, purpose, allow_assumed=allow_assumed, read=read)
        for plan in plans
    ]


def open_plan(
    plan: Path,
    scene_root: Path | None,
    robot: str | None,
    purpose: str,
    *,
    allow_assumed: bool,
    read: dict[Path, Scene] | None = None,
) -> tuple[PlacementPlan, Scene, Robot]:
    """Read a solved plan, its scene as it was planned in, and its robot.

    Args:
        plan: The plan file.
        scene_root: Folder for files that are not next to the plan.
        robot: A library robot or a robot file; None for the robot of the plan.
        purpose: What an unsolved plan has nothing for, such as "to execute".
        allow_assumed: Whether an assumed plan is read, too.
        read: Scenes that were already read, by file; others are added.

    Raises:
        MomaposError: A file is unusable, or the plan is not solved.
    """
    from momapos.model.plan_files import check_unchanged, read_plan
    from momapos.model.scene import as_planned
    from momapos.verification import check_plan_numbers, find_file

    content = read_plan(plan)
    if content.status == "assumed" and not allow_assumed:
        raise InputError(
            f"{plan}: the plan is 'assumed', not solved ({content.assumes}); "
            "momapos run --allow-assumed executes it"
        )
    if not content.feasible:
        raise InputError(f"{plan}: the plan is {content.status!r}; there is nothing {purpose}")
    folders = [resolved(plan).parent, *([scene_root] if scene_root else []), Path()]
    scene_file = find_file("scene", content.scene, folders, plan)
    urdf = find_file("robot.urdf", content.robot_urdf, folders, plan)
    check_unchanged(plan, scene_file, urdf)
    rooms = {} if read is None else read
    if scene_file not in rooms:
        rooms[scene_file] = _scene(scene_file, scene_root)
        print_warnings(rooms[scene_file].warnings)
    scene = as_planned(rooms[scene_file], content)
    machine = _robot(content, plan, urdf, robot)
    check_plan_numbers(content, scene, machine, str(plan))
    return content, scene, machine


def open_run(
    path: Path,
    scene_root: Path | None,
    robot: str | None,
    purpose: str,
    *,
    allow_assumed: bool,
    read: dict[Path, Scene] | None = None,
) -> tuple[RunRecord, PlacementPlan, Scene, Robot]:
    """Read the record of a run, its plan, the true scene and the robot.

    Args:
        path: The record.
        scene_root, robot, purpose, allow_assumed, read: See `open_plan`.

    Raises:
        MomaposError: A file is unusable, or the record has no motion.
    """
    import numpy as np

    from momapos.model.scene import load_scene
    from momapos.simulation import moved, read_run

    record = read_run(path)
    if not record.plan or record.motion is None:
        raise InputError(
            f"{path}: the record has no motion or names no plan; momapos run PLAN --out FILE "
            "writes a complete one"
        )
    plan, scene, machine = open_plan(
        path.parent / record.plan, scene_root, robot, purpose,
        allow_assumed=allow_assumed, read=read,
    )  # fmt: skip
    if record.world:
        nearby = path.parent / record.world
        there = load_scene(nearby if nearby.is_file() else record.world, root=scene_root)
        scene = moved(there, np.array(record.world_at or (0.0, 0.0, 0.0)))
    return record, plan, scene, machine


def _robot(content: PlacementPlan, plan: Path, urdf: Path, given: str | None) -> Robot:
    """Load the robot of a plan, its hand as open as in the plan.

    Raises:
        RobotError: There is no robot file, or it describes another robot.
    """
    from momapos.core import RobotError
    from momapos.model.robots import find_named_robot, library_names

    nearby = urdf.with_suffix(".toml")
    if given is not None:
        found = find_named_robot(given)
        robot = _load_robot(found, content.robot_arm)
    elif content.robot_file is not None:
        try:
            robot = _load_robot(content.robot_file, content.robot_arm)
        except InputError as error:
            raise RobotError(
                f"{plan}: its robot file is unusable: {error}; give --robot"
            ) from error
    elif nearby.is_file():
        robot = _load_robot(nearby, None)
    elif content.robot_name in library_names():
        robot = _load_robot(content.robot_name, None)
    else:
        raise RobotError(f"{plan}: there is no robot file {nearby}; give --robot")
    named = (content.base_link, content.tool_link, content.joints)
    if named != (robot.base_link, robot.tool_link, robot.moved_joints):
        raise RobotError(
            f"{plan}: the plan is for {content.robot_name} with tool {content.tool_link!r} and "
            f"joints {', '.join(content.joints)}; {robot.path} describes another robot"
        )
    return _opened(robot, tuple(sorted(content.robot_rest.items())))


def _scene(path: Path, root: Path | None) -> Scene:
    """Read a scene; a built-in kitchen is read once in a process."""
    from momapos.model.scene import builtin_names, find_scene
    from momapos.verification import read_scene

    name = path.stem
    if root is None and name in builtin_names() and find_scene(name).samefile(path):
        return _kitchen(name)
    return read_scene(path, root)


def _load_robot(source: str | Path, arm: str | None) -> Robot:
    """Load a robot; one of the library is loaded once in a process."""
    from momapos.model.robots import library_names, load_robot

    if source in library_names():
        return _library_robot(str(source), arm)
    return load_robot(source, arm=arm)


# What is computed for a scene or a robot is cached with it. A process that opens many plans would
# collect this for each of them if each had its own, so plans share what comes with the package.


@lru_cache(maxsize=MAX_SHARED)
def _kitchen(name: str) -> Scene:
    from momapos.model.scene import load_scene

    return load_scene(name)


@lru_cache(maxsize=MAX_SHARED)
def _library_robot(name: str, arm: str | None) -> Robot:
    from momapos.model.robots import load_robot

    return load_robot(name, arm=arm)


@owner_cache(MAX_SHARED)
def _opened(robot: Robot, rest: tuple[tuple[str, float], ...]) -> Robot:
    from momapos.model.robots import opened_as

    return opened_as(robot, dict(rest))
