"""Model a gripper as boxes: a palm and two jaws that close along one axis."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import owner_cache
from momapos.core.geometry import invert
from momapos.model.robots import Grip, Robot, facing_pose, finger_links, squared, tips_of
from momapos.model.urdf import Boxes

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

PAD_DEPTH = 0.03
"""Boxes of a finger that reach this close to its tip are its pad [m]."""
LEVEL_TOLERANCE = 1e-3
"""Boxes that protrude inwards beyond the pads by less count as level with them [m]."""
MIN_FLAT_COSINE = 0.98
"""Minimum cosine between the normal of a pad's inner face and the closing axis [-]."""


_CORNERS = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
_EDGES = np.argwhere(np.triu((_CORNERS[:, None] != _CORNERS).sum(-1) == 1))
"""Corners of a box in its frame, and the pairs of them that an edge connects."""


@dataclass(frozen=True, eq=False)
class HandBoxes:
    """A fully opened gripper in its tool frame."""

    boxes: Boxes
    side: Int[np.ndarray, " b"]
    """1 or -1 for boxes of the finger on that side of the closing axis, 0 for the palm."""
    pad: Bool[np.ndarray, " b"]
    """Which boxes belong to the pads."""
    approach: Float[np.ndarray, "3"]
    closing: Float[np.ndarray, "3"]
    travel: float
    """Maximum travel of each of two fingers, half of the opening [m]; 0 if nothing closes."""
    pad_middle: float
    """Position of the middle of the pads along the approach [m]."""
    tip: float
    """Position of the fingertips along the approach [m]."""
    rest: float
    """Travel of a finger from fully open to the gripper's rest position [m]."""
    fixed: int = 0
    """Side of a fixed jaw on which the other closes; 0 if both move."""

    @property
    def closes(self) -> bool:
        """Whether two fingers with pads face each other."""
        return self.travel > 0.0

    def meeting(
        self, distance: Float[np.ndarray, "g 2"], gap: float
    ) -> tuple[Float[np.ndarray, " g"], Float[np.ndarray, "g 2"]]:
        """Compute how the hand closes on an object at a distance from each side.

        Two fingers close by the same travel. A fixed jaw first keeps a gap to the object, so that
        the open hand is clear; the closing jaw then pulls the hand there.

        Args:
            distance: Distance of each side from the object [m].
            gap: Gap of a fixed jaw [m].

        Returns:
            Shift of the hand along its closing axis before, and travel of each side [m].
        """
        total = distance.sum(1)
        near = np.minimum(total, gap)
        first = {0: total / 2, 1: near, -1: total - near}[self.fixed]
        travel = np.stack([first, total - first], axis=1)
        shift = (distance[:, 0] - distance[:, 1] - (travel[:, 0] - travel[:, 1])) / 2
        return shift, travel

    def closed_to(self, width: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """Return the travel from rest of each moving finger at a width between the pads [m]."""
        share = 0.5 if self.fixed == 0 else 1.0
        return np.asarray(share * (2 * self.travel - width) - self.rest)

    def inner(self, side: int) -> tuple[float, Float[np.ndarray, "2 2"]]:
        """Return the inner face of the pad on a side.

        Returns:
            Its position along the closing axis, and its lower and upper corner along the approach
            and across both axes [m].
        """
        axes = np.stack([self.closing, self.approach, np.cross(self.approach, self.closing)])
        rows = np.flatnonzero((self.side == side) & self.pad)
        middle = self.boxes.center[rows] @ axes.T
        reach = _reach(self.boxes, axes)[rows]
        low, high = (middle - reach).min(0), (middle + reach).max(0)
        face = low[0] if side > 0 else high[0]
        return float(face), np.array([low[1:], high[1:]])

    @property
    def thickness(self) -> float:
        """Thickness of the thinnest box of a finger along the closing axis; inf without any [m]."""
        reach = _reach(self.boxes, self.closing[None])[self.side != 0]
        return float(2 * reach.min(initial=np.inf))

    def finger_reach(
        self,
        axes: Float[np.ndarray, "k 3"],
        along: Float[np.ndarray, "k 3"] | None = None,
        beyond: Float[np.ndarray, " k"] | None = None,
    ) -> Float[np.ndarray, " k"]:
        """Return how far the fingers extend from the tool's origin along axes of its frame [m].

        Args:
            axes: The axes.
            along, beyond: If given, only of the parts that lie at least this far along other
                axes [m].
        """
        if along is None or beyond is None:
            reach = self.boxes.center @ axes.T + _reach(self.boxes, axes)
            return reach[self.side != 0].max(0)
        rows = self.side != 0
        half = _CORNERS * self.boxes.half[rows, None]
        corners = self.boxes.center[rows, None] + half @ self.boxes.rotation[rows].swapaxes(1, 2)
        height = np.einsum("ki,bci->kbc", axes, corners)
        depth = np.einsum("ki,bci->kbc", along, corners) - beyond[:, None, None]
        inside = np.where(depth >= 0.0, height, -np.inf).max((1, 2))
        (a, b), (h, g) = ((v[..., _EDGES[:, 0]], v[..., _EDGES[:, 1]]) for v in (depth, height))
        crossed = a * b < 0.0
        cut = h + (g - h) * a / np.where(crossed, a - b, 1.0)
        return np.maximum(inside, np.where(crossed, cut, -np.inf).max((1, 2)))


def _reach(boxes: Boxes, axes: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "b k"]:
    """Return the half extents of boxes along axes [m]."""
    return np.einsum("kbj,bj->bk", np.abs(axes @ boxes.rotation).transpose(1, 0, 2), boxes.half)


def closes_fingers(robot: Robot) -> bool:
    """Return whether a tool holds with fingers that close."""
    return robot.grips is Grip.FINGERS and hand_of(robot).closes


def empty_handed(robot: Robot) -> str:
    """Explain why a tool cannot grasp (no moving finger) and what would help; "" if it can."""
    model = robot.model
    fingers = [
        link
        for joint in model.joints.values()
        if robot.tool_link not in (below := model.links_below(joint.child))
        for link in below
        if link in robot.gripper_links and model.hulls[link]
    ]
    if fingers or robot.grips is not Grip.FINGERS:
        return ""
    return (
        f"{robot.name} has nothing to hold with: no finger with a collision shape moves at "
        f"{robot.tool_link}; use a URDF with its gripper, or say tool.grips in {robot.path.name}"
    )


@owner_cache()
def hand_of(robot: Robot) -> HandBoxes:
    """Build the model of a robot's gripper.

    Fingers are moved along the closing axis until the distance of their pads is the opening, for
    files whose gripper rests closed. Rotating fingers are first posed so that their pads face each
    other.
    """
    model, fingers = robot.model, finger_links(robot)
    values, gap = facing_pose(robot, fingers)
    poses = model.link_poses(values)
    T_tool_root = invert(poses[robot.tool_link])
    T_tool_link = {link: T_tool_root @ poses[link] for link in robot.gripper_links}
    tips = tips_of(robot, {link: T_tool_link[link] for link in fingers})
    cover, finger, turned = [], [np.zeros(0, bool)], [np.zeros(0, bool)]
    for link, T in T_tool_link.items():
        for index, boxes in enumerate(model.boxes[link]):
            placed = boxes.moved(T)
            face = squared(placed, robot.closing_axis) if (link, index) in tips else None
            cover.append(placed if face is None else face)
            finger.append(np.full(len(boxes), link in fingers))
            turned.append(np.full(len(boxes), face is not None))
    moving = {joint.child for joint in model.joints.values() if joint.parent not in fingers}
    return _open_hand(
        Boxes.join(cover), np.concatenate(finger), np.concatenate(turned), gap, robot,
        one_jaw=len(moving & fingers) == 1,
    )  # fmt: skip


def _open_hand(
    boxes: Boxes,
    finger: Bool[np.ndarray, " b"],
    turned: Bool[np.ndarray, " b"],
    gap: float | None,
    robot: Robot,
    *,
    one_jaw: bool,
) -> HandBoxes:
    """Classify palm, fingers and pads, and open the fingers.

    Args:
        boxes, finger: The gripper, and which boxes belong to fingers.
        turned: Tips that were rotated; on their side, they alone are pads.
        gap: Distance of the pads at rest [m]; None if the boxes are at rest.
        robot: Gives the axes and the opening.
        one_jaw: Whether only one finger moves, toward a fixed jaw.
    """
    approach, closing = robot.approach_axis, robot.closing_axis
    reach = _reach(boxes, np.stack([approach, closing]))
    at, along = boxes.center @ closing, boxes.center @ approach
    side = np.where(finger, np.where(at >= 0, 1, -1), 0)
    fixed = 0
    if one_jaw:
        opposite = ~finger & (along + reach[:, 0] > (along + reach[:, 0])[finger].max() - PAD_DEPTH)
        if opposite.any():
            fixed = 1 if at[opposite].mean() > at[finger].mean() else -1
            side = np.where(finger, -fixed, np.where(opposite, fixed, 0))
    tips = [(along + reach[:, 0])[side == s].max(initial=-np.inf) for s in (1, -1)]
    flat = (
        np.abs(np.einsum("bij,i->bj", boxes.rotation, closing)).max(1, initial=0.0)
        > MIN_FLAT_COSINE
    )
    pad = np.zeros(len(boxes), bool)
    for s, tip in zip((1, -1), tips, strict=True):
        pad |= (side == s) & flat & (along + reach[:, 0] > tip - PAD_DEPTH)
    inner = at - np.sign(at) * reach[:, 1]
    for s in (1, -1):
        if turned[side == s].any():
            pad &= (side != s) | turned
    faces = [float((inner * s)[pad & (side == s)].min(initial=np.inf)) for s in (1, -1)]
    tip = max(tips) if np.isfinite(max(tips)) else robot.finger_depth
    if not np.isfinite(faces).all():
        return HandBoxes(boxes, side, pad, approach, closing, 0.0, 0.0, tip, 0.0)
    spread = np.where(side > 0, robot.opening / 2 - faces[0], faces[1] - robot.opening / 2)
    if fixed:
        spread = np.where(side == fixed, 0.0, fixed * (sum(faces) - robot.opening))
    center = boxes.center + np.where(side != 0, spread, 0.0)[:, None] * closing
    # Boxes that protrude inwards behind the pads limit the usable depth of the pads.
    front = np.where(side > 0, faces[0], np.where(side < 0, faces[1], -np.inf))
    behind = (side != 0) & ~pad & (inner * side < front - LEVEL_TOLERANCE)
    ends = (along + reach[:, 0])[behind]
    low = max(float((along - reach[:, 0])[pad].min()), float(ends.max(initial=-np.inf)))
    return HandBoxes(
        Boxes(center, boxes.rotation, boxes.half), side, pad, approach, closing,
        robot.opening / 2, (min(low, tip) + tip) / 2, tip,
        (robot.opening - (sum(faces) if gap is None else gap)) * (0.5 if fixed == 0 else 1.0),
        fixed,
    )  # fmt: skip
