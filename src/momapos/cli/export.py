"""momapos export: a plan as other programs take it."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from momapos.cli.options import OptionalPath, OptionalText
from momapos.cli.plan_files import check_plan_file, open_plan
from momapos.errors import InputError
from momapos.files import check_outputs

SUFFIXES = {"csv": ".csv", "npz": ".npz", "ros2": "_ros2.json", "mcap": "", "moveit": ".scene"}
"""How the result of each format is called after its plan."""
FRAME = "map"


def export(
    plan: Positional[Path],
    /,
    *,
    to: Literal["csv", "npz", "ros2", "mcap", "moveit"],
    out: OptionalPath = None,
    scene_root: OptionalPath = None,
    robot: OptionalText = None,
    frame: str = FRAME,
) -> int:
    """Write a solved plan as other programs take it.

    csv, npz: base, arm and object over time, as a table or as arrays. ros2: goals for Nav2, the
    arm's controller and the gripper, as JSON. mcap: a ROS 2 bag of frames, joints, trajectory and
    room, for Foxglove, RViz and "ros2 bag play". moveit: the room as a planning scene; beside it an
    SRDF of the robot, and what the hand carries as an attached object.

    Exit status: 0 written, 2 a file cannot be used or written.

    Args:
        plan: The plan file.
        to: The format.
        out: The file, for mcap a folder; by default named after the plan, in the current folder.
        scene_root: Folder for names not found beside the plan, and for a BestMan scene's models.
        robot: A library robot or a robot file; by default the one that the plan names.
        frame: Name of the world's frame in messages.
    """
    target = out or Path(plan.stem + SUFFIXES[to])
    attached = target.with_name(f"{target.stem}_attached.json")
    files = [target, target.with_suffix(".srdf"), attached] if to == "moveit" else [target]
    if target.resolve() == plan.resolve():
        raise InputError(f"{target}: is the plan itself; give another name with --out")
    if to == "mcap":
        check_outputs(folders=[target.absolute().parent])
        if target.exists():
            raise InputError(f"{target}: exists already; remove it, or give --out another name")
    else:
        check_outputs(files)
    if not frame:
        raise InputError("--frame must not be empty")
    if to == "moveit" and target.suffix == ".srdf":
        raise InputError(f"{target}: is the name of the robot's file; name the scene's with --out")
    check_plan_file(plan)
    content, scene, machine = open_plan(plan, scene_root, robot, "to export")
    if machine.srdf is not None and any(file.resolve() == machine.srdf.resolve() for file in files):
        raise InputError(f"{machine.srdf}: is the robot's own; give another name with --out")
    from momapos.export.phases import phases_of

    if to == "moveit":
        import numpy as np

        from momapos.export.attached_object import is_carried, write_attached
        from momapos.export.planning_scene import write_scene, write_srdf

        # Until it is let go, what is placed is in the hand and not in the room.
        absent = {content.task.object} if content.task.verb == "place" else set()
        write_scene(scene, np.eye(4), target, absent=absent)
        write_srdf(machine, files[1])
        if is_carried(content):
            write_attached(content, scene, machine, attached)
        else:
            files.pop()
    else:
        phases = phases_of(content, machine)
        if to == "csv":
            from momapos.export.tables import write_csv

            write_csv(content, phases, target)
        elif to == "npz":
            from momapos.export.tables import write_npz

            write_npz(content, phases, target)
        elif to == "ros2":
            from momapos.export.ros2 import write_ros2

            write_ros2(content, phases, machine, frame, target)
        else:
            from momapos.export.recording import write_recording

            write_recording(content, phases, scene, machine, frame, target)
        files = [target]
    for path in files:
        print(path)
    return 0
