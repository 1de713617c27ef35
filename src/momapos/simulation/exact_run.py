"""Execute the states of a plan in physics as they are: drive, approach, grasps, path home.

Nothing is replanned, avoided or made up for. Arm and base follow the plan's own states on straight
motions between them, at the plan's times where it has any. The verdict states whether the part
moved as planned, and what touched that should not.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import Clock, InputError
from momapos.core.geometry import rotation_angle, wrap_angle
from momapos.model import time_motion
from momapos.model.records import Hold, Motion, PlacementPlan
from momapos.model.robots import Robot, opened_as
from momapos.model.scene import Scene, with_assumptions

from .base_drive import BaseDrive, base_pose_of
from .config import (
    DWELL_TIME,
    GOOD,
    SETTLE_TIME,
    SUBSTEPS,
    Ending,
    ExecutionConfig,
    FurnitureConfig,
    Stage,
)
from .execute import believed_joint, cuts_of, hit_text, is_of_one_object, judge, section_of
from .execution_run import ExecutionRun, Watch
from .robot_dynamics import find_hand, read_dynamics
from .run_record import Collision, Execution, RunRecord, Visit
from .stages import grasp_here, press_in, presses
from .worlds import WorldSetup, draw_worlds

if TYPE_CHECKING:
    from jaxtyping import Float

EXACT = ExecutionConfig(furniture=FurnitureConfig(spread=0.0))
"""No random resistance: all runs of a plan are the same."""
ARM_SHARE, ARM_SPEED = 0.25, 0.8
"""Speed of a joint where the plan has no times: a share of its limit [-], and its limit where the
file has none [rad/s] or [m/s]."""
TOOL_SPEED = 0.1
"""Largest speed of the hand meanwhile [m/s]."""
BASE_SHARE, BASE_SMOOTHING = 0.2, 0.4
"""Share of the base's speed limits that a drive uses [-], and the time over which it smooths the
corners of its path [s]. Narrow bases of the library, with an arm up, tip over at twice that speed;
at this one a corner is cut by less than 1 cm."""
RETURN_TIME = 0.3
"""Time in which the hand returns to the plan after a grasp [s]."""
MAX_PART_ERROR = 0.1
"""Largest difference of the part's value from the plan's on its path, as a share of its travel [-]:
fingers give, and a hand that pushes leads."""
MAX_TOOL_ERROR, MAX_TOOL_ANGLE = 0.02, float(np.radians(5.0))
"""Largest distance of the free hand from the plan's tool pose [m], [rad]."""
MAX_DEPTH = 3e-3
"""Largest overlap in a contact that the verdict ignores, as in the exact check [m]."""


@dataclass
class _Offsets:
    """How far the world was from the states of the plan at most."""

    part: float = 0.0
    """Value of the part [rad] or [m]."""
    tool: float = 0.0
    """Tool while the hand is free [m]."""
    angle: float = 0.0
    """[rad]"""


class _PlanRun:
    """A run of a plan's own states, in progress."""

    def __init__(
        self, plan: PlacementPlan, scene: Scene, robot: Robot, config: ExecutionConfig,
        watch: Watch | None,
    ) -> None:  # fmt: skip
        assert plan.motion is not None
        assert plan.base_pose is not None
        assert robot.model.urdf.path is not None
        self.plan, self.motion, self.robot = plan, plan.motion, robot
        dynamics = read_dynamics(robot.model.urdf.path)
        hand = find_hand(robot, dynamics.mimics)
        if config.hold == "contact" and not hand.closes:
            config = replace(config, hold="weld")
        setting = WorldSetup(
            scene, robot, plan.base_pose, self.motion, plan.task, hand, dynamics, config
        )
        worlds = draw_worlds(setting, np.random.default_rng(0))
        self.step = config.timestep * SUBSTEPS
        self.base = BaseDrive(worlds.there, robot, np.array(plan.base_pose), None, self.step)
        belief = believed_joint(scene.object(plan.task.object), plan.task.joint)
        self.run = ExecutionRun(
            worlds.there, self.motion, plan.task, config, worlds.seal, belief, worlds.known, watch,
            base=self.base,
        )  # fmt: skip
        self.offsets, self.drive = _Offsets(), _drive_path(plan)
        self.offset = np.zeros(len(plan.joints))
        """Of the arm from the plan, where fingers centered the hand [rad] or [m]."""
        self.base.put(self.drive[0])
        self.run.begin_with(scene.object(plan.task.object))

    def carry_out(self) -> Ending:
        """Drive, approach, and move the part; return how it ended."""
        run, motion, place = self.run, self.motion, self.plan.task.verb == "place"
        ending = run.rest(Stage.SETTLE, SETTLE_TIME)
        if place:
            run.observer.hold()
            if run.config.hold == "contact":
                ending = ending or run.close_fingers(run.arm.q, gives=False)
                run.world.release()
        ending = ending or self._drive() or self._approach()
        for first, last, hold in cuts_of(motion):
            free = place or hold is None or bool(self.plan.task.poses)
            if free:
                if run.held:
                    ending = ending or run.let_go()
            elif not run.held:
                section = section_of(motion, first, last)
                ending = ending or grasp_here(run, section, hold, searches=False)
                self.offset = run.arm.q - motion.q[first]
            if hold is not None and presses(self.plan.task, section_of(motion, first, last)):
                ending = ending or press_in(run)
            else:
                ending = ending or self._manipulate(first, last, None if free else hold)
            if ending is not None:
                return ending
        return run.rest(Stage.DWELL, DWELL_TIME) or Ending.DONE

    def go_home(self) -> Ending | None:
        """Follow the path home after the task; a picked object stays in the hand."""
        home, run = self.motion.home, self.run
        if home is None:
            return None
        ending = None if self.plan.task.verb == "pick" or not run.held else run.let_go()
        return ending or self._follow(home, self._times_home(home), Stage.RETREAT)

    def _times_home(self, home: Float[np.ndarray, "m n"]) -> Float[np.ndarray, " m"]:
        """Return times for a path home, at which the arm accelerates as on the rest of the plan.

        Without limits of acceleration an arm with an object tips a narrow base over at corners.
        """
        tools = np.array([self.run.arm.kinematics.at(q)[0] for q in home])
        back = Motion(home, home[-1:], np.zeros(1), tools[-1:])
        speed = self.run.config.speed.for_task(self.plan.task)
        timed, _ = time_motion(self.robot, back, speed, self.step, verb="place")
        return np.asarray(timed.state_times)

    def _drive(self) -> Ending | None:
        """Follow the base path, with the arm at the first state of the approach."""
        way, robot = self.drive, self.robot
        if len(way) < 2:
            return None
        length = np.hypot(*np.diff(way[:, :2], axis=0).T) / robot.max_speed
        turn = np.abs(np.diff(way[:, 2])) / robot.max_yaw_rate
        times = np.append(0.0, np.cumsum(np.maximum(length, turn) / BASE_SHARE))
        rest = round(BASE_SMOOTHING / self.step)
        sent = np.clip(np.arange(-rest, times[-1] / self.step + rest) * self.step, 0.0, times[-1])
        poses = np.stack([np.interp(sent, times, column) for column in way.T], axis=1)
        window = np.ones(rest) / rest
        for x, y, yaw in np.stack([np.convolve(c, window, "valid") for c in poses.T], axis=1):
            self.base.go(np.array([x, y, yaw]))
            ending = self.run.tick(Stage.DRIVE)
            if ending is not None:
                return ending
        self.base.go(way[-1])
        return self.run.rest(Stage.DRIVE, DWELL_TIME)

    def _approach(self) -> Ending | None:
        states, times = self.motion.approach, self.motion.approach_times
        if not len(states):
            return None
        times = self._times(states) if times is None else times
        return self._follow(states, times, Stage.APPROACH) or self.run.rest(Stage.APPROACH, 0.1)

    def _manipulate(self, first: int, last: int, hold: Hold | None) -> Ending | None:
        """Follow the states from one to another, with the base where it moves."""
        motion, states = self.motion, slice(first, last + 1)
        times = motion.times
        whole = self._times(motion.q, motion) if times is None else times
        base = None if motion.base is None else motion.base[states]
        at = whole[states] - whole[first]
        values = None if self.plan.task.verb == "press" else motion.object_q[states]
        return self._follow(
            motion.q[states], at, Stage.MANIPULATE, base, values,
            None if hold is not None else motion.Ts_world_tool[states],
        )  # fmt: skip

    def _follow(
        self,
        q: Float[np.ndarray, "m n"],
        times: Float[np.ndarray, " m"],
        stage: Stage,
        base: Float[np.ndarray, "m 3"] | None = None,
        part: Float[np.ndarray, " m"] | None = None,
        Ts_world_tool: Float[np.ndarray, "m 4 4"] | None = None,
    ) -> Ending | None:
        """Follow states on straight motions between them; return an early ending, or None."""
        run = self.run
        for k in range(int(np.ceil(times[-1] / self.step)) + 1):
            t = min(k * self.step, float(times[-1]))
            if not run.held:
                self.offset = self.offset * (1.0 - min(1.0, self.step / RETURN_TIME))
            wanted, speed = _between(q, times, t)
            run.arm.go(wanted + self.offset, speed)
            if base is not None:
                self.base.go(_between(base, times, t)[0])
            ending = run.tick(stage) or run.check_grasp()
            if ending is not None:
                return ending
            self._compare(t, times, part, Ts_world_tool)
        return None

    def _compare(
        self,
        t: float,
        times: Float[np.ndarray, " m"],
        part: Float[np.ndarray, " m"] | None,
        Ts_world_tool: Float[np.ndarray, "m 4 4"] | None,
    ) -> None:
        """Compare part and tool with the plan's states."""
        world, off = self.run.world, self.offsets
        if part is not None and self.plan.task.joint is not None:
            value = float(world.data.qpos[world.part_q])
            off.part = max(off.part, abs(value - float(np.interp(t, times, part))))
        if Ts_world_tool is not None:
            T, there = world.T_world_tool, Ts_world_tool[int(np.abs(times - t).argmin())]
            if abs(times - t).min() < self.step:
                off.tool = max(off.tool, float(np.linalg.norm(T[:3, 3] - there[:3, 3])))
                off.angle = max(off.angle, float(rotation_angle(T[:3, :3], there[:3, :3])))

    def _times(
        self, q: Float[np.ndarray, "m n"], motion: Motion | None = None
    ) -> Float[np.ndarray, " m"]:
        """Return times for states of a plan without times."""
        joints = [self.robot.model.joint(name) for name in self.plan.joints]
        speed = np.array([joint.velocity for joint in joints])
        speed = ARM_SHARE * np.where(np.isfinite(speed), speed, ARM_SPEED)
        lengths = [(np.abs(np.diff(q, axis=0)) / speed).max(1, initial=0.0)]
        if motion is not None:
            tools = motion.Ts_world_tool[:, :3, 3]
            lengths.append(np.linalg.norm(np.diff(tools, axis=0), axis=1) / TOOL_SPEED)
            if motion.base is not None:
                moved = np.abs(np.diff(motion.base, axis=0))
                lengths.append((moved / (BASE_SHARE * self.robot.max_speed)).max(1))
        return np.append(0.0, np.cumsum(np.max(lengths, axis=0)))

    def off_plan(self) -> list[str]:
        """Return in what the world was not as the plan states, in words."""
        off, values = self.offsets, self.motion.object_q
        found, travel = [], float(np.ptp(values)) if self.plan.task.joint is not None else 0.0
        if off.part > MAX_PART_ERROR * max(travel, 1e-9) and travel > 0.0:
            found.append(f"the part was {off.part:.3f} from the plan's values")
        if off.tool > MAX_TOOL_ERROR or off.angle > MAX_TOOL_ANGLE:
            turned = f"{np.degrees(off.angle):.0f} deg"
            found.append(f"the free hand was {100 * off.tool:.1f} cm and {turned} off the plan")
        return found


def run_exactly(
    plan: PlacementPlan,
    scene: Scene,
    robot: Robot,
    config: ExecutionConfig = EXACT,
    *,
    watch: Watch | None = None,
    clock: Clock = time.perf_counter,
) -> RunRecord:
    """Execute a plan's own states in physics, from its start to the end of its path home.

    Args:
        plan: A solved plan for this scene and robot.
        scene: The scene of the plan, with the joints that it begins with.
        robot: The robot; its hand opens as in the plan.
        config: How to model and judge.
        watch: Called after every control step.
        clock: Measures the wall time.

    Raises:
        InputError: The plan is not solved, or the engine rejects the model.
        SceneError: The robot starts in collision.
        RobotError: The plan rests a joint beyond its limits.
    """
    if plan.motion is None or plan.base_pose is None:
        raise InputError(f"the plan is {plan.status!r}: there is nothing to execute")
    scene, robot = with_assumptions(scene, plan), opened_as(robot, plan.robot_rest)
    following = _PlanRun(plan, scene, robot, config, watch)
    run, began = following.run, clock()
    run.check_start()
    ending = following.carry_out()
    reached = base_pose_of(run.world, run.world.data.qpos)
    stopped = "" if ending in GOOD else ": ".join(filter(None, (ending, run.detail)))
    outcome = judge(
        run.world, run.observer, plan.task, scene.object(plan.task.object), run.T_part_first,
        plan.motion, run.config, stopped,
    )  # fmt: skip
    reasons = [outcome.reason] if outcome.reason else []
    if ending in GOOD:
        after = following.go_home()
        reasons += [] if after is None else [f"path home: {after} {run.detail}".strip()]
        reasons += following.off_plan()
    hits = [hit for hit in run.observer.hardest() if _counts(hit, run.config)]
    if hits and not any("hit: " in reason for reason in reasons):
        reasons.append(hit_text(hits[0]))
    execution = Execution(
        success=not reasons, reason="; ".join(reasons), hold=run.config.hold,
        start=outcome.start, asked=outcome.asked, reached=outcome.reached,
        collisions=run.observer.hardest(), slip=run.observer.slip, load=run.observer.load,
        tracking=run.observer.tracking, stability=run.tipping.stability,
        clearance=None if np.isinf(run.observer.clearance) else run.observer.clearance,
        base_shift=_triple(run.observer.base_shift),
        time={name.value: n * run.step for name, n in run.spent.items()},
        simulated=run.time, wall=clock() - began, ending=str(ending), base_pose=plan.base_pose,
        final_base_pose=_triple(reached) if plan.moves_base else None,
        notes=tuple(_notes(plan, config, run.config)),
    )  # fmt: skip
    drive = following.drive
    length = float(np.hypot(*np.diff(drive[:, :2], axis=0).T).sum())
    seconds = run.spent[Stage.DRIVE] * run.step
    visit = Visit(plan.base_pose, _triple(drive[-1]), length, seconds, "", way=length)
    return RunRecord(
        scene=plan.scene, robot=robot.name, task=plan.task, visits=(visit,), execution=execution,
        exact=True,
    )  # fmt: skip


def _counts(hit: Collision, config: ExecutionConfig) -> bool:
    """Return whether a contact is one that the plan must not have."""
    return not is_of_one_object(hit) and (hit.force > config.touch_force or hit.depth > MAX_DEPTH)


def _notes(plan: PlacementPlan, asked: ExecutionConfig, used: ExecutionConfig) -> list[str]:
    motion, notes = plan.motion, []
    assert motion is not None
    if asked.hold != used.hold:
        notes.append(f"the fingers of {plan.robot_name} do not close; a weld replaces the grasp")
    if motion.times is None or motion.approach_times is None:
        notes.append("the plan has no times for all its states; slow ones are used")
    if plan.base_path is None:
        notes.append("the plan has no base path; the run begins at the base pose")
    if motion.home is None:
        notes.append("the plan has no path home")
    return notes


def _drive_path(plan: PlacementPlan) -> Float[np.ndarray, "k 3"]:
    """Return the base path, without jumps of a turn up to the base pose."""
    there = np.array(plan.base_pose, float)[None]
    if plan.base_path is None or not len(plan.base_path):
        return there
    way = plan.base_path.copy()
    way[:, 2] = np.unwrap(way[:, 2])
    way[:, 2] += there[0, 2] + float(wrap_angle(way[-1, 2] - there[0, 2])) - way[-1, 2]
    return way


def _between(
    rows: Float[np.ndarray, "m n"], times: Float[np.ndarray, " m"], t: float
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Return the state at a time, and its speed; it rests at the ends."""
    k = int(np.clip(np.searchsorted(times, t, side="right") - 1, 0, max(len(rows) - 2, 0)))
    if len(rows) < 2 or t >= times[-1] or times[k + 1] <= times[k]:
        last = len(rows) - 1 if t >= times[-1] else k
        return rows[last], np.zeros(rows.shape[1])
    length = times[k + 1] - times[k]
    share = (t - times[k]) / length
    return rows[k] + share * (rows[k + 1] - rows[k]), (rows[k + 1] - rows[k]) / length


def _triple(values: Float[np.ndarray, "3"]) -> tuple[float, float, float]:
    x, y, yaw = values.tolist()
    return x, y, yaw
