"""Run all benchmarks, one after the other, as `make bench` does."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from pathlib import Path

from placement import shared

HERE = Path(__file__).parent
ROBOTS = ["robots.py", "bench_out/packages", "--get", "--table", "--place", "2"]
RUNS = (
    ["startup.py"],
    ["reach.py"],
    ["inverse.py"],
    ["self_collision.py"],
    [*ROBOTS, "--out", "bench_out/robots"],
    ["placement.py", "--out", "bench_out"],
    ["placement.py", "--exhaustive", "--out", "bench_out/grid"],
    ["execution.py", "--out", "bench_out"],
    ["objects.py", "--out", "bench_out"],
    ["mutations.py", "--out", "bench_out"],
    ["objects.py", "--families", "--out", "bench_out"],
    ["completeness.py", "--out", "bench_out"],
    ["paper_tasks.py", "--methods", "ours", "paper", "--out", "bench_out"],
    ["drive.py"],
    ["boxes.py", "bench_out/boxes", "--count", "6", "--shared"],
    ["parts.py", "--shared", str(shared())],
    ["modeling_error.py", "--out", "bench_out"],
    ["scan.py", "--rooms", "17", "--out", "bench_out"],
    ["page.py"],
    ["scaling.py"],
    ["importance.py"],
    ["importance_answers.py"],
    ["importance_truth.py", "--rooms", "3", "--targets", "1"],  # all: 60 rooms, 2 targets
)

if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__).parse_args()
    environment = {**os.environ, "PYTHONPATH": str(HERE.parent)}  # for training/
    for script, *args in RUNS:
        print(f"== {script} {' '.join(args)}", flush=True)
        command = [sys.executable, str(HERE / script), *args]
        subprocess.run(command, check=True, cwd=HERE.parent, env=environment)
