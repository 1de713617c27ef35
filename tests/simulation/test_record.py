"""Run records round-trip, and other files are refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from momapos.core.errors import FileFormatError, InputError
from momapos.model.records.plans import Task
from momapos.simulation.run_record import (
    Collision,
    Execution,
    RunMotion,
    RunRecord,
    Slip,
    Visit,
    read_run,
    with_files,
    write_run,
)

HIT = Collision("arm", "fridge/door", 12.5, 0.001, 0.2, 3.1, "manipulate")
DONE = Execution(
    False, "the hold broke", "weld", 0.0, 1.5, 0.7, (HIT,), Slip(0.01, 0.2),
    clearance=0.02, resistance={"mass": 8.0}, time={"approach": 2.0}, notes=("a note",),
)  # fmt: skip
RECORD = RunRecord(
    scene="kitchen.json",
    robot="fetch",
    task=Task("open", "fridge", "door", 1.5),
    visits=(Visit((1.0, 2.0, 0.5), (1.01, 2.0, 0.5), 3.2, 8.0, ""),),
    execution=DONE,
    seed=4,
    noise=True,
)


def test_a_record_round_trips(tmp_path: Path) -> None:
    write_run(RECORD, tmp_path / "run.json")
    assert read_run(tmp_path / "run.json") == RECORD


def test_a_record_contains_the_motion_and_its_source_files(tmp_path: Path) -> None:
    motion = RunMotion(
        (0.0, 0.1), ("drive", "settle"), ((0.0, 0.0, 0.1), (0.1, 0.0, 0.1)),
        {"lift": (0.2, 0.3)}, (0.0, 0.0), (), ((0.0, 0.0, 0.0), (1.0, 0.0, -2.0)),
    )  # fmt: skip
    (tmp_path / "runs").mkdir()
    out, plan = tmp_path / "runs" / "run.json", tmp_path / "plan.json"
    named = with_files(RECORD, out, plan, "kitchen_small", np.array([1.0, 2.0, 0.5]))
    write_run(replace(named, motion=motion), out)
    read = read_run(out)
    assert read.motion == motion
    assert (out.parent / read.plan).resolve() == plan
    assert (read.world, read.world_at) == ("kitchen_small", (1.0, 2.0, 0.5))


def test_a_record_has_the_values_of_a_latch_only_if_one_is_turned(tmp_path: Path) -> None:
    plain = RunMotion((0.0, 0.1), ("drive", "settle"), ((0.0, 0.0, 0.1), (0.1, 0.0, 0.1)))
    turned = replace(plain, latch={"lever": (0.0, -0.7)})
    for motion, stored in ((plain, False), (turned, True)):
        write_run(replace(RECORD, motion=motion), tmp_path / "run.json")
        data = json.loads((tmp_path / "run.json").read_text())
        assert ("latch" in data["motion"]) == stored
        assert read_run(tmp_path / "run.json").motion == motion
    data["motion"]["latch"]["lever"] = []
    (tmp_path / "run.json").write_text(json.dumps(data))
    with pytest.raises(FileFormatError, match="the values of a latch"):
        read_run(tmp_path / "run.json")


def test_a_motion_with_lists_of_different_lengths_is_refused(tmp_path: Path) -> None:
    write_run(RECORD, tmp_path / "run.json")
    data = json.loads((tmp_path / "run.json").read_text())
    data["motion"] = {"times": [0.0, 0.1], "stages": ["drive"], "bases": []}
    (tmp_path / "run.json").write_text(json.dumps(data))
    with pytest.raises(FileFormatError, match="invalid run record"):
        read_run(tmp_path / "run.json")


@pytest.mark.parametrize(
    ("member", "value"),
    [
        ("times", [0.0, 1e9]), ("bases", [[0, 0, 0], [1e300, 0, 0]]), ("part", [0.0, -1e9]),
        ("joints", {"lift": [0.0, 1e300]}), ("forces", [[0, 0, 0], [0, 1e300, 0]]),
        ("poses", [[0, 0, 0, 1, 0, 0, 0], [0, 0, 0, 1, 1, 0, 0]]),
    ],
)  # fmt: skip
def test_a_motion_with_impossible_numbers_is_not_read(
    member: str, value: Any, tmp_path: Path
) -> None:
    path = tmp_path / "run.json"
    motion = RunMotion((0.0, 0.1), ("drive", "drive"), ((0.0, 0.0, 0.1), (0.1, 0.0, 0.1)))
    write_run(replace(RECORD, motion=motion), path)
    data = json.loads(path.read_text())
    data["motion"][member] = value
    path.write_text(json.dumps(data))
    with pytest.raises(FileFormatError, match="of a motion must"):
        read_run(path)


def test_a_record_with_impossible_results_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "run.json"
    for changed in (replace(DONE, wall=1e300), replace(DONE, resistance={"mass": -1e300})):
        write_run(replace(RECORD, execution=changed), path)
        with pytest.raises(FileFormatError, match="numbers must be at most 1e\\+09"):
            read_run(path)


def test_failed_attempts_round_trip_and_a_record_without_them_is_read(tmp_path: Path) -> None:
    tried = replace(RECORD, failed=(replace(DONE, base_pose=(1.0, 2.0, 0.5)),))
    write_run(tried, tmp_path / "run.json")
    assert read_run(tmp_path / "run.json") == tried
    data = json.loads((tmp_path / "run.json").read_text())
    del data["failed"]
    del data["execution"]["base_pose"]
    (tmp_path / "old.json").write_text(json.dumps(data))
    assert read_run(tmp_path / "old.json") == RECORD


def test_a_run_that_never_reached_the_object_is_a_failure_with_its_reason(tmp_path: Path) -> None:
    visit = Visit((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 1.0, 2.0, "out of reach at waypoint 3")
    record = replace(RECORD, visits=(visit,), execution=None)
    write_run(record, tmp_path / "run.json")
    data = json.loads((tmp_path / "run.json").read_text())
    assert data["success"] is False
    assert data["reason"] == "out of reach at waypoint 3"
    assert read_run(tmp_path / "run.json") == record


def test_nan_is_not_written(tmp_path: Path) -> None:
    bad = replace(RECORD, execution=replace(DONE, reached=float("nan")))
    with pytest.raises(InputError, match="NaN"):
        write_run(bad, tmp_path / "run.json")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "content",
    ["", "[]", "{}", '{"format": "momapos-run", "version": 2}', '{"format": "momapos-run", "vers'],
)
def test_other_files_are_refused(content: str, tmp_path: Path) -> None:
    (tmp_path / "run.json").write_text(content)
    with pytest.raises(FileFormatError, match=r"run\.json"):
        read_run(tmp_path / "run.json")
