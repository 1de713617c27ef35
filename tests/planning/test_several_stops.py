"""Laws of answers with several stops."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from momapos.model.plan_files.plan_format import write_plan
from momapos.model.robots.robot import load_robot
from momapos.model.scene.scene_files import load_scene
from momapos.planning.base_use import with_other_use
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.planning.plan import plan_to_value
from momapos.planning.query import PlacementQuery
from momapos.planning.result import PlacementResult
from momapos.planning.several_stops import MAX_STOPS, STRETCHES, plan_in_stretches
from momapos.verification.plan_check import verify_files

LONGEST = 0.26
"""The part of the drawer's 40 cm that one base pose serves, in these tests [m]."""


def question() -> PlacementQuery:
    scene, robot = load_scene("kitchen_small"), load_robot("segway_ur5e")
    task = make_task(scene, "open", "cabinet_right", "drawer_top_slide")
    return PlacementQuery.of(scene, robot, task, clock=time.process_time)


def limited(longest: float, stretches: list[tuple[float, float]]) -> object:
    """Return a planner that refuses longer stretches, as a short arm would."""

    def answer(query: PlacementQuery) -> PlacementResult:
        task = query.task
        now = query.scene.object(task.object).values()[task.joint]
        stretches.append((now, task.to))
        found = plan_to_value(query)
        if abs(task.to - now) <= longest:
            return found
        return replace(found, plan=replace(found.plan, status="infeasible", motion=None))

    return answer


@pytest.fixture(scope="module")
def stops() -> tuple[PlacementQuery, PlacementResult, list[tuple[float, float]]]:
    stretches: list[tuple[float, float]] = []
    query, answer = question(), limited(LONGEST, stretches)
    query = replace(query, config=replace(query.config, base="stops"))
    found = with_other_use(query, answer(query), answer)  # type: ignore[operator, arg-type]
    return query, found, stretches


def test_two_stops_move_the_part_all_the_way_and_the_file_is_valid(
    stops: tuple[PlacementQuery, PlacementResult, list[tuple[float, float]]], tmp_path: Path
) -> None:
    query, found, _ = stops
    plan, motion = found.plan, found.plan.motion
    assert plan.status == "solved"
    assert plan.task == query.task
    assert len(motion.grasps) == 2
    assert motion.object_q[-1] == pytest.approx(query.task.to)
    write_plan(plan, tmp_path / "plan.json")
    report = verify_files(tmp_path / "plan.json")
    assert report.valid, report


def test_a_note_says_where_the_hand_lets_go_and_claims_nothing_about_fewer_stops(
    stops: tuple[PlacementQuery, PlacementResult, list[tuple[float, float]]],
) -> None:
    _, found, _ = stops
    motion = found.plan.motion
    let_go = 100 * motion.object_q[motion.grasps[0].last]
    words = f"the robot stops 2 times, and lets go at {let_go:.0f} cm"
    assert found.notes[-1] == f"no single base pose serves this task; {words}"


def test_the_first_stretch_is_the_longest(
    stops: tuple[PlacementQuery, PlacementResult, list[tuple[float, float]]],
) -> None:
    query, found, _ = stops
    motion = found.plan.motion
    values = query.task.to * np.arange(STRETCHES + 1) / STRETCHES
    let_go = motion.object_q[motion.grasps[0].last]
    assert let_go == pytest.approx(values[values <= LONGEST].max())


def test_the_base_drives_only_while_the_hand_is_free_and_the_part_rests(
    stops: tuple[PlacementQuery, PlacementResult, list[tuple[float, float]]],
) -> None:
    motion = stops[1].plan.motion
    moved = np.abs(np.diff(motion.base, axis=0)).max(1) > 0
    held = np.zeros(len(motion.q) - 1, bool)
    for hold in motion.grasps:
        held[hold.first : hold.last] = True
    assert moved.any()
    assert not (moved & held).any()
    assert (np.diff(motion.object_q)[~held] == 0.0).all()
    home = motion.approach[0]
    np.testing.assert_allclose(motion.q[:-1][moved], np.tile(home, (moved.sum(), 1)), atol=1e-9)


def test_a_part_that_needs_more_than_three_stops_has_no_answer() -> None:
    stretches: list[tuple[float, float]] = []
    query, answer = question(), limited(0.06, stretches)
    found = plan_in_stretches(query, answer(query), answer)  # type: ignore[operator, arg-type]
    assert found.answer is None
    assert len({now for now, _ in stretches}) == MAX_STOPS


def test_a_task_that_one_base_pose_serves_is_answered_with_it() -> None:
    query = question()
    one = plan_base_placement(
        query.scene, query.robot, query.task, config=PipelineConfig(base="auto")
    ).plan
    other = plan_base_placement(query.scene, query.robot, query.task).plan
    assert not one.moves_base
    assert one == other
