"""A "yes" names the guesses about forces on which it depends."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.cupboards import HINGE, LATCHES, carcass, furniture_room, joint, link, turning

from momapos.model.records.plans import JointResistance
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.planning.advice import with_advice
from momapos.planning.answer_notes import SPRINGS
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.config import GraspConfig
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.planning.result import PlacementResult

QUICK = PipelineConfig(timeout=60.0)
DOWN = joint("hinge", "revolute", ("body", "door"), (-0.262, 0, 0.25), (0, -1, 0), (0, 1.2))
UP = joint("hinge", "revolute", ("body", "door"), (-0.262, 0, 0.85), (0, 1, 0), (0, 1.2))


def flap(side: int, mass: float) -> str:
    """Return a door that stands on its hinge (side 1), or hangs from it (-1)."""
    door = link(
        "door",
        ((0.02, 0.55, 0.58), (0, 0, side * 0.3)),
        handle=((0.02, 0.2, 0.02), (-0.05, 0, side * 0.54)),
    )
    inertial = f'<inertial><origin xyz="0 0 {side * 0.3}"/><mass value="{mass}"/></inertial>'
    return door.replace('name="door">', f'name="door">{inertial}', 1)


def answer_of(robot: Robot, scene: Scene, name: str, to: float) -> PlacementResult:
    task = make_task(scene, "open", "cupboard", name, to)
    return plan_base_placement(scene, robot, task, config=QUICK)


@pytest.mark.parametrize(("side", "hinge"), [(1, DOWN), (-1, UP)])
def test_a_yes_names_the_springs_on_which_it_depends_and_no_others(
    side: int, hinge: str, tmp_path: Path, fetch: Robot
) -> None:
    """A dishwasher's door and a lift-up door, too heavy without springs or light."""
    heavy = furniture_room(tmp_path, [carcass(), flap(side, 40.0), hinge])
    found = answer_of(fetch, heavy, "hinge", 0.9)
    assert found.plan.status == "solved"
    (note,) = [note for note in found.notes if SPRINGS in note]
    assert note.startswith(f"{SPRINGS} cupboard/hinge; without them, ")
    assert found.plan.resistance["cupboard"]["hinge"].balanced
    weighed = heavy.with_resistance({"cupboard": {"hinge": JointResistance(balanced=False)}})
    assert answer_of(fetch, weighed, "hinge", 0.9).plan.status == "infeasible"
    borne = heavy.with_resistance({"cupboard": {"hinge": JointResistance(balanced=True)}})
    assert not any(SPRINGS in note for note in answer_of(fetch, borne, "hinge", 0.9).notes)
    light = furniture_room(tmp_path, [carcass(), flap(side, 0.5), hinge])
    assert not any(SPRINGS in note for note in answer_of(fetch, light, "hinge", 0.9).notes)


def test_a_no_that_is_due_to_assumed_springs_says_so(tmp_path: Path, fetch: Robot) -> None:
    """The weight of a lift-up door helps to close it against its friction."""
    hinge = UP.replace("</joint>", '<dynamics friction="45"/></joint>')
    parts = [carcass(), flap(-1, 16.0), hinge]
    scene = furniture_room(tmp_path, parts).with_joint("cupboard", "hinge", 1.2)
    grasps = GraspConfig(families=("pinch",))
    config = replace(QUICK, motion=replace(QUICK.motion, grasps=grasps))
    task = make_task(scene, "close", "cupboard", "hinge", 0.9)
    answer = plan_base_placement(scene, fetch, task, config=config)
    assert answer.plan.status == "infeasible"
    words = "feasible without springs that bear the weight of cupboard/hinge, from"
    assert with_advice(answer).plan.advice.startswith(words)
    weighed = scene.with_resistance({"cupboard": {"hinge": JointResistance(balanced=False)}})
    assert plan_base_placement(weighed, fetch, task, config=config).plan.status == "solved"


@pytest.mark.parametrize("kind", ["a lever", "a sliding bolt"])
def test_a_yes_that_leaves_a_possible_latch_alone_names_it(
    kind: str, tmp_path: Path, fetch: Robot
) -> None:
    scene = furniture_room(tmp_path, LATCHES[kind][0])
    found = answer_of(fetch, scene, "hinge", np.pi / 4)
    assert found.plan.status == "solved"
    assert [note for note in found.notes if note.startswith("turn stays as it is, on the guess")]


def test_a_yes_names_a_leaf_on_the_part_that_may_swing_by_itself(
    tmp_path: Path, fetch: Robot
) -> None:
    handle = ((0.02, 0.02, 0.16), (-0.05, 0.53, 0.1))
    door = link("door", ((0.02, 0.59, 0.88), (0, 0.295, 0)), handle=handle)
    leaf = link("grip", ((0.02, 0.3, 0.4), (-0.04, -0.2, -0.25)))
    swings = turning("revolute", (0, 0, 1), (0, 1.5))
    scene = furniture_room(tmp_path, [carcass(), door, HINGE, leaf, swings])
    found = answer_of(fetch, scene, "hinge", 0.6)
    assert found.plan.status == "solved"
    assert [note for note in found.notes if note.startswith("turn on the part counts as held")]


def test_a_yes_names_the_friction_of_the_file_that_most_of_the_pull_is_due_to(
    tmp_path: Path, fetch: Robot
) -> None:
    hinge = UP.replace("</joint>", '<dynamics friction="9"/></joint>')
    scene = furniture_room(tmp_path, [carcass(), flap(-1, 2.0), hinge])
    found = answer_of(fetch, scene, "hinge", 0.6)
    assert found.plan.status == "solved"
    assert "most of the pull is due to 9 Nm by <dynamics friction> of hinge" in found.notes
