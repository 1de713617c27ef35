"""Replan the arm motion at base poses near the planned one: success under base pose errors."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import wrap_angle
from momapos.model.records import PlacementPlan, ReachScorer
from momapos.model.robots import Robot, opened_as
from momapos.model.scene import Scene
from momapos.planning import PipelineConfig, check_base_pose
from momapos.workflows import motion_from

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

LEVELS = ((0.02, np.radians(2.0)), (0.05, np.radians(5.0)))
"""Distance [m] and rotation [rad] of the base from its planned pose."""


def disturbed_poses(
    base: Float[np.ndarray, "3"], off: float, turn: float, count: int, rng: np.random.Generator
) -> Float[np.ndarray, "n 3"]:
    """Return base poses at one distance in evenly spread directions, turned to either side.

    Args:
        base: x [m], y [m], yaw [rad].
        off: Distance from the base [m].
        turn: Rotation from the base [rad].
        count: Number of poses.
        rng: Draws the first direction, and the sign of every rotation.
    """
    angle = 2 * np.pi * (np.arange(count) + rng.random()) / max(count, 1)
    turns = turn * rng.choice([-1.0, 1.0], count)
    yaw = wrap_angle(base[2] + turns)
    return np.column_stack([base[:2] + off * np.column_stack([np.cos(angle), np.sin(angle)]), yaw])


def works_disturbed(
    plan: PlacementPlan,
    scene: Scene,
    robot: Robot,
    reach: ReachScorer,
    *,
    count: int,
    config: PipelineConfig,
    seed: int,
) -> Bool[np.ndarray, "levels n"]:
    """Check at which disturbed base poses the replanned arm still does the task.

    Args:
        plan: A solved plan.
        scene, robot, reach: Inputs of the plan.
        count: Base poses at each level.
        config: Configuration of the planner.
        seed: Same seed, same poses.
    """
    assert plan.base_pose is not None
    base, rng = np.array(plan.base_pose), np.random.default_rng(seed)
    task, robot = replace(plan.task, farthest=False), opened_as(robot, plan.robot_rest)

    def works(pose: Float[np.ndarray, "3"]) -> bool:
        if plan.moves_base:  # as a run continues from there
            return motion_from(plan, scene, robot, pose).motion is not None
        attempt = check_base_pose(
            scene, robot, task, pose, reach, how_far=False, config=config, seed=seed
        )
        return attempt.motion is not None

    poses = [disturbed_poses(base, off, turn, count, rng) for off, turn in LEVELS]
    return np.array([[works(pose) for pose in level] for level in poses], bool)
