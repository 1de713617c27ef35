"""The grasps of a part by one hand, whatever the part weighs and where it stands."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import rotation_about, rotation_of
from momapos.model.robots import Grip, Robot
from momapos.model.urdf import Articulated

from .config import GraspConfig
from .hand_boxes import Hand, empty_handed, hand_of
from .handle_core import HandleKind
from .handle_shapes import Element, corners, part_elements, part_pieces
from .handles import Handle, HandleSource, front_face, motion_direction
from .pinch_grasps import advance, close, contact_of, near_elements, pinch_capacity, stands_clear

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

HAND_REACH = 0.35
"""What is farther from a handle cannot meet the hand [m]."""
BITE = 0.003
"""Fingertips reach at least this far beyond the near side of what they hold [m]."""
HOOKED = 0.8
"""A grasp hooks where at least this share of the pull is along the closing axis [-]."""
_PARTS = 512
"""Parts whose grasps are remembered [-]."""


class Family(StrEnum):
    """How a grasp holds; the words stand in answers."""

    PINCH = "pinch"
    """Pads on both sides, friction carries the pull."""
    HOOK = "hook"
    """A finger behind a bar, a lip or an edge carries the pull."""
    PUSH = "push"
    """The fingertips against a front, for closing alone."""
    SUCTION = "suction"
    """A cup on a front."""


FAMILIES: tuple[Family, ...] = tuple(Family)


@dataclass(frozen=True)
class PartGrasps:
    """The grasps of one handle by one robot, whatever the part weighs and where it stands."""

    Ts_part_tool: Float[np.ndarray, "g 4 4"]
    code: Int[np.ndarray, " g"]
    """Index into `FAMILIES`."""
    width: Float[np.ndarray, " g"]
    capacity: Float[np.ndarray, " g"]
    point: Float[np.ndarray, "g 3"]
    """Middle of the contact in the part [m]."""
    plainness: Float[np.ndarray, " g"]
    """The less, the plainer [-]."""
    line: Int[np.ndarray, " g"]
    """Grasps with the same number differ by their depth alone."""
    reason: str
    """Why there is none; "" where there is one."""

    def only(self, rows: Bool[np.ndarray, " g"]) -> PartGrasps:
        """Some of the grasps."""
        return PartGrasps(
            self.Ts_part_tool[rows], self.code[rows], self.width[rows], self.capacity[rows],
            self.point[rows], self.plainness[rows], self.line[rows], self.reason,
        )  # fmt: skip


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


@dataclass(frozen=True)
class Lines:
    """Straight ways of the tool onto a handle."""

    R: Float[np.ndarray, "g 3 3"]
    target: Float[np.ndarray, "g 3"]
    """Point on the handle's middle line [m]."""
    plainness: Float[np.ndarray, " g"]


def lines_onto(robot: Robot, handle: Handle, config: GraspConfig) -> Lines:
    """Turns about the handle, tilts along it, rolls about the approach, points along it."""
    side = np.cross(handle.long, handle.out)
    if handle.knob:
        rolls = np.arange(config.rolls) * 2 * np.pi / config.rolls
    else:
        rolls = np.array([0, np.pi])
        if 2 * handle.half_length < robot.opening:
            rolls = np.array([0, np.pi, np.pi / 2, -np.pi / 2])
    turns, tilts = np.radians(config.turns), np.radians(config.tilts)
    grid = np.stack(np.meshgrid(rolls, _points(handle, config), tilts, turns, indexing="ij"), -1)
    roll, point, tilt, turn = grid.reshape(-1, 4).T
    R_turn = rotation_about(handle.long, turn)
    approach = R_turn @ -handle.out
    closing = R_turn @ side
    approach = np.einsum("gij,gj->gi", _rotations(closing, tilt), approach)
    closing = np.einsum("gij,gj->gi", _rotations(approach, roll), closing)
    plainness = np.abs(turn) + np.abs(tilt) + 5 * np.abs(point)
    if not handle.knob:
        plainness = plainness + 0.5 * np.abs(np.sin(roll))
    target = handle.grip + point[:, None] * handle.long
    R = grasp_frames(robot, target, approach, closing)[:, :3, :3]
    return Lines(R, target, plainness)


def _points(handle: Handle, config: GraspConfig) -> Float[np.ndarray, " p"]:
    usable = max(handle.half_length - 0.015, 0.0)
    if usable < 0.02:
        return np.zeros(1)
    return np.array(config.points) * usable


def _rotations(
    axes: Float[np.ndarray, "g 3"], angles: Float[np.ndarray, " g"]
) -> Float[np.ndarray, "g 3 3"]:
    return rotation_of(axes * angles[:, None])


@lru_cache(maxsize=_PARTS)
def grasps_of(
    robot: Robot, model: Articulated, joint: str, sign: float, handle: Handle, config: GraspConfig
) -> PartGrasps:
    """The grasps of a handle.

    The hand comes along a straight line until its pads are at the handle or something is in its
    way; then the fingers close. A grasp is kept where only the pads touch, only the handle, over
    enough of it, within the friction cone.

    Args:
        robot: Whose hand.
        model, joint: The part.
        sign: Direction of the joint in which it opens (+1 or -1).
        handle: What to hold.
        config: What is tried.
    """
    hand = hand_of(robot)
    if empty_handed(robot):
        return _none(empty_handed(robot))
    if robot.grips is Grip.FINGERS and hand.closes:
        return _closed(robot, hand, model, joint, sign, handle, config)
    return _touching(robot, hand, model, joint, sign, handle, config)


@lru_cache(maxsize=_PARTS)
def push_grasps(
    robot: Robot, model: Articulated, joint: str, sign: float, config: GraspConfig
) -> tuple[Handle, PartGrasps] | None:
    """Ways to push a part shut with the fingertips against its front; None where it has none."""
    face = front_face(model, joint, sign)
    if face is None:
        return None
    found = _touching(robot, hand_of(robot), model, joint, sign, face, config)
    push = np.full(len(found.code), FAMILIES.index(Family.PUSH))
    firm = np.full(len(found.code), np.inf)
    return face, PartGrasps(
        found.Ts_part_tool, push, found.width, firm, found.point, found.plainness, found.line,
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
    """Grasps with fingers that close."""
    elements, held = surroundings(model, joint, handle)
    lines = lines_onto(robot, handle, config)
    what = handle.name if handle.found is not HandleSource.EDGE else f"the edge of {handle.name}"
    R, p, plain, line, obstacle = _deep_enough(hand, elements, lines, handle, config)
    if not len(R):
        name = elements[obstacle].link if obstacle >= 0 else handle.name
        no_room = f"the hand has no room at {what}: {name} is in its way"
        return _none(_too_thick(robot, handle, what) or no_room)
    closing = close(hand, elements, held, R, p, config.hand_clearance)
    met = np.isfinite(closing.travel).all(1)
    way = np.where(met[:, None], closing.travel, 0.0)
    shift, travel = hand.meeting(way, config.hand_clearance)
    p = p - shift[:, None] * (R @ hand.closing)
    met &= (travel > 0).any(1) & (travel.sum(1) < 2 * hand.travel)
    firm = (closing.cosine >= np.cos(np.arctan(config.friction))).all(1)
    rows = np.flatnonzero(met & firm)
    if not len(rows):
        return _none(_too_thick(robot, handle, what) or f"the fingers cannot close on {what}")
    rows = rows[stands_clear(hand, elements, held, R[rows], p[rows], config)]
    if not len(rows):
        return _none(_too_thick(robot, handle, what) or f"the open hand has no room at {what}")
    own = tuple(e for e, mine in zip(elements, held, strict=True) if mine)
    contact = contact_of(hand, own, R[rows], p[rows], travel[rows], config.friction)
    pads = np.diff(hand.inner(1)[1], axis=0)[0]
    kept = (contact.area >= 1e-4 * config.pad_contact) & (contact.apart < pads.min())
    if not kept.any():
        return _none(f"the pads touch too little of {what}")
    rows, point = rows[kept], contact.point[kept]
    pull = np.array([motion_direction(model, joint, sign, x) for x in point])
    lean = np.abs(np.einsum("gi,gi->g", R[rows] @ hand.closing, pull))
    capacity = pinch_capacity(robot.grip_force, config.friction, lean)
    code = np.where(lean > HOOKED, FAMILIES.index(Family.HOOK), FAMILIES.index(Family.PINCH))
    width = robot.opening - travel[rows].sum(1)
    return PartGrasps(
        poses_of(R[rows], p[rows]), code, width, capacity, point, plain[rows], line[rows], ""
    )


def surroundings(
    model: Articulated, joint: str, handle: Handle
) -> tuple[tuple[Element, ...], Bool[np.ndarray, " e"]]:
    """The elements near a handle, and which of them the pads may touch."""
    part = part_pieces(model, joint) if handle.in_pieces else part_elements(model, joint)
    near = near_elements(part, handle.center, HAND_REACH + handle.half_length)
    own = {id(e) for e in handle.elements}
    extra = tuple(e for e in handle.elements if not any(e is other for other in near))
    elements = (*near, *extra)
    return elements, np.array([id(e) in own for e in elements], bool)


def _deep_enough(
    hand: Hand,
    elements: tuple[Element, ...],
    lines: Lines,
    handle: Handle,
    config: GraspConfig,
) -> tuple[
    Float[np.ndarray, "g 3 3"],
    Float[np.ndarray, "g 3"],
    Float[np.ndarray, " g"],
    Int[np.ndarray, " g"],
    int,
]:
    """Tool poses where the pads are at the handle, as deep as there is room, and less deep.

    Returns:
        Rotations, origins, plainness, the line of each, and what is in the way of most lines that
        lead nowhere.
    """
    origin = lines.target - hand.pad_middle * (lines.R @ hand.approach)
    room = advance(hand, elements, lines.R, origin, config)
    deepest = np.minimum(room.travel, 0.0)
    # At the least the tips come a little beyond the near side of the handle.
    along = np.abs(np.einsum("gij,j->gi", lines.R, hand.approach) @ handle.out)
    reach = np.minimum(handle.depth, 0.02) / 2 * along
    shallow = hand.pad_middle - hand.tip + BITE - reach
    fits = deepest >= shallow
    blocked = room.obstacle[~fits & (room.obstacle >= 0)]
    worst = int(np.bincount(blocked).argmax()) if len(blocked) else -1
    # Where the tool's origin lies in a bar, the hand can turn about it on its way.
    at_origin = np.full(len(deepest), min(hand.pad_middle, 0.0))
    turns = (at_origin <= deepest) & (at_origin >= shallow)
    R, p, plain, line = [], [], [], []
    for share in (*config.standoffs, None):
        if share is None:
            travel, rows = at_origin, fits & turns
        else:
            travel = deepest + share * (shallow - deepest)
            rows = fits & ~(turns & (np.abs(travel - at_origin) < BITE))
            rows &= (share == config.standoffs[0]) | (deepest - travel > BITE / 2)
        R.append(lines.R[rows])
        line.append(np.flatnonzero(rows) + (len(rows) if share is None else 0))
        p.append(origin[rows] + travel[rows, None] * (lines.R[rows] @ hand.approach))
        plain.append(lines.plainness[rows] + 10 * (-travel[rows]).clip(0))
    return (
        np.concatenate(R), np.concatenate(p), np.concatenate(plain), np.concatenate(line), worst,
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
    """Poses of a hand that touches and does not close: a cup, a hook, fingertips that push."""
    if robot.grips is Grip.SUCTION and handle.kind is HandleKind.EDGE:
        handle = front_face(model, joint, sign) or handle
    elements, held = surroundings(model, joint, handle)
    lines = lines_onto(robot, handle, config)
    hooks = robot.grips is not Grip.SUCTION and handle.kind is not HandleKind.FACE
    if hooks:
        elements = tuple(e for e, own in zip(elements, held, strict=True) if not own)
        origin = lines.target
    else:
        origin = lines.target - hand.tip * (lines.R @ hand.approach)
    room = advance(hand, elements, lines.R, origin, config)
    if not hooks:  # across the front they would slide along it
        steep = lines.R @ hand.approach @ -handle.out < np.cos(np.arctan(config.friction))
        room.travel[steep] = -np.inf
    travel = np.minimum(room.travel, 0.0) if hooks else room.travel + config.hand_clearance
    rows = np.flatnonzero(np.abs(travel) < hand.tip if hooks else np.abs(travel) < BITE)
    if not len(rows):
        return _none(f"the tool has no room at {handle.name}")
    p = origin[rows] + travel[rows, None] * (lines.R[rows] @ hand.approach)
    code = FAMILIES.index(Family.HOOK if hooks else Family.SUCTION)
    count = len(rows)
    return PartGrasps(
        poses_of(lines.R[rows], p), np.full(count, code), np.full(count, robot.opening),
        np.full(count, robot.grip_force), lines.target[rows], lines.plainness[rows],
        np.arange(count), "",
    )  # fmt: skip


def poses_of(
    R: Float[np.ndarray, "g 3 3"], p: Float[np.ndarray, "g 3"]
) -> Float[np.ndarray, "g 4 4"]:
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
    """That no way of closing spans a handle; "" where one does."""
    least = handle.thickness
    if not handle.edge:
        least = min(least, float(np.ptp(corners(handle.elements) @ handle.out)))
    if least < robot.opening:
        return ""
    return (
        f"{what} is {100 * (least - robot.opening):.1f} cm too thick for the gripper of "
        f"{robot.name} ({100 * least:.1f} cm, opens {100 * robot.opening:.1f} cm)"
    )
