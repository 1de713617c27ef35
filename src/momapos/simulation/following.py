"""The hand moves the part that it holds, along the way that this turns out to take."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import invert
from momapos.model import Trajectory

from .arm_control import EVERYWHERE, Reference, twist_between
from .avoidance import LOOK, Bounds
from .config import Ending, Stage
from .joint_estimate import JointEstimate, Learned

if TYPE_CHECKING:
    from jaxtyping import Float

    from .stages import Belief, ExecutionRun, Stretch

_STRAYED = 0.02
"""A hand that brings a part back may have strayed so far on it [m]."""


def follow_part(
    run: ExecutionRun, plan: Trajectory, stretch: Stretch, belief: Belief
) -> Ending | None:
    """Move the part as planned about the joint as the hand finds it; why that ends early."""
    way = _PartWay(run, plan, stretch, belief)
    extra = round(run.config.dwell / run.step)  # in which the arm makes up what it lags behind
    for i in range(len(plan) + extra):
        ending = way.step(i)
        if ending is Ending.OTHERWISE and not stretch.pushes:
            way.bring_back()
        if ending is not None:
            return ending
    return way.end()


class _PartWay:
    """The way of a part that the hand moves, and what the hand learns of it."""

    def __init__(
        self, run: ExecutionRun, plan: Trajectory, stretch: Stretch, belief: Belief
    ) -> None:
        self.run, self.plan, self.belief, motion = run, plan, belief, stretch.motion
        times = np.arange(len(plan)) * run.step
        self.values = np.interp(times, plan.state_times, motion.object_q)
        T_held = self._hand()
        self.T_first, _ = run.arm.kinematics.at(plan.q[0])
        self.shift = T_held @ invert(self.T_first)  # the grasp, from where it was planned
        run.estimate = self.estimate = JointEstimate(
            belief.axis, T_held[:3, 3], run.config.compliance
        )
        self.planned = self.values - self.values[0]
        self.more = _missing(belief, T_held, self.T_first) if run.again else 0.0
        self.whole = self.planned[-1] if self.planned[-1] else 1.0
        self.last = len(plan) - 1
        tools = motion.Ts_world_tool[:, :3, 3]
        self.length = float(np.linalg.norm(np.diff(tools, axis=0), axis=1).sum())
        self.bounds: Bounds | None = None
        self.pushes, self.most_felt = stretch.pushes, 0.0
        self.trail = [(run.world.data.qpos[run.world.arm_q].copy(), T_held)]
        """States of the arm and poses of the tool on the way, `LOOK` steps apart."""

    def _hand(self) -> Float[np.ndarray, "4 4"]:
        return self.run.arm.kinematics.at(self.run.world.data.qpos[self.run.world.arm_q])[0]

    def _off_at(self, k: int) -> Float[np.ndarray, "4 4"]:
        """Moves what is planned of tool and part to where the estimated joint has it."""
        moved = self.planned[k] + self.more * self.planned[k] / self.whole
        return (
            self.estimate.axis.moved(moved) @ self.shift @ self.belief.axis.moved(-self.planned[k])
        )

    def _pose_at(self, k: int) -> Float[np.ndarray, "4 4"]:
        """Where the tool is when the part moves about the estimated joint as planned."""
        return self._off_at(k) @ self.run.arm.kinematics.at(self.plan.q[k])[0]

    def _near_end(self, here: Float[np.ndarray, "4 4"]) -> bool:
        """Whether what is left of the way is within the tolerance."""
        return _left(here, self._pose_at(self.last)) <= self.run.config.tolerance * self.length

    def step(self, i: int) -> Ending | None:
        """Let one step of the controller pass; why the way ends with it, if it does."""
        run, plan = self.run, self.plan
        k = min(i, self.last)
        if i % LOOK == 0:
            value, after = self.values[k], self.values[min(k + 1, self.last)]
            self.bounds = run.surroundings.bounds(
                run.arm.q, float(value), self._off_at(k), part_speed=float(after - value) / run.step
            )
        T, T_after = self._pose_at(k), self._pose_at(min(k + 1, self.last))
        here = self._hand()
        if i % LOOK == 0 and self._meets_robot(k):
            run.arm.stop()
            return Ending.STOPPED_AT_END if self._near_end(here) else Ending.MEETS_ROBOT
        farther = self.estimate.see(here[:3, 3])
        way = self.estimate.axis.way_at(here[:3, 3])
        across = EVERYWHERE - np.outer(way, way)
        twist = twist_between(T, T_after) / run.step
        run.arm.follow(
            Reference(plan.q[k], plan.v[k], T, twist, across, across, here[:3, 3], self.bounds)
        )
        ending = run.tick(Stage.MANIPULATE) or run.lost()
        self.most_felt = max(self.most_felt, run.touch.size[0])
        if i % LOOK == 0:
            self.trail.append((run.world.data.qpos[run.world.arm_q].copy(), here))
        if max(run.touch.pads) > 1.0 or run.world.welded:
            run.learned = self._learned(here[:3, 3])
            if farther and run.doubt is not None and run.doubt(self.estimate.points):
                run.arm.stop()  # with the part in the hand, or it swings on
                settled = run.rest(Stage.MANIPULATE, run.config.settle)
                ending = ending or settled or Ending.OTHERWISE
        if ending is Ending.SLIPPED and self._near_end(here):
            return Ending.SLIPPED_AT_END
        if ending is None and _at_stop(run, here, self._pose_at(self.last), self.length):
            run.arm.stop()
            return Ending.STOPPED_AT_END
        return ending

    def bring_back(self) -> None:
        """Bring the part back to where the hand took it, as long as it holds it.

        How the part moves is in doubt then, and so is where it stands when it is let go on its way:
        where it stood at first is not. The hand goes as it came, gives way across that, and stops
        where the part resists: it is back, and the hand has strayed on it.
        """
        run, still, start = self.run, np.zeros_like(self.run.arm.q), self.trail[0][1][:3, 3]
        for (q, T), (_, T_after) in reversed(list(pairwise(self.trail))):
            twist = twist_between(T_after, T) / (LOOK * run.step)
            way = twist[:3] / max(float(np.linalg.norm(twist[:3])), 1e-9)
            across = EVERYWHERE - np.outer(way, way)
            for k in range(LOOK):
                goal = T_after + (k + 1) / LOOK * (T - T_after)
                here = self._hand()[:3, 3]
                run.arm.follow(Reference(q, still, goal, twist, across, across, here))
                if run.tick(Stage.MANIPULATE) is not None or run.lost() is not None:
                    return
            resists = -run.arm.wrench[:3] @ way > run.config.control.stop_force
            if resists:
                run.arm.stop()
                if np.linalg.norm(here - start) > _STRAYED:
                    return
                here = start
            self.estimate.see(here)
            run.learned = self._learned(here)
            if resists:
                return

    def _meets_robot(self, k: int) -> bool:
        """Whether the part, as it is found to move, comes upon the base or an arm in a corner."""
        surroundings, compliance = self.run.surroundings, self.run.config.compliance
        base, arm = surroundings.part_gaps
        if min(base, arm) < compliance.apart:
            return True
        if base > compliance.base_room:
            return False
        planned, _ = surroundings.gaps(self.run.arm.q, float(self.values[k]))
        return base < planned - compliance.apart

    def _learned(self, point: Float[np.ndarray, "3"]) -> Learned:
        """What the hand knows of the part, from where it is."""
        axis, belief, first = self.estimate.axis, self.belief, self.values[0]
        value = first - self.more + self.estimate.value_at(point)
        shut = belief.axis.moved(belief.closed - first) @ self.T_first
        expected = axis.moved(value - belief.closed) @ shut
        return Learned(value, axis, point - expected[:3, 3], tuple(self.estimate.points))

    def end(self) -> Ending | None:
        """How the way ends after its last step."""
        if self.pushes and self.most_felt < self.run.config.compliance.noticed:
            if self.run.learned is not None:  # most parts that run away fall shut
                self.run.learned = replace(self.run.learned, value=self.belief.closed)
            return Ending.NOTHING_MET
        here = self._hand()
        if self._near_end(here):
            return None
        left = _left(here, self._pose_at(self.last))
        self.run.detail = f"{100 * left:.0f} cm of {100 * self.length:.0f} were left"
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
