"""Execute a motion in physics, and judge it."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace

import numpy as np

from momapos.core import Clock
from momapos.model import time_motion
from momapos.model.records import Hold, Motion, Task
from momapos.model.robots import Robot
from momapos.model.scene import Scene, SceneObject
from momapos.model.urdf import opening_of

from .approach import PacedTrajectory, paced
from .arm_control import ArmKinematics
from .config import AT_END, GOOD, RECOVERABLE, Ending, ExecutionConfig
from .dynamics import Dynamics, read_dynamics
from .joint_estimate import Axis, Doubt, JointEstimate, Learned
from .retreat import WayHome, retreat
from .run_record import Collision, Execution, JointFound, Pose
from .simulated_hand import find_hand
from .simulated_room import Resistance
from .simulation import Simulation
from .stages import Belief, ExecutionRun, Stretch, Watch
from .true_worlds import TrueWorld
from .verdict import TaskOutcome, judge
from .worlds import Setting, draw_worlds

DEFAULT = ExecutionConfig()
_IN_THE_WAY = (Ending.BLOCKED, Ending.BEHIND, Ending.MEETS_ROBOT, Ending.TOO_HARD)
_WELD_INSTEAD = "the fingers of {} do not close on anything: a weld stands for its hold"


@dataclass(frozen=True, eq=False)
class Again:
    """What another try begins with."""

    scene: Scene
    """The room as the robot believes it to be, for which the motion is planned."""
    value: float
    """Where the part's joint truly is [rad] or [m]."""
    collisions: Mapping[tuple[str, str], Collision]
    """All touches of the tries before."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """What came of a motion, and what may follow."""

    execution: Execution
    ending: Ending
    learned: Learned | None
    """Where the hand had the part last; None where it did not move it."""
    value: float
    """Where the part's joint truly is, which it does not know [rad] or [m]."""
    collisions: Mapping[tuple[str, str], Collision]
    at_home: bool
    """Whether the motion failed and the arm is home again, so that another may be tried."""

    @property
    def in_the_way(self) -> bool:
        """Whether the arm could not follow the part from where the base stands."""
        return self.learned is not None and self.ending in _IN_THE_WAY

    @property
    def nothing_there(self) -> bool:
        """Whether the hand found nothing where it closed."""
        return self.learned is None and self.ending is Ending.NOTHING_HELD

    @property
    def ran_away(self) -> bool:
        """Whether the part was not there any more when the hand came to push it on."""
        return self.ending is Ending.NOTHING_MET


def execute(
    scene: Scene,
    robot: Robot,
    base_pose: Pose,
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
        motion: Of the arm. What it and the scene say of the object is where the arm begins to look
            for its joint; from there on it follows what it feels.
        task: What is to be done.
        config: How to model and judge.
        rng: Draws how the furniture resists, where `config.furniture.spread` is not 0.
        watch: Sees the world after every step of the controller.
        clock: Measures the wall time.

    Raises:
        SceneError: The robot stands in something at the beginning.
        InputError: The motion cannot be timed, or the engine refuses the model.
    """
    return attempt(
        scene, robot, base_pose, motion, task, config, rng, watch=watch, clock=clock
    ).execution


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
    again: Again | None = None,
    way_home: WayHome | None = None,
    doubt: Doubt | None = None,
    watch: Watch | None = None,
    clock: Clock = time.perf_counter,
) -> Outcome:
    """Execute a motion; where it fails, let go and bring the arm home.

    Args:
        scene, robot, base_pose, motion, task, config, rng, watch, clock: See `execute`. The scene
            is the one that the run began with.
        true_world: What is really there; as the scene says by default.
        again: What earlier tries left; None for the first one.
        way_home: Plans the arm's way home from where a motion failed; None to stay there.
        doubt: Ends the motion where the hand's way speaks against the joint as believed.

    Raises:
        SceneError: The robot stands in something at the beginning.
        InputError: The motion cannot be timed, or the engine refuses the model.
    """
    assert robot.model.urdf.path is not None
    dynamics = read_dynamics(robot.model.urdf.path)
    hand, notes = find_hand(robot, dynamics.mimics), []
    if config.hold == "contact" and not hand.closes:
        config = replace(config, hold="weld")
        notes.append(_WELD_INSTEAD.format(robot.name))
    worlds = draw_worlds(
        Setting(scene, robot, base_pose, motion, task, hand, dynamics, config),
        rng or np.random.default_rng(0),
        true_world=true_world,
        believed=None if again is None else again.scene,
        begin=None if again is None else again.value,
    )
    world, known = worlds.there, worlds.known
    there = worlds.room
    item = there.scene.object(there.task.object)
    believed = scene if again is None else again.scene
    belief = _belief(believed.object(task.object), task.joint)
    touched = None if again is None else again.collisions
    run = ExecutionRun(
        world, motion, task, config, worlds.seal, belief, known, watch, touched, doubt
    )
    if task.verb == "place":
        run.carry(item)
    run.check_start()
    began = clock()
    approach = _approach(robot, motion, task, config, known, careful=again is not None)
    ending = run.go(approach, _stretches(robot, motion, task, config, known))
    detail, at_home = run.detail, False
    if way_home is not None and belief is not None and ending in RECOVERABLE:
        at_home = retreat(run, robot, approach, way_home)
    wall = clock() - began
    how = f"{ending}: {detail}" if detail else str(ending)
    stopped = "" if ending in GOOD else how
    verdict = judge(world, run.observer, there.task, item, run.first, motion, config, stopped)
    notes += _effort_notes(robot, dynamics, world)
    if ending in AT_END:
        notes.append(how)
    execution = _outcome(run, base_pose, ending, verdict, worlds.resistance, wall, notes)
    value = float(world.data.qpos[world.part_q])
    return Outcome(execution, ending, run.learned, value, run.observer.collisions, at_home)


def _effort_notes(robot: Robot, dynamics: Dynamics, world: Simulation) -> list[str]:
    """What is assumed of the motors."""
    notes = []
    unknown = [name for name in robot.moved_joints if name not in dynamics.efforts]
    if unknown:
        notes.append(f"no effort limit is known of {', '.join(unknown)}")
    if world.balanced:
        notes.append(
            "the URDF's efforts are less than the arm's own weight takes, which springs are taken "
            f"to bear: {', '.join(world.balanced)}"
        )
    return notes


def _stretches(
    robot: Robot, motion: Motion, task: Task, config: ExecutionConfig, room: Simulation
) -> list[Stretch]:
    """The motion cut where the hand takes hold and lets go."""
    step = config.timestep * config.substeps
    holds = motion.holds or (Hold(0, len(motion.q) - 1),)
    cuts: list[tuple[int, int, Hold | None]] = []
    for hold in holds:
        if cuts:
            cuts.append((cuts[-1][1], hold.first, None))
        cuts.append((hold.first, hold.last, hold))
    stretches = []
    for first, last, held in cuts:
        states = slice(first, last + 1)
        part = replace(
            motion, approach=motion.q[states], q=motion.q[states],
            object_q=motion.object_q[states], Ts_world_tool=motion.Ts_world_tool[states],
            approach_times=None, times=None, holds=(),
        )  # fmt: skip
        speed = config.speed
        if held is not None and held.family == "push":
            most = min(speed.tool_speed, config.compliance.push_speed)
            speed = replace(speed, tool_speed=most)
        # What is placed is let go before: there is nothing to carry.
        verb = None if task.verb == "place" else task.verb
        free, slow = time_motion(robot, part, speed, step, verb=verb)
        if held is not None:
            stretches.append(Stretch(slow, part, held))
            continue
        way = paced(
            free, part.q, part.Ts_world_tool[:, :3, 3], room, config,
            value=float(part.object_q[0]),
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
    """The approach, slow where the arm is near what the robot knows of the room."""
    step = config.timestep * config.substeps
    plan, _ = time_motion(robot, motion, config.speed, step, verb=task.verb)
    path = motion.approach if len(motion.approach) else motion.q[:1]
    kinematics = ArmKinematics(room)
    tool = np.array([kinematics.at(q)[0][:3, 3] for q in path])
    return paced(plan, path, tool, room, config, careful=careful)


def _belief(item: SceneObject, name: str | None) -> Belief | None:
    """What the scene says of the part's joint."""
    if name is None:
        return None
    joint = item.model.joint(name)
    T = item.link_poses()[joint.parent] @ joint.T_parent_joint
    axis = Axis(joint.kind == "prismatic", T[:3, :3] @ joint.axis, T[:3, 3])
    return Belief(axis, opening_of(item.model, name).closed)


def _outcome(
    run: ExecutionRun,
    base_pose: Pose,
    ending: Ending,
    verdict: TaskOutcome,
    resistance: Resistance,
    wall: float,
    notes: list[str],
) -> Execution:
    """Gather what was seen."""
    observer, config = run.observer, run.config
    if run.world.loose:
        names = ", ".join(run.world.loose)
        notes.append(f"touch the moved part in the scene, and are left out against it: {names}")
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
        time={name.value: n * run.step for name, n in run.spent.items()},
        simulated=run.time,
        wall=wall,
        ending=str(ending),
        joint=_joint_found(run.estimate),
        base_pose=base_pose,
        notes=tuple(notes),
    )


def _joint_found(estimate: JointEstimate | None) -> JointFound | None:
    if estimate is None:
        return None
    axis = estimate.axis
    (a, b, c), (x, y, z) = axis.direction.tolist(), axis.point.tolist()
    return JointFound((a, b, c), (x, y, z), estimate.tilt, estimate.shift)
