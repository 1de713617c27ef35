"""momapos verify: check a plan again, from the files alone."""

from __future__ import annotations

from pathlib import Path

from tyro.conf import Positional

from .options import OptionalPath
from .plan_sources import check_plan_file


def verify(
    plan: Positional[Path],
    /,
    *,
    scene_root: OptionalPath = None,
    json: bool = False,
) -> int:
    """Check a plan again, from the plan file, the scene and the URDF that it names.

    Of a tour each plan is checked, and that each begins where and as the one before it ends.

    Exit status: 0 the plan holds, 1 it does not, 2 a file cannot be used.

    Args:
        plan: The plan file, or a tour.
        scene_root: Folder for names not found beside the plan, and for a BestMan scene's models.
        json: Print the report as one JSON object and nothing else.
    """
    check_plan_file(plan)
    from json import dumps

    from momapos.core import user_cache
    from momapos.model.plan_files import is_tour
    from momapos.verification import report_lines, report_to_dict, verify_files, verify_tour

    from .compile import VERIFY, compile_once

    compile_once(VERIFY)
    if is_tour(plan):
        reports = verify_tour(plan, scene_root, cache=user_cache())
        valid = all(report.valid for report in reports.values())
        if json:
            files = {name: report_to_dict(report) for name, report in reports.items()}
            print(dumps({"valid": valid, "files": files}))
        else:
            for name, report in reports.items():
                print("\n".join([f"{name}:", *report_lines(report)]))
        return 0 if valid else 1
    report = verify_files(plan, scene_root, cache=user_cache())
    if json:
        print(dumps(report_to_dict(report)))
    else:
        print("\n".join(report_lines(report)))
    return 0 if report.valid else 1
