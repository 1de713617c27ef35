"""How far beside a base pose the robot may stand, and still do it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from momapos.base_pose import BasePoseChecks
from momapos.config import PipelineConfig
from momapos.errors import InputError
from momapos.outcomes import Tolerance
from momapos.query import PlacementQuery
from momapos.reachability.store import load_reach
from momapos.robots.robot import Robot
from momapos.robust import SAMPLES, unit_offsets, works_around
from momapos.scene.scene import Scene
from momapos.stopwatch import Stopwatch
from momapos.types import Task

if TYPE_CHECKING:
    from pathlib import Path

    from jaxtyping import Float

    from momapos.protocols import ReachScorer

DEFAULT = PipelineConfig()
RADII = (0.005, 0.01, 0.015, 0.02, 0.025, 0.03, 0.04, 0.05, 0.06, 0.08, 0.1, 0.125, 0.15)
"""Radii of discs that are asked about, smallest first [m]."""
TURN = float(np.radians(0.6) / 0.01)
"""How far it is turned at most, for each meter of the radius [rad/m]."""


def placement_tolerance(
    scene: Scene,
    robot: Robot,
    task: Task,
    base_pose: Float[np.ndarray, "3"] | Sequence[float],
    reach: ReachScorer | None = None,
    *,
    samples: int = SAMPLES,
    config: PipelineConfig = DEFAULT,
    cache_dir: Path | None = None,
    seed: int = 0,
) -> Tolerance:
    """Find the largest disc and turn around a base pose from which the motion is found anew.

    At poses drawn evenly in a disc, turned by at most 0.6 deg for each cm of its radius, the arm's
    motion is planned as `check_base_pose` does. A disc counts where it is found at all of them; the
    largest such disc is found by halving a list of radii, 5 mm to 15 cm.

    Args:
        scene: The room.
        robot: The robot.
        task: What is to be done, see `make_task`.
        base_pose: x [m], y [m], yaw [rad].
        reach: The robot's reachability map; None to load it, or to build it at the first use.
        samples: Poses in a disc [-].
        config: How to plan.
        cache_dir: Where maps are kept; the user's cache folder by default.
        seed: Same seed, same poses.

    Raises:
        TaskError: The gripper cannot hold the object.
        RobotError: The robot and the task do not fit together.
        InputError: There are no samples.
    """
    if samples < 1:
        raise InputError(f"samples must be at least 1, not {samples}")
    if reach is None:
        reach = load_reach(robot, cache_dir)
    watch = Stopwatch(lambda: 0.0)
    query = PlacementQuery(scene, robot, task, reach, None, None, config, seed, watch)
    checks = BasePoseChecks(query)
    offsets = unit_offsets(samples, np.random.default_rng(seed))
    base = np.asarray(base_pose, float)

    def holds(radius: float) -> bool:
        scale = radius * np.array([1.0, 1.0, TURN])
        return works_around(checks, base, offsets * scale)

    known, beyond = 0, len(RADII) + 1  # discs that hold, counted from 1; the first that does not
    while beyond - known > 1:
        middle = (known + beyond) // 2
        if holds(RADII[middle - 1]):
            known = middle
        else:
            beyond = middle
    radius = 0.0 if known == 0 else RADII[known - 1]
    return Tolerance(radius, radius * TURN, samples)
