"""The first answer of a new robot, which does not wait for its reachability map."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from tests.urdf_parts import mobile_manipulator

from momapos.apps.cli import loading
from momapos.core.errors import OutOfTimeError
from momapos.model.robots.derive import write_robot
from momapos.planning.reachability.map_store import ArmLength
from momapos.planning.reachability.reach_map import ReachMap


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """Collect the commands of processes instead of starting them."""
    found: list[list[str]] = []
    monkeypatch.setenv(loading.BEHIND, "1")
    monkeypatch.setattr(subprocess, "Popen", lambda words, **_: found.append(words))
    return found


@pytest.fixture
def new(tmp_path: Path) -> str:
    path = tmp_path / "robot.urdf"
    path.write_text(mobile_manipulator())
    return str(write_robot(path)[0])


def test_a_solved_task_of_a_new_robot_needs_no_map(
    new: str, started: list[list[str]], capsys: pytest.CaptureFixture[str]
) -> None:
    queried: list[tuple[Any, float]] = []

    def plan(arms: Any, limit: float) -> str:
        queried.append((arms, limit))
        return "solved"

    assert loading.plan_before_maps(new, "any", plan, "solved".__eq__) == "solved"
    ((((_, reach),), limit),) = queried
    assert isinstance(reach, ArmLength)
    assert limit == loading.FIRST_TIME
    command = [sys.executable, "-P", "-m", "momapos", "reach", "build", new]
    assert started == [command]
    assert "without its reachability map" in capsys.readouterr().err


@pytest.mark.parametrize("late", [False, True])
def test_a_task_that_is_not_solved_without_maps_waits_for_them(
    new: str, started: list[list[str]], monkeypatch: pytest.MonkeyPatch, late: bool
) -> None:
    monkeypatch.setattr(loading, "load_arms_with_maps", lambda *_: ((1,), ["map"]))

    def plan(arms: Any, limit: float) -> str:
        if late and limit < math.inf:
            raise OutOfTimeError("late")
        return "infeasible" if limit < math.inf else f"by {arms[0][1]}"

    assert loading.plan_before_maps(new, "any", plan, "solved".__eq__) == "by map"
    assert not started


@pytest.mark.parametrize("quick", [False, True])
def test_a_robot_with_a_map_is_planned_with_it(quick: bool, started: list[list[str]]) -> None:
    queried: list[Any] = []

    def plan(arms: Any, limit: float) -> str:
        queried.append((arms[0][1], limit))
        return "infeasible"

    loading.plan_before_maps("fetch", "any", plan, "solved".__eq__, quick=quick)
    ((reach, limit),) = queried
    assert isinstance(reach, ReachMap)
    assert limit == math.inf
    assert not started
