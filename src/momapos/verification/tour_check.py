"""Verify a tour from its files: each plan, and that each plan starts where the last one ends."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np

from momapos.core import USER_CACHE, Cache
from momapos.model.plan_files import TourFile, read_plan, read_tour
from momapos.model.records import PlacementPlan

from .plan_check import verify_files
from .report import DEFAULT, Check, Limits, Report, at_most, verdict


def verify_tour(
    path: Path,
    scene_root: Path | None = None,
    limits: Limits = DEFAULT,
    *,
    allow_assumed: bool = False,
    cache: Cache | None = USER_CACHE,
) -> dict[str, Report]:
    """Verify a tour, given only its file, its plans, and the scenes and URDFs that they name.

    Args:
        path: The tour.
        scene_root: As for `verify_files`.
        limits: Largest allowed errors.
        allow_assumed: As for `verify_files`.
        cache: Where to cache model geometry; None to always compute it.

    Returns:
        A report for each plan by its file name, and one for the sequence by the tour's file name.

    Raises:
        FileFormatError, SceneError, UrdfError, UnknownNameError, TaskError, RobotError: The tour,
            a plan or a file that a plan names is unusable.
    """
    tour = read_tour(path)
    files = [path.with_name(step.plan) for step in tour.steps]
    reports = {
        file.name: verify_files(file, scene_root, limits, allow_assumed=allow_assumed, cache=cache)
        for file in files
    }
    sequence = _sequence(tour, [read_plan(file) for file in files], allow_assumed)
    reports[path.name] = Report(tuple(sequence))
    return reports


def _sequence(tour: TourFile, plans: list[PlacementPlan], allow_assumed: bool) -> Iterator[Check]:
    """Check that each plan starts in the state in which the previous plan ends."""
    solved = tour.status == "solved" or (allow_assumed and tour.status == "assumed")
    yield verdict("status is solved", solved, f"status {tour.status!r}")
    stops = [step.stop for step in tour.steps]
    counted = [1, *(b - a for a, b in pairwise(stops))]
    in_order = stops[0] == 1 and set(counted) <= {0, 1} and stops[-1] == tour.stops
    yield verdict("stops are numbered from 1, in order", in_order, str(stops))
    for number, (before, after) in enumerate(pairwise(plans), start=2):
        name = f"plan {number}"
        yield verdict(
            f"{name}: same scene and robot as the previous plan",
            (before.scene, before.robot_urdf, before.joints)
            == (after.scene, after.robot_urdf, after.joints),
        )
        yield verdict(
            f"{name}: scene joints are as the previous plan leaves them",
            _joints_after(before) == _joints(after),
            f"{_joints(after)}, previous plan leaves {_joints_after(before)}",
        )  # fmt: skip
        ends = np.array([before.final_base_pose or [np.nan] * 3, after.start or [np.nan] * 3])
        off = float(np.abs(np.diff(ends, axis=0)).max())
        yield at_most(f"{name}: base starts where the previous plan ends", off, 1e-6, "rad|m")
        came_home = before.motion is not None and before.motion.home is not None
        yield verdict(f"{name}: arm has returned home", came_home)
        gap = _arm_gap(before, after)
        if gap is not None:
            what = f"{name}: arm starts as it has returned"
            yield at_most(what, gap, DEFAULT.join, "rad|m")
        if stops[number - 1] == stops[number - 2]:
            stays = before.final_base_pose == after.base_pose
            yield verdict(f"{name}: base stays at its stop", stays)


def _arm_gap(before: PlacementPlan, after: PlacementPlan) -> float | None:
    """Return how far a plan's first arm state is from the last one of the previous plan."""
    first, last = after.motion, before.motion
    if first is None or last is None or last.home is None or before.joints != after.joints:
        return None
    starts = first.approach[:1] if len(first.approach) else first.q[:1]
    return float(np.abs(starts - last.home[-1:]).max(initial=0.0))


def _joints(plan: PlacementPlan) -> dict[tuple[str, str], float]:
    """Return the joint values that differ from the scene file."""
    return {
        (name, joint): value
        for name, joints in plan.scene_joints.items()
        for joint, value in joints.items()
    }


def _joints_after(plan: PlacementPlan) -> dict[tuple[str, str], float]:
    task = plan.task
    if task.joint is None or task.to is None:
        return _joints(plan)
    return {**_joints(plan), (task.object, task.joint): task.to}
