"""momapos scene scan: render a synthetic scan of a scene."""

from __future__ import annotations

import json as json_format
import sys
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from momapos.core import check_outputs, say
from momapos.model.scene import find_scene

from .console import progress
from .options import Flag, JointsArg, SceneArg, check_count, check_seed

SOLVED = 0


def scene_scan(
    scene: SceneArg,
    /,
    *,
    out: Annotated[Path, arg(metavar="DIR")],
    joint: JointsArg = (),
    frames: int = 60,
    seed: int = 0,
    noise: Flag = True,
    tilt: Flag = False,
    json: Flag = False,
) -> int:
    """Render a synthetic scan of a scene: posed color and depth images, and the ground truth.

    Args:
        scene: A scene file or a built-in kitchen.
        out: A new folder for the frames (7-Scenes layout) and truth.json.
        joint: Set a joint of the scene, such as fridge/door_hinge=60deg.
        frames: Number of images.
        seed: The same scene and seed give the same scan.
        noise: Render exact images and poses, without the noise of a RealSense D435.
        tilt: Rotate the scan's frame at random, so that its z axis is not up.
        json: Print one JSON object instead of text.
    """
    check_outputs(folders=[out])
    check_seed(seed)
    check_count("--frames", frames, 1, 10_000)
    find_scene(scene)  # reports a mistyped name before anything heavy is imported
    from momapos.apps.synthetic_scans import DepthSensor, refuse_used, synthetic_scan, write_scan
    from momapos.model.scene import load_scene, set_joints

    refuse_used(out)
    loaded = set_joints(load_scene(scene), joint)
    sensor = DepthSensor() if noise else None
    scan = synthetic_scan(loaded, frames=frames, seed=seed, sensor=sensor, tilt=tilt)
    with progress("rendering") as report:
        write_scan(scan, out, report)
    if json:
        facts = {
            "scene": str(loaded.path),
            "out": str(out),
            "frames": frames,
            "seed": seed,
            "noise": noise,
            "tilt": tilt,
            "objects": len(loaded.objects),
            "warnings": list(loaded.warnings),
        }
        say(json_format.dumps(facts, indent=1))
        return SOLVED
    for text in loaded.warnings:
        say(f"note: {text}", file=sys.stderr)
    say(f"{out}: {frames} frames of {len(loaded.objects)} objects, and truth.json")
    return SOLVED
