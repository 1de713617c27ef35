"""momapos export: write plans, tours, runs and sets of episodes for other programs."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from momapos.core import InputError, MomaposError, check_outputs, resolved, say, temporary_folder

from .loading import file_format, numbered, open_plan, open_run, plans_of, print_warnings
from .options import OptionalFile, OptionalFolder, OptionalRobot, PlanArg

if TYPE_CHECKING:
    from momapos.apps.export import Camera, Episode
    from momapos.model.records import PlacementPlan
    from momapos.model.robots import Robot
    from momapos.model.scene import Scene
    from momapos.simulation import RunRecord


SETS = {"lerobot": "_lerobot", "hdf5": ".hdf5"}
"""Ending of the name of each kind of set."""
MAX_SIZE = 2048
"""Largest width and height of an image [px]."""
MAX_RUNS = 1_000_000


def export_episodes(
    source: Path, to: str, out: Path | None, scene_root: Path | None, robot: str | None,
    cameras: str, size: str,
) -> None:  # fmt: skip
    """Write the runs of a record or of a folder of records as one set.

    Raises:
        MomaposError: A file is unusable, or the set cannot be written; then nothing is written.
    """
    chosen, pixels = _cameras(cameras), _size(size)
    runs = _runs(source)
    target = Path(resolved(source).stem + SETS[to]) if out is None else out
    if target.exists() or target.is_symlink():
        raise InputError(f"{target}: exists already; remove it, or choose another name with --out")
    check_outputs(folders=[target.absolute().parent])
    from momapos.apps.export import write_hdf5, write_lerobot

    from .console import progress

    rooms: dict[Path, Scene] = {}
    without_arm = 0
    with progress(f"{len(runs)} runs") as report:

        def episodes() -> Iterator[tuple[str, Episode]]:
            nonlocal without_arm
            for done, run in enumerate(runs):
                episode = _episode(run, scene_root, robot, chosen, pixels, rooms)
                if episode is not None:
                    yield str(run), episode
                else:
                    without_arm += 1
                report((done + 1) / len(runs))
            if without_arm == len(runs):
                raise InputError(f"{source}: no run came so far that the arm moved")

        target.parent.mkdir(parents=True, exist_ok=True)
        with temporary_folder(target.absolute().parent, target.name) as folder:
            draft = folder / "set"
            if to == "lerobot":
                count = write_lerobot(episodes(), draft)
            else:
                count = write_hdf5(episodes(), draft)
            draft.rename(target)
    if without_arm:
        ended = f"{source}: {without_arm} of {len(runs)} runs ended before the arm moved"
        print_warnings([f"{ended}; they are left out"])
    say(f"{target}: {count} episodes")


def _episode(
    run: Path, scene_root: Path | None, robot: str | None, cameras: tuple[Camera, ...],
    size: tuple[int, int], rooms: dict[Path, Scene],
) -> Episode | None:  # fmt: skip
    """Return a run as an episode; None if it ended before the arm moved."""
    from momapos.apps.export import episode_of

    record, _, scene, machine = open_run(
        run, scene_root, robot, "to export", allow_assumed=True, read=rooms
    )
    if record.motion is not None and record.motion.times and not record.motion.joints:
        return None
    try:
        return episode_of(record, scene, machine, cameras, size)
    except MomaposError as error:
        raise InputError(f"{run}: {error}") from error


def _runs(source: Path) -> list[Path]:
    """Return the run records that a name stands for, in order.

    Raises:
        InputError: There are none.
    """
    if not source.is_dir():
        return [source]
    found = sorted(
        path for path in source.glob("*.json")
        if path.is_file() and not path.name.startswith(".") and file_format(path) == "momapos-run"
    )  # fmt: skip
    if not found or len(found) > MAX_RUNS:
        raise InputError(
            f"{source}: needs 1 to {MAX_RUNS} run records (momapos run PLAN --out FILE), not "
            f"{len(found)}"
        )
    return found


def _cameras(text: str) -> tuple[Camera, ...]:
    from momapos.apps.export import CAMERAS

    names = [] if text == "none" else text.split(",")
    chosen = tuple(camera for camera in CAMERAS if camera in names)
    if len(chosen) != len(names):
        raise InputError(
            f"--cameras must name some of {', '.join(CAMERAS)}, or be none, not {json.dumps(text)}"
        )
    return chosen


def _size(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d{1,4})x(\d{1,4})", text)
    if match is None or not all(8 <= int(side) <= MAX_SIZE for side in match.groups()):
        raise InputError(
            f"--image-size must be WIDTHxHEIGHT, each from 8 to {MAX_SIZE} px, not "
            f"{json.dumps(text)}"
        )
    return int(match[1]), int(match[2])


SUFFIXES = {"csv": ".csv", "npz": ".npz", "ros2": "_ros2.json", "mcap": "", "moveit": ".scene"}
"""Ending of each format's file; its name is that of the plan."""
OF_PLANS = ("ros2", "moveit")
"""Formats for plans only."""
FRAME = "map"


def export(
    source: PlanArg,
    /,
    *,
    to: Literal["csv", "npz", "ros2", "mcap", "moveit", "lerobot", "hdf5"],
    out: OptionalFile = None,
    scene_root: OptionalFolder = None,
    robot: OptionalRobot = None,
    frame: str = FRAME,
    cameras: str = "room,hand",
    image_size: str = "128x96",
) -> int:
    """Write a solved plan, or the motion of runs, for other programs.

    csv, npz: base, arm and object over time, as a table or as arrays. ros2: goals for Nav2, the arm
    controller and the gripper, as JSON. mcap: a ROS 2 bag of frames, joints, trajectory and scene,
    for Foxglove, RViz and "ros2 bag play". moveit: a planning scene, an SRDF of the robot, and the
    carried object as an attached object. lerobot, hdf5: a set of runs as a LeRobot dataset or in
    robomimic's layout, with rendered images.

    For a tour, each plan is written: FILE_1, FILE_2 and so on. ros2 and moveit need a plan, not a
    run; lerobot and hdf5 need a run, or a folder of runs of one robot.

    Exit status: 0 written; 2 unusable input or output.

    Args:
        source: A plan file, a tour file, the record of a run, or a folder of records.
        to: The format.
        out: The file, or the folder for mcap (default: named after the plan, in the current
            folder).
        scene_root: Folder for files that are not next to the plan, and for models of a BestMan
            scene.
        robot: A library robot or a robot file (default: the robot of the plan).
        frame: Name of the world frame in messages.
        cameras: Rendered cameras of lerobot and hdf5: some of room and hand, or none.
        image_size: Size of their images [px].
    """
    if to in SETS:
        export_episodes(source, to, out, scene_root, robot, cameras, image_size)
        return 0
    if not frame:
        raise InputError("--frame must not be empty")
    paths = plans_of(source, "to export")
    targets = [
        Path(path.stem + SUFFIXES[to]) if out is None else numbered(out, len(paths), k)
        for k, path in enumerate(paths)
    ]
    for target in targets:
        _check(target, to, [source, *paths])
    # Read everything before writing anything.
    opened = [_read(path, to, scene_root, robot) for path in paths]
    for content, target in zip(opened, targets, strict=True):
        own = content.robot.srdf
        if own is not None and any(
            resolved(file) == resolved(own) for file in _output_files(target, to)
        ):
            raise InputError(f"{own}: is the robot's own file; choose another name with --out")
    for content, target in zip(opened, targets, strict=True):
        for path in _write(content, to, frame, target):
            say(path)
    return 0


@dataclass(frozen=True)
class _Content:
    """What to export."""

    plan: PlacementPlan
    scene: Scene
    robot: Robot
    run: RunRecord | None


def _output_files(target: Path, to: str) -> list[Path]:
    """Return all files that an export may write for one name."""
    if to != "moveit":
        return [target]
    return [target, target.with_suffix(".srdf"), target.with_name(f"{target.stem}_attached.json")]


def _check(target: Path, to: str, sources: list[Path]) -> None:
    """Refuse an unusable output name, before anything heavy is imported.

    Raises:
        InputError: It is a source, exists, or can't be written.
    """
    for path in sources:
        if resolved(target) == resolved(path):
            raise InputError(f"{target}: is the input file; choose another name with --out")
    if to == "mcap":
        check_outputs(folders=[target.absolute().parent])
        if target.exists():
            raise InputError(
                f"{target}: exists already; remove it, or choose another name with --out"
            )
    else:
        check_outputs(_output_files(target, to))
    if to == "moveit" and target.suffix == ".srdf":
        raise InputError(
            f"{target}: .srdf is for the robot's file; --out names the scene file (.scene)"
        )


def _read(path: Path, to: str, scene_root: Path | None, robot: str | None) -> _Content:
    """Read a plan, or the record of a run with its plan.

    Raises:
        MomaposError: A file is unusable, or a run is exported to a format for plans.
    """
    from momapos.model.plan_files import format_of
    from momapos.simulation import FORMAT

    if format_of(path) != FORMAT:
        plan, scene, machine = open_plan(path, scene_root, robot, "to export", allow_assumed=False)
        return _Content(plan, scene, machine, None)
    record, plan, scene, machine = open_run(
        path, scene_root, robot, "to export", allow_assumed=False
    )
    if to in OF_PLANS:
        raise InputError(
            f"{path}: a run can't be exported to {to}; export its plan, {path.parent / record.plan}"
        )
    return _Content(plan, scene, machine, record)


def _write(content: _Content, to: str, frame: str, target: Path) -> list[Path]:
    """Write one plan or run; return the files."""
    plan, scene, robot = content.plan, content.scene, content.robot
    if to == "moveit":
        return _write_moveit(plan, scene, robot, target)
    from momapos.apps.export import phases_of, plan_timeline, run_timeline

    if to == "ros2":
        from momapos.apps.export import write_ros2

        write_ros2(plan, phases_of(plan, robot), robot, frame, target)
        return [target]
    if content.run is not None:
        timeline = run_timeline(content.run, robot)
    else:
        timeline = plan_timeline(plan, phases_of(plan, robot), scene, robot)
    if to == "mcap":
        from momapos.apps.export import write_recording

        write_recording(timeline, scene, robot, frame, target)
    else:
        from momapos.apps.export import write_csv, write_npz

        (write_csv if to == "csv" else write_npz)(timeline, target)
    return [target]


def _write_moveit(plan: PlacementPlan, scene: Scene, robot: Robot, target: Path) -> list[Path]:
    """Write the scene, the robot's SRDF, and the carried object; return the files."""
    import numpy as np

    from momapos.apps.export import carries_object, write_attached, write_scene, write_srdf

    files = _output_files(target, "moveit")
    # An object to be placed is in the hand, not in the scene.
    absent = {plan.task.object} if plan.task.verb == "place" else set()
    write_scene(scene, np.eye(4), target, absent=absent)
    write_srdf(robot, files[1])
    if not carries_object(plan):
        return files[:2]
    write_attached(plan, scene, robot, files[2])
    return files
