"""Families of grasps: never one hand-picked pose."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.robots import Robot
from momapos.model.urdf import Articulated

from .config import GraspConfig
from .hand_boxes import empty_handed
from .handles import Handle, handles_in_turn, lever_arms
from .part_grasps import FAMILIES, Family, PartGrasps, grasps_of, lines_onto, poses_of, push_grasps
from .push_grasps import push_from_behind

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

_LINES = 1_000_000
"""Apart from each other by more than the lines onto one handle [-]."""
_ENOUGH = 2.5
"""Grasps that transmit more times what is needed are as good as each other [-]."""


@dataclass(frozen=True)
class Grasps:
    """What is known of each grasp of a task, beside where the tool is."""

    code: Int[np.ndarray, " g"]
    """Index into `FAMILIES`."""
    width: Float[np.ndarray, " g"]
    """Between the pads when they have closed [m]."""
    capacity: Float[np.ndarray, " g"]
    """Pull that the grasp transmits along the motion [N]."""
    need: Float[np.ndarray, " g"]
    """Pull there that the part needs [N]."""
    handles: tuple[Handle, ...]
    """What is held; empty for rigid objects."""
    handle: Int[np.ndarray, " g"]
    """Index into `handles`."""
    line: Int[np.ndarray, " g"]
    """Grasps with the same number differ by their depth alone, the deepest first."""

    def __len__(self) -> int:
        return len(self.code)

    @property
    def family(self) -> tuple[Family, ...]:
        """How each grasp holds."""
        return tuple(FAMILIES[code] for code in self.code)

    def deepest(self, rows: Bool[np.ndarray, " g"]) -> Bool[np.ndarray, " g"]:
        """Of some grasps, those that no other holds deeper from the same side."""
        chosen = np.flatnonzero(rows)
        _, first = np.unique(self.line[chosen], return_index=True)
        kept = np.zeros(len(self), bool)
        kept[chosen[first]] = True
        return kept

    def describe(self, grasp: int, *, turns: bool = False) -> str:
        """What a grasp holds and how, in words, and whether the hand turns about it."""
        family, width = FAMILIES[self.code[grasp]], 100 * self.width[grasp]
        what = f"{self.handles[self.handle[grasp]]}" if self.handles else "the object"
        if family is Family.PUSH:
            return f"{family} at {what}"
        strong = f"{self.capacity[grasp]:.0f} N of {self.need[grasp]:.0f} N needed"
        words = f"{family} of {what}; {width:.1f} cm between the fingers, {strong}"
        return f"{words}, about which the hand turns" if turns else words

    def take(self, rows: Int[np.ndarray, " k"] | Bool[np.ndarray, " g"]) -> Grasps:
        """Some of the grasps."""
        return Grasps(
            self.code[rows], self.width[rows], self.capacity[rows], self.need[rows],
            self.handles, self.handle[rows], self.line[rows],
        )  # fmt: skip


@dataclass(frozen=True)
class Chosen:
    """The grasps of a part that hold, the best first."""

    Ts_part_tool: Float[np.ndarray, "g 4 4"]
    grasps: Grasps
    reason: str
    """Why none of them holds; "" where they do."""
    passed_over: str
    """Why a better handle is not held; "" where there is none."""


def holding_grasps(
    robot: Robot,
    model: Articulated,
    joint: str,
    sign: float,
    torque: float,
    *,
    closes: bool,
    config: GraspConfig,
    passed: Collection[Handle] = (),
) -> Chosen:
    """The grasps of the first handle of a part by which the robot can move it.

    Args:
        robot: Whose hand.
        model, joint: The part.
        sign: Direction of the joint in which it opens (+1 or -1).
        torque: What the joint resists with [Nm] or [N].
        closes: Whether the part is to be shut: then its front may be pushed as well.
        config: What is tried.
        passed: Handles that are passed over, of which there are more.

    Returns:
        Where none holds, those that the best handle would have, and why they do not.
    """
    found: list[tuple[Handle, PartGrasps]] = []
    handles: list[Handle] = []
    reasons: list[str] = []
    for handle in handles_in_turn(model, joint, sign):
        if handle in passed:
            continue
        handles.append(handle)
        grasps = grasps_of(robot, model, joint, sign, handle, config)
        strong, reason = _strong(robot, model, joint, grasps, torque, handle, config)
        if len(strong.code):
            found.append((handle, strong))
            break
        reasons.append(reason)
    pushes = closes and Family.PUSH in config.families
    pushed = push_grasps(robot, model, joint, sign, config) if pushes else None
    if pushed is not None and len(pushed[1].code):
        found.append(pushed)
    if found:
        return _ordered(model, joint, found, torque, "", reasons[0] if reasons else "")
    lines = lines_onto(robot, handles[0], config)
    none = np.full(len(lines.R), np.nan)
    bare = PartGrasps(
        poses_of(lines.R, lines.target), np.zeros(len(none), np.int64), none,
        np.zeros(len(none)), lines.target, lines.plainness,
        np.arange(len(none)), "",
    )  # fmt: skip
    # A part without any handle has edges alone, and the first says as much as the second.
    named = [r for r, h in zip(reasons, handles, strict=True) if not h.edge] or reasons[:1]
    plain = handles[0].edge or empty_handed(robot)
    edges = "" if plain else ", and no hand gets around its free edge"
    return _ordered(model, joint, [(handles[0], bare)], torque, named[0] + edges, "")


def _strong(
    robot: Robot,
    model: Articulated,
    joint: str,
    grasps: PartGrasps,
    torque: float,
    handle: Handle,
    config: GraspConfig,
) -> tuple[PartGrasps, str]:
    """Those grasps that transmit what a part needs, and why there is none."""
    if not len(grasps.code):
        return grasps, grasps.reason
    grasps = grasps.only(np.isin(grasps.code, [FAMILIES.index(Family(f)) for f in config.families]))
    if not len(grasps.code):
        return grasps, f"{robot.name} holds {handle.name} by other grasps than those allowed"
    need = torque / np.maximum(lever_arms(model, joint, grasps.point), 1e-3)
    strong = grasps.capacity >= config.grasp_margin * need
    if strong.any():
        return grasps.only(strong), ""
    best = int(np.argmax(grasps.capacity / need))
    return grasps.only(strong), (
        f"{robot.name} holds {handle.name} with {grasps.capacity[best]:.0f} N at most, and "
        f"{config.grasp_margin * need[best]:.0f} N are needed there"
    )


def _ordered(
    model: Articulated,
    joint: str,
    found: list[tuple[Handle, PartGrasps]],
    torque: float,
    reason: str,
    passed_over: str,
) -> Chosen:
    """All grasps of some handles, the firmest first, and of those the plainest."""
    parts = [grasps for _, grasps in found]
    point = np.concatenate([g.point for g in parts])
    need = torque / np.maximum(lever_arms(model, joint, point), 1e-3)
    capacity = np.concatenate([g.capacity for g in parts])
    handle = np.repeat(np.arange(len(parts)), [len(g.code) for g in parts])
    plain = np.concatenate([g.plainness for g in parts])
    order = firmest_first(capacity, need, plain, handle)
    grasps = Grasps(
        np.concatenate([g.code for g in parts]), np.concatenate([g.width for g in parts]),
        capacity, need, tuple(h for h, _ in found), handle,
        np.concatenate([_LINES * k + g.line for k, g in enumerate(parts)]),
    )  # fmt: skip
    Ts = np.concatenate([g.Ts_part_tool for g in parts])
    return Chosen(Ts[order], grasps.take(order), reason, passed_over)


def firmest_first(
    capacity: Float[np.ndarray, " g"],
    need: Float[np.ndarray, " g"],
    plainness: Float[np.ndarray, " g"],
    handle: Int[np.ndarray, " g"],
) -> Int[np.ndarray, " g"]:
    """The order in which grasps are tried: by handle, then the firmest, of those the plainest."""
    firm = np.minimum(capacity / np.maximum(need, 1e-9), _ENOUGH)
    return np.lexsort((plainness, -np.floor(2 * firm), handle))


def inside_grasps(
    robot: Robot, model: Articulated, joint: str, sign: float, config: GraspConfig
) -> Chosen | None:
    """Ways to push a part that is ajar farther open, the plainest first; None where there is none.

    The arm pushes: what it transmits has no bound of its own.
    """
    found = push_from_behind(robot, model, joint, sign, config)
    if found is None:
        return None
    back, Ts, plain = found
    count, order = len(Ts), np.argsort(plain, kind="stable")
    code = np.full(count, FAMILIES.index(Family.PUSH))
    wide, firm = np.full(count, robot.opening), np.full(count, np.inf)
    grasps = Grasps(
        code, wide, firm, np.zeros(count), (back,), np.zeros(count, np.int64), np.arange(count)
    )
    return Chosen(Ts[order], grasps, "", "")
