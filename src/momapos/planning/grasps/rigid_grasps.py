"""How hands hold a whole object: the fingers closed on its own shape, and what they then carry."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import invert
from momapos.model.robots import Grip, Robot
from momapos.model.scene import SceneObject
from momapos.model.urdf import Articulated

from .config import GraspConfig
from .grasp_families import Chosen, Grasps, firmest_first
from .hand_boxes import Hand, empty_handed, hand_of
from .handle_shapes import Element, corners
from .part_grasps import BITE, FAMILIES, Family, grasp_frames, poses_of
from .pinch_grasps import OWN, advance, close, contact_of, lifting_capacity, stands_clear
from .resistance import GRAVITY, mass_of
from .swept_boxes import convex_of

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

PITCHES = (90.0, 75.0, 60.0, 45.0, 30.0, 15.0, 0.0)
"""How steeply hands come down [deg]."""
RIM = 0.015
"""The middle of the pads stays this far inside the ends of what they hold [m]."""
CONTACT = 0.25
"""Grasps whose pads touch a smaller share of what they could touch elsewhere are left out [-]."""
_OBJECTS = 512
"""Objects whose grasps are remembered [-]."""
_DIGITS = 9
DOWN = np.array([[0.0, 0.0, -1.0]])
EVERY_WAY = np.array(
    [[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if x or y or z], float
)
"""Where down may be, seen from an object that a hand carries about."""
EVERY_WAY /= np.linalg.norm(EVERY_WAY, axis=1, keepdims=True)


@dataclass(frozen=True)
class _Lines:
    """Straight ways of the tool onto an object, in its upright frame."""

    R: Float[np.ndarray, "g 3 3"]
    target: Float[np.ndarray, "g 3"]
    """Where the middle of the pads should be [m]."""
    near: Float[np.ndarray, " g"]
    """How far the object reaches from there toward the hand [m]."""
    width: Float[np.ndarray, " g"]
    """Its width along the closing axis [m]."""
    plainness: Float[np.ndarray, " g"]


def holding_object(
    robot: Robot,
    item: SceneObject,
    T_world_upright: Float[np.ndarray, "4 4"],
    config: GraspConfig,
    *,
    carried: bool,
) -> Chosen:
    """The grasps by which a hand lifts a whole object, in a frame of it with z up.

    Args:
        robot: Whose hand.
        item: A rigid object.
        T_world_upright: That frame.
        config: What is tried.
        carried: Whether the hand takes it along in any attitude, and does not just lift it.

    Returns:
        Where none holds, all that were looked at, and why they do not.
    """
    T = invert(T_world_upright) @ item.T_world_object
    return _holding(
        robot, item.model, tuple(np.round(T, _DIGITS).ravel().tolist()), config, carried
    )


@lru_cache(maxsize=_OBJECTS)
def _holding(
    robot: Robot, model: Articulated, T: tuple[float, ...], config: GraspConfig, carried: bool
) -> Chosen:
    """The same for a pose of the object's root in its upright frame."""
    poses = model.rest_poses
    T_upright_root = np.reshape(T, (4, 4))
    elements = tuple(
        Element(link, hull.name or link, convex_of(hull, T_upright_root @ poses[link]), index)
        for link in model.links
        for index, hull in enumerate(model.hulls[link])
    )
    mass, center = mass_of(model, config.resistance)
    center = T_upright_root[:3, :3] @ center + T_upright_root[:3, 3]
    lines = _lines(robot, elements, center, config)
    need = (1.0 + config.swing) * GRAVITY * mass
    hand = hand_of(robot)
    if robot.grips is Grip.SUCTION:
        return _sucked(robot, hand, elements, lines, need, config)
    if robot.grips is not Grip.FINGERS or not hand.closes:
        why = empty_handed(robot) or f"{robot.name} has no fingers that close on an object"
        return _none(lines, need, why)
    if _too_wide(robot, lines, config):
        # The fingers pass by it as near as they stand to it at any grasp, see `stands_clear`.
        config = replace(config, hand_clearance=config.hand_clearance * OWN)
    return _pinched(robot, hand, elements, lines, center, need, config, carried=carried)


def _lines(
    robot: Robot,
    elements: tuple[Element, ...],
    center: Float[np.ndarray, "3"],
    config: GraspConfig,
) -> _Lines:
    """From above, the sides and all slants between; level closing; at and beside the center."""
    yaws = np.arange(config.rolls) * 2 * np.pi / config.rolls
    pitch, yaw, swap = (
        values.ravel()
        for values in np.meshgrid(np.radians(PITCHES), yaws, (1.0, -1.0), indexing="ij")
    )
    once = (pitch < pitch.max()) | (swap > 0)  # from above the other half of the turns swaps them
    pitch, yaw, swap = pitch[once], yaw[once], swap[once]
    none = np.zeros(len(yaw))
    ahead = np.column_stack([np.cos(yaw), np.sin(yaw), none])
    closing = swap[:, None] * np.column_stack([-np.sin(yaw), np.cos(yaw), none])
    approach = np.cos(pitch)[:, None] * ahead - np.sin(pitch)[:, None] * [0.0, 0.0, 1.0]
    across = np.cross(approach, closing)

    points = corners(elements) - center
    beside = points @ across.T
    usable = np.stack([-beside.min(0), beside.max(0)]) - RIM
    shares = np.array(config.points)
    off = shares[:, None] * np.where(shares[:, None] > 0, usable[1], usable[0]).clip(0)
    row = np.tile(np.arange(len(yaw)), len(shares))
    kept = (shares == 0).repeat(len(yaw)) | (np.abs(off.ravel()) > RIM)
    row, off = row[kept], off.ravel()[kept]
    target = center + off[:, None] * across[row]
    near = -(points @ approach.T).min(0)
    width = np.ptp(points @ closing.T, axis=0)
    plainness = 5 * np.abs(off) + np.minimum(pitch, np.pi / 2 - pitch)[row]
    R = grasp_frames(robot, target, approach[row], closing[row])[:, :3, :3]
    return _Lines(R, target, near[row], width[row], plainness)


def _pinched(
    robot: Robot,
    hand: Hand,
    elements: tuple[Element, ...],
    lines: _Lines,
    center: Float[np.ndarray, "3"],
    need: float,
    config: GraspConfig,
    *,
    carried: bool,
) -> Chosen:
    """Grasps of two fingers that touch nothing but with their pads, and carry the weight."""
    held = np.ones(len(elements), bool)
    wide = _too_wide(robot, lines, config)
    R, p, row = _depths(hand, elements, lines, config)
    closing = close(hand, elements, held, R, p, config.hand_clearance)
    met = np.isfinite(closing.travel).all(1)
    way = np.where(met[:, None], closing.travel, 0.0)
    shift, travel = hand.meeting(way, config.hand_clearance)
    p = p - shift[:, None] * (R @ hand.closing)
    met &= (travel > 0).any(1) & (travel.sum(1) < 2 * hand.travel)
    met &= (closing.cosine >= np.cos(np.arctan(config.friction))).all(1)
    if not met.any():
        return _none(lines, need, wide or f"the fingers of {robot.name} cannot close on it")
    R, p, row, travel = R[met], p[met], row[met], travel[met]
    clear = stands_clear(hand, elements, held, R, p, config)
    if not clear.any():
        return _none(lines, need, wide or f"the open hand of {robot.name} has no room at it")
    R, p, row, travel = R[clear], p[clear], row[clear], travel[clear]
    contact = contact_of(hand, elements, R, p, travel, config.friction)
    pads = np.diff(hand.inner(1)[1], axis=0)[0]
    firm = (contact.area >= 1e-4 * config.pad_contact) & (contact.apart < pads.min())
    if not firm.any():
        return _none(lines, need, f"the pads of {robot.name} touch too little of it")
    firm &= contact.area >= CONTACT * contact.area[firm].max()
    width = robot.opening - travel.sum(1)
    capacity = lifting_capacity(
        robot.grip_force, config.friction, contact, R @ hand.closing, width, center,
        EVERY_WAY if carried else DOWN,
    )  # fmt: skip
    strong = firm & (capacity >= config.grasp_margin * need)
    if not strong.any():
        return _none(
            lines, need, f"{robot.name} holds {capacity[firm].max():.1f} N of it at most, and "
            f"{config.grasp_margin * need:.1f} N are needed",
        )  # fmt: skip
    code = np.full(len(R), FAMILIES.index(Family.PINCH))
    plain = lines.plainness[row] + 10 * np.linalg.norm(contact.point - center, axis=1)
    return _ordered(poses_of(R, p), code, width, capacity, row, plain, need, strong)


def _too_wide(robot: Robot, lines: _Lines, config: GraspConfig) -> str:
    """That no closing axis leaves room beside an object; "" where one does."""
    least, beside = float(lines.width.min()), config.hand_clearance
    if least + 2 * beside <= robot.opening:
        return ""
    return (
        f"it is {100 * least:.1f} cm wide, and the gripper of {robot.name} opens "
        f"{100 * robot.opening:.1f} cm and needs {100 * beside:.1f} cm beside each finger"
    )


def _depths(
    hand: Hand, elements: tuple[Element, ...], lines: _Lines, config: GraspConfig
) -> tuple[Float[np.ndarray, "g 3 3"], Float[np.ndarray, "g 3"], Int[np.ndarray, " g"]]:
    """Tool poses on lines: the pads at the target or as deep as there is room, and less deep.

    Returns:
        Rotations, origins, and the line of each; of one line the deepest first.
    """
    approach = lines.R @ hand.approach
    origin = lines.target - hand.pad_middle * approach
    room = advance(hand, elements, lines.R, origin, config)
    deepest = np.minimum(room.travel, 0.0)
    shallow = np.minimum(hand.pad_middle - hand.tip + BITE - lines.near, deepest)
    shares = np.array(config.standoffs)
    travel = deepest + shares[:, None] * (shallow - deepest)
    different = (shares[:, None] == shares[0]) | (deepest - travel > BITE)
    share, row = np.nonzero(different & (deepest > -np.inf))
    p = origin[row] + travel[share, row][:, None] * approach[row]
    return lines.R[row], p, row


def _sucked(
    robot: Robot,
    hand: Hand,
    elements: tuple[Element, ...],
    lines: _Lines,
    need: float,
    config: GraspConfig,
) -> Chosen:
    """Poses of a cup on the faces that it meets straight on."""
    approach = lines.R @ hand.approach
    p = lines.target - (hand.tip + lines.near)[:, None] * approach
    room = advance(hand, elements, lines.R, p, config)
    way = room.travel + config.hand_clearance
    met = np.flatnonzero((room.obstacle >= 0) & (np.abs(way) < BITE))
    p = p[met] + way[met, None] * approach[met]
    square = np.zeros(len(met))
    for index, element in enumerate(elements):
        rows = room.obstacle[met] == index
        inside = p[rows] + (hand.tip + BITE) * approach[met][rows]
        depth, cosine = element.convex.surface(inside[:, None], -approach[met][rows])
        square[rows] = np.where(depth[:, 0] > 0, cosine[:, 0], 0.0)
    flat = square >= np.cos(np.arctan(config.friction))
    strong = flat & (robot.grip_force >= config.grasp_margin * need)
    if not strong.any():
        weak = f"holds {robot.grip_force:.1f} N, and {config.grasp_margin * need:.1f} N are needed"
        return _none(lines, need, f"{robot.name} {weak if flat.any() else 'meets no face of it'}")
    code = np.full(len(met), FAMILIES.index(Family.SUCTION))
    wide, firm = np.full(len(met), robot.opening), np.full(len(met), robot.grip_force)
    return _ordered(
        poses_of(lines.R[met], p), code, wide, firm, met, lines.plainness[met], need, strong
    )


def _ordered(
    Ts: Float[np.ndarray, "g 4 4"],
    code: Int[np.ndarray, " g"],
    width: Float[np.ndarray, " g"],
    capacity: Float[np.ndarray, " g"],
    line: Int[np.ndarray, " g"],
    plain: Float[np.ndarray, " g"],
    need: float,
    strong: Bool[np.ndarray, " g"],
) -> Chosen:
    """Those that are strong, the firmest first, and of those the plainest."""
    every, none = np.full(len(capacity), need), np.zeros(len(capacity), np.int64)
    order = firmest_first(capacity, every, plain, none)
    order = order[strong[order]]
    grasps = Grasps(code, width, capacity, every, (), none, line).take(order)
    return Chosen(np.ascontiguousarray(Ts[order]), grasps, "", "")


def _none(lines: _Lines, need: float, reason: str) -> Chosen:
    """The lines themselves, and why no grasp along them holds."""
    count = len(lines.R)
    none, unknown = np.zeros(count, np.int64), np.full(count, np.nan)
    grasps = Grasps(
        none, unknown, np.zeros(count), np.full(count, need), (), none, np.arange(count)
    )
    return Chosen(poses_of(lines.R, lines.target), grasps, reason, "")
