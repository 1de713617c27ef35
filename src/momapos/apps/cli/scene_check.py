"""momapos scene check: find what is wrong in a scene before a task."""

from __future__ import annotations

import json as json_format
from typing import TYPE_CHECKING, Any

from momapos.core import say
from momapos.model.scene import find_scene

from .console import busy
from .options import Flag, JointsArg, RobotOption, SceneArg

if TYPE_CHECKING:
    from momapos.model.scene import Scene
    from momapos.workflows.scene_check import SceneReport

USABLE, UNUSABLE = 0, 2
MAX_SHOWN = 3
"""Findings of a kind that are listed in short [-]."""


def scene_check(
    scene: SceneArg,
    /,
    *,
    robot: RobotOption = "fetch",
    joint: JointsArg = (),
    json: Flag = False,
) -> int:
    """Check a scene: unknown keys, sizes, shapes, overlaps, joints, handles, start and floor.

    Exit status: 0, or 2 if planning would refuse the scene.

    Args:
        scene: A built-in kitchen or a scene file (momapos, BestMan, URDF).
        robot: The robot that starts and drives there: a library robot or a robot file.
        joint: Set a joint of the scene, such as fridge/door_hinge=60deg.
        json: Print one JSON object instead of text.
    """
    from momapos.model.robots import find_named_robot

    find_scene(scene)  # reports a mistyped name before anything heavy is imported
    find_named_robot(robot)
    from momapos.model.robots import load_robot
    from momapos.model.scene import load_scene, set_joints
    from momapos.workflows.scene_check import check_scene, report_lines, report_to_dict

    loaded = set_joints(load_scene(scene), joint)
    with busy(f"checking {loaded.name}"):
        report = check_scene(loaded, load_robot(robot))
    if json:
        say(json_format.dumps(report_to_dict(report), indent=1, allow_nan=False))
    else:
        say("\n".join(report_lines(report)))
    return USABLE if report.usable else UNUSABLE


def check_in_short(scene: Scene) -> SceneReport:
    """Check a scene without a robot."""
    from momapos.workflows.scene_check import check_scene

    with busy(f"checking {scene.name}"):
        return check_scene(scene)


def findings_to_list(report: SceneReport) -> list[dict[str, Any]]:
    """Return the findings of a report as plain values."""
    from momapos.workflows.scene_check import report_to_dict

    found: list[dict[str, Any]] = report_to_dict(report)["findings"]
    return found


def lines_in_short(report: SceneReport, source: str) -> list[str]:
    """Return the number of findings, and the errors and warnings."""
    from momapos.workflows.scene_check import Severity, finding_lines, summary

    worst = (Severity.ERROR, Severity.WARNING)
    more = f"; 'momapos scene check {source}' lists all" if report.findings else ""
    return [
        f"  check: {summary(report)}{more}",
        *(f"  {line}" for line in finding_lines(report.findings, worst, MAX_SHOWN)),
    ]
