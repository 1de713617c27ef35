"""Is this base pose feasible? One pose, all grasps, the room fully modeled."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.config import PipelineConfig
from momapos.outcomes import PoseOutcome, PoseStatus
from momapos.placement.area import BaseStatus, base_pose_status
from momapos.placement.holding import score_grasps
from momapos.placement.place import BASE_OUTCOMES
from momapos.prepare import prepare
from momapos.protocols import ReachScorer
from momapos.reachability.store import load_reach_map
from momapos.robots.robot import Robot
from momapos.scene.scene import Scene
from momapos.types import Attempt, Task

if TYPE_CHECKING:
    from jaxtyping import Float

DEFAULT = PipelineConfig()
LEAST_SCORE = 1e-6
"""Score of grasps that the reachability map calls out of reach; those that turn come last [-]."""


def check_base_pose(
    scene: Scene,
    robot: Robot,
    task: Task,
    base_pose: Float[np.ndarray, "3"] | Sequence[float],
    reach: ReachScorer | None = None,
    *,
    config: PipelineConfig = DEFAULT,
    cache_dir: Path | None = None,
    seed: int = 0,
) -> Attempt:
    """Plan the arm's motion at one base pose, or say why there is none.

    All grasps are tried, and every object of the room is modeled. Nothing is driven: whether a
    way leads to the pose does not count.

    Args:
        scene: The room.
        robot: The robot.
        task: What is to be done, see `make_task`.
        base_pose: x [m], y [m], yaw [rad].
        reach: The robot's reachability map; None to load it, or to build it at the first use.
        config: How to plan.
        cache_dir: Where maps are kept; the user's cache folder by default.
        seed: Same seed, same motion.

    Returns:
        A motion that the exact check accepts, or why there is none.

    Raises:
        TaskError: The gripper cannot hold the object.
        RobotError: The robot and the task do not fit together.
    """
    base = np.asarray(base_pose, float)
    prepared = prepare(scene, robot, task, config, clearance=0.0)
    if prepared.infeasible_reason:
        return Attempt(None, PoseOutcome(PoseStatus.TASK_INFEASIBLE, prepared.infeasible_reason))
    status = BaseStatus(base_pose_status(prepared.geometry, base[None])[0][0])
    if status != BaseStatus.CLEAR:
        return Attempt(None, BASE_OUTCOMES[status])
    if reach is None:
        reach = load_reach_map(robot, cache_dir)
    feasible = prepared.feasibility(config, seed)
    # The map is right for most poses, not for all: it orders the grasps and rules none out.
    scores = np.maximum(score_grasps(reach, base[None], prepared.geometry), LEAST_SCORE)
    turning = np.full((1, len(prepared.geometry.groups)), LEAST_SCORE / 2)
    scores = np.concatenate([scores, turning], axis=1)
    screened = feasible.screen(base[None], scores, None)
    assert screened is not None
    if screened[0].q is None:
        return Attempt(None, screened[0].outcome)
    return feasible(base, screened[0], np.argsort(-scores[0], kind="stable"))
