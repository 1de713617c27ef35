"""Check a scene."""

from __future__ import annotations

from collections.abc import Iterator

from momapos.core import expect
from momapos.model.robots import Robot
from momapos.model.scene import Scene

from .joints import joint_findings, joint_reports
from .report import Finding, FindingKind, SceneReport, Severity
from .shapes import shape_findings

_ORDER = list(Severity)


def check_scene(scene: Scene, robot: Robot | None = None) -> SceneReport:
    """Check a scene before a task: what is wrong, and what is known about its parts.

    Each finding says what is wrong, where, and what would be right. A report without findings does
    not mean that a task is feasible.

    Args:
        scene: The scene, with the joint values of interest.
        robot: The robot whose start and paths are checked; None to leave these out.

    Returns:
        The findings, the worst first, and what is known about each joint.

    Raises:
        InputError: An argument is of the wrong type.
    """
    expect("scene", scene, Scene, "load_scene reads one")
    if robot is not None:
        expect("robot", robot, Robot, "load_robot reads one")
    findings, joints, floor = list(_file_findings(scene)), joint_reports(scene), None
    findings += shape_findings(scene)
    bare = {one.object for one in findings if one.kind is FindingKind.NO_SHAPE}
    findings += joint_findings([one for one in joints if one.object not in bare])
    if robot is not None and scene.objects:
        from .driving import drive_report  # imports most of the planner

        floor, joints, more = drive_report(scene, robot, joints)
        findings += more
    return SceneReport(
        scene=scene.name,
        path="" if scene.path is None else str(scene.path),
        objects=len(scene.objects),
        findings=tuple(sorted(findings, key=lambda one: _ORDER.index(one.severity))),
        joints=joints,
        floor=floor,
    )


def _file_findings(scene: Scene) -> Iterator[Finding]:
    """Yield the unknown keys of the file, and the assumptions of its reader."""
    for key in scene.ignored_keys:
        where = key.where.removeprefix(f"{scene.path}").removeprefix(": ")
        text = f"{where}{': ' if where else ''}{key.key!r:.80} is not known and was ignored"
        yield Finding(FindingKind.UNKNOWN_KEY, Severity.WARNING, text, key.advice, key.object)
    ignored = {str(key) for key in scene.ignored_keys}
    for text in scene.warnings:
        if text not in ignored:
            shown = text.removeprefix(f"{scene.path}: ")
            yield Finding(FindingKind.READER, Severity.NOTE, shown)
