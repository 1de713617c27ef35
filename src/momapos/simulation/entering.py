"""Move the hand to and from a grasp or placement under force feedback."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .approach import PacedTrajectory
from .arm_control import EVERYWHERE, Reference
from .avoidance import PROXIMITY_INTERVAL, Bounds
from .base_drive import base_coordinates
from .config import (
    ARRIVING,
    BUMP_FORCE,
    HOME_TIME,
    MIN_BUMP_PATH,
    MIN_PACE,
    NEAR_GRASP,
    NEAR_SPEED,
    PATH_FORCE,
    RETRY_OFFSETS,
    SEARCH_AHEAD,
    SEARCH_BACK,
    STOP_FORCE,
    STRAIGHT_IN,
    Ending,
    Stage,
)
from .execution_run import ExecutionRun

if TYPE_CHECKING:
    from jaxtyping import Float


def come_in(run: ExecutionRun, way: PacedTrajectory) -> Ending | None:
    """Approach the grasp under force feedback, or carry an object to its placement."""
    compliance, sign = run.config.compliance, 1.0
    run.passed, steps, begin = 0.0, 0, float(run.motion.object_q[0])
    while True:
        left = float(way.left[round(run.passed)])
        near = left < NEAR_GRASP
        pace = sign * float(way.pace[round(run.passed)]) * _easing(run)
        if steps % PROXIMITY_INTERVAL == 0:
            close = way.gap[round(run.passed)] < compliance.avoid
            apart, bounds = left >= STRAIGHT_IN, None
            if close:
                stands = apart and not run.held
                bounds = run.avoidance.bounds(run.arm.q, begin, hand=apart, stands=stands)
        T, steps = _go_along(run, way, pace, bounds, stiff=near), steps + 1
        ending = run.tick(Stage.APPROACH) or run.check_grasp()
        if ending is not None:
            return ending
        if run.held and near and run.arm.wrench[2] > STOP_FORCE:
            return None  # the carried object rests on something
        if not near and np.linalg.norm(run.arm.wrench[:3]) > PATH_FORCE:
            return Ending.BLOCKED
        if sign < 0 and (left > NEAR_GRASP / 2 or run.passed == 0.0):
            sign = 1.0
        elif sign > 0 and near and left > MIN_BUMP_PATH and not run.held and _bumped(run, T):
            sign = -1.0
        elif sign > 0 and run.passed >= way.last:
            return None
        run.passed = float(np.clip(run.passed + pace, 0.0, way.last))


def reach_on(run: ExecutionRun, q: Float[np.ndarray, " n"]) -> Ending | None:
    """Move the hand ahead until it touches something or reaches the search limit, then back a bit.

    An object that is not between the fingers may be farther in than planned.

    Args:
        run: The run, with open fingers.
        q: Arm state at the planned grasp [rad] or [m].
    """
    T, _ = run.arm.kinematics.at(run.world.data.qpos[run.world.arm_q])
    ahead, still = T[:3, :3] @ run.world.hand.approach, np.zeros(len(q))
    loose, gone, sign = EVERYWHERE - np.outer(ahead, ahead), 0.0, 1.0
    speed, most = NEAR_SPEED / 2, SEARCH_AHEAD
    while sign > 0 or gone > most:
        gone += sign * speed * run.step
        there = T.copy()
        there[:3, 3] += gone * ahead
        twist = np.concatenate([sign * speed * ahead, np.zeros(3)])
        run.arm.follow(Reference(q, still, there, twist, EVERYWHERE, loose))
        ending = run.tick(Stage.GRIP)
        if ending is not None:
            return ending
        met = float(-run.arm.wrench[:3] @ ahead) > BUMP_FORCE / 2
        if sign > 0 and (met or gone >= most):
            sign, most = -1.0, gone - SEARCH_BACK
    run.forward_offset = gone * ahead
    return None


def go_between(run: ExecutionRun, way: PacedTrajectory) -> Ending | None:
    """Move the free hand from one grasp to the next, returning to the plan meanwhile."""
    offset = run.arm.q - way.plan.q[0]
    fade, steps, at = run.step / HOME_TIME, 0, 0.0
    arrives = _arrival(way)
    while at < way.last:
        pace = float(way.pace[round(at)])
        at, steps = min(at + pace, float(way.last)), steps + 1
        q, v, a = way.at(at, pace)
        base = way.base_at(at)
        if run.base is not None and base is not None:
            run.base.go(base)
        if base is not None and at >= arrives:
            if run.base is not None and at - pace < arrives:
                run.base.localize()
            _reach(run, q, v, base)
        else:
            run.arm.go(q + max(0.0, 1.0 - fade * steps) * offset, v, a)
        ending = run.tick(Stage.MANIPULATE) or run.check_grasp()
        if ending is not None:
            return ending
    return None


def _arrival(way: PacedTrajectory) -> float:
    """Return the sample from which on the hand is near the next grasp and stays near it."""
    return float(len(way.left) - np.argmax(way.left[::-1] > ARRIVING)) if way.last else 0.0


def _reach(
    run: ExecutionRun,
    q: Float[np.ndarray, " n"],
    v: Float[np.ndarray, " n"],
    base: Float[np.ndarray, "3"],
) -> None:
    """Move the hand to its planned pose, from where the base is instead of where it should be."""
    T, J = run.arm.kinematics.at(q, base_coordinates(run.world, base[None])[0])
    run.arm.follow(Reference(q, v, T, J @ v, EVERYWHERE, np.zeros((3, 3))))


def go_back(run: ExecutionRun, way: PacedTrajectory) -> Ending | None:
    """Move back along a trajectory from the arm's position on it, with compliance."""
    while True:
        pace = -float(way.pace[round(run.passed)])
        _go_along(run, way, pace, None, stiff=False)
        ending = run.tick(Stage.RETREAT)
        if ending is not None or run.passed <= 0.0:
            return ending
        run.passed = max(0.0, run.passed + pace)


def _go_along(
    run: ExecutionRun, way: PacedTrajectory, pace: float, bounds: Bounds | None, *, stiff: bool
) -> Float[np.ndarray, "4 4"]:
    """Set the arm to the current sample of the trajectory, offset by what the hand feels.

    Args:
        run: The run.
        way: The trajectory.
        pace: Samples per step.
        bounds: Joint speed bounds that keep the arm away from obstacles; None for none.
        stiff: Push ahead; otherwise slide along whatever the hand meets.

    Returns:
        Tool pose at the sample.
    """
    q, v, a = way.at(run.passed, pace)
    T, J = run.arm.kinematics.at(q)
    if bounds is None and _free(run, q):
        run.arm.go(q, v, a)
        return T
    ahead = T[:3, :3] @ run.world.hand.approach
    loose = EVERYWHERE - np.outer(ahead, ahead) if stiff else EVERYWHERE
    run.arm.follow(Reference(q, v, run.offset_pose(T), J @ v, EVERYWHERE, loose, bounds=bounds))
    return T


def _free(run: ExecutionRun, q: Float[np.ndarray, " n"]) -> bool:
    """Return whether the hand feels nothing and the arm is on the plan."""
    near = np.abs(run.arm.q + run.step * run.arm.v - q).max() < 1e-3
    return bool(near and not run.lateral_offset and np.abs(run.arm.wrench).max() < 0.1)


def _easing(run: ExecutionRun) -> float:
    """Return the share of the planned speed, lower the more force the arm feels."""
    felt = float(np.linalg.norm(run.arm.wrench[:3])) / BUMP_FORCE
    return max(MIN_PACE, 1.0 - max(felt, run.arm.load))


def _bumped(run: ExecutionRun, T: Float[np.ndarray, "4 4"]) -> bool:
    """Return whether a finger hits an object that should come between the fingers.

    The torque of the contact shows which finger; the hand comes in offset to that side next time.
    """
    approach = T[:3, :3] @ run.world.hand.approach
    force, torque = np.split(run.arm.wrench, 2)
    push = float(-force @ approach)
    if push < BUMP_FORCE or run.tries >= len(RETRY_OFFSETS):
        return False
    if not run.tries:
        lever = torque @ np.cross(approach, T[:3, :3] @ run.world.hand.axis)
        run.side = float(np.sign(lever))
    run.lateral_offset = run.side * RETRY_OFFSETS[run.tries]
    run.tries += 1
    return True
