"""An answer: the plan, and what the search saw on the way."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from importlib import import_module
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import require, version_of
from momapos.model.records import CostTerm, PlacementPlan, Tolerance
from momapos.model.robots import Robot
from momapos.planning.grasps import slides
from momapos.planning.navigation import BasePath, outlines_after, touched_at_home
from momapos.planning.placement import OURS, Search, cost_terms

from .query import PlacementQuery
from .task_setup import PreparedTask

if TYPE_CHECKING:
    from jaxtyping import Float

DEPENDS_ON = ("momapos", "numpy", "ompl")
"""Packages that an answer depends on, beside its inputs."""


@dataclass(frozen=True)
class PlacementResult:
    """A plan, and what the search saw on the way; the latter is for pictures and benchmarks."""

    plan: PlacementPlan
    prepared: PreparedTask
    search: Search
    start: Float[np.ndarray, "3"]
    """Where the base was: x [m], y [m], yaw [rad]."""
    query: PlacementQuery | None = field(default=None, repr=False)
    """What was asked; None of a plan that was read."""

    @cached_property
    def tolerance(self) -> Tolerance | None:
        """How far beside the base pose the robot may stand, measured when it is first asked for;
        None where there is no motion, and of a plan that was read and has none."""
        return self.with_tolerance().plan.tolerance

    def with_tolerance(self) -> PlacementResult:
        """The same answer, its plan with the tolerance, as `momapos place` writes it."""
        # By name: it plans anew, so that it is downstream of answers.
        answer: PlacementResult = import_module("momapos.planning.tolerance").with_tolerance(self)
        return answer

    @property
    def slides(self) -> bool:
        """Whether the part slides [m]; it turns otherwise [rad]."""
        return slides(self.prepared.scene, self.plan.task)

    @property
    def holds(self) -> tuple[str, ...]:
        """How the plan holds what it moves, one hold after the other, and where that was found."""
        motion, found = self.prepared.motion, self.plan.motion
        if found is None:
            return ()
        if found.holds:
            return tuple(hold.words for hold in found.holds)
        away = np.abs(motion.Ts_world_tool[:, motion.grasp_step] - found.Ts_world_tool[0])
        return (motion.grasps.describe(int(away.sum((1, 2)).argmin())),)

    @property
    def touched_after(self) -> str:
        """What the robot touches where it brings its arm home after the task; "" for nothing."""
        base, robot, task = self.plan.base_pose, self.prepared.robot, self.plan.task
        if base is None or self.plan.motion is None:
            return ""
        outlines = outlines_after(self.prepared.scene, robot, task)
        return touched_at_home(np.array(base), robot, outlines)

    def __repr__(self) -> str:
        task = self.plan.task
        what = task.object if task.joint is None else f"{task.object}/{task.joint}"
        name, status = self.plan.robot_name, self.plan.status
        return f"<PlacementResult of {name}: {task.verb} {what}: {status}>"

    def _repr_png_(self) -> bytes:
        """The picture that a notebook shows."""
        # By name: what draws records is downstream of them, and is imported by nobody else.
        png: bytes = import_module("momapos.apps.plots.notebook_images").answer_png(self)
        return png

    def show(self) -> None:
        """Play the plan in a notebook, or in a browser outside of one; needs `momapos[view]`.

        Raises:
            InputError: The plan is not solved.
            MissingExtraError: viser is not installed.
        """
        with require("view"):
            page = import_module("momapos.apps.web.notebook_page")
        page.show(self)


def cheapest(results: Sequence[PlacementResult], *, farthest: bool = False) -> PlacementResult:
    """The answer of several arms: the shortest drive that solves the task, else the farthest part.

    Args:
        results: One for each arm, at least one; the first wins where they are equal.
        farthest: Whether the task asks for as far as possible, which then comes before the drive.
    """

    def rank(result: PlacementResult) -> tuple[int, float, float]:
        plan = result.plan
        order = ("solved", "timeout", "infeasible").index(plan.status)
        solved_to = plan.task.to if farthest else None
        to = solved_to if plan.status == "solved" else plan.feasible_to
        return order, -_moved(result, to), plan.navigation_cost or 0.0

    return min(results, key=rank)


def _moved(result: PlacementResult, to: float | None) -> float:
    """How far the part goes from where the scene has it, to a value [rad] or [m]."""
    task = result.plan.task
    if task.joint is None or to is None:
        return 0.0
    return abs(to - result.prepared.scene.object(task.object).values()[task.joint])


def plan_of(
    query: PlacementQuery,
    prepared: PreparedTask,
    found: Search,
    start: Float[np.ndarray, "3"],
    path: BasePath | None,
) -> PlacementPlan:
    """The plan that a search leads to.

    Args:
        query: What was asked.
        prepared: The room and the task as they were modeled.
        found: What the search found.
        start: Where the base is: x [m], y [m], yaw [rad].
        path: The way from there to the base pose, if there is one.
    """
    robot, base = query.robot, found.base
    solved = found.motion is not None and base is not None
    return PlacementPlan(
        scene=str(query.scene.path) if query.scene.path else query.scene.name,
        robot_name=robot.name,
        robot_urdf=str(robot.model.urdf.path),
        base_link=robot.base_link,
        tool_link=robot.tool_link,
        task=query.task,
        status="solved" if solved else "timeout" if found.timed_out else "infeasible",
        robot_file=robot.source,
        robot_srdf=_named_srdf(robot),
        robot_rest=robot.model.held,
        robot_arm=robot.arm or None,
        robot_amended=robot.amended,
        scene_joints=query.scene.joints_set,
        scene_hypotheses=query.scene.hypotheses_set,
        joints=robot.moved_joints,
        start=(float(start[0]), float(start[1]), float(start[2])),
        base_path=None if path is None else path.poses,
        base_pose=None if base is None else (float(base[0]), float(base[1]), float(base[2])),
        motion=found.motion,
        navigation_cost=float(found.cost) if solved else None,
        cost=_cost(query, prepared, found),
        candidates=found.candidates(),
        method=query.config.place.method,
        seed=query.seed,
        region=query.region,
        versions={name: version_of(name) for name in DEPENDS_ON},
    )


def _cost(query: PlacementQuery, prepared: PreparedTask, found: Search) -> Mapping[str, CostTerm]:
    """The terms of what the base pose costs; none of one that another method chose."""
    place, motion, base = query.config.place, found.motion, found.base
    if motion is None or base is None or place.method not in OURS:
        return {}
    q = query.robot.chain.freedom_values(motion.q)
    travel = float(found.cost)
    return cost_terms(prepared.geometry, place, base, q, travel=travel, margin=found.margin)


def _named_srdf(robot: Robot) -> str | None:
    """The SRDF, where it is not the one that everybody finds beside the URDF."""
    urdf = robot.model.urdf.path
    beside = None if urdf is None else urdf.with_suffix(".srdf")
    # A URDF that the robot file adds to is written beside the plan, where nobody finds the SRDF.
    found = robot.amended is None and robot.srdf == beside
    return None if robot.srdf is None or found else str(robot.srdf)
