"""Measure the processor time of whole commands, user and system, including children.

Warm commands run once before the measurement. First answers are measured once each: from a clone (a
copy of the source tree without caches) and from a wheel that is built and unpacked first.
"""

from __future__ import annotations

import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

from rows import child, commands

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
    """Return the processor time of a momapos command with the package in `source` [s]."""
    paths = [str(source), os.environ.get("PYTHONPATH", "")]
    # Without stored byte code, Python would compile all modules at every start.
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    environment |= {"PYTHONPATH": os.pathsep.join(filter(None, paths)), "MOMAPOS_CACHE": str(cache)}
    call = [sys.executable, "-c", "from momapos.apps.cli.main import entry; entry()", *command]
    null = subprocess.DEVNULL
    status, _, spent, _ = child(call, env=environment, cwd=cache.parent, stdout=null, stderr=null)
    if status:
        sys.exit(f"momapos {' '.join(command)}: exit status {status}")
    return spent


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


def main(repeats: int = 3, out: Path | None = None) -> None:
    """Print the table, and optionally write it.

    Args:
        repeats: Number of runs of a warm command.
        out: JSON file for the times.
    """
    found: dict[str, float | None] = {}
    with tempfile.TemporaryDirectory() as name:
        folder, source = Path(name), ROOT / "src"
        plan, cache = str(folder / "plan.json"), folder / "cache"
        processor_time([*PLACE, "--out", plan], source, cache)
        for command in WARM:
            words = [plan if word == "PLAN" else word for word in command]
            times = [processor_time(words, source, cache) for _ in range(repeats + 1)]
            found[" ".join(command)] = statistics.median(times[1:])
        found["first place, clone"] = first_from_clone(folder)
        found["first place, wheel"] = first_from_wheel(folder)
    for label, seconds in found.items():
        print(f"{label:<66} {'-' if seconds is None else f'{seconds:6.2f} s'}")
    if out is not None:
        out.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    commands(__doc__, main)
