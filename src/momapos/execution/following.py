"""The hand moves the part that it holds, along the way that this turns out to take."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from momapos.execution.arm_control import EVERYWHERE, Reference, twist_between
from momapos.execution.avoidance import LOOK, Bounds
from momapos.execution.config import Ending, Stage
from momapos.execution.joint_estimate import JointEstimate, Learned
from momapos.geometry.transforms import invert
from momapos.trajectory import Trajectory

if TYPE_CHECKING:
    from jaxtyping import Float

    from momapos.execution.stages import Belief, ExecutionRun, Stretch


def follow_part(
    run: ExecutionRun, plan: Trajectory, stretch: Stretch, belief: Belief
) -> Ending | None:
    """Move the part as planned about the joint as the hand finds it; why that ends early."""
    config, motion = run.config, stretch.motion
    times = np.arange(len(plan)) * run.step
    values = np.interp(times, plan.state_times, motion.object_q)
    T_held, _ = run.arm.kinematics.at(run.world.data.qpos[run.world.arm_q])
    T_first, _ = run.arm.kinematics.at(plan.q[0])
    shift = T_held @ invert(T_first)  # the grasp, from where it was planned
    run.estimate = estimate = JointEstimate(belief.axis, T_held[:3, 3], config.compliance)

    planned = values - values[0]
    more = _missing(belief, T_held, T_first) if run.again else 0.0
    whole = planned[-1] if planned[-1] else 1.0

    def off_at(k: int) -> Float[np.ndarray, "4 4"]:
        """Moves what is planned of tool and part to where the estimated joint has it."""
        moved = planned[k] + more * planned[k] / whole
        return estimate.axis.moved(moved) @ shift @ belief.axis.moved(-planned[k])

    def pose_at(k: int) -> Float[np.ndarray, "4 4"]:
        """Where the tool is when the part moves about the estimated joint as planned."""
        return off_at(k) @ run.arm.kinematics.at(plan.q[k])[0]

    last = len(plan) - 1
    length = float(np.linalg.norm(np.diff(motion.Ts_world_tool[:, :3, 3], axis=0), axis=1).sum())
    extra = round(config.dwell / run.step)  # in which the arm makes up what it lags behind
    bounds: Bounds | None = None
    for i in range(len(plan) + extra):
        k = min(i, last)
        if i % LOOK == 0:
            bounds = run.surroundings.bounds(run.arm.q, float(values[k]), off_at(k))
        T, after = pose_at(k), pose_at(min(k + 1, last))
        here, _ = run.arm.kinematics.at(run.world.data.qpos[run.world.arm_q])
        farther = estimate.see(here[:3, 3])
        way = estimate.axis.way_at(here[:3, 3])
        across = EVERYWHERE - np.outer(way, way)
        twist = twist_between(T, after) / run.step
        run.arm.follow(
            Reference(plan.q[k], plan.v[k], T, twist, across, across, here[:3, 3], bounds)
        )
        ending = run.tick(Stage.MANIPULATE) or run.lost()
        if max(run.touch.pads) > 1.0 or run.world.welded:
            value = values[0] - more + estimate.value_at(here[:3, 3])
            expected = belief.axis.moved(value - values[0]) @ T_first
            off = here[:3, 3] - expected[:3, 3]
            run.learned = Learned(value, off, tuple(estimate.points))
            if farther and run.doubt is not None and run.doubt(estimate.points):
                run.arm.stop()  # with the part in the hand, or it swings on
                ending = ending or run.rest(Stage.MANIPULATE, config.settle) or Ending.OTHERWISE
        if ending is Ending.SLIPPED and _left(here, pose_at(last)) <= config.tolerance * length:
            return Ending.SLIPPED_AT_END
        if ending is not None:
            return ending
        if _at_stop(run, here, pose_at(last), length):
            run.arm.stop()
            return Ending.STOPPED_AT_END
    here, _ = run.arm.kinematics.at(run.world.data.qpos[run.world.arm_q])
    left = _left(here, pose_at(last))
    if left <= config.tolerance * length:
        return None
    run.detail = f"{100 * left:.0f} cm of {100 * length:.0f} were left"
    return Ending.BEHIND


def _missing(
    belief: Belief, T_held: Float[np.ndarray, "4 4"], T_planned: Float[np.ndarray, "4 4"]
) -> float:
    """How much farther a part that was moved before must go than planned [rad] or [m].

    What the hand holds farther back on the part's way than planned has not come so far as believed.
    """
    point, axis = T_planned[:3, 3], belief.axis
    along = float((T_held[:3, 3] - point) @ axis.way_at(point))
    return -along / axis.lever_at(point)


def _at_stop(
    run: ExecutionRun,
    here: Float[np.ndarray, "4 4"],
    goal: Float[np.ndarray, "4 4"],
    length: float,
) -> bool:
    """Whether a part resists the hand's push where its way should end.

    The arm feels it by the force at its hand alone; where the part is, it does not know.
    """
    left, distance = goal[:3, 3] - here[:3, 3], _left(here, goal)
    if not 0.0 < distance <= run.config.tolerance * length:
        return False
    push = float(-run.touch.force @ left) / distance
    if run.usual_push is None:  # weight and friction, which resist all along
        run.usual_push = max(0.0, push)
    if push - run.usual_push < run.config.control.stop_force:
        return False
    run.detail = f"{1000 * distance:.0f} mm were left"
    return True


def _left(here: Float[np.ndarray, "4 4"], goal: Float[np.ndarray, "4 4"]) -> float:
    """How far the tool is from where its way ends [m]."""
    return float(np.linalg.norm(goal[:3, 3] - here[:3, 3]))
