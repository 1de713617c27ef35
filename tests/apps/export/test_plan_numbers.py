"""Plans with numbers that `verify` rejects are refused before they are exported, run or shown."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.commands import error_of
from tests.rooms import Everywhere

from momapos.apps.cli.main import main
from momapos.apps.cli.view import opened_source
from momapos.core.errors import FileFormatError, InputError
from momapos.model.plan_files.plan_format import write_plan
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene_files import load_scene
from momapos.model.trajectory import with_times
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.planning.placement.config import PlaceConfig

Change = Callable[[dict[str, Any]], None]
COUNT = 60
"""Randomly mutated plans [-]."""


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory, segway: Robot) -> dict[str, Any]:
    kitchen = load_scene("kitchen_small")
    task = make_task(kitchen, "open", "fridge", "door_hinge")
    config = PipelineConfig(place=PlaceConfig(count=256, polish=1))
    found = plan_base_placement(kitchen, segway, task, Everywhere(), config=config).plan
    path = tmp_path_factory.mktemp("plan") / "fridge.json"
    write_plan(with_times(found, segway), path)
    content: dict[str, Any] = json.loads(path.read_text())
    return content


def _joint(value: float) -> Change:
    return lambda plan: plan["manipulation"]["q"][3].__setitem__(2, value)


def _approach(value: float) -> Change:
    return lambda plan: plan["approach"][-2].__setitem__(0, value)


def _object(plan: dict[str, Any]) -> None:
    plan["manipulation"]["object_q"] = [9.0 * v for v in plan["manipulation"]["object_q"]]


def _tool(plan: dict[str, Any]) -> None:
    plan["manipulation"]["T_world_tool"][5][0][3] += 1.0


def _path(plan: dict[str, Any]) -> None:
    plan["base_path"][4][0] += 3.0


def _base(plan: dict[str, Any]) -> None:
    plan["base_pose"]["x"] = 1e9


def _times(plan: dict[str, Any]) -> None:
    plan["manipulation"]["times"] = [0.01 * t for t in plan["manipulation"]["times"]]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (_joint(1e4), "joint limits"), (_joint(1e6), "finite"), (_joint(1e300), "finite"),
        (_approach(-1e5), "joint limits"), (_object, "object ends"), (_tool, "FK position"),
        (_path, "step of the base path"), (_base, "finite"), (_times, "joint speed"),
    ],
)  # fmt: skip
def test_numbers_that_verify_rejects_are_not_exported(
    plan: dict[str, Any], tmp_path: Path, change: Change,
    words: str,
) -> None:  # fmt: skip
    changed = copy.deepcopy(plan)
    change(changed)
    path = tmp_path / "plan.json"
    path.write_text(json.dumps(changed))
    for to in ("csv", "npz", "ros2"):
        assert words in error_of("export", str(path), "--to", to, "--out", str(tmp_path / "out"))
    assert words in error_of("run", str(path), "--out", str(tmp_path / "run.json"))
    with pytest.raises(FileFormatError, match=words), opened_source(str(path), None):
        pass
    assert list(tmp_path.iterdir()) == [path]


def test_randomly_mutated_plans_are_exported_or_refused(
    plan: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(0)
    path, out = tmp_path / "plan.json", tmp_path / "out.csv"
    statuses = set()
    for _ in range(COUNT):
        changed = copy.deepcopy(plan)
        for _ in range(rng.integers(1, 4)):
            _mutate(changed, rng)
        path.write_text(json.dumps(changed))
        status = main(["export", str(path), "--to", "csv", "--out", str(out)])
        assert status in (0, 2)
        refusal = capsys.readouterr().err
        assert refusal.count("\n") == (1 if status == 2 else 0)
        assert out.exists() == (status == 0)
        out.unlink(missing_ok=True)
        statuses.add(status)
        try:
            with opened_source(str(path), None) as opened:
                assert opened is None or status == 0, refusal  # None: the format names no plan
        except InputError:
            assert status == 2
    assert statuses == {0, 2}


def _mutate(value: Any, rng: np.random.Generator) -> None:
    """Replace, remove or swap one member somewhere in a document."""
    while True:
        keys = list(value) if isinstance(value, dict) else range(len(value))
        if not keys:
            return
        key = keys[rng.integers(len(keys))]
        inner = value[key]
        if isinstance(inner, dict | list) and inner and rng.random() < 0.85:
            value = inner
            continue
        words = (0, -1, 1e4, 1e300, 10**20, True, None, "", "x", [], {}, [[1.0]], {"a": 1}, 0.1)
        value[key] = words[rng.integers(len(words))]
        return
