"""Group grasps between which the hand may turn: about the long axis of a bar or the axis of a knob.

Grasps that differ only by such a turn form a group. The hand may change between them during the
motion: its angle about the bar is an additional joint of the path over the waypoints.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import rotation_about
from momapos.model.robots import Robot

from .grasp_families import GraspSelection
from .handle_core import HandleKind
from .handle_records import Handle
from .part_grasps import FAMILIES, Family

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
_CLOSED = [FAMILIES.index(Family.PINCH), FAMILIES.index(Family.HOOK)]


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
    held = (chosen.grasps.handle == 0) & np.isin(chosen.grasps.code, _CLOSED)
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
