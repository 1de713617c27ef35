"""momapos verify: check a plan independently, from its files."""

from __future__ import annotations

from momapos.core import say

from .loading import check_plan_file
from .options import Flag, OptionalFolder, PlanArg


def verify(
    plan: PlanArg,
    /,
    *,
    scene_root: OptionalFolder = None,
    allow_assumed: Flag = False,
    json: Flag = False,
) -> int:
    """Check a plan independently of the planner, from the plan file, the scene and the URDF.

    For a tour, each plan is checked, and that it begins where the one before it ends.

    A plan for a joint type other than the most probable one (status `assumed`) is checked in the
    scene that it assumes, and counts as invalid unless --allow-assumed is given.

    Exit status: 0 plan valid; 1 plan invalid; 2 unusable file.

    Args:
        plan: A plan file or a tour file.
        scene_root: Folder for files that are not next to the plan, and for models of a BestMan
            scene.
        allow_assumed: Accept a plan of status `assumed` if all checks pass.
        json: Print the report as one JSON object, and nothing else.
    """
    check_plan_file(plan)
    from json import dumps

    from momapos.model.plan_files import is_tour
    from momapos.verification import report_lines, report_to_dict, verify_files, verify_tour

    from .compile import VERIFY, compile_once

    compile_once(VERIFY)
    if is_tour(plan):
        reports = verify_tour(plan, scene_root, allow_assumed=allow_assumed)
        valid = all(report.valid for report in reports.values())
        if json:
            files = {name: report_to_dict(report) for name, report in reports.items()}
            say(dumps({"valid": valid, "files": files}))
        else:
            for name, report in reports.items():
                say("\n".join([f"{name}:", *report_lines(report)]))
        return 0 if valid else 1
    report = verify_files(plan, scene_root, allow_assumed=allow_assumed)
    if json:
        say(dumps(report_to_dict(report)))
    else:
        say("\n".join(report_lines(report)))
    return 0 if report.valid else 1
