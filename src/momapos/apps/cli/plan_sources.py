"""What a plan file names: its scene and its robot; of a tour its plans, of a run its plan."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from momapos.core import FileFormatError, InputError

from .loading import tell

if TYPE_CHECKING:
    from momapos.model.records import PlacementPlan
    from momapos.model.robots import Robot
    from momapos.model.scene import Scene
    from momapos.simulation import RunRecord


def check_plan_file(plan: Path) -> None:
    """Make sure that there is a file, before anything heavy is imported.

    Raises:
        FileFormatError: There is none.
    """
    if not plan.exists():
        raise FileFormatError(f"{plan}: no such plan file")


def plans_of(path: Path, purpose: str) -> list[Path]:
    """The plan files that a file stands for: those of a tour in order, else itself.

    Args:
        path: The file of a plan or of a tour.
        purpose: What there is nothing for where the tour is not solved, such as "to execute".

    Raises:
        InputError: The tour is not solved, or names a file that does not exist.
    """
    check_plan_file(path)
    from momapos.model.plan_files import is_tour, read_tour

    if not is_tour(path):
        return [path]
    tour = read_tour(path)
    if tour.status != "solved":
        raise InputError(f"{path}: the tour is {tour.status!r}: there is nothing {purpose}")
    plans = [path.with_name(step.plan) for step in tour.steps]
    for plan in plans:
        check_plan_file(plan)
    return plans


def numbered(path: Path, count: int, k: int) -> Path:
    """Where the output of a task goes: NAME itself of a plan, NAME_1 and so on of a tour."""
    return path if count == 1 else path.with_name(f"{path.stem}_{k + 1}{path.suffix}")


def open_plans(
    plans: Sequence[Path], scene_root: Path | None, robot: str | None, purpose: str
) -> list[tuple[PlacementPlan, Scene, Robot]]:
    """Read several plans as `open_plan` does; what their rooms share is the same in all."""
    read: dict[Path, Scene] = {}
    return [open_plan(plan, scene_root, robot, purpose, read=read) for plan in plans]


def open_plan(
    plan: Path,
    scene_root: Path | None,
    robot: str | None,
    purpose: str,
    *,
    read: dict[Path, Scene] | None = None,
) -> tuple[PlacementPlan, Scene, Robot]:
    """Read a solved plan, its scene as the plan left it, and its robot.

    Args:
        plan: The plan file.
        scene_root: Folder for names not found beside the plan.
        robot: A library robot or a robot file; None for the one that the plan names.
        purpose: What there is nothing for where the plan is not solved, such as "to execute".
        read: Scenes that were read already, by their file; others are added.

    Raises:
        MomaposError: A file cannot be used, or the plan is not solved.
    """
    from momapos.core import user_cache
    from momapos.model.plan_files import check_unchanged, read_plan
    from momapos.model.scene import as_planned
    from momapos.verification import find_file, read_scene

    content = read_plan(plan)
    if content.status != "solved":
        raise InputError(f"{plan}: the plan is {content.status!r}: there is nothing {purpose}")
    folders = [plan.resolve().parent, *([scene_root] if scene_root else []), Path()]
    scene_file = find_file("scene", content.scene, folders, plan)
    urdf = find_file("robot.urdf", content.robot_urdf, folders, plan)
    check_unchanged(plan, scene_file, urdf)
    rooms = {} if read is None else read
    if scene_file not in rooms:
        rooms[scene_file] = read_scene(scene_file, scene_root, cache=user_cache())
        tell(rooms[scene_file].warnings)
    scene = as_planned(rooms[scene_file], content)
    return content, scene, _robot(content, plan, urdf, robot)


def open_run(
    path: Path, scene_root: Path | None, robot: str | None, purpose: str
) -> tuple[RunRecord, PlacementPlan, Scene, Robot]:
    """Read the record of a run, its plan, what was really there, and its robot.

    Args:
        path: The record.
        scene_root, robot, purpose: See `open_plan`.

    Raises:
        MomaposError: A file cannot be used, or the record does not say what moved.
    """
    import numpy as np

    from momapos.core import user_cache
    from momapos.model.scene import load_scene
    from momapos.simulation import moved, read_run

    record = read_run(path)
    if not record.plan or record.motion is None:
        raise InputError(
            f"{path}: the record does not say what moved, or of which plan; momapos run PLAN "
            "--out FILE writes one that does"
        )
    plan, scene, machine = open_plan(path.parent / record.plan, scene_root, robot, purpose)
    if record.world:
        beside = path.parent / record.world
        there = load_scene(
            beside if beside.is_file() else record.world, root=scene_root, cache=user_cache()
        )
        scene = moved(there, np.array(record.world_at or (0.0, 0.0, 0.0)))
    return record, plan, scene, machine


def _robot(content: PlacementPlan, plan: Path, urdf: Path, given: str | None) -> Robot:
    """The robot file that goes with the URDF of a plan.

    Raises:
        RobotError: There is none, or it describes another robot.
    """
    from momapos.core import RobotError, user_cache
    from momapos.model.robots import find_named_robot, library_names, load_robot

    beside = urdf.with_suffix(".toml")
    if given is not None:
        found = find_named_robot(given)
        robot = load_robot(found, arm=content.robot_arm, cache=user_cache())
    elif content.robot_file is not None:
        try:
            robot = load_robot(content.robot_file, arm=content.robot_arm, cache=user_cache())
        except InputError as error:
            raise RobotError(
                f"{plan}: its robot file cannot be used: {error}; give --robot"
            ) from error
    elif beside.is_file():
        robot = load_robot(beside, cache=user_cache())
    elif content.robot_name in library_names():
        robot = load_robot(content.robot_name, cache=user_cache())
    else:
        raise RobotError(f"{plan}: there is no robot file {beside}; give --robot")
    named = (content.base_link, content.tool_link, content.joints)
    if named != (robot.base_link, robot.tool_link, robot.moved_joints):
        raise RobotError(
            f"{plan}: the plan is for {content.robot_name} with tool {content.tool_link!r} and "
            f"joints {', '.join(content.joints)}; {robot.path} describes another robot"
        )
    return robot
