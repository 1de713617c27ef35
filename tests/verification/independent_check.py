"""Verdicts of the independent program on plan files, where it is present."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tests import optional
from tests.real import TOOLS

RUN_INDEPENDENT = """
import json, sys, types
from pathlib import Path
import verify_plan
options = types.SimpleNamespace(skip_approach=False, allow_hinge_grasp=False)
for path in map(Path, sys.argv[1:]):
    report, _ = verify_plan.verify(json.loads(path.read_text()), path.parent, None, options)
    print(json.dumps({check["check"]: (check["ok"], check["value"]) for check in report.checks}))
"""

INDEPENDENT_NAMES = {
    "q, object_q, T_world_tool have equal length >= 2": (
        "same number (2 or more) of q, object_q, T_world_tool"
    ),
    "moved part collision with the scene": "moved part in the room",
    "base collision with the scene": "base in the scene",
    "arm collision with the scene": "arm in the scene",
    "robot self-collision": "robot in itself",
    "open hand in the part": "open hand in the part that it takes",
    "hand off the part that it holds": "hand to the held part (a pinch: 12 mm more)",
}
"""Names of checks that the independent checker spells differently."""
HAND_CHECKS = {name for ours, name in INDEPENDENT_NAMES.items() if "hand" in ours}
"""Checks that are coarser there: one hull for the whole hand, at the ends of a hold only."""


def independent_verdicts(plans: Mapping[Any, Path]) -> list[dict[str, tuple[bool, float]]]:
    """Return verdict and value of each check of the independent checker, for each plan."""
    command = [sys.executable, "-c", RUN_INDEPENDENT, *map(str, plans.values())]
    other = subprocess.run(
        command, capture_output=True, text=True, cwd=optional.there(TOOLS, "independent checker"),
        env={**os.environ, "PYTHONPATH": "."},
    )  # fmt: skip
    assert other.returncode == 0, other.stderr
    return [json.loads(line) for line in other.stdout.splitlines()]
