"""Trace of a run in progress: its drives and its physics, in order."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import mujoco
import numpy as np

from momapos.core.geometry import invert, local_points, pose_planar, pose_wxyz

from .arm_control import sense_forces
from .base_drive import base_pose_of, initial_base_pose
from .config import Stage
from .geoms import matrix_quat
from .run_record import DIGITS, DRIVE, RunMotion, Triple, rounded
from .simulated_robot import BASE_JOINTS
from .simulated_room import is_part
from .simulation import Simulation

if TYPE_CHECKING:
    from jaxtyping import Float

STATE_INTERVAL = 0.05
"""Minimum time between traced states [s]."""
SAMPLE_INTERVAL = 0.1
"""Time between the samples of a recorded motion [s]."""
GRASP_STAGES = (Stage.GRIP, Stage.MANIPULATE, Stage.DWELL)
"""Stages in which the hand may hold something."""
_STILL = np.zeros(3)


class State(NamedTuple):
    """State of a world."""

    time: float
    """Time since the start of its act [s]."""
    stage: str
    q: np.ndarray
    """Generalized coordinates of the engine."""
    force: np.ndarray
    """Force of the held object on the hand, in the world [N]."""


@dataclass(eq=False)
class Act:
    """A motion in physics, and the drives before it."""

    times: list[Float[np.ndarray, " t"]] = field(default_factory=list)
    """Times of each drive, from its start [s]."""
    poses: list[Float[np.ndarray, "t 3"]] = field(default_factory=list)
    """Poses of the base in each drive: x [m], y [m], yaw [rad]."""
    world: Simulation | None = None
    """None if the arm found no motion after the last drive."""
    carries: bool = False
    """Whether the hand holds an object from the start, and on the drives before."""
    states: list[State] = field(default_factory=list)

    @property
    def drove(self) -> float:
        """Duration of all drives [s]."""
        return sum(float(times[-1]) for times in self.times)

    @property
    def duration(self) -> float:
        """Duration of the act [s]."""
        return self.drove + (self.states[-1].time if self.states else 0.0)

    @property
    def way(self) -> tuple[Float[np.ndarray, " t"], Float[np.ndarray, "t 3"]]:
        """Times [s] and poses of all drives in sequence."""
        ends = np.cumsum([0.0, *(times[-1] for times in self.times)])
        shifted = [t + end for t, end in zip(self.times, ends[:-1], strict=True)]
        return np.concatenate([np.zeros(0), *shifted]), np.concatenate(
            [np.zeros((0, 3)), *self.poses]
        )

    def standing_at(self, pose: Float[np.ndarray, "3"]) -> np.ndarray:
        """Return the coordinates of the first state with the base at another pose.

        What the hand holds then moves with the base.
        """
        assert self.world is not None
        q, stands = self.states[0].q.copy(), initial_base_pose(self.world)
        if self.carries:
            at = slice(self.world.part_q, self.world.part_q + 7)
            x, y, z, *wxyz = q[at].tolist()
            T_base_part = invert(pose_planar(base_pose_of(self.world, q))) @ pose_wxyz(
                (x, y, z), tuple(wxyz)
            )
            T = pose_planar(pose) @ T_base_part
            q[at] = [*T[:3, 3], *matrix_quat(T[:3, :3])]
        q[self.world.base_q] = [*local_points(stands, pose[None, :2])[0], pose[2] - stands[2]]
        return q


@dataclass
class RunTrace:
    """Callback for `run_plan`: pass it as `watch`, and its `drive` as `trace`."""

    acts: list[Act] = field(default_factory=list)

    def __call__(self, world: Simulation, time: float, stage: str) -> None:
        """Store a state, if the last one is old enough."""
        if not self.acts or self.acts[-1].world not in (None, world):
            self.acts.append(Act())
        act = self.acts[-1]
        act.world = world
        if not act.states:
            act.carries = world.welded and _loose(world)
        if not act.states or time - act.states[-1].time >= STATE_INTERVAL - 1e-9:
            force = sense_forces(world).force if stage in GRASP_STAGES else _STILL
            act.states.append(State(time, str(stage), world.data.qpos.copy(), force))

    def drive(self, times: Float[np.ndarray, " t"], poses: Float[np.ndarray, "t 3"]) -> None:
        """Store a drive.

        Args:
            times: Times from the start of the drive [s].
            poses: True poses of the base: x [m], y [m], yaw [rad].
        """
        if not self.acts or self.acts[-1].world is not None:
            self.acts.append(Act())
        self.acts[-1].times.append(times)
        self.acts[-1].poses.append(poses)

    @property
    def played(self) -> list[Act]:
        """The acts in which something was executed."""
        return [act for act in self.acts if act.states]

    def motion(self) -> RunMotion:
        """Return the recorded motion."""
        rows = list(self._rows())
        worlds = [row.world for row in rows if row.world is not None]
        names = joints_of(worlds[0]) if worlds else []
        values = {name: [_joint(row, name) for row in rows] for name in names}
        parts = [_part(row) for row in rows]
        loose = bool(worlds) and _loose(worlds[0])
        return RunMotion(
            times=rounded([row.time for row in rows], 3),
            stages=tuple(row.stage for row in rows),
            bases=tuple(_triple(row.base) for row in rows),
            joints={name: rounded(each) for name, each in values.items()},
            part=() if loose else rounded([p[0] for p in parts]),
            latch=_latch(rows),
            poses=tuple(rounded(p) for p in parts) if loose else (),
            forces=tuple(_triple(row.force, 1) for row in rows),
        )

    def _rows(self) -> Iterator[_Row]:
        """Yield the samples of a record. During a drive the arm is as at the next act's start."""
        began, before = 0.0, _Row(0.0, DRIVE, _STILL, None, np.zeros(0), _STILL)
        for act in self.acts:
            if act.world is not None:
                before = before._replace(world=act.world, q=act.states[0].q)
            times, poses = act.way
            for i in _sampled(times):
                q = before.q if act.world is None else act.standing_at(poses[i])
                yield before._replace(time=began + float(times[i]), base=poses[i], q=q)
            for i in _sampled(np.array([state.time for state in act.states])):
                assert act.world is not None
                time, stage, q, force = act.states[i]
                base = base_pose_of(act.world, q)
                yield _Row(began + act.drove + time, stage, base, act.world, q, force)
            if act.states:
                before = before._replace(q=act.states[-1].q)
            began += act.duration


class _Row(NamedTuple):
    """One sample of a record."""

    time: float
    stage: str
    base: np.ndarray
    world: Simulation | None
    q: np.ndarray
    force: np.ndarray


def joints_of(world: Simulation) -> list[str]:
    """Return the names of the robot's moving joints: arm and fingers."""
    names = [world.model.joint(k).name for k in range(world.model.njnt)]
    return [name for name in names if name not in (*BASE_JOINTS, "") and not is_part(name)]


def _sampled(times: Float[np.ndarray, " t"]) -> Iterator[int]:
    """Yield the indices of the recorded times: one per interval, and the last."""
    if len(times):
        wanted = np.arange(times[0], times[-1], SAMPLE_INTERVAL)
        yield from np.unique([*np.searchsorted(times, wanted), len(times) - 1]).tolist()


def _joint(row: _Row, name: str) -> float:
    return 0.0 if row.world is None else float(row.q[row.world.model.joint(name).qposadr[0]])


def _latch(rows: Sequence[_Row]) -> dict[str, tuple[float, ...]]:
    """Return the values of the latch of the first world that has one; it stays in other worlds."""
    latch = next((row.world.latch for row in rows if row.world and row.world.latch), None)
    if latch is None:
        return {}
    values, last = [], latch.start
    for row in rows:
        if row.world is not None and row.world.latch is not None:
            last = float(row.q[row.world.latch.value_q])
        values.append(last)
    return {latch.joint: rounded(values)}


def _loose(world: Simulation) -> bool:
    joint = world.model.body_jntadr[world.part_body]
    return bool(world.model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE)


def _part(row: _Row) -> list[float]:
    """Return the value of the part's joint; for a movable object its pose x, y, z, wxyz."""
    if row.world is None:
        return [0.0]
    at = row.world.part_q
    values: list[float] = row.q[at : at + (7 if _loose(row.world) else 1)].tolist()
    return values


def _triple(values: np.ndarray, digits: int = DIGITS) -> Triple:
    x, y, z = rounded(values.tolist(), digits)
    return x, y, z
