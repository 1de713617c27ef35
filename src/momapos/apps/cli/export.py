"""momapos export: a plan, a tour or a run as other programs take it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tyro.conf import Positional

from momapos.core import InputError, check_outputs

from .options import OptionalPath, OptionalText
from .plan_sources import numbered, open_plan, open_run, plans_of

if TYPE_CHECKING:
    from momapos.model.records import PlacementPlan
    from momapos.model.robots import Robot
    from momapos.model.scene import Scene
    from momapos.simulation import RunRecord

SUFFIXES = {"csv": ".csv", "npz": ".npz", "ros2": "_ros2.json", "mcap": "", "moveit": ".scene"}
"""How the result of each format is called after its plan."""
OF_PLANS = ("ros2", "moveit")
"""Formats that say what is to be done; a run says what was done."""
FRAME = "map"


def export(
    source: Positional[Path],
    /,
    *,
    to: Literal["csv", "npz", "ros2", "mcap", "moveit"],
    out: OptionalPath = None,
    scene_root: OptionalPath = None,
    robot: OptionalText = None,
    frame: str = FRAME,
) -> int:
    """Write a solved plan, or what physics made of it, as other programs take it.

    csv, npz: base, arm and object over time, as a table or as arrays. ros2: goals for Nav2, the
    arm's controller and the gripper, as JSON. mcap: a ROS 2 bag of frames, joints, trajectory and
    room, for Foxglove, RViz and "ros2 bag play". moveit: the room as a planning scene; beside it an
    SRDF of the robot, and what the hand carries as an attached object.

    Of a tour each plan is written, in order: FILE_1, FILE_2 and so on. The record of a run has no
    goals and no planning scene: its plan has.

    Exit status: 0 written, 2 a file cannot be used or written.

    Args:
        source: The file of a plan or a tour, or the record of a run.
        to: The format.
        out: The file, for mcap a folder; by default named after the plan, in the current folder.
        scene_root: Folder for names not found beside the plan, and for a BestMan scene's models.
        robot: A library robot or a robot file; by default the one that the plan names.
        frame: Name of the world's frame in messages.
    """
    if not frame:
        raise InputError("--frame must not be empty")
    paths = plans_of(source, "to export")
    targets = [
        Path(path.stem + SUFFIXES[to]) if out is None else numbered(out, len(paths), k)
        for k, path in enumerate(paths)
    ]
    for target in targets:
        _check(target, to, [source, *paths])
    # All is read before anything is written.
    opened = [_read(path, to, scene_root, robot) for path in paths]
    for content, target in zip(opened, targets, strict=True):
        own = content.robot.srdf
        if own is not None and any(file.resolve() == own.resolve() for file in _beside(target, to)):
            raise InputError(f"{own}: is the robot's own; give another name with --out")
    for content, target in zip(opened, targets, strict=True):
        for path in _write(content, to, frame, target):
            print(path)
    return 0


@dataclass(frozen=True)
class _Content:
    """What is written."""

    plan: PlacementPlan
    scene: Scene
    robot: Robot
    run: RunRecord | None


def _beside(target: Path, to: str) -> list[Path]:
    """All files that may be written for one name."""
    if to != "moveit":
        return [target]
    return [target, target.with_suffix(".srdf"), target.with_name(f"{target.stem}_attached.json")]


def _check(target: Path, to: str, sources: list[Path]) -> None:
    """Refuse a name that cannot be written, before anything heavy is imported.

    Raises:
        InputError: It is the name of a source, exists, or cannot be written.
    """
    for path in sources:
        if target.resolve() == path.resolve():
            raise InputError(f"{target}: is the plan itself; give another name with --out")
    if to == "mcap":
        check_outputs(folders=[target.absolute().parent])
        if target.exists():
            raise InputError(f"{target}: exists already; remove it, or give --out another name")
    else:
        check_outputs(_beside(target, to))
    if to == "moveit" and target.suffix == ".srdf":
        raise InputError(f"{target}: is the name of the robot's file; name the scene's with --out")


def _read(path: Path, to: str, scene_root: Path | None, robot: str | None) -> _Content:
    """Read a plan, or the record of a run with its plan.

    Raises:
        MomaposError: A file cannot be used, or has nothing of that format.
    """
    from momapos.model.plan_files import format_of
    from momapos.simulation import FORMAT

    if format_of(path) != FORMAT:
        return _Content(*open_plan(path, scene_root, robot, "to export"), None)
    record, plan, scene, machine = open_run(path, scene_root, robot, "to export")
    if to in OF_PLANS:
        raise InputError(
            f"{path}: the record of a run has nothing for {to}; export its plan, "
            f"{path.parent / record.plan}"
        )
    return _Content(plan, scene, machine, record)


def _write(content: _Content, to: str, frame: str, target: Path) -> list[Path]:
    """Write one plan or run; return the files."""
    plan, scene, robot = content.plan, content.scene, content.robot
    if to == "moveit":
        return _write_moveit(plan, scene, robot, target)
    from momapos.apps.export import executed, phases_of, planned

    if to == "ros2":
        from momapos.apps.export import write_ros2

        write_ros2(plan, phases_of(plan, robot), robot, frame, target)
        return [target]
    if content.run is not None:
        timeline = executed(content.run, robot)
    else:
        timeline = planned(plan, phases_of(plan, robot), scene, robot)
    if to == "mcap":
        from momapos.apps.export import write_recording

        write_recording(timeline, scene, robot, frame, target)
    else:
        from momapos.apps.export import write_csv, write_npz

        (write_csv if to == "csv" else write_npz)(timeline, target)
    return [target]


def _write_moveit(plan: PlacementPlan, scene: Scene, robot: Robot, target: Path) -> list[Path]:
    """Write the room, the robot's SRDF, and what the hand carries; return the files."""
    import numpy as np

    from momapos.apps.export import is_carried, write_attached, write_scene, write_srdf

    files = _beside(target, "moveit")
    # Until it is let go, what is placed is in the hand and not in the room.
    absent = {plan.task.object} if plan.task.verb == "place" else set()
    write_scene(scene, np.eye(4), target, absent=absent)
    write_srdf(robot, files[1])
    if not is_carried(plan):
        return files[:2]
    write_attached(plan, scene, robot, files[2])
    return files
