"""Move a grasped part along the path that its estimated joint allows."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import invert
from momapos.model import Trajectory

from .arm_control import EVERYWHERE, Reference, twist_between
from .avoidance import PROXIMITY_INTERVAL, Bounds
from .config import (
    BASE_CLEARANCE,
    DWELL_TIME,
    NOTICED_FORCE,
    SETTLE_TIME,
    STOP_FORCE,
    Ending,
    Stage,
)
from .execution_run import BelievedJoint, ExecutionRun, Stretch
from .joint_estimate import JointEstimate, LearnedPart

if TYPE_CHECKING:
    from jaxtyping import Float


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
