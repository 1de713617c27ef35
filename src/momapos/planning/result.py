"""An answer: the plan, and the search data behind it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib import import_module
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from momapos.core import require, version_of
from momapos.model.records import (
    Assumption,
    CostTerm,
    JointResistance,
    MotionLoads,
    PlacementPlan,
    Status,
    Tolerance,
)
from momapos.model.robots import Robot, robot_loads
from momapos.model.scene import latch_value
from momapos.planning.grasps import slides
from momapos.planning.navigation import BasePath, outlines_after, touched_at_home
from momapos.planning.placement import OURS, Search, cost_terms
from momapos.verification import SHORT_TRAVEL

from .answer_notes import notes_on
from .query import PlacementQuery
from .task_setup import PreparedTask

if TYPE_CHECKING:
    from jaxtyping import Float

DEPENDS_ON = ("momapos", "numpy", "ompl")
"""Packages that an answer depends on, in addition to its inputs."""


@dataclass(frozen=True, eq=False)
class PlacementResult:
    """A plan, and the search data behind it for figures and benchmarks."""

    plan: PlacementPlan
    prepared: PreparedTask
    search: Search
    start: Float[np.ndarray, "3"]
    """Start of the base: x [m], y [m], yaw [rad]."""
    query: PlacementQuery | None = field(default=None, repr=False)
    """The question; None if the plan was read from a file."""

    @cached_property
    def tolerance(self) -> Tolerance | None:
        """Return how far the base may be from its pose, measured on first access.

        None without a motion, and for a plan from a file that states none.
        """
        return self.with_tolerance().plan.tolerance

    def with_tolerance(self) -> PlacementResult:
        """Return the answer with the tolerance in its plan, as `momapos place` writes it."""
        # By name: it replans, and so depends on this module.
        answer: PlacementResult = import_module("momapos.planning.tolerance").with_tolerance(self)
        return answer

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """Return notes: a part that meets the floor, an arm that leaves the floor's outline."""
        return self.plan.notes or notes_on(self.plan, self.prepared)

    def with_notes(self) -> PlacementResult:
        """Return the answer with the notes in its plan, as `momapos place` writes it."""
        return replace(self, plan=replace(self.plan, notes=self.notes))

    @property
    def slides(self) -> bool:
        """Return whether the part slides [m]; otherwise it turns [rad]."""
        return slides(self.prepared.scene, self.plan.task)

    def value_words(self, value: float) -> str:
        """Return a value of the task's joint in words, such as 90 deg, 30 cm or 4 mm."""
        if not self.slides:
            return f"{math.degrees(value):.0f} deg"
        short = np.ptp(self.prepared.motion.object_q) < SHORT_TRAVEL
        return f"{1000 * value:.3g} mm" if short else f"{100 * value:.0f} cm"

    @property
    def holds(self) -> tuple[str, ...]:
        """Return a description of each grasp of the plan, in order."""
        motion, found = self.prepared.motion, self.plan.motion
        if found is None:
            return ()
        if found.holds:
            return tuple(hold.words for hold in found.holds)
        away = np.abs(motion.Ts_world_tool[:, motion.grasp_step] - found.Ts_world_tool[0])
        return (motion.grasps.describe(int(away.sum((1, 2)).argmin())),)

    @property
    def latch(self) -> str:
        """Return what the hand turns before the part moves, in words; "" for nothing."""
        found, target = self.plan.motion, self.prepared.scene.object(self.plan.task.object)
        if found is None or found.latch_q is None or target.latch is None:
            return ""
        value = latch_value(target, target.latch)
        return f"{target.latch.joint} to {value} first; the hand holds on and keeps it there"

    @property
    def touched_after(self) -> str:
        """Return what the robot touches as its arm returns home after the task; "" for nothing."""
        base, robot, task = self.plan.final_base_pose, self.prepared.robot, self.plan.task
        if base is None or self.plan.motion is None:
            return ""
        outlines = outlines_after(self.prepared.scene, robot, task)
        return touched_at_home(np.array(base), robot, outlines)

    def __repr__(self) -> str:
        task = self.plan.task
        name, status = self.plan.robot_name, self.plan.status
        return f"<PlacementResult of {name}: {task.verb} {task.target}: {status}>"

    def _repr_png_(self) -> bytes:
        """Return the figure that a notebook shows."""
        # By name: figures depend on records.
        png: bytes = import_module("momapos.apps.plots.notebook_images").answer_png(self)
        return png

    def show(self) -> None:
        """Play the plan in a notebook, or in a browser outside of one; needs viser.

        Raises:
            InputError: The plan is not solved.
            MissingExtraError: viser is not installed.
        """
        with require("view"):
            page = import_module("momapos.apps.web.static")
        page.show(self)


Answer: TypeAlias = "Callable[[PlacementQuery], PlacementResult]"
"""Answers a question."""


def cheapest(results: Sequence[PlacementResult], *, farthest: bool = False) -> PlacementResult:
    """Return the best answer of several arms: the shortest drive, else the largest opening.

    Args:
        results: One answer per arm, at least one; the first wins a tie.
        farthest: Whether the task requests the maximum, which then has priority over the drive.
    """

    def rank(result: PlacementResult) -> tuple[int, float, float]:
        plan = result.plan
        order = ("solved", "assumed", "timeout", "infeasible").index(plan.status)
        solved_to = plan.task.to if farthest else None
        to = solved_to if plan.feasible else plan.feasible_to
        return order, -_moved(result, to), plan.navigation_cost or 0.0

    return min(results, key=rank)


def _moved(result: PlacementResult, to: float | None) -> float:
    """Return how far the part moves from its value in the scene [rad] or [m]."""
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
    """Return the plan that a search found.

    Args:
        query: The question.
        prepared: The scene and the task as they were modeled.
        found: What the search found.
        start: Start of the base: x [m], y [m], yaw [rad].
        path: The path from there to the base pose, if there is one.
    """
    robot, base = query.robot, found.base
    solved = found.motion is not None and base is not None
    status: Status = "timeout" if found.timed_out else "infeasible"
    if solved:
        assumed = query.scene.is_assumed(query.task.object, query.task.joint)
        status = "assumed" if assumed else "solved"
    return PlacementPlan(
        scene=str(query.scene.path) if query.scene.path else query.scene.name,
        robot_name=robot.name,
        robot_urdf=str(robot.model.urdf.path),
        base_link=robot.base_link,
        tool_link=robot.tool_link,
        task=query.task,
        status=status,
        robot_file=robot.source,
        robot_srdf=_named_srdf(robot),
        robot_rest=robot.model.held,
        robot_arm=robot.arm or None,
        robot_drive=robot.drive,
        robot_min_turning_radius=robot.min_turning_radius or None,
        robot_amended=robot.amended,
        scene_joints=query.scene.joints_set,
        scene_hypotheses=query.scene.hypotheses_set,
        assumption=_improbable(query) if status == "assumed" else None,
        resistance=_resistance(prepared),
        overrides=replace(
            query.scene.overrides, assumed=query.config.motion.grasps.resistance.changed()
        ),
        loads=_loads(prepared, found) if solved else None,
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


def _loads(prepared: PreparedTask, found: Search) -> MotionLoads | None:
    """Return the worst loads of the motion, as the exact check measures them."""
    if found.base is None or found.motion is None:
        return None
    x, y, yaw = map(float, found.base)
    loads = prepared.verifier.loads((x, y, yaw), found.motion)
    return replace(loads, notes=robot_loads(prepared.robot).notes)


def _improbable(query: PlacementQuery) -> Assumption | None:
    """Describe the joint if its most probable motion is improbable; None if another is assumed."""
    scene, task = query.scene, query.task
    if scene.hypotheses_set or task.joint is None:
        return None
    return Assumption.of_first(scene.object(task.object).hypotheses[task.joint][0])


def _resistance(prepared: PreparedTask) -> dict[str, dict[str, JointResistance]]:
    """Return the resistance of the moved part, by object and joint; empty for rigid objects."""
    motion = prepared.motion
    if motion.task.joint is None or motion.resistance is None:
        return {}
    return {motion.task.object: {motion.task.joint: motion.resistance}}


def _cost(query: PlacementQuery, prepared: PreparedTask, found: Search) -> Mapping[str, CostTerm]:
    """Return the cost terms of the base pose; empty for other methods."""
    place, motion, base = query.config.place, found.motion, found.base
    if motion is None or base is None or place.method not in OURS:
        return {}
    q = query.robot.chain.freedom_values(motion.q)
    return cost_terms(
        prepared.geometry, place, base, q, travel=float(found.cost), robustness=found.robustness,
        own=None if query.pose_cost is None else float(query.own_cost(base[None])[0]),
    )  # fmt: skip


def _named_srdf(robot: Robot) -> str | None:
    """Return the SRDF, unless it is the one that stands next to the URDF."""
    urdf = robot.model.urdf.path
    default = None if urdf is None else urdf.with_suffix(".srdf")
    # An amended URDF is written next to the plan, away from the SRDF.
    found = robot.amended is None and robot.srdf == default
    return None if robot.srdf is None or found else str(robot.srdf)
