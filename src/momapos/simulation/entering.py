"""The hand's way to what it will hold or let go, felt as it goes, and the same way back."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .approach import PacedTrajectory
from .arm_control import EVERYWHERE, Reference
from .avoidance import LOOK, Bounds
from .config import Ending, Stage

if TYPE_CHECKING:
    from jaxtyping import Float

    from .stages import ExecutionRun


def come_in(run: ExecutionRun, way: PacedTrajectory) -> Ending | None:
    """Go to the grasp and feel the way in, or carry an object to where it is let go."""
    compliance, sign = run.config.compliance, 1.0
    run.passed, steps, begin = 0.0, 0, float(run.motion.object_q[0])
    while True:
        left = float(way.left[round(run.passed)])
        near = left < compliance.near
        pace = sign * float(way.pace[round(run.passed)]) * _easing(run)
        if steps % LOOK == 0:
            close = way.gap[round(run.passed)] < compliance.avoid
            apart, bounds = left >= compliance.straight, None
            if close:
                stands = apart and not run.held
                bounds = run.surroundings.bounds(run.arm.q, begin, hand=apart, stands=stands)
        T, steps = _go_along(run, way, pace, bounds, stiff=near), steps + 1
        ending = run.tick(Stage.APPROACH) or run.lost()
        if ending is not None:
            return ending
        if run.held and near and run.arm.wrench[2] > run.config.control.stop_force:
            return None  # what is carried stands on something
        if not near and np.linalg.norm(run.arm.wrench[:3]) > compliance.way_force:
            return Ending.BLOCKED
        if sign < 0 and (left > compliance.near / 2 or run.passed == 0.0):
            sign = 1.0
        elif sign > 0 and near and left > compliance.early and not run.held and _bumped(run, T):
            sign = -1.0
        elif sign > 0 and run.passed >= way.last:
            return None
        run.passed = float(np.clip(run.passed + pace, 0.0, way.last))


def reach_on(run: ExecutionRun, q: Float[np.ndarray, " n"]) -> Ending | None:
    """Move the hand ahead until it feels something, or as far as it may search, and a little back.

    What was not between the fingers may be farther in than planned.

    Args:
        run: Under way, the fingers open.
        q: State of the arm at the planned grasp [rad] or [m].
    """
    compliance = run.config.compliance
    T, _ = run.arm.kinematics.at(run.world.data.qpos[run.world.arm_q])
    ahead, still = T[:3, :3] @ run.world.hand.approach, np.zeros(len(q))
    loose, gone, sign = EVERYWHERE - np.outer(ahead, ahead), 0.0, 1.0
    speed, most = compliance.near_speed / 2, compliance.search
    while sign > 0 or gone > most:
        gone += sign * speed * run.step
        there = T.copy()
        there[:3, 3] += gone * ahead
        twist = np.concatenate([sign * speed * ahead, np.zeros(3)])
        run.arm.follow(Reference(q, still, there, twist, EVERYWHERE, loose))
        ending = run.tick(Stage.GRIP)
        if ending is not None:
            return ending
        met = float(-run.arm.wrench[:3] @ ahead) > compliance.bump / 2
        if sign > 0 and (met or gone >= most):
            sign, most = -1.0, gone - compliance.search_back
    run.ahead = gone * ahead
    return None


def go_between(run: ExecutionRun, way: PacedTrajectory) -> Ending | None:
    """Go with a free hand from one hold to the next, and return to the plan on the way."""
    offset = run.arm.q - way.plan.q[0]
    fade, steps, at = run.step / run.config.compliance.home, 0, 0.0
    while at < way.last:
        pace = float(way.pace[round(at)])
        at, steps = min(at + pace, float(way.last)), steps + 1
        q, v, a = way.at(at, pace)
        run.arm.go(q + max(0.0, 1.0 - fade * steps) * offset, v, a)
        ending = run.tick(Stage.MANIPULATE) or run.lost()
        if ending is not None:
            return ending
    return None


def go_back(run: ExecutionRun, way: PacedTrajectory) -> Ending | None:
    """Go back along a way from where the arm is on it, giving way to what the hand feels."""
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
    """Be at a state of the way, or beside it as the hand feels.

    Args:
        run: Under way.
        way: Where to.
        pace: Samples that pass in a step.
        bounds: Of the joints' speeds, that keep the arm apart from what is near; None for none.
        stiff: Whether the hand pushes ahead; else it slides along what it meets.

    Returns:
        Pose of the tool at the state.
    """
    q, v, a = way.at(run.passed, pace)
    T, J = run.arm.kinematics.at(q)
    if bounds is None and _free(run, q):
        run.arm.go(q, v, a)
        return T
    ahead = T[:3, :3] @ run.world.hand.approach
    loose = EVERYWHERE - np.outer(ahead, ahead) if stiff else EVERYWHERE
    run.arm.follow(Reference(q, v, run.beside(T), J @ v, EVERYWHERE, loose, bounds=bounds))
    return T


def _free(run: ExecutionRun, q: Float[np.ndarray, " n"]) -> bool:
    """Whether the hand feels nothing, and the arm is where the plan has it."""
    near = np.abs(run.arm.q + run.step * run.arm.v - q).max() < 1e-3
    return bool(near and not run.aside and np.abs(run.arm.wrench).max() < 0.1)


def _easing(run: ExecutionRun) -> float:
    """Share of its speed at which the arm comes on, the less the more it feels."""
    compliance = run.config.compliance
    felt = float(np.linalg.norm(run.arm.wrench[:3])) / compliance.bump
    return max(compliance.slowest, 1.0 - max(felt, run.arm.load))


def _bumped(run: ExecutionRun, T: Float[np.ndarray, "4 4"]) -> bool:
    """Whether a finger meets something ahead that should come between the fingers.

    The torque of the push tells which finger; next time the hand comes in nearer to that side.
    """
    compliance, approach = run.config.compliance, T[:3, :3] @ run.world.hand.approach
    force, torque = np.split(run.arm.wrench, 2)
    push = float(-force @ approach)
    if push < compliance.bump or run.tries >= len(compliance.aside):
        return False
    if not run.tries:
        lever = torque @ np.cross(approach, T[:3, :3] @ run.world.hand.axis)
        run.side = float(np.sign(lever))
    run.aside = run.side * compliance.aside[run.tries]
    run.tries += 1
    return True
