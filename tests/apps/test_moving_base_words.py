"""What users read and see of a plan whose base moves."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.moving_base import arc, on_moving_base
from tests.rooms import Everywhere
from tests.verification.moving_case import moving_case, stops_case

from momapos.apps.cli.console import summary
from momapos.apps.plots.answer_plot import draw_answer
from momapos.apps.web.static import page_of
from momapos.apps.web.words import answer_card
from momapos.model.plan_files.plan_format import read_plan
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.planning.result import PlacementResult
from momapos.planning.tolerance import with_tolerance


@pytest.fixture(scope="module")
def answer(kitchen: Scene, segway: Robot) -> PlacementResult:
    """Return an answer whose base drives back a little as the hand opens a drawer."""
    task = make_task(kitchen, "open", "cabinet_right", "drawer_middle_slide")
    found = plan_base_placement(kitchen, segway, task)
    base = arc(found.plan.base_pose, -0.06, 0.05, len(found.plan.motion.q))
    return replace(found, plan=on_moving_base(found.plan, segway, base))


def test_plans_tell_how_the_base_moves(tmp_path: Path) -> None:
    words = {
        name: read_plan(case.write(tmp_path / name)).base_motion
        for name, case in {
            "moves": moving_case(), "stops": stops_case(),
            "still": moving_case(),
        }.items()
    }  # fmt: skip
    assert words["moves"] == "drives 0.20 m and turns 17 deg while the hand holds the part"
    assert words["stops"] == "drives 0.20 m and turns 17 deg between grasps"
    plan = read_plan(tmp_path / "still" / "plan.json")
    assert replace(plan, motion=replace(plan.motion, base=None)).base_motion == ""


def test_the_tolerance_of_a_moving_base_is_not_measured_and_words_say_so(
    answer: PlacementResult,
) -> None:
    assert with_tolerance(answer).plan.tolerance is None
    moves = "drives 0.06 m and turns 3 deg while the hand holds the part"
    for text in (summary(answer, None), str(answer_card(answer).facts)):
        assert "not measured" in text
        assert moves in text


def test_figures_and_pages_show_the_base_where_it_ends(
    answer: PlacementResult, tmp_path: Path
) -> None:
    draw_answer(answer.prepared.scene, answer, Everywhere(), tmp_path / "answer.png")
    assert (tmp_path / "answer.png").stat().st_size > 10_000
    plan = answer.plan
    html = page_of(answer.prepared.scene, answer.prepared.robot, plan)
    assert len(html) > 100_000
    np.testing.assert_allclose(plan.motion.base_poses((0.0, 0.0, 0.0))[0], plan.base_pose)
