"""Generate the grasps of a part by one hand, and how hands close on it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import owner_cache
from momapos.core.geometry import rotation_about, rotation_of
from momapos.model.records import FAMILIES, Family
from momapos.model.robots import Grip, Robot
from momapos.model.urdf import Articulated

from .config import HANDLE_POINTS, ROLLS, STANDOFFS, GraspConfig
from .hand_boxes import HandBoxes, closes_fingers, empty_handed, hand_of
from .handle_shapes import (
    NEVER,
    CarriedPart,
    Element,
    corners,
    in_pieces,
    part_elements,
    part_pieces,
    touches_hull,
)
from .handles import Handle, HandleKind, HandleSource, front_face
from .part_motion import motion_directions

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
    hand: HandBoxes,
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
    hand: HandBoxes,
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
    hand: HandBoxes,
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
    hand: HandBoxes,
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

    def is_firm(self, hand: HandBoxes, config: GraspConfig) -> Bool[np.ndarray, " g"]:
        """Check that the contacts are large enough and face each other."""
        return (self.area >= 1e-4 * config.pad_contact) & (self.apart < _pad_width(hand))

    def flaw(self, hand: HandBoxes, config: GraspConfig) -> str:
        """Return why no contact is firm, with the setting or the size that decides."""
        most = 1e4 * float(self.area.max())
        if most < config.pad_contact:
            return (
                f"at most {most:.2f} cm^2 each, and motion.grasps.pad_contact is "
                f"{config.pad_contact:g} cm^2"
            )
        large = self.area >= 1e-4 * config.pad_contact
        return (
            f"the two contacts are {1000 * self.apart[large].min():.0f} mm apart, and the pads are "
            f"only {1000 * _pad_width(hand):.0f} mm wide"
        )


def _pad_width(hand: HandBoxes) -> float:
    """Return the smaller extent of a pad's face [m]."""
    return float(np.diff(hand.inner(1)[1], axis=0).min())


def contact_of(
    hand: HandBoxes,
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


HAND_REACH = 0.35
"""Elements farther from a handle cannot touch the hand [m]."""
MIN_OVERLAP = 0.003
"""Minimum depth of the fingertips beyond the near side of the handle [m]."""
FREE_TILTS = (50.0, -50.0)
"""Further tilts along a handle with a free end, around which there is room for the hand [deg]."""
STEEP_TURNS = {75.0: {60.0, 90.0}, -75.0: {-60.0, -90.0}}
"""Further turns of a hand that is not fully open, if both turns next to them are tried [deg].
Behind a bar near a panel a finger has most room if it leans: at 72 to 80 degrees for 43 mm."""
HOOK_SHARE = 0.8
"""Share of the pull along the closing axis above which a grasp is a hook [-]."""


@dataclass(frozen=True, eq=False)
class PartGrasps:
    """The grasps of one handle by one robot; see `Grasps` for the fields."""

    Ts_part_tool: Float[np.ndarray, "g 4 4"]
    code: Int[np.ndarray, " g"]
    width: Float[np.ndarray, " g"]
    capacity: Float[np.ndarray, " g"]
    point: Float[np.ndarray, "g 3"]
    """Middle of the contact in the part's frame [m]."""
    complexity: Float[np.ndarray, " g"]
    """Deviation from a straight grasp in the middle; simple grasps are preferred [-]."""
    line: Int[np.ndarray, " g"]
    reason: str
    """Why there are none; "" if there are."""

    def and_also(self, others: PartGrasps) -> PartGrasps:
        """Return these grasps and others, on lines of their own."""
        if not len(others.code):
            return self

        def both(name: str) -> np.ndarray:
            return np.concatenate([getattr(self, name), getattr(others, name)])

        line = np.append(self.line, others.line + self.line.max(initial=-1) + 1)
        return PartGrasps(
            both("Ts_part_tool"), both("code"), both("width"), both("capacity"), both("point"),
            both("complexity"), line, "",
        )  # fmt: skip

    def only(self, rows: Bool[np.ndarray, " g"]) -> PartGrasps:
        """Return a subset of the grasps."""
        return PartGrasps(
            self.Ts_part_tool[rows], self.code[rows], self.width[rows], self.capacity[rows],
            self.point[rows], self.complexity[rows], self.line[rows], self.reason,
        )  # fmt: skip


def grasp_frames(
    robot: Robot, center: np.ndarray, approach: np.ndarray, closing: np.ndarray
) -> Float[np.ndarray, "g 4 4"]:
    """Build tool poses from origins, approach directions and closing directions.

    Args:
        robot: Gives the axes of its tool.
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


@dataclass(frozen=True, eq=False)
class ApproachLines:
    """Straight approach lines of the tool to a handle."""

    R: Float[np.ndarray, "g 3 3"]
    target: Float[np.ndarray, "g 3"]
    """Point on the handle's center line [m]."""
    complexity: Float[np.ndarray, " g"]


def approach_lines(robot: Robot, handle: Handle, config: GraspConfig) -> ApproachLines:
    """Combine turns about the handle, tilts and points along it, and rolls about the approach."""
    side = np.cross(handle.long, handle.out)
    if handle.knob:
        rolls = np.arange(ROLLS) * 2 * np.pi / ROLLS
    else:
        rolls = np.array([0, np.pi])
        if 2 * handle.half_length < robot.opening:
            rolls = np.array([0, np.pi, np.pi / 2, -np.pi / 2])
    free = handle.kind in (HandleKind.LEVER, HandleKind.KNOB)
    tilts = np.radians(sorted({*config.tilts, *(FREE_TILTS if free else ())}, key=abs))
    steep = {t for t, near in STEEP_TURNS.items() if near <= {*config.turns}}
    between = sorted(steep - {*config.turns}) if robot.fully_open is not None else ()
    turns = np.radians((*config.turns, *between))
    grid = np.stack(np.meshgrid(rolls, _points(handle), tilts, turns, indexing="ij"), -1)
    roll, point, tilt, turn = grid.reshape(-1, 4).T
    R_turn = rotation_about(handle.long, turn)
    approach = R_turn @ -handle.out
    closing = R_turn @ side
    approach = np.einsum("gij,gj->gi", rotation_of(closing * tilt[:, None]), approach)
    closing = np.einsum("gij,gj->gi", rotation_of(approach * roll[:, None]), closing)
    complexity = np.abs(turn) + np.abs(tilt) + 5 * np.abs(point)
    if not handle.knob:
        complexity = complexity + 0.5 * np.abs(np.sin(roll))
    target = handle.grip + point[:, None] * handle.long
    R = grasp_frames(robot, target, approach, closing)[:, :3, :3]
    return ApproachLines(R, target, complexity)


def _points(handle: Handle) -> Float[np.ndarray, " p"]:
    usable = max(handle.half_length - 0.015, 0.0)
    if usable < 0.02:
        return np.zeros(1)
    return np.array(HANDLE_POINTS) * usable


@owner_cache()
def grasps_of(
    robot: Robot, model: Articulated, joint: str, sign: float, handle: Handle, config: GraspConfig
) -> PartGrasps:
    """Generate the grasps of a handle.

    The hand moves along a straight line until its pads are at the handle or it is blocked; then the
    fingers close. A grasp is valid if only the pads touch, only the handle, over a minimum area
    and within the friction cone.

    Args:
        robot: The robot.
        model, joint: The part.
        sign: Opening direction of the joint (+1 or -1).
        handle: The handle.
        config: The grasps to try.
    """
    hand = hand_of(robot)
    if reason := empty_handed(robot):
        return _none(reason)
    if closes_fingers(robot):
        return _closed(robot, hand, model, joint, sign, handle, config)
    return _touching(robot, hand, model, joint, sign, handle, config)


@owner_cache()
def push_grasps(
    robot: Robot, model: Articulated, joint: str, sign: float, face: Handle, config: GraspConfig
) -> PartGrasps:
    """Generate pushes with the fingertips on a face of a part, against its opening direction."""
    found = _touching(robot, hand_of(robot), model, joint, sign, face, config)
    push = np.full(len(found.code), FAMILIES.index(Family.PUSH))
    firm = np.full(len(found.code), np.inf)
    return PartGrasps(
        found.Ts_part_tool, push, found.width, firm, found.point, found.complexity, found.line,
        found.reason,
    )  # fmt: skip


def grasps_at(
    robot: Robot,
    model: Articulated,
    joint: str,
    sign: float,
    handle: Handle,
    Ts_part_tool: Float[np.ndarray, "g 4 4"],
    config: GraspConfig,
) -> PartGrasps:
    """Close the fingers on a handle at given tool poses; see `grasps_of` for the arguments."""
    hand = hand_of(robot)
    carried = handle.carrier == model.joint(joint).child
    if not len(Ts_part_tool) or not carried or not closes_fingers(robot):
        return _none(f"no grasp of your own holds {handle.name}" if len(Ts_part_tool) else "")
    return _closed(robot, hand, model, joint, sign, handle, config, Ts_part_tool)


def _closed(
    robot: Robot,
    hand: HandBoxes,
    model: Articulated,
    joint: str,
    sign: float,
    handle: Handle,
    config: GraspConfig,
    at: Float[np.ndarray, "g 4 4"] | None = None,
) -> PartGrasps:
    """Generate grasps with fingers that close: at tool poses, or else along approach lines."""
    elements, held = elements_near_handle(model, joint, handle)
    what = handle.name if handle.found is not HandleSource.EDGE else f"the edge of {handle.name}"
    if at is None:
        lines = approach_lines(robot, handle, config)
        R, p, complexity, line, obstacle = _grasp_depths(hand, elements, lines, handle, config)
    else:
        R, p = np.ascontiguousarray(at[:, :3, :3]), np.ascontiguousarray(at[:, :3, 3])
        complexity, line, obstacle = np.zeros(len(at)), np.arange(len(at)), -1
    if not len(R):
        name = elements[obstacle].link if obstacle >= 0 else handle.name
        no_room = f"the hand does not fit at {what}: {name} is in the way"
        return _none(_too_thick(robot, handle, what) or no_room)
    p, travel, met = close_hands(hand, elements, held, R, p, config)
    rows = np.flatnonzero(met)
    if not len(rows):
        return _none(_too_thick(robot, handle, what) or cannot_close(robot, hand, what))
    rows = rows[stands_clear(hand, elements, held, R[rows], p[rows], config)]
    if not len(rows):
        return _none(_too_thick(robot, handle, what) or f"the open hand does not fit at {what}")
    own = tuple(e for e, mine in zip(elements, held, strict=True) if mine)
    contact = contact_of(hand, own, R[rows], p[rows], travel[rows], config.friction)
    kept = contact.is_firm(hand, config)
    if not kept.any():
        return _none(f"the pads touch too little of {what}: {contact.flaw(hand, config)}")
    rows, point = rows[kept], contact.point[kept]
    pulls = motion_directions(CarriedPart(model, joint, handle.carrier), sign, point)
    leans = np.abs(np.einsum("gi,vgi->vg", R[rows] @ hand.closing, pulls))
    lean = leans[0]
    capacity = pinch_capacity(robot.grip_force, config.friction, leans).min(0)
    code = np.where(lean > HOOK_SHARE, FAMILIES.index(Family.HOOK), FAMILIES.index(Family.PINCH))
    width = robot.opening - travel[rows].sum(1)
    return PartGrasps(
        poses_of(R[rows], p[rows]), code, width, capacity, point, complexity[rows], line[rows], ""
    )


def elements_near_handle(
    model: Articulated, joint: str, handle: Handle
) -> tuple[tuple[Element, ...], Bool[np.ndarray, " e"]]:
    """Return the elements near a handle, and which of them the pads may touch."""
    part = CarriedPart(model, joint, handle.carrier)
    own, whole = {id(e) for e in handle.elements}, part_elements(part)
    if handle.in_pieces:
        around = part_pieces(part)
    else:
        hulls = {id(e) for e in whole}
        cut = {(e.link, e.index) for e in handle.elements if id(e) not in hulls}
        around = tuple(
            piece
            for e in whole
            for piece in (in_pieces(part, [e]) if (e.link, e.index) in cut else [e])
        )
    near = near_elements(around, handle.center, HAND_REACH + handle.half_length)
    extra = tuple(e for e in handle.elements if not any(e is other for other in near))
    elements = (*near, *extra)
    return elements, np.array([id(e) in own for e in elements], bool)


def _grasp_depths(
    hand: HandBoxes,
    elements: tuple[Element, ...],
    lines: ApproachLines,
    handle: Handle,
    config: GraspConfig,
) -> tuple[
    Float[np.ndarray, "g 3 3"],
    Float[np.ndarray, "g 3"],
    Float[np.ndarray, " g"],
    Int[np.ndarray, " g"],
    int,
]:
    """Build tool poses with the pads at the handle, at the deepest reachable depth and others.

    Returns:
        Rotations, origins, complexity and line of each, and the obstacle of most blocked lines.
    """
    origin = lines.target - hand.pad_middle * (lines.R @ hand.approach)
    reached = advance(hand, elements, lines.R, origin, config)
    deepest = np.minimum(reached.travel, 0.0)
    # The shallowest grasp has the tips slightly beyond the near side of the handle.
    along = np.abs(np.einsum("gij,j->gi", lines.R, hand.approach) @ handle.out)
    reach = np.minimum(handle.depth, 0.02) / 2 * along
    shallow = hand.pad_middle - hand.tip + MIN_OVERLAP - reach
    fits = deepest >= shallow
    blocked = reached.obstacle[~fits & (reached.obstacle >= 0)]
    worst = int(np.bincount(blocked).argmax()) if len(blocked) else -1
    # With the tool's origin in a bar, the hand can turn about the bar during the motion.
    at_origin = np.full(len(deepest), min(hand.pad_middle, 0.0))
    turns = (at_origin <= deepest) & (at_origin >= shallow)
    R, p, complexity, line = [], [], [], []
    for share in (*STANDOFFS, None):
        if share is None:
            travel, rows = at_origin, fits & turns
        else:
            travel = deepest + share * (shallow - deepest)
            rows = fits & ~(turns & (np.abs(travel - at_origin) < MIN_OVERLAP))
            rows &= (share == STANDOFFS[0]) | (deepest - travel > MIN_OVERLAP / 2)
        R.append(lines.R[rows])
        line.append(np.flatnonzero(rows) + (len(rows) if share is None else 0))
        p.append(origin[rows] + travel[rows, None] * (lines.R[rows] @ hand.approach))
        complexity.append(lines.complexity[rows] + 10 * (-travel[rows]).clip(0))
    return (
        np.concatenate(R), np.concatenate(p), np.concatenate(complexity), np.concatenate(line),
        worst,
    )  # fmt: skip


def _touching(
    robot: Robot,
    hand: HandBoxes,
    model: Articulated,
    joint: str,
    sign: float,
    handle: Handle,
    config: GraspConfig,
) -> PartGrasps:
    """Generate grasps that touch without closing: suction cup, hook, pushing fingertips."""
    if robot.grips is Grip.SUCTION and handle.kind is HandleKind.EDGE:
        handle = front_face(CarriedPart(model, joint, handle.carrier), sign) or handle
    elements, held = elements_near_handle(model, joint, handle)
    lines = approach_lines(robot, handle, config)
    hooks = robot.grips is not Grip.SUCTION and handle.kind is not HandleKind.FACE
    if hooks:
        elements = tuple(e for e, own in zip(elements, held, strict=True) if not own)
        origin = lines.target
    else:
        origin = lines.target - hand.tip * (lines.R @ hand.approach)
    reached = advance(hand, elements, lines.R, origin, config).travel
    if not hooks:  # outside the friction cone the tool would slide along the front
        steep = lines.R @ hand.approach @ -handle.out < np.cos(np.arctan(config.friction))
        reached[steep] = -np.inf
    travel = np.minimum(reached, 0.0) if hooks else reached + config.hand_clearance
    rows = np.flatnonzero(np.abs(travel) < hand.tip if hooks else np.abs(travel) < MIN_OVERLAP)
    if not len(rows):
        return _none(f"the tool does not fit at {handle.name}")
    p = origin[rows] + travel[rows, None] * (lines.R[rows] @ hand.approach)
    code = FAMILIES.index(Family.HOOK if hooks else Family.SUCTION)
    count = len(rows)
    return PartGrasps(
        poses_of(lines.R[rows], p), np.full(count, code), np.full(count, robot.opening),
        np.full(count, robot.grip_force), lines.target[rows], lines.complexity[rows],
        np.arange(count), "",
    )  # fmt: skip


def poses_of(
    R: Float[np.ndarray, "g 3 3"], p: Float[np.ndarray, "g 3"]
) -> Float[np.ndarray, "g 4 4"]:
    """Build poses from rotations and positions."""
    T = np.tile(np.eye(4), (len(R), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = R, p
    return T


def _none(reason: str) -> PartGrasps:
    none = np.zeros(0)
    return PartGrasps(
        np.zeros((0, 4, 4)), np.zeros(0, np.int64), none, none, np.zeros((0, 3)), none,
        np.zeros(0, np.int64), reason,
    )  # fmt: skip


def cannot_close(robot: Robot, hand: HandBoxes, what: str) -> str:
    """Return the reason why no pads meet something, with the derived values that decide."""
    return (
        f"the fingers cannot close on {what}: from tool.opening {100 * robot.opening:.1f} cm each "
        f"pad of {robot.name} moves {1000 * hand.travel:.0f} mm, and no two pads meet it before "
        "another part of the hand does"
    )


def _too_thick(robot: Robot, handle: Handle, what: str) -> str:
    """Return a reason if the gripper cannot span a handle, else ""."""
    least = handle.thickness
    if not handle.edge:
        least = min(least, float(np.ptp(corners(handle.elements) @ handle.out)))
    if least < robot.opening:
        return ""
    return (
        f"{what} is {100 * (least - robot.opening):.1f} cm too thick for the gripper of "
        f"{robot.name} ({100 * least:.1f} cm, opens {100 * robot.opening:.1f} cm by tool.opening)"
    )
