"""Laws of the hypotheses of a part's joint, updated by the path of the hand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.rooms import Everywhere
from tests.workflows.guessed_rooms import BLOCKS_ONE, BLOCKS_TWO, Odds, room

from momapos.apps.cli.console import summary
from momapos.apps.cli.loading import open_plan
from momapos.core.errors import TaskError
from momapos.core.geometry.transforms import apply
from momapos.model.plan_files.plan_format import write_plan
from momapos.model.records.plans import Task
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.planning.result import PlacementResult
from momapos.simulation.config import ComplianceConfig, Ending
from momapos.verification.plan_check import verify_files
from momapos.workflows.joint_belief import (
    MIN_PROBABILITY,
    JointBeliefs,
    joint_beliefs,
    plan_by_hypothesis,
    save_learned,
)
from momapos.workflows.run import run_plan

CONFIG = ComplianceConfig()


def beliefs_of(scene: Scene) -> JointBeliefs:
    (joint,) = scene.object("cupboard").model.joints
    return JointBeliefs(joint_beliefs(scene, make_task(scene, "open", "cupboard", joint)), CONFIG)


ALL: Odds = (("door_right", 0.55), ("door_left", 0.25), ("drawer", 0.12), ("door_down", 0.08))


@pytest.fixture(scope="module")
def guessed(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return room(tmp_path_factory.mktemp("beliefs") / "guessed", ALL)


@settings(max_examples=20)
@given(
    index=st.integers(0, 3), length=st.floats(0.15, 0.25), seed=st.integers(0, 1000),
    handle=st.tuples(st.floats(-0.2, 0.2), st.floats(-0.05, 0.2)),
)  # fmt: skip
def test_the_path_of_the_hand_makes_its_joint_the_most_probable(
    guessed: Scene, index: int, length: float, seed: int, handle: tuple[float, float]
) -> None:
    beliefs = beliefs_of(guessed)
    axis = beliefs.beliefs[index].axis
    start = np.array([1.22, handle[0], 0.8 + handle[1]])
    values = np.linspace(0.0, length / axis.lever_at(start), 30)
    if values[-1] > 1.5:  # beyond any part's limit
        return
    noise = np.random.default_rng(seed).normal(0.0, 1e-3, (30, 3))
    way = [apply(axis.moved(v), start[None])[0] + e for v, e in zip(values, noise, strict=True)]
    other = beliefs.fail(way)
    weights = [belief.log_weight for belief in beliefs.beliefs]
    if index == 0:
        assert not beliefs_of(guessed).contradicts(way)
    else:
        assert (other.hypothesis.kind, int(np.argmax(weights))) == (ALL[index][0], index)
        assert other.moved == pytest.approx(values[-1], abs=0.03 / axis.lever_at(start))


def test_after_a_part_does_not_move_the_next_probable_kind_is_tried(guessed: Scene) -> None:
    beliefs, held = beliefs_of(guessed), [np.array([1.22, 0.1, 0.8])]
    tried = [beliefs.kind]
    for _ in range(3):
        beliefs.fail(held)
        tried.append(beliefs.kind)
    assert tried == ["door_right", "door_left", "drawer", "door_down"]


def test_a_hand_that_loses_the_part_measures_nothing_but_lowers_the_weight(guessed: Scene) -> None:
    beliefs = beliefs_of(guessed)
    assert not beliefs.moved
    before = beliefs.beliefs
    other = beliefs.fail(())
    assert other.hypothesis.kind == "door_left"
    assert [b.moved for b in beliefs.beliefs] == [b.moved for b in before]
    beliefs.fail([np.array([1.22 - 0.01 * k, 0.1, 0.8]) for k in range(10)])
    assert beliefs.moved


def test_hypotheses_are_ranked_by_the_path_of_the_hand_and_the_current_one_is_none(
    guessed: Scene,
) -> None:
    beliefs = beliefs_of(guessed)
    pulled = [np.array([1.22 - 0.01 * k, 0.1, 0.8]) for k in range(25)]
    ranked = beliefs.ranked(pulled)
    assert len(ranked) == len(ALL)
    assert ranked.count(None) == 1
    assert ranked[0].hypothesis.kind == "drawer"
    weights = [belief.log_weight for belief in ranked if belief is not None]
    assert weights == sorted(weights, reverse=True)


def test_a_dropped_hypothesis_is_not_tried_again(guessed: Scene) -> None:
    beliefs, held = beliefs_of(guessed), [np.array([1.22, 0.1, 0.8])]
    tried = [beliefs.kind]
    while (other := beliefs.drop_current()) is not None:
        tried.append(other.hypothesis.kind)
        assert beliefs.kind == tried[-1]
    assert tried == [kind for kind, _ in ALL]
    assert beliefs.fail(held) is None


def test_an_improbable_hypothesis_is_not_tried(tmp_path: Path) -> None:
    beliefs = beliefs_of(room(tmp_path / "sure", (("door_right", 0.995), ("drawer", 0.005))))
    assert beliefs.drop_current() is None
    assert beliefs.kind == "door_right"


def test_a_part_with_one_hypothesis_has_no_alternative(tmp_path: Path) -> None:
    beliefs = beliefs_of(room(tmp_path / "known", (("door_left", 1.0),)))
    way = [np.array([1.22 - 0.01 * k, 0.001 * k, 0.8]) for k in range(20)]
    assert beliefs.kind == ""
    assert not beliefs.contradicts(way)
    assert beliefs.ranked(way) == [None]
    assert beliefs.fail(way) is None
    assert beliefs.drop_current() is None


def test_a_door_hinged_on_the_other_side_is_opened_and_its_joint_saved(
    tmp_path: Path, segway: Robot
) -> None:
    guessed = room(tmp_path / "guessed", (("door_right", 0.7), ("door_left", 0.3)))
    really = room(tmp_path / "really", (("door_left", 1.0),))
    task = make_task(guessed, "open", "cupboard", "door_hinge")
    plan = plan_base_placement(guessed, segway, task, Everywhere(), config=PipelineConfig()).plan
    record = run_plan(plan, guessed, segway, Everywhere(), world=really)
    assert record.success, record.reason
    assert record.kinds[0] == "door_right"
    assert record.kinds[-1] == "door_left"
    assert [one.ending for one in record.failed] == [Ending.OTHERWISE]
    assert record.failed[0].reached == pytest.approx(0.0, abs=0.02)  # brought back
    learned = save_learned(record, guessed, tmp_path / "learned" / "scene.json")
    assert learned is not None
    item = load_scene(tmp_path / "learned" / "scene.json").object("cupboard")
    ((way,),) = item.hypotheses.values()
    assert (way.kind, way.probability) == ("door_left", 1.0)
    true = really.object("cupboard").model.joint("door_hinge")
    assert np.linalg.norm(np.array(way.point[:2]) - true.T_parent_joint[:2, 3]) < 0.01
    assert np.array(way.axis) @ true.axis > np.cos(np.radians(2.0))
    assert item.values()["door_hinge"] == pytest.approx(record.execution.reached, abs=0.02)
    failed = replace(record, execution=record.failed[0])
    assert save_learned(failed, guessed, tmp_path / "none.json") is None
    assert not (tmp_path / "none.json").exists()


def test_if_the_most_probable_hypothesis_is_infeasible_the_next_is_planned_verified_and_executed(
    tmp_path: Path, segway: Robot
) -> None:
    odds: Odds = (("drawer", 0.5), ("door_right", 0.3), ("door_left", 0.2))
    guessed = room(tmp_path / "guessed", odds, post=BLOCKS_TWO)
    really = room(tmp_path / "really", (("door_left", 1.0),), post=BLOCKS_TWO)
    planned = list[str]()

    def plan_task(scene: Scene, task: Task) -> list[PlacementResult]:
        planned.append(scene.object("cupboard").hypotheses["drawer_slide"][0].kind)
        return [plan_base_placement(scene, segway, task, Everywhere())]

    first = make_task(guessed, "open", "cupboard", "drawer_slide")
    _, _, (answer,) = plan_by_hypothesis(guessed, first, plan_task)
    assert planned == ["drawer", "door_right", "door_left"]
    assert answer.plan.scene_hypotheses == {"cupboard": {"drawer_slide": 2}}
    assert answer.plan.status == "assumed"
    assert "joint type  door_left (20 %), assumed" in summary(answer, None)
    assert "probable    drawer (50 %): " in summary(answer, None)
    write_plan(answer.plan, tmp_path / "plan.json")
    assert verify_files(tmp_path / "plan.json", allow_assumed=True).valid
    plan, again, _ = open_plan(tmp_path / "plan.json", None, None, "to execute", allow_assumed=True)
    assert again.object("cupboard").model.joint("drawer_slide").kind == "revolute"
    record = run_plan(plan, again, segway, Everywhere(), world=really, allow_assumed=True)
    assert record.verdict == "done", record.reason


@pytest.mark.slow
def test_a_run_skips_a_hypothesis_without_a_plan(tmp_path: Path, segway: Robot) -> None:
    odds: Odds = (("drawer", 0.5), ("door_right", 0.3), ("door_left", 0.2))
    guessed = room(tmp_path / "guessed", odds, post=BLOCKS_ONE)
    stuck = room(tmp_path / "stuck", (("door_right", 1.0),), turn=0.01)
    task = make_task(guessed, "open", "cupboard", "drawer_slide")
    plan = plan_base_placement(guessed, segway, task, Everywhere(), config=PipelineConfig()).plan
    assert plan.status == "solved"
    record = run_plan(plan, guessed, segway, Everywhere(), world=stuck, tries=2)
    assert record.kinds == ("drawer", "door_left")


def test_if_no_hypothesis_has_a_plan_the_error_is_that_of_the_most_probable(guessed: Scene) -> None:
    task = make_task(guessed, "open", "cupboard", "door_hinge")
    planned = list[str]()

    def refuse(scene: Scene, _: Task) -> list[PlacementResult]:
        planned.append(scene.object("cupboard").hypotheses["door_hinge"][0].kind)
        raise TaskError(f"no hand holds a {planned[-1]}")

    with pytest.raises(TaskError, match="no hand holds a door_right"):
        plan_by_hypothesis(guessed, task, refuse)
    assert planned == [kind for kind, share in ALL if share >= MIN_PROBABILITY]
    likely = guessed.object("cupboard").hypotheses["door_hinge"]
    assert len(planned) == len(likely)
