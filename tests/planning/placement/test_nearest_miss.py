"""The reason of a "no" is the base pose that came nearest, not the most frequent rejection."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from momapos.model.plan_files.plan_format import read_plan, write_plan
from momapos.model.records.outcomes import PoseOutcome, PoseStatus
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.planning.placement.problem import PoseOutcomes, Search

OFF = PoseOutcome(PoseStatus.OFF_FLOOR)
NO_GRASP = PoseOutcome(PoseStatus.NO_GRASP_IN_REACH)
EARLY = PoseOutcome(PoseStatus.ARM_COLLISION, "shelf", "waypoint 3")
LATE = PoseOutcome(PoseStatus.WAYPOINT_OUT_OF_REACH, where="waypoint 12")
WHOLE = PoseOutcome(PoseStatus.NO_CONTINUOUS_PATH)
EXACT = PoseOutcome(PoseStatus.EXACT_CHECK, "the wrist")


@pytest.mark.parametrize(
    ("outcomes", "nearest"),
    [
        ([OFF, OFF, NO_GRASP, EARLY, OFF], 3),
        ([OFF, LATE, EARLY, EARLY], 1),
        ([WHOLE, LATE, NO_GRASP], 0),
        ([OFF, WHOLE, EXACT, OFF], 2),
        ([OFF, OFF], None),
    ],
)
def test_the_nearest_miss_is_the_pose_whose_checks_came_farthest(
    outcomes: list[PoseOutcome], nearest: int | None
) -> None:
    found, poses = Search(), np.arange(3.0 * len(outcomes)).reshape(-1, 3)
    found.note(poses, PoseOutcomes(outcomes))
    miss = found.candidates().nearest
    if nearest is None:
        assert miss is None
        return
    assert miss.base_pose == tuple(poses[nearest])
    assert miss.reason == str(outcomes[nearest])


def test_a_plan_file_keeps_the_nearest_miss(tmp_path: Path, kitchen: Scene, segway: Robot) -> None:
    plan = plan_base_placement(
        kitchen, segway, make_task(kitchen, "open", "fridge", "door_hinge")
    ).plan
    assert plan.candidates.nearest is None
    write_plan(plan, tmp_path / "solved.json")
    assert "nearest" not in (tmp_path / "solved.json").read_text()
    found = Search()
    found.note(np.array([[1.0, 2.0, 0.5]]), PoseOutcomes([EARLY]))
    no = replace(
        plan, status="infeasible", motion=None, base_pose=None, candidates=found.candidates()
    )
    write_plan(no, tmp_path / "no.json")
    assert read_plan(tmp_path / "no.json").candidates.nearest == no.candidates.nearest
