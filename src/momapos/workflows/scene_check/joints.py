"""What is known about the joints of a scene, and findings about them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from momapos.model.scene import Scene, SceneObject, latch_guess, latch_value
from momapos.model.urdf import opens_both_ways
from momapos.planning.grasps import PartFacts, part_facts_of

from .report import Finding, FindingKind, JointReport, Severity

MIN_RANGE = 1e-6
"""Smallest range of a joint that moves [rad] or [m]."""


def joint_reports(scene: Scene) -> tuple[JointReport, ...]:
    """Return what is known about each movable joint, in the scene's order."""
    return tuple(
        _report(item, joint, part_facts_of(item, joint))
        for item in scene.objects
        for joint in item.model.joints
    )


def _report(item: SceneObject, joint: str, facts: PartFacts) -> JointReport:
    handle, xyz, latch = facts.handle, facts.handle_world, item.latch
    return JointReport(
        object=item.name,
        joint=joint,
        kind=item.joint(joint).kind,
        closed=facts.opening.closed,
        wide=facts.opening.wide,
        value=item.values()[joint],
        both_ways=opens_both_ways(item.model, joint),
        follows=facts.follows,
        is_handle=facts.is_handle,
        handle="" if handle is None else str(handle),
        has_handle=handle is not None and not handle.edge,
        handle_xyz=None if xyz is None else (float(xyz[0]), float(xyz[1]), float(xyz[2])),
        pull=facts.pull,
        problem=facts.problem,
        latch="" if latch is None or latch.holds != joint else latch.joint,
        latch_to="" if latch is None or latch.holds != joint else latch_value(item, latch),
        holds="" if latch is None or latch.joint != joint else latch.holds,
        latch_guess=latch_guess(item, joint),
    )


def joint_findings(joints: Sequence[JointReport]) -> Iterator[Finding]:
    """Yield the joints that move nothing, undeclared latches, and the parts without a handle."""
    for one in joints:
        where = f"{one.object}/{one.joint}"
        if one.follows:
            continue
        if one.latch_guess:
            yield Finding(
                FindingKind.LATCH, Severity.NOTE,
                f"{one.object}/{one.latch_guess} may be a latch of {one.joint}; plans leave it "
                "alone", f'declare it: "latch": {{"joint": "{one.latch_guess}", "to": VALUE, '
                f'"holds": "{one.joint}"}}', one.object, one.joint,
            )  # fmt: skip
        if abs(one.wide - one.closed) < MIN_RANGE:
            yield Finding(
                FindingKind.JOINT, Severity.NOTE, f"{where} has a range of zero and cannot move",
                "set its limits, or make it a fixed joint", one.object, one.joint,
            )  # fmt: skip
        elif one.problem:
            yield Finding(
                FindingKind.JOINT, Severity.WARNING, f"{where}: {one.problem.partition('; ')[0]}",
                "give its child link a collision element", one.object, one.joint,
            )  # fmt: skip
        elif not one.has_handle and not one.is_handle:
            yield Finding(
                FindingKind.NO_HANDLE, Severity.NOTE,
                f"no handle was found on {where}; it is held by {one.handle}",
                "if it has one, name its collision element 'handle'", one.object, one.joint,
            )  # fmt: skip
