"""Laws of jobs, run with the real methods in the built-in kitchens."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from tests.commands import json_of, output_of
from tests.rooms import corridor_room

from momapos.apps.bench import job
from momapos.apps.bench import job as steps
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
from momapos.core.errors import SceneError
from momapos.model.scene import joint_resistance
from momapos.model.scene.scene_files import load_scene
from momapos.model.scene.scene_names import find_scene
from momapos.planning.grasps import handle_shapes, handles, part_grasps
from momapos.planning.query import PlacementQuery
from momapos.planning.result import PlacementResult

CUP = SuiteTask("cup", "pick", "kitchen_small", "segway_ur5e", "pick", "cup")


def run_job(task: SuiteTask, method: str, folder: Path = Path("unused")) -> BenchRow:
    return answer_job(Job("key", str(folder), task, method, Settings(timeout=10.0)))


def test_the_row_of_a_solved_job_has_its_plan_and_its_times() -> None:
    solved = run_job(CUP, "ours")
    assert (solved.outcome, solved.verified, solved.reason) == ("solved", True, "")
    assert len(solved.bases) == 1
    assert solved.driving is not None
    assert solved.seconds == pytest.approx(sum(solved.stages.values()), abs=0.02)
    assert from_plain(json.loads(json.dumps(to_plain(solved))), BenchRow, "here") == solved


def test_only_a_method_with_a_complete_search_reports_infeasible() -> None:
    floor = SuiteTask("d", "door", "kitchen_small", "segway_ur5e", "open", "dishwasher")
    ours, other = run_job(floor, "ours"), run_job(floor, "habitat")
    assert (ours.outcome, other.outcome) == ("infeasible", "gave up")
    assert ours.reason == other.reason == "the hand hits the floor in every grasp"
    assert ours.driving is None
    assert ours.verified is None


def test_an_invalid_task_yields_a_failed_row() -> None:
    row = run_job(replace(CUP, object="cupp"), "ours")
    assert row.outcome == "failed"
    assert "did you mean cup" in row.reason


def results_in(owner: object) -> int:
    """Return the number of results about handles, grasps and masses that an object caches."""
    modules = {one.__name__ for one in (handle_shapes, handles, part_grasps, joint_resistance)}
    results = vars(owner).get("_results")
    known = {} if results is None else results.of_function
    return sum(len(found) for function, found in known.items() if function.__module__ in modules)


@pytest.mark.parametrize("method", ["ours", "m3"])
def test_cached_data_of_a_task_is_computed_before_the_measurement(
    method: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Otherwise it would count only for the first method."""
    drawer = SuiteTask(
        "d", "", "kitchen_small", "segway_ur5e", "open", "cabinet_left", "drawer_slide"
    )
    run_job(CUP, method)  # loads the kernels
    job._scene.cache_clear()
    made: list[int] = []

    plan = steps.plan_with_method

    def watched(query: PlacementQuery) -> PlacementResult:
        models = [item.model for item in query.scene.objects]
        before = sum(map(results_in, [query.robot, *models]))
        assert before > 0
        result = plan(query)
        made.append(sum(map(results_in, [query.robot, *models])) - before)
        return result

    monkeypatch.setattr(steps, "plan_with_method", watched)
    assert run_job(drawer, method).outcome == "solved"
    assert made[0] <= 0  # what belongs to a dropped object may go


def with_egg(folder: Path) -> SuiteTask:
    """Write a built-in kitchen with an egg in a drawer, 15 cm behind its front."""
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


def test_an_object_in_a_drawer_is_picked_after_opening_the_drawer(tmp_path: Path) -> None:
    task = with_egg(tmp_path)
    row = run_job(task, "ours", tmp_path)
    assert (row.outcome, row.reason) == ("solved", "")
    assert len(row.bases) == 2
    closed = run_job(replace(task, inside=None, carried=()), "ours", tmp_path)
    assert closed.outcome == "infeasible"


def test_a_job_gives_up_if_the_second_step_cannot_start_at_the_first_base_pose(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    task, plan = with_egg(tmp_path), steps.plan_with_method

    def blocked(query: PlacementQuery) -> PlacementResult:
        if query.start is not None:
            raise SceneError("start (1.00, 2.00, 0 deg): its arm would touch a; give another")
        return plan(query)

    monkeypatch.setattr(steps, "plan_with_method", blocked)
    row = run_job(task, "ours", tmp_path)
    assert row.outcome == "gave up"
    assert row.reason == "after opening cabinet_left: its arm would touch a"
    assert len(row.bases) == 1
    alone = run_job(replace(CUP, start=(0.0, 0.0, 0.0)), "ours")
    assert alone.outcome == "failed"


@pytest.mark.parametrize("enabled", [True, False])
def test_if_the_object_is_out_of_reach_the_door_is_opened_from_its_other_side(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, enabled: bool
) -> None:
    """The open door separates the dead end with the mug from the side that the robot prefers."""
    scene = corridor_room(tmp_path, end=4.0)
    urdf = (tmp_path / "cabinet.urdf").read_text()
    (tmp_path / "cabinet.urdf").write_text(urdf.replace('upper="1.9"', 'upper="1.2"'))
    room = json.loads((tmp_path / "room.json").read_text())
    mug = {"name": "mug", "pose": {"xyz": [3.3, -0.1, 0.9]}, "box": [0.06, 0.06, 0.1]}
    room["objects"].append(mug)
    room["floor"] = scene.floor_polygon.tolist()
    room["start"] = dict(zip(("x", "y", "yaw"), scene.start.tolist(), strict=True))
    (tmp_path / "room.json").write_text(json.dumps(room))
    task = SuiteTask(
        "mug", "in cabinet", "room.json", "segway_ur5e", "pick", "mug",
        inside=Container("cabinet", "hinge"),
    )  # fmt: skip
    if not enabled:
        monkeypatch.setattr(steps, "poses_in_other_regions", lambda *_: None)
    row = run_job(task, "ours:place.grid=false", tmp_path)
    assert (row.outcome, row.verified) == ("solved" if enabled else "infeasible", True)
    assert (row.bases[0][0] > 0.3) == enabled
    assert steps.OTHER_POSES in row.stages
    assert row.seconds == pytest.approx(sum(row.stages.values()), abs=0.1)


def test_an_infeasible_opening_ends_the_job(tmp_path: Path) -> None:
    task = replace(with_egg(tmp_path), carried=())
    content = json.loads((tmp_path / "kitchen.json").read_text())
    content["objects"][-1]["on"] = None  # it stays behind
    (tmp_path / "kitchen.json").write_text(json.dumps(content))
    row = run_job(task, "ours", tmp_path)
    assert row.outcome == "infeasible"
    assert "egg" in row.reason
    assert row.bases == ()


@pytest.mark.timeout(300)
def test_a_second_run_of_a_suite_adds_no_row(tmp_path: Path) -> None:
    out = tmp_path / "out"
    command = ["bench", "run", "smoke", "--out", str(out), "--methods", "habitat", "--workers", "1"]
    first = json_of(*command, "--limit", "2", "--json")
    assert (first["jobs"], first["new"]) == (2, 2)
    assert "2 results, 0 of them new" in output_of(*command, "--limit", "2")
    rows = all_rows(out)
    assert {row.method for row in rows} == {"habitat"}
    assert all(row.outcome in ("solved", "gave up") for row in rows)
    assert "| habitat | 2 | " in output_of("bench", "report", str(out))
