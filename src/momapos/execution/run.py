"""Execute a motion in physics, and judge it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from momapos.errors import SceneError
from momapos.execution.config import ExecutionConfig, Stage
from momapos.execution.dynamics import Dynamics, read_dynamics
from momapos.execution.furniture import Resistance, draw_resistance
from momapos.execution.observer import Observer
from momapos.execution.record import Execution
from momapos.execution.shapes import ROBOT
from momapos.execution.simulation import Simulation, build_simulation
from momapos.execution.verdict import TaskOutcome, judge
from momapos.geometry.transforms import invert, rotation_angle
from momapos.kinematics.opening import opening_of
from momapos.kinematics.urdf import Joint
from momapos.protocols import Clock
from momapos.robots.robot import Robot
from momapos.scene.scene import Scene, SceneObject
from momapos.trajectory import Trajectory, joined, still, time_motion
from momapos.types import Motion, Task

if TYPE_CHECKING:
    from jaxtyping import Float, Int

DEFAULT = ExecutionConfig()
Watch = Callable[[Simulation, float, Stage], None]
"""Called after every step of the controller with the time [s] and the stage."""
STAGES = tuple(Stage)
OVERLAP = 3e-3
"""The robot may overlap things at the beginning by what a plan may [m]."""
GRASP_POSITION, GRASP_ANGLE = 0.03, np.radians(15.0)
"""The tool takes hold when it is this near its planned place at the part [m], [rad]."""
BREAKING = 5
"""A weld breaks after this many steps of the controller above its limit [-]."""
_STATES = 5
"""States of the motion for which the motors are tuned [-]."""


def execute(
    scene: Scene,
    robot: Robot,
    base_pose: tuple[float, float, float],
    motion: Motion,
    task: Task,
    config: ExecutionConfig = DEFAULT,
    rng: np.random.Generator | None = None,
    *,
    watch: Watch | None = None,
    clock: Clock = time.perf_counter,
) -> Execution:
    """Execute a motion at a base pose and say whether the task was done.

    Nothing of the planner's is used: neither its spheres and boxes nor its kinematics.

    Args:
        scene: The room.
        robot: The robot.
        base_pose: x [m], y [m], yaw [rad] of its base.
        motion: Of the arm; what the planner believes of the object is used for its first tool pose
            alone, where the tool takes hold.
        task: What is to be done.
        config: How to model and judge.
        rng: Draws how the furniture resists, where `config.furniture.spread` is not 0.
        watch: Sees the world after every step of the controller.
        clock: Measures the wall time.

    Raises:
        SceneError: The robot stands in something at the beginning.
        InputError: The motion cannot be timed, or the engine refuses the model.
        RobotError: The hold is `contact`, and the gripper has no sliding fingers.
    """
    item = scene.object(task.object)
    joint = None if task.joint is None else item.model.joint(task.joint)
    assert robot.model.urdf.path is not None
    dynamics = read_dynamics(robot.model.urdf.path)
    resistance = draw_resistance(item, joint, config.furniture, rng or np.random.default_rng(0))
    states = np.concatenate([motion.approach, motion.q])
    tuned = states[np.linspace(0, len(states) - 1, _STATES).astype(int)]
    plan, stage = _timed(robot, motion, config)
    world = build_simulation(scene, robot, base_pose, tuned, task, dynamics, resistance, config)
    seal = _seal(item, joint, motion, resistance.pull, config.furniture.seal_range)
    run = _ExecutionRun(world, motion, task, config, seal, watch)
    if task.verb == "place":
        run.carry(item)
    run.check_start()
    began = clock()
    stopped = run.go(plan, stage)
    wall = clock() - began
    verdict = judge(world, run.observer, task, item, run.first, motion, config, stopped)
    return _outcome(run, verdict, resistance, dynamics, robot, wall)


def _timed(
    robot: Robot, motion: Motion, config: ExecutionConfig
) -> tuple[Trajectory, Int[np.ndarray, " t"]]:
    """When the arm is where, and the stage of each sample."""
    step = config.timestep * config.substeps
    away, hold = time_motion(robot, motion, config.speed, step)

    def rest(q: Float[np.ndarray, " n"], seconds: float) -> Trajectory:
        return still(q, max(1, round(seconds / step)))

    parts = [
        rest(away.q[0], config.settle), away, rest(motion.q[0], config.grip), hold,
        rest(motion.q[-1], config.dwell),
    ]  # fmt: skip
    return joined(parts)


@dataclass(frozen=True)
class Seal:
    """What keeps a closed part closed."""

    closed: float
    """[rad] or [m]"""
    outward: float
    """Direction in which the joint opens, 1 or -1; 0 where nothing holds it."""
    pull: float
    """Torque or force at the joint when it is closed [Nm] or [N]."""
    reach: float
    """Travel over which it fades [rad] or [m]."""

    def force(self, value: float) -> float:
        """Torque or force at a value of the joint [Nm] or [N]."""
        share = 1.0 - abs(value - self.closed) / self.reach
        return -self.outward * self.pull * max(0.0, share)


def _seal(item: SceneObject, joint: Joint | None, motion: Motion, pull: float, way: float) -> Seal:
    """The seal of a part, its force at the handle turned into one at the joint."""
    if joint is None:
        return Seal(0.0, 0.0, 0.0, 1.0)
    opening = opening_of(item.model, joint.name)
    lever = 1.0
    if joint.kind != "prismatic":
        T = item.link_poses()[joint.parent] @ joint.T_parent_joint
        arm = invert(T)[:3, :3] @ (motion.Ts_world_tool[0, :3, 3] - T[:3, 3])
        lever = max(0.05, float(np.linalg.norm(arm - (arm @ joint.axis) * joint.axis)))
    return Seal(opening.closed, opening.sign, pull * lever, way / lever)


class _ExecutionRun:
    """One run under way."""

    def __init__(
        self,
        world: Simulation,
        motion: Motion,
        task: Task,
        config: ExecutionConfig,
        seal: Seal,
        watch: Watch | None,
    ) -> None:
        self.world, self.motion, self.task, self.config = world, motion, task, config
        self.seal, self.watch = seal, watch
        self.observer = Observer(world, config)
        self.first = world.T_world_part
        self.held, self.overloaded = False, 0
        self.spent = dict.fromkeys(STAGES, 0)
        tool = motion.Ts_world_tool[:, :3, 3]
        length = float(np.linalg.norm(np.diff(tool, axis=0), axis=1).sum())
        self.goal, self.last_stretch = tool[-1], config.tolerance * length
        self.stopped_short: float | None = None
        """Distance that was left to the tool when the part stopped it [m]; None where none did."""
        self.usual_push: float | None = None
        """Push toward the end of the way as the last stretch begins [N]; None before."""

    def carry(self, item: SceneObject) -> None:
        """Put the object into the hand, as the plan holds it where it lets go."""
        world = self.world
        T_tool_part = invert(self.motion.Ts_world_tool[0]) @ item.T_world_object
        T = world.T_world_tool @ T_tool_part
        quat = np.empty(4)
        mujoco.mju_mat2Quat(quat, T[:3, :3].ravel())
        world.data.qpos[world.part_q : world.part_q + 7] = [*T[:3, 3], *quat]
        mujoco.mj_forward(world.model, world.data)
        world.attach()
        self._close(True)
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

    def go(self, plan: Trajectory, stage: Int[np.ndarray, " t"]) -> str:
        """Follow the trajectory to its end, or until it makes no sense any more.

        Returns:
            Why it ended early; "" where it did not.
        """
        world, config = self.world, self.config
        w, step = config.control.bandwidth, config.timestep * config.substeps
        # The motors push in proportion to the error; this lead makes them follow without lag.
        lead = plan.q + 2 / w * plan.v + plan.a / w**2
        wanted, k, entered = plan.q, 0, -1
        while k < len(plan):
            name = STAGES[stage[k]]
            if stage[k] != entered:
                entered = stage[k]
                refusal = self._enter(name)
                if refusal:
                    return refusal
            world.data.ctrl[world.arm_motor] = lead[k]
            self._step(name)
            time = sum(self.spent.values()) * step
            if self.observer.diverged:
                return f"the simulation diverged after {time:.2f} s"
            self.observer.record_step(wanted[k], time, name)
            broken = self._overload()
            if broken:
                return broken
            k += 1
            if name is Stage.MANIPULATE and self._at_stop():
                k = int(np.searchsorted(stage, STAGES.index(Stage.DWELL)))
                lead = wanted = np.tile(world.data.qpos[world.arm_q], (len(plan), 1))
        return ""

    def _step(self, stage: Stage) -> None:
        """Let one step of the controller pass."""
        world, config = self.world, self.config
        if self.seal.outward:
            value = float(world.data.qpos[world.part_q])
            world.data.qfrc_applied[world.part_v] = self.seal.force(value)
        mujoco.mj_step(world.model, world.data, nstep=config.substeps)
        self.spent[stage] += 1
        if self.watch is not None:
            time = sum(self.spent.values()) * config.timestep * config.substeps
            self.watch(world, time, stage)

    def _at_stop(self) -> bool:
        """Whether a part on a joint resists the hand's push where its way should end.

        The arm feels it by the force at its hand alone; where the part is, it does not know.
        """
        if self.task.joint is None or not self.held:
            return False
        left = self.goal - self.world.T_world_tool[:3, 3]
        distance = float(np.linalg.norm(left))
        if not 0.0 < distance <= self.last_stretch:
            return False
        push = float(self.world.push() @ left) / distance
        if self.usual_push is None:  # weight and friction, which resist all along
            self.usual_push = max(0.0, push)
        if push - self.usual_push < self.config.control.stop_force:
            return False
        self.stopped_short = distance
        return True

    def _enter(self, stage: Stage) -> str:
        """Do what a stage begins with; a reason where it cannot."""
        place = self.task.verb == "place"
        if stage is Stage.SETTLE and place:
            self.observer.hold()
        if stage is Stage.APPROACH and place and self.config.hold == "contact":
            self.world.release()
        if stage is Stage.GRIP:
            if place:
                self._let_go()
                return ""
            return self._take_hold()
        if stage is Stage.MANIPULATE and not place:
            self.observer.hold()
        return ""

    def _take_hold(self) -> str:
        """Weld, or close the fingers, if the tool is where the plan has it at the part."""
        planned = invert(self.first) @ self.motion.Ts_world_tool[0]
        T = invert(self.world.T_world_part) @ self.world.T_world_tool
        off = float(np.linalg.norm(T[:3, 3] - planned[:3, 3]))
        angle = float(rotation_angle(T[:3, :3], planned[:3, :3]))
        if off > GRASP_POSITION or angle > GRASP_ANGLE:
            return (
                f"the tool is {100 * off:.1f} cm and {np.degrees(angle):.0f} deg off its planned "
                "place when it takes hold"
            )
        if self.config.hold == "weld":
            gap = self.world.grip_gap(1.0)
            if gap > self.config.gripper.reach:
                return f"the gripper is {100 * gap:.1f} cm from what it should take hold of"
            self.world.attach()
        self.held = True
        self._close(True)
        return ""

    def _let_go(self) -> None:
        self.held = False
        self.observer.let_go()
        self.world.release()
        self._close(False)

    def _close(self, closed: bool) -> None:
        for finger, motor in self.world.fingers:
            self.world.data.ctrl[motor] = finger.closed if closed else finger.open

    def _overload(self) -> str:
        """Break the weld where it is loaded too much for long; a reason where it broke."""
        grip = self.config.gripper
        if not self.held or self.config.hold != "weld":
            return ""
        force, torque = self.world.hold_load()
        beyond = force > grip.weld_force or torque > grip.weld_torque
        self.overloaded = self.overloaded + 1 if beyond else 0
        if self.overloaded < BREAKING:
            return ""
        self.world.release()
        self.held = False
        return f"the hold broke at {force:.0f} N and {torque:.1f} Nm"


def _outcome(
    run: _ExecutionRun,
    verdict: TaskOutcome,
    resistance: Resistance,
    dynamics: Dynamics,
    robot: Robot,
    wall: float,
) -> Execution:
    """Gather what was seen."""
    observer, config = run.observer, run.config
    step = config.timestep * config.substeps
    notes = []
    if run.world.loose:
        names = ", ".join(run.world.loose)
        notes.append(f"touch the moved part in the scene, and are left out against it: {names}")
    unknown = [name for name in robot.arm_joints if name not in dynamics.efforts]
    if unknown:
        notes.append(f"no effort limit is known of {', '.join(unknown)}")
    if run.stopped_short is not None:
        notes.append(f"the part stopped the arm {1000 * run.stopped_short:.0f} mm before its end")
    shift = observer.base_shift.tolist()
    return Execution(
        success=verdict.success,
        reason=verdict.reason,
        hold=config.hold,
        start=verdict.start,
        asked=verdict.asked,
        reached=verdict.reached,
        collisions=observer.hardest(),
        slip=observer.slip,
        load=observer.load,
        tracking=observer.tracking,
        clearance=None if np.isinf(observer.clearance) else observer.clearance,
        base_shift=(shift[0], shift[1], shift[2]),
        resistance=asdict(resistance),
        time={name.value: n * step for name, n in run.spent.items()},
        simulated=sum(run.spent.values()) * step,
        wall=wall,
        notes=tuple(notes),
    )
