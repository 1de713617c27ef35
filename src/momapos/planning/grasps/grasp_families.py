"""Select and order the grasps of a part, in families; pushes are one of them."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import TaskError, owner_cache
from momapos.core.geometry import rotation_about, rotation_of
from momapos.model.records import FAMILIES, Family
from momapos.model.robots import Grip, Robot
from momapos.model.scene import MotionResistance
from momapos.model.urdf import Articulated, opens_both_ways
from momapos.verification import Limits

from .config import HANDLE_POINTS, GraspConfig
from .hand_boxes import HandBoxes, empty_handed, hand_of
from .handle_shapes import NEVER, CarriedPart, Element, in_pieces, part_elements, touches_hull
from .handles import (
    PUSH_INSET,
    Handle,
    front_face,
    front_part,
    handles_in_turn,
    pressed_faces,
)
from .part_grasps import (
    PartGrasps,
    approach_lines,
    grasp_frames,
    grasps_at,
    grasps_of,
    poses_of,
    push_grasps,
)
from .part_motion import levers_along

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int


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
    hand: HandBoxes, back: Handle, inward: Float[np.ndarray, "3"], R: Float[np.ndarray, "g 3 3"]
) -> Float[np.ndarray, "g 3"]:
    """Return tool origins at which the fingers touch the back, with their tips at its middle point.

    Parts of the fingers beyond the free edge, such as knuckles, are ignored.
    """
    reach = hand.finger_reach(inward @ R)
    toward = hand.finger_reach(-back.out @ R, inward @ R, reach - PUSH_INSET)
    return back.center - reach[:, None] * inward + toward[:, None] * back.out


def _height(
    hand: HandBoxes, part: CarriedPart, out: Float[np.ndarray, "3"], T: Float[np.ndarray, "g 4 4"]
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


_LINE_STRIDE = 1_000_000
"""Offset between the line numbers of two handles; exceeds the number of lines of one [-]."""
MIN_LEVER = 1e-3
"""Smallest lever of a grasp that counts [m]."""
_MAX_RATIO = 2.5
"""Ratio of transmitted to needed force above which grasps count as equally firm [-]."""


NO_POSES: np.ndarray = np.zeros((0, 4, 4))
"""No grasps."""


@dataclass(frozen=True, eq=False)
class Grasps:
    """The grasps of a task, without their tool poses."""

    code: Int[np.ndarray, " g"]
    """Index into `FAMILIES`."""
    width: Float[np.ndarray, " g"]
    """Distance between the closed pads [m]."""
    capacity: Float[np.ndarray, " g"]
    """Pull that the grasp transmits along the motion [N]."""
    need: Float[np.ndarray, " g"]
    """Pull that the part needs there [N]."""
    handles: tuple[Handle, ...]
    """The grasped handles; empty for rigid objects."""
    handle: Int[np.ndarray, " g"]
    """Index into `handles`."""
    line: Int[np.ndarray, " g"]
    """Number of the approach line; grasps of one line differ only in depth, deepest first."""

    def __len__(self) -> int:
        return len(self.code)

    @property
    def family(self) -> tuple[Family, ...]:
        """Family of each grasp."""
        return tuple(FAMILIES[code] for code in self.code)

    def deepest(self, rows: Bool[np.ndarray, " g"]) -> Bool[np.ndarray, " g"]:
        """Select, among some grasps, the deepest one of each approach line."""
        chosen = np.flatnonzero(rows)
        _, first = np.unique(self.line[chosen], return_index=True)
        kept = np.zeros(len(self), bool)
        kept[chosen[first]] = True
        return kept

    def describe(self, grasp: int, *, turns: bool = False) -> str:
        """Describe a grasp in words for the plan."""
        family, width = FAMILIES[self.code[grasp]], 100 * self.width[grasp]
        what = f"{self.handles[self.handle[grasp]]}" if self.handles else "the object"
        if family is Family.PUSH:
            return f"{family} at {what}"
        strong = f"{self.capacity[grasp]:.0f} N of {self.need[grasp]:.0f} N needed"
        words = f"{family} of {what}; {width:.1f} cm between the fingers, {strong}"
        return f"{words}, the hand turning about it" if turns else words

    def take(self, rows: Int[np.ndarray, " k"] | Bool[np.ndarray, " g"]) -> Grasps:
        """Return a subset of the grasps."""
        return Grasps(
            self.code[rows], self.width[rows], self.capacity[rows], self.need[rows],
            self.handles, self.handle[rows], self.line[rows],
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class GraspSelection:
    """The selected grasps of a part, the best first."""

    Ts_part_tool: Float[np.ndarray, "g 4 4"]
    grasps: Grasps
    reason: str
    """Why none of them holds; "" if they do."""
    better_handle_reason: str
    """Why a better handle is not used; "" if there is none."""

    def take(self, rows: Bool[np.ndarray, " g"]) -> GraspSelection:
        """Return some of the grasps."""
        return replace(self, Ts_part_tool=self.Ts_part_tool[rows], grasps=self.grasps.take(rows))


def select_part_grasps(
    robot: Robot,
    model: Articulated,
    joint: str,
    sign: float,
    resistance: MotionResistance,
    *,
    closes: bool,
    config: GraspConfig,
    excluded: Collection[Handle] = (),
    latch: str | None = None,
    own: Float[np.ndarray, "g 4 4"] = NO_POSES,
) -> GraspSelection:
    """Select the grasps of the part's first handle by which the robot can move it.

    A door that swings both ways is grasped on either side, a lever anywhere.

    Args:
        robot: The robot.
        model, joint: The part.
        sign: Opening direction of the joint (+1 or -1).
        resistance: Resistance of the joint along the motion.
        closes: Whether the task closes the part, so that its front may also be pushed.
        config: The grasps to try.
        excluded: Handles to skip; not all of the part's.
        latch: The link that the hand must hold; None for any.
        own: Tool poses of the user's own grasps in the frame of the joint's child.

    Returns:
        The grasps; if none holds, approaches to the best handle, and the reason.
    """
    found: list[tuple[Handle, PartGrasps]] = []
    handles: list[Handle] = []
    reasons: list[str] = []
    two_sided = opens_both_ways(model, joint)
    only_own = config.own == "only" and len(own) > 0
    for handle in handles_in_turn(model, joint, sign, latch):
        if handle in excluded or (found and not _adds_to(found[0][0], handle)):
            continue
        handles.append(handle)
        grasps = grasps_at(robot, model, joint, sign, handle, own, config)
        if not only_own:
            grasps = grasps_of(robot, model, joint, sign, handle, config).and_also(grasps)
        strong, reason = _strong(robot, model, joint, grasps, resistance, handle, config)
        if len(strong.code):
            found.append((handle, strong))
            if not two_sided and not handle.whole and not found[0][0].whole:
                break
            continue
        reasons.append(reason)
    face = front_face(front_part(model, joint, sign), sign)
    pushes = closes and Family.PUSH in config.families and not only_own
    if pushes and face is not None:
        pushed = push_grasps(robot, model, joint, sign, face, config)
        if len(pushed.code):
            found.append((face, pushed))
    if found:
        return _ordered(model, joint, found, resistance, "", reasons[0] if reasons else "")
    bare = _approaches(robot, handles[0], config)
    # A part without handles has only edges, whose reasons are alike.
    named = [r for r, h in zip(reasons, handles, strict=True) if not h.edge] or reasons[:1]
    plain = handles[0].edge or empty_handed(robot)
    edges = "" if plain else ", and no hand gets around its free edge"
    return _ordered(model, joint, [(handles[0], bare)], resistance, named[0] + edges, "")


def select_presses(
    robot: Robot,
    model: Articulated,
    joint: str,
    sign: float,
    resistance: MotionResistance,
    config: GraspConfig,
) -> GraspSelection:
    """Select pushes with the fingertips that press a part in, see `pressed_faces`.

    Args:
        robot: The robot, with a closed hand.
        model, joint: The part.
        sign: Direction in which the part comes out (+1 or -1).
        resistance: Resistance of the joint along the motion.
        config: The grasps to try.

    Raises:
        TaskError: The part has no face that a push moves.
    """
    part = front_part(model, joint, sign)
    faces = () if part is None else pressed_faces(part, sign)
    if not faces:
        raise TaskError(f"{joint} has no face whose push moves it there; open or close it instead")
    pushes = [push_grasps(robot, model, joint, sign, face, config) for face in faces]
    found = [(face, one) for face, one in zip(faces, pushes, strict=True) if len(one.code)]
    if found:
        return _ordered(model, joint, found, resistance, "", "")
    bare = [(faces[0], _approaches(robot, faces[0], config))]
    return _ordered(model, joint, bare, resistance, pushes[0].reason, "")


def _approaches(robot: Robot, handle: Handle, config: GraspConfig) -> PartGrasps:
    """Return approaches to a handle of which none holds, for answers that say why."""
    lines = approach_lines(robot, handle, config)
    none = np.full(len(lines.R), np.nan)
    return PartGrasps(
        poses_of(lines.R, lines.target), np.zeros(len(none), np.int64), none,
        np.zeros(len(none)), lines.target, lines.complexity,
        np.arange(len(none)), "",
    )  # fmt: skip


def _adds_to(first: Handle, handle: Handle) -> bool:
    """Check whether a handle is another hold of a lever, or on the other side of a swing door."""
    facing = float(handle.out @ first.out)
    return first.whole or (not handle.edge and handle.carrier == first.carrier and facing < -0.5)


def _strong(
    robot: Robot,
    model: Articulated,
    joint: str,
    grasps: PartGrasps,
    resistance: MotionResistance,
    handle: Handle,
    config: GraspConfig,
) -> tuple[PartGrasps, str]:
    """Return the grasps that transmit the needed force, and the reason if there are none."""
    if not len(grasps.code):
        return grasps, grasps.reason
    grasps = grasps.only(np.isin(grasps.code, [FAMILIES.index(Family(f)) for f in config.families]))
    if not len(grasps.code):
        return grasps, f"{robot.name} holds {handle.name} by other grasps than those allowed"
    if robot.grips is Grip.HOOK and resistance.along.min() < 0.0:
        where = _value_words(resistance, int(np.argmax(resistance.along < 0.0)), model, joint)
        return grasps.only(np.zeros(len(grasps.code), bool)), (
            f"{robot.name} hooks {handle.name}, and no hook holds back a part that falls open, as "
            f"this one does {where}"
        )
    part = CarriedPart(model, joint, handle.carrier)
    forces = _forces(part, grasps.point, resistance)
    need = forces.max(0)
    strong = grasps.capacity >= config.grasp_margin * need
    if strong.any():
        return grasps.only(strong), ""
    best = int(np.argmax(grasps.capacity / need))
    worst = int(forces[:, best].argmax())
    where = _value_words(resistance, worst, model, joint)
    back = " to hold it back" if resistance.along[worst] < 0.0 else ""
    why = resistance.source(worst)
    return grasps.only(strong), (
        f"{robot.name} holds {handle.name} with {grasps.capacity[best]:.0f} N at most, and "
        f"{config.grasp_margin * need[best]:.0f} N are needed {where}{back}{why and f' ({why})'}"
    )


def _forces(
    part: CarriedPart, points: Float[np.ndarray, "g 3"], resistance: MotionResistance
) -> Float[np.ndarray, "v g"]:
    """Return the force that a hand at each point must transmit at each value [N]."""
    levers = levers_along(part, points, resistance.values)
    return np.asarray(resistance.total[:, None] / np.maximum(levers, MIN_LEVER))


def _value_words(resistance: MotionResistance, index: int, model: Articulated, joint: str) -> str:
    """Return a value of a motion in words."""
    value, slides = float(resistance.values[index]), model.joint(joint).kind == "prismatic"
    return f"at {100 * value:.0f} cm" if slides else f"at {np.degrees(value):.0f} deg"


def _ordered(
    model: Articulated,
    joint: str,
    found: list[tuple[Handle, PartGrasps]],
    resistance: MotionResistance,
    reason: str,
    better_handle_reason: str,
) -> GraspSelection:
    """Order the grasps of some handles, see `firmest_first`."""
    parts = [grasps for _, grasps in found]
    carried = [CarriedPart(model, joint, handle.carrier) for handle, _ in found]
    need = np.concatenate(
        [_forces(part, g.point, resistance).max(0) for part, g in zip(carried, parts, strict=True)]
    )
    capacity = np.concatenate([g.capacity for g in parts])
    handle = np.repeat(np.arange(len(parts)), [len(g.code) for g in parts])
    complexity = np.concatenate([g.complexity for g in parts])
    order = firmest_first(capacity, need, complexity, handle)
    grasps = Grasps(
        np.concatenate([g.code for g in parts]), np.concatenate([g.width for g in parts]),
        capacity, need, tuple(h for h, _ in found), handle,
        np.concatenate([_LINE_STRIDE * k + g.line for k, g in enumerate(parts)]),
    )  # fmt: skip
    Ts = np.concatenate([g.Ts_part_tool for g in parts])
    return GraspSelection(Ts[order], grasps.take(order), reason, better_handle_reason)


def firmest_first(
    capacity: Float[np.ndarray, " g"],
    need: Float[np.ndarray, " g"],
    complexity: Float[np.ndarray, " g"],
    handle: Int[np.ndarray, " g"],
) -> Int[np.ndarray, " g"]:
    """Return the order of grasps: by handle, then the firmest, then the simplest."""
    firm = np.minimum(capacity / np.maximum(need, 1e-9), _MAX_RATIO)
    return np.lexsort((complexity, -np.floor(2 * firm), handle))


def select_inner_pushes(
    robot: Robot, model: Articulated, joint: str, sign: float, config: GraspConfig
) -> GraspSelection | None:
    """Select pushes that open a part that is ajar, the simplest first; None if there are none.

    The arm pushes, so the transmitted force is unbounded.
    """
    found = push_from_behind(robot, model, joint, sign, config)
    if found is None:
        return None
    back, Ts, complexity = found
    count, order = len(Ts), np.argsort(complexity, kind="stable")
    code = np.full(count, FAMILIES.index(Family.PUSH))
    wide, firm = np.full(count, robot.opening), np.full(count, np.inf)
    grasps = Grasps(
        code, wide, firm, np.zeros(count), (back,), np.zeros(count, np.int64), np.arange(count)
    )
    return GraspSelection(Ts[order], grasps, "", "")
