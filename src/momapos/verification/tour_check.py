"""Verify a tour from its files alone: each plan by itself, and that one follows from the other."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np

from momapos.core import Cache
from momapos.model.plan_files import TourFile, read_plan, read_tour
from momapos.model.records import PlacementPlan

from .plan_check import verify_files
from .report import DEFAULT, Check, Limits, Report, at_most, verdict


def verify_tour(
    path: Path,
    scene_root: Path | None = None,
    limits: Limits = DEFAULT,
    *,
    cache: Cache | None = None,
) -> dict[str, Report]:
    """Check a tour with nothing but its file, its plans, and the scenes and URDFs that they name.

    Args:
        path: The tour.
        scene_root: As for `verify_files`.
        limits: What to hold the plans to.
        cache: Where the geometry of models is kept.

    Returns:
        A report for each plan, by its file's name, and one of how they follow, by the tour's.

    Raises:
        FileFormatError: The tour or a plan cannot be used.
        SceneError, UrdfError, UnknownNameError, TaskError, RobotError: Nor what a plan names.
    """
    tour = read_tour(path)
    files = [path.with_name(step.plan) for step in tour.steps]
    reports = {file.name: verify_files(file, scene_root, limits, cache=cache) for file in files}
    reports[path.name] = Report(tuple(_follow(tour, [read_plan(file) for file in files])))
    return reports


def _follow(tour: TourFile, plans: list[PlacementPlan]) -> Iterator[Check]:
    """Whether each plan begins where and as the one before it ends."""
    yield verdict("status is solved", tour.status == "solved", f"status {tour.status!r}")
    stops = [step.stop for step in tour.steps]
    counted = [1, *(b - a for a, b in pairwise(stops))]
    in_order = stops[0] == 1 and set(counted) <= {0, 1} and stops[-1] == tour.stops
    yield verdict("stops are counted from 1, in order", in_order, str(stops))
    for number, (before, after) in enumerate(pairwise(plans), start=2):
        name = f"plan {number}"
        yield verdict(
            f"{name}: same scene and robot as before",
            (before.scene, before.robot_urdf, before.joints)
            == (after.scene, after.robot_urdf, after.joints),
        )
        yield verdict(
            f"{name}: the room is as it was left", _left(before) == _joints(after),
            f"{_joints(after)}, left {_left(before)}",
        )  # fmt: skip
        ends = np.array([before.base_pose or [np.nan] * 3, after.start or [np.nan] * 3])
        off = float(np.abs(np.diff(ends, axis=0)).max())
        yield at_most(f"{name}: starts where the base is", off, 1e-6, "rad|m")
        came_home = before.motion is not None and before.motion.home is not None
        yield verdict(f"{name}: the arm has come home", came_home)
        if stops[number - 1] == stops[number - 2]:
            stays = before.base_pose == after.base_pose
            yield verdict(f"{name}: the base stays at its stop", stays)


def _joints(plan: PlacementPlan) -> dict[tuple[str, str], float]:
    """Joint values that differ from the scene file's."""
    return {
        (name, joint): value
        for name, joints in plan.scene_joints.items()
        for joint, value in joints.items()
    }


def _left(plan: PlacementPlan) -> dict[tuple[str, str], float]:
    """The same after the plan's task."""
    task = plan.task
    if task.joint is None or task.to is None:
        return _joints(plan)
    return {**_joints(plan), (task.object, task.joint): task.to}
