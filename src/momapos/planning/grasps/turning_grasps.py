"""Grasps that turn: a bar that two fingers hold turns in them about its long axis, a knob about its
own.

Grasps that differ by such a turn alone are one group. On its way the hand may go from one to the
next, so that the tool's angle about the bar is one more joint of the path over the waypoints.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import rotation_about
from momapos.model.robots import Robot

from .grasp_families import Chosen
from .handle_core import HandleKind
from .handles import Handle
from .part_grasps import FAMILIES, Family

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

OFF_AXIS = 0.004
"""The tool's origin is so near to the axis, about which the hand then turns [m]."""
ALIKE = 1e-3
"""What is as thick from all sides up to this is round [m]."""
MOST_STEP = np.radians(46.0)
"""Grasps of a knob that are farther from each other have something between them [rad]."""
FULL = 6
"""Degrees of freedom from which on an arm takes any tool pose within reach [-]."""
LEAST = 3
"""A group has so many grasps at least [-]."""
_DIGITS = 4
_BARS = (HandleKind.BAR, HandleKind.LEVER)
_CLOSED = [FAMILIES.index(Family.PINCH), FAMILIES.index(Family.HOOK)]


@dataclass(frozen=True)
class Turning:
    """Groups of grasps that differ by a turn about one axis, which is fixed in the part."""

    angles: Float[np.ndarray, " g"]
    """Turn of each grasp [rad]; 0 of those in no group."""
    groups: Int[np.ndarray, "t k"]
    """Grasps of each group, -1 where it has fewer."""
    axis: Float[np.ndarray, "3"]
    """Unit axis of the turn, in the frame of the moved link."""
    R_part_tool: Float[np.ndarray, "g 3 3"]
    """Rotation of the tool in that frame, for each grasp."""

    @property
    def ways(self) -> int:
        """Ways of holding: every grasp, then every group."""
        return len(self.angles) + len(self.groups)

    def members(self, ways: Int[np.ndarray, " j"]) -> Int[np.ndarray, "j k"]:
        """Grasps of ways of holding: one of a grasp itself, all of a group."""
        grasps = len(self.angles)
        if (ways < grasps).all():
            return ways[:, None]
        alone = np.full((grasps, self.groups.shape[1]), -1)
        alone[:, 0] = np.arange(grasps)
        return np.concatenate([alone, self.groups])[ways]

    def only(self, grasps: Bool[np.ndarray, " g"]) -> Turning:
        """The groups of some grasps, by their numbers among these."""
        number = np.append(np.where(grasps, np.cumsum(grasps) - 1, -1), -1)
        groups = -np.sort(-number[self.groups], axis=1)
        enough = (groups >= 0).sum(1) >= LEAST
        return Turning(self.angles[grasps], groups[enough], self.axis, self.R_part_tool[grasps])

    def axis_of(self, way: int) -> tuple[float, float, float] | None:
        """The axis about which the hand turns in a way of holding; None where it does not."""
        if way < len(self.angles):
            return None
        x, y, z = self.axis.tolist()
        return x, y, z


def no_turning(grasps: int) -> Turning:
    """Of grasps that are all rigid."""
    none, up = np.zeros((0, 1), np.int64), np.array([0.0, 0.0, 1.0])
    return Turning(np.zeros(grasps), none, up, np.tile(np.eye(3), (grasps, 1, 1)))


def turning_about(robot: Robot, chosen: Chosen) -> Turning:
    """Group the grasps of a bar, or of a round knob, that differ by a turn about it.

    A knob is turned about by short arms alone: others hold it as well at the turn that suits them.

    Args:
        robot: Names the axes of its tool, and how many joints its arm has.
        chosen: The grasps; only those between two pads turn.
    """
    handle, Ts = chosen.grasps.handles[0], chosen.Ts_part_tool
    turns = handle.kind in _BARS or (handle.knob and robot.chain.size < FULL)
    if not turns:
        return no_turning(len(Ts))
    axis, angles = _turns(robot, handle, Ts)
    away = Ts[:, :3, 3] - handle.grip
    along = away @ axis
    beside = np.linalg.norm(away - along[:, None] * axis, axis=1)
    held = (chosen.grasps.handle == 0) & np.isin(chosen.grasps.code, _CLOSED)
    on_axis = np.flatnonzero(held & (beside < OFF_AXIS))
    unturned = rotation_about(axis, -angles[on_axis]) @ Ts[on_axis, :3, :3]
    keys = np.round(np.column_stack([unturned.reshape(-1, 9), along[on_axis]]), _DIGITS) + 0.0
    _, group, counts = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
    group = group.ravel()
    groups = np.full((len(counts), int(counts.max(initial=1))), -1)
    order = np.lexsort((angles[on_axis], group))
    place = np.arange(len(order)) - np.repeat(np.cumsum(counts) - counts, counts)
    groups[group[order], place] = on_axis[order]
    kept = counts >= LEAST
    if handle.knob:
        kept &= _round(groups, angles, chosen.grasps.width)
    return Turning(angles, groups[kept], axis, Ts[:, :3, :3])


def _turns(
    robot: Robot, handle: Handle, Ts: Float[np.ndarray, "g 4 4"]
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, " g"]]:
    """The axis about which a hand turns, and the turn of each grasp about it [rad]."""
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
    """Groups whose fingers are as wide apart from every side, with no side left out between."""
    there = groups >= 0
    apart = np.diff(angles[groups], axis=1)
    steps = np.where(there[:, 1:], apart, 0.0).max(1, initial=0.0) < MOST_STEP
    widths = np.where(there, width[groups], np.nan)
    return steps & (np.nanmax(widths, axis=1) - np.nanmin(widths, axis=1) < ALIKE)
