"""Check the path of the moved part through the scene and above the floor.

Real scenes are imprecise: doors are flush with their neighbors, drawers touch their frames, an
object leans on a front. So the scene as given is the reference, and the part must not overlap
anything more deeply than there, nor extend deeper below the floor. Elements of the part's own
object may touch the part as deep as they do where it is closed, and somewhat deeper at a hinge.
So may the bodies of a part that move against each other, such as the leaves of a folding door.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import contact_text, owner_cache
from momapos.core.geometry import apply, invert
from momapos.model.records import Task
from momapos.model.scene import Scene, SceneObject

from .convex import overlap
from .exact_shapes import Shapes, hulls_of, join, link_of_label, triangle_shapes
from .moved_part import (
    MovedPart,
    OwnElements,
    moved_part,
    split,
    split_object,
    way_of,
    within_part,
)
from .report import DEFAULT, Limits
from .sweep import Overlaps, all_pairs, deepest

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int


MAX_DIP = 1e-3
"""A part that extends less below the floor slides along it, as a drawer of a base cabinet [m]."""
TOUCH = 1e-5
"""Depth at which a part that would extend deeper meets the floor [m]."""
LIFT_STEP = 0.002
"""Distance between the places at which an object on its way is checked [m]."""
SHORT_TRAVEL = 0.05
"""Motions up to this length are stated in tenths of millimeters [m]."""
_FINE_STEPS = 33
"""Number of states between two states of a sweep, among which the contact is found [-]."""


def depths_below_floor(
    shapes: Shapes, Ts: Float[np.ndarray, "s k 4 4"]
) -> Float[np.ndarray, "s k"]:
    """Return how far each shape extends below z = 0 [m]; 0 if it is above.

    Args:
        shapes: The shapes.
        Ts: Their world poses.
    """
    extent = np.einsum("skj,kj->sk", np.abs(Ts[..., 2, :3]), shapes.half)
    low = Ts[..., 2, 3] - extent < 0.0
    depth = np.zeros(low.shape)
    for index in np.flatnonzero(low.any(0)).tolist():
        rows = np.flatnonzero(low[:, index])
        T = Ts[rows, index, 2]
        bottom = (T[:, :3] @ shapes.outline(index).T).min(1) + T[:, 3] - shapes.ball[index]
        depth[rows, index] = np.maximum(-bottom, 0.0)
    return depth


def dips(part: MovedPart, Ts: Float[np.ndarray, "s k 4 4"]) -> Float[np.ndarray, " s"]:
    """Return how far a part extends below the floor, minus the same in the given scene [m].

    Args:
        part: The part.
        Ts: World poses of its shapes.
    """
    given = depths_below_floor(part.shapes, part.placed(np.array([part.start])))
    depths = depths_below_floor(part.shapes, Ts).max(1, initial=0.0)
    return np.asarray(depths - given.max(initial=0.0))


def floor_contact(part: MovedPart, goal: float, step: float) -> tuple[float, str] | None:
    """Return at which value a part meets the floor, and its shape that does.

    Args:
        part: The part.
        goal: Value at the end of its motion [rad] or [m].
        step: Largest step between the values to check [rad] or [m].

    Returns:
        The value and the name of the shape; None if the part stays above the floor.
    """
    values = np.linspace(part.start, goal, max(2, math.ceil(abs(goal - part.start) / step) + 1))
    depths = dips(part, part.placed(values))
    if not (depths > MAX_DIP).any():
        return None
    state = int(np.argmax(depths > TOUCH))
    fine = np.linspace(values[state - 1], values[state], _FINE_STEPS)
    Ts = part.placed(fine)
    first = int(np.argmax(dips(part, Ts) > TOUCH))
    lowest = int(depths_below_floor(part.shapes, Ts[first : first + 1])[0].argmax())
    return float(fine[first]), part.shapes.names[lowest]


def meets_floor_at(item: SceneObject, joint: str, goal: float) -> float | None:
    """Return the value of a joint at which its part meets the floor; None if it never does.

    Args:
        item: The object, as it is in the scene.
        joint: The joint, which is no mimic joint.
        goal: Value at the end of its motion [rad] or [m].
    """
    contact = floor_contact(
        moved_part(item, Task("open", item.name, joint, goal)), goal, DEFAULT.step
    )
    return None if contact is None else contact[0]


TOUCHING = -1e-3
"""Depth from which two elements of an object touch: 1 mm apart [m]."""
HINGE_RADIUS = 0.06
"""Half the edge of the square around a hinge's axis in which the part may turn into its own object:
knuckles and the bows of a door's edge lie within it [m]."""
MODEL_ERROR = 0.025
"""How much deeper a part may get into its own object there. The doors of `Kitchen.json` that share
a hinge line get 19.5 mm into each other's hulls [m]."""
_CHUNK = 1000
"""Number of shapes whose boxes are computed together [-]."""
FINER_STEPS = 4
"""The part's own path is sampled so many times as finely as a motion: it is checked once for a
task, and thin panels pass each other within 5 mm [-]."""
MAX_THROUGH = 0.9
"""Largest share of its thickness by which a panel may be in another one [-]."""
MAX_SURFACE_PAIRS = 1_000_000
"""Largest number of close pairs of triangles of two elements; if there are more, their hulls decide
[-]."""


@dataclass(frozen=True, eq=False)
class PartSweepCheck:
    """A part, its obstacles, and the allowed overlap of each pair of their shapes.

    The obstacles of the scene are checked for each scene; those of the part's own object are checks
    of their own, which all scenes with that object share.
    """

    part: MovedPart
    moving: Shapes
    """The shapes of the part, and triangles of some of them, by the body that carries each."""
    fixed: Shapes
    """The obstacles, and triangles of some of them, in the frame in which they stand still."""
    pairs: Int[np.ndarray, "p 2"]
    """Indices into the moving and the fixed shapes."""
    already: Float[np.ndarray, " p"]
    """Overlap of each pair to subtract, as the given scene has it [m]."""
    limits: Limits
    own: tuple[PartSweepCheck, ...] = ()
    """Checks against the rest of the part's object, and of each of its bodies against another one,
    in whose frame that one stands still."""

    def placed(
        self, values: Float[np.ndarray, " s"], latch_q: Float[np.ndarray, " s"] | None = None
    ) -> Float[np.ndarray, "s k 4 4"]:
        """Return poses of the moving shapes at values of joint and latch."""
        return self.moving.placed(self.part.poses(values, latch_q))

    def depths(self, value: float, floor: float) -> Float[np.ndarray, " p"]:
        """Return the overlap of each pair at a value of the joint, at least a floor [m]."""
        Ts, fixed = self.placed(np.array([value])), self.fixed
        return deepest(self.moving, Ts, fixed, fixed.Ts_body_shape[None], self.pairs, floor)[0]

    def path(self, goal: float) -> Float[np.ndarray, " s"]:
        """Return values of the joint, or heights, from the start to a goal, closely spaced."""
        span, step = goal - self.part.start, self.limits.step / FINER_STEPS
        count = max(2, math.ceil(abs(span) / step) + 1)
        return np.linspace(self.part.start, goal, count)

    def take(self, index: Int[np.ndarray, " q"]) -> PartSweepCheck:
        """Return the check of some of the pairs."""
        return replace(self, pairs=self.pairs[index], already=self.already[index])

    def first_hit(self, goal: float) -> str | None:
        """Return the first collision of the part on the path to a joint value (or a lift).

        Args:
            goal: Joint value [rad] or [m]; without a joint, the height of the lift [m].

        Returns:
            A description; None if the path is free.
        """
        values = self.path(goal)
        first = len(values), ""
        for check in (self, *self.own):
            first = check._first_overlap(goal, first)
        value = float(values[min(first[0], len(values) - 1)])
        contact = floor_contact(self.part, value, self.limits.step)
        if contact is not None:
            value, name = contact
            return f"{name} meets the floor {self._at(value, goal)}"
        return f"{first[1]} {self._at(value, goal)}" if first[1] else None

    def _first_overlap(self, goal: float, first: tuple[int, str]) -> tuple[int, str]:
        """Return the first state with a collision and its words, or those of an earlier one."""
        hits = np.flatnonzero(self.excess(goal) > 0.0)
        if not len(hits):
            return first
        values, deep = self.path(goal), self.excess(goal) + self.limits.penetration
        Ts = self.placed(values, self.part.turned(len(values)))
        for pair in hits.tolist():
            earlier = self._first_state(pair, Ts[: first[0]])
            if earlier is not None:
                i, j = self.pairs[pair]
                names = self.moving.names[i], self.fixed.names[j]
                first = earlier, f"{contact_text(*names, float(deep[pair]))} at worst, first"
        return first

    @cached_property
    def on_task(self) -> Overlaps:
        """Return what the part overlaps on the path to the task's goal, with the latch turned."""
        values, found = self.path(self.part.goal), Overlaps(self.limits.penetration)
        for check in (self, *self.own):
            depth, state = check.to_goal
            found.collect(
                check.moving, check.fixed, check.pairs, depth - check.already, state,
                lambda state: f"object_q {values[state]:.3f}",
            )  # fmt: skip
        return found

    @cached_property
    def to_goal(self) -> tuple[Float[np.ndarray, " p"], Int[np.ndarray, " p"]]:
        """Return the deepest overlap of each pair on the path to the task's goal, and its state."""
        return self._to(self.part.goal)

    def _to(self, goal: float) -> tuple[Float[np.ndarray, " p"], Int[np.ndarray, " p"]]:
        values, fixed = self.path(goal), self.fixed
        Ts = self.placed(values, self.part.turned(len(values)))
        floor = min(0.0, self.limits.penetration)
        return deepest(self.moving, Ts, fixed, fixed.Ts_body_shape[None], self.pairs, floor)

    def excess(self, goal: float) -> Float[np.ndarray, " p"]:
        """Return how much deeper than allowed each pair gets on the path to a joint value [m]."""
        depth, _ = self.to_goal if goal == self.part.goal else self._to(goal)
        return np.asarray(depth - self.already - self.limits.penetration)

    def overlaps(
        self, Ts_body: Float[np.ndarray, "s b 4 4"], where: Callable[[int], str]
    ) -> Overlaps:
        """Return what the part overlaps more than allowed.

        Args:
            Ts_body: World poses of the part's bodies.
            where: Names a state by its index.
        """
        found = Overlaps(self.limits.penetration)
        for check in (self, *self.own):
            moving, fixed = check.moving, check.fixed
            Ts = moving.placed(check.part.paths.in_frame(Ts_body))
            found.add(
                moving, Ts, fixed, fixed.Ts_body_shape[None], check.pairs, where,
                already=check.already,
            )  # fmt: skip
        return found

    @property
    def sunk_into(self) -> tuple[str, ...]:
        """Return the links of its own object that a pressed part gets deeper into than others may.

        These have no hole in the model, see `_contacts`.
        """
        links = dict[str, None]()
        for check in self.own:
            depth, _ = check.to_goal
            start = check.depths(check.part.start, check.limits.penetration)
            deeper = np.maximum(depth, 0.0) - np.maximum(start, 0.0) > check.limits.penetration
            links |= dict.fromkeys(
                link_of_label(check.fixed.names[j]) for j in check.pairs[deeper, 1].tolist()
            )
        return tuple(links)

    def obstructions(self, goal: float) -> frozenset[str]:
        """Return the links, as object/link, that the part hits on the path to a joint value."""
        return frozenset(
            link_of_label(check.fixed.names[j])
            for check in (self, *self.own)
            for j in check.pairs[check.excess(goal) > 0.0, 1].tolist()
        )

    def _first_state(self, pair: int, Ts: Float[np.ndarray, "s k 4 4"]) -> int | None:
        """Return the first state at which a pair overlaps too deeply, if there is one."""
        i, j = self.pairs[pair].tolist()
        a, b = self.moving.core(i), self.fixed.core(j)
        allowed = self.limits.penetration + self.already[pair]
        Ts_b_a = invert(self.fixed.Ts_body_shape[j]) @ Ts[:, i]
        deep = (overlap(a, b, np.ascontiguousarray(T)) > allowed for T in Ts_b_a)
        return next((state for state, hits in enumerate(deep) if hits), None)

    def _at(self, value: float, goal: float) -> str:
        start, joint = self.part.start, self.part.joint
        if joint is None:
            how = "moved" if self.part.way[:, :2].any() else "lifted"
            return f"when {how} by {value:.2f} of {goal:.2f} m"
        if joint.kind == "prismatic":
            digits = 2 if abs(goal - start) > SHORT_TRAVEL else 4
            here, begin, end = (f"{x:.{digits}f}" for x in (value, start, goal))
            return f"at {here} m, moving from {begin} to {end} m"
        v, a, b = (round(math.degrees(x)) for x in (value, start, goal))
        return f"at {v} deg, moving from {a} to {b} deg"


def part_sweep_check(
    part: MovedPart, fixed: Shapes, own: OwnElements, limits: Limits
) -> PartSweepCheck:
    """Find which shapes the part touches in the given scene.

    Args:
        part: The moved part.
        fixed: All other shapes, in world coordinates.
        own: The elements of the same object; see `own_contacts`.
        limits: Allowed overlap, also relative to the given scene.
    """
    others = np.delete(np.arange(len(fixed)), np.arange(len(own.standing)) + own.first)
    pairs = all_pairs(len(part.shapes), len(others))
    pairs[:, 1] = others[pairs[:, 1]]
    check = PartSweepCheck(part, part.shapes, fixed, pairs, np.zeros(len(pairs)), limits)
    floor = limits.penetration - limits.deeper
    mine = () if part.joint is None else own_contacts(own.item, own.task, limits)
    return replace(check, already=check.depths(part.start, floor) - floor, own=mine)


@owner_cache()
def own_contacts(item: SceneObject, task: Task, limits: Limits) -> tuple[PartSweepCheck, ...]:
    """Return the checks of a part against its own object and itself, cached for all its scenes.

    The part may overlap its object as it does in the given scene or where it is closed. A mesh is
    decided by its triangles where its hull would say more. Where the part turns into its object at
    a hinge, or slides along what it overlaps at rest, models are not exact.
    """
    part, own = split_object(item, task)
    named = replace(own, standing=join([own.standing], [f"{item.name}/"]))
    return tuple(_contacts(*one, limits) for one in ((part, named), *within_part(part, own)))


def _contacts(part: MovedPart, own: OwnElements, limits: Limits) -> PartSweepCheck:
    """Return the check of a part against what stands still in a frame, see `own_contacts`."""
    pairs = all_pairs(len(part.shapes), len(own.standing))
    check = PartSweepCheck(part, part.shapes, own.standing, pairs, np.zeros(len(pairs)), limits)
    element, loose = own.of_standing[pairs[:, 1]], own.loose[own.of_part[pairs[:, 0]]]
    resting = _resting(check, own.displaced[element] | loose)
    error = _model_error(resting, own.movable[element] | loose)
    if own.task.verb == "press":  # a button sinks into its plate, whose model often has no hole
        error[(resting > TOUCHING) & ~own.movable[element]] = MODEL_ERROR
    check = replace(check, already=_allowed(check, resting, error))
    suspects = (resting > limits.deeper) | (check.excess(part.goal) > 0.0)
    if suspects.any():
        check, resting = _surfaces(check, resting, own, np.flatnonzero(suspects))
        check = _with_bearings(check, resting)
    return check


def _resting(check: PartSweepCheck, given: Bool[np.ndarray, " p"]) -> Float[np.ndarray, " p"]:
    """Return how deep pairs overlap in the given scene, or if more, where the part is closed [m].

    Only the given scene counts where another joint has moved the obstacle from rest, and for what
    rests on the part: these may hit each other where the part is closed.
    """
    part, floor = check.part, min(TOUCHING, check.limits.penetration - check.limits.deeper)
    depth = check.depths(part.start, floor)
    if part.rest == part.start:
        return depth
    closed = check.depths(part.rest, floor)
    return np.where(given, depth, np.maximum(depth, closed))


def _allowed(
    check: PartSweepCheck, resting: Float[np.ndarray, " p"], error: Float[np.ndarray, " p"]
) -> Float[np.ndarray, " p"]:
    """Return the overlap to subtract for pairs that rest so deep in each other [m].

    A thin panel must not get deeper than half its thickness, nor almost through: it would come out
    on the other side.

    Args:
        check: The pairs.
        resting: Overlap of each pair at rest [m].
        error: How wrong the model is there at least, see `_model_error` [m].
    """
    limits, (i, j) = check.limits, check.pairs.T
    floor = limits.penetration - limits.deeper
    thin = np.minimum(_half_thickness(check.moving)[i], _half_thickness(check.fixed)[j])
    through = np.maximum(2.0 * MAX_THROUGH * thin - np.maximum(resting, 0.0), 0.0)
    deeper = np.where(
        error > limits.deeper,
        limits.deeper + error,
        np.minimum(np.minimum(limits.deeper, thin), through),
    )
    return np.maximum(resting, floor) - floor - (limits.deeper - deeper)


def _model_error(
    resting: Float[np.ndarray, " p"], movable: Bool[np.ndarray, " p"]
) -> Float[np.ndarray, " p"]:
    """Return how much deeper pairs may get, given their overlap at rest [m].

    Where the closed part overlaps the body of its object, the model is wrong by that much at least.
    Parts that move, too, are no bearings.
    """
    return np.where(movable, 0.0, np.clip(resting, 0.0, MODEL_ERROR))


def _half_thickness(shapes: Shapes) -> Float[np.ndarray, " k"]:
    """Return half the thickness of each shape [m]; infinite for triangles, which have none."""
    return np.where(np.diff(shapes.first) == 3, np.inf, shapes.half.min(1))


def _surfaces(
    check: PartSweepCheck,
    resting: Float[np.ndarray, " p"],
    own: OwnElements,
    suspects: Int[np.ndarray, " q"],
) -> tuple[PartSweepCheck, Float[np.ndarray, " r"]]:
    """Replace pairs of hulls by pairs of triangles where a hull that bridges space would decide.

    A triangle that the part crosses in the given scene is where the part comes out of its object.

    Returns:
        The check, and the overlap of each of its pairs at rest [m].
    """
    element = own.of_standing[check.pairs[:, 1]]
    dropped = np.zeros(len(check.pairs), bool)
    added = [(check.pairs[:0], resting[:0])]
    moving, fixed = check.moving, check.fixed
    for i, e in sorted({(int(check.pairs[p, 0]), int(element[p])) for p in suspects}):
        a, b = own.surface(int(own.of_part[i])), own.surface(e)
        coarse = (check.pairs[:, 0] == i) & (element == e)
        if a is None and b is None:
            continue
        found = _triangle_pairs(check, i, check.pairs[coarse, 1], a, b)
        if found is None:
            continue
        dropped |= coarse
        one, other, near = found
        pairs = near + np.array([len(moving), len(fixed)])
        moving, fixed = _appended(moving, one), _appended(fixed, other)
        fine = replace(check, moving=moving, fixed=fixed, pairs=pairs, already=np.zeros(len(pairs)))
        given = own.displaced[e] | own.loose[own.of_part[i]]
        depth = _resting(fine, np.repeat(given, len(pairs)))
        kept = depth <= check.limits.deeper
        deepest_rest = min(float(depth.max(initial=0.0)), MODEL_ERROR)
        added.append((pairs[kept], np.full(int(kept.sum()), deepest_rest)))
    depth = np.concatenate([d for _, d in added])
    pairs = np.concatenate([p for p, _ in added])
    fine = replace(check, moving=moving, fixed=fixed, pairs=pairs, already=np.zeros(len(depth)))
    already = _allowed(fine, depth, np.zeros(len(depth)))
    fine = replace(
        fine,
        pairs=np.concatenate([check.pairs[~dropped], fine.pairs]),
        already=np.concatenate([check.already[~dropped], already]),
    )
    return fine, np.concatenate([resting[~dropped], depth])


def _triangle_pairs(
    check: PartSweepCheck,
    i: int,
    obstacles: Int[np.ndarray, " o"],
    a: Float[np.ndarray, "t 3 3"] | None,
    b: Float[np.ndarray, "u 3 3"] | None,
) -> tuple[Shapes, Shapes, Int[np.ndarray, "p 2"]] | None:
    """Return the triangles of two elements that come close, and their pairs.

    Args:
        check: The check of the hulls.
        i: The moving element.
        obstacles: The fixed element, or its pieces.
        a: Triangles of the moving element in the world; None if it is convex.
        b: The same of the fixed element.

    Returns:
        None if there are too many pairs.
    """
    part = check.part
    values = check.path(part.goal)
    Ts_body = part.poses(values, part.turned(len(values)))
    one = check.moving.take(np.array([i]))
    body, name = int(one.body[0]), link_of_label(one.names[0])
    lows, highs = _boxes_of(one, Ts_body)
    if b is None:
        other = check.fixed.take(obstacles)
        low, high = _boxes_of(other, np.eye(4)[None, None])
    else:
        low, high = b.min(1), b.max(1)
        kept = ((lows <= high) & (low <= highs)).all(1)
        b, low, high = b[kept], low[kept], high[kept]
        other = triangle_shapes(b, 0, link_of_label(check.fixed.names[obstacles[0]]))
    if a is not None and len(other):
        T_body_world = invert(part.poses(np.array([part.start]))[0, body])
        local = np.asarray(apply(T_body_world, a.reshape(-1, 3))).reshape(-1, 3, 3)
        one = triangle_shapes(local, body, name)
        lows, highs = _boxes_of(one, Ts_body)
    pairs = _meeting(lows, highs, low, high)
    if pairs is None:
        return None
    used, new = np.unique(pairs[:, 0], return_inverse=True)
    met, now = np.unique(pairs[:, 1], return_inverse=True)
    return one.take(used), other.take(met), np.column_stack([new, now])


def _meeting(
    lows: Float[np.ndarray, "k 3"],
    highs: Float[np.ndarray, "k 3"],
    low: Float[np.ndarray, "o 3"],
    high: Float[np.ndarray, "o 3"],
) -> Int[np.ndarray, "p 2"] | None:
    """Return the pairs of boxes that meet, from two sets; None if there are too many."""
    if not len(low) or not len(lows):
        return np.empty((0, 2), np.int64)
    near = np.flatnonzero(((lows <= high.max(0)) & (low.min(0) <= highs)).all(1))
    found, count = [np.empty((0, 2), np.int64)], 0
    for rows in np.array_split(near, len(near) // _CHUNK + 1):
        meet = (lows[rows, None] <= high[None]) & (low[None] <= highs[rows, None])
        k, j = np.nonzero(meet.all(2))
        found.append(np.column_stack([rows[k], j]))
        count += len(k)
        if count > MAX_SURFACE_PAIRS:
            return None
    return np.concatenate(found)


def _boxes_of(
    shapes: Shapes, Ts_body: Float[np.ndarray, "s b 4 4"]
) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, "k 3"]]:
    """Return the lowest and highest corners of boxes around shapes over all states [m]."""
    low, high = np.empty((len(shapes), 3)), np.empty((len(shapes), 3))
    for rows in np.array_split(np.arange(len(shapes)), len(shapes) // _CHUNK + 1):
        Ts = Ts_body[:, shapes.body[rows]] @ shapes.Ts_body_shape[rows]
        extent = np.einsum("skij,kj->ski", np.abs(Ts[..., :3, :3]), shapes.half[rows])
        low[rows] = (Ts[..., :3, 3] - extent).min(0)
        high[rows] = (Ts[..., :3, 3] + extent).max(0)
    return low, high


def _appended(shapes: Shapes, others: Shapes) -> Shapes:
    """Return two sets of shapes as one; unlike with `join`, they keep their bodies."""
    both = join([shapes, others], ["", ""])
    return replace(both, body=np.concatenate([shapes.body, others.body]))


def _with_bearings(check: PartSweepCheck, resting: Float[np.ndarray, " p"]) -> PartSweepCheck:
    """Allow more overlap to pairs that touch at rest, at a hinge only.

    There, models are never exact. What gets too deep outside of the square around the axis of its
    hinge is a pair of its own.

    Args:
        check: The check of elements of the same object.
        resting: Overlap of each pair at rest [m].
    """
    joints = check.part.paths.joints
    turning = np.array([joint.kind != "prismatic" for joint in joints])
    hinged = turning[check.moving.body[check.pairs[:, 0]]] & (resting >= TOUCHING)
    suspects = np.flatnonzero(hinged & (check.excess(check.part.goal) > 0.0))
    if not len(suspects):
        return check
    moving, rows = check.moving, [np.empty((0, 3), np.int64)]
    for i in np.unique(check.pairs[suspects, 0]).tolist():
        outside = _beyond_hinge(check.moving, i, joints[int(check.moving.body[i])].axis)
        at = suspects[check.pairs[suspects, 0] == i]
        new = len(moving) + np.arange(len(outside))
        cut = [(k, check.pairs[p, 1], p) for p in at for k in new]
        rows.append(np.array(cut, np.int64).reshape(-1, 3))
        moving = _appended(moving, outside)
    k, j, p = np.concatenate(rows).T
    pairs, already = np.column_stack([k, j]), check.already[p]
    beyond = replace(check, moving=moving, pairs=pairs, already=already)
    beyond = beyond.take(np.flatnonzero(beyond.excess(check.part.goal) > 0.0))
    already = check.already.copy()
    already[suspects] += MODEL_ERROR - check.limits.deeper
    return replace(
        beyond,
        pairs=np.concatenate([check.pairs, beyond.pairs]),
        already=np.concatenate([already, beyond.already]),
    )


def _beyond_hinge(shapes: Shapes, i: int, axis: Float[np.ndarray, "3"]) -> Shapes:
    """Return the parts of a shape outside of the square prism around the axis of its hinge.

    Each of four planes cuts off one convex part; the axis passes through the body's origin.
    """
    points = np.asarray(apply(shapes.Ts_body_shape[i], shapes.outline(i)))
    ball = float(shapes.ball[i])
    across = points.mean(0) - (points.mean(0) @ axis) * axis
    if np.linalg.norm(across) < 1e-9:
        across = np.eye(3)[int(np.argmin(np.abs(axis)))]
        across = across - (across @ axis) * axis
    u = across / np.linalg.norm(across)
    v = np.cross(axis, u)
    parts = [_beyond(points, n, HINGE_RADIUS - ball) for n in (u, -u, v, -v)]
    parts = [part for part in parts if len(part)]
    first = np.cumsum([0, *map(len, parts)])
    found = hulls_of(
        np.concatenate([points[:0], *parts]), first, int(shapes.body[i]), shapes.names[i]
    )
    return replace(found, ball=np.full(len(parts), ball))


def _beyond(
    points: Float[np.ndarray, "n 3"], normal: Float[np.ndarray, "3"], offset: float
) -> Float[np.ndarray, "m 3"]:
    """Return points whose hull is what a plane cuts off the hull of points."""
    away = points @ normal - offset
    out, into = np.flatnonzero(away > 0.0), np.flatnonzero(away <= 0.0)
    if not len(out) or not len(into):
        return points[out]
    share = away[out, None] / (away[out, None] - away[None, into])
    crossing = points[out, None] + share[..., None] * (points[None, into] - points[out, None])
    return np.concatenate([points[out], _rim(crossing.reshape(-1, 3), normal)])


def _rim(points: Float[np.ndarray, "n 3"], normal: Float[np.ndarray, "3"]) -> np.ndarray:
    """Return the corners of the hull of points in a plane."""
    from scipy.spatial import ConvexHull, QhullError

    kept = np.argsort(np.abs(normal))[:2]
    try:
        return points[ConvexHull(points[:, kept]).vertices]
    except QhullError:  # all on one line
        return points


def obstructing_links(scene: Scene, task: Task, limits: Limits = DEFAULT) -> frozenset[str]:
    """Return the links, as object/link, that stand in the way of what a task moves."""
    part, fixed, own = split(scene, task)
    return part_sweep_check(part, fixed, own, limits).obstructions(part.goal)


def free_length(
    scene: Scene, name: str, lift: float, slide: Sequence[float] = (0.0, 0.0, 0.0)
) -> float:
    """Return how far an object can be slid and then lifted before it hits something [m].

    Args:
        scene: The scene.
        name: The object, which has no joints.
        lift: By how much it is lifted at the end [m].
        slide: By which vector it is slid before [m].
    """
    check = _loose_check(scene, name)
    check = replace(check, part=replace(check.part, way=way_of(lift, slide)))
    most = lift + float(np.linalg.norm(slide))
    lengths = np.linspace(0.0, most, max(2, math.ceil(most / LIFT_STEP) + 1))
    hits = np.flatnonzero(check.excess(most) > 0.0)
    Ts = check.placed(lengths)
    states = [check._first_state(pair, Ts) for pair in hits.tolist()]
    first = min((state for state in states if state is not None), default=len(lengths))
    return float(lengths[first - 1]) if first else 0.0


@owner_cache(8)
def _loose_check(scene: Scene, name: str) -> PartSweepCheck:
    return part_sweep_check(*split(scene, Task("pick", name)), DEFAULT)
