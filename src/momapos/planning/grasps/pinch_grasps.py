"""Compute how hands close on a part: reachable depth, pad contact, transmitted force."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .config import GraspConfig
from .hand_boxes import Hand
from .handle_shapes import Element
from .swept_boxes import NEVER, touches_hull

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

START_DISTANCE = 0.25
"""Distance before its target at which a hand starts on its approach line [m]."""
ROWS, COLUMNS = 40, 3
"""Sample points of a pad's contact, along and across the fingers [-]."""
CONE_SHARE = 2 / 3
"""Share of the friction cone within which a surface counts as contact [-]."""
PAD_COMPLIANCE = 0.0015
"""Depth by which the rubber of a pad yields [m]."""
HELD_CLEARANCE_SHARE, OTHER_CLEARANCE_SHARE = 1 / 4, 1 / 2
"""Minimum clearance of an open hand at a grasp to the grasped elements and to all others, as shares
of `hand_clearance` [-]."""


@dataclass(frozen=True, eq=False)
class Advance:
    """How far hands move along their approach lines before they touch something."""

    travel: Float[np.ndarray, " g"]
    """Travel from the target [m]."""
    obstacle: Int[np.ndarray, " g"]
    """Index of the element that stops each hand, or -1."""


def near_elements(
    elements: tuple[Element, ...], center: Float[np.ndarray, "3"], reach: float
) -> tuple[Element, ...]:
    """Return the elements whose axis-aligned boxes are within a distance of a point."""
    return tuple(
        e
        for e in elements
        if np.linalg.norm(np.maximum(0, np.maximum(e.low - center, center - e.high))) < reach
    )


def advance(
    hand: Hand,
    elements: tuple[Element, ...],
    R: Float[np.ndarray, "g 3 3"],
    p: Float[np.ndarray, "g 3"],
    config: GraspConfig,
) -> Advance:
    """Move open hands along their approach, from `START_DISTANCE` before, until they touch.

    Args:
        hand: The gripper.
        elements: The part.
        R, p: Target poses of the tools, in the part's frame.
        config: Gives the clearance.

    Returns:
        Travel beyond the target poses; negative if a hand stops before.
    """
    start = p - START_DISTANCE * (R @ hand.approach)
    travel = np.full(len(R), NEVER)
    obstacle = np.full(len(R), -1)
    for index, element in enumerate(elements):
        touch = touches_hull(
            hand.boxes, element.convex, R, start, hand.approach, config.hand_clearance
        )
        # Obstacles before the straight approach do not count.
        begin = np.where(touch.end < START_DISTANCE - config.pregrasp, NEVER, touch.begin).min(
            1, initial=NEVER
        )
        obstacle = np.where(begin < travel, index, obstacle)
        travel = np.minimum(travel, begin)
    return Advance(travel - START_DISTANCE, obstacle)


def stands_clear(
    hand: Hand,
    elements: tuple[Element, ...],
    held: Bool[np.ndarray, " e"],
    R: Float[np.ndarray, "g 3 3"],
    p: Float[np.ndarray, "g 3"],
    config: GraspConfig,
) -> Bool[np.ndarray, " g"]:
    """Check that open hands are clear at their grasps and on the straight approach."""
    clear = np.ones(len(R), bool)
    for element, own in zip(elements, held, strict=True):
        margin = config.hand_clearance * (HELD_CLEARANCE_SHARE if own else OTHER_CLEARANCE_SHARE)
        touch = touches_hull(hand.boxes, element.convex, R, p, -hand.approach, margin)
        clear &= ~((touch.begin <= config.pregrasp) & (touch.end > 0)).any(1)
    return clear


def close_hands(
    hand: Hand,
    elements: tuple[Element, ...],
    held: Bool[np.ndarray, " e"],
    R: Float[np.ndarray, "g 3 3"],
    p: Float[np.ndarray, "g 3"],
    config: GraspConfig,
) -> tuple[Float[np.ndarray, "g 3"], Float[np.ndarray, "g 2"], Bool[np.ndarray, " g"]]:
    """Close hands until their pads touch held elements.

    Returns:
        Tool origins after closing, travel of each finger [m], and which hands have both pads in
        contact within the friction cone.
    """
    closing, cosine = _close_fingers(hand, elements, held, R, p, config.hand_clearance)
    met = np.isfinite(closing).all(1)
    distance = np.where(met[:, None], closing, 0.0)
    shift, travel = hand.meeting(distance, config.hand_clearance)
    met &= (travel > 0).any(1) & (travel.sum(1) < 2 * hand.travel)
    met &= (cosine >= np.cos(np.arctan(config.friction))).all(1)
    return p - shift[:, None] * (R @ hand.closing), travel, met


def _close_fingers(
    hand: Hand,
    elements: tuple[Element, ...],
    held: Bool[np.ndarray, " e"],
    R: Float[np.ndarray, "g 3 3"],
    p: Float[np.ndarray, "g 3"],
    clearance: float,
) -> tuple[Float[np.ndarray, "g 2"], Float[np.ndarray, "g 2"]]:
    """Return the travel of each finger until its pad touches, and the cosine to the contact normal.

    The travel is NEVER if anything else touches first, or is within half the clearance.
    """
    travel = np.full((len(R), 2), NEVER)
    cosine = np.zeros((len(R), 2))
    for k, side in enumerate((1, -1)):
        rows = np.flatnonzero(hand.side == side)
        boxes = hand.boxes.take(rows)
        pad, other = hand.pad[rows], np.full(len(R), NEVER)
        for element, own in zip(elements, held, strict=True):
            touch = touches_hull(boxes, element.convex, R, p, -side * hand.closing)
            begin = np.where(touch.end < 0, NEVER, touch.begin)
            mine = begin[:, pad] if own else np.full((len(R), 1), NEVER)
            best = mine.argmin(1)[:, None]
            first = np.take_along_axis(mine, best, 1)[:, 0]
            if own:
                nearer = first < travel[:, k]
                lean = np.take_along_axis(touch.cosine[:, pad], best, 1)[:, 0]
                cosine[:, k] = np.where(nearer, lean, cosine[:, k])
                travel[:, k] = np.minimum(travel[:, k], first)
            rest = begin[:, ~pad] if own else begin
            margin = 0.0 if own else clearance / 2
            other = np.minimum(other, rest.min(1, initial=NEVER) - margin)
        travel[:, k] = np.where(other < travel[:, k], NEVER, travel[:, k])
    return travel, cosine


@dataclass(frozen=True, eq=False)
class Contact:
    """The contact of two closed pads."""

    area: Float[np.ndarray, " g"]
    """Area of the smaller contact [m^2]."""
    point: Float[np.ndarray, "g 3"]
    """Middle of both contacts, in the part's frame [m]."""
    apart: Float[np.ndarray, " g"]
    """Distance of the two middles across the closing axis [m]."""
    spread: Float[np.ndarray, " g"]
    """Mean distance of the contact points from their middle, the smaller of both pads [m]."""

    def is_firm(self, hand: Hand, config: GraspConfig) -> Bool[np.ndarray, " g"]:
        """Check that the contacts are large enough and face each other."""
        pads = np.diff(hand.inner(1)[1], axis=0)[0]
        return (self.area >= 1e-4 * config.pad_contact) & (self.apart < pads.min())


def contact_of(
    hand: Hand,
    held: tuple[Element, ...],
    R: Float[np.ndarray, "g 3 3"],
    p: Float[np.ndarray, "g 3"],
    travel: Float[np.ndarray, "g 2"],
    friction: float,
) -> Contact:
    """Compute the contact of closed pads from sample points on their faces.

    Only surfaces well within the friction cone about the closing axis count. Pads slip on others,
    such as the sharp edge of a bar or a wedge.
    """
    cone = np.cos(CONE_SHARE * np.arctan(friction))
    axis = R @ hand.closing
    across = np.cross(hand.approach, hand.closing)
    areas, middles, spreads = [], [], []
    for k, side in enumerate((1, -1)):
        face, (low, high) = hand.inner(side)
        a = low[0] + (np.arange(ROWS) + 0.5) / ROWS * (high[0] - low[0])
        b = low[1] + (np.arange(COLUMNS) + 0.5) / COLUMNS * (high[1] - low[1])
        grid = (a[:, None, None] * hand.approach + b[None, :, None] * across).reshape(-1, 3)
        shift = face - side * (travel[:, k] + PAD_COMPLIANCE)
        local = grid[None] + shift[:, None, None] * hand.closing
        points = np.einsum("gij,gnj->gni", R, local) + p[:, None]
        touching = np.zeros(points.shape[:2], bool)
        for element in held:
            depth, cosine = element.convex.surface(points, side * axis)
            touching |= (depth >= 0) & (cosine >= cone)
        count = touching.sum(1)
        cell = (high - low).prod() / (ROWS * COLUMNS)
        areas.append(count * cell)
        weights = touching / np.maximum(count, 1)[:, None]
        middles.append(weights @ grid)
        away = np.linalg.norm(grid - middles[-1][:, None], axis=-1)
        spreads.append((weights * away).sum(1))
    middle = (middles[0] + middles[1]) / 2
    inward = (travel[:, 1] - travel[:, 0])[:, None] / 2 * hand.closing
    point = np.einsum("gij,gj->gi", R, middle + inward) + p
    apart = np.linalg.norm(middles[0] - middles[1], axis=1)
    return Contact(np.minimum(*areas), point, apart, np.minimum(*spreads))


def pinch_capacity(
    force: float, friction: float, lean: Float[np.ndarray, " *g"]
) -> Float[np.ndarray, " *g"]:
    """Return the pull that two closed fingers transmit [N].

    Friction at both pads carries the component across the closing axis. The force of one finger
    carries the component along it, which reduces the normal force at the other pad.

    Args:
        force: Force of each finger [N].
        friction: Friction coefficient between pad and part [-].
        lean: Share of the pull along the closing axis [-].
    """
    along = np.abs(lean)
    across = np.sqrt(np.maximum(0.0, 1.0 - along**2))
    return _transmitted(force, friction, across, along)


def lifting_capacity(
    force: float,
    friction: float,
    contact: Contact,
    closing: Float[np.ndarray, "g 3"],
    width: Float[np.ndarray, " g"],
    center: Float[np.ndarray, "3"],
    down: Float[np.ndarray, "k 3"],
) -> Float[np.ndarray, " g"]:
    """Return the weight that two closed pads carry [N].

    A center of mass away from the contact exerts a torque, which friction bears within an ellipsoid
    of force and torque that grows with the spread of the contact (Howe and Cutkosky, IJRR 1996).
    The pad nearer to the center of mass bears more load.

    Args:
        force: Force of each finger [N].
        friction: Friction coefficient between pads and object [-].
        contact: Contact of the pads.
        closing: Unit closing axes.
        width: Distance between the pads [m].
        center: Center of mass, in the frame of the contact [m].
        down: Unit directions of gravity in that frame; the worst one counts.
    """
    away = center - contact.point
    along = np.abs(closing @ down.T)
    across = np.sqrt(np.maximum(0.0, 1.0 - along**2))
    turning = np.abs(np.einsum("gki,gi->gk", np.cross(away[:, None], down), closing))
    aside = np.abs(np.einsum("gi,gi->g", away, closing)) / np.maximum(width, 1e-6)
    shear = np.hypot(
        across * (1.0 + 2.0 * aside)[:, None],
        turning / np.maximum(contact.spread, 1e-6)[:, None],
    )
    return np.asarray(_transmitted(force, friction, shear, along).min(1))


def _transmitted(
    force: float,
    friction: float,
    shear: Float[np.ndarray, " *batch"],
    along: Float[np.ndarray, " *batch"],
) -> Float[np.ndarray, " *batch"]:
    """Return the load that two pads transmit, given its shares in shear and along the axis [N]."""
    by_friction = 2 * friction * force / np.maximum(shear + friction * along, 1e-9)
    return np.minimum(by_friction, force / np.maximum(along, 1e-9))
