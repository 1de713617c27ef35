"""Whether the arm still does it where the base stands a little off: success under base errors."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import wrap_angle
from momapos.model.records import PlacementPlan, ReachScorer
from momapos.model.robots import Robot
from momapos.model.scene import Scene
from momapos.planning import PipelineConfig, check_base_pose

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

LEVELS = ((0.02, np.radians(2.0)), (0.05, np.radians(5.0)))
"""How far off the base stands [m], and how far it is turned [rad]."""


def disturbed_poses(
    base: Float[np.ndarray, "3"], off: float, turn: float, count: int, rng: np.random.Generator
) -> Float[np.ndarray, "n 3"]:
    """Base poses that are all so far off, in directions spread evenly, and turned either way.

    Args:
        base: x [m], y [m], yaw [rad].
        off: Distance from there [m].
        turn: Turn from there [rad].
        count: How many.
        rng: Draws the first direction, and the way of every turn.
    """
    way = 2 * np.pi * (np.arange(count) + rng.random()) / max(count, 1)
    turns = turn * rng.choice([-1.0, 1.0], count)
    yaw = wrap_angle(base[2] + turns)
    return np.column_stack([base[:2] + off * np.column_stack([np.cos(way), np.sin(way)]), yaw])


def still_does(
    plan: PlacementPlan,
    scene: Scene,
    robot: Robot,
    reach: ReachScorer,
    *,
    count: int,
    config: PipelineConfig,
    seed: int,
) -> Bool[np.ndarray, "levels n"]:
    """Whether the arm, planned anew at disturbed base poses, does what was planned.

    Args:
        plan: A solved plan.
        scene, robot, reach: What it was made for.
        count: Base poses at each level.
        config: How the arm's motion is planned.
        seed: Same seed, same poses.
    """
    assert plan.base_pose is not None
    base, rng = np.array(plan.base_pose), np.random.default_rng(seed)
    task = replace(plan.task, farthest=False)

    def holds(pose: Float[np.ndarray, "3"]) -> bool:
        attempt = check_base_pose(
            scene, robot, task, pose, reach, how_far=False, config=config, seed=seed
        )
        return attempt.motion is not None

    poses = [disturbed_poses(base, off, turn, count, rng) for off, turn in LEVELS]
    return np.array([[holds(pose) for pose in level] for level in poses], bool)
