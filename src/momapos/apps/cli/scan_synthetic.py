"""`momapos scene scan`: render a scan of a scene."""

from __future__ import annotations

import json as json_format
import sys
from pathlib import Path

from momapos.core import InputError, check_outputs
from momapos.model.scene import find_scene

from .console import progress
from .options import JointsArg, check_seed

SOLVED = 0


def scene_scan(
    scene: str,
    /,
    *,
    out: Path,
    joint: JointsArg = (),
    frames: int = 60,
    seed: int = 0,
    noise: bool = True,
    tilt: bool = False,
    json: bool = False,
) -> int:
    """Render a scan of a scene: posed color and depth images, and the truth beside them.

    Args:
        scene: Name of a built-in kitchen, or a file (momapos scene, BestMan list, URDF).
        out: A new folder for the frames (layout of 7-Scenes) and truth.json.
        joint: A joint that stands elsewhere than in the file, as fridge/door_hinge=60deg;
            repeatable.
        frames: Number of images.
        seed: The same scene and seed give the same scan.
        noise: Make the images and poses as imperfect as those of a RealSense D435.
        tilt: Turn the world of the scan at random, so that its z axis is not up.
        json: Print one JSON object instead of text.
    """
    check_outputs(folders=[out])
    check_seed(seed)
    if not 1 <= frames <= 10_000:
        raise InputError("--frames must be between 1 and 10000")
    find_scene(scene)  # a mistyped name is told before anything heavy is imported
    from momapos.apps.synthetic_scans import DepthSensor, refuse_used, synthetic_scan, write_scan
    from momapos.core import user_cache
    from momapos.model.scene import load_scene, set_joints

    refuse_used(out)
    loaded = set_joints(load_scene(scene, cache=user_cache()), joint)
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
        print(json_format.dumps(facts, indent=1))
        return SOLVED
    for text in loaded.warnings:
        print(f"note: {text}", file=sys.stderr)
    print(f"{out}: {frames} frames of {len(loaded.objects)} objects, and truth.json")
    return SOLVED
