"""Was the task done?"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import rotation_angle
from momapos.model.records import Motion, Task
from momapos.model.scene import SceneObject

from .config import ExecutionConfig
from .observer import Observer
from .run_record import Collision
from .simulation import Simulation

if TYPE_CHECKING:
    from jaxtyping import Float

PLACED_POSITION, PLACED_ANGLE = 0.02, np.radians(15.0)
"""A placed object may rest this far from where the scene has it [m], [rad]."""


@dataclass(frozen=True)
class TaskOutcome:
    """Whether a task was done, by which number."""

    success: bool
    reason: str
    """Why not; "" where it was."""
    start: float
    """Value of the joint at first [rad] or [m]; for loose objects the height [m]."""
    asked: float
    reached: float


def judge(
    world: Simulation,
    observer: Observer,
    task: Task,
    item: SceneObject,
    T_first: Float[np.ndarray, "4 4"],
    motion: Motion,
    config: ExecutionConfig,
    stopped: str,
) -> TaskOutcome:
    """Judge a run by the state it ended in.

    Args:
        world: At the end.
        observer: Saw all of the run.
        task: What was asked.
        item: The object, as the scene has it.
        T_first: Pose of the part or object in the beginning.
        motion: What was executed.
        config: How near is near enough.
        stopped: Why the run ended early; "" where it did not.
    """
    if observer.diverged:
        return TaskOutcome(False, stopped, 0.0, 0.0, 0.0)
    if task.joint is None:
        return _loose(world, observer, task, item, T_first, motion, config, stopped)
    assert task.to is not None
    start, reached = float(item.values()[task.joint]), float(world.data.qpos[world.part_q])
    near = abs(reached - task.to) <= config.tolerance * abs(task.to - start)
    reason = ""
    if not near or stopped:
        share = (reached - start) / (task.to - start) if task.to != start else 0.0
        reason = f"{task.joint} moved {100 * share:.0f} % of its way"
    return _verdict(reason, stopped, observer, start, task.to, reached, config)


def _loose(
    world: Simulation,
    observer: Observer,
    task: Task,
    item: SceneObject,
    T_first: Float[np.ndarray, "4 4"],
    motion: Motion,
    config: ExecutionConfig,
    stopped: str,
) -> TaskOutcome:
    """An object must be lifted and still in the hand, or rest where it belongs."""
    T, goal = world.T_world_part, item.T_world_object
    start, reached, reason = float(T_first[2, 3]), float(T[2, 3]), ""
    if task.verb == "place":
        asked = float(goal[2, 3])
        off = float(np.linalg.norm(T[:3, 3] - goal[:3, 3]))
        tilt = float(rotation_angle(T[:3, :3], goal[:3, :3]))
        if off > PLACED_POSITION or tilt > PLACED_ANGLE:
            turned = f"{np.degrees(tilt):.0f} deg"
            reason = f"{item.name} lies {100 * off:.1f} cm and {turned} from where it belongs"
    else:
        lift = float(motion.Ts_world_tool[-1, 2, 3] - motion.Ts_world_tool[0, 2, 3])
        asked = start + lift
        if observer.slip.position > config.slip:
            reason = f"{item.name} slipped {100 * observer.slip.position:.1f} cm in the hand"
        elif reached - start < (1 - config.tolerance) * lift:
            reason = f"{item.name} was lifted {100 * (reached - start):.1f} cm"
    return _verdict(reason, stopped, observer, start, asked, reached, config)


def _verdict(
    reason: str,
    stopped: str,
    observer: Observer,
    start: float,
    asked: float,
    reached: float,
    config: ExecutionConfig,
) -> TaskOutcome:
    """Put the reasons together, and name what was hit hardest: a hard hit is one of its own.

    Elements of one object do not count as hard: hulls of hollow things overlap where the things
    pass each other.
    """
    reasons = [text for text in (stopped, reason) if text]
    hard = [c for c in observer.hardest() if c.force > config.touch_force and not _of_one(c)]
    hit = (hard or observer.hardest())[:1]
    if hit and (reasons or hard):
        reasons.append(f"{hit[0].one} pushed {hit[0].other} with {hit[0].force:.0f} N")
    return TaskOutcome(not reasons, "; ".join(reasons), start, asked, reached)


def _of_one(hit: Collision) -> bool:
    """Whether two elements belong to the same piece of furniture."""
    one, other = hit.one.rpartition("/")[0], hit.other.rpartition("/")[0]
    return one == other != ""
