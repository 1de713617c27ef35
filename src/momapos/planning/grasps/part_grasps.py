"""Generate the grasps of a part by one hand, independent of the part's weight and pose."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import owner_cache
from momapos.core.geometry import rotation_about, rotation_of
from momapos.model.robots import Grip, Robot
from momapos.model.urdf import Articulated

from .config import HANDLE_POINTS, ROLLS, STANDOFFS, GraspConfig
from .fronts import front_face, front_part
from .hand_boxes import Hand, empty_handed, hand_of
from .handle_core import HandleKind
from .handle_records import Handle, HandleSource
from .handle_shapes import (
    CarriedPart,
    Element,
    corners,
    in_pieces,
    part_elements,
    part_pieces,
)
from .part_motion import motion_directions
from .pinch_grasps import (
    advance,
    close_hands,
    contact_of,
    near_elements,
    pinch_capacity,
    stands_clear,
)  # fmt: skip

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

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


class Family(StrEnum):
    """The grasp families; plans contain the words."""

    PINCH = "pinch"
    """Pads on both sides; friction transmits the pull."""
    HOOK = "hook"
    """A finger behind a bar, a lip or an edge transmits the pull."""
    PUSH = "push"
    """Fingertips against a front, for closing only."""
    SUCTION = "suction"
    """A suction cup on a front."""


FAMILIES: tuple[Family, ...] = tuple(Family)


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
    if robot.grips is Grip.FINGERS and hand.closes:
        return _closed(robot, hand, model, joint, sign, handle, config)
    return _touching(robot, hand, model, joint, sign, handle, config)


@owner_cache()
def push_grasps(
    robot: Robot, model: Articulated, joint: str, sign: float, config: GraspConfig
) -> tuple[Handle, PartGrasps] | None:
    """Generate pushes that close a part with the fingertips; None if it has no front."""
    face = front_face(front_part(model, joint, sign), sign)
    if face is None:
        return None
    found = _touching(robot, hand_of(robot), model, joint, sign, face, config)
    push = np.full(len(found.code), FAMILIES.index(Family.PUSH))
    firm = np.full(len(found.code), np.inf)
    return face, PartGrasps(
        found.Ts_part_tool, push, found.width, firm, found.point, found.complexity, found.line,
        found.reason,
    )  # fmt: skip


def _closed(
    robot: Robot,
    hand: Hand,
    model: Articulated,
    joint: str,
    sign: float,
    handle: Handle,
    config: GraspConfig,
) -> PartGrasps:
    """Generate grasps with fingers that close."""
    elements, held = elements_near_handle(model, joint, handle)
    lines = approach_lines(robot, handle, config)
    what = handle.name if handle.found is not HandleSource.EDGE else f"the edge of {handle.name}"
    R, p, complexity, line, obstacle = _grasp_depths(hand, elements, lines, handle, config)
    if not len(R):
        name = elements[obstacle].link if obstacle >= 0 else handle.name
        no_room = f"the hand does not fit at {what}: {name} is in the way"
        return _none(_too_thick(robot, handle, what) or no_room)
    p, travel, met = close_hands(hand, elements, held, R, p, config)
    rows = np.flatnonzero(met)
    if not len(rows):
        return _none(_too_thick(robot, handle, what) or f"the fingers cannot close on {what}")
    rows = rows[stands_clear(hand, elements, held, R[rows], p[rows], config)]
    if not len(rows):
        return _none(_too_thick(robot, handle, what) or f"the open hand does not fit at {what}")
    own = tuple(e for e, mine in zip(elements, held, strict=True) if mine)
    contact = contact_of(hand, own, R[rows], p[rows], travel[rows], config.friction)
    kept = contact.is_firm(hand, config)
    if not kept.any():
        return _none(f"the pads touch too little of {what}")
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
    hand: Hand,
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
    hand: Hand,
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


def _too_thick(robot: Robot, handle: Handle, what: str) -> str:
    """Return a reason if the gripper cannot span a handle, else ""."""
    least = handle.thickness
    if not handle.edge:
        least = min(least, float(np.ptp(corners(handle.elements) @ handle.out)))
    if least < robot.opening:
        return ""
    return (
        f"{what} is {100 * (least - robot.opening):.1f} cm too thick for the gripper of "
        f"{robot.name} ({100 * least:.1f} cm, opens {100 * robot.opening:.1f} cm)"
    )
