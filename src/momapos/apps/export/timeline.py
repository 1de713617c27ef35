"""Motion over time and in phases, from a plan or from the record of a run in physics."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation

from momapos.core import InputError, write_atomic
from momapos.core.geometry import invert, pose_planar, pose_wxyz
from momapos.model import DEFAULT, SpeedConfig, limited_base_path, time_motion, time_path
from momapos.model.records import Motion, PlacementPlan, Task, Verb
from momapos.model.robots import Robot, opened_as
from momapos.model.scene import Scene
from momapos.simulation import DRIVE, RunMotion, RunRecord

if TYPE_CHECKING:
    from collections.abc import Sequence

    from jaxtyping import Bool, Float, Int


GRIPPER_TIME = 1.0
"""Time for a gripper to close or open [s]."""
STEP = 0.02
"""Time between samples [s]."""
_MIN_MOTION = 1e-9
"""A joint or a base that moves less stands still [rad] or [m]."""


class PhaseKind(StrEnum):
    """Kind of a phase; the values are written to files."""

    DRIVE = "drive"
    ARM = "arm"
    DRIVE_AND_ARM = "drive_and_arm"
    CLOSE = "close_gripper"
    OPEN = "open_gripper"


@dataclass(frozen=True, eq=False)
class Phase:
    """A section of a plan that begins and ends at rest."""

    kind: PhaseKind
    times: Float[np.ndarray, " t"]
    """Time since the beginning of the phase [s]."""
    base: Float[np.ndarray, "t 3"]
    """x [m], y [m], yaw [rad] of the base on the floor."""
    positions: Float[np.ndarray, "t n"]
    """Positions of the plan's joints [rad] or [m]."""
    velocities: Float[np.ndarray, "t n"]
    object_q: Float[np.ndarray, " t"]
    """Value of the object's joint [rad] or [m]; zeros if the task has none."""
    latch_q: Float[np.ndarray, " t"]
    """Value of the object's latch [rad] or [m]; zeros if none is turned."""
    base_path: Float[np.ndarray, "k 3"] | None = None
    """The path of the base, of a phase in which the base moves alone."""


def phases_of(
    plan: PlacementPlan, robot: Robot, speeds: SpeedConfig = DEFAULT, *, step: float = STEP
) -> tuple[Phase, ...]:
    """Return the phases of a solved plan, in order.

    A hand that is not fully open in the plan is opened to that width first. The base drives along
    its path with the arm at home. Then the arm moves, and rests while the gripper closes or opens.
    If the base moves in the manipulation, phases in which arm and base move are on one clock, and
    phases in which the base moves alone, between two grasps, are drives.

    Args:
        plan: A solved plan.
        robot: Robot of the plan, with its speed limits.
        speeds: Speed limits of the arm.
        step: Time between samples [s].

    Raises:
        InputError: The plan is not solved, or no trajectory keeps the limits.
    """
    if plan.motion is None or plan.base_pose is None:
        raise InputError(f"the plan is {plan.status!r}: it has no motion to export")
    motion, base, verb = plan.motion, np.array(plan.base_pose), plan.task.verb
    robot, speeds = opened_as(robot, plan.robot_rest), speeds.for_task(plan.task)
    q, now = _first(motion), _Now.of(motion)
    phases: list[Phase] = []
    if robot.fully_open is not None and verb != "place":
        begin = base if plan.base_path is None else plan.base_path[0]
        phases.append(_gripper(PhaseKind.OPEN, begin, q, now))
    if plan.base_path is not None:
        phases.append(_drive(plan.base_path, q, now, robot, step))
    if verb == "place":
        phases.append(_gripper(PhaseKind.CLOSE, base, q, now))
    for part in _parts(verb, motion):
        if isinstance(part, PhaseKind):
            phases.append(_gripper(part, base, q, now))
        else:
            phases.append(_section(part, verb, base, robot, speeds, step))
            last = phases[-1]
            base = last.base[-1]
            q, now = last.positions[-1], _Now(float(last.object_q[-1]), float(last.latch_q[-1]))
    if motion.home is not None:
        section = now.rests(np.concatenate([motion.q[-1:], motion.home]))
        # What was picked up is in the hand, as before something is placed.
        carried: Verb = "place" if verb == "pick" else "open"
        phases.append(_section(section, carried, base, robot, speeds, step))
    return tuple(phases)


def _first(motion: Motion) -> Float[np.ndarray, " n"]:
    return motion.approach[0] if len(motion.approach) else motion.q[0]


@dataclass(frozen=True)
class _Now:
    """Values of the object's joint and of its latch [rad] or [m]."""

    object_q: float
    latch_q: float

    @classmethod
    def of(cls, motion: Motion) -> _Now:
        """Return the values at the start of a motion."""
        return cls(float(motion.object_q[0]), float(_latch_q(motion)[0]))

    def rests(self, q: Float[np.ndarray, "m n"]) -> _Section:
        """Return a section in which only the arm moves."""
        return _Section(q, np.full(len(q), self.object_q), np.full(len(q), self.latch_q), None)


def _latch_q(motion: Motion) -> Float[np.ndarray, " m"]:
    return np.zeros(len(motion.q)) if motion.latch_q is None else motion.latch_q


@dataclass(frozen=True, eq=False)
class _Section:
    """States of the arm between two actions of the gripper."""

    q: Float[np.ndarray, "m n"]
    object_q: Float[np.ndarray, " m"]
    latch_q: Float[np.ndarray, " m"]
    Ts_world_tool: Float[np.ndarray, "m 4 4"] | None
    """None before the grasp and after the release, where the tool's speed is limited only if it
    carries an object."""
    base: Float[np.ndarray, "m 3"] | None = None
    """Poses of a base that moves; None if it stands still."""

    @property
    def base_moves(self) -> bool:
        return self.base is not None and bool(np.ptp(self.base, axis=0).max() > _MIN_MOTION)

    def cut(self) -> list[_Section]:
        """Cut a section of the free hand where the base starts or stops to move."""
        if self.base is None or len(self.q) < 2:
            return [self]
        moves = np.abs(np.diff(self.base, axis=0)).max(1) > _MIN_MOTION
        ends = [0, *(np.flatnonzero(moves[1:] != moves[:-1]) + 1).tolist(), len(self.q) - 1]
        return [self._part(slice(first, last + 1)) for first, last in pairwise(ends)]

    def _part(self, states: slice) -> _Section:
        Ts = None if self.Ts_world_tool is None else self.Ts_world_tool[states]
        base = None if self.base is None else self.base[states]
        return _Section(self.q[states], self.object_q[states], self.latch_q[states], Ts, base)


def _parts(verb: str, motion: Motion) -> list[_Section | PhaseKind]:
    """Cut the motion of the arm where the gripper closes or opens."""
    parts: list[_Section | PhaseKind] = []
    if len(motion.approach):
        parts.append(_Now.of(motion).rests(motion.approach))
    last = len(motion.q) - 1
    if verb == "pick":
        return [*parts, PhaseKind.CLOSE, _between(motion, 0, last)]
    if verb == "place":
        return [*parts, PhaseKind.OPEN, _between(motion, 0, last)]
    at = 0
    for hold in motion.grasps:
        parts += _between(motion, at, hold.first).cut() if hold.first > at else []
        parts += [PhaseKind.CLOSE, _between(motion, hold.first, hold.last), PhaseKind.OPEN]
        at = hold.last
    return [*parts, *_between(motion, at, last).cut()] if at < last else parts


def _between(motion: Motion, first: int, last: int) -> _Section:
    part = slice(first, last + 1)
    return _Section(
        motion.q[part], motion.object_q[part], _latch_q(motion)[part], motion.Ts_world_tool[part],
        None if motion.base is None else motion.base[part],
    )  # fmt: skip


def _drive(
    path: Float[np.ndarray, "k 3"], q: Float[np.ndarray, " n"], now: _Now, robot: Robot, step: float
) -> Phase:
    """Time the drive. Limits of speed and acceleration hold for the norm of x and y."""
    turned = path.copy()
    turned[:, 2] = np.unwrap(path[:, 2])
    turned[:, 2] += (
        path[-1, 2] - turned[-1, 2]
    )  # by whole turns, to end at the yaw of the arm phases
    place, base = np.pad(path[:, :2], ((0, 0), (0, 1))), limited_base_path(robot, turned, 1.0)
    timed = time_path(
        turned, base.speed, base.acceleration, step, tool=place, tool_speed=robot.max_speed
    )
    rest = np.tile(q, (len(timed), 1))
    return Phase(
        PhaseKind.DRIVE, _times(len(timed), step), timed.q, rest, np.zeros_like(rest),
        np.full(len(timed), now.object_q), np.full(len(timed), now.latch_q), path,
    )  # fmt: skip


def _section(
    part: _Section,
    verb: Verb,
    base: Float[np.ndarray, "3"],
    robot: Robot,
    speeds: SpeedConfig,
    step: float,
) -> Phase:
    if part.base is not None and part.base_moves and np.ptp(part.q, axis=0).max() < _MIN_MOTION:
        now = _Now(float(part.object_q[0]), float(part.latch_q[0]))
        return _drive(part.base, part.q[0], now, robot, step)
    if part.Ts_world_tool is None:
        motion = Motion(part.q, part.q[-1:], part.object_q[-1:], np.eye(4)[None])
        timed = time_motion(robot, motion, speeds, step, verb=verb)[0]
    else:
        motion = Motion(part.q[:0], part.q, part.object_q, part.Ts_world_tool, base=part.base)
        timed = time_motion(robot, motion, speeds, step, verb=verb)[1]
    times = _times(len(timed), step)
    values, latch = (np.interp(times, timed.state_times, v) for v in (part.object_q, part.latch_q))
    bases = np.tile(base, (len(timed), 1)) if timed.base is None else timed.base
    kind = PhaseKind.DRIVE_AND_ARM if part.base_moves else PhaseKind.ARM
    return Phase(kind, times, bases, timed.q, timed.v, values, latch)


def _gripper(
    kind: PhaseKind, base: Float[np.ndarray, "3"], q: Float[np.ndarray, " n"], now: _Now
) -> Phase:
    rest = np.tile(q, (2, 1))
    return Phase(
        kind, np.array([0.0, GRIPPER_TIME]), np.tile(base, (2, 1)), rest, np.zeros_like(rest),
        np.full(2, now.object_q), np.full(2, now.latch_q),
    )  # fmt: skip


def _times(count: int, step: float) -> Float[np.ndarray, " t"]:
    return np.arange(count) * step


@dataclass(frozen=True, eq=False)
class Samples:
    """Samples of all phases in order."""

    times: Float[np.ndarray, " t"]
    base: Float[np.ndarray, "t 3"]
    positions: Float[np.ndarray, "t n"]
    velocities: Float[np.ndarray, "t n"]
    object_q: Float[np.ndarray, " t"]
    phase: Int[np.ndarray, " t"]
    """Index of the phase of each sample."""
    latch_q: Float[np.ndarray, " t"]


def samples_of(phases: tuple[Phase, ...]) -> Samples:
    """Join phases; each begins when the one before it ends."""
    begin = np.cumsum([0.0, *(phase.times[-1] for phase in phases[:-1])])
    return Samples(
        times=np.concatenate([t + p.times for t, p in zip(begin, phases, strict=True)]),
        base=np.concatenate([phase.base for phase in phases]),
        positions=np.concatenate([phase.positions for phase in phases]),
        velocities=np.concatenate([phase.velocities for phase in phases]),
        object_q=np.concatenate([phase.object_q for phase in phases]),
        phase=np.repeat(np.arange(len(phases)), [len(phase.times) for phase in phases]),
        latch_q=np.concatenate([phase.latch_q for phase in phases]),
    )


@dataclass(frozen=True, eq=False)
class CarriedObject:
    """A movable object that is picked or placed."""

    T_world_rest: Float[np.ndarray, "4 4"]
    """Pose of its root link before it is picked, or after it is placed."""
    T_tool_object: Float[np.ndarray, "4 4"]
    """Pose of its root link in the hand."""

    @classmethod
    def of(cls, scene: Scene, task: Task, motion: Motion) -> CarriedObject | None:
        """Return the object that a motion carries; None if the motion moves a joint."""
        if task.joint is not None:
            return None
        item = scene.object(task.object)
        T_world_rest = item.link_poses()[item.model.urdf.root]
        return cls(T_world_rest, invert(motion.Ts_world_tool[0]) @ T_world_rest)

    def at_end(self, task: Task, motion: Motion) -> Float[np.ndarray, "4 4"]:
        """Return the final pose of its root link."""
        if task.verb == "place":
            return self.T_world_rest
        return motion.Ts_world_tool[-1] @ self.T_tool_object

    def poses(
        self,
        task: Task,
        kinds: Sequence[PhaseKind],
        phase: Int[np.ndarray, " t"],
        Ts_world_tool: Float[np.ndarray, "t 4 4"],
    ) -> Float[np.ndarray, "t 4 4"]:
        """Return the poses of its root link over time.

        A picked object is carried after the gripper closes, a placed one until the gripper opens.

        Args:
            task: Pick or place.
            kinds: Kinds of all phases, in order.
            phase: Index of the phase of each sample.
            Ts_world_tool: Pose of the tool at each sample.
        """
        if task.verb == "pick":
            held = phase >= list(kinds).index(PhaseKind.CLOSE)
        else:
            held = phase < list(kinds).index(PhaseKind.OPEN)
        carried = Ts_world_tool @ self.T_tool_object
        return np.where(held[:, None, None], carried, self.T_world_rest)


LIMIT_SLACK = 0.2
"""Distance beyond a joint limit that the soft limits of the physics engine may give way to a load
[rad] or [m]."""


@dataclass(frozen=True, eq=False)
class Timeline:
    """Motion of robot and object over time; sample times never decrease."""

    task: Task
    joints: tuple[str, ...]
    """Joints of the robot, one per column of the positions."""
    samples: Samples
    stages: tuple[str, ...]
    """Name of each phase, in order."""
    arm: tuple[bool, ...]
    """Whether the arm moves in each phase."""
    base_path: Float[np.ndarray, "k 3"] | None
    """Path of the base: x [m], y [m], yaw [rad]; None without a drive."""
    Ts_world_object: Float[np.ndarray, "t 4 4"] | None
    """Pose of a movable object's root link; None if the task moves a joint."""
    latch: str = ""
    """Joint of the object's latch that is turned; "" if none is."""

    def object_values(self, sample: int) -> dict[str, float]:
        """Return the values of the object's joints that move, at a sample [rad] or [m]."""
        if self.task.joint is None:
            return {}
        samples = self.samples
        turned = {self.latch: float(samples.latch_q[sample])} if self.latch else {}
        return {self.task.joint: float(samples.object_q[sample]), **turned}

    def phases(self) -> Iterator[tuple[int, slice]]:
        """Yield the index and the samples of each phase."""
        phase = self.samples.phase
        cuts = np.flatnonzero(np.diff(phase)) + 1
        for first, end in pairwise([0, *cuts.tolist(), len(phase)]):
            yield int(phase[first]), slice(first, end)


def plan_timeline(
    plan: PlacementPlan, phases: tuple[Phase, ...], scene: Scene, robot: Robot
) -> Timeline:
    """Return the timeline of a solved plan with its phases, see `phases_of`."""
    assert plan.motion is not None
    samples, kinds = samples_of(phases), tuple(phase.kind for phase in phases)
    carried, poses = CarriedObject.of(scene, plan.task, plan.motion), None
    latch = scene.object(plan.task.object).latch
    if carried is not None:
        tools = robot.chain.tool_poses(robot.chain.freedom_values(samples.positions))
        tools = pose_planar(samples.base) @ tools
        poses = carried.poses(plan.task, kinds, samples.phase, tools)
    return Timeline(
        plan.task, plan.joints, samples, tuple(map(str, kinds)),
        tuple(kind in (PhaseKind.ARM, PhaseKind.DRIVE_AND_ARM) for kind in kinds),
        _base_path(plan), poses,
        "" if latch is None or plan.motion.latch_q is None else latch.joint,
    )  # fmt: skip


def _base_path(plan: PlacementPlan) -> Float[np.ndarray, "k 3"] | None:
    """Return the path of the base from the start to its last pose; None without a drive."""
    moved = None if plan.motion is None else plan.motion.base
    parts = [part for part in (plan.base_path, moved) if part is not None]
    return np.concatenate(parts) if parts else None


def run_timeline(record: RunRecord, robot: Robot) -> Timeline:
    """Return the timeline of a run; velocities are differences of the recorded positions.

    Args:
        record: The record, with its motion.
        robot: The robot of the plan.

    Raises:
        InputError: The record has no motion, or belongs to another robot.
    """
    motion, task = recorded_motion(record, robot), record.true_task or record.task
    later = np.append(np.diff(motion.times) > 0, True)  # of samples at one time, the last
    times = np.array(motion.times)[later]
    base = np.array(motion.bases)[later]
    positions = np.zeros((len(times), len(motion.joints)))
    for column, values in enumerate(motion.joints.values()):
        positions[:, column] = np.array(values)[later]
    velocities = np.asarray(np.gradient(positions, times, axis=0))
    words = np.array(motion.stages)[later]
    phase = np.cumsum(np.append(False, words[1:] != words[:-1]))
    stages = tuple(words[np.searchsorted(phase, np.arange(phase[-1] + 1))].tolist())
    part = np.array(motion.part)[later] if motion.part else np.zeros(len(times))
    latch, turned = next(iter(motion.latch.items()), ("", motion.times))
    poses = None
    if motion.poses:
        rows = [pose_wxyz(tuple(row[:3]), tuple(row[3:])) for row in motion.poses]
        poses = np.stack(rows)[later]
    drives: Bool[np.ndarray, " t"] = words == DRIVE
    return Timeline(
        task, tuple(motion.joints),
        Samples(times, base, positions, velocities, part, phase, np.array(turned)[later]),
        stages, tuple(stage != DRIVE for stage in stages), base[drives] if drives.any() else None,
        poses, latch,
    )  # fmt: skip


def recorded_motion(record: RunRecord, robot: Robot) -> RunMotion:
    """Return the motion of a run.

    Raises:
        InputError: The record has no motion, belongs to another robot, or leaves its limits.
    """
    motion = record.motion
    if motion is None or len(motion.times) < 2:
        raise InputError(
            "the run record contains no motion; 'momapos run ... --out FILE' writes one with motion"
        )
    unknown = next((name for name in motion.joints if name not in robot.model.joints), None)
    if unknown is not None:
        raise InputError(f"the run record moves {unknown!r:.60}, which is no joint of {robot.name}")
    for name, values in motion.joints.items():
        joint = robot.model.joint(name)
        low, high = joint.lower - LIMIT_SLACK, joint.upper + LIMIT_SLACK
        beyond = next((value for value in values if not low <= value <= high), None)
        if beyond is not None:
            raise InputError(
                f"the run record moves {name!r:.60} to {beyond:g}; its limits are {joint.lower:g} "
                f"to {joint.upper:g}"
            )
    return motion


BASE = ("base_x", "base_y", "base_yaw")
OBJECT = tuple(f"object_{name}" for name in ("x", "y", "z", "qw", "qx", "qy", "qz"))


def write_csv(timeline: Timeline, path: Path) -> None:
    """Write one line per sample: time, phase, base pose, joint positions and velocities, object_q.

    If a latch is turned, its value follows as latch_q; for a movable object, its pose: position and
    quaternion. Units are s, m and rad.
    """
    samples, names = timeline.samples, timeline.joints
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    velocities = [f"{name}_velocity" for name in names]
    columns = [samples.base, samples.positions, samples.velocities, samples.object_q]
    header = ["time", "phase", *BASE, *names, *velocities, "object_q"]
    if timeline.latch:
        header.append("latch_q")
        columns.append(samples.latch_q)
    if timeline.Ts_world_object is not None:
        header += OBJECT
        columns.append(_poses(timeline.Ts_world_object))
    rows.writerow(header)
    numbers = np.column_stack(columns)
    for time, index, row in zip(samples.times, samples.phase, numbers, strict=True):
        values = [f"{value:.9g}" for value in row.tolist()]
        rows.writerow([f"{time:.9g}", f"{index}_{timeline.stages[index]}", *values])
    write_atomic(path, text.getvalue().encode())


def write_npz(timeline: Timeline, path: Path) -> None:
    """Write the samples as arrays: times, base, positions, velocities, object_q, phase, names.

    If a latch is turned, `latch_q` contains its values. For a movable object, `object_poses`
    contains x, y, z and the quaternion wxyz.
    """
    samples, content = timeline.samples, io.BytesIO()
    extra: dict[str, Any] = {"latch_q": samples.latch_q} if timeline.latch else {}
    if timeline.Ts_world_object is not None:
        extra["object_poses"] = _poses(timeline.Ts_world_object)
    np.savez_compressed(
        content, times=samples.times, base=samples.base, positions=samples.positions,
        velocities=samples.velocities, object_q=samples.object_q, phase=samples.phase,
        phases=np.array(timeline.stages), joints=np.array(timeline.joints), **extra,
    )  # fmt: skip
    write_atomic(path, content.getvalue())


def _poses(Ts: Float[np.ndarray, "t 4 4"]) -> Float[np.ndarray, "t 7"]:
    """Return x, y, z [m] and the quaternion wxyz."""
    quaternions = Rotation.from_matrix(Ts[:, :3, :3]).as_quat()[:, [3, 0, 1, 2]]
    return np.concatenate([Ts[:, :3, 3], quaternions], axis=1)
