"""Carry a motion out stage by stage: settle, approach, grasp, move the part, dwell, retreat."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import invert, rotation_angle
from momapos.model import Trajectory, time_motion
from momapos.model.records import Family, Hold, Motion, Task
from momapos.model.robots import Robot

from .arm_control import (
    EVERYWHERE,
    PROXIMITY_INTERVAL,
    Bounds,
    PacedTrajectory,
    Reference,
    pace_trajectory,
    twist_between,
)
from .base_drive import base_coordinates
from .config import (
    ARRIVING,
    AT_END,
    BASE_CLEARANCE,
    BUMP_FORCE,
    DWELL_TIME,
    GRIP_TIME,
    HOME_TIME,
    MIN_BUMP_PATH,
    MIN_PACE,
    NEAR_GRASP,
    NEAR_SPEED,
    NOTICED_FORCE,
    PATH_FORCE,
    PRESS_SPEED,
    PRESS_TIME,
    PRESS_TRAVEL,
    RETRY_OFFSETS,
    SEARCH_AHEAD,
    SEARCH_BACK,
    SETTLE_TIME,
    STOP_FORCE,
    STRAIGHT_IN,
    WELD_REACH,
    Ending,
    Stage,
)
from .execution_run import BelievedJoint, ExecutionRun, Stretch
from .joint_estimate import JointEstimate, LearnedPart

if TYPE_CHECKING:
    from typing import TypeAlias

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


def presses(task: Task, motion: Motion) -> bool:
    """Check whether a section of a motion presses a part that travels no farther than a button."""
    moved = np.linalg.norm(np.diff(motion.Ts_world_tool[:, :3, 3], axis=0), axis=1).sum()
    return task.verb == "press" and bool(moved < PRESS_TRAVEL)


def press_in(run: ExecutionRun) -> Ending | None:
    """Move the fingertips ahead until the part stops them; return an early ending, or None.

    A button moves by millimeters, less than the base misses its pose by. So the hand feels where
    the button is, and where it ends, instead of following the plan.

    Args:
        run: The run, with the hand at the planned contact.
    """
    q = run.world.data.qpos[run.world.arm_q].copy()
    T, _ = run.arm.kinematics.at(q)
    ahead, still = T[:3, :3] @ run.world.hand.approach, np.zeros(len(q))
    across, gone, firm = EVERYWHERE - np.outer(ahead, ahead), 0.0, 0
    while gone < PRESS_TRAVEL:
        there = T.copy()
        there[:3, 3] += gone * ahead
        twist = np.concatenate([PRESS_SPEED * ahead, np.zeros(3)])
        run.arm.follow(Reference(q, still, there, twist, EVERYWHERE, across))
        ending = run.tick(Stage.MANIPULATE)
        if ending is not None:
            return ending
        push = float(-run.arm.wrench[:3] @ ahead)
        firm = firm + 1 if push > run.press_force else 0
        if firm * run.step >= PRESS_TIME:
            return None
        gone += PRESS_SPEED * run.step
    return Ending.NOTHING_MET


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


_MAX_RETURN_SLIP = 0.02
"""Maximum slip of the hand along a part that it brings back [m]."""


def follow_part(
    run: ExecutionRun, plan: Trajectory, stretch: Stretch, belief: BelievedJoint
) -> Ending | None:
    """Move the part about its estimated joint as planned; return an early ending, or None."""
    way = _PartWay(run, plan, stretch, belief)
    extra = round(DWELL_TIME / run.step)  # time for the arm to make up its lag
    for i in range(len(plan) + extra):
        ending = way.step(i)
        if ending is Ending.OTHERWISE and not stretch.pushes:
            way.bring_back()
        if ending is not None:
            return ending
    return way.end()


def turn_latch(run: ExecutionRun, plan: Trajectory) -> Ending | None:
    """Turn the latch of a part as planned; return an early ending, or None.

    The hand keeps the pose in the latch that it found, and is compliant across its path.
    """
    T_held = run.arm.kinematics.at(run.world.data.qpos[run.world.arm_q])[0]
    T_first_held = invert(run.arm.kinematics.at(plan.q[0])[0]) @ T_held
    last, goal = len(plan) - 1, T_held
    for i in range(1, len(plan) + round(DWELL_TIME / run.step)):
        k, before = min(i, last), goal
        goal = run.arm.kinematics.at(plan.q[k])[0] @ T_first_held
        twist = twist_between(before, goal) / run.step
        way = twist[:3] / max(float(np.linalg.norm(twist[:3])), 1e-9)
        across = EVERYWHERE - np.outer(way, way)
        here = run.arm.kinematics.at(run.world.data.qpos[run.world.arm_q])[0][:3, 3]
        run.arm.follow(Reference(plan.q[k], plan.v[k], goal, twist, across, across, here))
        ending = run.tick(Stage.MANIPULATE) or run.check_grasp()
        if ending is not None:
            return ending
    return None


class _PartWay:
    """Path of a part under the hand, and what the hand learns about its joint."""

    def __init__(
        self, run: ExecutionRun, plan: Trajectory, stretch: Stretch, belief: BelievedJoint
    ) -> None:
        self.run, self.plan, self.belief, motion = run, plan, belief, stretch.motion
        times = np.arange(len(plan)) * run.step
        self.values = np.interp(times, plan.state_times, motion.object_q)
        T_held = self._hand()
        self.T_first = run.planned_tool(plan, 0)
        self.shift = T_held @ invert(self.T_first)  # offset of the grasp from the plan
        run.estimate = self.estimate = JointEstimate(
            belief.axis, T_held[:3, 3], run.config.compliance
        )
        self.planned = self.values - self.values[0]
        self.more = _missing(belief, T_held, self.T_first) if run.again else 0.0
        self.whole = self.planned[-1] if self.planned[-1] else 1.0
        self.last = len(plan) - 1
        tools = motion.Ts_world_tool[:, :3, 3]
        own = float(np.linalg.norm(np.diff(tools, axis=0), axis=1).sum())
        every = np.abs(np.diff(run.motion.object_q)).sum() / abs(self.whole)
        self.length = own * max(1.0, float(every))
        """Length of the hand's path if it moved the part all the way [m]: a stop between two holds
        may be as far off as the end."""
        self.bounds: Bounds | None = None
        self.pushes, self.most_felt = stretch.pushes, 0.0
        self.trail = [(run.world.data.qpos[run.world.arm_q].copy(), T_held)]
        """Arm states and tool poses on the path, `PROXIMITY_INTERVAL` steps apart."""
        self.passed = [0]
        """Samples of the plan at which they are."""
        self.drives = plan.base is not None and bool(np.ptp(plan.base, axis=0).any())
        self.traveled = 0.0 if run.base is None else run.base.traveled
        """Length of the base's way when the hand took hold [m]."""
        self.sample = 0
        """Sample of the plan at which the arm is: the base may be late."""

    def _hand(self) -> Float[np.ndarray, "4 4"]:
        return self.run.arm.kinematics.at(self.run.world.data.qpos[self.run.world.arm_q])[0]

    def _off_at(self, k: int) -> Float[np.ndarray, "4 4"]:
        """Return the transform from planned to estimated poses of tool and part."""
        moved = self.planned[k] + self.more * self.planned[k] / self.whole
        return (
            self.estimate.axis.moved(moved) @ self.shift @ self.belief.axis.moved(-self.planned[k])
        )

    def _pose_at(self, k: int) -> Float[np.ndarray, "4 4"]:
        """Return the tool pose for the planned part motion about the estimated joint."""
        return self._off_at(k) @ self.run.planned_tool(self.plan, k)

    @property
    def _doubt(self) -> float:
        """Standard deviation of where the robot is, since the hand took hold [m]."""
        return 0.0 if self.run.base is None else self.run.base.doubt_since(self.traveled)

    def _near_end(self, here: Float[np.ndarray, "4 4"]) -> bool:
        """Return whether the remaining path is within the tolerance."""
        return _left(here, self._pose_at(self.last)) <= self.run.config.tolerance * self.length

    def step(self, i: int) -> Ending | None:
        """Advance by one control step; return an early ending, or None."""
        run, plan = self.run, self.plan
        run.send_base(plan, min(i, self.last))
        k = self.sample = run.reached_sample(plan, min(i, self.last), self.sample)
        if i % PROXIMITY_INTERVAL == 0:
            value, after = self.values[k], self.values[min(k + 1, self.last)]
            self.bounds = run.avoidance.bounds(
                run.arm.q, float(value), self._off_at(k), part_speed=float(after - value) / run.step
            )
        T, T_after = self._pose_at(k), self._pose_at(min(k + 1, self.last))
        here = self._hand()
        if i % PROXIMITY_INTERVAL == 0 and self._meets_robot(k):
            run.stop()
            return Ending.STOPPED_AT_END if self._near_end(here) else Ending.MEETS_ROBOT
        farther = self.estimate.see(here[:3, 3], self._doubt)
        way = self.estimate.axis.way_at(here[:3, 3])
        across = EVERYWHERE - np.outer(way, way)
        twist = twist_between(T, T_after) / run.step
        run.arm.follow(
            Reference(plan.q[k], plan.v[k], T, twist, across, across, here[:3, 3], self.bounds)
        )
        if run.base is not None and self.drives:
            run.base.relieve(run.arm.missing)
        ending = run.tick(Stage.MANIPULATE) or run.check_grasp()
        self.most_felt = max(self.most_felt, run.touch.size[0])
        if i % PROXIMITY_INTERVAL == 0:
            self.trail.append((run.world.data.qpos[run.world.arm_q].copy(), here))
            self.passed.append(k)
        if max(run.touch.pads) > 1.0 or run.world.welded:
            run.learned = self._learned(here[:3, 3])
            if farther and run.doubt is not None and run.doubt(self.estimate.points):
                run.stop()  # hold the part, which would swing on otherwise
                settled = run.rest(Stage.MANIPULATE, SETTLE_TIME)
                ending = ending or settled or Ending.OTHERWISE
        if ending is Ending.SLIPPED and self._near_end(here):
            return Ending.SLIPPED_AT_END
        if ending is Ending.TOO_HARD and run.tipping.leans and self._near_end(here):
            run.stop()  # it need not pull on
            return Ending.STOPPED_AT_END
        if ending is None and _at_stop(run, here, self._pose_at(self.last), self.length):
            run.stop()
            return Ending.STOPPED_AT_END
        return ending

    def bring_back(self) -> None:
        """Bring the part back to where the hand grasped it, as long as the hand holds it.

        The joint is in doubt here, so the part's position after release would be, too; its initial
        position is known. The hand retraces its path, compliant across it, and stops where the part
        resists: the part is back, and the hand has slipped on it.
        """
        run, still, start = self.run, np.zeros_like(self.run.arm.q), self.trail[0][1][:3, 3]
        way_back = zip(pairwise(self.trail), pairwise(self.passed), strict=True)
        for ((q, T), (_, T_after)), (sample, after) in reversed(list(way_back)):
            twist = twist_between(T_after, T) / (PROXIMITY_INTERVAL * run.step)
            way = twist[:3] / max(float(np.linalg.norm(twist[:3])), 1e-9)
            across = EVERYWHERE - np.outer(way, way)
            for k in range(PROXIMITY_INTERVAL):
                run.send_base(self.plan, max(sample, after - k - 1))
                goal = T_after + (k + 1) / PROXIMITY_INTERVAL * (T - T_after)
                here = self._hand()[:3, 3]
                run.arm.follow(Reference(q, still, goal, twist, across, across, here))
                if run.tick(Stage.MANIPULATE) is not None or run.check_grasp() is not None:
                    return
            resists = -run.arm.wrench[:3] @ way > STOP_FORCE
            if resists:
                run.stop()
                if np.linalg.norm(here - start) > _MAX_RETURN_SLIP:
                    return
                here = start
            self.estimate.see(here, self._doubt)
            run.learned = self._learned(here)
            if resists:
                return

    def _meets_robot(self, k: int) -> bool:
        """Return whether the part, on its estimated path, reaches the base or a cornered arm."""
        avoidance, compliance = self.run.avoidance, self.run.config.compliance
        base, arm = avoidance.part_gaps
        if min(base, arm) < compliance.apart:
            return True
        if base > BASE_CLEARANCE:
            return False
        planned, _ = avoidance.gaps(self.run.arm.q, float(self.values[k]))
        return base < planned - compliance.apart

    def _learned(self, point: Float[np.ndarray, "3"]) -> LearnedPart:
        """Return the state of the part for a position of the hand."""
        axis, belief, first = self.estimate.axis, self.belief, self.values[0]
        value = first - self.more + self.estimate.value_at(point)
        closed = belief.axis.moved(belief.closed - first) @ self.T_first
        expected = axis.moved(value - belief.closed) @ closed
        return LearnedPart(value, axis, point - expected[:3, 3], tuple(self.estimate.points))

    def end(self) -> Ending | None:
        """Return how the path ends after its last step."""
        if self.pushes and self.most_felt < NOTICED_FORCE:
            if self.run.learned is not None:  # most parts that were pushed away fall closed
                self.run.learned = replace(self.run.learned, value=self.belief.closed)
            return Ending.NOTHING_MET
        here = self._hand()
        if self._near_end(here):
            return None
        left = _left(here, self._pose_at(self.last))
        self.run.detail = f"{100 * left:.0f} cm of {100 * self.length:.0f} cm left"
        return Ending.BEHIND


def _missing(
    belief: BelievedJoint, T_held: Float[np.ndarray, "4 4"], T_planned: Float[np.ndarray, "4 4"]
) -> float:
    """Return how much farther than planned a part must move that was moved before [rad] or [m].

    A grasp farther back on the part's path than planned means that the part is less far open.
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
    """Return whether a part resists the hand at the end of its path.

    The arm judges by the force at its hand alone; it does not know where the part is.
    """
    left, distance = goal[:3, 3] - here[:3, 3], _left(here, goal)
    if not 0.0 < distance <= run.config.tolerance * length:
        return False
    push = float(-run.touch.force @ left) / distance
    if run.usual_push is None:  # weight and friction, which resist all along the path
        run.usual_push = max(0.0, push)
    if push - run.usual_push < STOP_FORCE:
        return False
    run.detail = f"{1000 * distance:.0f} mm left"
    return True


def _left(here: Float[np.ndarray, "4 4"], goal: Float[np.ndarray, "4 4"]) -> float:
    return float(np.linalg.norm(goal[:3, 3] - here[:3, 3]))


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
    family = Family.UNSTATED if hold is None else hold.kind
    if hold is not None and hold.kind is Family.PUSH and run.task.verb == "press":
        return None
    if run.config.hold == "contact":
        if family is Family.PUSH:
            return None
        q, one_sided = motion.q[0], family.is_one_sided
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
    if stretch.pushes and presses(run.task, stretch.motion):
        return press_in(run)
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


PlanHomePath: TypeAlias = (
    "Callable[[Float[np.ndarray, ' n'], LearnedPart], Float[np.ndarray, 'k n'] | None]"
)
"""Plans arm states from a given state to home, with the part at its estimated state; None without
a path. A second call means that the arm met an obstacle; the planner then assumes another part
pose."""
_MAX_HOME_PATHS = 3
"""Maximum number of paths home that are tried [-]."""
_LOAD_FACTOR = 1.2
"""Factor on the joint load after release at which the arm stops on its way back [-]."""
_HOME_TOLERANCE = 0.05
"""Maximum joint distance from home at which the arm has arrived [rad] or [m]."""


def retreat(run: ExecutionRun, robot: Robot, way: PacedTrajectory, way_home: PlanHomePath) -> bool:
    """Let go and bring the arm home; return whether it arrived.

    If the part has not moved, the hand goes back on its approach. Otherwise it draws back from the
    part, against its approach direction, and plans a path.
    """
    run.arm.stop()
    run.max_load, run.releasing = np.inf, True
    if _let_go(run) is not None:
        return False
    run.releasing = False
    run.max_load = max(1.0, _LOAD_FACTOR * run.arm.load)
    run.lateral_offset, run.forward_offset = 0.0, np.zeros(3)
    if run.learned is None:
        return go_back(run, way) is None and _at_home(run, robot)
    if _draw_back(run, run.learned.value) is not None:
        return False
    for _ in range(_MAX_HOME_PATHS):
        path = way_home(run.world.data.qpos[run.world.arm_q].copy(), run.learned)
        if path is None:
            return False
        home = _time_path(run, robot, path)
        if _follow_home(run, home):
            return _at_home(run, robot)
        if go_back(run, home) is not None:
            return False
    return False


def _time_path(run: ExecutionRun, robot: Robot, path: Float[np.ndarray, "k n"]) -> PacedTrajectory:
    """Time a path home, slow where the arm is near the known room."""
    tool = np.array([run.arm.kinematics.at(q)[0] for q in path])
    back = Motion(path, path[-1:], np.zeros(1), tool[-1:])
    plan, _ = time_motion(robot, back, run.config.speed, run.step)
    known = run.avoidance.known
    return pace_trajectory(plan, path, tool[:, :3, 3], known, run.config, careful=True)


def _follow_home(run: ExecutionRun, home: PacedTrajectory) -> bool:
    """Move the arm along a trajectory; return whether it met no obstacle."""
    run.passed = 0.0
    while run.passed < home.last:
        pace = float(home.pace[round(run.passed)])
        q, v, a = home.at(run.passed, pace)
        run.arm.go(q, v, a)
        felt = float(np.linalg.norm(run.arm.wrench[:3]))
        if run.tick(Stage.RETREAT) is not None or felt > PATH_FORCE:
            run.arm.stop()
            return False
        run.passed += pace
    return True


def _let_go(run: ExecutionRun) -> Ending | None:
    """Open the hand as slowly as it closes: fingers that snap open would knock the part away.

    The arm is compliant meanwhile: a finger that opens against an obstacle would push hard.
    """
    q, still = run.arm.q.copy(), np.zeros_like(run.arm.q)
    T, _ = run.arm.kinematics.at(q)
    stay = Reference(q, still, T, np.zeros(6), EVERYWHERE, EVERYWHERE)
    grip, fingers, ctrl = run.config.gripper, run.world.fingers, run.world.data.ctrl
    way = max((abs(ctrl[motor] - one.open) * one.lever for one, motor in fingers), default=0.0)
    for k in range(0 if run.world.welded else round(way / grip.speed / run.step)):
        run.command_fingers(way - grip.speed * k * run.step)
        run.arm.follow(stay)
        ending = run.tick(Stage.GRIP)
        if ending is not None:
            return ending
    return run.let_go()


def _draw_back(run: ExecutionRun, value: float) -> Ending | None:
    """Draw the hand back against its approach, over the distance of its slow approach."""
    T, _ = run.arm.kinematics.at(run.arm.q)
    back = -T[:3, :3] @ run.world.hand.approach
    q, still = run.arm.q.copy(), np.zeros_like(run.arm.q)
    twist = np.concatenate([NEAR_SPEED * back, np.zeros(3)])
    count = round(NEAR_GRASP / NEAR_SPEED / run.step)
    for _ in range(count):
        T = T.copy()
        T[:3, 3] += run.step * twist[:3]
        bounds = run.avoidance.bounds(run.arm.q, value)
        run.arm.follow(Reference(q, still, T, twist, EVERYWHERE, EVERYWHERE, None, bounds))
        ending = run.tick(Stage.RETREAT)
        if ending is not None:
            return ending
    return run.rest(Stage.RETREAT, SETTLE_TIME)


def _at_home(run: ExecutionRun, robot: Robot) -> bool:
    run.rest(Stage.RETREAT, SETTLE_TIME)
    home = robot.model.all_values(dict(zip(robot.arm_joints, robot.home.tolist(), strict=True)))
    off = run.world.data.qpos[run.world.arm_q] - [home[name] for name in robot.moved_joints]
    return bool(np.abs(off).max() < _HOME_TOLERANCE)
