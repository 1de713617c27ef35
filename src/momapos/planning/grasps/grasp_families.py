"""Select and order the grasps of a part, in families instead of one hand-picked pose."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.robots import Grip, Robot
from momapos.model.scene import MotionResistance
from momapos.model.urdf import Articulated, opens_both_ways

from .config import GraspConfig
from .hand_boxes import empty_handed
from .handle_records import Handle
from .handle_shapes import CarriedPart
from .handles import handles_in_turn
from .part_grasps import (
    FAMILIES,
    Family,
    PartGrasps,
    approach_lines,
    grasps_of,
    poses_of,
    push_grasps,
)
from .part_motion import levers_along
from .push_grasps import push_from_behind

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

_LINE_STRIDE = 1_000_000
"""Offset between the line numbers of two handles; exceeds the number of lines of one [-]."""
MIN_LEVER = 1e-3
"""Smallest lever of a grasp that counts [m]."""
_MAX_RATIO = 2.5
"""Ratio of transmitted to needed force above which grasps count as equally firm [-]."""


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

    Returns:
        The grasps; if none holds, approaches to the best handle, and the reason.
    """
    found: list[tuple[Handle, PartGrasps]] = []
    handles: list[Handle] = []
    reasons: list[str] = []
    two_sided = opens_both_ways(model, joint)
    for handle in handles_in_turn(model, joint, sign, latch):
        if handle in excluded or (found and not _adds_to(found[0][0], handle)):
            continue
        handles.append(handle)
        grasps = grasps_of(robot, model, joint, sign, handle, config)
        strong, reason = _strong(robot, model, joint, grasps, resistance, handle, config)
        if len(strong.code):
            found.append((handle, strong))
            if not two_sided and not handle.whole and not found[0][0].whole:
                break
            continue
        reasons.append(reason)
    pushes = closes and Family.PUSH in config.families
    pushed = push_grasps(robot, model, joint, sign, config) if pushes else None
    if pushed is not None and len(pushed[1].code):
        found.append(pushed)
    if found:
        return _ordered(model, joint, found, resistance, "", reasons[0] if reasons else "")
    lines = approach_lines(robot, handles[0], config)
    none = np.full(len(lines.R), np.nan)
    bare = PartGrasps(
        poses_of(lines.R, lines.target), np.zeros(len(none), np.int64), none,
        np.zeros(len(none)), lines.target, lines.complexity,
        np.arange(len(none)), "",
    )  # fmt: skip
    # A part without handles has only edges, whose reasons are alike.
    named = [r for r, h in zip(reasons, handles, strict=True) if not h.edge] or reasons[:1]
    plain = handles[0].edge or empty_handed(robot)
    edges = "" if plain else ", and no hand gets around its free edge"
    return _ordered(model, joint, [(handles[0], bare)], resistance, named[0] + edges, "")


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
