"""Hands that close on a part: where they can go, where the pads meet it, what they transmit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.urdf import Boxes

from .config import GraspConfig
from .hand_boxes import Hand
from .handle_shapes import Element
from .swept_boxes import NEVER, touches_hull

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

BACK = 0.25
"""A hand that comes along a line is looked at from this far before its target [m]."""
ROWS, COLUMNS = 40, 3
"""Points of a pad at which its contact is looked for, along and across the fingers [-]."""
CONE = 2 / 3
"""Of the friction cone, so much may be spent on staying where the pads are [-]."""
NEAR = 0.0015
"""A pad touches what is this near to its face: rubber gives way [m]."""
OWN, OTHERS = 1 / 4, 1 / 2
"""Shares of its clearance that an open hand at a grasp keeps at least from what it holds, and from
all else [-]."""


@dataclass(frozen=True)
class Clearing:
    """How far hands come along their lines before anything touches."""

    travel: Float[np.ndarray, " g"]
    """[m]"""
    obstacle: Int[np.ndarray, " g"]
    """The element that stops each, -1 for none."""


def near_elements(
    elements: tuple[Element, ...], center: Float[np.ndarray, "3"], reach: float
) -> tuple[Element, ...]:
    """Those elements whose upright boxes come within a distance of a point."""
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
) -> Clearing:
    """How far open hands move along their approach before they touch anything.

    Args:
        hand: The gripper.
        elements: The part.
        R, p: Where the tools are to go, in the frame of the part; they begin `BACK` before.
        config: Names the clearance.

    Returns:
        Travel from the poses given, mostly positive: how much farther they could go.
    """
    start = p - BACK * (R @ hand.approach)
    travel = np.full(len(R), NEVER)
    obstacle = np.full(len(R), -1)
    for index, element in enumerate(elements):
        touch = touches_hull(
            hand.boxes, element.convex, R, start, hand.approach, config.hand_clearance
        )
        # What lies behind the straight approach is not in the way.
        begin = np.where(touch.end < BACK - config.pregrasp, NEVER, touch.begin).min(
            1, initial=NEVER
        )
        obstacle = np.where(begin < travel, index, obstacle)
        travel = np.minimum(travel, begin)
    return Clearing(travel - BACK, obstacle)


def stands_clear(
    hand: Hand,
    elements: tuple[Element, ...],
    held: Bool[np.ndarray, " e"],
    R: Float[np.ndarray, "g 3 3"],
    p: Float[np.ndarray, "g 3"],
    config: GraspConfig,
) -> Bool[np.ndarray, " g"]:
    """Whether open hands touch nothing at their grasps and on the straight way there."""
    clear = np.ones(len(R), bool)
    for element, own in zip(elements, held, strict=True):
        margin = config.hand_clearance * (OWN if own else OTHERS)
        touch = touches_hull(hand.boxes, element.convex, R, p, -hand.approach, margin)
        clear &= ~((touch.begin <= config.pregrasp) & (touch.end > 0)).any(1)
    return clear


@dataclass(frozen=True)
class Closing:
    """Where fingers meet what they close on."""

    travel: Float[np.ndarray, "g 2"]
    """How far each finger closes until its pad touches what is held [m]; NEVER where it does not,
    or not first."""
    cosine: Float[np.ndarray, "g 2"]
    """Between the closing axis and the normal of each contact [-]."""


def close(
    hand: Hand,
    elements: tuple[Element, ...],
    held: Bool[np.ndarray, " e"],
    R: Float[np.ndarray, "g 3 3"],
    p: Float[np.ndarray, "g 3"],
    clearance: float,
) -> Closing:
    """Close both fingers until they touch something.

    A finger counts where its pad touches first, and what is held; all else keeps a clearance.
    """
    travel = np.full((len(R), 2), NEVER)
    cosine = np.zeros((len(R), 2))
    for k, side in enumerate((1, -1)):
        rows = np.flatnonzero(hand.side == side)
        boxes = Boxes(hand.boxes.center[rows], hand.boxes.rotation[rows], hand.boxes.half[rows])
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
    return Closing(travel, cosine)


@dataclass(frozen=True)
class Contact:
    """What closed pads touch."""

    area: Float[np.ndarray, " g"]
    """Of the smaller contact of the two [m^2]."""
    point: Float[np.ndarray, "g 3"]
    """Middle of both, in the part."""
    apart: Float[np.ndarray, " g"]
    """Distance of their middles, seen along the closing axis [m]."""
    spread: Float[np.ndarray, " g"]
    """Mean distance of the contact from its middle, of the smaller of the two [m]."""


def contact_of(
    hand: Hand,
    held: tuple[Element, ...],
    R: Float[np.ndarray, "g 3 3"],
    p: Float[np.ndarray, "g 3"],
    travel: Float[np.ndarray, "g 2"],
    friction: float,
) -> Contact:
    """Where the pads of closed hands touch what they hold, by points on their faces.

    Only surface well within the friction cone about the closing axis counts: pads slip over the
    rest, as at the sharp edge of a bar or on a wedge.
    """
    cone = np.cos(CONE * np.arctan(friction))
    axis = R @ hand.closing
    across = np.cross(hand.approach, hand.closing)
    areas, middles, spreads = [], [], []
    for k, side in enumerate((1, -1)):
        face, (low, high) = hand.inner(side)
        a = low[0] + (np.arange(ROWS) + 0.5) / ROWS * (high[0] - low[0])
        b = low[1] + (np.arange(COLUMNS) + 0.5) / COLUMNS * (high[1] - low[1])
        grid = (a[:, None, None] * hand.approach + b[None, :, None] * across).reshape(-1, 3)
        shift = face - side * (travel[:, k] + NEAR)
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
    force: float, friction: float, lean: Float[np.ndarray, " g"]
) -> Float[np.ndarray, " g"]:
    """The pull that two closed fingers transmit [N].

    Across the closing axis friction at both pads carries it; along the axis a finger's own force
    does, and takes as much from the other pad's friction.

    Args:
        force: Of each finger [N].
        friction: Between pad and part [-].
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
    """The weight that two closed pads carry whose contact is somewhere on an object [N].

    Weight beside the pads turns the object between them: friction bears that too, as far as the
    contact spreads, within an ellipsoid of force and torque (Howe and Cutkosky, IJRR 1996). Weight
    nearer to one pad loads that one more.

    Args:
        force: Of each finger [N].
        friction: Between pads and object [-].
        contact: Of the pads.
        closing: Unit closing axes.
        width: Between the pads [m].
        center: Center of mass, in the frame of the contact [m].
        down: Unit directions of the weight there; the worst one counts.
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
    """What two pads transmit of a load of which shares shear them and press on one of them [N]."""
    by_friction = 2 * friction * force / np.maximum(shear + friction * along, 1e-9)
    return np.minimum(by_friction, force / np.maximum(along, 1e-9))
