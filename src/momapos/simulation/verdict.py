"""Judge whether a task was done."""

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

MAX_PLACED_OFFSET, MAX_PLACED_ANGLE = 0.02, np.radians(15.0)
"""Maximum deviation of a placed object from its goal [m], [rad]."""


@dataclass(frozen=True)
class TaskOutcome:
    """Verdict on a task, with the value it is based on."""

    success: bool
    reason: str
    """Why the task failed; "" on success."""
    start: float
    """Initial value of the joint [rad] or [m]; for movable objects the height [m]."""
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
    """Judge a run by its final state.

    Args:
        world: The world at the end.
        observer: Observations of the whole run.
        task: The task.
        item: The object, as the scene has it.
        T_first: Initial pose of the part or object.
        motion: The executed motion.
        config: Tolerances.
        stopped: Why the run ended early; "" otherwise.
    """
    if observer.diverged:
        return TaskOutcome(False, stopped, 0.0, 0.0, 0.0)
    if task.joint is None:
        reason, start, asked, reached = _judge_object(
            world, observer, task, item, T_first, motion, config
        )
    else:
        assert task.to is not None
        asked = task.to
        start, reached = float(item.values()[task.joint]), float(world.data.qpos[world.part_q])
        near = abs(reached - asked) <= config.tolerance * abs(asked - start)
        reason = ""
        if not near or stopped:
            share = (reached - start) / (asked - start) if asked != start else 0.0
            reason = f"{task.joint} moved {100 * share:.0f} % of the requested travel"
            latch = world.latch
            waits = latch is not None and not latch.turned(world.data.qpos, config.tolerance)
            if latch is not None and waits and not near:
                reason += f"; its latch {latch.joint} is not turned"
    reasons = [text for text in (stopped, reason) if text]
    # Collisions within one object do not count as hard: hulls of hollow shapes overlap where the
    # shapes pass each other.
    touched = [c for c in observer.hardest() if not is_of_one_object(c)]
    hard = [c for c in touched if c.force > config.touch_force]
    hit = (hard or observer.hardest())[:1]
    if hit and (reasons or hard):
        reasons.append(f"{hit[0].one} hit {hit[0].other} with {hit[0].force:.0f} N")
    return TaskOutcome(not reasons, "; ".join(reasons), start, asked, reached)


def _judge_object(
    world: Simulation,
    observer: Observer,
    task: Task,
    item: SceneObject,
    T_first: Float[np.ndarray, "4 4"],
    motion: Motion,
    config: ExecutionConfig,
) -> tuple[str, float, float, float]:
    """Check that an object is lifted and still in the hand, or rests at its goal.

    Returns:
        The reason of a failure, and the heights at the start, requested and reached [m].
    """
    T, goal = world.T_world_part, item.T_world_object
    start, reached, reason = float(T_first[2, 3]), float(T[2, 3]), ""
    if task.verb == "place":
        off = float(np.linalg.norm(T[:3, 3] - goal[:3, 3]))
        tilt = float(rotation_angle(T[:3, :3], goal[:3, :3]))
        if off > MAX_PLACED_OFFSET or tilt > MAX_PLACED_ANGLE:
            turned = f"{np.degrees(tilt):.0f} deg"
            reason = f"{item.name} is {100 * off:.1f} cm and {turned} from its goal"
        return reason, start, float(goal[2, 3]), reached
    lift = float(motion.Ts_world_tool[-1, 2, 3] - motion.Ts_world_tool[0, 2, 3])
    if observer.slip.position > config.slip:
        reason = f"{item.name} slipped {100 * observer.slip.position:.1f} cm in the hand"
    elif reached - start < (1 - config.tolerance) * lift:
        reason = f"{item.name} was lifted only {100 * (reached - start):.1f} cm"
    return reason, start, start + lift, reached


def is_of_one_object(hit: Collision) -> bool:
    """Return whether two elements belong to the same piece of furniture."""
    one, other = hit.one.rpartition("/")[0], hit.other.rpartition("/")[0]
    return one == other != ""
