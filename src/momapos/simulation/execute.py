"""Execute a motion in physics, and judge it."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import Clock, InputError, contact_text
from momapos.core.geometry import rotation_angle, wrap_angle
from momapos.model import time_motion
from momapos.model.records import Family, Hold, Motion, Task
from momapos.model.robots import Robot
from momapos.model.scene import Scene, SceneObject
from momapos.model.urdf import opening_of

from .arm_control import ArmKinematics, PacedTrajectory, pace_trajectory
from .base_drive import BaseDrive, base_pose_of
from .config import AT_END, GOOD, PUSH_SPEED, RECOVERABLE, SUBSTEPS, Ending, ExecutionConfig
from .execution_run import BelievedJoint, ExecutionRun, Observer, Stretch, Watch
from .joint_estimate import Axis, JointDoubt, JointEstimate, LearnedPart
from .robot_dynamics import Dynamics, find_hand, read_dynamics
from .run_record import Collision, Execution, JointFound, Pose
from .simulated_room import PartResistance
from .simulation import Simulation
from .stages import PlanHomePath, carry_out, retreat
from .true_worlds import TrueWorld
from .worlds import WorldSetup, draw_worlds

if TYPE_CHECKING:
    from jaxtyping import Float


MAX_PLACED_OFFSET, MAX_PLACED_ANGLE = 0.02, np.radians(15.0)
"""Maximum deviation of a placed object from its goal [m], [rad]."""


@dataclass(frozen=True)
class TaskOutcome:
    """Verdict on a task, with the value it is based on."""

    success: bool
    reason: str
    """Why the task failed; "" on success."""
    start: float
    """Initial value of the joint [rad] or [m]; for movable objects the height [m]."""
    asked: float
    reached: float


def judge(
    world: Simulation,
    observer: Observer,
    task: Task,
    item: SceneObject,
    T_first: Float[np.ndarray, "4 4"],
    motion: Motion,
    config: ExecutionConfig,
    stopped: str,
) -> TaskOutcome:
    """Judge a run by its final state.

    Args:
        world: The world at the end.
        observer: Observations of the whole run.
        task: The task.
        item: The object, as the scene has it.
        T_first: Initial pose of the part or object.
        motion: The executed motion.
        config: Tolerances.
        stopped: Why the run ended early; "" otherwise.
    """
    if observer.diverged:
        return TaskOutcome(False, stopped, 0.0, 0.0, 0.0)
    if task.poses:  # the tool is compared with the plan along the whole motion
        reason, start, asked, reached = "", 0.0, 0.0, 0.0
    elif task.joint is None:
        reason, start, asked, reached = _judge_object(
            world, observer, task, item, T_first, motion, config
        )
    else:
        assert task.to is not None
        asked = task.to
        start, reached = float(item.values()[task.joint]), float(world.data.qpos[world.part_q])
        if task.verb == "press":  # it may spring back
            reached = float(np.clip(asked, *observer.part_range))
        near = abs(reached - asked) <= config.tolerance * abs(asked - start)
        reason = ""
        if not near or stopped:
            share = (reached - start) / (asked - start) if asked != start else 0.0
            reason = f"{task.joint} moved {100 * share:.0f} % of the requested travel"
            latch = world.latch
            waits = latch is not None and not latch.turned(world.data.qpos, config.tolerance)
            if latch is not None and waits and not near:
                reason += f"; its latch {latch.joint} is not turned"
    reasons = [text for text in (stopped, reason) if text]
    # Collisions within one object do not count as hard: hulls of hollow shapes overlap where the
    # shapes pass each other.
    touched = [c for c in observer.hardest() if not is_of_one_object(c)]
    hard = [c for c in touched if c.force > config.touch_force]
    hit = (hard or observer.hardest())[:1]
    if hit and (reasons or hard):
        reasons.append(hit_text(hit[0]))
    return TaskOutcome(not reasons, "; ".join(reasons), start, asked, reached)


def hit_text(hit: Collision) -> str:
    """Return a contact of a run in words."""
    return f"hit: {contact_text(hit.one, hit.other, hit.depth)} with {hit.force:.0f} N"


def _judge_object(
    world: Simulation,
    observer: Observer,
    task: Task,
    item: SceneObject,
    T_first: Float[np.ndarray, "4 4"],
    motion: Motion,
    config: ExecutionConfig,
) -> tuple[str, float, float, float]:
    """Check that an object is lifted and still in the hand, or rests at its goal.

    Returns:
        The reason of a failure, and the heights at the start, requested and reached [m].
    """
    T, goal = world.T_world_part, item.T_world_object
    start, reached, reason = float(T_first[2, 3]), float(T[2, 3]), ""
    if task.verb == "place":
        off = float(np.linalg.norm(T[:3, 3] - goal[:3, 3]))
        tilt = float(rotation_angle(T[:3, :3], goal[:3, :3]))
        if off > MAX_PLACED_OFFSET or tilt > MAX_PLACED_ANGLE:
            turned = f"{np.degrees(tilt):.0f} deg"
            reason = f"{item.name} is {100 * off:.1f} cm and {turned} from its goal"
        return reason, start, float(goal[2, 3]), reached
    lift = float(motion.Ts_world_tool[-1, 2, 3] - motion.Ts_world_tool[0, 2, 3])
    if observer.slip.position > config.slip:
        reason = f"{item.name} slipped {100 * observer.slip.position:.1f} cm in the hand"
    elif reached - start < (1 - config.tolerance) * lift:
        reason = f"{item.name} was lifted only {100 * (reached - start):.1f} cm"
    return reason, start, start + lift, reached


def is_of_one_object(hit: Collision) -> bool:
    """Return whether two elements belong to the same piece of furniture."""
    one, other = hit.one.rpartition("/")[0], hit.other.rpartition("/")[0]
    return one == other != ""


DEFAULT = ExecutionConfig()
MAX_BASE_GAP = 1e-6
"""Largest difference of the base pose and the first one of a motion's base [m] or [rad]."""
_OBSTRUCTED = (Ending.BLOCKED, Ending.BEHIND, Ending.MEETS_ROBOT, Ending.TOO_HARD)
_WELD_INSTEAD = "the fingers of {} do not close on anything; a weld replaces the grasp"


@dataclass(frozen=True, eq=False)
class RetryState:
    """State that a further attempt starts from."""

    scene: Scene
    """Room as the robot believes it to be; the motion is planned for it."""
    value: float
    """True value of the part's joint [rad] or [m]."""
    collisions: Mapping[tuple[str, str], Collision]
    """Collisions of the earlier attempts."""


@dataclass(frozen=True, eq=False)
class AttemptOutcome:
    """Result of an attempt, and what may follow."""

    execution: Execution
    ending: Ending
    learned: LearnedPart | None
    """State of the part by the hand's last contact; None if the hand did not move it."""
    value: float
    """True value of the part's joint, unknown to the robot [rad] or [m]."""
    collisions: Mapping[tuple[str, str], Collision]
    at_home: bool
    """Whether the motion failed and the arm is back home, ready for another attempt."""

    @property
    def in_the_way(self) -> bool:
        """Whether the arm could not follow the part from this base pose."""
        return self.learned is not None and self.ending in _OBSTRUCTED

    @property
    def nothing_there(self) -> bool:
        """Whether the hand closed on nothing."""
        return self.learned is None and self.ending is Ending.NOTHING_HELD

    @property
    def ran_away(self) -> bool:
        """Whether the part had moved away when the hand came to push it."""
        return self.ending is Ending.NOTHING_MET


def attempt(
    scene: Scene,
    robot: Robot,
    base_pose: Pose,
    motion: Motion,
    task: Task,
    config: ExecutionConfig = DEFAULT,
    rng: np.random.Generator | None = None,
    *,
    true_world: TrueWorld | None = None,
    again: RetryState | None = None,
    way_home: PlanHomePath | None = None,
    doubt: JointDoubt | None = None,
    watch: Watch | None = None,
    clock: Clock = time.perf_counter,
) -> AttemptOutcome:
    """Execute a motion at a base pose and judge it; if it fails, bring the arm home.

    Independent of the planner: neither its collision shapes nor its kinematics are used.

    Args:
        scene: The room at the start of the run.
        robot: The robot.
        base_pose: x [m], y [m], yaw [rad] of its base.
        motion: Arm motion. Together with the scene it gives the initial estimate of the part's
            joint; from there on the arm follows what it feels.
        task: The task.
        config: How to model and judge.
        rng: Draws the resistance of the furniture if `config.furniture.spread` is not 0.
        true_world: The true room; by default the scene.
        again: State after earlier attempts; None for the first one.
        way_home: Plans the arm's path home after a failed motion; None to stay there.
        doubt: Ends the motion if the hand's path contradicts the believed joint.
        watch: Called after every control step.
        clock: Measures the wall time.

    Raises:
        SceneError: The robot starts in collision.
        InputError: The motion cannot be timed, or the engine rejects the model, or the base of the
            motion does not begin at `base_pose`.
    """
    _check_first_pose(base_pose, motion)
    assert robot.model.urdf.path is not None
    rng = rng or np.random.default_rng(0)
    dynamics = read_dynamics(robot.model.urdf.path)
    hand, notes = find_hand(robot, dynamics.mimics), []
    if config.hold == "contact" and not hand.closes:
        config = replace(config, hold="weld")
        notes.append(_WELD_INSTEAD.format(robot.name))
    worlds = draw_worlds(
        WorldSetup(scene, robot, base_pose, motion, task, hand, dynamics, config),
        rng,
        true_world=true_world,
        believed=None if again is None else again.scene,
        begin=None if again is None else again.value,
    )
    world, known = worlds.there, worlds.known
    there = worlds.room
    item = there.scene.object(there.task.object)
    believed = scene if again is None else again.scene
    belief = believed_joint(believed.object(task.object), task.joint)
    touched = None if again is None else again.collisions
    base = None
    if motion.base is not None:
        slips = rng.spawn(1)[0]  # its own stream, so that the furniture does not depend on it
        step = config.timestep * SUBSTEPS
        base = BaseDrive(world, robot, motion.base[0], config.base, step, slips)
    run = ExecutionRun(
        world, motion, task, config, worlds.seal, belief, known, watch, touched, doubt, base
    )
    run.begin_with(item)
    run.check_start()
    began = clock()
    approach = _approach(robot, motion, task, config, known, careful=again is not None)
    ending = carry_out(run, approach, _stretches(robot, motion, task, config, known))
    detail, at_home = run.detail, False
    if way_home is not None and belief is not None and ending in RECOVERABLE:
        at_home = retreat(run, robot, approach, way_home)
    wall = clock() - began
    how = f"{ending}: {detail}" if detail else str(ending)
    stopped = "" if ending in GOOD else how
    verdict = judge(
        world, run.observer, there.task, item, run.T_part_first, motion, config, stopped
    )
    notes += _effort_notes(robot, dynamics, world)
    if ending in AT_END:
        notes.append(how)
    execution = _outcome(run, base_pose, ending, verdict, worlds.resistance, wall, notes)
    value = float(world.data.qpos[world.part_q])
    return AttemptOutcome(execution, ending, run.learned, value, run.observer.collisions, at_home)


def _check_first_pose(base_pose: Pose, motion: Motion) -> None:
    if motion.base is None:
        return
    off = motion.base[0] - np.array(base_pose)
    if max(abs(off[0]), abs(off[1]), abs(float(wrap_angle(off[2])))) > MAX_BASE_GAP:
        raise InputError(
            f"base_pose must be the first base pose of the motion, {motion.base[0].tolist()}, not "
            f"{list(base_pose)}"
        )


def _effort_notes(robot: Robot, dynamics: Dynamics, world: Simulation) -> list[str]:
    """Return the assumptions about the motors, one line each."""
    notes = []
    unknown = [name for name in robot.moved_joints if name not in dynamics.efforts]
    if unknown:
        notes.append(f"no effort limit is known for {', '.join(unknown)}")
    if world.balanced:
        notes.append(
            "the effort limits in the URDF are below what the arm's own weight needs; springs are "
            f"assumed to bear it: {', '.join(world.balanced)}"
        )
    return notes


def cuts_of(motion: Motion) -> list[tuple[int, int, Hold | None]]:
    """Cut a motion where the hand grasps and lets go.

    Returns:
        First and last state of each section, and the hold; None for a free hand. A hand that turns
        a latch holds in two sections, before and after the part moves. Poses that a tool
        passes are no holds.
    """
    if motion.holds and all(hold.first == hold.last for hold in motion.holds):
        return [(0, len(motion.q) - 1, None)]
    cuts: list[tuple[int, int, Hold | None]] = []
    for hold in motion.grasps:
        before = cuts[-1][1] if cuts else 0
        if cuts or hold.first > 0:
            cuts.append((before, hold.first, None))
        cuts.append((hold.first, hold.last, hold))
    if motion.latch_q is not None:  # the hand turns the latch, and holds on as the part moves
        first, last, held = cuts.pop(0)
        turned = motion.holds[0].first
        cuts[:0] = [(first, turned, held), (turned, last, held)]
    return cuts


def section_of(motion: Motion, first: int, last: int) -> Motion:
    """Return the states of a section of a motion."""
    states = slice(first, last + 1)
    return replace(
        motion, approach=motion.q[states], q=motion.q[states],
        object_q=motion.object_q[states], Ts_world_tool=motion.Ts_world_tool[states],
        approach_times=None, times=None, holds=(), latch_q=None,
        base=None if motion.base is None else motion.base[states],
    )  # fmt: skip


def _stretches(
    robot: Robot, motion: Motion, task: Task, config: ExecutionConfig, room: Simulation
) -> list[Stretch]:
    """Time the sections of a motion."""
    config = replace(config, speed=config.speed.for_task(task))
    step, latched = config.timestep * SUBSTEPS, motion.latch_q is not None
    stretches = []
    for index, (first, last, held) in enumerate(cuts_of(motion)):
        part = section_of(motion, first, last)
        speed = config.speed
        if held is not None and held.kind is Family.PUSH:
            most = min(speed.tool_speed, PUSH_SPEED)
            speed = replace(speed, tool_speed=most)
        # A placed object is let go first: there is nothing to carry.
        verb = None if task.verb == "place" else task.verb
        free, slow = time_motion(robot, part, speed, step, verb=verb)
        if held is not None:
            turns, goes_on = latched and index == 0, latched and index == 1
            stretches.append(Stretch(slow, part, held, turns_latch=turns, goes_on=goes_on))
            continue
        if part.base is not None:  # the base drives, at the speed of a manipulation
            free = slow
        way = pace_trajectory(
            free, part.q, part.Ts_world_tool[:, :3, 3], room, config,
            value=float(part.object_q[0]), base=part.base,
        )  # fmt: skip
        stretches.append(Stretch(free, part, None, way))
    return stretches


def _approach(
    robot: Robot,
    motion: Motion,
    task: Task,
    config: ExecutionConfig,
    room: Simulation,
    *,
    careful: bool,
) -> PacedTrajectory:
    """Return the approach, slow where the arm is near the known room."""
    step = config.timestep * SUBSTEPS
    plan, _ = time_motion(robot, motion, config.speed.for_task(task), step, verb=task.verb)
    path = motion.approach if len(motion.approach) else motion.q[:1]
    kinematics = ArmKinematics(room)
    tool = np.array([kinematics.at(q)[0][:3, 3] for q in path])
    return pace_trajectory(plan, path, tool, room, config, careful=careful)


def believed_joint(item: SceneObject, name: str | None) -> BelievedJoint | None:
    """Return the joint of a part as the robot believes it; None for a movable object."""
    if name is None:
        return None
    joint = item.model.joint(name)
    T = item.link_poses()[joint.parent] @ joint.T_parent_joint
    axis = Axis(joint.kind == "prismatic", T[:3, :3] @ joint.axis, T[:3, 3])
    alone = not item.model.followers(name)
    return BelievedJoint(axis, opening_of(item.model, name).closed, alone)


def _outcome(
    run: ExecutionRun,
    base_pose: Pose,
    ending: Ending,
    verdict: TaskOutcome,
    resistance: PartResistance,
    wall: float,
    notes: list[str],
) -> Execution:
    observer, config = run.observer, run.config
    if run.world.loose:
        names = ", ".join(run.world.loose)
        notes.append(f"ignored contacts with the moved part that the scene starts with: {names}")
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
        stability=run.tipping.stability,
        clearance=None if np.isinf(observer.clearance) else observer.clearance,
        base_shift=(shift[0], shift[1], shift[2]),
        resistance=asdict(resistance),
        time={name.value: n * run.step for name, n in run.spent.items()},
        simulated=run.time,
        wall=wall,
        ending=str(ending),
        joint=_joint_found(run.estimate),
        base_pose=base_pose,
        final_base_pose=None if run.base is None else _final_base(run.world),
        notes=tuple(notes),
    )


def _final_base(world: Simulation) -> Pose:
    x, y, yaw = base_pose_of(world, world.data.qpos).tolist()
    return x, y, yaw


def _joint_found(estimate: JointEstimate | None) -> JointFound | None:
    if estimate is None:
        return None
    axis = estimate.axis
    (a, b, c), (x, y, z) = axis.direction.tolist(), axis.point.tolist()
    return JointFound((a, b, c), (x, y, z), estimate.tilt, estimate.shift)
