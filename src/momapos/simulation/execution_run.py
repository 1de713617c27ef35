"""State of a run in physics, the elementary actions of the robot in it, and what it observes.

The simulated base cannot leave the floor. The force and torque that hold it there tell where the
floor's reaction would act: the zero moment point (Vukobratovic 1972), accelerations included.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from momapos.core import GRAVITY, SceneError, contact_text
from momapos.core.geometry import contains, edge_distances, invert, local_points, rotation_angle
from momapos.model import Trajectory
from momapos.model.records import Family, Hold, Motion, Task
from momapos.model.scene import SceneObject

from .arm_control import (
    EVERYWHERE,
    CollisionAvoidance,
    CompliantArm,
    PacedTrajectory,
    Reference,
    SensedForces,
    sense_forces,
)
from .base_drive import BaseDrive, base_coordinates
from .config import (
    BANDWIDTH,
    GRIP_PATIENCE,
    GRIP_TIME,
    LOST_TIME,
    MIN_LOADED,
    PRESS_FORCE,
    SUBSTEPS,
    WEIGHT_TIME,
    WELD_FORCE,
    WELD_TORQUE,
    Ending,
    ExecutionConfig,
    Stage,
)
from .geoms import ROBOT, Kind, matrix_quat
from .joint_estimate import Axis, JointDoubt, JointEstimate, LearnedPart
from .run_record import Collision, Load, Slip, Tracking
from .simulated_room import Seal, push_of
from .simulation import Simulation

if TYPE_CHECKING:
    from jaxtyping import Float


class Payload:
    """Weight of a movable object in the hand, and its line of action.

    The downward force at the wrist counts as weight, through a slow filter: a sudden push acts on
    the arm first. A lasting push would count as weight, but a support only ever reduces it.
    """

    def __init__(self, filter_time: float, step: float) -> None:
        """`filter_time` is the time constant of the weight's low-pass filter [s]."""
        self._share = step / (filter_time + step)
        self._felt, self._carried = np.zeros(6), False

    def remove_weight(self, touch: SensedForces, *, carried: bool) -> SensedForces:
        """Update the estimate and subtract the weight from the sensed forces.

        Args:
            touch: The sensed forces.
            carried: Whether the hand holds a movable object.
        """
        self._carried = carried
        if not carried:
            self._felt = np.zeros(6)
            return touch
        wrench = np.concatenate([touch.force, touch.torque])
        self._felt += self._share * (wrench - self._felt)
        weight = self.weight
        return replace(touch, force=touch.force - weight[:3], torque=touch.torque - weight[3:])

    @property
    def weight(self) -> Float[np.ndarray, "6"]:
        """Force [N] and torque about the tool's origin [Nm] of the weight, in the world."""
        down = np.zeros(6)
        if self._felt[2] < 0.0:
            down[2:] = self._felt[2:]
        return down

    def lead(self, world: Simulation) -> Float[np.ndarray, " n"]:
        """Return the lead of the motors' set-points that bears the weight [rad] or [m]."""
        if not self._carried:
            return np.zeros(len(world.arm_v))
        J = np.zeros((6, world.model.nv))
        mujoco.mj_jacBody(world.model, world.data, J[:3], J[3:], world.tool_body)
        load = self.weight @ J[:, world.arm_v]
        return np.asarray(-load / world.model.actuator_gainprm[world.arm_motor, 0])


_MAX_JOINT_SPEED = 1e4
"""Joint speed above which the simulation has diverged [rad/s] or [m/s]."""
_HELD = Kind.PAD | Kind.PART
_RESTS = (Kind.PART | Kind.ROOM, Kind.PART | Kind.FLOOR)
_ROBOT_ROOM = np.array([kind | Kind.ROOM for kind in ROBOT])


@dataclass(eq=False)
class Observer:
    """Observations of a run so far."""

    world: Simulation
    config: ExecutionConfig
    collisions: dict[tuple[str, str], Collision] = field(default_factory=dict)
    reaching: bool = True
    """Whether the hand is on its way to the grasp; afterwards contacts of the pads are normal."""
    clearance: float = np.inf
    slip: Slip = field(default_factory=Slip)
    load: Load = field(default_factory=Load)
    base_shift: Float[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))
    part_range: tuple[float, float] = (np.inf, -np.inf)
    """Smallest and largest value of the part's joint [rad] or [m]."""
    _T_part_tool: Float[np.ndarray, "4 4"] | None = None
    _worst: float = 0.0
    _squares: float = 0.0
    _samples: int = 0
    _effort: float = 0.0

    def __post_init__(self) -> None:
        limits = self.world.model.jnt_actfrcrange
        joints = self.world.model.actuator_trnid[self.world.arm_motor, 0]
        self._limit = np.where(limits[joints, 1] > 0, limits[joints, 1], np.inf)
        joint = self.world.model.body_jntadr[self.world.part_body]
        self._loose = self.world.model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE

    @property
    def diverged(self) -> bool:
        """Whether the state is not finite, or its speed is implausible."""
        data = self.world.data
        return not (np.abs(data.qvel).max() < _MAX_JOINT_SPEED and np.isfinite(data.qpos.sum()))

    @property
    def tracking(self) -> Tracking:
        """Tracking errors of the motors."""
        rms = float(np.sqrt(self._squares / max(self._samples, 1)))
        return Tracking(self._worst, rms, self._effort)

    def hold(self) -> None:
        """Start measuring slip, and accept contacts between pads and part."""
        self.reaching = False
        self._T_part_tool = invert(self.world.T_world_part) @ self.world.T_world_tool

    def let_go(self) -> None:
        """Stop measuring slip."""
        self._T_part_tool = None

    def record_step(
        self,
        wanted: Float[np.ndarray, " n"],
        base: Float[np.ndarray, "3"],
        time: float,
        stage: str,
        touch: SensedForces,
    ) -> None:
        """Record the present state.

        Args:
            wanted: Set-points of the arm [rad] or [m].
            base: Set-points of the base's joints.
            time: Time since the start of the run [s].
            stage: Stage of the run.
            touch: Forces on the hand.
        """
        data, world = self.world.data, self.world
        error = np.abs(data.qpos[world.arm_q] - wanted)
        self._worst = max(self._worst, float(error.max()))
        self._squares += float((error**2).mean())
        self._samples += 1
        effort = np.abs(data.qfrc_actuator[world.arm_v]) / self._limit
        self._effort = max(self._effort, float(effort.max()))
        value, (low, high) = float(data.qpos[world.part_q]), self.part_range
        self.part_range = min(low, value), max(high, value)
        self.base_shift = np.maximum(self.base_shift, np.abs(data.qpos[world.base_q] - base))
        if data.ncon:
            self._note_contacts(time, stage)
        if self._T_part_tool is not None:
            self._note_hold(self._T_part_tool, touch)

    def _note_hold(self, T_before: Float[np.ndarray, "4 4"], touch: SensedForces) -> None:
        T = invert(self.world.T_world_part) @ self.world.T_world_tool
        moved = float(np.linalg.norm(T[:3, 3] - T_before[:3, 3]))
        angle = float(rotation_angle(T_before[:3, :3], T[:3, :3]))
        self.slip = Slip(max(self.slip.position, moved), max(self.slip.angle, angle))
        force, torque = touch.size
        self.load = Load(max(self.load.force, force), max(self.load.torque, torque))

    def _note_contacts(self, time: float, stage: str) -> None:
        """Record contacts with a force as collisions, and the others as clearance."""
        contact, kinds = self.world.data.contact, self.world.kinds
        geoms, dist = contact.geom, contact.dist
        both = kinds[geoms[:, 0]] | kinds[geoms[:, 1]]
        room = (both[:, None] == _ROBOT_ROOM).any(1)
        self.clearance = min(self.clearance, float(dist[room].min(initial=np.inf)))
        pushing = (contact.efc_address >= 0) & (self.reaching | (both != _HELD))
        if self._loose:  # it may rest on the room and the floor
            pushing &= (both != _RESTS[0]) & (both != _RESTS[1])
        if not pushing.any():
            return
        touched: dict[tuple[str, str], tuple[float, float]] = {}
        wrench = np.empty(6)
        for i in np.flatnonzero(pushing).tolist():
            mujoco.mj_contactForce(self.world.model, self.world.data, i, wrench)
            names = sorted(self.world.names[g] for g in geoms[i])
            force, depth = touched.get((names[0], names[1]), (0.0, 0.0))
            touched[names[0], names[1]] = (force + float(wrench[0]), max(depth, -float(dist[i])))
        for pair, (force, depth) in touched.items():
            self._note_collision(pair, force, depth, time, stage)

    def _note_collision(
        self, pair: tuple[str, str], force: float, depth: float, time: float, stage: str
    ) -> None:
        seen = self.collisions.get(pair)
        if seen is None:
            seen = Collision(*pair, force=0.0, depth=0.0, seconds=0.0, first=time, stage=stage)
        self.collisions[pair] = replace(
            seen,
            force=max(seen.force, force),
            depth=max(seen.depth, depth),
            seconds=seen.seconds + self.config.timestep * SUBSTEPS,
        )

    def hardest(self) -> tuple[Collision, ...]:
        """Return all collisions, the hardest first."""
        return tuple(sorted(self.collisions.values(), key=lambda c: -c.force))


MAX_TILT = math.radians(1.0)
"""Tilt at which a base counts as tipped over [rad]: a wheel 40 cm from the edge is 7 mm up."""
LEANING_TILT = MAX_TILT / 5
"""Tilt at which the arm stops to pull [rad]."""
LIFTED = -1.0
"""Stability of a base that is pulled off the floor, and the least that counts: a light load on the
floor puts the zero moment point anywhere [m]."""
SMOOTHING_TIME = 0.1
"""Time constant of the filter of the recorded stability, which leaves impacts out [s]."""


class Tipping:
    """The stability of a robot during a run.

    Where the zero moment point is outside the area that the wheels stand on, the robot begins to
    turn about its edge, and falls back when the point returns.
    """

    def __init__(self, world: Simulation, step: float) -> None:
        """`step` is the time between updates [s]."""
        self._world, self._step = world, step
        self._body = world.model.body("base").id
        self._own = np.flatnonzero(world.model.body_rootid == self._body)
        """The robot's bodies."""
        self._velocity = world.data.qvel.copy()
        """Joint velocities at the last update."""
        self._tilt, self._rate = 0.0, 0.0
        self._smooth: float | None = None
        self.stability: float | None = None
        """Least distance of the zero moment point from the edge of the wheels' outline so far [m];
        None if masses or wheels are unknown."""

    @property
    def tips(self) -> bool:
        """Whether the base would tip over."""
        return self._tilt > MAX_TILT

    @property
    def leans(self) -> bool:
        """Whether the base begins to tip over, as the robot knows from its weight and its wrist."""
        return self._tilt > LEANING_TILT

    def update(self) -> None:
        """Take the present state into account."""
        support = self._world.support
        if support is None:
            return
        margin = self._margin(support)
        before = margin if self._smooth is None else self._smooth
        share = self._step / (SMOOTHING_TIME + self._step)
        self._smooth = before + share * (margin - before)
        least = self._smooth if self.stability is None else self.stability
        self.stability = min(least, self._smooth)
        self._turn(margin)

    def _margin(self, support: Float[np.ndarray, "k 2"]) -> float:
        """Return how far inside the wheels' outline the zero moment point is [m]."""
        point = self._zero_moment_point()
        if point is None:
            return LIFTED
        distance = float(edge_distances(point[None], support)[0])
        return distance if contains(support, point[None])[0] else max(-distance, LIFTED)

    def _turn(self, margin: float) -> None:
        """Integrate the turn about the edge, on which the weight acts with a lever."""
        model, data = self._world.model, self._world.data
        mass, at = model.body_mass[self._own], data.xipos[self._own]
        inertia = float(mass @ ((at - data.xpos[self._body]) ** 2).sum(1))
        self._rate -= self._step * GRAVITY * float(mass.sum()) * margin / inertia
        self._tilt += self._step * self._rate
        if self._tilt <= 0.0:
            self._tilt = self._rate = 0.0

    def _zero_moment_point(self) -> Float[np.ndarray, "2"] | None:
        """Return where the floor reacts [m], in the frame of the base; None where it does not."""
        model, data = self._world.model, self._world.data
        # The engine integrates damping implicitly, so that its own accelerations are not the real.
        kept, change = data.qacc.copy(), data.qvel - self._velocity
        data.qacc[:] = change / self._step
        mujoco.mj_rnePostConstraint(model, data)
        data.qacc[:], self._velocity = kept, data.qvel.copy()
        torque_x, torque_y, _, *force = data.cfrc_int[self._body].tolist()
        if force[2] <= 0.0:
            return None
        center = data.subtree_com[model.body_rootid[self._body]].tolist()
        moment_x = torque_x + (center[1] * force[2] - center[2] * force[1])
        moment_y = torque_y + (center[2] * force[0] - center[0] * force[2])
        point = np.array([[-moment_y, moment_x]]) / force[2]
        T = data.xmat[self._body].reshape(3, 3)
        pose = np.array([*data.xpos[self._body][:2], np.arctan2(T[1, 0], T[0, 0])])
        return local_points(pose, point)[0]


Watch = Callable[[Simulation, float, Stage], None]
"""Callback after every control step, with the time [s] and the stage."""
MAX_START_OVERLAP = 3e-3
"""Maximum overlap of the robot with its surroundings at the start, as a plan may have it [m]."""
MIN_TIPPING_FORCE = 5.0
"""Force on the hand from which on it is what tips the base, and not the arm's own motion [N]."""
MAX_LATE = 0.4
"""How long the arm waits for a base that is late [s]; eight times the usual delay of a command."""
CATCH_UP = 2
"""Samples of the plan by which the arm goes on per step, as long as the base is ahead [-]."""
MAX_OVERLOAD_STEPS = 5
"""Control steps for which a force must exceed its limit to count [-]."""


@dataclass(frozen=True)
class BelievedJoint:
    """Joint of the part, as the robot believes it to be."""

    axis: Axis
    closed: float
    """Closed value of the joint [rad] or [m]."""
    alone: bool = True
    """Whether no mimic joint moves with it, so that the path of the hand tells its axis."""


@dataclass(frozen=True, eq=False)
class Stretch:
    """Section of the motion with one grasp throughout, or with a free hand."""

    plan: Trajectory
    motion: Motion
    """States of the section."""
    hold: Hold | None
    """None for a free hand."""
    between: PacedTrajectory | None = None
    """For a free hand between two grasps, the trajectory slowed down near obstacles; else None."""
    turns_latch: bool = False
    """Whether the hand turns the latch of the part in this section."""
    goes_on: bool = False
    """Whether the hand holds on from the section before."""

    @property
    def pushes(self) -> bool:
        """Whether the part is pushed instead of grasped."""
        return self.hold is not None and self.hold.kind is Family.PUSH

    @property
    def one_sided(self) -> bool:
        """Whether one finger under load is enough."""
        return self.hold is not None and self.hold.kind.is_one_sided


class ExecutionRun:
    """A run in progress."""

    def __init__(
        self,
        world: Simulation,
        motion: Motion,
        task: Task,
        config: ExecutionConfig,
        seal: Seal,
        belief: BelievedJoint | None,
        known: Simulation,
        watch: Watch | None,
        touched: Mapping[tuple[str, str], Collision] | None = None,
        doubt: JointDoubt | None = None,
        base: BaseDrive | None = None,
    ) -> None:
        """`touched` holds the collisions of earlier attempts; None for the first attempt. `base`
        drives the base; None if it stands still."""
        self.doubt = doubt
        self.again = touched is not None
        self.world, self.motion, self.task, self.config = world, motion, task, config
        self.seal, self.belief, self.watch = seal, belief, watch
        self.step = config.timestep * SUBSTEPS
        self.observer = Observer(world, config, dict(touched or {}))
        self.T_part_first = world.T_world_part
        self.arm = CompliantArm(world, config.compliance, self.step)
        self.base = base
        self.tipping = Tipping(world, self.step)
        self.avoidance = CollisionAvoidance(known, config.compliance)
        self.payload = Payload(WEIGHT_TIME, self.step)
        self.estimate: JointEstimate | None = None
        self.touch = sense_forces(world)
        self.held, self.strained, self.unloaded = False, 0, 0
        self.lateral_offset, self.side, self.tries = 0.0, 0.0, 0
        """Offset of the hand from the plan along its closing axis [m], the sign of its side, and
        the number of retries [-]."""
        self.max_load = 1.0
        """Share of the allowed joint load at which the arm stops [-]."""
        self.releasing = False
        """Whether the hand is letting go of the part, so that forces on it do not end the run."""
        self.learned: LearnedPart | None = None
        """None if the hand has not moved the part."""
        self.forward_offset = np.zeros(3)
        """Offset of the hand from the planned grasp after it searched ahead [m]."""
        self.passed = 0.0
        """Position of the arm on the approach, in samples [-]."""
        self.spent = dict.fromkeys(Stage, 0)
        self.detail = ""
        """Figures that explain the ending."""
        self.press_force = PRESS_FORCE
        """Push at which a pressed part is at its end [N]."""
        self.usual_push: float | None = None
        """Push toward the end of the path when the last section begins [N]; None before."""

    @property
    def time(self) -> float:
        """Time since the start of the run [s]."""
        return sum(self.spent.values()) * self.step

    def begin_with(self, item: SceneObject) -> None:
        """Put an object to be placed into the hand, or learn how hard a part must be pressed."""
        if self.task.verb == "place":
            self.carry(item)
        elif self.task.verb == "press":
            self.press_force += push_of(item, self.task, self.config.furniture)

    def carry(self, item: SceneObject) -> None:
        """Put the object into the hand as planned for its placement."""
        world = self.world
        T_tool_part = invert(self.motion.Ts_world_tool[0]) @ item.T_world_object
        T = world.T_world_tool @ T_tool_part
        pose = [*T[:3, 3], *matrix_quat(T[:3, :3])]
        world.data.qpos[world.part_q : world.part_q + 7] = pose
        mujoco.mj_forward(world.model, world.data)
        world.attach()
        self.held = True

    def check_start(self) -> None:
        """Check that the robot starts free of collisions.

        Raises:
            SceneError: The robot overlaps an obstacle, which the message names.
        """
        contact, world = self.world.data.contact, self.world
        for geoms, dist in zip(np.array(contact.geom), np.array(contact.dist), strict=True):
            if dist < -MAX_START_OVERLAP and np.isin(world.kinds[geoms], ROBOT).any():
                one, other = sorted(world.names[g] for g in geoms)
                raise SceneError(f"start in collision: {contact_text(one, other, -dist)}")

    def tick(self, stage: Stage) -> Ending | None:
        """Advance by one control step; return the ending it causes, or None."""
        world, w = self.world, BANDWIDTH
        # The motors push in proportion to the error; this lead makes them follow without lag.
        lead = 2 / w * self.arm.v + self.arm.a / w**2 + self.payload.lead(self.world)
        world.data.ctrl[world.arm_motor] = self.arm.q + lead
        if self.base is not None:
            self.base.update()
            self.arm.kinematics.base = self.avoidance.base = self.base.odometry
            self.arm.kinematics.base_velocity = self.base.velocity
        if self.seal.outward:
            value = float(world.data.qpos[world.part_q])
            world.data.qfrc_applied[world.part_v] = self.seal.force(value)
        if world.latch is not None:
            world.latch.update(world.data, self.config.tolerance)
        mujoco.mj_step(world.model, world.data, nstep=SUBSTEPS)
        self.spent[stage] += 1
        if self.watch is not None:
            self.watch(world, self.time, stage)
        if self.observer.diverged:
            self.detail = f"after {self.time:.2f} s"
            return Ending.DIVERGED
        self.tipping.update()
        if self.tipping.tips:
            return Ending.TIPS_OVER
        self.touch = sense_forces(world)
        carried = self.held and self.belief is None
        self.arm.update_forces(self.payload.remove_weight(self.touch, carried=carried))
        goal = np.zeros(3) if self.base is None else self.base.goal
        self.observer.record_step(self.arm.q, goal, self.time, stage, self.touch)
        return self._check_overload()

    def _check_overload(self) -> Ending | None:
        """Break the weld, or stop the arm, if the load at the hand stays too high."""
        most = self.config.compliance
        force, torque = self.touch.size
        welded = self.held and self.world.welded
        if welded and (force > WELD_FORCE or torque > WELD_TORQUE):
            self.strained += 1
            if self.strained >= MAX_OVERLOAD_STEPS:
                self.world.release()
                self.detail = f"at {force:.0f} N and {torque:.1f} Nm"
                return Ending.BROKE
            return None
        if self.tipping.leans and not self.releasing and force > MIN_TIPPING_FORCE:
            self.detail = f"{force:.0f} N tip the base over"
            return Ending.TOO_HARD
        force, torque = (float(np.linalg.norm(v)) for v in np.split(self.arm.wrench, 2))
        hard = not self.releasing and (force > most.force or torque > most.torque)
        blocked = self.arm.load > self.max_load
        self.strained = self.strained + 1 if hard or blocked else 0
        if self.strained < MAX_OVERLOAD_STEPS:
            return None
        if blocked:
            self.detail = f"a joint is at {100 * self.arm.load:.0f} % of its allowed load"
            return Ending.BLOCKED
        self.detail = (
            f"{force:.0f} N and {torque:.1f} Nm, limits {most.force:g} N and {most.torque:g} Nm"
        )
        return Ending.TOO_HARD

    def rest(self, stage: Stage, seconds: float) -> Ending | None:
        """Keep the arm still for some time; return the ending it causes, or None."""
        self.arm.go(self.arm.q, np.zeros_like(self.arm.q))
        for _ in range(max(1, round(seconds / self.step))):
            ending = self.tick(stage)
            if ending is not None:
                return ending
        return None

    def stop(self) -> None:
        """Hold the arm and the base where they are, so that nothing is pulled further."""
        self.arm.stop()
        if self.base is not None:
            self.base.stop()

    def send_base(self, plan: Trajectory, sample: int) -> None:
        """Send a moving base to where a trajectory has it at a sample."""
        if self.base is not None and plan.base is not None:
            self.base.go(plan.base[sample])

    def reached_sample(self, plan: Trajectory, sample: int, before: int) -> int:
        """Return the sample of a trajectory that the base has reached, by its odometry.

        Wheels follow late. An arm that went on without them would pull the part aside, and a short
        arm cannot make up for them.

        Args:
            plan: The trajectory.
            sample: The sample to which the base was sent.
            before: The sample that it had reached one step earlier.
        """
        if self.base is None or plan.base is None:
            return sample
        first = max(before, sample - round(MAX_LATE / self.step))
        left = self.base.distances_to(plan.base[first : min(first + CATCH_UP, sample) + 1])
        # Where the base rests in the plan, the arm goes on.
        return first + int(np.flatnonzero(left <= left.min() + 1e-9)[-1])

    def planned_tool(self, plan: Trajectory, sample: int) -> Float[np.ndarray, "4 4"]:
        """Return the planned tool pose at a sample of a trajectory."""
        base = None
        if plan.base is not None:
            base = base_coordinates(self.world, plan.base[sample][None])[0]
        return self.arm.kinematics.at(plan.q[sample], base)[0]

    def offset_pose(self, T: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
        """Return a planned tool pose with the offsets that the hand has found on its way in."""
        moved = T.copy()
        moved[:3, 3] += self.lateral_offset * T[:3, :3] @ self.world.hand.axis + self.forward_offset
        return moved

    def close_fingers(
        self, q: Float[np.ndarray, " n"], *, one_sided: bool = False, gives: bool = True
    ) -> Ending | None:
        """Close the fingers until the pads of both sides bear a load.

        Args:
            q: Arm state [rad] or [m].
            one_sided: One finger under load is enough.
            gives: Make the arm compliant along the closing axis.
        """
        grip, arm, still = self.config.gripper, self.arm, np.zeros_like(q)
        T = self.offset_pose(arm.kinematics.at(q)[0])
        closing = T[:3, :3] @ self.world.hand.axis
        across = np.outer(closing, closing)  # the fingers center the hand along this axis only
        reference = Reference(q, still, T, np.zeros(6), EVERYWHERE, across)
        way = max(abs(f.closed - f.open) * f.lever for f in self.world.hand.fingers)
        enough, firm = MIN_LOADED * self.world.hand.force, 0
        for k in range(round((way / grip.speed + GRIP_PATIENCE) / self.step)):
            self.command_fingers(grip.speed * k * self.step)
            if gives:
                arm.follow(reference)
            else:
                arm.go(q, still)
            ending = self.tick(Stage.GRIP)
            if ending is not None:
                return ending
            firm = firm + 1 if min(self.touch.pads) > enough else 0
            if firm * self.step >= GRIP_PATIENCE / 2:
                return None
        one = max(self.touch.pads) > enough
        if one and one_sided:
            return None
        return Ending.ONE_SIDED if one else Ending.NOTHING_HELD

    def command_fingers(self, way: float) -> None:
        """Set the closing travel of each pad from its open position [m]; inf for full force."""
        grip = self.config.gripper
        for finger, motor in self.world.fingers:
            sign = np.sign(finger.closed - finger.open)
            press = self.world.hand.force / grip.stiffness / finger.lever
            most = abs(finger.closed - finger.open) + press
            self.world.data.ctrl[motor] = finger.open + sign * min(way / finger.lever, most)

    def let_go(self) -> Ending | None:
        """Open the fingers and the weld; return the ending it causes, or None."""
        self.held = False
        self.observer.let_go()
        self.world.release()
        self.command_fingers(0.0)
        return self.rest(Stage.GRIP, GRIP_TIME)

    def check_grasp(self) -> Ending | None:
        """Return SLIPPED if the pads have borne no load for too long."""
        if not self.held or self.config.hold != "contact":
            return None
        self.unloaded = self.unloaded + 1 if max(self.touch.pads) < 1.0 else 0
        return Ending.SLIPPED if self.unloaded * self.step > LOST_TIME else None
