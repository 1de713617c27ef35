"""Laws of what a hand that pulls a part learns of how it moves."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.rooms import Everywhere

from momapos.config import PipelineConfig
from momapos.execution.config import ComplianceConfig, Ending
from momapos.geometry.transforms import apply
from momapos.joint_beliefs import JointBeliefs, joint_beliefs, save_learned
from momapos.manipulation.tasks import make_task
from momapos.pipeline import plan_base_placement
from momapos.reconstruction.build import build_scene
from momapos.reconstruction.model import furniture_model
from momapos.robots.robot import load_robot
from momapos.run_plan import run_plan
from momapos.scene.files import load_scene
from momapos.scene.scene import Scene
from momapos.types import Detection, FaceImage, Part, PartKind, UprightBox

CONFIG = ComplianceConfig()
Odds = tuple[tuple[PartKind, float], ...]
MIDDLE = (0.6, 0.4, 0.66, 0.6)


def room(folder: Path, odds: Odds, handle: tuple[float, float, float, float] = MIDDLE) -> Scene:
    """A cupboard before a robot, its one part believed to move in some ways."""
    pixels = (240, 240)
    color = np.full((*pixels, 3), 200, np.uint8)
    face = FaceImage(color, np.full(pixels, np.nan, np.float32), 0.6, 0.6)
    part = Part(odds[0][0], (0.0, 0.0, 1.0, 1.0), 0.9, handle, odds)
    box = UprightBox(np.array([1.5, 0.0, 0.8]), np.array([0.6, 0.5, 0.6]), -np.pi / 2)
    found = Detection("cupboard", "cabinet", 0.9, box, np.arange(3))
    piece = furniture_model(found, np.pi, face, [part], free=(True, True))
    floor = [(-2.0, -2.0), (2.0, -2.0), (2.0, 2.0), (-2.0, 2.0)]
    folder.mkdir()
    out = folder / "scene.json"
    build_scene([found], {"cupboard": piece}, floor, out, start=(0.0, 0.0, 0.0))
    return load_scene(out)


def beliefs_of(scene: Scene) -> JointBeliefs:
    (joint,) = scene.object("cupboard").model.joints
    return JointBeliefs(joint_beliefs(scene, make_task(scene, "open", "cupboard", joint)), CONFIG)


ALL: Odds = (("door_right", 0.55), ("door_left", 0.25), ("drawer", 0.12), ("door_down", 0.08))


@pytest.fixture(scope="module")
def guessed(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return room(tmp_path_factory.mktemp("beliefs") / "guessed", ALL)


@settings(max_examples=20, deadline=None)
@given(
    index=st.integers(0, 3), length=st.floats(0.15, 0.25), seed=st.integers(0, 1000),
    handle=st.tuples(st.floats(-0.2, 0.2), st.floats(-0.05, 0.2)),
)  # fmt: skip
def test_a_hand_that_goes_the_way_of_a_joint_makes_it_the_likeliest(
    guessed: Scene, index: int, length: float, seed: int, handle: tuple[float, float]
) -> None:
    beliefs = beliefs_of(guessed)
    axis = beliefs.beliefs[index].axis
    start = np.array([1.22, handle[0], 0.8 + handle[1]])
    values = np.linspace(0.0, length / axis.lever_at(start), 30)
    if values[-1] > 1.5:  # no part opens so far
        return
    noise = np.random.default_rng(seed).normal(0.0, 1e-3, (30, 3))
    way = [apply(axis.moved(v), start[None])[0] + e for v, e in zip(values, noise, strict=True)]
    other = beliefs.fail(way)
    weights = [belief.log_weight for belief in beliefs.beliefs]
    if index == 0:
        assert not beliefs_of(guessed).speaks_against(way)
    else:
        assert other is not None
        assert (other.way.kind, int(np.argmax(weights))) == (ALL[index][0], index)
        assert other.moved == pytest.approx(values[-1], abs=0.03 / axis.lever_at(start))


def test_a_part_that_does_not_yield_is_taken_for_the_next_likely_kind(guessed: Scene) -> None:
    beliefs, held = beliefs_of(guessed), [np.array([1.22, 0.1, 0.8])]
    tried = [beliefs.kind]
    for _ in range(3):
        beliefs.fail(held)
        tried.append(beliefs.kind)
    assert tried == ["door_right", "door_left", "drawer", "door_right"]


def test_where_the_scene_knows_how_a_part_moves_nothing_else_is_tried(tmp_path: Path) -> None:
    beliefs = beliefs_of(room(tmp_path / "known", (("door_left", 1.0),)))
    way = [np.array([1.22 - 0.01 * k, 0.001 * k, 0.8]) for k in range(20)]
    assert beliefs.kind == ""
    assert not beliefs.speaks_against(way)
    assert beliefs.likelier(way) is None
    assert beliefs.fail(way) is None


def test_a_door_hinged_at_the_other_side_than_believed_is_opened_and_remembered(
    tmp_path: Path,
) -> None:
    guessed = room(tmp_path / "guessed", (("door_right", 0.7), ("door_left", 0.3)))
    really = room(tmp_path / "really", (("door_left", 1.0),))
    robot = load_robot("segway_ur5e")
    task = make_task(guessed, "open", "cupboard", "door_hinge")
    plan = plan_base_placement(guessed, robot, task, Everywhere(), config=PipelineConfig()).plan
    record = run_plan(plan, guessed, robot, Everywhere(), world=really)
    assert record.success, record.reason
    assert record.kinds[0] == "door_right"
    assert record.kinds[-1] == "door_left"
    assert record.failed[0].ending == Ending.OTHERWISE
    assert record.execution is not None
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
