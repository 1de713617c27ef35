"""Measure the processor time of commands that have two seconds and need more.

    python benchmarks/time_limits.py [--timeout 2] [--only WORD] [--out DIR]

Each command does work that takes longer: large files, fine maps, long runs. It runs in a process of
its own; the processor time is that of the process and of those that it started. Exit status 1 if
a command ends with another status than 0 or 4 or with several lines of error, or takes `ALLOWED`
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

from momapos.apps.cli.main import main as momapos
from momapos.model.robots.robot_names import library_file
from momapos.model.scene.scene_names import find_scene
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
    "reach eval fetch --count 200000",
)


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


def measure(words: str, limit: float) -> dict[str, Any]:
    """Run a command with a time limit in a process of its own.

    Args:
        words: The command.
        limit: The time limit [s].
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
        "ok": child.returncode in (0, 4) and len(lines) <= 1 and spent <= limit + ALLOWED,
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
            row = measure(words.format(d=name), args.timeout)
            rows.append({**row, "command": words})
            mark = "" if row["ok"] else "  WRONG"
            print(f"{row['seconds']:6.2f} s  {row['status']}  {words}{mark}", flush=True)
            if row["errors"] and mark:
                print(f"          {row['errors'][0]:.150}", flush=True)
    keep_rows(rows, args.out, "time_limits")
    return int(not all(row["ok"] for row in rows))


if __name__ == "__main__":
    sys.exit(main())
