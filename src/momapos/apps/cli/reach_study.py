"""momapos reach study: how well a robot reaches the points of a surface from one base pose."""

from __future__ import annotations

import csv
import io
import json as encoder
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from momapos.apps.plots import check_figure_path
from momapos.core import check_outputs, parse_quantity, say
from momapos.model.robots import find_named_robot

from .base_pose_words import parse_pose
from .options import ArmOption, Flag, OptionalFile, PoseArg, RobotArg, Text, optional

if TYPE_CHECKING:
    from collections.abc import Sequence

    from momapos.model.records import ToolPose
    from momapos.model.scene import Scene
    from momapos.planning import ReachStudy

SurfaceArg = Annotated[Positional[str], arg(metavar="SURFACE")]


def reach_study(
    robot: RobotArg,
    surface: SurfaceArg,
    /,
    *,
    scene: Annotated[Text, optional("SCENE")] = None,
    at: PoseArg = None,
    spacing: str = "10cm",
    cone: str = "0deg",
    standoff: str = "0cm",
    arm: ArmOption = "any",
    out: OptionalFile = None,
    plot: OptionalFile = None,
    map_file: Annotated[OptionalFile, arg(name="map")] = None,
    page: OptionalFile = None,
    json: Flag = False,
) -> int:
    """Look how well a robot reaches the points of a surface, from a given or the best base pose.

    The hand is toward the surface, and may turn about its approach. A reached point has an arm
    state that hits nothing; its dexterity (0 to 1) is how evenly the arm moves the tool there in
    all directions. Motions are not planned.

    Args:
        robot: A library robot or a robot file.
        surface: A mesh file (STL, OBJ, PLY, GLB) in meters, z up; with --scene an object of it, or
            a part as OBJECT/PART.
        scene: A scene file or a built-in kitchen, whose objects are in the way.
        at: The base pose [m, m, rad or deg] (default: the one that reaches the most points).
        spacing: Mean distance of neighboring points.
        cone: Angle by which the hand may lean.
        standoff: Distance of the fingertips from the surface.
        arm: The arm of a robot with several (any: the first).
        out: Write tool poses, whether they are reached, and dexterity to this CSV file.
        plot: Draw the surface with its points (PNG, SVG or PDF).
        map_file: Draw how many points each base position serves (PNG, SVG or PDF).
        page: Write a web page with the surface, its points and the robot (HTML).
        json: Print one JSON object.
    """
    find_named_robot(robot)
    check_outputs([out, plot, map_file, page])
    for figure in (plot, map_file):
        check_figure_path(figure)
    apart, away = (
        parse_quantity(text).length(f"{name}:")
        for name, text in (("--spacing", spacing), ("--standoff", standoff))
    )
    lean = parse_quantity(cone).angle("--cone:")
    given = None if at is None else parse_pose(at, "--at")
    from momapos.apps.plots import draw_pose_map, draw_study
    from momapos.core import require, write_atomic
    from momapos.model.records import Task
    from momapos.model.robots import load_robot
    from momapos.planning import PlacementQuery, map_poses, study_reach
    from momapos.planning.grasps import surface_poses

    from .console import busy

    machine = load_robot(robot, arm=None if arm == "any" else arm)
    room, name = _surface(surface, scene)
    poses = surface_poses(room, machine, name, apart, cone=lean, standoff=away)
    query = PlacementQuery.of(room, machine, Task("reach", "", poses=poses))
    with busy(f"{machine.name}: {len(poses)} points"):
        found = map_poses(query) if given is None or map_file is not None else None
        base = given if given is not None or found is None else found.best
        study = study_reach(query, base)
    if out is not None:
        write_atomic(out, _table(poses, study).encode())
    if plot is not None:
        draw_study(room, machine, name, poses, study, plot)
    if map_file is not None and found is not None:
        bases = [] if study.base_pose is None else [study.base_pose]
        draw_pose_map(room, machine, poses, found, bases, map_file)
    if page is not None:
        with require("view"):
            from momapos.apps.web import write_study_page
        write_study_page(room, machine, name, poses, study, page)
    reached = int(study.reached.sum())
    if json:
        say(encoder.dumps({
            "robot": machine.name, "surface": name, "points": len(poses), "reached": reached,
            "base_pose": study.base_pose, "dexterity": study.dexterity.tolist(), "why": study.why,
        }))  # fmt: skip
    else:
        say(_words(machine.title, name, poses, study))
    return 0


def _surface(surface: str, scene: str | None) -> tuple[Scene, str]:
    """Return the room and the name of the surface in it.

    Raises:
        MomaposError: The scene or the mesh cannot be read.
    """
    from momapos.core import FileFormatError
    from momapos.model.scene import Scene, SceneObject, load_scene
    from momapos.model.urdf import mesh_triangles

    if scene is not None:
        return load_scene(scene), surface
    path = Path(surface)
    triangles = mesh_triangles(path)
    if not len(triangles):
        raise FileFormatError(f"{path}: has no triangles")
    faces = [[3 * k, 3 * k + 1, 3 * k + 2] for k in range(len(triangles))]
    item = SceneObject.from_mesh(path.stem, triangles.reshape(-1, 3), faces, (0.0, 0.0, 0.0))
    return Scene(path.stem, (item,)), path.stem


def _table(poses: Sequence[ToolPose], study: ReachStudy) -> str:
    """Return a row for each point."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(["x", "y", "z", "qx", "qy", "qz", "qw", "reached", "dexterity"])
    for pose, on, value in zip(poses, study.reached, study.dexterity, strict=True):
        w, *xyz = pose.wxyz
        numbers = [f"{one:.6g}" for one in (*pose.xyz, *xyz, w, value)]
        rows.writerow([*numbers[:-1], int(on), numbers[-1]])
    return text.getvalue()


def _words(robot: str, surface: str, poses: Sequence[ToolPose], study: ReachStudy) -> str:
    """Summarize a study."""
    from .console import pose_text

    reached = int(study.reached.sum())
    lines = [f"{robot}: {reached} of {len(poses)} points of {surface} are reached", ""]
    if study.base_pose is not None:
        lines.append(f"  base pose   {pose_text(study.base_pose)}")
    if study.why:
        lines.append(f"  not there   {study.why}")
    if reached:
        values = sorted(study.dexterity[study.reached].tolist())
        middle = values[len(values) // 2]
        lines.append(f"  dexterity   {middle:.3f} in the middle, {values[0]:.3f} at least")
    return "\n".join(lines)
