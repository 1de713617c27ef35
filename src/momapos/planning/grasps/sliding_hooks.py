"""Add slides along the handle to the motion of hooks.

While the part rests at a waypoint, the fingers open, the hand moves along the handle, and the
fingers close there. A slide is a step of the path over the waypoints. Between waypoints, a hand
that holds a bar may also turn about it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from momapos.core.geometry import invert, rotation_about
from momapos.model.records import FAMILIES, Family, Hold
from momapos.model.robots import Grip, Robot
from momapos.model.scene import SceneObject, stays_in_place

from .config import GraspConfig
from .hand_boxes import HandBoxes, hand_of
from .handle_shapes import Element
from .handles import Handle
from .motion_record import TaskMotion, Turning
from .part_grasps import elements_near_handle, stands_clear

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

SLIDE_STATES = 6
"""Steps of a slide, the last of which grasps again [-]."""
CHECK_STEP = 0.01
"""Distance of the collision checks along a slide [m]."""
MIN_SLIDE = 1e-3
"""Minimum length of a slide [m]."""
_HOOK = FAMILIES.index(Family.HOOK)
_DIGITS = 4


@dataclass(frozen=True, repr=False, eq=False)
class SlidingMotion(TaskMotion):
    """A motion whose part rests at some waypoints so that the hand can slide there.

    Such a waypoint appears twice: before and after the slide. The groups of `turning` are grasps
    between which the hand may slide and turn.
    """

    turn_lane: Int[np.ndarray, " g"] = field(default_factory=lambda: np.zeros(0, np.int64))
    """Grasps with the same number differ only by a turn about the handle."""
    slide_lane: Int[np.ndarray, " g"] = field(default_factory=lambda: np.zeros(0, np.int64))
    """Grasps with the same number differ only by a free slide along the handle."""
    after: Bool[np.ndarray, " w"] = field(default_factory=lambda: np.zeros(0, bool))
    """Whether each waypoint ends a slide; the waypoint before is its beginning."""

    @property
    def lanes(self) -> tuple[Int[np.ndarray, "k g"], Int[np.ndarray, " w"]]:
        """See `TaskMotion`; the hand turns between waypoints and slides at them."""
        approach = np.arange(len(self.turn_lane))
        row = np.where(self.after, 2, 1)
        row[1] = 0
        return np.stack([approach, self.turn_lane, self.slide_lane]), row

    @property
    def layer_of(self) -> Int[np.ndarray, " w"]:
        """See `TaskMotion`; both waypoints of a slide share their arm states."""
        return np.cumsum(~self.after) - 1

    @property
    def closed(self) -> Bool[np.ndarray, " d"]:
        """See `TaskMotion`; the fingers are open during a slide."""
        return super().closed & ~self._inside(1, SLIDE_STATES)

    @property
    def closes(self) -> Bool[np.ndarray, " d"]:
        """See `TaskMotion`; the fingers open before a slide and close after it."""
        ends = self._inside(0, 1) | self._inside(SLIDE_STATES, SLIDE_STATES + 1)
        return super().closes | ends

    def _inside(self, first: int, last: int) -> Bool[np.ndarray, " d"]:
        """Select steps first:last of every slide."""
        begins = self.waypoint_steps[:-1][self.after[1:]]
        return np.isin(
            np.arange(len(self.object_q)), begins[:, None] + np.arange(first, last)[None]
        )

    def tool_poses(self, grasps: Int[np.ndarray, " w"]) -> Float[np.ndarray, "d 4 4"]:
        """See `TaskMotion`; the tool moves straight along the handle and turns about it."""
        steps, turning = np.arange(len(self.object_q)), self.turning
        next_one = np.searchsorted(self.waypoint_steps, steps)
        before, after = grasps[np.maximum(next_one - 1, 0)], grasps[next_one]
        share = np.interp(steps, self.waypoint_steps, np.arange(len(grasps))) - next_one + 1.0
        Ts, goal = self.Ts_world_tool[before, steps], self.Ts_world_tool[after, steps, :3, 3]
        Ts[:, :3, 3] += share[:, None] * (goal - Ts[:, :3, 3])
        axis = turning.axis @ turning.R_part_tool[grasps[0]]
        turn = share * (turning.angles[after] - turning.angles[before])
        Ts[:, :3, :3] = Ts[:, :3, :3] @ rotation_about(axis, turn)
        return Ts

    def executed_steps(
        self, mode: int, Ts_world_tool: Float[np.ndarray, "d 4 4"]
    ) -> tuple[Int[np.ndarray, " k"], tuple[Hold, ...]]:
        """See `TaskMotion`; slides of no length are left out."""
        begins, ends = self.waypoint_steps[:-1][self.after[1:]], self.waypoint_steps[self.after]
        along = Ts_world_tool[ends, :3, 3] - Ts_world_tool[begins, :3, 3]
        slid = np.linalg.norm(along, axis=1) > MIN_SLIDE
        kept = np.ones(len(self.object_q), bool)
        for begin, end in zip(begins[~slid], ends[~slid], strict=True):
            kept[begin + 1 : end + 1] = False
        last = len(kept) - 1 if self.release_step is None else self.release_step
        firsts = [self.grasp_step, *ends[slid].tolist()]
        lasts = [*begins[slid].tolist(), last]
        grasps = self.turning.members(np.array([mode]))[0]
        grasps = grasps[grasps >= 0]
        turns = len(np.unique(self.turn_lane[grasps])) < len(grasps)
        axis = self.turning.axis_of(mode) if turns else None
        number = np.cumsum(kept) - 1 - self.grasp_step
        holds: list[Hold] = []
        for first, end in zip(firsts, lasts, strict=True):
            away = self.Ts_world_tool[grasps, first, :3, 3] - Ts_world_tool[first, :3, 3]
            grasp = int(grasps[np.linalg.norm(away, axis=1).argmin()])
            words = self.grasps.describe(grasp, turns=turns) + (", after a slide" if holds else "")
            range_ = int(number[first]), int(number[end])
            holds.append(Hold(*range_, axis, str(self.grasps.family[grasp]), words))
        return np.flatnonzero(kept), tuple(holds)


def sliding_motion(
    motion: TaskMotion, robot: Robot, target: SceneObject, config: GraspConfig
) -> SlidingMotion | None:
    """Extend a motion by slides of hooks along the handle.

    Args:
        motion: A joint's motion, by one handle.
        robot: The robot.
        target: The object with the joint.
        config: Gives the clearance of the open hand.

    Returns:
        The motion, or None if no slide between two hooks is free, or if the part rests at no
        waypoint between its ends.
    """
    if motion.task.joint is None or motion.handle is None or not config.sliding:
        return None
    if motion.latch_q is not None:  # the hand that turned the latch keeps it turned
        return None
    rests = _rests(motion, target, config)
    joint, handle = target.joint(motion.task.joint), motion.handle
    T_part = target.link_poses()[handle.carrier]
    Ts_part_tool = invert(T_part) @ motion.Ts_world_tool[:, motion.grasp_step]
    hooks = motion.grasps.code == _HOOK
    hooks &= motion.grasps.handle == motion.grasps.handle[0]
    if not len(rests) or hooks.sum() < 2:
        return None
    elements, held = elements_near_handle(target.model, joint.name, handle)
    if robot.grips is Grip.HOOK:  # it is behind the handle and does not open
        elements = tuple(e for e, own in zip(elements, held, strict=True) if not own)
        held = np.zeros(len(elements), bool)
    is_free = partial(_slide_is_free, hand_of(robot), elements, held, config)
    turn_lane = _turn_lanes(motion.turning, len(hooks))
    slide_lane = _slide_lanes(Ts_part_tool, hooks, handle, is_free)
    groups = _groups(hooks, turn_lane, slide_lane)
    if not groups:
        return None
    kept = np.isin(np.arange(len(hooks)), np.concatenate(groups))
    number = np.cumsum(kept) - 1
    table = np.full((len(groups), max(map(len, groups))), -1)
    for row, group in zip(table, groups, strict=True):
        row[: len(group)] = number[group]
    turning = replace(
        motion.turning, angles=motion.turning.angles[kept], groups=table,
        R_part_tool=Ts_part_tool[kept, :3, :3],
    )  # fmt: skip
    Ts_world_tool, grasps = motion.Ts_world_tool[kept], motion.grasps.take(kept)
    alone = replace(motion, Ts_world_tool=Ts_world_tool, grasps=grasps, turning=turning)
    return _with_rests(alone, rests, turn_lane[kept], slide_lane[kept])


def _rests(motion: TaskMotion, target: SceneObject, config: GraspConfig) -> Int[np.ndarray, " r"]:
    """Return the waypoints between the ends of the motion at which a released part stays."""
    joint, released = motion.task.joint, 1 if motion.release_step is None else 2
    assert joint is not None
    between = np.arange(2, len(motion.waypoint_steps) - released)
    values = motion.object_q[motion.waypoint_steps[between]]
    return between[stays_in_place(target, joint, values, config.resistance)]


PathCheck: TypeAlias = "Callable[[Float[np.ndarray, '4 4'], Float[np.ndarray, '4 4']], bool]"
"""Check that an open hand can move straight from one pose in the part to another."""


def _turn_lanes(turning: Turning, count: int) -> Int[np.ndarray, " g"]:
    """Number the grasps by turning group; each other grasp gets a number of its own."""
    lanes = np.arange(count) + len(turning.groups)
    for number, group in enumerate(turning.groups):
        lanes[group[group >= 0]] = number
    return lanes


def _slide_lanes(
    Ts: Float[np.ndarray, "g 4 4"],
    hooks: Bool[np.ndarray, " g"],
    handle: Handle,
    is_free: PathCheck,
) -> Int[np.ndarray, " g"]:
    """Number the hooks by free slides between them; each other grasp gets a number of its own."""
    away = Ts[:, :3, 3] - handle.grip
    along = away @ handle.long
    across = away - along[:, None] * handle.long
    keys = np.round(np.column_stack([Ts[:, :3, :3].reshape(-1, 9), across]), _DIGITS) + 0.0
    _, alike = np.unique(keys, axis=0, return_inverse=True)
    lanes = np.arange(len(Ts))
    for group in np.unique(alike[hooks]):
        mine = np.flatnonzero(hooks & (alike.ravel() == group))
        for one, next_one in pairwise(mine[np.argsort(along[mine], kind="stable")]):
            if is_free(Ts[one], Ts[next_one]):
                lanes[next_one] = lanes[one]
    return lanes


def _groups(
    hooks: Bool[np.ndarray, " g"],
    turn_lane: Int[np.ndarray, " g"],
    slide_lane: Int[np.ndarray, " g"],
) -> list[Int[np.ndarray, " k"]]:
    """Group the hooks connected by slides and turns; keep the groups with a slide."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    rows = np.flatnonzero(hooks)
    first = len(turn_lane)
    lanes = [turn_lane[rows] + first, slide_lane[rows] + first + int(turn_lane.max()) + 1]
    count = int(lanes[1].max()) + 1
    ends = np.tile(rows, 2), np.concatenate(lanes)
    joined = coo_array((np.ones(len(ends[0])), ends), (count, count))
    label = connected_components(joined, directed=False)[1][rows]
    groups = [rows[label == number] for number in np.unique(label)]
    return [group for group in groups if len(np.unique(slide_lane[group])) < len(group)]


def _slide_is_free(
    hand: HandBoxes,
    elements: tuple[Element, ...],
    held: Bool[np.ndarray, " e"],
    config: GraspConfig,
    one: Float[np.ndarray, "4 4"],
    other: Float[np.ndarray, "4 4"],
) -> bool:
    """Check that an open hand can slide between two poses and retract from anywhere between."""
    count = 1 + int(np.ceil(np.linalg.norm(other[:3, 3] - one[:3, 3]) / CHECK_STEP))
    p = np.linspace(one[:3, 3], other[:3, 3], count)
    R = np.tile(one[:3, :3], (count, 1, 1))
    return bool(stands_clear(hand, elements, held, R, p, config).all())


def _with_rests(
    motion: TaskMotion,
    rests: Int[np.ndarray, " r"],
    turn_lane: Int[np.ndarray, " g"],
    slide_lane: Int[np.ndarray, " g"],
) -> SlidingMotion:
    """Let the part rest at some waypoints for the steps of a slide."""
    copies = np.ones(len(motion.object_q), np.int64)
    copies[motion.waypoint_steps[rests]] += SLIDE_STATES
    old = np.repeat(np.arange(len(copies)), copies)
    first = np.cumsum(copies) - copies
    twice = np.sort(np.append(np.arange(len(motion.waypoint_steps)), rests))
    after = np.append(False, np.diff(twice) == 0)
    steps = first[motion.waypoint_steps[twice]] + SLIDE_STATES * after
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
            "turn_lane": turn_lane,
            "slide_lane": slide_lane,
            "after": after,
        }
    )
