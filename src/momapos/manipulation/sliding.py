"""Hooks that slide along what they hold.

While the part rests, the fingers open, the hand goes on along the handle, and the fingers close
there. Grasps that differ by such a way alone are one group, and at every waypoint the hand may go
from one to another: to slide is a step of the path over the waypoints.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from momapos.geometry.transforms import invert
from momapos.manipulation.config import GraspConfig
from momapos.manipulation.grasp_hold import stands_clear
from momapos.manipulation.hand import Hand, hand_of
from momapos.manipulation.handle_shapes import Element
from momapos.manipulation.handles import Handle
from momapos.manipulation.motion import TaskMotion
from momapos.manipulation.part_grasps import FAMILIES, Family, surroundings
from momapos.manipulation.resistance import stays
from momapos.manipulation.turning import Turning
from momapos.robots.robot import Grip, Robot
from momapos.scene.scene import SceneObject
from momapos.types import Hold

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

STATES = 6
"""States of a slide, the last of which takes hold anew [-]."""
STEP = 0.01
"""A slide is looked at in steps of this [m]."""
MOVED = 1e-3
"""A hand that is farther along the handle has slid [m]."""
_HOOK = FAMILIES.index(Family.HOOK)
_DIGITS = 4


@dataclass(frozen=True, repr=False)
class SlidingMotion(TaskMotion):
    """A motion on which the part rests at waypoints, so that the hand can slide there.

    Such a waypoint comes twice, before and after. The groups of `turning` are grasps along the
    handle.
    """

    after: Bool[np.ndarray, " w"] = field(default_factory=lambda: np.zeros(0, bool))
    """Waypoints that come after a slide; the one before each is the same without it."""

    @property
    def keeps_grasp(self) -> Bool[np.ndarray, " w"]:
        """Between waypoints the hand holds on."""
        return ~self.after

    @property
    def layer_of(self) -> Int[np.ndarray, " w"]:
        """The two of a slide have the same states of the arm."""
        return np.cumsum(~self.after) - 1

    @property
    def closed(self) -> Bool[np.ndarray, " d"]:
        """Fingers are open while the hand slides."""
        return super().closed & ~self._inside(1, STATES)

    @property
    def closes(self) -> Bool[np.ndarray, " d"]:
        """They open before a slide and close after it."""
        ends = self._inside(0, 1) | self._inside(STATES, STATES + 1)
        return super().closes | ends

    def _inside(self, first: int, last: int) -> Bool[np.ndarray, " d"]:
        """States of the slides, from one of each up to another."""
        begins = self.waypoint_steps[:-1][self.after[1:]]
        return np.isin(
            np.arange(len(self.object_q)), begins[:, None] + np.arange(first, last)[None]
        )

    def tool_poses(self, grasps: Int[np.ndarray, " w"]) -> Float[np.ndarray, "d 4 4"]:
        """Tool poses at every step; between two grasps the tool goes straight."""
        steps = np.arange(len(self.object_q))
        next_one = np.searchsorted(self.waypoint_steps, steps)
        before = self.Ts_world_tool[grasps[np.maximum(next_one - 1, 0)], steps]
        after = self.Ts_world_tool[grasps[next_one], steps]
        share = np.interp(steps, self.waypoint_steps, np.arange(len(grasps))) % 1.0
        share[share == 0.0] = 1.0
        Ts = before.copy()
        Ts[:, :3, 3] += share[:, None] * (after - before)[:, :3, 3]
        return Ts

    def carried_out(
        self, way: int, Ts_world_tool: Float[np.ndarray, "d 4 4"]
    ) -> tuple[Int[np.ndarray, " k"], tuple[Hold, ...]]:
        """The steps of a motion without the slides that it does not need, and its holds."""
        begins, ends = self.waypoint_steps[:-1][self.after[1:]], self.waypoint_steps[self.after]
        along = Ts_world_tool[ends, :3, 3] - Ts_world_tool[begins, :3, 3]
        slid = np.linalg.norm(along, axis=1) > MOVED
        kept = np.ones(len(self.object_q), bool)
        for begin, end in zip(begins[~slid], ends[~slid], strict=True):
            kept[begin + 1 : end + 1] = False
        last = len(kept) - 1 if self.release_step is None else self.release_step
        firsts = [self.grasp_step, *ends[slid].tolist()]
        lasts = [*begins[slid].tolist(), last]
        grasps = self.turning.members(np.array([way]))[0]
        grasps = grasps[grasps >= 0]
        number = np.cumsum(kept) - 1 - self.grasp_step
        holds: list[Hold] = []
        for first, end in zip(firsts, lasts, strict=True):
            away = self.Ts_world_tool[grasps, first, :3, 3] - Ts_world_tool[first, :3, 3]
            grasp = int(grasps[np.linalg.norm(away, axis=1).argmin()])
            words = self.grasps.describe(grasp) + (", after a slide" if holds else "")
            range_ = int(number[first]), int(number[end])
            holds.append(Hold(*range_, None, str(self.grasps.family[grasp]), words))
        return np.flatnonzero(kept), tuple(holds)


def sliding_motion(
    motion: TaskMotion, robot: Robot, target: SceneObject, config: GraspConfig
) -> SlidingMotion | None:
    """The same motion, on which a hook may slide along the handle.

    Args:
        motion: Of a joint, by one handle.
        robot: Whose hand.
        target: The object with the joint.
        config: Which clearance the open hand keeps.

    Returns:
        None where no two hooks have a free way between them along the handle, or where the part
        rests at no waypoint between its ends.
    """
    if motion.task.joint is None or motion.handle is None or not config.sliding:
        return None
    rests = _rests(motion, target, config)
    joint, handle = target.model.joint(motion.task.joint), motion.handle
    T_part = target.link_poses()[joint.child]
    Ts_part_tool = invert(T_part) @ motion.Ts_world_tool[:, motion.grasp_step]
    hooks = motion.grasps.code == _HOOK
    hooks &= motion.grasps.handle == motion.grasps.handle[0]
    if not len(rests) or hooks.sum() < 2:
        return None
    elements, held = surroundings(target.model, joint.name, handle)
    if robot.grips is Grip.HOOK:  # it is behind what it holds, and does not open
        elements = tuple(e for e, own in zip(elements, held, strict=True) if not own)
        held = np.zeros(len(elements), bool)
    way = partial(_way_is_free, hand_of(robot), elements, held, config)
    groups = _groups(Ts_part_tool, np.flatnonzero(hooks), handle, way)
    if not groups:
        return None
    kept = np.isin(np.arange(len(hooks)), np.concatenate(groups))
    number = np.cumsum(kept) - 1
    table = np.full((len(groups), max(map(len, groups))), -1)
    for row, group in zip(table, groups, strict=True):
        row[: len(group)] = number[group]
    turning = Turning(np.zeros(kept.sum()), table, handle.long, Ts_part_tool[kept, :3, :3])
    Ts_world_tool, grasps = motion.Ts_world_tool[kept], motion.grasps.take(kept)
    alone = replace(motion, Ts_world_tool=Ts_world_tool, grasps=grasps, turning=turning)
    return _with_rests(alone, rests)


def _rests(motion: TaskMotion, target: SceneObject, config: GraspConfig) -> Int[np.ndarray, " r"]:
    """Waypoints between the ends of a part's way at which it stays where it is let go."""
    joint, released = motion.task.joint, 1 if motion.release_step is None else 2
    assert joint is not None
    between = np.arange(2, len(motion.waypoint_steps) - released)
    values = motion.object_q[motion.waypoint_steps[between]].tolist()
    stay = [stays(target, joint, value, config.resistance) for value in values]
    return between[np.array(stay, bool)]


Way: TypeAlias = "Callable[[Float[np.ndarray, '4 4'], Float[np.ndarray, '4 4']], bool]"
"""Whether an open hand finds its way from one pose in the part to another free."""


def _groups(
    Ts: Float[np.ndarray, "g 4 4"], rows: Int[np.ndarray, " h"], handle: Handle, is_free: Way
) -> list[Int[np.ndarray, " k"]]:
    """Grasps that differ by a way along the handle alone, which is free for the open hand."""
    away = Ts[rows, :3, 3] - handle.grip
    along = away @ handle.long
    beside = away - along[:, None] * handle.long
    keys = np.round(np.column_stack([Ts[rows, :3, :3].reshape(-1, 9), beside]), _DIGITS) + 0.0
    _, alike = np.unique(keys, axis=0, return_inverse=True)
    found = []
    for group in range(int(alike.max(initial=-1)) + 1):
        mine = np.flatnonzero(alike.ravel() == group)
        mine = rows[mine[np.argsort(along[mine], kind="stable")]]
        free = [is_free(Ts[a], Ts[b]) for a, b in pairwise(mine)]
        found += np.split(mine, np.flatnonzero(~np.array(free, bool)) + 1)
    return [group for group in found if len(group) > 1]


def _way_is_free(
    hand: Hand,
    elements: tuple[Element, ...],
    held: Bool[np.ndarray, " e"],
    config: GraspConfig,
    one: Float[np.ndarray, "4 4"],
    other: Float[np.ndarray, "4 4"],
) -> bool:
    """Whether an open hand can go straight from one pose in the part to another, and could draw
    back from anywhere between them."""
    count = 1 + int(np.ceil(np.linalg.norm(other[:3, 3] - one[:3, 3]) / STEP))
    p = np.linspace(one[:3, 3], other[:3, 3], count)
    R = np.tile(one[:3, :3], (count, 1, 1))
    return bool(stands_clear(hand, elements, held, R, p, config).all())


def _with_rests(motion: TaskMotion, rests: Int[np.ndarray, " r"]) -> SlidingMotion:
    """A motion on which the part rests at some waypoints for as long as a slide takes."""
    copies = np.ones(len(motion.object_q), np.int64)
    copies[motion.waypoint_steps[rests]] += STATES
    old = np.repeat(np.arange(len(copies)), copies)
    first = np.cumsum(copies) - copies
    twice = np.sort(np.append(np.arange(len(motion.waypoint_steps)), rests))
    after = np.append(False, np.diff(twice) == 0)
    steps = first[motion.waypoint_steps[twice]] + STATES * after
    same = {f.name: getattr(motion, f.name) for f in fields(motion)}
    release = motion.release_step
    return SlidingMotion(
        **same
        | {
            "Ts_world_tool": np.ascontiguousarray(motion.Ts_world_tool[:, old]),
            "object_q": motion.object_q[old],
            "holding": motion.holding[old],
            "value": motion.value[old],
            "waypoint_steps": steps,
            "release_step": None if release is None else int(first[release]),
            "after": after,
        }
    )
