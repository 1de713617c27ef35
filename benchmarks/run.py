"""Run all benchmarks, one after the other, as `make bench` does."""

from __future__ import annotations

import argparse
import os
import shlex
import subprocess
import sys
from pathlib import Path

from placement import shared

HERE = Path(__file__).parent
RUNS = (
    "startup.py",
    "reach.py",
    "inverse.py",
    "robots.py self-collision",
    "robots.py check bench_out/packages --get --table --place 2 --out bench_out/robots",
    "placement.py --out bench_out",
    "placement.py --exhaustive --out bench_out/grid",
    "execution.py --out bench_out",
    "objects.py --out bench_out",
    "mutations.py corrupted --out bench_out",
    "objects.py --families --out bench_out",
    "answers.py completeness --out bench_out",
    "drive.py",
    "perception.py boxes bench_out/boxes --count 6 --shared",
    f"parts.py --shared {shlex.quote(str(shared()))}",
    "modeling_error.py --out bench_out",
    "scan.py kitchens --rooms 17 --out bench_out",
    "page.py start",
    "page.py drag",
    "scaling.py",
    "importance.py ranking",
    "importance.py answers",
    "importance.py truth --rooms 3 --targets 1",  # all: 60 rooms, 2 targets
)

if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__).parse_args()
    environment = {**os.environ, "PYTHONPATH": str(HERE.parent)}  # for training/
    for command in RUNS:
        print(f"== {command}", flush=True)
        script, *words = shlex.split(command)
        line = [sys.executable, str(HERE / script), *words]
        subprocess.run(line, check=True, cwd=HERE.parent, env=environment)
