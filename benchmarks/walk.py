"""Measure time and memory of `momapos scan` by the number of frames.

    python benchmarks/walk.py FOLDER [--frames 100 1000] [--scene kitchen_small] [--seed 0]

Renders walks along one path with increasing numbers of frames, as with a 30 Hz camera, stores them
in FOLDER, and runs `momapos scan` on each in a separate process.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from pathlib import Path

from momapos.apps.synthetic_scans import DepthSensor, synthetic_scan, write_scan
from momapos.model.scene import load_scene


def scanned(walk: Path, out: Path) -> tuple[float, float, float]:
    """Run the command.

    Returns:
        Wall time [s], processor time [s] and peak memory [GB].
    """
    words = ["scan", str(walk), "--out", str(out), "--json"]
    code = f"import sys; from momapos.apps.cli.main import main; sys.exit(main({words!r}))"
    began = time.perf_counter()
    child = os.spawnv(os.P_NOWAIT, sys.executable, [sys.executable, "-c", code])
    _, status, used = os.wait4(child, 0)
    took = time.perf_counter() - began
    if status:
        sys.exit(f"{walk}: momapos scan ended with {os.waitstatus_to_exitcode(status)}")
    return took, used.ru_utime + used.ru_stime, used.ru_maxrss / 1e6


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--frames", type=int, nargs="+", default=[100, 1000])
    parser.add_argument("--scene", default="kitchen_small")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    scene = load_scene(args.scene)
    for frames in args.frames:
        walk = args.folder / f"{Path(args.scene).stem}_{frames}_{args.seed}"
        if not walk.exists():
            scan = synthetic_scan(scene, frames=frames, seed=args.seed, sensor=DepthSensor())
            write_scan(scan, walk)
        out = walk.with_name(f"{walk.name}_found") / "scene.json"
        took, busy, memory = scanned(walk, out)
        made = load_scene(out)
        joints = sum(len(item.model.joints) for item in made.objects)
        report = json.loads((out.parent / "scan_report.json").read_text())
        print(
            f"{frames} frames, {report['frames']} of them read: {took:.1f} s, {busy:.1f} s of the "
            f"processor, {memory:.2f} GB at most; {len(made.objects)} objects, {joints} joints; "
            f"{'; '.join(report['notes'])}",
            flush=True,
        )


if __name__ == "__main__":
    main()
