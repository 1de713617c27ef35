"""A run, stage by stage: settle, approach, take hold, move the part, dwell."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from momapos.core import SceneError
from momapos.core.geometry import invert, rotation_angle
from momapos.model import Trajectory
from momapos.model.records import Hold, Motion, Task
from momapos.model.scene import SceneObject

from .approach import PacedTrajectory
from .arm_control import EVERYWHERE, CompliantArm, Reference
from .avoidance import Surroundings
from .config import AT_END, Ending, ExecutionConfig, Stage
from .entering import come_in, go_between, reach_on
from .feel import feel
from .following import follow_part
from .geoms import ROBOT, matrix_quat
from .joint_estimate import Axis, Doubt, JointEstimate, Learned
from .observer import Observer
from .payload import Payload
from .run_record import Collision
from .simulated_room import Seal
from .simulation import Simulation

if TYPE_CHECKING:
    from jaxtyping import Float

Watch = Callable[[Simulation, float, Stage], None]
"""Called after every step of the controller with the time [s] and the stage."""
STAGES = tuple(Stage)
OVERLAP = 3e-3
"""The robot may overlap things at the beginning by what a plan may [m]."""
GRASP_POSITION, GRASP_ANGLE = 0.03, np.radians(15.0)
"""The hand closes when the arm is this near its planned state there [m], [rad]."""
LASTING = 5
"""A force counts that is above its limit for this many steps of the controller [-]."""


@dataclass(frozen=True)
class Belief:
    """What the plan says of the part: where its joint is."""

    axis: Axis
    closed: float
    """Where it is shut [rad] or [m]."""


@dataclass(frozen=True, eq=False)
class Stretch:
    """A part of the motion in which the hand holds all the time, or not at all."""

    plan: Trajectory
    motion: Motion
    """Its states."""
    hold: Hold | None
    """None where the hand is free."""
    between: PacedTrajectory | None = None
    """The plan of a free hand between two holds, slow near things; None of all others."""

    @property
    def pushes(self) -> bool:
        """Whether the part is pushed, and not held."""
        return self.hold is not None and self.hold.family == "push"

    @property
    def one_sided(self) -> bool:
        """Whether one finger that bears a load is enough."""
        return self.hold is not None and self.hold.family == "hook"


class ExecutionRun:
    """One run under way."""

    def __init__(
        self,
        world: Simulation,
        motion: Motion,
        task: Task,
        config: ExecutionConfig,
        seal: Seal,
        belief: Belief | None,
        known: Simulation,
        watch: Watch | None,
        touched: Mapping[tuple[str, str], Collision] | None = None,
        doubt: Doubt | None = None,
    ) -> None:
        """`touched` holds the touches of tries before; None for the first one."""
        self.doubt = doubt
        self.again = touched is not None
        self.world, self.motion, self.task, self.config = world, motion, task, config
        self.seal, self.belief, self.watch = seal, belief, watch
        self.step = config.timestep * config.substeps
        self.observer = Observer(world, config, dict(touched or {}))
        self.first = world.T_world_part
        self.arm = CompliantArm(world, config.compliance, self.step)
        self.surroundings = Surroundings(known, config.compliance)
        self.payload = Payload(config.compliance.weight_time, self.step)
        self.estimate: JointEstimate | None = None
        self.touch = feel(world)
        self.held, self.strained, self.unloaded = False, 0, 0
        self.aside, self.side, self.tries = 0.0, 0.0, 0
        """How far along its closing axis the hand comes in beside the plan [m], on which side, and
        how often it has tried anew [-]."""
        self.bearable = 1.0
        """Share of what its joints may bear by what is in the way, at which the arm stops [-]."""
        self.opening = False
        """Whether the hand lets go of what strains it."""
        self.learned: Learned | None = None
        """None where the hand has not moved the part."""
        self.ahead = np.zeros(3)
        """How far the hand went on from the planned grasp to look for what it should hold [m]."""
        self.passed = 0.0
        """How far along the approach the arm is, in samples [-]."""
        self.spent = dict.fromkeys(STAGES, 0)
        self.detail = ""
        """Figures that go with the ending, in words."""
        self.usual_push: float | None = None
        """Push toward the end of the way as the last stretch begins [N]; None before."""

    @property
    def time(self) -> float:
        """Since the beginning of the run [s]."""
        return sum(self.spent.values()) * self.step

    def carry(self, item: SceneObject) -> None:
        """Put the object into the hand, as the plan holds it where it lets go."""
        world = self.world
        T_tool_part = invert(self.motion.Ts_world_tool[0]) @ item.T_world_object
        T = world.T_world_tool @ T_tool_part
        pose = [*T[:3, 3], *matrix_quat(T[:3, :3])]
        world.data.qpos[world.part_q : world.part_q + 7] = pose
        mujoco.mj_forward(world.model, world.data)
        world.attach()
        self.held = True

    def check_start(self) -> None:
        """Refuse a start in which the robot is in something.

        Raises:
            SceneError: It names what.
        """
        contact, world = self.world.data.contact, self.world
        for geoms, dist in zip(np.array(contact.geom), np.array(contact.dist), strict=True):
            if dist < -OVERLAP and np.isin(world.kinds[geoms], ROBOT).any():
                one, other = sorted(world.names[g] for g in geoms)
                raise SceneError(f"start in collision: {one} is {-1000 * dist:.0f} mm in {other}")

    def go(self, approach: PacedTrajectory, stretches: Sequence[Stretch]) -> Ending:
        """Carry out the motion, until it is done or makes no sense any more."""
        place = self.task.verb == "place"
        if place:
            self.observer.hold()
        ending = self.rest(Stage.SETTLE, self.config.settle)
        if place and self.config.hold == "contact":
            ending = ending or self._shut(self.arm.q, gives=False)
            self.world.release()
        ending = ending or come_in(self, approach)
        for stretch in stretches:
            free = place or (stretch.hold is None and self.belief is not None)
            ending = ending or (self.let_go() if free else self._take_hold(stretch))
            ending = ending or self._move(stretch)
        if ending not in (None, *AT_END):
            return ending
        return self.rest(Stage.DWELL, self.config.dwell) or ending or Ending.DONE

    def tick(self, stage: Stage) -> Ending | None:
        """Let one step of the controller pass; why the run ends with it, if it does."""
        world, w = self.world, self.config.control.bandwidth
        # The motors push in proportion to the error; this lead makes them follow without lag.
        lead = 2 / w * self.arm.v + self.arm.a / w**2 + self.payload.lead(self.world)
        world.data.ctrl[world.arm_motor] = self.arm.q + lead
        if self.seal.outward:
            value = float(world.data.qpos[world.part_q])
            world.data.qfrc_applied[world.part_v] = self.seal.force(value)
        mujoco.mj_step(world.model, world.data, nstep=self.config.substeps)
        self.spent[stage] += 1
        if self.watch is not None:
            self.watch(world, self.time, stage)
        if self.observer.diverged:
            self.detail = f"after {self.time:.2f} s"
            return Ending.DIVERGED
        self.touch = feel(world)
        self.arm.feel(self.payload.see(self.touch, carried=self.held and self.belief is None))
        self.observer.record_step(self.arm.q, self.time, stage, self.touch)
        return self._strain()

    def _strain(self) -> Ending | None:
        """Break the weld, or stop the arm, where the hand feels too much for long."""
        grip, most = self.config.gripper, self.config.compliance
        force, torque = self.touch.size
        welded = self.held and self.world.welded
        if welded and (force > grip.weld_force or torque > grip.weld_torque):
            self.strained += 1
            if self.strained >= LASTING:
                self.world.release()
                self.detail = f"at {force:.0f} N and {torque:.1f} Nm"
                return Ending.BROKE
            return None
        force, torque = (float(np.linalg.norm(v)) for v in np.split(self.arm.wrench, 2))
        hard = not self.opening and (force > most.force or torque > most.torque)
        blocked = self.arm.load > self.bearable
        self.strained = self.strained + 1 if hard or blocked else 0
        if self.strained < LASTING:
            return None
        if blocked:
            self.detail = f"a joint bears {100 * self.arm.load:.0f} % of what it may"
            return Ending.BLOCKED
        self.detail = (
            f"{force:.0f} N and {torque:.1f} Nm, at most {most.force:g} N and {most.torque:g} Nm"
        )
        return Ending.TOO_HARD

    def rest(self, stage: Stage, seconds: float) -> Ending | None:
        """Stay as the arm is."""
        self.arm.go(self.arm.q, np.zeros_like(self.arm.q))
        for _ in range(max(1, round(seconds / self.step))):
            ending = self.tick(stage)
            if ending is not None:
                return ending
        return None

    def beside(self, T: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
        """A pose of the tool, moved aside by what the hand has learned on its way in."""
        moved = T.copy()
        moved[:3, 3] += self.aside * T[:3, :3] @ self.world.hand.axis + self.ahead
        return moved

    def _take_hold(self, stretch: Stretch) -> Ending | None:
        """Weld, or close the fingers, where the arm is at the planned grasp."""
        T, _ = self.arm.kinematics.at(self.world.data.qpos[self.world.arm_q])
        planned = stretch.motion.Ts_world_tool[0]
        # The hand comes in beside the plan for a first hold; for later ones it is back on it, and
        # fingers that close move it aside once more: the part is still where it was found.
        goals = planned[:3, 3], self.beside(planned)[:3, 3]
        off = float(min(np.linalg.norm(T[:3, 3] - goal) for goal in goals))
        angle = float(rotation_angle(T[:3, :3], planned[:3, :3]))
        if off > GRASP_POSITION or angle > GRASP_ANGLE:
            self.detail = f"it is {100 * off:.1f} cm and {np.degrees(angle):.0f} deg off"
            return Ending.ASTRAY
        self.observer.reaching = False
        if self.config.hold == "contact":
            if stretch.pushes:
                return None
            q, one_sided = stretch.motion.q[0], stretch.one_sided
            ending = self._shut(q, one_sided=one_sided)
            if ending is Ending.NOTHING_HELD and self.belief is not None:
                self.close(0.0)
                ending = self.rest(Stage.GRIP, self.config.grip)
                ending = ending or reach_on(self, q) or self._shut(q, one_sided=one_sided)
        else:
            gap = self.world.grip_gap(1.0)
            if gap > self.config.gripper.reach:
                self.detail = f"the gripper is {100 * gap:.1f} cm from it"
                return Ending.OUT_OF_REACH
            turns = stretch.hold is not None and stretch.hold.turn_axis is not None
            self.world.attach(turns=turns)
            ending = self.rest(Stage.GRIP, self.config.grip)
        self.held = True
        self.observer.hold()
        return ending

    def _shut(
        self, q: Float[np.ndarray, " n"], *, one_sided: bool = False, gives: bool = True
    ) -> Ending | None:
        """Close the fingers until the pads of both sides bear a load.

        Args:
            q: State of the arm [rad] or [m].
            one_sided: Whether one finger that bears a load is enough.
            gives: Whether the arm gives way along the closing axis.
        """
        grip, arm, still = self.config.gripper, self.arm, np.zeros_like(q)
        T = self.beside(arm.kinematics.at(q)[0])
        closing = T[:3, :3] @ self.world.hand.axis
        across = np.outer(closing, closing)  # the fingers find what they hold along this alone
        reference = Reference(q, still, T, np.zeros(6), EVERYWHERE, across)
        way = max(abs(f.closed - f.open) * f.lever for f in self.world.hand.fingers)
        enough, firm = grip.loaded * self.world.hand.force, 0
        for k in range(round((way / grip.speed + grip.patience) / self.step)):
            self.close(grip.speed * k * self.step)
            if gives:
                arm.follow(reference)
            else:
                arm.go(q, still)
            ending = self.tick(Stage.GRIP)
            if ending is not None:
                return ending
            firm = firm + 1 if min(self.touch.pads) > enough else 0
            if firm * self.step >= grip.patience / 2:
                return None
        one = max(self.touch.pads) > enough
        if one and one_sided:
            return None
        return Ending.ONE_SIDED if one else Ending.NOTHING_HELD

    def close(self, way: float) -> None:
        """Let each pad close by a way from where it was open [m]; inf to press with all force."""
        grip = self.config.gripper
        for finger, motor in self.world.fingers:
            sign = np.sign(finger.closed - finger.open)
            press = self.world.hand.force / grip.stiffness / finger.lever
            most = abs(finger.closed - finger.open) + press
            self.world.data.ctrl[motor] = finger.open + sign * min(way / finger.lever, most)

    def let_go(self) -> Ending | None:
        self.held = False
        self.observer.let_go()
        self.world.release()
        self.close(0.0)
        return self.rest(Stage.GRIP, self.config.grip)

    def _move(self, stretch: Stretch) -> Ending | None:
        """Move what is held along its planned way, or along the way that it turns out to take."""
        plan = stretch.plan
        if stretch.between is not None:
            return go_between(self, stretch.between)
        if self.belief is None or stretch.hold is None:
            offset = self.arm.q - plan.q[0]  # what is in the hand came into it as it did
            for q, v, a in zip(plan.q, plan.v, plan.a, strict=True):
                self.arm.go(q + offset, v, a)
                ending = self.tick(Stage.MANIPULATE) or self.lost()
                if ending is not None:
                    return ending
            return None
        return follow_part(self, plan, stretch, self.belief)

    def lost(self) -> Ending | None:
        """Whether what was held is in the hand no more: nothing presses on the pads."""
        if not self.held or self.config.hold != "contact":
            return None
        self.unloaded = self.unloaded + 1 if max(self.touch.pads) < 1.0 else 0
        return Ending.SLIPPED if self.unloaded * self.step > self.config.gripper.lost else None
