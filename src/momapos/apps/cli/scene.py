"""`momapos scene`: list, show, make and convert scenes."""

from __future__ import annotations

import json as json_format
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from momapos.apps.plots import check_picture
from momapos.core import check_outputs
from momapos.model.scene import builtin_names, builtin_size, find_scene

from .console import busy
from .options import JointsArg, ObjectsArg, OptionalPath, check_seed

if TYPE_CHECKING:
    from momapos.model.scene import Scene, SceneObject

SOLVED = 0


def scene_list(*, json: bool = False) -> int:
    """List the kitchens that come with momapos.

    Args:
        json: Print one JSON object instead of a table.
    """
    if json:
        from momapos.core import user_cache
        from momapos.model.scene import load_scene

        scenes = [load_scene(name, cache=user_cache()) for name in builtin_names()]
        _print_json({"scenes": [describe(scene) for scene in scenes]})
        return SOLVED
    for name in builtin_names():
        objects, joints = builtin_size(name)
        print(f"{name:20} {objects:3} objects, {joints:3} joints")
    print("Use a name as SCENE, or a file; 'momapos scene new LAYOUT' makes more.")
    return SOLVED


def scene_show(
    scene: str,
    /,
    *,
    joint: JointsArg = (),
    plot: OptionalPath = None,
    json: bool = False,
) -> int:
    """Show what is in a scene: its objects, their sizes, their joints.

    Args:
        scene: Name of a built-in kitchen, or a file (momapos scene, BestMan list, URDF).
        joint: A joint that stands elsewhere than in the file, as fridge/door_hinge=60deg;
            repeatable.
        plot: Draw the scene from above into this file (PNG, SVG, PDF).
        json: Print one JSON object instead of text.
    """
    check_outputs([plot])
    check_picture(plot)
    find_scene(scene)  # a mistyped name is told before anything heavy is imported
    from momapos.core import user_cache
    from momapos.model.scene import load_scene, set_joints

    loaded = set_joints(load_scene(scene, cache=user_cache()), joint)
    if plot is not None:
        from momapos.apps.plots import draw_scene

        with busy(f"drawing {plot.name}"):
            draw_scene(loaded, plot)
    facts = describe(loaded)
    if json:
        _print_json({**facts, "plot": None if plot is None else str(plot)})
        return SOLVED
    print(f"{loaded.name} ({loaded.path})")
    for item in facts["objects"]:
        low, high = item["bounds"]
        size = " x ".join(f"{b - a:.2f}" for a, b in zip(low, high, strict=True))
        x, y, z = ((a + b) / 2 for a, b in zip(low, high, strict=True))
        print(f"  {item['name']:20} {item['category']:14} {size} m at ({x:.2f}, {y:.2f}, {z:.2f})")
        for moving in item["joints"]:
            print(f"      {_joint_line(moving)}")
    floor = facts["floor_area"]
    print(f"  floor: {'not known' if floor is None else f'{floor:.1f} m^2'}")
    start = facts["start"]
    place = "none" if start is None else f"({start[0]:.2f}, {start[1]:.2f}), yaw {start[2]:.2f} rad"
    print(f"  start: {place}")
    _warn(loaded)
    if plot is not None:
        print(f"  drawn in {plot}")
    return SOLVED


def scene_new(layout: str, /, *, seed: int = 0, out: Path, json: bool = False) -> int:
    """Make a new kitchen from a layout and a seed.

    Args:
        layout: single_wall, galley, l_shaped, u_shaped, island or peninsula.
        seed: The same layout and seed give the same kitchen.
        out: The scene file; the URDF files go into a folder beside it.
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
    print(f"{path}: {len(facts['objects'])} objects, {joints} joints")
    return SOLVED


def scene_convert(
    source: str,
    out: Path,
    /,
    *,
    copy: bool = False,
    root: OptionalPath = None,
    without: ObjectsArg = (),
    json: bool = False,
) -> int:
    """Write a scene of another kind as a momapos scene, as MJCF or for MoveIt.

    Args:
        source: The scene to convert: a momapos scene, a BestMan list, a URDF or xacro file,
            MJCF, a planning scene of MoveIt, SDF or USD.
        out: The file to write: .json, .xml (MJCF) or .scene (MoveIt). A .json must lie above its
            URDF files, or --copy them; those of a room that has none are written beside it.
        copy: Copy the URDF and mesh files into the folder `<out>_files` beside the new file.
        root: Folder that no path in the source may leave, and that those of a BestMan scene are
            relative to; found where not given.
        without: An object of another program's room that is left out, such as a robot; repeatable.
        json: Print one JSON object instead of text.
    """
    check_outputs([out])
    path = find_scene(source)
    from .conversion import convert

    scene, report = convert(path, out, copy=copy, root=root, without=without)
    if json:
        told = {} if report is None else {"report": report.as_json()}
        _print_json({**describe(scene), "warnings": list(scene.warnings), **told})
        return SOLVED
    count = len(scene.objects)
    print(f"{out}: {count} object{'' if count == 1 else 's'}")
    for line in [] if report is None else report.lines():
        print(f"  {line}")
    _warn(scene)
    return SOLVED


# --------------------------------------------------------------------------------------- the facts


def describe(scene: Scene) -> dict[str, Any]:
    """What `scene show` tells, as plain values [m], [rad]."""
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
    return {
        "name": item.name,
        "category": item.category,
        "bounds": np.round(item.bounds, 4).tolist(),
        "joints": joints,
    }


def _joint_line(joint: dict[str, Any]) -> str:
    unit = "m" if joint["kind"] == "prismatic" else "rad"
    if joint["lower"] is None:
        span = "without end"
    else:
        span = f"{joint['lower']:.2f} to {joint['upper']:.2f} {unit}"
    return f"{joint['name']:24} {joint['kind']}, {span}, at {joint['value']:.2f}"


def _print_json(data: dict[str, Any]) -> None:
    print(json_format.dumps(data, indent=1, allow_nan=False))


def _warn(scene: Scene) -> None:
    for text in scene.warnings:
        print(f"note: {text}", file=sys.stderr)
