"""Push a part that is ajar from behind: the fingers reach past its free edge."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from momapos.core import owner_cache
from momapos.core.geometry import rotation_about, rotation_of
from momapos.model.robots import Robot
from momapos.model.urdf import Articulated
from momapos.verification import Limits

from .config import HANDLE_POINTS, GraspConfig
from .fronts import PUSH_INSET, front_face, front_part
from .hand_boxes import Hand, hand_of
from .handle_records import Handle
from .handle_shapes import CarriedPart, Element, in_pieces, part_elements
from .part_grasps import grasp_frames
from .swept_boxes import NEVER, touches_hull

if TYPE_CHECKING:
    from jaxtyping import Float

LEANS = (0.0, 20.0, 40.0)
"""Angles from the panel to the fingers, along which they come in [deg]."""
GRAZING, CLEAR = 10.0, 0.007
"""Fingers at a smaller angle [deg] stay this far off the panel [m], less than the exact check
allows. They would graze it all the way in, and catch on the edge of a released door: in physics a
fridge's stands so far off that 3 mm were too few."""
START_HEIGHT = 0.1
"""Height above the hull of the part's rim from which a hand comes down on its back [m]."""


@owner_cache()
def push_from_behind(
    robot: Robot, model: Articulated, joint: str, sign: float, config: GraspConfig
) -> tuple[Handle, Float[np.ndarray, "g 4 4"], Float[np.ndarray, " g"]] | None:
    """Build tool poses in which the side of a finger touches a part's back near its free edge.

    The palm stays beyond the edge, so that the arm need not reach around the part. Many doors are
    hollow inside: meshes count as convex pieces, since a hand that stopped at their hull would
    leave the part behind.

    Args:
        robot: The robot.
        model, joint: The part.
        sign: Opening direction of the joint (+1 or -1).
        config: Points along the edge, and tilts.

    Returns:
        The back of the part's hull, the poses in the part's frame and their complexity; None if the
        part has no back or the robot no fingers. Poses with the tool's origin farther from the part
        than the exact check allows are left out: wide hands touch it with one finger at their side.
    """
    back, hand = front_face(front_part(model, joint, sign), -sign), hand_of(robot)
    if back is None or not (hand.side != 0).any():
        return None
    record = next(one for one in model.urdf.joints if one.child == back.carrier)
    inward = np.cross(back.long, back.out)
    to_hinge = -back.center + record.axis * float(back.center @ record.axis)
    inward = inward * (1.0 if inward @ to_hinge > 0 else -1.0)
    usable = max(back.half_length - 0.03, 0.0)
    grid = np.meshgrid(
        np.radians(LEANS), np.radians(config.tilts), np.array(HANDLE_POINTS) * usable,
        np.arange(4) * np.pi / 2, indexing="ij",
    )  # fmt: skip
    lean, tilt, point, roll = (g.ravel() for g in grid)
    # The fingers lean from the direction along the panel toward it, against its outward normal.
    R = rotation_about(np.cross(inward, -back.out), lean) @ rotation_about(back.out, tilt)
    approach = R @ inward
    closing = np.einsum("gij,gj->gi", rotation_of(approach * roll[:, None]), R @ back.long)
    T = grasp_frames(robot, point[:, None] * back.long, approach, closing)
    T[:, :3, 3] += _touching_hull(hand, back, inward, T[:, :3, :3])
    part = CarriedPart(model, joint, back.carrier)
    height = _height(hand, part, back.out, T)
    met = np.isfinite(height)
    T[met, :3, 3] -= height[met, None] * back.out
    T[:, :3, 3] += np.where(lean < np.radians(GRAZING), CLEAR, 0.0)[:, None] * back.out
    complexity = np.abs(lean - np.radians(LEANS[1])) + np.abs(tilt) + 5 * np.abs(point)
    near = met & (T[:, :3, 3] @ back.out - _top(part, back.out) <= Limits().reach)
    return (back, T[near], complexity[near]) if near.any() else None


def _top(part: CarriedPart, out: Float[np.ndarray, "3"]) -> float:
    """Return how far a part extends in a direction, from the carrier's origin [m]."""
    return max(float((e.convex.vertices @ out).max()) for e in part_elements(part))


def _touching_hull(
    hand: Hand, back: Handle, inward: Float[np.ndarray, "3"], R: Float[np.ndarray, "g 3 3"]
) -> Float[np.ndarray, "g 3"]:
    """Return tool origins at which the fingers touch the back, with their tips at its middle point.

    Parts of the fingers beyond the free edge, such as knuckles, are ignored.
    """
    reach = hand.finger_reach(inward @ R)
    toward = hand.finger_reach(-back.out @ R, inward @ R, reach - PUSH_INSET)
    return back.center - reach[:, None] * inward + toward[:, None] * back.out


def _height(
    hand: Hand, part: CarriedPart, out: Float[np.ndarray, "3"], T: Float[np.ndarray, "g 4 4"]
) -> Float[np.ndarray, " g"]:
    """Return how far the fingers of hands are above the pieces of a part, in a direction [m].

    Negative where something next to the rim, as a rack, stands higher; infinite where they pass
    the part.
    """
    fingers = hand.boxes.take(np.flatnonzero(hand.side))
    R, height = np.ascontiguousarray(T[:, :3, :3]), np.full(len(T), NEVER)
    start = T[:, :3, 3] + START_HEIGHT * out
    ways, same = np.unique(np.round(-out @ R, 9), axis=0, return_inverse=True)

    def met(element: Element) -> Float[np.ndarray, " g"]:
        found = np.full(len(T), NEVER)
        for k, way in enumerate(ways):
            rows = np.flatnonzero(same.ravel() == k)
            touch = touches_hull(fingers, element.convex, R[rows], start[rows], way)
            found[rows] = np.where(touch.end < 0.0, NEVER, touch.begin).min(1)
        return found

    for whole in part_elements(part):
        if np.isfinite(met(whole)).any():
            height = np.min([height, *map(met, in_pieces(part, [whole]))], axis=0)
    return height - START_HEIGHT
