"""Tool poses that a task asks for, with the deviations that it allows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import InputError, expect, finite_array, finite_number, whole_number
from momapos.core.geometry import pose_wxyz, rotation_angle

if TYPE_CHECKING:
    from jaxtyping import Float

POSITION, ROTATION = 1e-3, math.radians(0.5)
"""Default tolerances of a tool pose [m], [rad]; arms repeat poses to a tenth of these."""
MAX_QUATERNION_ERROR = 1e-3
"""Largest deviation of a quaternion's length from 1 [-]; more is a mistake, not rounding."""
_ROUNDING = 1e-6
"""Deviations may exceed their tolerance by this [m] or [rad]; files are rounded."""


@dataclass(frozen=True)
class ToolPose:
    """A pose of the tool in the world that a task asks for, and how far the tool may be off.

    The tolerance is stated in the frame of the pose itself. Without `axis`, the tool may be rotated
    by `rotation` about any axis. With it, the axis may lean by `cone` and the tool may turn about
    it by `spin` to either side, each by at least `rotation`.

    Raises:
        InputError: A number is not finite or out of range, the quaternion or the axis has no unit
            length, or all tolerances are zero.
    """

    xyz: tuple[float, float, float]
    """Position in the world [m]."""
    wxyz: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    """Unit quaternion; one whose length is off by at most 1e-3 is scaled."""
    name: str = ""
    """Name in reports, such as its row in a file."""
    position: tuple[float, float, float] = (POSITION, POSITION, POSITION)
    """How far the tool may be off along each axis of the pose, to either side [m]."""
    rotation: float = ROTATION
    """How far it may be rotated [rad]."""
    axis: tuple[float, float, float] | None = None
    """Unit axis in the frame of the pose, about which the tool may turn or which may lean."""
    spin: float = 0.0
    """Turn about that axis to either side [rad]; pi for any."""
    cone: float = 0.0
    """Angle by which that axis may lean [rad]."""
    contact: str = ""
    """The object that the tool is meant to touch; "" for none."""

    def __post_init__(self) -> None:
        where = f"{self.name}: " if self.name else "ToolPose."
        expect(f"{where}name", self.name, str)
        expect(f"{where}contact", self.contact, str)
        for name, value in (("xyz", self.xyz), ("position", self.position)):
            object.__setattr__(self, name, _row(f"{where}{name}", value, 3))
        if min(self.position) < 0.0:
            raise InputError(f"{where}position must be at least 0 [m], not {self.position}")
        object.__setattr__(self, "wxyz", _unit(f"{where}quaternion", self.wxyz, 4))
        for name in ("rotation", "spin", "cone"):
            angle = finite_number(f"{where}{name}", getattr(self, name), 0.0, 2 * math.pi)
            object.__setattr__(self, name, min(angle, math.pi))
        if self.axis is not None:
            object.__setattr__(self, "axis", _unit(f"{where}axis", self.axis, 3))
        elif self.spin or self.cone:
            raise InputError(f"{where}spin and cone need an axis, such as axis (1, 0, 0)")
        if max(*self.position, self.rotation, self.spin, self.cone) <= 0.0:
            raise InputError(
                f"{where}all tolerances are zero, which no arm meets; leave them out for "
                f"{1000 * POSITION:g} mm and {math.degrees(ROTATION):g} deg"
            )

    @property
    def T_world_tool(self) -> Float[np.ndarray, "4 4"]:
        """Return the pose as a transform."""
        return pose_wxyz(self.xyz, self.wxyz)

    def excess(
        self,
        Ts_world_tool: Float[np.ndarray, "n 4 4"],
        wanted: Float[np.ndarray, "#n 4 4"] | None = None,
    ) -> Float[np.ndarray, "n 2"]:
        """Return by how much tools exceed the tolerance in position [m] and rotation [rad].

        Values up to 0 are within it. The lean is the angle between the axes; the turn is what is
        left of the rotation after the shortest one between the axes.

        Args:
            Ts_world_tool: Poses of the tool.
            wanted: Poses that it should have, with the tolerance of this one; this one by default.
        """
        wanted = self.T_world_tool[None] if wanted is None else wanted
        back = wanted[:, :3, :3].transpose(0, 2, 1)
        R = back @ Ts_world_tool[:, :3, :3]
        away = Ts_world_tool[:, :3, 3] - wanted[:, :3, 3]
        off = np.abs((back @ away[..., None])[..., 0])
        beyond = (off - self.position).max(1)
        if self.axis is None:
            angle = rotation_angle(R, np.broadcast_to(np.eye(3), R.shape)) - self.rotation
            return np.stack([beyond, angle], 1) - _ROUNDING
        axis = np.array(self.axis)
        turned = R @ axis
        normal, cosine = np.cross(axis, turned), turned @ axis
        lean = np.arctan2(np.linalg.norm(normal, axis=1), cosine)
        K = np.cross(np.eye(3), normal[:, None])
        scale = 1.0 / np.maximum(1.0 + cosine, 1e-9)
        swing = np.eye(3) + K + K @ K * scale[:, None, None]
        twist = rotation_angle(swing, R)
        angle = np.maximum(
            lean - max(self.cone, self.rotation), twist - max(self.spin, self.rotation)
        )
        return np.stack([beyond, angle], 1) - _ROUNDING


@dataclass(frozen=True)
class ToolPath:
    """Poses through which the tool moves in one go, straight from each to the next.

    Raises:
        InputError: There are fewer than two poses, a break is no pose between the first and the
            last, or the speed is not positive.
    """

    poses: tuple[ToolPose, ...]
    breaks: tuple[int, ...] = ()
    """Indices of the poses at which the tool may leave the path, to come back from another base
    pose; ascending."""
    speed: float | None = None
    """Speed of the tool [m/s]; None for the usual limit."""

    def __post_init__(self) -> None:
        if not isinstance(self.poses, Sequence) or isinstance(self.poses, str):
            raise InputError("ToolPath.poses must be a sequence of ToolPose")
        for k, pose in enumerate(self.poses):
            expect(f"ToolPath.poses[{k}]", pose, ToolPose)
        if len(self.poses) < 2:
            raise InputError(f"a path needs two poses or more, not {len(self.poses)}")
        object.__setattr__(self, "poses", tuple(self.poses))
        last = len(self.poses) - 1
        if not isinstance(self.breaks, Sequence | np.ndarray) or isinstance(self.breaks, str):
            raise InputError(f"ToolPath.breaks must be indices of poses, not {self.breaks!r:.60}")
        breaks = sorted({whole_number("ToolPath.breaks", k, 0, last) for k in self.breaks})
        object.__setattr__(self, "breaks", tuple(k for k in breaks if 0 < k < last))
        if self.speed is not None:
            object.__setattr__(self, "speed", finite_number("ToolPath.speed", self.speed, 0.0))


def _row(name: str, value: object, count: int) -> tuple[float, ...]:
    if not isinstance(value, Sequence | np.ndarray) or isinstance(value, str):
        raise InputError(f"{name} must be {count} numbers, not {value!r:.60}")
    if len(value) != count:
        raise InputError(f"{name} must be {count} numbers, not {len(value)}")
    return tuple(finite_array(name, value, (count,)).tolist())


def _unit(name: str, value: object, count: int) -> tuple[float, ...]:
    row = _row(name, value, count)
    length = math.hypot(*row)
    if abs(length - 1.0) > MAX_QUATERNION_ERROR:
        raise InputError(f"{name} has length {length:.4g}; it must be 1")
    return tuple(number / length for number in row)
