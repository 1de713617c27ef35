"""momapos scene: list, show, check and generate scenes."""

from __future__ import annotations

import json as json_format
import math
import sys
from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import Positional, arg

from momapos.apps.plots import check_figure_path
from momapos.core import check_outputs, say
from momapos.model.scene import builtin_names, builtin_size, find_scene

from .console import busy
from .options import (
    Flag,
    JointsArg,
    ObjectsArg,
    OptionalFile,
    OptionalFolder,
    RobotOption,
    SceneArg,
    check_seed,
)

if TYPE_CHECKING:
    from momapos.model.scene import Scene, SceneObject
    from momapos.workflows.scene_check import SceneReport


USABLE, UNUSABLE = 0, 2
MAX_SHOWN = 3
"""Findings of a kind that are listed in short [-]."""


def scene_check(
    scene: SceneArg,
    /,
    *,
    robot: RobotOption = "fetch",
    joint: JointsArg = (),
    json: Flag = False,
) -> int:
    """Check a scene: unknown keys, sizes, shapes, overlaps, joints, handles, start and floor.

    Exit status: 0, or 2 if planning would refuse the scene.

    Args:
        scene: A built-in kitchen or a scene file (momapos, BestMan, URDF).
        robot: The robot that starts and drives there: a library robot or a robot file.
        joint: Set a joint of the scene, such as fridge/door_hinge=60deg.
        json: Print one JSON object instead of text.
    """
    from momapos.model.robots import find_named_robot

    find_scene(scene)  # reports a mistyped name before anything heavy is imported
    find_named_robot(robot)
    from momapos.model.robots import load_robot
    from momapos.model.scene import load_scene, set_joints
    from momapos.workflows.scene_check import check_scene, report_lines, report_to_dict

    loaded = set_joints(load_scene(scene), joint)
    with busy(f"checking {loaded.name}"):
        report = check_scene(loaded, load_robot(robot))
    if json:
        say(json_format.dumps(report_to_dict(report), indent=1, allow_nan=False))
    else:
        say("\n".join(report_lines(report)))
    return USABLE if report.usable else UNUSABLE


def check_in_short(scene: Scene) -> SceneReport:
    """Check a scene without a robot."""
    from momapos.workflows.scene_check import check_scene

    with busy(f"checking {scene.name}"):
        return check_scene(scene)


def findings_to_list(report: SceneReport) -> list[dict[str, Any]]:
    """Return the findings of a report as plain values."""
    from momapos.workflows.scene_check import report_to_dict

    found: list[dict[str, Any]] = report_to_dict(report)["findings"]
    return found


def lines_in_short(report: SceneReport, source: str) -> list[str]:
    """Return the number of findings, and the errors and warnings."""
    from momapos.workflows.scene_check import Severity, finding_lines, summary

    worst = (Severity.ERROR, Severity.WARNING)
    more = f"; 'momapos scene check {source}' lists all" if report.findings else ""
    return [
        f"  check: {summary(report)}{more}",
        *(f"  {line}" for line in finding_lines(report.findings, worst, MAX_SHOWN)),
    ]


SOLVED = 0


def scene_list(*, json: Flag = False) -> int:
    """List the built-in kitchens.

    Args:
        json: Print one JSON object instead of a table.
    """
    if json:
        from momapos.model.scene import load_scene

        scenes = [load_scene(name) for name in builtin_names()]
        _print_json({"scenes": [describe(scene) for scene in scenes]})
        return SOLVED
    for name in builtin_names():
        objects, joints = builtin_size(name)
        say(f"{name:20} {objects:3} objects, {joints:3} joints")
    say("Use a name or a file as SCENE; 'momapos scene new LAYOUT' generates more.")
    return SOLVED


def scene_show(
    scene: SceneArg,
    /,
    *,
    joint: JointsArg = (),
    plot: OptionalFile = None,
    json: Flag = False,
) -> int:
    """Show what is wrong in a scene in short, then its objects with sizes and joints.

    Args:
        scene: A built-in kitchen or a scene file (momapos, BestMan, URDF).
        joint: Set a joint of the scene, such as fridge/door_hinge=60deg.
        plot: Draw the floor plan (PNG, SVG or PDF).
        json: Print one JSON object instead of text.
    """
    check_outputs([plot])
    check_figure_path(plot)
    find_scene(scene)  # reports a mistyped name before anything heavy is imported
    from momapos.model.scene import load_scene, set_joints

    loaded = set_joints(load_scene(scene), joint)
    if plot is not None:
        from momapos.apps.plots import draw_scene

        with busy(f"drawing {plot.name}"):
            draw_scene(loaded, plot)
    facts, report = describe(loaded), check_in_short(loaded)
    if json:
        findings = {"findings": findings_to_list(report)}
        _print_json({**facts, **findings, "plot": None if plot is None else str(plot)})
        return SOLVED
    say(f"{loaded.name} ({loaded.path})")
    say("\n".join(lines_in_short(report, scene)))
    for item in facts["objects"]:
        low, high = item["bounds"]
        size = " x ".join(f"{b - a:.2f}" for a, b in zip(low, high, strict=True))
        x, y, z = ((a + b) / 2 for a, b in zip(low, high, strict=True))
        say(f"  {item['name']:20} {item['category']:14} {size} m at ({x:.2f}, {y:.2f}, {z:.2f})")
        for moving in item["joints"]:
            say(f"      {_joint_line(moving)}")
        if "latch" in item:
            say(f"      {_latch_line(item)}")
    floor = facts["floor_area"]
    say(f"  floor: {'unknown' if floor is None else f'{floor:.1f} m^2'}")
    start = facts["start"]
    place = "none" if start is None else f"({start[0]:.2f}, {start[1]:.2f}), yaw {start[2]:.2f} rad"
    say(f"  start: {place}")
    _warn(loaded, listed=set(map(str, loaded.ignored_keys)))
    if plot is not None:
        say(f"  plot: {plot}")
    return SOLVED


def scene_new(
    layout: Annotated[Positional[str], arg(metavar="LAYOUT")],
    /,
    *,
    seed: int = 0,
    out: Annotated[Path, arg(metavar="FILE")],
    json: Flag = False,
) -> int:
    """Generate a kitchen from a layout and a seed.

    Args:
        layout: single_wall, galley, l_shaped, u_shaped, island or peninsula.
        seed: The same layout and seed give the same kitchen.
        out: The scene file; the URDF files go into a folder next to it.
        json: Print one JSON object instead of text.
    """
    from momapos.model.scene import generate_kitchen, load_scene

    check_outputs([out])
    check_seed(seed)
    path = generate_kitchen(layout, seed=seed, out=out)
    facts = describe(load_scene(path))
    if json:
        _print_json({**facts, "layout": layout, "seed": seed})
        return SOLVED
    joints = sum(len(item["joints"]) for item in facts["objects"])
    say(f"{path}: {len(facts['objects'])} objects, {joints} joints")
    return SOLVED


def scene_convert(
    source: SceneArg,
    out: Annotated[Positional[Path], arg(metavar="OUT")],
    /,
    *,
    copy: Flag = False,
    root: OptionalFolder = None,
    without: ObjectsArg = (),
    json: Flag = False,
) -> int:
    """Convert a scene to a momapos scene, MJCF or a MoveIt planning scene.

    Args:
        source: A momapos scene, a BestMan list, a URDF or xacro file, MJCF, a MoveIt planning
            scene, SDF or USD.
        out: The output file: .json, .xml (MJCF) or .scene (MoveIt). A .json file must be above its
            URDF files, unless --copy copies them. Sources without URDF files get new ones next to
            it.
        copy: Copy the URDF and mesh files to the folder <out>_files next to the output.
        root: Folder that no path in the source may leave; paths of a BestMan scene are relative to
            it (default: found from the source).
        without: Leave out this object of another program's scene, such as a robot.
        json: Print one JSON object instead of text.
    """
    check_outputs([out])
    path = find_scene(source)
    from .conversion import convert

    scene, report = convert(path, out, copy=copy, root=root, without=without)
    if json:
        reported = {} if report is None else {"report": report.as_json()}
        _print_json({**describe(scene), "warnings": list(scene.warnings), **reported})
        return SOLVED
    count = len(scene.objects)
    say(f"{out}: {count} object{'' if count == 1 else 's'}")
    for line in [] if report is None else report.lines():
        say(f"  {line}")
    _warn(scene)
    return SOLVED


# --------------------------------------------------------------------------------------- the facts


def describe(scene: Scene) -> dict[str, Any]:
    """Return the content of a scene as plain values [m], [rad]."""
    from momapos.core.geometry import signed_area

    return {
        "name": scene.name,
        "path": None if scene.path is None else str(scene.path),
        "objects": [_describe_object(item) for item in scene.objects],
        "floor_area": None
        if scene.floor_polygon is None
        else abs(signed_area(scene.floor_polygon)),
        "start": None if scene.start is None else scene.start.tolist(),
        "warnings": list(scene.warnings),
    }


def _describe_object(item: SceneObject) -> dict[str, Any]:
    import numpy as np

    values = item.values()
    joints = [
        {
            "name": name,
            "kind": joint.kind,
            "lower": joint.lower if math.isfinite(joint.lower) else None,
            "upper": joint.upper if math.isfinite(joint.upper) else None,
            "value": values[name],
        }
        for name, joint in item.model.joints.items()
    ]
    latch = {} if item.latch is None else {"latch": item.latch.members()}
    return {
        **latch,
        "name": item.name,
        "category": item.category,
        "bounds": np.round(item.bounds, 4).tolist(),
        "joints": joints,
    }


def _joint_line(joint: dict[str, Any]) -> str:
    unit = "m" if joint["kind"] == "prismatic" else "rad"
    if joint["lower"] is None:
        span = "unlimited"
    else:
        span = f"{joint['lower']:.2f} to {joint['upper']:.2f} {unit}"
    return f"{joint['name']:24} {joint['kind']}, {span}, at {joint['value']:.2f}"


def _latch_line(item: dict[str, Any]) -> str:
    turned, to, held = (item["latch"][key] for key in ("joint", "to", "holds"))
    kind = next(joint["kind"] for joint in item["joints"] if joint["name"] == turned)
    return f"{held} opens once {turned} is at {to:.2f} {'m' if kind == 'prismatic' else 'rad'}"


def _print_json(data: dict[str, Any]) -> None:
    say(json_format.dumps(data, indent=1, allow_nan=False))


def _warn(scene: Scene, listed: Collection[str] = ()) -> None:
    """Print the warnings of a scene on stderr, without those that are listed already."""
    for text in scene.warnings:
        if text not in listed:
            say(f"note: {text}", file=sys.stderr)
