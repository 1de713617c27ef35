"""Plan files round-trip, and unusable ones raise one-line errors."""

from __future__ import annotations

import json
import shutil
import tracemalloc
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from door_case import make_case
from tests.rooms import Everywhere

from momapos.apps.cli.main import main
from momapos.core.errors import FileFormatError, InputError
from momapos.model.plan_files.plan_format import plan_to_dict, read_plan, write_plan
from momapos.model.records.plans import Motion, PlacementPlan
from momapos.model.robots.robot import load_robot
from momapos.model.scene.scene_files import load_scene
from momapos.model.scene.scene_names import LIBRARY
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.planning.placement.config import PlaceConfig
from momapos.verification.plan_check import verify_files

QUICK = PipelineConfig(place=PlaceConfig(count=256, polish=1))


@pytest.fixture
def plan(tmp_path: Path) -> PlacementPlan:
    return read_plan(make_case().write(tmp_path))


def same(a: PlacementPlan, b: PlacementPlan) -> bool:
    """Compare plans exactly; `==` fails on the arrays of a motion."""
    if (a.motion is None) != (b.motion is None):
        return False
    if a.motion is not None and b.motion is not None:
        for item in fields(Motion):
            x, y = getattr(a.motion, item.name), getattr(b.motion, item.name)
            if (x is None) != (y is None) or (x is not None and not np.array_equal(x, y)):
                return False
    return replace(a, motion=None) == replace(b, motion=None)


def test_a_plan_round_trips(plan: PlacementPlan, tmp_path: Path) -> None:
    assert plan.motion is not None
    noisy = replace(plan.motion, q=plan.motion.q + np.pi / 1e7)
    timed = replace(plan.motion, times=np.linspace(0.0, np.pi, len(plan.motion.q)))
    for item in (plan, replace(plan, motion=noisy), replace(plan, motion=timed)):
        write_plan(item, tmp_path / "again.json")
        assert same(read_plan(tmp_path / "again.json"), item)


def test_a_plan_without_a_solution_round_trips(plan: PlacementPlan, tmp_path: Path) -> None:
    none = replace(plan, status="timeout", base_pose=None, motion=None, navigation_cost=None)
    write_plan(none, tmp_path / "none.json")
    assert same(read_plan(tmp_path / "none.json"), none)


def test_a_plan_without_an_approach_round_trips(plan: PlacementPlan, tmp_path: Path) -> None:
    assert plan.motion is not None
    bare = replace(plan, motion=replace(plan.motion, approach=np.empty((0, 6))))
    write_plan(bare, tmp_path / "bare.json")
    assert same(read_plan(tmp_path / "bare.json"), bare)


def test_a_folder_of_plans_can_be_moved(plan: PlacementPlan, tmp_path: Path) -> None:
    write_plan(plan, tmp_path / "plans" / "plan.json")
    data = json.loads((tmp_path / "plans" / "plan.json").read_text())
    assert (data["scene"], data["robot"]["urdf"]) == ("../scene.json", "../robot.urdf")
    moved = tmp_path.with_name(f"{tmp_path.name}_moved")
    shutil.move(tmp_path, moved)
    assert verify_files(moved / "plans" / "plan.json").valid


def test_files_not_next_to_the_plan_are_found_below_the_scene_root(tmp_path: Path) -> None:
    case = make_case()
    case.write(tmp_path / "files")
    case.plan.update(scene="files/scene.json")
    case.plan["robot"]["urdf"] = "files/robot.urdf"
    (tmp_path / "elsewhere").mkdir()
    path = tmp_path / "elsewhere" / "plan.json"
    path.write_text(json.dumps(case.plan))
    with pytest.raises(FileFormatError, match="scene_root"):
        verify_files(path)
    assert verify_files(path, tmp_path).valid


def test_a_plan_with_built_in_files_is_verified_by_another_installation(tmp_path: Path) -> None:
    kitchen, robot = load_scene("kitchen_small"), load_robot("segway_ur5e")
    task = make_task(kitchen, "open", "fridge", "door_hinge")
    plan = plan_base_placement(kitchen, robot, task, Everywhere(), config=QUICK).plan
    write_plan(plan, tmp_path / "plan.json")
    data = json.loads((tmp_path / "plan.json").read_text())
    here = str(LIBRARY.parents[2])
    for other in ("/opt/env/lib/python3.13/site-packages/momapos", "/momapos/src/momapos"):
        moved = json.dumps(data).replace(f'"{here}/', f'"{other}/')
        assert here not in moved
        (tmp_path / "moved.json").write_text(moved)
        assert verify_files(tmp_path / "moved.json").valid
    for wrong in ("model/scene/library/kitchen_9.json", "model/scene/library/../__init__.py"):
        (tmp_path / "wrong.json").write_text(json.dumps({**data, "scene": f"/opt/momapos/{wrong}"}))
        with pytest.raises(FileFormatError, match="does not exist"):
            verify_files(tmp_path / "wrong.json")


def test_a_failed_write_leaves_the_old_file(plan: PlacementPlan, tmp_path: Path) -> None:
    path = tmp_path / "kept" / "plan.json"
    write_plan(plan, path)
    before = path.read_bytes()
    with pytest.raises(InputError, match="NaN"):
        write_plan(replace(plan, navigation_cost=float("nan")), path)
    with pytest.raises(InputError, match="does not exist"):
        write_plan(replace(plan, scene="nowhere.json"), path)
    assert path.read_bytes() == before
    assert [entry.name for entry in path.parent.iterdir()] == ["plan.json"]


def test_the_dictionary_of_a_plan_equals_its_file(plan: PlacementPlan, tmp_path: Path) -> None:
    write_plan(plan, tmp_path / "again.json")
    data = json.loads((tmp_path / "again.json").read_text())
    assert set(data.pop("hashes")) == {"scene", "robot"}
    expected = plan_to_dict(plan)
    assert {**data, "scene": 0, "robot": 0} == {**expected, "scene": 0, "robot": 0}


def text(change: Callable[[dict[str, Any]], object]) -> str:
    """Return the text of the plan file with a change."""
    data = make_case().plan
    change(data)
    return json.dumps(data)


WHOLE = json.dumps(make_case().plan)
MALFORMED: dict[str, tuple[str, str]] = {
    "empty": ("", "is empty"),
    "blank": (" \n", "is empty"),
    "truncated": (WHOLE[:-40], "invalid JSON"),
    "not JSON": ("robot: fetch", "invalid JSON"),
    "deep": ("[" * 100_000, "invalid JSON|object"),
    "a list": ("[]", "object"),
    "a scene": ('{"format": "momapos-scene", "version": 1}', "momapos-plan"),
    "no format": ("{}", "momapos-plan"),
    "a later version": (text(lambda d: d.update(version=3)), "version 3"),
    "version as text": (text(lambda d: d.update(version="1")), "version '1'"),
    "version as truth": (text(lambda d: d.update(version=True)), "version True"),
    "NaN": (WHOLE.replace("0.7", "NaN", 1), "invalid JSON"),
    "Infinity": (text(lambda d: d["base_pose"].update(x=float("inf"))), "invalid JSON"),
    "too large a number": (WHOLE.replace("-0.7,", "1e999,", 1), "out of range|invalid"),
    "a word for a number": (text(lambda d: d["base_pose"].update(x="0")), r"base_pose\.x"),
    "null in q": (text(lambda d: d["manipulation"]["q"][3].__setitem__(0, None)), r"q\[3\]"),
    "no scene": (text(lambda d: d.pop("scene")), "`scene`"),
    "no joints": (text(lambda d: d.pop("joints")), "`joints`"),
    "empty joints": (text(lambda d: d.update(joints=[])), "joints is empty"),
    "a joint twice": (text(lambda d: d["joints"].__setitem__(1, "pan")), "twice"),
    "no base pose": (text(lambda d: d.pop("base_pose")), "base_pose is missing"),
    "no motion": (text(lambda d: d.pop("manipulation")), "manipulation is missing"),
    "unknown verb": (text(lambda d: d["task"].update(verb="shake")), "shake"),
    "unknown status": (text(lambda d: d.update(status="perhaps")), "perhaps"),
    "no joint to open": (text(lambda d: d["task"].update(joint=None)), "joint"),
    "no goal": (text(lambda d: d["task"].update(to=None)), "to"),
    "name with NUL": (text(lambda d: d.update(scene="a\0b")), "scene"),
    "short row": (text(lambda d: d["manipulation"]["q"][3].pop()), "rows of different length"),
    "narrow q": (
        text(lambda d: d["manipulation"].update(q=[[0.0] * 5] * 41)), "need 6, one per joint",
    ),
    "too few values of the door": (
        text(lambda d: d["manipulation"]["object_q"].pop()), "41 q, 40 object_q and 41",
    ),
    "too few times": (text(lambda d: d["manipulation"].update(times=[0.0])), "manipulation.times"),
    "narrow approach": (text(lambda d: d.update(approach=[[0.0]])), "approach"),
    "3x3 poses": (
        text(lambda d: d["manipulation"].update(T_world_tool=[np.eye(3).tolist()])), "4 x 4",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", MALFORMED)
def test_a_malformed_file_is_rejected_in_one_line(name: str, tmp_path: Path) -> None:
    content, message = MALFORMED[name]
    path = make_case().write(tmp_path)
    path.write_text(content)
    with pytest.raises(FileFormatError, match=message) as caught:
        read_plan(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_files_and_binaries_are_rejected(tmp_path: Path) -> None:
    for path, why in (
        (tmp_path / "none.json", "no such file"),
        (tmp_path, "is a folder"),
        (Path("/dev/null"), "regular file"),
    ):
        with pytest.raises(FileFormatError, match=why):
            read_plan(path)
    (tmp_path / "binary").write_bytes(bytes(range(256)))
    with pytest.raises(FileFormatError, match="invalid"):
        read_plan(tmp_path / "binary")


def test_a_file_that_is_too_large_is_rejected(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("momapos.model.plan_files.plan_format.MAX_BYTES", 100)
    with pytest.raises(FileFormatError, match="larger"):
        read_plan(make_case().write(tmp_path))


def test_a_plan_with_a_jump_is_rejected_before_its_states_are_allocated(tmp_path: Path) -> None:
    assert verify_files(
        make_case().write(tmp_path)
    ).valid  # warm up, so that caches are not counted
    for jump in (1e3, 9e5):
        case = make_case()
        case.plan["manipulation"]["object_q"][1] = jump
        tracemalloc.start()
        report = verify_files(case.write(tmp_path))
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert [check.name for check in report.violations] == ["states to check"]
        assert peak < 50_000_000


def test_the_exit_status_distinguishes_valid_invalid_and_unusable_plans(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    case = make_case()
    path = str(case.write(tmp_path))
    assert main(["verify", path]) == 0
    assert capsys.readouterr().out.endswith("\nVALID\n")
    case.plan["base_pose"]["x"] += 0.1
    case.write(tmp_path)
    assert main(["verify", path]) == 1
    assert "FAIL FK position" in capsys.readouterr().out
    assert main(["verify", path, "--json"]) == 1
    data = json.loads(capsys.readouterr().out)
    assert data["valid"] is False
    assert len(data["checks"]) > 15
    case.plan["version"] = 9
    case.write(tmp_path)
    assert main(["verify", path]) == 2
    output = capsys.readouterr()
    assert output.out == ""
    assert output.err.count("\n") == 1
