"""Choose how far a tour opens parts, where a later task needs another value than the default.

An object deep in a fridge may be out of reach behind a door at 90 degrees and within reach behind
one that is wide open; a wide door may also keep the robot from the next task. So where the user
names no value and the tour fails, other values are tried. A search in the room without the part
first shows whether any value can help.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from momapos.core import OutOfTimeError, SceneError, Stopwatch, TaskError, time_limit
from momapos.model.records import PoseStatus, Task, is_text_of
from momapos.model.scene import Scene
from momapos.model.urdf import Articulated, opening_of
from momapos.planning.grasps import make_task

from .max_opening import MIN_TIMEOUT
from .plan import plan_placement
from .query import PlacementQuery
from .time_limit import with_note
from .tour import Request, Tour, expanded, plan_requests, scenes_of

VALUES = 8
"""Number of values between closed and wide open that are tried, 11 to 23 degrees apart [-]."""
MAX_TOURS = 4
"""Number of other tours that are planned [-]."""
UNSURE_VALUES = 2
"""Number of values that are tried if only the way to the failed task is blocked there, which the
side of the part on which the robot stands decides [-]."""
TRIED_OPENINGS = 2
"""Number of openings before a failed task whose values are tried, the last ones first [-]."""
MAX_TURN = np.pi
"""Parts without a limit are opened no farther [rad]."""
_CUT_OFF = (
    PoseStatus.NO_ROUTE, PoseStatus.NO_PASSAGE, PoseStatus.NO_ROUTE_AT_HOME,
    PoseStatus.AREA_IN_THE_WAY,
)  # fmt: skip
"""A base pose cannot be reached."""


def plan_chain(query: PlacementQuery, requests: Sequence[Request]) -> Tour:
    """Return where the robot must stand to do several tasks, and how far it opens parts.

    The tour is that of `plan_requests` if it is complete. Else openings before the failed task to
    which the user gave no value get another, the nearest to the default with which the failed task
    has a plan. The tour with the most solved tasks is returned; notes name the changed values.

    Args:
        query: The question of the first task, see `plan_requests`.
        requests: All tasks.

    Raises:
        TaskError: A request makes no sense in the scene at its turn, or there are too many.
        SceneError: The robot collides at its start pose.
        UnknownNameError: There is no such object or joint.
        OutOfTimeError: The time was over before the first task had an answer.
    """
    requests = expanded(requests, query.scene)
    with query.in_time():
        best = plan_requests(query, requests)
    began = query.watch.clock() - best.seconds
    chain = _Chain(query, tuple(requests), began)
    if len(requests) > 1 and _fails(best, requests):
        with suppress(OutOfTimeError), time_limit(chain.left, query.watch.clock):
            for other in islice(chain.others(len(best.steps) - 1), MAX_TOURS):
                tour = chain.plan(other)
                if _done(tour) > _done(best):
                    best = tour
                if not _fails(tour, requests):
                    break
    return replace(best, seconds=query.watch.clock() - began)


def _done(tour: Tour) -> int:
    return sum(step.plan.feasible for step in tour.steps)


def _fails(tour: Tour, requests: Sequence[Request]) -> bool:
    """Return whether a task has no plan, and time was not the reason."""
    return tour.steps[-1].plan.status == "infeasible" and _done(tour) < len(requests)


@dataclass(frozen=True)
class _Other:
    """Another value for an opening of a tour."""

    opening: int
    """Its index among the requests."""
    value: float
    """[rad] or [m]."""


@dataclass(frozen=True)
class _Chain:
    """The tasks of a tour, whose openings may change."""

    query: PlacementQuery
    requests: tuple[Request, ...]
    began: float
    """Time on the query's clock [s]."""

    @property
    def left(self) -> float:
        """Return the time left for the tour [s]."""
        return self.query.config.timeout - (self.query.watch.clock() - self.began)

    def with_value(self, other: _Other) -> list[Request]:
        """Return the requests with another value for an opening."""
        requests = [*self.requests]
        requests[other.opening] = requests[other.opening]._replace(to=other.value)
        return requests

    def plan(self, other: _Other) -> Tour:
        """Plan the tour with another value, which a note names."""
        k, config = other.opening, replace(self.query.config, timeout=self.left)
        tour = plan_requests(replace(self.query, config=config), self.with_value(other))
        if k >= len(tour.steps) or not tour.steps[k].plan.feasible:
            return tour
        steps, later = list(tour.steps), self.requests[k + 1]
        usual = scenes_of(self.query.scene, self.requests)[k][1].to
        words = [steps[k].value_words(value) for value in (other.value, usual or 0.0)]
        note = f"opened to {words[0]}, not to {words[1]}, for {later.verb} {later.object}"
        steps[k] = with_note(steps[k].with_notes(), note)
        return replace(tour, steps=tuple(steps))

    def others(self, failed: int) -> Iterator[_Other]:
        """Yield other values with which a failed task, or the one after it, may have a plan.

        Args:
            failed: Its index among the requests; if it is an opening, a smaller value may do.
        """
        tried = 0
        for k in range(failed, -1, -1):
            needs_it = failed if k < failed else k + 1
            if tried == TRIED_OPENINGS or needs_it >= len(self.requests):
                continue
            if self._may_change(k, needs_it) and self._helps(k, needs_it):
                tried += 1
                yield from self._values(k, needs_it, shorter=k == failed)

    def _may_change(self, k: int, task: int) -> bool:
        """Return whether a request opens a part to no given value, and it is open at a task."""
        request = self.requests[k]
        if request.verb != "open" or request.to is not None:
            return False
        part = self._part(k)
        return all(self._part(i) != part for i in range(k + 1, task))

    def _part(self, k: int) -> tuple[str, str | None]:
        _, task = scenes_of(self.query.scene, self.requests)[k]
        return task.object, task.joint

    def _helps(self, k: int, task: int) -> bool:
        """Return whether the task may have a plan if the part does not stand in its way."""
        name, joint = self._part(k)
        if joint is None or self._part(task) == (name, joint):
            return True
        scene, _ = scenes_of(self.query.scene, self.requests)[task]
        return self._may_solve(task, without_part(scene, name, joint)) is not False

    def _values(self, k: int, task: int, *, shorter: bool) -> Iterator[_Other]:
        """Yield values of an opening with which a task may have a plan, the most probable first.

        Args:
            k: Index of the opening among the requests.
            task: Index of the task.
            shorter: Whether the part opens less wide than usual, since it does not open that wide.
        """
        scene, opening = scenes_of(self.query.scene, self.requests)[k]
        unsure = []
        for value in _nearest_first(scene, opening, shorter=shorter):
            other = _Other(k, value)
            try:
                changed = scenes_of(self.query.scene, self.with_value(other))
            except TaskError:  # the part meets the floor, for example
                continue
            if self.left < MIN_TIMEOUT:
                return
            sure = self._may_solve(task, changed[task][0])
            if sure:
                yield other
            elif sure is None:
                unsure.append(other)
        yield from unsure[:UNSURE_VALUES]

    def _may_solve(self, k: int, scene: Scene) -> bool | None:
        """Return whether a task has a plan in a scene; None if only the way there is blocked."""
        config = replace(self.query.config, timeout=max(self.left, MIN_TIMEOUT), base="fixed")
        request = self.requests[k]
        if request.verb == "place":
            request = request._replace(to=None)
        query = replace(
            self.query, scene=scene, task=make_task(scene, *request), config=config, start=None,
            watch=Stopwatch(self.query.watch.clock),
        )  # fmt: skip
        try:
            plan = plan_placement(query).plan
        except SceneError:  # the part covers the start
            return None
        if plan.status != "infeasible":
            return True
        cut_off = any(is_text_of(word, _CUT_OFF) for word in plan.candidates.rejections)
        return None if cut_off else False


def _nearest_first(scene: Scene, opening: Task, *, shorter: bool) -> list[float]:
    """Return values to which a part may be opened, those nearest to the task's first.

    Of two that are equally near, the wider one comes first [rad] or [m].

    Args:
        scene: The scene.
        opening: The task.
        shorter: Whether only values short of the task's count.
    """
    assert opening.joint is not None
    assert opening.to is not None
    item = scene.object(opening.object)
    limits = opening_of(item.model, opening.joint)
    start, sign = item.values()[opening.joint], limits.sign
    ahead = min(sign * (limits.wide - start), MAX_TURN)
    values = start + sign * ahead * np.arange(1, VALUES + 1) / VALUES
    apart = np.abs(values - opening.to)
    short = sign * (opening.to - values) > 0.0
    values = values[(apart > ahead / (2 * VALUES)) & (short | (not shorter))]
    order = np.lexsort((-sign * values, np.abs(values - opening.to).round(6)))
    return values[order].tolist()


def without_part(scene: Scene, name: str, joint: str) -> Scene:
    """Return a scene without the shapes of a part and of what it carries, which shows what is out
    of reach however the part stands.

    Args:
        scene: The scene.
        name: The object.
        joint: The joint of its part.
    """
    item = scene.object(name)
    model, moved = item.model, set(item.model.moved_by(joint))
    links = {
        link: replace(body, collisions=(), visuals=()) if link in moved else body
        for link, body in model.urdf.links.items()
    }
    bare = Articulated(replace(model.urdf, links=links), model.held, None, model.closed)
    changed = replace(item, model=bare)
    return replace(scene, objects=tuple(changed if o is item else o for o in scene.objects))
