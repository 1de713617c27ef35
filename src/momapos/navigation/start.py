"""Where a robot starts: as it is told, or in front of things, with room around it.

One rule for all who plan and drive: at the start the robot, its arm at home, touches nothing.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.ndimage import distance_transform_edt

from momapos.errors import SceneError
from momapos.navigation.clearance import gaps
from momapos.navigation.cost_map import CELL, FloorPlan
from momapos.navigation.footprint_map import HEADINGS, Ground
from momapos.navigation.judge import Judge
from momapos.navigation.outlines import on_floor

ROOM = 0.8
"""Clearance around the start [m]."""
_AT_ONCE = 64
"""Cells that are looked at together [-]."""


def check_start(ground: Ground, pose: Float[np.ndarray, "3"]) -> None:
    """Make sure that a robot with its arm at home touches nothing where it starts.

    Args:
        ground: The robot and the room.
        pose: x [m], y [m], yaw [rad].

    Raises:
        SceneError: It would touch something.
    """
    touched = Judge(ground.body, ground.obstacles, ground.floor).distance(pose[None])[1][0]
    if touched:
        x, y, yaw = pose
        raise SceneError(
            f"start ({x:.2f}, {y:.2f}, {np.degrees(yaw):.0f} deg): {ground.robot.name} with its "
            f"arm at home would touch {touched}; give another --start"
        )


def find_start(
    plan: FloorPlan, wish: Float[np.ndarray, "2"], ground: Ground
) -> Float[np.ndarray, "3"]:
    """The floor position nearest to a wish that has room around it, for the arm at home as well.

    Args:
        plan: Where something stands.
        wish: Where the start would best be [m].
        ground: The robot and the room.

    Raises:
        SceneError: Nowhere is there room.
    """
    clear = (
        distance_transform_edt(np.pad(~plan.blocked, 1, constant_values=True))[1:-1, 1:-1] * CELL
    )
    # Where no place is roomy enough for an arm that sticks out, any that the robot fits in will do.
    for room in (min(ROOM, 0.9 * float(clear.max())), 0.0):
        i, j = np.nonzero(clear > room)
        centers = plan.origin + (np.stack([j, i], -1) + 0.5) * CELL
        nearest = centers[np.argsort(np.linalg.norm(centers - wish, axis=1), kind="stable")]
        for k in range(0, len(nearest), _AT_ONCE):
            # The heading along x comes first, as does the nearer of two cells.
            poses = np.array([[*xy, yaw] for xy in nearest[k : k + _AT_ONCE] for yaw in _HEADINGS])
            fits = gaps(poses, ground.body, ground.things) > 0.0
            fits &= on_floor(ground.body, ground.floor, poses)
            if fits.any():
                return poses[int(np.argmax(fits))]
    raise SceneError("the room is full: nowhere can a robot start; give --start X,Y,YAW")


_HEADINGS = HEADINGS[np.argsort(np.abs(HEADINGS), kind="stable")]
