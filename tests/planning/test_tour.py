"""Laws of several tasks one after the other."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from tests.rooms import Everywhere, corridor_room

from momapos.apps.cli.main import main
from momapos.apps.cli.tour import split
from momapos.core.errors import FileFormatError, TaskError
from momapos.model.plan_files.plan_format import read_plan
from momapos.model.plan_files.tour_format import read_tour
from momapos.model.robots.robot import Robot, load_robot
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene
from momapos.planning.config import PipelineConfig
from momapos.planning.placement.config import PlaceConfig
from momapos.planning.tour import Request, plan_tour
from momapos.verification.exact_check import PlanVerifier
from momapos.verification.tour_check import verify_tour

SAMPLED = PipelineConfig(place=PlaceConfig(grid=False), timeout=300.0)
DRAWER = ("cabinet_right", "drawer_middle_slide")
WORDS = [
    "place", "open", "kitchen_small", "/".join(DRAWER), "then", "pick", "bottle", "then", "close",
    "/".join(DRAWER), "--robot", "segway_ur5e",
]  # fmt: skip


@pytest.fixture(scope="module")
def kitchen() -> Scene:
    return load_scene("kitchen_small")


@pytest.fixture(scope="module")
def segway() -> Robot:
    return load_robot("segway_ur5e")


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tour of three tasks, and its plans."""
    file = tmp_path_factory.mktemp("tour") / "tour.json"
    assert main([*WORDS, "--out", str(file)]) == 0
    return file


def test_one_base_pose_serves_all_and_each_begins_as_the_one_before_ended(
    kitchen: Scene, segway: Robot
) -> None:
    requests = [Request("open", *DRAWER), Request("pick", "bottle"), Request("close", *DRAWER)]
    tour = plan_tour(kitchen, segway, requests, config=SAMPLED)
    assert tour.status == "solved"
    assert tour.stops == (1, 1, 1)
    plans = [step.plan for step in tour.steps]
    assert len({plan.base_pose for plan in plans}) == 1
    assert tour.driving == plans[0].navigation_cost
    for before, after in pairwise(plans):
        assert after.start == before.base_pose
        assert before.motion is not None
        assert before.motion.home is not None
        assert after.motion is not None
        assert (abs(before.motion.home[-1] - after.motion.approach[0]) < 1e-9).all()
    opened = kitchen.with_joint(*DRAWER, plans[0].task.to or 0.0)
    for plan, room in zip(plans, (kitchen, opened, opened), strict=True):
        assert plan.base_pose is not None
        assert plan.motion is not None
        verifier = PlanVerifier(room, segway, plan.task)
        assert verifier.check(plan.base_pose, plan.motion).valid
        assert all(check.ok for check in verifier.drive_checks(plan))
    assert plans[2].motion is not None
    assert plans[2].motion.home is None  # nothing follows
    assert len(tour.assumed) == 1


def test_where_no_base_pose_serves_all_the_stops_are_few(kitchen: Scene, segway: Robot) -> None:
    # The cup stands beyond the arm's length from wherever the drawer can be opened.
    requests = [Request("open", *DRAWER), Request("close", *DRAWER), Request("pick", "cup")]
    tour = plan_tour(kitchen, segway, requests, config=SAMPLED)
    assert tour.status == "solved"
    assert tour.stops == (1, 1, 2)
    first, _, last = (step.plan for step in tour.steps)
    assert last.start == first.base_pose
    assert last.navigation_cost is not None
    assert last.navigation_cost > 0.1
    assert tour.driving == pytest.approx((first.navigation_cost or 0.0) + last.navigation_cost)


@pytest.mark.parametrize("asked", [True, False])
def test_a_stop_from_which_the_next_task_cannot_be_done_is_made_elsewhere(
    tmp_path: Path, segway: Robot, monkeypatch: pytest.MonkeyPatch, asked: bool
) -> None:
    """The open door parts the mug from the side on which the robot has a way on."""
    mug = ', {"name": "mug", "pose": {"xyz": [3.3, -0.1, 0.9]}, "box": [0.06, 0.06, 0.1]}'
    corridor = corridor_room(tmp_path, end=4.0, extra=mug)
    requests = [Request("open", "cabinet", None, 1.2), Request("pick", "mug")]
    config = PipelineConfig(
        place=PlaceConfig(count=256, improve=1, rounds=2, grid=False), timeout=300.0
    )
    if not asked:
        monkeypatch.setattr("momapos.planning.tour.base_poses_elsewhere", lambda *_: None)
    tour = plan_tour(corridor, segway, requests, Everywhere(), config=config)
    assert tour.status == ("solved" if asked else "infeasible")
    assert tour.stops == (1, 2)
    first, last = (step.plan for step in tour.steps)
    assert last.start == first.base_pose
    assert first.base_pose is not None
    assert (first.base_pose[0] > 0.3) == asked


def test_a_task_without_an_answer_ends_the_tour_with_its_reasons(
    kitchen: Scene, segway: Robot
) -> None:
    requests = [Request("open", *DRAWER), Request("open", "dishwasher", "door_hinge")]
    config = PipelineConfig(place=PlaceConfig(rounds=1, grid=False), timeout=300.0)
    tour = plan_tour(kitchen, segway, requests, config=config)
    assert tour.status == "infeasible"
    assert tour.stops == (1, 2)
    assert [step.plan.status for step in tour.steps] == ["solved", "infeasible"]
    assert tour.steps[-1].plan.candidates.rejections


def test_what_a_task_means_depends_on_the_tasks_before_it(kitchen: Scene, segway: Robot) -> None:
    with pytest.raises(TaskError, match="nothing to close"):
        plan_tour(kitchen, segway, [Request("close", *DRAWER)])
    with pytest.raises(TaskError, match="nothing to open"):
        plan_tour(kitchen, segway, [Request("open", *DRAWER)] * 2)
    for verb, other in (("pick", "place"), ("place", "pick")):
        twice = [Request(verb, "cup"), Request("open", *DRAWER), Request(verb, "cup")]
        with pytest.raises(TaskError, match=f"{verb} cup.*before; {other} it in between"):
            plan_tour(kitchen, segway, twice)
    with pytest.raises(TaskError, match="how far"):
        plan_tour(kitchen, segway, [Request("open", *DRAWER, "max")])
    with pytest.raises(TaskError, match="1 to 20"):
        plan_tour(kitchen, segway, [])


def test_a_tour_file_names_plans_that_hold_and_follow(
    written: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tour = read_tour(written)
    assert [(step.stop, step.plan) for step in tour.steps] == [
        (1, "tour_1.json"), (1, "tour_2.json"), (1, "tour_3.json")
    ]  # fmt: skip
    capsys.readouterr()
    assert main(["verify", str(written), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["valid"]
    assert set(said["files"]) == {"tour_1.json", "tour_2.json", "tour_3.json", "tour.json"}


def test_plans_that_do_not_follow_are_told(written: Path, tmp_path: Path) -> None:
    for file in written.parent.iterdir():
        (tmp_path / file.name).write_text(file.read_text())

    def edit(name: str, **changes: Any) -> None:
        data = json.loads((tmp_path / name).read_text())
        (tmp_path / name).write_text(json.dumps({**data, **changes}))

    assert verify_tour(tmp_path / "tour.json")["tour.json"].valid
    home = json.loads((tmp_path / "tour_1.json").read_text())["home"]
    edit("tour_1.json", home=None)
    edit(
        "tour_3.json",
        scene_joints={DRAWER[0]: {DRAWER[1]: 0.2}},
        start={"x": 2, "y": -1.5, "yaw": 0},
    )
    edit("tour.json", stops=2)
    report = verify_tour(tmp_path / "tour.json")["tour.json"]
    assert [check.name for check in report.violations] == [
        "stops are counted from 1, in order", "plan 2: the arm has come home",
        "plan 3: the room is as it was left", "plan 3: starts where the base is",
    ]  # fmt: skip
    assert home


@pytest.mark.parametrize("name", ["../plan.json", "/etc/passwd", "..", "a/b.json", "a\0b"])
def test_a_tour_names_files_beside_it_alone(name: str, tmp_path: Path) -> None:
    data = {
        "format": "momapos-tour", "version": 1, "status": "solved", "stops": 1, "driving": 0.0,
        "steps": [{"stop": 1, "plan": name}],
    }  # fmt: skip
    (tmp_path / "tour.json").write_text(json.dumps(data))
    with pytest.raises(FileFormatError, match="beside the tour"):
        read_tour(tmp_path / "tour.json")


@pytest.mark.parametrize(
    "changes",
    [
        {"version": 2}, {"version": True}, {"steps": []}, {"steps": [{"stop": 0, "plan": "a"}]},
        {"steps": [{"stop": 1, "plan": "a.json"}] * 21}, {"status": "done"}, {"driving": "far"},
    ],
)  # fmt: skip
def test_what_is_no_tour_is_one_line(changes: dict[str, Any], tmp_path: Path) -> None:
    data = {
        "format": "momapos-tour", "version": 1, "status": "solved", "stops": 1, "driving": 0.0,
        "steps": [{"stop": 1, "plan": "a.json"}],
    }  # fmt: skip
    (tmp_path / "tour.json").write_text(json.dumps({**data, **changes}))
    with pytest.raises(FileFormatError, match=r"tour\.json: not a"):
        read_tour(tmp_path / "tour.json")


def test_what_takes_one_plan_says_so_of_a_tour(written: Path) -> None:
    with pytest.raises(FileFormatError, match="a tour of several plans"):
        read_plan(written)


def test_a_tour_is_carried_out_task_by_task(
    written: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run.json"
    capsys.readouterr()
    assert main(["run", str(written), "--no-noise", "--out", str(out), "--json"]) == 0
    records = json.loads(capsys.readouterr().out)
    assert [record["task"]["verb"] for record in records] == ["open", "pick", "close"]
    assert all(record["success"] for record in records)
    files = [json.loads((tmp_path / f"run_{k}.json").read_text()) for k in (1, 2, 3)]
    assert [file["task"] for file in files] == [record["task"] for record in records]
    assert not out.exists()
    arrived = [record["visits"][-1]["reached"] for record in records]
    assert arrived[0] == pytest.approx(arrived[1], abs=0.05)  # one base pose serves all


def test_of_a_tour_the_first_task_that_fails_is_the_last(
    written: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["run", str(written), "--no-noise", "--json"]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("momapos.workflows.replanning.Trip.go", lambda _, here, *__: (here, None))
        assert main(command) == 1
    said = capsys.readouterr()
    assert len(json.loads(said.out)) == 1
    assert "2 of 3 tasks were left" in said.err


def test_another_world_is_for_one_plan(written: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", str(written), "--world", "kitchen_small"]) == 2
    said = capsys.readouterr().err
    assert "one plan" in said
    assert said.count("\n") == 1


def test_words_are_told_apart_and_options_may_stand_anywhere() -> None:
    words = "open room a/b --to 30deg --seed 3 then pick c --robot r then close a/b --to=10deg"
    verb, first, further = split(words.split())
    assert verb == "open"
    assert " ".join(first) == "room a/b --to 30deg --seed 3 --robot r"
    assert further == [("pick", "c", None), ("close", "a/b", "10deg")]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("open kitchen_small fridge/door_hinge then", "write each further task as"),
        ("open kitchen_small fridge/door_hinge then pick", "write each further task as"),
        ("open kitchen_small fridge/door_hinge then shut fridge", "no verb 'shut'"),
        ("then pick cup", "no verb ''"),
        ("open kitchen_small fridge/door_hinge then pick cupp", "cup"),
        ("open kitchen_small fridge/door_hinge then pick cup --to", "--to needs a value"),
        ("open kitchen_small fridge/door_hinge then pick cup --at 1,2,0", "--at belongs to one"),
        ("open kitchen_small fridge/door_hinge then pick cup --method habitat", "habitat"),
        ("open kitchen_small fridge/door_hinge then pick cup --to 3cm", "--to"),
    ],
)  # fmt: skip
def test_words_that_make_no_tasks_are_one_line(
    words: str, says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["place", *words.split()]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert says in line
