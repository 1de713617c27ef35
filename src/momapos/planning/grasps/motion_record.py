"""The motion of a task: tool poses of every grasp at every step, and turns between grasps.

Grasps that differ only by a turn about the axis of a bar or a knob form a group. The hand may
change between them during the motion: its angle about the bar is an additional joint of the path
over the waypoints.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import GRAVITY
from momapos.core.geometry import rotation_about
from momapos.model.records import FAMILIES, Hold, JointResistance, Task
from momapos.model.robots import Robot
from momapos.model.urdf import Boxes, MovingBoxes

from .grasp_families import Grasps, GraspSelection
from .handles import Handle, HandleKind
from .retreats import Retreat

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int


MAX_AXIS_OFFSET = 0.004
"""Maximum distance of the tool's origin from the axis [m]."""
ROUND_TOLERANCE = 1e-3
"""Maximum difference in thickness of a round knob over all grasps of a group [m]."""
MAX_KNOB_STEP = np.radians(46.0)
"""Maximum angle between neighboring grasps of a knob; beyond, something may be between [rad]."""
FULL_DOF = 6
"""Degrees of freedom with which an arm can take any tool pose within reach [-]."""
MIN_GROUP = 3
"""Minimum number of grasps in a group [-]."""
_DIGITS = 4
_BARS = (HandleKind.BAR, HandleKind.LEVER)
_TURN = [FAMILIES.index(family) for family in FAMILIES if family.turns]


@dataclass(frozen=True, eq=False)
class Turning:
    """Groups of grasps that differ by a turn about one axis, which is fixed in the part."""

    angles: Float[np.ndarray, " g"]
    """Turn of each grasp [rad]; 0 for grasps in no group."""
    groups: Int[np.ndarray, "t k"]
    """Grasps of each group, padded with -1."""
    axis: Float[np.ndarray, "3"]
    """Unit axis of the turn, in the frame of the moved link."""
    R_part_tool: Float[np.ndarray, "g 3 3"]
    """Rotation of the tool in that frame, for each grasp."""

    @property
    def modes(self) -> int:
        """Number of grasp modes: the single grasps, then the groups."""
        return len(self.angles) + len(self.groups)

    def members(self, modes: Int[np.ndarray, " j"]) -> Int[np.ndarray, "j k"]:
        """Return the grasps of each grasp mode, padded with -1."""
        grasps = len(self.angles)
        if (modes < grasps).all():
            return modes[:, None]
        alone = np.full((grasps, self.groups.shape[1]), -1)
        alone[:, 0] = np.arange(grasps)
        return np.concatenate([alone, self.groups])[modes]

    def only(self, grasps: Bool[np.ndarray, " g"]) -> Turning:
        """Return the groups within a subset of the grasps, renumbered."""
        number = np.append(np.where(grasps, np.cumsum(grasps) - 1, -1), -1)
        groups = -np.sort(-number[self.groups], axis=1)
        enough = (groups >= 0).sum(1) >= MIN_GROUP
        return Turning(self.angles[grasps], groups[enough], self.axis, self.R_part_tool[grasps])

    def axis_of(self, mode: int) -> tuple[float, float, float] | None:
        """Return the axis about which the hand turns in a grasp mode; None if it does not."""
        if mode < len(self.angles):
            return None
        x, y, z = self.axis.tolist()
        return x, y, z


def no_turning(grasps: int) -> Turning:
    """Return no groups, for rigid grasps."""
    none, up = np.zeros((0, 1), np.int64), np.array([0.0, 0.0, 1.0])
    return Turning(np.zeros(grasps), none, up, np.tile(np.eye(3), (grasps, 1, 1)))


def turning_about(robot: Robot, chosen: GraspSelection) -> Turning:
    """Group the grasps of a bar, or of a round knob, that differ only by a turn about it.

    Only arms with fewer than `FULL_DOF` degrees of freedom turn about a knob.

    Args:
        robot: The robot.
        chosen: The grasps; only pinches and hooks turn.
    """
    handle, Ts = chosen.grasps.handles[0], chosen.Ts_part_tool
    turns = handle.kind in _BARS or (handle.knob and robot.chain.size < FULL_DOF)
    if not turns:
        return no_turning(len(Ts))
    axis, angles = _turns(robot, handle, Ts)
    away = Ts[:, :3, 3] - handle.grip
    along = away @ axis
    offset = np.linalg.norm(away - along[:, None] * axis, axis=1)
    held = (chosen.grasps.handle == 0) & np.isin(chosen.grasps.code, _TURN)
    on_axis = np.flatnonzero(held & (offset < MAX_AXIS_OFFSET))
    unturned = rotation_about(axis, -angles[on_axis]) @ Ts[on_axis, :3, :3]
    keys = np.round(np.column_stack([unturned.reshape(-1, 9), along[on_axis]]), _DIGITS) + 0.0
    _, group, counts = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
    group = group.ravel()
    groups = np.full((len(counts), int(counts.max(initial=1))), -1)
    order = np.lexsort((angles[on_axis], group))
    place = np.arange(len(order)) - np.repeat(np.cumsum(counts) - counts, counts)
    groups[group[order], place] = on_axis[order]
    kept = counts >= MIN_GROUP
    if handle.knob:
        kept &= _round(groups, angles, chosen.grasps.width)
    return Turning(angles, groups[kept], axis, Ts[:, :3, :3])


def _turns(
    robot: Robot, handle: Handle, Ts: Float[np.ndarray, "g 4 4"]
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, " g"]]:
    """Return the axis of the turn, and the angle of each grasp about it [rad]."""
    if handle.knob:
        across = Ts[:, :3, :3] @ robot.closing_axis
        axis, zero = handle.out, handle.long
    else:
        across = Ts[:, :3, :3] @ robot.approach_axis
        axis, zero = handle.long, -handle.out
    return axis, np.arctan2(np.cross(zero, across) @ axis, across @ zero)


def _round(
    groups: Int[np.ndarray, "t k"], angles: Float[np.ndarray, " g"], width: Float[np.ndarray, " g"]
) -> Bool[np.ndarray, " t"]:
    """Find the groups whose finger width is the same at every angle, without gaps in the angles."""
    used = groups >= 0
    steps = np.diff(angles[groups], axis=1)
    dense = np.where(used[:, 1:], steps, 0.0).max(1, initial=0.0) < MAX_KNOB_STEP
    widths = np.where(used, width[groups], np.nan)
    return dense & (np.nanmax(widths, axis=1) - np.nanmin(widths, axis=1) < ROUND_TOLERANCE)


MIN_CHANGE = 1e-9
"""Change of a joint's value between steps below which it rests [rad] or [m]."""
MIN_TRAVEL = 0.02
"""Travel of the hand per unit of the joint below which the pull is not larger [m/rad]."""


@dataclass(frozen=True, eq=False)
class Weight:
    """The mass of a rigid object, and its center in the world at each value."""

    mass: float
    """[kg]"""
    center: Float[np.ndarray, "v 3"]
    """[m]"""


@dataclass(frozen=True, eq=False)
class TaskMotion:
    """Tool poses of every grasp along the motion, and the boxes that move with it."""

    task: Task
    Ts_world_tool: Float[np.ndarray, "g d 4 4"]
    """Straight approach, then the motion."""
    object_q: Float[np.ndarray, " d"]
    """Value of the object's joint at each step [rad] or [m]; zeros for rigid objects."""
    waypoint_steps: Int[np.ndarray, " w"]
    """Steps that are waypoints; the first is the pre-grasp."""
    grasp_step: int
    """Step at which the hand grasps the object."""
    holding: Bool[np.ndarray, " d"]
    """Whether the gripper may touch the grasped part, at each step."""
    static: Boxes
    """Static boxes in the world."""
    moving: MovingBoxes
    """Moving boxes in the world, at each value."""
    value: Int[np.ndarray, " d"]
    """Index into `moving` at each step."""
    grasped: Bool[np.ndarray, " m"]
    """Moving boxes that the gripper may touch."""
    labels: tuple[str, ...]
    """Names of the static boxes, then of the moving ones."""
    grasps: Grasps
    refusal: str
    """Why no grasp holds, for any base pose; "" if some do."""
    turning: Turning
    """Grasps between which the hand may turn."""
    release_step: int | None = None
    """Step after which the hand releases the part of a joint; None if it never does."""
    better_handle_reason: str = ""
    """Why a better handle is not used; "" if there is none."""
    resistance: JointResistance | None = None
    """Resistance of the part, which the grasps transmit; None for rigid objects."""
    latch_q: Float[np.ndarray, " d"] | None = None
    """Value of the object's latch at each step [rad] or [m]; None if no latch is turned."""
    effort: Float[np.ndarray, " v"] | None = None
    """What resists the motion at each value, along it [Nm] or [N]; None for rigid objects."""
    more_pull: float = 0.0
    """What the part pulls beyond its resistance, against the hand's motion [N]."""
    weight: Weight | None = None
    """Weight of a rigid object; None for the part of a joint."""
    retreat: Retreat | None = None
    """How a rigid object leaves where it stands; None for the part of a joint."""
    pose_steps: Int[np.ndarray, " p"] | None = None
    """The step at each pose of a path to follow; None for other tasks."""

    def __repr__(self) -> str:
        grasps, steps = self.Ts_world_tool.shape[:2]
        what = f"{self.task.verb} {self.task.object}"
        return f"<TaskMotion of {what}: {grasps} grasps, {steps} steps>"

    @property
    def waypoints(self) -> Float[np.ndarray, "w 3"]:
        """Tool positions of the first grasp at the waypoints, without the pre-grasp [m]."""
        return self.Ts_world_tool[0, self.waypoint_steps[1:], :3, 3]

    def only(self, rows: Bool[np.ndarray, " g"]) -> TaskMotion:
        """Return the motion with a subset of its grasps."""
        return replace(
            self,
            Ts_world_tool=self.Ts_world_tool[rows],
            grasps=self.grasps.take(rows),
            turning=self.turning.only(rows),
        )

    @property
    def lift(self) -> float:
        """Return by how much a rigid object is lifted or let down [m]; 0 for a part."""
        return 0.0 if self.retreat is None else self.retreat.lift

    @property
    def closed(self) -> Bool[np.ndarray, " d"]:
        """Whether the fingers are closed at each step, if they close at all."""
        steps = np.arange(len(self.object_q))
        if self.task.verb == "place":
            return steps <= self.grasp_step
        last = steps[-1] if self.release_step is None else self.release_step
        return (self.grasp_step <= steps) & (steps <= last)

    @property
    def closes(self) -> Bool[np.ndarray, " d"]:
        """Whether the fingers close or open at each step."""
        steps = [s for s in (self.grasp_step, self.release_step) if s is not None]
        return np.isin(np.arange(len(self.object_q)), steps)

    @cached_property
    def hand_loads(self) -> tuple[Float[np.ndarray, "g d 3"], Float[np.ndarray, "g d 3"]]:
        """Force on the hand of each grasp at each step [N], and where it acts, in the world [m].

        A part pushes back along the path of the hand, with what resists its motion over the
        hand's travel per unit of the joint.
        """
        point = self.Ts_world_tool[:, :, :3, 3]
        force = np.zeros_like(point)
        held = np.flatnonzero(self.closed)
        if self.weight is not None:
            force[:, held, 2] = -GRAVITY * self.weight.mass
            # A copy: kernels are compiled for arrays that can be written to.
            return force, np.broadcast_to(self.weight.center[self.value], point.shape).copy()
        if self.effort is None or len(held) < 2:
            return force, point
        q = self.object_q[held]
        change = np.gradient(q)[:, None]
        # While a latch is turned, the part rests.
        change = np.where(np.abs(change) > MIN_CHANGE, change, np.inf)
        travel = np.gradient(point[:, held], axis=1) / change
        square = np.maximum((travel**2).sum(-1, keepdims=True), MIN_TRAVEL**2)
        effort = self.effort[self.value[held], None]
        along = effort / square + self.more_pull / np.sqrt(square)
        force[:, held] = -np.sign(q[-1] - q[0]) * along * travel
        return force, point

    @property
    def free_ends(self) -> tuple[int, ...]:
        """Steps at which a free arm motion ends or begins."""
        return (0,) if self.release_step is None else (0, len(self.object_q) - 1)

    @property
    def progress(self) -> Float[np.ndarray, " d"]:
        """Return how far the manipulation has come at each step, from 0 to 1.

        This is the share of a joint's motion, or of the steps along a path.
        """
        way = self.object_q
        if self.pose_steps is not None:
            way = np.arange(len(way)).clip(self.grasp_step, self.release_step).astype(float)
        way = way - way[self.grasp_step]
        return np.asarray(np.clip(way / way[-1], 0.0, 1.0))

    @property
    def lanes(self) -> tuple[Int[np.ndarray, "k g"], Int[np.ndarray, " w"]]:
        """Rows of grasp numbers, and the row of each waypoint.

        On its path to a waypoint, the hand may change between grasps with the same number in the
        waypoint's row. It keeps its grasp during the approach.
        """
        grasps = np.arange(len(self.Ts_world_tool))
        return np.stack([0 * grasps, grasps]), (self.layer_of == 1).astype(np.int64)

    @property
    def layer_of(self) -> Int[np.ndarray, " w"]:
        """Layer of each waypoint; waypoints of one layer share their arm states."""
        return np.arange(len(self.waypoint_steps))

    @property
    def handle(self) -> Handle | None:
        """Handle of the first grasp; None for rigid objects."""
        handles = self.grasps.handles
        return handles[int(self.grasps.handle[0])] if handles else None

    def tool_poses(self, grasps: Int[np.ndarray, " w"]) -> Float[np.ndarray, "d 4 4"]:
        """Return the tool pose at every step, given the grasp at each waypoint.

        Between waypoints with different grasps the hand turns about the axis of `turning`.
        """
        first = grasps[0]
        Ts = self.Ts_world_tool[first]
        if (grasps == first).all():
            return Ts
        steps = np.arange(len(Ts))
        turn = np.interp(steps, self.waypoint_steps, self.turning.angles[grasps])
        axis = self.turning.axis @ self.turning.R_part_tool[first]
        out = Ts.copy()
        out[:, :3, :3] = Ts[:, :3, :3] @ rotation_about(axis, turn - self.turning.angles[first])
        return out

    def holds(self, mode: int) -> tuple[Hold, ...]:
        """Return a plan's record of a grasp mode; empty for rigid objects.

        A path has one for each of its poses.
        """
        if self.pose_steps is not None:
            at = (self.pose_steps - self.grasp_step).tolist()
            names = zip(at, self.task.pose_names, strict=True)
            return tuple(Hold(k, k, words=name) for k, name in names)
        if self.task.joint is None:
            return ()
        grasp = int(self.turning.members(np.array([mode]))[0, 0])
        last = len(self.object_q) - 1 if self.release_step is None else self.release_step
        axis = self.turning.axis_of(mode)
        words = self.grasps.describe(grasp, turns=axis is not None)
        family = str(self.grasps.family[grasp])
        return (
            Hold(self.turned_step - self.grasp_step, last - self.grasp_step, axis, family, words),
        )

    @property
    def turned_step(self) -> int:
        """Step from which on the latch is turned and the part moves; the grasp without a latch."""
        if self.latch_q is None:
            return self.grasp_step
        return int(np.argmax(self.latch_q == self.latch_q[-1]))

    def executed_steps(
        self, mode: int, Ts_world_tool: Float[np.ndarray, "d 4 4"]
    ) -> tuple[Int[np.ndarray, " k"], tuple[Hold, ...]]:
        """Return the steps that are executed in a grasp mode, and the holds.

        Args:
            mode: The grasp mode.
            Ts_world_tool: Tool pose at every step.
        """
        return np.arange(len(Ts_world_tool)), self.holds(mode)

    def sweep(self) -> Boxes:
        """Return the moving boxes at all values as one set."""
        return self.moving.sweep()

    def static_obstacles(self) -> Boxes:
        """Return all boxes as they are before the task, in the order of `labels`."""
        return Boxes.join([self.static, self.moving.at(0)])
