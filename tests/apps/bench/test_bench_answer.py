"""Jobs answered in earnest: by the methods, in the built-in kitchens."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from tests.rooms import corridor_room

from momapos.apps.bench import steps
from momapos.apps.bench.bench_records import (
    Container,
    Job,
    Settings,
    SuiteTask,
    from_plain,
    to_plain,
)
from momapos.apps.bench.bench_records import Row as BenchRow
from momapos.apps.bench.folder import all_rows
from momapos.apps.bench.job import answer_job
from momapos.apps.cli.main import main
from momapos.core.errors import SceneError
from momapos.model.scene.scene_files import load_scene
from momapos.model.scene.scene_names import find_scene
from momapos.planning.baselines.by_method import plan_by_method
from momapos.planning.grasps import handle_shapes, handles, part_grasps, resistance

CUP = SuiteTask("cup", "pick", "kitchen_small", "segway_ur5e", "pick", "cup")


def ask(task: SuiteTask, method: str, folder: Path = Path("unused")) -> BenchRow:
    return answer_job(Job("key", str(folder), task, method, Settings(timeout=10.0)))


def test_a_row_says_what_came_of_a_job() -> None:
    solved = ask(CUP, "ours")
    assert (solved.outcome, solved.verified, solved.reason) == ("solved", True, "")
    assert len(solved.bases) == 1
    assert solved.driving is not None
    assert solved.seconds == pytest.approx(sum(solved.stages.values()), abs=0.02)
    assert from_plain(json.loads(json.dumps(to_plain(solved))), BenchRow, "here") == solved


def test_only_a_method_that_searches_to_the_end_says_infeasible() -> None:
    floor = SuiteTask("d", "door", "kitchen_small", "segway_ur5e", "open", "dishwasher")
    ours, other = ask(floor, "ours"), ask(floor, "habitat")
    assert (ours.outcome, other.outcome) == ("infeasible", "gave up")
    assert ours.reason == other.reason == "the hand hits the floor in every grasp"
    assert ours.driving is None
    assert ours.verified is None


def test_what_cannot_be_asked_is_a_row_that_failed() -> None:
    row = ask(replace(CUP, object="cupp"), "ours")
    assert row.outcome == "failed"
    assert "did you mean cup" in row.reason


@pytest.mark.parametrize("method", ["ours", "m3"])
def test_what_a_process_keeps_of_a_task_is_made_before_the_clock_starts(
    method: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else whoever is asked first pays for it."""
    kept = [
        one
        for module in (handle_shapes, handles, part_grasps, resistance)
        for one in vars(module).values()
        if hasattr(one, "cache_info")
    ]
    assert len(kept) > 5
    drawer = SuiteTask(
        "d", "", "kitchen_small", "segway_ur5e", "open", "cabinet_left", "drawer_slide"
    )
    ask(CUP, method)  # what is loaded once
    for one in kept:
        one.cache_clear()
    made: list[int] = []

    def watched(*args: Any, **kwargs: Any) -> Any:
        before = sum(one.cache_info().misses for one in kept)
        assert before > 0
        result = plan_by_method(*args, **kwargs)
        made.append(sum(one.cache_info().misses for one in kept) - before)
        return result

    monkeypatch.setattr(steps, "plan_by_method", watched)
    assert ask(drawer, method).outcome == "solved"
    assert made == [0]


def with_egg(folder: Path) -> SuiteTask:
    """A built-in kitchen with an egg in a drawer, 15 cm behind its front."""
    source = find_scene("kitchen_small")
    shutil.copytree(source.parent / "kitchen_small_urdf", folder / "kitchen_small_urdf")
    cabinet = load_scene("kitchen_small").object("cabinet_left")
    drawer = cabinet.model.joint("drawer_slide").child
    bottom = cabinet.model.urdf.links[drawer].collisions[1]
    top = bottom.T_link_geometry[2, 3] + bottom.size[2] / 2
    xyz = (cabinet.link_poses()[drawer] @ [0.0, 0.15, top + 0.026, 1.0])[:3].tolist()
    scene = json.loads(source.read_text())
    scene["objects"].append({"name": "egg", "pose": {"xyz": xyz}, "box": [0.045, 0.045, 0.05]})
    (folder / "kitchen.json").write_text(json.dumps(scene))
    return SuiteTask(
        "egg", "in drawer", "kitchen.json", "segway_ur5e", "pick", "egg",
        inside=Container("cabinet_left", "drawer_slide"), carried=("egg",),
    )  # fmt: skip


def test_a_thing_in_a_drawer_is_taken_after_the_drawer_was_opened(tmp_path: Path) -> None:
    task = with_egg(tmp_path)
    row = ask(task, "ours", tmp_path)
    assert (row.outcome, row.reason) == ("solved", "")
    assert len(row.bases) == 2
    shut = ask(replace(task, inside=None, carried=()), "ours", tmp_path)
    assert shut.outcome == "infeasible"


def test_who_stands_where_it_cannot_go_on_from_gave_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    task, plan = with_egg(tmp_path), steps.plan_by_method

    def in_the_way(*args: Any, **named: Any) -> Any:
        if named["start"] is not None:
            raise SceneError("start (1.00, 2.00, 0 deg): its arm would touch a; give another")
        return plan(*args, **named)

    monkeypatch.setattr(steps, "plan_by_method", in_the_way)
    row = ask(task, "ours", tmp_path)
    assert row.outcome == "gave up"
    assert row.reason == "where it opened cabinet_left: its arm would touch a"
    assert len(row.bases) == 1
    alone = ask(replace(CUP, start=(0.0, 0.0, 0.0)), "ours")
    assert alone.outcome == "failed"


@pytest.mark.parametrize("asked", [True, False])
def test_where_the_thing_cannot_be_taken_the_door_is_opened_from_its_other_side(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, asked: bool
) -> None:
    """The mug is in a dead end that the open door parts from the side that the robot prefers."""
    scene = corridor_room(tmp_path, end=4.0)
    urdf = (tmp_path / "cabinet.urdf").read_text()
    (tmp_path / "cabinet.urdf").write_text(urdf.replace('upper="1.9"', 'upper="1.2"'))
    room = json.loads((tmp_path / "room.json").read_text())
    assert scene.floor_polygon is not None
    assert scene.start is not None
    mug = {"name": "mug", "pose": {"xyz": [3.3, -0.1, 0.9]}, "box": [0.06, 0.06, 0.1]}
    room["objects"].append(mug)
    room["floor"] = scene.floor_polygon.tolist()
    room["start"] = dict(zip(("x", "y", "yaw"), scene.start.tolist(), strict=True))
    (tmp_path / "room.json").write_text(json.dumps(room))
    task = SuiteTask(
        "mug", "in cabinet", "room.json", "segway_ur5e", "pick", "mug",
        inside=Container("cabinet", "hinge"),
    )  # fmt: skip
    if not asked:
        monkeypatch.setattr(steps, "base_poses_elsewhere", lambda *_: None)
    row = ask(task, "ours:place.grid=false", tmp_path)
    assert (row.outcome, row.verified) == ("solved" if asked else "infeasible", True)
    assert (row.bases[0][0] > 0.3) == asked
    assert steps.ELSEWHERE in row.stages
    assert row.seconds == pytest.approx(sum(row.stages.values()), abs=0.1)


def test_a_drawer_that_cannot_be_opened_ends_the_job(tmp_path: Path) -> None:
    row = ask(replace(with_egg(tmp_path), carried=()), "ours", tmp_path)
    assert row.outcome == "infeasible"
    assert "egg" in row.reason
    assert row.bases == ()


@pytest.mark.timeout(300)
def test_a_suite_is_run_once_and_then_only_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    command = ["bench", "run", "smoke", "--out", str(out), "--methods", "habitat", "--workers", "1"]
    assert main([*command, "--limit", "2", "--json"]) == 0
    first = json.loads(capsys.readouterr().out)
    assert (first["jobs"], first["new"]) == (2, 2)
    assert main([*command, "--limit", "2"]) == 0
    assert "2 answers, 0 of them new" in capsys.readouterr().out
    rows = all_rows(out)
    assert {row.method for row in rows} == {"habitat"}
    assert all(row.outcome in ("solved", "gave up") for row in rows)
    assert main(["bench", "report", str(out)]) == 0
    assert "| habitat | 2 | " in capsys.readouterr().out
