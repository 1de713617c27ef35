"""Carry a motion out stage by stage: settle, approach, grasp, move the part, dwell."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from momapos.core.geometry import rotation_angle
from momapos.model.records import Hold, Motion

from .approach import PacedTrajectory
from .config import AT_END, DWELL_TIME, GRIP_TIME, SETTLE_TIME, WELD_REACH, Ending, Stage
from .entering import come_in, go_between, reach_on
from .execution_run import ExecutionRun, Stretch
from .following import follow_part, turn_latch

MAX_GRASP_OFFSET, MAX_GRASP_ANGLE = 0.03, np.radians(15.0)
"""Maximum deviation of the hand from the planned grasp at which it closes [m], [rad]."""


def carry_out(run: ExecutionRun, approach: PacedTrajectory, stretches: Sequence[Stretch]) -> Ending:
    """Carry out the motion until it is done or cannot go on."""
    place = run.task.verb == "place"
    if place:
        run.observer.hold()
    ending = run.rest(Stage.SETTLE, SETTLE_TIME)
    if place and run.config.hold == "contact":
        ending = ending or run.close_fingers(run.arm.q, gives=False)
        run.world.release()
    ending = ending or come_in(run, approach)
    for index, stretch in enumerate(stretches):
        free = place or (stretch.hold is None and run.belief is not None)
        comes = stretch.hold is None and index == 0  # the hand has held nothing yet
        if not (stretch.goes_on or comes):
            ending = ending or (
                run.let_go() if free else grasp_here(run, stretch.motion, stretch.hold)
            )
        ending = ending or _move(run, stretch)
    if ending not in (None, *AT_END):
        return ending
    return run.rest(Stage.DWELL, DWELL_TIME) or ending or Ending.DONE


def grasp_here(
    run: ExecutionRun, motion: Motion, hold: Hold | None, *, searches: bool = True
) -> Ending | None:
    """Weld, or close the fingers, if the arm is at the planned grasp.

    Args:
        run: The run.
        motion: The section of the motion that begins with the grasp.
        hold: The hold; None for a movable object.
        searches: Let the hand search ahead if nothing is between the fingers.
    """
    T, _ = run.arm.kinematics.at(run.world.data.qpos[run.world.arm_q])
    planned = motion.Ts_world_tool[0]
    # For the first grasp the hand comes in offset from the plan; for later ones it is back on the
    # plan, and closing fingers shift it again: the part is still where the hand found it.
    goals = planned[:3, 3], run.offset_pose(planned)[:3, 3]
    off = float(min(np.linalg.norm(T[:3, 3] - goal) for goal in goals))
    angle = float(rotation_angle(T[:3, :3], planned[:3, :3]))
    if off > MAX_GRASP_OFFSET or angle > MAX_GRASP_ANGLE:
        run.detail = f"it is off by {100 * off:.1f} cm and {np.degrees(angle):.0f} deg"
        return Ending.ASTRAY
    run.observer.reaching = False
    family = "" if hold is None else hold.family
    if run.config.hold == "contact":
        if family == "push":
            return None
        q, one_sided = motion.q[0], family == "hook"
        ending = run.close_fingers(q, one_sided=one_sided)
        if searches and ending is Ending.NOTHING_HELD and run.belief is not None:
            run.command_fingers(0.0)
            ending = run.rest(Stage.GRIP, GRIP_TIME)
            ending = ending or reach_on(run, q) or run.close_fingers(q, one_sided=one_sided)
    else:
        gap = run.world.grip_gap(1.0)
        if gap > WELD_REACH:
            run.detail = f"the gripper is {100 * gap:.1f} cm from it"
            return Ending.OUT_OF_REACH
        run.world.attach(turns=hold is not None and hold.turn_axis is not None)
        ending = run.rest(Stage.GRIP, GRIP_TIME)
    run.held = True
    run.observer.hold()
    return ending


def _move(run: ExecutionRun, stretch: Stretch) -> Ending | None:
    """Move the grasped object along its planned path, or along the path that its joint allows."""
    plan = stretch.plan
    if stretch.between is not None:
        return go_between(run, stretch.between)
    if stretch.turns_latch:
        return turn_latch(run, plan)
    if run.belief is None or not run.belief.alone or stretch.hold is None:
        offset = run.arm.q - plan.q[0]  # keep the object as it came into the hand
        for k, (q, v, a) in enumerate(zip(plan.q, plan.v, plan.a, strict=True)):
            run.send_base(plan, k)
            run.arm.go(q + offset, v, a)
            ending = run.tick(Stage.MANIPULATE) or run.check_grasp()
            if ending is not None:
                return ending
        return None
    return follow_part(run, plan, stretch, run.belief)
