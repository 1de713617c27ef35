"""Compiling the kernels, once after installation.

Compiling keeps one core busy, so two processes share the work: this one compiles the exact check
and answers a small question, a helper compiles what finds the arm's path and the way of the base.
They meet in numba's cache on disk, where each finds what the other has finished; without the
helper, this process compiles it all.
"""

from __future__ import annotations

import contextlib
import gc
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from importlib import metadata
from pathlib import Path

import numpy as np

import momapos
from momapos.cache import Cache, content_key
from momapos.cli.compile_arm import way_round_a_corner
from momapos.config import PipelineConfig
from momapos.pipeline import plan_base_placement
from momapos.protocols import ReachScorer
from momapos.robots.robot import Robot
from momapos.scene.scene import Scene
from momapos.types import Motion, Task
from momapos.verification.exact import PlanVerifier


def compile_once(
    scene: Scene,
    robot: Robot,
    task: Task,
    reach: ReachScorer,
    start: np.ndarray | None,
    cache_dir: Path,
) -> None:
    """Compile the kernels where that has not been done yet, so that no timeout pays for it.

    A stamp in the cache folder says that it has; it names the versions and the package's place.
    """
    parts = [metadata.version(name) for name in ("momapos", "numba", "numpy")]
    key = f"compiled-{content_key(*parts, sys.version, momapos.__file__)}"
    cache = Cache(cache_dir)
    if cache.get(key) is not None:
        return
    print("momapos: compiling, once after installation (about half a minute)", file=sys.stderr)
    plain = PipelineConfig()
    small = replace(plain.place, count=128, rounds=1, improve=0, grid_cell=0.5, grid_turn=90.0)
    config = replace(plain, place=small, timeout=3600.0)
    with _helper(), _no_collector():
        _check_at_rest(scene, robot, task)
        plan_base_placement(scene, robot, task, reach, start=start, config=config)
        way_round_a_corner()
    with contextlib.suppress(OSError):
        cache.put(key, b"done")


def _check_at_rest(scene: Scene, robot: Robot, task: Task) -> None:
    """Check an arm that stands still at the origin: whatever comes of it, the kernels are compiled.

    The helper meanwhile compiles what a search needs next.
    """
    q = np.tile(robot.home, (2, 1))
    still = Motion(q, q, np.zeros(2), robot.chain.tool_poses(q))
    PlanVerifier(scene, robot, task).check((0.0, 0.0, 0.0), still)


@contextlib.contextmanager
def _helper() -> Iterator[None]:
    """Have a second, silent process compile meanwhile, if one can be started."""
    # -P: no module of that name in the current folder is taken for ours.
    command = [sys.executable, "-P", "-m", "momapos.cli.compile_arm"]
    none = subprocess.DEVNULL
    process = None
    if sys.executable:
        with contextlib.suppress(OSError):
            process = subprocess.Popen(command, stdin=none, stdout=none, stderr=none)
    try:
        yield
    finally:
        if process is not None:
            process.kill()
            process.wait()


@contextlib.contextmanager
def _no_collector() -> Iterator[None]:
    """Keep Python from looking for dead cycles among numba's many objects: a tenth of the time."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()
