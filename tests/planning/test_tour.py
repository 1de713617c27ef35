"""Laws of several tasks one after the other."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any, NoReturn

import pytest
from tests.commands import error_of, json_of
from tests.rooms import Everywhere, corridor_room

from momapos.apps.cli.main import main
from momapos.apps.cli.tour import split
from momapos.core.errors import FileFormatError, OutOfTimeError, TaskError
from momapos.core.stopwatch import look
from momapos.model.plan_files.plan_format import read_plan
from momapos.model.plan_files.tour_format import read_tour
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.planning.config import PipelineConfig
from momapos.planning.keyword_forms import plan_tour
from momapos.planning.placement.config import PlaceConfig
from momapos.planning.plan import plan_placement
from momapos.planning.query import PlacementQuery
from momapos.planning.result import PlacementResult
from momapos.planning.tour import Request
from momapos.verification.exact_check import PlanVerifier
from momapos.verification.plan_check import verify_tour

SAMPLED = PipelineConfig(place=PlaceConfig(grid=False), timeout=300.0)
DRAWER = ("cabinet_right", "drawer_middle_slide")
WORDS = [
    "place", "open", "kitchen_small", "/".join(DRAWER), "then", "pick", "bottle", "then", "close",
    "/".join(DRAWER), "--robot", "segway_ur5e",
]  # fmt: skip


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a tour of three tasks and its plans."""
    file = tmp_path_factory.mktemp("tour") / "tour.json"
    assert main([*WORDS, "--out", str(file)]) == 0
    return file


def test_one_base_pose_serves_all_tasks_and_each_begins_as_the_last_ended(
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
        assert (abs(before.motion.home[-1] - after.motion.approach[0]) < 1e-9).all()
    opened = kitchen.with_joint(*DRAWER, plans[0].task.to or 0.0)
    for plan, scene in zip(plans, (kitchen, opened, opened), strict=True):
        verifier = PlanVerifier(scene, segway, plan.task)
        assert verifier.check(plan.base_pose, plan.motion).valid
        assert all(check.ok for check in verifier.drive_checks(plan))
    assert plans[2].motion.home is None  # nothing follows
    assert len(tour.assumed) == 1


def test_if_no_base_pose_serves_all_tasks_the_stops_are_few(kitchen: Scene, segway: Robot) -> None:
    # The cup is out of reach of every base pose from which the drawer can be opened.
    requests = [Request("open", *DRAWER), Request("close", *DRAWER), Request("pick", "cup")]
    tour = plan_tour(kitchen, segway, requests, config=SAMPLED)
    assert tour.status == "solved"
    assert tour.stops == (1, 1, 2)
    first, _, last = (step.plan for step in tour.steps)
    assert last.start == first.base_pose
    assert last.navigation_cost > 0.1
    assert tour.driving == pytest.approx((first.navigation_cost or 0.0) + last.navigation_cost)


@pytest.mark.parametrize("searched", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_a_stop_from_which_the_next_task_is_infeasible_moves_to_another_region(
    tmp_path: Path, segway: Robot, monkeypatch: pytest.MonkeyPatch, searched: bool
) -> None:
    """The open door separates the mug from the side on which the robot can drive on."""
    mug = ', {"name": "mug", "pose": {"xyz": [3.3, -0.1, 0.9]}, "box": [0.06, 0.06, 0.1]}'
    corridor = corridor_room(tmp_path, end=4.0, extra=mug)
    requests = [Request("open", "cabinet", None, 1.2), Request("pick", "mug")]
    config = PipelineConfig(
        place=PlaceConfig(count=256, polish=1, rounds=2, grid=False), timeout=300.0
    )
    if not searched:
        monkeypatch.setattr("momapos.planning.tour.poses_in_other_regions", lambda *_: None)
    tour = plan_tour(corridor, segway, requests, Everywhere(), config=config)
    assert tour.status == ("solved" if searched else "infeasible")
    assert tour.stops == (1, 2)
    first, last = (step.plan for step in tour.steps)
    assert last.start == first.base_pose
    assert (first.base_pose[0] > 0.3) == searched


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


def _late() -> NoReturn:
    raise OutOfTimeError("late")


def _interrupted() -> NoReturn:
    """Interrupt once, since the second interrupt would end the command, and work on."""
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        signal.raise_signal(signal.SIGINT)
    while True:
        look()


@pytest.mark.parametrize(("end", "status"), [(_late, 4), (_interrupted, 130)])
def test_a_tour_keeps_the_plans_that_it_has_when_its_time_is_over_or_it_is_interrupted(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    end: Callable[[], NoReturn],
    status: int,
) -> None:
    def late(query: PlacementQuery) -> PlacementResult:
        if query.task.object == "cup":
            end()
        return plan_placement(query)

    monkeypatch.setattr("momapos.planning.tour.plan_placement", late)
    file = tmp_path / "tour.json"
    tasks = [*WORDS[:4], "then", "pick", "cup", "then", "close", "/".join(DRAWER), *WORDS[-2:]]
    tasks += ["--set", "place.grid=false"]
    handler = signal.getsignal(signal.SIGINT)
    assert main([*tasks, "--out", str(file)]) == status
    assert "2 further tasks have no answer yet" in capsys.readouterr().out
    assert signal.getsignal(signal.SIGINT) is handler
    tour = read_tour(file)
    assert tour.status == "timeout"
    assert [step.plan for step in tour.steps] == ["tour_1.json"]
    assert main(["verify", str(tmp_path / "tour_1.json")]) == 0
    assert main(["verify", str(file)]) == 1


def test_the_meaning_of_a_task_depends_on_the_tasks_before_it(
    kitchen: Scene, segway: Robot
) -> None:
    with pytest.raises(TaskError, match="already closed"):
        plan_tour(kitchen, segway, [Request("close", *DRAWER)])
    with pytest.raises(TaskError, match="already open"):
        plan_tour(kitchen, segway, [Request("open", *DRAWER)] * 2)
    for verb, other in (("pick", "place"), ("place", "pick")):
        twice = [Request(verb, "cup"), Request("open", *DRAWER), Request(verb, "cup")]
        with pytest.raises(TaskError, match=f"{verb} cup.*before; {other} it in between"):
            plan_tour(kitchen, segway, twice)
    with pytest.raises(TaskError, match="how far"):
        plan_tour(kitchen, segway, [Request("open", *DRAWER, "max")])
    with pytest.raises(TaskError, match="1 to 20"):
        plan_tour(kitchen, segway, [])


def test_a_tour_file_names_valid_plans_that_follow_each_other(written: Path) -> None:
    tour = read_tour(written)
    assert [(step.stop, step.plan) for step in tour.steps] == [
        (1, "tour_1.json"), (1, "tour_2.json"), (1, "tour_3.json")
    ]  # fmt: skip
    report = json_of("verify", str(written), "--json")
    assert report["valid"]
    assert set(report["files"]) == {"tour_1.json", "tour_2.json", "tour_3.json", "tour.json"}


def test_plans_that_do_not_follow_each_other_are_reported(written: Path, tmp_path: Path) -> None:
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
        "stops are numbered from 1, in order", "plan 2: arm has returned home",
        "plan 3: the room is as the previous plan leaves it",
        "plan 3: base starts where the previous plan ends",
    ]  # fmt: skip
    assert home


@pytest.mark.parametrize("name", ["../plan.json", "/etc/passwd", "..", "a/b.json", "a\0b"])
def test_a_tour_names_files_in_its_own_folder_only(name: str, tmp_path: Path) -> None:
    data = {
        "format": "momapos-tour", "version": 1, "status": "solved", "stops": 1, "driving": 0.0,
        "steps": [{"stop": 1, "plan": name}],
    }  # fmt: skip
    (tmp_path / "tour.json").write_text(json.dumps(data))
    with pytest.raises(FileFormatError, match="in the folder of the tour"):
        read_tour(tmp_path / "tour.json")


@pytest.mark.parametrize(
    "changes",
    [
        {"version": 2}, {"version": True}, {"steps": []}, {"steps": [{"stop": 0, "plan": "a"}]},
        {"steps": [{"stop": 1, "plan": "a.json"}] * 21}, {"status": "done"}, {"driving": "far"},
    ],
)  # fmt: skip
def test_an_invalid_tour_file_is_a_one_line_error(changes: dict[str, Any], tmp_path: Path) -> None:
    data = {
        "format": "momapos-tour", "version": 1, "status": "solved", "stops": 1, "driving": 0.0,
        "steps": [{"stop": 1, "plan": "a.json"}],
    }  # fmt: skip
    (tmp_path / "tour.json").write_text(json.dumps({**data, **changes}))
    with pytest.raises(FileFormatError, match=r"tour\.json: not a"):
        read_tour(tmp_path / "tour.json")


def test_a_reader_of_one_plan_refuses_a_tour(written: Path) -> None:
    with pytest.raises(FileFormatError, match="a tour of several plans"):
        read_plan(written)


def test_a_tour_is_executed_task_by_task(written: Path, tmp_path: Path) -> None:
    out = tmp_path / "run.json"
    records = json_of("run", str(written), "--no-noise", "--out", str(out), "--json")
    assert [record["task"]["verb"] for record in records] == ["open", "pick", "close"]
    assert all(record["success"] for record in records)
    files = [json.loads((tmp_path / f"run_{k}.json").read_text()) for k in (1, 2, 3)]
    assert [file["task"] for file in files] == [record["task"] for record in records]
    assert not out.exists()
    arrived = [record["visits"][-1]["reached"] for record in records]
    assert arrived[0] == pytest.approx(arrived[1], abs=0.05)  # one base pose serves all


def test_a_tour_ends_at_the_first_task_that_fails(
    written: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["run", str(written), "--no-noise", "--json"]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "momapos.workflows.replanning.Replanner.drive_and_plan",
            lambda _, here, *__: (here, None),
        )
        assert main(command) == 1
    output = capsys.readouterr()
    assert len(json.loads(output.out)) == 1
    assert "2 of 3 tasks were not started" in output.err


def test_the_world_option_refuses_a_tour(written: Path) -> None:
    assert "single plan" in error_of("run", str(written), "--world", "kitchen_small")


def test_tasks_are_split_at_then_and_options_may_be_anywhere() -> None:
    words = "open room a/b --to 30deg --seed 3 then pick c --robot r then close a/b --to=10deg"
    verb, first, further = split(words.split())
    assert verb == "open"
    assert " ".join(first) == "room a/b --to 30deg --seed 3 --robot r"
    assert further == [("pick", "c", None), ("close", "a/b", "10deg")]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("open kitchen_small fridge/door_hinge then", "write each further task as"),
        ("open kitchen_small fridge/door_hinge then pick", "write each further task as"),
        ("open kitchen_small fridge/door_hinge then tilt fridge", "no verb 'tilt'"),
        ("then pick cup", "no verb ''"),
        ("open kitchen_small fridge/door_hinge then pick cupp", "cup"),
        ("open kitchen_small fridge/door_hinge then pick cup --to", "--to needs a value"),
        ("open kitchen_small fridge/door_hinge then pick cup --at 1,2,0", "--at applies to one"),
        ("open kitchen_small fridge/door_hinge then pick cup --method habitat", "habitat"),
        ("open kitchen_small fridge/door_hinge then pick cup --to 3cm", "leave out joint and to"),
    ],
)  # fmt: skip
def test_an_invalid_command_of_tasks_is_a_one_line_error(words: str, message: str) -> None:
    assert message in error_of("place", *words.split())
