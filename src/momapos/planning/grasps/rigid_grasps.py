"""Generate grasps of rigid objects: fingers close on the object's shape and carry its weight."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

from momapos.core import GRAVITY, owner_cache
from momapos.core.geometry import invert
from momapos.model.records import FAMILIES, Family
from momapos.model.robots import Grip, Robot
from momapos.model.scene import SceneObject, object_mass
from momapos.model.urdf import Articulated

from .config import HANDLE_POINTS, ROLLS, STANDOFFS, GraspConfig
from .grasp_families import NO_POSES, Grasps, GraspSelection, firmest_first
from .hand_boxes import HandBoxes, closes_fingers, empty_handed, hand_of
from .handle_shapes import Element, convex_of, corners
from .part_grasps import (
    HELD_CLEARANCE_SHARE,
    MIN_OVERLAP,
    advance,
    cannot_close,
    close_hands,
    contact_of,
    grasp_frames,
    lifting_capacity,
    poses_of,
    stands_clear,
)

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

PITCHES = (90.0, 75.0, 60.0, 45.0, 30.0, 15.0, 0.0)
"""Angles of the approach below the horizontal [deg]."""
PAD_INSET = 0.015
"""Minimum distance of the pads' middle from the ends of the object [m]."""
MIN_CONTACT_SHARE = 0.25
"""Minimum contact area of a grasp, as a share of the largest one [-]."""
_DIGITS = 9
DOWN = np.array([[0.0, 0.0, -1.0]])
ALL_DIRECTIONS = np.array(
    [[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if x or y or z], float
)
"""Possible directions of gravity in the frame of a carried object."""
ALL_DIRECTIONS /= np.linalg.norm(ALL_DIRECTIONS, axis=1, keepdims=True)


@dataclass(frozen=True, eq=False)
class _Lines:
    """Straight approach lines of the tool to an object, in its upright frame."""

    R: Float[np.ndarray, "g 3 3"]
    target: Float[np.ndarray, "g 3"]
    """Target of the middle of the pads [m]."""
    near: Float[np.ndarray, " g"]
    """Extent of the object from there toward the hand [m]."""
    width: Float[np.ndarray, " g"]
    """Width of the object along the closing axis [m]."""
    complexity: Float[np.ndarray, " g"]


def select_object_grasps(
    robot: Robot,
    item: SceneObject,
    T_world_upright: Float[np.ndarray, "4 4"],
    config: GraspConfig,
    *,
    carried: bool,
    own: Float[np.ndarray, "g 4 4"] = NO_POSES,
) -> GraspSelection:
    """Select the grasps by which a hand lifts a rigid object, in a frame of it with z up.

    Args:
        robot: The robot.
        item: A rigid object.
        T_world_upright: That frame.
        config: The grasps to try.
        carried: Whether the hand carries the object in any orientation; else it only lifts it.
        own: Tool poses of the user's own grasps in the object's frame.

    Returns:
        The grasps; if none holds, the approach lines and the reason.
    """
    T = invert(T_world_upright) @ item.T_world_object
    mass, center = object_mass(item, config.resistance)
    weight = (mass, *center.tolist())
    pose = tuple(np.round(T, _DIGITS).ravel().tolist())
    found = _holding(robot, item.model, weight, pose, config, carried)
    if not len(own) or not closes_fingers(robot):
        return found
    also = _held_at(robot, _Body.of(item.model, weight, pose), T @ own, config, carried=carried)
    if config.own == "only":
        return replace(
            also, reason=also.reason and f"{also.reason} (at {len(own)} grasps of your own)"
        )
    if found.reason or also.reason:
        return also if found.reason and not also.reason else found
    return _both(found, also)


def _both(found: GraspSelection, also: GraspSelection) -> GraspSelection:
    """Return two selections as one, ordered again; see `firmest_first`."""
    one, other = found.grasps, also.grasps
    # The user's own are as simple as the simplest.
    complexity = np.append(np.arange(len(one)), np.zeros(len(other)))
    return _ordered(
        np.concatenate([found.Ts_part_tool, also.Ts_part_tool]),
        np.append(one.code, other.code), np.append(one.width, other.width),
        np.append(one.capacity, other.capacity),
        np.append(one.line, other.line + one.line.max() + 1), complexity, float(one.need[0]),
        np.ones(len(complexity), bool),
    )  # fmt: skip


class _Body(NamedTuple):
    """A rigid object in its upright frame."""

    elements: tuple[Element, ...]
    center: Float[np.ndarray, "3"]
    """Center of mass [m]."""
    mass: float
    """[kg]"""

    @classmethod
    def of(cls, model: Articulated, weight: tuple[float, ...], T: tuple[float, ...]) -> _Body:
        """Return an object, see `_holding`."""
        poses, T_upright_root = model.rest_poses, np.reshape(T, (4, 4))
        elements = tuple(
            Element(link, hull.name or link, convex_of(hull, T_upright_root @ poses[link]), index)
            for link in model.links
            for index, hull in enumerate(model.hulls[link])
        )
        center = T_upright_root[:3, :3] @ weight[1:] + T_upright_root[:3, 3]
        return cls(elements, center, weight[0])


def _held_at(
    robot: Robot,
    body: _Body,
    Ts_object_tool: Float[np.ndarray, "g 4 4"],
    config: GraspConfig,
    *,
    carried: bool,
) -> GraspSelection:
    """Close the fingers at given tool poses in the upright frame; keep the grasps that hold."""
    R, p = (np.ascontiguousarray(x) for x in (Ts_object_tool[:, :3, :3], Ts_object_tool[:, :3, 3]))
    none = np.zeros(len(R))
    lines = _Lines(R, p, none, none, none)
    need = (1.0 + config.swing) * GRAVITY * body.mass
    return _pinched(
        robot, hand_of(robot), body.elements, lines, (R, p, np.arange(len(R))), body.center, need,
        config, carried=carried,
    )  # fmt: skip


@owner_cache()
def _holding(
    robot: Robot,
    model: Articulated,
    weight: tuple[float, ...],
    T: tuple[float, ...],
    config: GraspConfig,
    carried: bool,
) -> GraspSelection:
    """Select the grasps for a pose of the object's root in its upright frame.

    The weight is mass [kg] and center of mass in the root's frame [m].
    """
    elements, center, mass = _Body.of(model, weight, T)
    lines = _lines(robot, elements, center)
    need = (1.0 + config.swing) * GRAVITY * mass
    hand = hand_of(robot)
    if robot.grips is Grip.SUCTION:
        return _sucked(robot, hand, elements, lines, need, config)
    if not closes_fingers(robot):
        why = empty_handed(robot) or f"{robot.name} has no fingers that close on an object"
        return _none(lines, need, why)
    if _too_wide(robot, lines, config):
        # The fingers may pass the object as closely as at a grasp, see `stands_clear`.
        config = replace(config, hand_clearance=config.hand_clearance * HELD_CLEARANCE_SHARE)
    start = _depths(hand, elements, lines, config)
    return _pinched(robot, hand, elements, lines, start, center, need, config, carried=carried)


def _lines(
    robot: Robot,
    elements: tuple[Element, ...],
    center: Float[np.ndarray, "3"],
) -> _Lines:
    """Combine pitches, yaws and points along the object; the closing axis is horizontal."""
    yaws = np.arange(ROLLS) * 2 * np.pi / ROLLS
    pitch, yaw, swap = (
        values.ravel()
        for values in np.meshgrid(np.radians(PITCHES), yaws, (1.0, -1.0), indexing="ij")
    )
    once = (pitch < pitch.max()) | (swap > 0)  # from above, a half turn also swaps the fingers
    pitch, yaw, swap = pitch[once], yaw[once], swap[once]
    zero = np.zeros(len(yaw))
    ahead = np.column_stack([np.cos(yaw), np.sin(yaw), zero])
    closing = swap[:, None] * np.column_stack([-np.sin(yaw), np.cos(yaw), zero])
    approach = np.cos(pitch)[:, None] * ahead - np.sin(pitch)[:, None] * [0.0, 0.0, 1.0]
    across = np.cross(approach, closing)

    points = corners(elements) - center
    lateral = points @ across.T
    usable = np.stack([-lateral.min(0), lateral.max(0)]) - PAD_INSET
    shares = np.array(HANDLE_POINTS)
    off = shares[:, None] * np.where(shares[:, None] > 0, usable[1], usable[0]).clip(0)
    row = np.tile(np.arange(len(yaw)), len(shares))
    kept = (shares == 0).repeat(len(yaw)) | (np.abs(off.ravel()) > PAD_INSET)
    row, off = row[kept], off.ravel()[kept]
    target = center + off[:, None] * across[row]
    near = -(points @ approach.T).min(0)
    width = np.ptp(points @ closing.T, axis=0)
    complexity = 5 * np.abs(off) + np.minimum(pitch, np.pi / 2 - pitch)[row]
    R = grasp_frames(robot, target, approach[row], closing[row])[:, :3, :3]
    return _Lines(R, target, near[row], width[row], complexity)


def _pinched(
    robot: Robot,
    hand: HandBoxes,
    elements: tuple[Element, ...],
    lines: _Lines,
    start: _Start,
    center: Float[np.ndarray, "3"],
    need: float,
    config: GraspConfig,
    *,
    carried: bool,
) -> GraspSelection:
    """Select pinch grasps in which only the pads touch, and which carry the weight."""
    held = np.ones(len(elements), bool)
    wide = _too_wide(robot, lines, config)
    R, p, row = start
    p, travel, met = close_hands(hand, elements, held, R, p, config)
    if not met.any():
        return _none(lines, need, wide or cannot_close(robot, hand, "it"))
    R, p, row, travel = R[met], p[met], row[met], travel[met]
    clear = stands_clear(hand, elements, held, R, p, config)
    if not clear.any():
        return _none(lines, need, wide or f"the open hand of {robot.name} does not fit around it")
    R, p, row, travel = R[clear], p[clear], row[clear], travel[clear]
    contact = contact_of(hand, elements, R, p, travel, config.friction)
    firm = contact.is_firm(hand, config)
    if not firm.any():
        flaw = contact.flaw(hand, config)
        return _none(lines, need, f"the pads of {robot.name} touch too little of it: {flaw}")
    firm &= contact.area >= MIN_CONTACT_SHARE * contact.area[firm].max()
    width = robot.opening - travel.sum(1)
    capacity = lifting_capacity(
        robot.grip_force, config.friction, contact, R @ hand.closing, width, center,
        ALL_DIRECTIONS if carried else DOWN,
    )  # fmt: skip
    strong = firm & (capacity >= config.grasp_margin * need)
    if not strong.any():
        return _none(
            lines, need, f"{robot.name} holds {capacity[firm].max():.1f} N of it at most, and "
            f"{config.grasp_margin * need:.1f} N are needed",
        )  # fmt: skip
    code = np.full(len(R), FAMILIES.index(Family.PINCH))
    complexity = lines.complexity[row] + 10 * np.linalg.norm(contact.point - center, axis=1)
    return _ordered(poses_of(R, p), code, width, capacity, row, complexity, need, strong)


_Start: TypeAlias = (
    "tuple[Float[np.ndarray, 'g 3 3'], Float[np.ndarray, 'g 3'], Int[np.ndarray, ' g']]"
)
"""Rotations and origins of hands that are about to close, and the approach line of each."""


def _too_wide(robot: Robot, lines: _Lines, config: GraspConfig) -> str:
    """Return a reason if the gripper is too narrow along every closing axis, else ""."""
    least, clearance = float(lines.width.min()), config.hand_clearance
    if least + 2 * clearance <= robot.opening:
        return ""
    return (
        f"it is {100 * least:.1f} cm wide, and the gripper of {robot.name} opens "
        f"{100 * robot.opening:.1f} cm and needs {100 * clearance:.1f} cm next to each finger"
    )


def _depths(
    hand: HandBoxes, elements: tuple[Element, ...], lines: _Lines, config: GraspConfig
) -> tuple[Float[np.ndarray, "g 3 3"], Float[np.ndarray, "g 3"], Int[np.ndarray, " g"]]:
    """Build tool poses on lines, at the deepest reachable depth and others.

    Returns:
        Rotations, origins and line of each; deepest first.
    """
    approach = lines.R @ hand.approach
    origin = lines.target - hand.pad_middle * approach
    deepest = np.minimum(advance(hand, elements, lines.R, origin, config).travel, 0.0)
    shallow = np.minimum(hand.pad_middle - hand.tip + MIN_OVERLAP - lines.near, deepest)
    shares = np.array(STANDOFFS)
    travel = deepest + shares[:, None] * (shallow - deepest)
    different = (shares[:, None] == shares[0]) | (deepest - travel > MIN_OVERLAP)
    share, row = np.nonzero(different & (deepest > -np.inf))
    p = origin[row] + travel[share, row][:, None] * approach[row]
    return lines.R[row], p, row


def _sucked(
    robot: Robot,
    hand: HandBoxes,
    elements: tuple[Element, ...],
    lines: _Lines,
    need: float,
    config: GraspConfig,
) -> GraspSelection:
    """Select poses of a suction cup on faces perpendicular to it."""
    approach = lines.R @ hand.approach
    p = lines.target - (hand.tip + lines.near)[:, None] * approach
    reached = advance(hand, elements, lines.R, p, config)
    travel = reached.travel + config.hand_clearance
    met = np.flatnonzero((reached.obstacle >= 0) & (np.abs(travel) < MIN_OVERLAP))
    p = p[met] + travel[met, None] * approach[met]
    square = np.zeros(len(met))
    for index, element in enumerate(elements):
        rows = reached.obstacle[met] == index
        inside = p[rows] + (hand.tip + MIN_OVERLAP) * approach[met][rows]
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
        poses_of(lines.R[met], p), code, wide, firm, met, lines.complexity[met], need, strong
    )


def _ordered(
    Ts: Float[np.ndarray, "g 4 4"],
    code: Int[np.ndarray, " g"],
    width: Float[np.ndarray, " g"],
    capacity: Float[np.ndarray, " g"],
    line: Int[np.ndarray, " g"],
    complexity: Float[np.ndarray, " g"],
    need: float,
    strong: Bool[np.ndarray, " g"],
) -> GraspSelection:
    """Return the strong grasps, see `firmest_first`."""
    every, none = np.full(len(capacity), need), np.zeros(len(capacity), np.int64)
    order = firmest_first(capacity, every, complexity, none)
    order = order[strong[order]]
    grasps = Grasps(code, width, capacity, every, (), none, line).take(order)
    return GraspSelection(np.ascontiguousarray(Ts[order]), grasps, "", "")


def _none(lines: _Lines, need: float, reason: str) -> GraspSelection:
    """Return the approach lines and the reason why no grasp along them holds."""
    count = len(lines.R)
    none, unknown = np.zeros(count, np.int64), np.full(count, np.nan)
    grasps = Grasps(
        none, unknown, np.zeros(count), np.full(count, need), (), none, np.arange(count)
    )
    return GraspSelection(poses_of(lines.R, lines.target), grasps, reason, "")
