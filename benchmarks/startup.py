"""Measure the processor time of whole commands, user and system, including children.

Warm commands run once before the measurement. First answers are measured once each: from a clone (a
copy of the source tree without caches) and from a wheel that is built and unpacked first.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path

ROOT = Path(__file__).parents[1]
PLACE = ["place", "open", "kitchen_small", "fridge/door_hinge", "--robot", "segway_ur5e"]
WARM = (
    ["--help"],
    ["robot", "list"],
    ["scene", "list"],
    ["robot", "show", "fetch"],
    ["scene", "show", "kitchen_small"],
    ["rank", "kitchen_small", "fridge"],
    ["verify", "PLAN"],
    PLACE,
)


def processor_time(command: list[str], source: Path, cache: Path) -> float:
    """Return the processor time of a momapos command with the package in `source` [s].

    Raises:
        subprocess.CalledProcessError: The command failed.
    """
    paths = [str(source), os.environ.get("PYTHONPATH", "")]
    # Without stored byte code, Python would compile all modules at every start.
    kept = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    environment = {
        **kept,
        "PYTHONPATH": os.pathsep.join(filter(None, paths)),
        "MOMAPOS_CACHE": str(cache),
    }
    call = [sys.executable, "-c", "from momapos.apps.cli.main import entry; entry()", *command]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(call, env=environment, cwd=cache.parent, check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def warm(command: list[str], folder: Path, repeats: int) -> float:
    """Return the median of some runs after one that is not counted [s]."""
    cache = folder / "cache"
    plan = folder / "plan.json"
    command = [str(plan) if word == "PLAN" else word for word in command]
    times = [processor_time(command, ROOT / "src", cache) for _ in range(repeats + 1)]
    return statistics.median(times[1:])


def first_from_clone(folder: Path) -> float:
    """Return the time of the first answer of a new source tree [s]."""
    source = folder / "clone"
    ignored = shutil.ignore_patterns("__pycache__", "kernels.zip")
    shutil.copytree(ROOT / "src", source, ignore=ignored)
    return processor_time(PLACE, source, folder / "clone_cache")


def first_from_wheel(folder: Path) -> float | None:
    """Return the time of the first answer of a wheel [s]; None without compiled kernels."""
    build = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir"]
    done = subprocess.run([*build, str(folder), str(ROOT)], capture_output=True, text=True)
    wheels = list(folder.glob("*.whl"))
    if done.returncode or not wheels:
        print(f"no wheel: {done.stderr.strip().splitlines()[-1:]}", file=sys.stderr)
        return None
    with zipfile.ZipFile(wheels[0]) as wheel:
        if "momapos/core/compiled/kernels.zip" not in wheel.namelist():
            print("the wheel has no compiled kernels", file=sys.stderr)
            return None
        wheel.extractall(folder / "site")
    return processor_time(PLACE, folder / "site", folder / "wheel_cache")


def measure(repeats: int) -> Mapping[str, float | None]:
    """Return the time of each command [s]."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        processor_time([*PLACE, "--out", str(folder / "plan.json")], ROOT / "src", folder / "cache")
        found: dict[str, float | None] = {}
        for command in WARM:
            found[" ".join(command)] = warm(command, folder, repeats)
        found["first place, clone"] = first_from_clone(folder)
        found["first place, wheel"] = first_from_wheel(folder)
        return found


def main() -> None:
    """Print the table, and optionally write it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=3, help="number of runs of a warm command")
    parser.add_argument("--out", type=Path, help="JSON file for the times")
    args = parser.parse_args()
    found = measure(args.repeats)
    for name, seconds in found.items():
        print(f"{name:<66} {'-' if seconds is None else f'{seconds:6.2f} s'}")
    if args.out is not None:
        args.out.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
