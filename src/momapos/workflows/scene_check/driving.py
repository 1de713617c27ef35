"""Whether a robot can start in a scene, and where it can drive."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from momapos.model.robots import Robot
from momapos.model.scene import Scene
from momapos.planning import survey_floor

from .report import Finding, FindingKind, FloorReport, JointReport, Severity

MIN_REACHABLE_SHARE = 0.9
"""If the robot reaches less of the free floor, a part of the room is cut off [-]."""


def drive_report(
    scene: Scene, robot: Robot, joints: Sequence[JointReport]
) -> tuple[FloorReport, tuple[JointReport, ...], tuple[Finding, ...]]:
    """Survey the floor, and add to each joint how near to its handle the robot can drive.

    A handle counts as out of reach if the arm cannot reach it from any place that the base's
    inscribed circle can drive to. So "within reach" is necessary for a task, not sufficient.
    """
    survey = survey_floor(scene, robot)
    start, drivable = survey.start, survey.floor
    free = 0.0 if drivable is None else drivable.free_area
    floor = FloorReport(
        robot=robot.title,
        start=None if start is None else (float(start[0]), float(start[1]), float(start[2])),
        given=scene.start is not None,
        is_free=not survey.problem,
        free_area=free,
        reachable_share=0.0 if drivable is None else drivable.reachable_area / free,
    )
    shown = [one for one in joints if one.handle_xyz is not None]
    points = np.array([one.handle_xyz for one in shown]).reshape(-1, 3)
    distance = survey.distances(points[:, :2]).tolist()
    reach = robot.outreach + float(np.linalg.norm(robot.footprint, axis=1).max())
    near = {
        (one.object, one.joint): replace(one, base_distance=d, base_reaches=d <= reach)
        for one, d in zip(shown, distance, strict=True)
    }
    joints = tuple(near.get((one.object, one.joint), one) for one in joints)
    findings = (*_start(survey.problem), *_drive(floor, joints))
    return floor, joints, findings


def _start(problem: str) -> Iterator[Finding]:
    if problem:
        yield Finding(
            FindingKind.START, Severity.ERROR, problem.partition("; ")[0],
            "give a free 'start' in the scene, or --start X,Y,YAW with a task",
        )  # fmt: skip


def _drive(floor: FloorReport, joints: Sequence[JointReport]) -> Iterator[Finding]:
    if not floor.is_free:
        return
    if floor.reachable_share < MIN_REACHABLE_SHARE:
        yield Finding(
            FindingKind.DRIVING, Severity.WARNING,
            f"{floor.robot} reaches only {100 * floor.reachable_share:.0f} % of the free floor "
            f"({floor.free_area:.1f} m^2) from its start",
            "widen the passages, move the start, or use a narrower robot",
        )  # fmt: skip
    for one in joints:
        if one.base_reaches is False and not one.is_handle:
            assert one.base_distance is not None
            near = (
                "nowhere near" if np.isinf(one.base_distance)
                else f"only within {one.base_distance:.2f} m of"
            )  # fmt: skip
            yield Finding(
                FindingKind.DRIVING, Severity.WARNING,
                f"{floor.robot} can drive {near} the handle of {one.object}/{one.joint}, "
                "which is beyond its arm",
                "clear the floor in front of it, or move the start", one.object, one.joint,
            )  # fmt: skip
