"""Families of grasps: never one hand-picked pose."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from momapos.geometry.transforms import rotation_about, rotation_of
from momapos.manipulation.config import GraspConfig
from momapos.manipulation.handles import Handle
from momapos.robots.robot import Robot

if TYPE_CHECKING:
    from jaxtyping import Float


def grasp_frames(
    robot: Robot, center: np.ndarray, approach: np.ndarray, closing: np.ndarray
) -> Float[np.ndarray, "g 4 4"]:
    """Tool poses from where the tool is, where it points and how it closes.

    Args:
        robot: Names the axes of its tool.
        center: Tool origins (g, 3).
        approach: Unit approach directions (g, 3).
        closing: Unit closing directions (g, 3), perpendicular to `approach`.

    Returns:
        T_part_tool in the frame of the arguments.
    """
    a, c = robot.approach_axis, robot.closing_axis
    R_axes_tool = np.stack([a, c, np.cross(a, c)])
    R_part_axes = np.stack([approach, closing, np.cross(approach, closing)], axis=-1)
    T = np.tile(np.eye(4), (len(center), 1, 1))
    T[:, :3, :3] = R_part_axes @ R_axes_tool
    T[:, :3, 3] = center
    return T


def handle_grasps(robot: Robot, handle: Handle, config: GraspConfig) -> Float[np.ndarray, "g 4 4"]:
    """The family of grasps of a handle, the plainest first, in the moving link's frame.

    The fingers close across the long axis; both rolls by half a turn are kept, because the
    arm's wrist makes them different.
    """
    side = np.cross(handle.long, handle.out)
    # An edge that cannot be reached behind is touched with the fingertips.
    deep = [] if handle.edge else [share * robot.finger_depth for share in config.standoffs]
    standoffs = [*deep, robot.finger_depth + config.tip_gap]
    points = _points(handle, config)
    rolls = (
        np.arange(config.rolls) * 2 * np.pi / config.rolls if handle.knob else np.array([0, np.pi])
    )
    turns, tilts = np.radians(config.turns), np.radians(config.tilts)
    grid = np.stack(np.meshgrid(rolls, points, standoffs, tilts, turns, indexing="ij"), -1).reshape(
        -1, 5
    )
    roll, point, standoff, tilt, turn = grid.T
    R_turn = rotation_about(handle.long, turn)
    approach = R_turn @ -handle.out
    closing = R_turn @ side
    R_tilt = _rotations(closing, tilt)
    approach = np.einsum("gij,gj->gi", R_tilt, approach)
    closing = np.einsum("gij,gj->gi", _rotations(approach, roll), closing)
    center = handle.center + point[:, None] * handle.long - standoff[:, None] * approach
    order = np.argsort(
        np.abs(turn) + np.abs(tilt) + 5 * np.abs(point) + 5 * standoff, kind="stable"
    )
    return grasp_frames(robot, center, approach, closing)[order]


def _points(handle: Handle, config: GraspConfig) -> Float[np.ndarray, " p"]:
    usable = max(handle.half_length - 0.015, 0.0)
    if usable < 0.02:
        return np.zeros(1)
    return np.array(config.points) * usable


def _rotations(
    axes: Float[np.ndarray, "g 3"], angles: Float[np.ndarray, " g"]
) -> Float[np.ndarray, "g 3 3"]:
    return rotation_of(axes * angles[:, None])


def box_grasps(
    robot: Robot, half: Float[np.ndarray, "3"], config: GraspConfig
) -> Float[np.ndarray, "g 4 4"]:
    """Grasps of a rigid box about its center, in the box's frame (z up): from above and the sides.

    Only directions across which the box fits between the fingers are kept.
    """
    directions, closings = [], []
    for pitch in np.radians((90.0, 60.0, 30.0, 0.0)):
        for yaw in np.arange(config.rolls) * 2 * np.pi / config.rolls:
            approach = np.array(
                [np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), -np.sin(pitch)]
            )
            level = np.array([-np.sin(yaw), np.cos(yaw), 0.0])
            for closing in (level, -level):
                directions.append(approach)
                closings.append(closing)
    approach, closing = np.array(directions), np.array(closings)
    width = 2 * np.abs(closing) @ half
    # A round thing of this box is as wide as the box's narrower side, whatever the direction.
    fits = np.minimum(width, 2 * float(half[:2].min())) < robot.opening
    approach, closing = approach[fits], closing[fits]
    # Come no deeper than the palm allows: hold near the top or the near side.
    depth = np.maximum(np.abs(approach) @ half - 0.03, 0.0)
    return grasp_frames(robot, -approach * depth[:, None], approach, closing)
