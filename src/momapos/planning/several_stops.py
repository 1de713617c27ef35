"""Open or close a part from several base poses, one after the other.

At each stop the hand moves the part a stretch of the way and lets go; the arm returns home, the
base drives to the next stop, and the hand takes hold again or pushes from inside. Each stretch is a
task as usual, from a part that stands ajar.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from momapos.core import OutOfTimeError
from momapos.core.geometry import pose_planar
from momapos.model.records import Hold, Motion, PlacementPlan
from momapos.model.scene import scene_after, stays_in_place

from .max_opening import MIN_TIMEOUT, answer_on_watch, by_samples, last_that_works
from .query import PlacementQuery
from .result import Answer, PlacementResult

if TYPE_CHECKING:
    from jaxtyping import Float

MAX_STOPS = 3
"""Largest number of stops [-]."""
STRETCHES = 8
"""The part is let go at a multiple of this share of its way [-]."""


@dataclass(frozen=True, eq=False)
class Stops:
    """The stops of one opening, and how far they move the part."""

    answer: PlacementResult | None
    """The answer for the task's value, if there is one."""
    stretches: tuple[PlacementResult, ...] = ()
    """The answers of the longest stretches, in order, without one to the task's value."""
    refused: PlacementResult | None = None
    """The answer for a farther stretch that has no plan; None if none was asked."""


def plan_in_stretches(
    query: PlacementQuery, infeasible: PlacementResult, answer: Answer, *, how_far: bool = False
) -> Stops:
    """Plan the fewest stops that move a part to the task's value, at most `MAX_STOPS`.

    Each stretch but the last is the longest that one base pose serves: what a shorter one leaves is
    never easier.

    Args:
        query: The question.
        infeasible: Its answer from one base pose.
        answer: Answers a question from one base pose.
        how_far: Whether to find out how far the last of too few stops moves the part.
    """
    task, at = query.task, query
    legs: list[PlacementResult] = []
    refused = None
    if task.joint is None or task.to is None or infeasible.prepared.blocked:
        return Stops(None)
    while len(legs) < MAX_STOPS:
        again = query.config.motion.home_again
        last = _leg(query, at, task.to, answer, again=again) if legs else None
        if last is not None and _can_be_joined(last):
            return Stops(_joined(query, infeasible, [*legs, last]), tuple(legs))
        if len(legs) + 1 == MAX_STOPS and not how_far:
            break
        # Where the base goes afterwards concerns the last stop.
        leg, refused = _longest(query, replace(at, final_check=None), answer)
        refused = refused or last
        if leg is None:
            break
        legs.append(leg)
        at = _after(at, leg)
    return Stops(None, tuple(legs), refused)


def _after(query: PlacementQuery, leg: PlacementResult) -> PlacementQuery:
    """Return the question that is left after a stretch."""
    done, base = leg.plan.task, leg.plan.base_pose
    return replace(query, scene=scene_after(query.scene, done), start=np.array(base))


def _longest(
    query: PlacementQuery, at: PlacementQuery, answer: Answer
) -> tuple[PlacementResult | None, PlacementResult | None]:
    """Find the longest stretch that one base pose serves, from short ones on.

    Returns:
        Its answer, and that for the shortest stretch without a plan; None for none.
    """
    values, refused = _values(query, at), None

    def reaches(index: int) -> PlacementResult | None:
        nonlocal refused
        leg = _leg(query, at, float(values[index]), answer, again=True)
        if leg is not None and _can_be_joined(leg):
            return leg
        refused = leg
        return None

    # A short stretch shows whether the part can be taken at all, and many are short.
    _, best = last_that_works(reaches, -1, len(values), first_step=1)
    return best, refused


def _values(query: PlacementQuery, at: PlacementQuery) -> Float[np.ndarray, " k"]:
    """Return the values between where the part is and its goal at which it stays if let go."""
    task = query.task
    assert task.joint is not None
    assert task.to is not None
    target = at.scene.object(task.object)
    start = query.scene.object(task.object).values()[task.joint]
    now = target.values()[task.joint]
    every = np.linspace(start, task.to, STRETCHES + 1)[1:-1]
    beyond = every[(every - now) * np.sign(task.to - start) > 1e-9]
    return beyond[stays_in_place(target, task.joint, beyond, query.config.motion.grasps.resistance)]


def _leg(
    query: PlacementQuery, at: PlacementQuery, to: float, answer: Answer, *, again: bool
) -> PlacementResult | None:
    """Return the answer for a stretch; None if the time is up.

    Args:
        query: The whole question, whose stopwatch counts.
        at: The question that is left.
        to: Where the stretch ends [rad] or [m].
        answer: Answers a question.
        again: Whether the arm returns home.
    """
    left = query.config.timeout - query.watch.total
    if left < MIN_TIMEOUT:
        return None
    config = by_samples(replace(query.config, timeout=left))
    config = replace(config, motion=replace(config.motion, home_again=again))
    task = replace(query.task, to=to, farthest=False)
    try:
        return answer_on_watch(query, replace(at, task=task, config=config), answer)
    except OutOfTimeError:
        return None


def _can_be_joined(leg: PlacementResult) -> bool:
    """Return whether an answer has a motion that can be a stretch of several."""
    motion = leg.plan.motion
    can_be_joined = motion is not None and motion.latch_q is None and motion.base is None
    return can_be_joined and leg.plan.base_path is not None


def _joined(
    query: PlacementQuery, infeasible: PlacementResult, legs: list[PlacementResult]
) -> PlacementResult | None:
    """Join the stretches into one answer; None if the exact check rejects it."""
    motion, first = _joined_motion(legs), legs[0].plan
    assert first.base_pose is not None
    if infeasible.prepared.violation(np.array(first.base_pose), motion) is not None:
        return None
    loads = infeasible.prepared.verifier.loads(first.base_pose, motion)
    plan = replace(
        first,
        task=query.task,
        motion=motion,
        navigation_cost=sum(leg.plan.navigation_cost or 0.0 for leg in legs),
        cost={},
        loads=replace(loads, notes=first.loads.notes if first.loads else ()),
        scene_joints=infeasible.plan.scene_joints,
        resistance=infeasible.plan.resistance,
        key_objects=infeasible.plan.key_objects,
        timing=query.watch.timing,
    )
    return replace(legs[0], plan=plan, prepared=infeasible.prepared, query=query)


def _joined_motion(legs: list[PlacementResult]) -> Motion:
    """Return one motion of several stretches; between them the base drives with the arm at home."""
    phases: list[_Phase] = []
    holds: list[Hold] = []
    for leg in legs:
        phases += _to_grasp(leg.plan) if phases else []
        motion, base = _known(leg.plan)
        begin = sum(len(phase.q) for phase in phases)
        holds += [replace(h, first=h.first + begin, last=h.last + begin) for h in motion.grasps]
        phases.append(_Phase.at(base, motion.q, motion.object_q))
        if leg is not legs[-1]:
            assert motion.home is not None
            phases.append(_Phase.at(base, motion.home, motion.object_q[-1]))
    q, object_q, bases = (np.concatenate(parts) for parts in zip(*phases, strict=True))
    bases[:, 2] = np.unwrap(bases[:, 2])
    chain = legs[0].prepared.robot.chain
    Ts_world_tool = pose_planar(bases) @ chain.tool_poses(chain.freedom_values(q))
    approach, home = _known(legs[0].plan)[0].approach, _known(legs[-1].plan)[0].home
    return Motion(
        approach, q, object_q, Ts_world_tool, holds=tuple(holds), home=home, base=bases
    )  # fmt: skip


class _Phase(NamedTuple):
    """Consecutive states of a motion."""

    q: Float[np.ndarray, "m n"]
    object_q: Float[np.ndarray, " m"]
    bases: Float[np.ndarray, "m 3"]

    @classmethod
    def at(
        cls,
        base: tuple[float, float, float] | Float[np.ndarray, "m 3"],
        q: Float[np.ndarray, "#m n"],
        object_q: float | Float[np.ndarray, " m"],
    ) -> _Phase:
        """Build a phase; what is given once is the same at all its states."""
        count = max(len(q), len(np.atleast_2d(base)))
        return cls(
            np.broadcast_to(q, (count, q.shape[1])),
            np.broadcast_to(object_q, count),
            np.broadcast_to(base, (count, 3)),
        )


def _known(plan: PlacementPlan) -> tuple[Motion, tuple[float, float, float]]:
    """Return the motion and the base pose of a solved plan."""
    assert plan.motion is not None
    assert plan.base_pose is not None
    return plan.motion, plan.base_pose


def _to_grasp(plan: PlacementPlan) -> list[_Phase]:
    """Return the drive to a stop and the approach there, while the part rests."""
    motion, base = _known(plan)
    assert plan.base_path is not None
    rests = float(motion.object_q[0])
    return [
        _Phase.at(plan.base_path, motion.approach[:1], rests),
        _Phase.at(base, motion.approach, rests),
    ]
