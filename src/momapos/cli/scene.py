"""`momapos scene`: list, show, make and convert scenes."""

from __future__ import annotations

import json as json_format
import math
import os
import shutil
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from momapos.cli.options import OptionalPath
from momapos.errors import SceneError
from momapos.scene.names import builtin_names, builtin_size, find_scene

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Float

    from momapos.kinematics.articulated import Articulated
    from momapos.scene.scene import Scene, SceneObject

SOLVED = 0


def scene_list(*, json: bool = False) -> int:
    """List the kitchens that come with momapos.

    Args:
        json: Print one JSON object instead of a table.
    """
    if json:
        from momapos.cache import user_cache
        from momapos.scene.files import load_scene

        scenes = [load_scene(name, cache=user_cache()) for name in builtin_names()]
        _print_json({"scenes": [describe(scene) for scene in scenes]})
        return SOLVED
    for name in builtin_names():
        objects, joints = builtin_size(name)
        print(f"{name:20} {objects:3} objects, {joints:3} joints")
    print("Use a name as SCENE, or a file; 'momapos scene new LAYOUT' makes more.")
    return SOLVED


def scene_show(scene: str, /, *, plot: OptionalPath = None, json: bool = False) -> int:
    """Show what is in a scene: its objects, their sizes, their joints.

    Args:
        scene: Name of a built-in kitchen, or a file (momapos scene, BestMan list, URDF).
        plot: Draw the scene from above into this PNG file.
        json: Print one JSON object instead of text.
    """
    find_scene(scene)  # a mistyped name is told before anything heavy is imported
    from momapos.cache import user_cache
    from momapos.scene.files import load_scene

    loaded = load_scene(scene, cache=user_cache())
    if plot is not None:
        from momapos.viewer.scene import draw_scene

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
        for joint in item["joints"]:
            print(f"      {_joint_line(joint)}")
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
    from momapos.scene.files import load_scene
    from momapos.scene.kitchens import generate_kitchen

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
    json: bool = False,
) -> int:
    """Write a scene of another kind (BestMan list, URDF) as a momapos scene.

    Args:
        source: The scene to convert.
        out: The scene file to write; it must lie above its URDF files, or --copy them.
        copy: Copy the URDF and mesh files into the folder `<out>_files` beside the new file.
        root: Folder that the paths in a BestMan scene are relative to; found where not given.
        json: Print one JSON object instead of text.
    """
    find_scene(source)
    from momapos.scene.files import load_scene, save_scene

    scene = load_scene(source, root=root)
    if copy:
        scene = copy_models(scene, out)
    else:
        _refuse_outside(scene, out)
    save_scene(scene, out)
    again = load_scene(out)
    if json:
        _print_json({**describe(again), "warnings": [*scene.warnings, *again.warnings]})
        return SOLVED
    print(f"{out}: {len(again.objects)} objects")
    _warn(scene)
    return SOLVED


# --------------------------------------------------------------------------------------- the facts


def describe(scene: Scene) -> dict[str, Any]:
    """What `scene show` tells, as plain values [m], [rad]."""
    return {
        "name": scene.name,
        "path": None if scene.path is None else str(scene.path),
        "objects": [_describe_object(item) for item in scene.objects],
        "floor_area": None if scene.floor is None else _area(scene.floor),
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


def _area(outline: Float[np.ndarray, "k 2"]) -> float:
    import numpy as np

    ahead = np.roll(outline, -1, axis=0)
    return abs(float(outline[:, 0] @ ahead[:, 1] - outline[:, 1] @ ahead[:, 0])) / 2


def _print_json(data: dict[str, Any]) -> None:
    print(json_format.dumps(data, indent=1, allow_nan=False))


def _warn(scene: Scene) -> None:
    for text in scene.warnings:
        print(f"note: {text}", file=sys.stderr)


# --------------------------------------------------------------------------------- where files lie


def _refuse_outside(scene: Scene, out: Path) -> None:
    """Say where the output could stand when the models are not below its folder."""
    from momapos.scene.copies import model_files

    files = [file.resolve() for item in scene.objects for file in model_files(item.model)]
    folder = out.resolve().parent
    if all(file.is_relative_to(folder) for file in files):
        return
    place = Path(os.path.commonpath([file.parent for file in files])) / out.name
    raise SceneError(
        f"{out}: the scene's URDF files are not below {folder}; "
        f"write it to {place}, or add --copy to copy them"
    )


def copy_models(scene: Scene, out: Path) -> Scene:
    """Copy the URDF and mesh files of a scene into `<stem>_files` beside a new scene file.

    Folders keep their places among each other, so that the meshes are found as before.

    Returns:
        The scene with its models read from the copies.

    Raises:
        SceneError: The folder exists; what is in it is not overwritten.
    """
    from momapos.scene.copies import copy_files, model_files

    target = out.resolve().parent / f"{out.stem}_files"
    if target.exists():
        raise SceneError(f"{target} exists already; remove it or write to another file")
    models = {id(item.model): item.model for item in scene.objects}
    files = {file: None for model in models.values() for file in model_files(model)}
    if not files:
        return scene
    try:
        copies = dict(zip(files, copy_files(files, target), strict=True))
        moved = {key: _moved(model, copies, target) for key, model in models.items()}
    except BaseException as error:
        shutil.rmtree(target, ignore_errors=True)
        if isinstance(error, OSError):
            raise SceneError(f"{target}: cannot be written ({error.strerror})") from error
        raise
    objects = tuple(replace(item, model=moved[id(item.model)]) for item in scene.objects)
    return replace(scene, objects=objects)


def _moved(model: Articulated, copies: Mapping[Path, Path], target: Path) -> Articulated:
    from momapos.kinematics.articulated import Articulated
    from momapos.kinematics.urdf import read_urdf

    if model.urdf.path is None:
        return model
    path = copies[model.urdf.path]
    return Articulated(read_urdf(path, root=target.parent, scale=model.urdf.scale))
