"""Measure the processor time of commands that have two seconds and need more.

    python benchmarks/time_limits.py [--timeout 2] [--only WORD] [--out DIR]

Each command does work that takes longer: large files, fine maps, long runs. It runs in a process of
its own; the processor time is that of the process and of those that it started. Exit status 1 if
a command ends with another status than 0, 3 or 4 or with several lines of error, or takes `ALLOWED`
more.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import shutil
import subprocess
import sys
import tempfile
import threading
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np

from momapos.apps.cli.main import main as momapos
from momapos.model.robots.robot_names import library_file
from momapos.model.scene.scene_names import MAX_BYTES, find_scene
from placement import machine
from rows import keep_rows

ALLOWED = 0.5
"""Processor time after the limit in which a command ends [s]."""
HANG = 120.0
"""Wall time after which a command is ended from outside [s]."""
OBJECTS = 800
"""Furniture of the large scene [-]."""
MADE = (
    "scene scan kitchen_small --out {d}/scan --frames 40",
    "place open kitchen_small fridge/door_hinge --robot fetch --out {d}/plan.json",
    "place open kitchen_small fridge/door_hinge --robot fetch then close fridge/door_hinge "
    "--out {d}/tour.json",
    "run {d}/plan.json --out {d}/run.json",
)
"""What the commands work on."""
COMMANDS = (
    "place open {d}/large.json fridge_0/door_hinge --robot fetch",
    "place open kitchen_small fridge/door_hinge --robot tiago_dual --tolerance "
    "--tolerance-samples 10000",
    "place open kitchen_small fridge/door_hinge --robot stretch --method exhaustive",
    "place open kitchen_small fridge/door_hinge --robot fetch --map {d}/out_map.png "
    "--out {d}/out.json",
    "place open kitchen_island oven/door_hinge --robot fetch then open fridge/door_hinge then pick "
    "cup then close fridge/door_hinge then close oven/door_hinge",
    "view {d}/run.json --static {d}/out.html",
    "run {d}/tour.json --out {d}/out.json",
    "run {d}/plan.json --exact",
    "run {d}/plan.json --record {d}/out.gif",
    "export {d}/run.json --to hdf5 --out {d}/out.hdf5 --image-size 1280x960",
    "export {d}/run.json --to mcap --out {d}/out_mcap",
    "rank {d}/large.json fridge_0",
    "rank {d}/large.json fridge_0 --scorer deepwalk",
    "scene show {d}/large.json",
    "scene check {d}/large.json",
    "scene convert {d}/large.json {d}/out_scene.json",
    "scene scan kitchen_small --out {d}/out_scan --frames 500",
    "robot check {d}/robot.urdf",
    "scan {d}/scan --out {d}/out_scan.json",
    "solve {d}/scan open 0 --out {d}/out_solve",
    "reach build fetch --out {d}/out.reach",
    "reach eval fetch --count 10000000",
    "verify {d}/long_plan.json",
    "export {d}/long_plan.json --to csv --out {d}/out.csv",
    "scene show {d}/crates.json",
    "scene show {d}/mesh.json",
    "scene convert {d}/map.yaml {d}/out_map.json",
    "robot check {d}/links.urdf",
    "scan {d}/cloud.ply --out {d}/out_cloud.json",
    "scan {d}/cloud_text.ply --out {d}/out_cloud.json",
)
REFUSED = ("scene show {d}/crates.json", "robot check {d}/links.urdf")
"""Commands whose file is too large; refusing it must not take long either."""


def prepare(folder: Path) -> None:
    """Write the files that the commands work on."""
    for words in MADE:
        with redirect_stdout(StringIO()):
            status = momapos(words.format(d=folder).split())
        if status:
            sys.exit(f"momapos {words}: exit status {status}")
    kitchen = find_scene("kitchen_small")
    scene = json.loads(kitchen.read_text())
    side = math.ceil(math.sqrt(OBJECTS / len(scene["objects"])))
    objects = []
    for k in range(side * side):
        for one in scene["objects"]:
            x, y, z = one["pose"]["xyz"]
            at = [x + 6.0 * (k % side), y + 6.0 * (k // side), z]
            objects.append(
                {**one, "name": f"{one['name']}_{k}", "pose": {**one["pose"], "xyz": at}}
            )
    far = 6.0 * side
    floor = [[-5, -5], [far, -5], [far, far], [-5, far]]
    large = {**scene, "objects": objects, "floor": floor}
    (folder / "large.json").write_text(json.dumps(large))
    source = kitchen.with_name("kitchen_small_urdf")
    shutil.copytree(source, folder / source.name)
    (folder / "robot.urdf").symlink_to(library_file("fetch").with_name("fetch.urdf"))
    many = MAX_BYTES // (len(json.dumps(objects[-1])) + 10)
    crates = [{**objects[-1], "name": f"crate_{k}"} for k in range(many)]
    (folder / "crates.json").write_text(json.dumps({**scene, "objects": crates}))
    _write_long_plan(folder)
    _write_models(folder)
    _write_scans(folder)


def _write_long_plan(folder: Path) -> None:
    """Write a plan of many states."""
    plan = json.loads((folder / "plan.json").read_text())
    rows, times = (np.array(plan[name]) for name in ("approach", "approach_times"))
    old = np.arange(len(times))
    new = np.linspace(0, old[-1], 12_000)
    dense = np.stack([np.interp(new, old, column) for column in rows.T], axis=1)
    plan["approach"] = dense.round(8).tolist()
    plan["approach_times"] = np.interp(new, old, times).round(8).tolist()
    (folder / "long_plan.json").write_text(json.dumps(plan))


def _write_models(folder: Path) -> None:
    """Write a URDF of many links, and one of a large mesh in a scene."""
    box = '<collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision>'
    links = "".join(f'<link name="l{k}">{box}</link>' for k in range(50_001))
    joints = "".join(
        f'<joint name="j{k}" type="fixed"><parent link="l0"/><child link="l{k}"/></joint>'
        for k in range(1, 50_001)
    )
    (folder / "links.urdf").write_text(f'<robot name="links">{links}{joints}</robot>')
    points = np.random.default_rng(0).normal(size=(600_000, 3))
    faces = np.arange(len(points)).reshape(-1, 3) + 1
    (folder / "mesh.obj").write_text(
        "".join(f"v {x:.6f} {y:.6f} {z:.6f}\n" for x, y, z in points.tolist())
        + "".join(f"f {a} {b} {c}\n" for a, b, c in faces.tolist())
    )
    mesh = box.replace('box size="0.1 0.1 0.1"', 'mesh filename="mesh.obj"')
    (folder / "mesh.urdf").write_text(f'<robot name="mesh"><link name="l">{mesh}</link></robot>')
    pose = {"xyz": [0, 0, 0], "wxyz": [1, 0, 0, 0]}
    scene = {"format": "momapos-scene", "version": 1, "name": "mesh"}
    objects = [{"name": "mesh", "urdf": "mesh.urdf", "pose": pose}]
    (folder / "mesh.json").write_text(json.dumps({**scene, "objects": objects}))


def _write_scans(folder: Path) -> None:
    """Write a map and two clouds."""
    rng = np.random.default_rng(0)
    free = 254 * (rng.random((4_000, 4_000)) > 0.3).astype(np.uint8)
    (folder / "map.pgm").write_bytes(b"P5\n4000 4000\n255\n" + free.tobytes())
    (folder / "map.yaml").write_text(
        "image: map.pgm\nresolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    head = "ply\nformat {} 1.0\nelement vertex {}\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz") + "end_header\n"
    points = rng.uniform(0.0, 5.0, (20_000_000, 3)).astype("<f4")
    binary = head.format("binary_little_endian", len(points)).encode()
    (folder / "cloud.ply").write_bytes(binary + points.tobytes())
    rows = "".join(f"{x:.4f} {y:.4f} {z:.4f}\n" for x, y, z in points[:30_000].tolist())
    (folder / "cloud_text.ply").write_text(head.format("ascii", 3_000_000) + 100 * rows)


def measure(words: str, limit: float, allowed: tuple[int, ...]) -> dict[str, Any]:
    """Run a command with a time limit in a process of its own.

    Args:
        words: The command.
        limit: The time limit [s].
        allowed: Exit statuses that are right.
    """
    call = [sys.executable, "-m", "momapos", *words.split(), "--timeout", f"{limit:g}"]
    with tempfile.TemporaryFile() as errors, tempfile.TemporaryFile() as shown:
        child = subprocess.Popen(call, stdout=shown, stderr=errors)
        killer = threading.Timer(HANG, child.kill)
        killer.start()
        _, status, used = os.wait4(child.pid, 0)
        killer.cancel()
        child.returncode = os.waitstatus_to_exitcode(status)
        errors.seek(0)
        lines = errors.read().decode().splitlines()
    spent = used.ru_utime + used.ru_stime
    return {
        "command": words, "seconds": round(spent, 2), "status": child.returncode,
        "ok": child.returncode in allowed and len(lines) <= 1 and spent <= limit + ALLOWED,
        "errors": lines[-1:],
    }  # fmt: skip


def main() -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--timeout", type=float, default=2.0, help="limit of each command [s]")
    parser.add_argument("--only", default="", help="run the commands that contain this text")
    parser.add_argument("--out", type=Path, help="folder for time_limits.json")
    args = parser.parse_args()
    rows = []
    print(f"machine: {machine()}")
    with tempfile.TemporaryDirectory() as name:
        prepare(Path(name))
        for words in (words for words in COMMANDS if args.only in words):
            allowed = (0, 3, 4, *((2,) if words in REFUSED else ()))
            row = measure(words.format(d=name), args.timeout, allowed)
            rows.append({**row, "command": words})
            mark = "" if row["ok"] else "  WRONG"
            print(f"{row['seconds']:6.2f} s  {row['status']}  {words}{mark}", flush=True)
            if row["errors"] and mark:
                print(f"          {row['errors'][0]:.150}", flush=True)
    keep_rows(rows, args.out, "time_limits")
    return int(not all(row["ok"] for row in rows))


if __name__ == "__main__":
    sys.exit(main())
