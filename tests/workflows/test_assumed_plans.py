"""A plan for a less probable joint is `assumed`, and comes after everything else was tried."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from tests import optional
from tests.commands import error_of, json_of, output_of
from tests.real import CASES
from tests.rooms import Everywhere
from tests.shapes import unchecked
from tests.workflows.guessed_rooms import BLOCKS_ONE, BLOCKS_TWO, Odds, room

from momapos.apps.cli.console import summary
from momapos.apps.cli.main import main
from momapos.apps.web.words import answer_card, run_card
from momapos.core.errors import InputError
from momapos.model.plan_files.plan_format import read_plan, write_plan
from momapos.model.records.plans import Status, Task, status_of_all
from momapos.model.records.scans import Scan
from momapos.model.robots.robot import Robot, load_robot
from momapos.model.scene.other_motion import scene_with_hypothesis
from momapos.model.scene.scene import Scene
from momapos.perception.records import Modeled
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.importance.ranking import Importance
from momapos.planning.keyword_forms import plan_base_placement
from momapos.planning.result import PlacementResult, cheapest
from momapos.workflows import solve as solving
from momapos.workflows.joint_belief import plan_by_hypothesis
from momapos.workflows.run import run_plan
from momapos.workflows.solve import ScanAnswer, ScanTask, solve_scan

HINGE_FIRST: Odds = (("door_right", 0.96), ("drawer", 0.04))
DRAWER_FIRST: Odds = (("drawer", 0.8), ("door_left", 0.2))
ROBOT = "segway_ur5e"


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot(ROBOT)


def answer_in(scene: Scene, robot: Robot) -> PlacementResult:
    """Open the cupboard by the most probable hypothesis that has a plan."""
    (joint,) = scene.object("cupboard").model.joints
    task = make_task(scene, "open", "cupboard", joint)

    def plan(scene: Scene, task: Task) -> list[PlacementResult]:
        return [plan_base_placement(scene, robot, task, Everywhere())]

    _, _, answers = plan_by_hypothesis(scene, task, plan)
    return cheapest(answers)


@pytest.fixture(scope="module")
def assumed(tmp_path_factory: pytest.TempPathFactory, robot: Robot) -> PlacementResult:
    """Return the answer where a post blocks the door that the part most probably is."""
    folder = tmp_path_factory.mktemp("assumed") / "room"
    return answer_in(room(folder, HINGE_FIRST, post=BLOCKS_ONE), robot)


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory, assumed: PlacementResult) -> Path:
    path = tmp_path_factory.mktemp("assumed_plan") / "plan.json"
    write_plan(assumed.plan, path)
    return path


def test_a_plan_for_a_less_probable_joint_is_assumed_and_states_how_far_the_probable_one_opens(
    assumed: PlacementResult,
) -> None:
    plan, found = assumed.plan, assumed.plan.assumption
    assert plan.status == "assumed"
    assert plan.feasible
    assert (found.kind, found.instead_of) == ("drawer", "door_right")
    assert (found.probability, found.instead_probability) == pytest.approx((0.04, 0.96))
    assert 0.0 < found.feasible_to < np.pi / 2
    assert str(found) == "drawer (4 %)"
    assert (
        found.instead == f"door_right (96 %): feasible to {np.degrees(found.feasible_to):.0f} deg"
    )


def test_the_order_of_the_hypotheses_decides_and_not_the_kind_of_joint(
    tmp_path: Path, robot: Robot
) -> None:
    plan = answer_in(room(tmp_path / "drawer", DRAWER_FIRST, post=BLOCKS_TWO), robot).plan
    assert plan.status == "assumed"
    assert (plan.assumption.kind, plan.assumption.instead_of) == ("door_left", "drawer")
    assert plan.assumption.instead.startswith("drawer (80 %): ")
    for name, odds in (("free_hinge", HINGE_FIRST), ("free_drawer", DRAWER_FIRST)):
        plan = answer_in(room(tmp_path / name, odds), robot).plan
        assert (plan.status, plan.assumption, plan.scene_hypotheses) == ("solved", None, {})


def test_of_equal_probabilities_only_the_joint_of_the_scene_file_is_solved(
    tmp_path: Path, robot: Robot
) -> None:
    odds: Odds = (("door_right", 0.5), ("drawer", 0.5))
    plan = answer_in(room(tmp_path / "equal", odds, post=BLOCKS_ONE), robot).plan
    assert plan.status == "assumed"
    assert plan.assumption.probability == plan.assumption.instead_probability == 0.5
    turned: Odds = (odds[1], odds[0])
    assert answer_in(room(tmp_path / "turned", turned, post=BLOCKS_ONE), robot).plan.status == (
        "solved"
    )


def test_a_plan_for_a_joint_below_one_half_is_assumed_even_if_no_other_is_as_probable(
    tmp_path: Path, robot: Robot
) -> None:
    odds: Odds = (("drawer", 0.45), ("door_right", 0.3), ("door_left", 0.25))
    answer = answer_in(room(tmp_path / "three", odds), robot)
    plan, found = answer.plan, answer.plan.assumption
    assert (plan.status, plan.scene_hypotheses) == ("assumed", {})
    assert found.is_first
    assert plan.assumes == "cupboard/drawer_slide is a drawer (45 %)"
    assert "joint type  drawer (45 %), assumed: the most probable one, but" in summary(answer, None)
    write_plan(plan, tmp_path / "plan.json")
    data = json.loads((tmp_path / "plan.json").read_text())
    (tmp_path / "claims.json").write_text(json.dumps(data | {"status": "solved"}))
    for name in ("plan.json", "claims.json"):
        assert "cupboard/drawer_slide is a drawer (45 %)\n" in output_of(
            "verify", str(tmp_path / name), status=1
        )


def test_any_plan_in_a_scene_with_a_less_probable_joint_is_assumed(
    tmp_path: Path, robot: Robot
) -> None:
    scene = scene_with_hypothesis(room(tmp_path / "free", HINGE_FIRST), "cupboard", "door_hinge", 1)
    task = make_task(scene, "open", "cupboard", "door_hinge")
    plan = plan_base_placement(scene, robot, task, Everywhere()).plan
    assert plan.status == "assumed"
    assert plan.assumes == "a joint doesn't move in its most probable way"
    farthest = make_task(scene, "open", "cupboard", "door_hinge", "max")
    assert plan_base_placement(scene, robot, farthest, Everywhere()).plan.status == "assumed"


def test_a_solved_answer_ranks_before_an_assumed_one_and_one_assumed_task_makes_a_tour_assumed(
    assumed: PlacementResult,
) -> None:
    def other(status: Status) -> PlacementResult:
        return replace(assumed, plan=replace(assumed.plan, status=status, navigation_cost=99.0))

    order: list[Status] = ["infeasible", "timeout", "assumed", "solved"]
    for k, best in enumerate(order):
        answers = [other(status) for status in order[: k + 1]]
        assert cheapest(answers).plan.status == best
    solved, infeasible = other("solved").plan, other("infeasible").plan
    assert status_of_all([assumed.plan, solved]) == "assumed"
    assert status_of_all([solved, solved]) == "solved"
    assert status_of_all([assumed.plan, infeasible]) == "infeasible"


def test_a_plan_file_keeps_the_assumption_and_a_file_of_an_earlier_version_becomes_assumed(
    file: Path, assumed: PlacementResult, tmp_path: Path
) -> None:
    again = read_plan(file)
    assert (again.status, again.assumption) == ("assumed", assumed.plan.assumption)
    data = json.loads(file.read_text())
    del data["assumption"]
    data["status"] = "solved"
    (tmp_path / "old.json").write_text(json.dumps(data))
    old = read_plan(tmp_path / "old.json")
    assert (old.status, old.assumption) == ("assumed", None)
    data["scene_hypotheses"] = {}
    (tmp_path / "first.json").write_text(json.dumps(data))
    assert read_plan(tmp_path / "first.json").status == "solved"


@pytest.mark.parametrize("key", ["base_pose", "manipulation"])
def test_an_assumed_plan_without_its_motion_is_refused(
    file: Path, tmp_path: Path, key: str
) -> None:
    data = json.loads(file.read_text()) | {key: None}
    (tmp_path / "plan.json").write_text(json.dumps(data))
    assert f"{key} is missing; an assumed plan needs one" in error_of(
        "verify", str(tmp_path / "plan.json")
    )


def test_verify_refuses_an_assumed_plan_unless_it_is_allowed(file: Path) -> None:
    shown = output_of("verify", str(file), status=1)
    assert "cupboard/door_hinge is a drawer (4 %), not a door_right (96 %)" in shown
    assert "INVALID: 1 of" in shown
    assert main(["verify", str(file), "--allow-assumed"]) == 0


@pytest.mark.parametrize("command", [["run"], ["export", "--to", "csv"]])
def test_an_assumed_plan_is_neither_executed_nor_exported(file: Path, command: list[str]) -> None:
    assert "'assumed', not solved (cupboard/door_hinge is a drawer (4 %)" in error_of(
        command[0], str(file), *command[1:]
    )


def test_a_run_of_an_assumed_plan_says_that_the_part_moved_as_assumed_and_not_done(
    assumed: PlacementResult, robot: Robot
) -> None:
    scene = assumed.query.scene
    with pytest.raises(InputError, match="allow_assumed=True"):
        run_plan(assumed.plan, scene, robot, Everywhere())
    record = run_plan(assumed.plan, scene, robot, Everywhere(), allow_assumed=True)
    assert record.success, record.reason
    assert (record.verdict, record.assumed) == ("moved as assumed", "drawer")
    assert str(run_card(record)).startswith("Moved as assumed")


def test_the_page_says_what_is_assumed(assumed: PlacementResult) -> None:
    text = str(answer_card(assumed))
    assert text.startswith("Assumed, not solved\n")
    assert "drawer" in text
    assert "door_right (96 %): feasible to" in text


def test_place_exits_with_3_for_an_assumed_plan_unless_it_is_allowed(
    assumed: PlacementResult,
) -> None:
    words = ["place", "open", assumed.plan.scene, "cupboard", "--robot", ROBOT]
    data = json_of(*words, "--json", status=3)
    assert (data["status"], data["assumption"]["kind"]) == ("assumed", "drawer")
    shown = output_of(*words, "--allow-assumed")
    assert shown.splitlines()[0].endswith(": assumed")
    assert "probable    door_right (96 %): feasible to" in shown


FromScan = Callable[[Scene, Scene], ScanAnswer]


@pytest.fixture
def from_scan(monkeypatch: pytest.MonkeyPatch, robot: Robot, tmp_path: Path) -> FromScan:
    """Solve a scan that shows one scene while few objects are modeled, and another when all are."""

    def solve(few: Scene, every: Scene) -> ScanAnswer:
        names = {"cupboard": 1.0, "post": 0.3}
        ranked = Importance(
            "cupboard", tuple(names), np.array([1.0, 0.3]), 0.45, "reach", 0,
            None,  # type: ignore[arg-type]
        )  # fmt: skip

        def model_room(*_: object, **how: float) -> Modeled:
            modeled = [name for name, score in names.items() if score >= how["alpha"]]
            shown = every if len(modeled) == len(names) else few
            assert shown.path is not None
            decisions = tuple(
                SimpleNamespace(
                    detection=SimpleNamespace(name=name), reason="",
                    model=object() if name in modeled else None,
                )
                for name in names
            )  # fmt: skip
            return Modeled(shown.path, None, (), np.eye(4), decisions)  # type: ignore[arg-type]

        survey = SimpleNamespace(timing={})
        monkeypatch.setattr(solving, "survey", lambda *_, **__: survey)
        monkeypatch.setattr(solving, "rank_survey", lambda *_: ranked)
        monkeypatch.setattr(solving, "model_room", model_room)
        with unchecked():
            return solve_scan(
                Scan("scan", ()), [(robot, Everywhere())], ScanTask("open", "cupboard"),
                tmp_path / "scene.json", tools=SimpleNamespace(),  # type: ignore[arg-type]
            )  # fmt: skip

    return solve


def test_more_objects_are_modeled_before_a_less_probable_joint_is_tried(
    from_scan: FromScan, tmp_path: Path
) -> None:
    few = room(tmp_path / "few", HINGE_FIRST, post=BLOCKS_ONE)
    every = room(tmp_path / "every", HINGE_FIRST)
    answer = from_scan(few, every)
    assert answer.result.plan.status == "solved"
    assert answer.result.plan.scene_hypotheses == {}
    assert answer.alphas == (0.45, 0.3)
    answer = from_scan(few, few)
    assert answer.result.plan.status == "assumed"
    assert answer.alphas == (0.45, 0.3)


def test_a_scanned_freezer_door_is_not_solved_as_a_drawer() -> None:
    scene = optional.there(CASES / "scans/unlikely/scene.json")
    words = ["place", "open", str(scene), "fridge_1/door_2_hinge", "--robot", "tiago"]
    shown = output_of(*words, status=3)
    assert "door_2_hinge to 30 cm: assumed" in shown
    assert "joint type  drawer (1.5 %)" in shown
    assert "probable    door_right (96 %): not feasible" in shown


def test_a_tour_with_an_improbable_joint_is_assumed(tmp_path: Path) -> None:
    odds: Odds = (("drawer", 0.45), ("door_right", 0.3), ("door_left", 0.25))
    scene = room(tmp_path / "three", odds)
    words = ["place", "open", str(scene.path), "cupboard", "--to", "10cm", "--robot", ROBOT]
    words += ["--out", str(tmp_path / "tour.json")]
    words += ["then", "close", "cupboard"]
    shown = output_of(*words, status=3)
    assert shown.splitlines()[0].endswith(": assumed")
    assert "assumed: cupboard/drawer_slide is a drawer (45 %)" in shown
    assert main(["verify", str(tmp_path / "tour.json")]) == 1
    assert main(["verify", str(tmp_path / "tour.json"), "--allow-assumed"]) == 0
    assert main(["run", str(tmp_path / "tour.json")]) == 2
