"""Laws of the map of openings."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.apps.plots.test_plot import answer_of, size_of, unsolved
from tests.commands import error_of

from momapos import planning
from momapos.apps.cli.main import main
from momapos.apps.plots.opening_plot import (
    _figure,
    _figure_alone,
    draw_opening_map,
    draw_opening_map_alone,
)
from momapos.core import OutOfTimeError
from momapos.model.records.plans import Task
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import check_base_pose
from momapos.planning.opening_maps import YAWS, OpeningMap, opening_map
from momapos.planning.placement.problem import Search
from momapos.planning.reachability.map_store import load_reach_map


@pytest.fixture(scope="module")
def task(kitchen: Scene) -> Task:
    return make_task(kitchen, "open", "dishwasher", "door_hinge")


@pytest.fixture(scope="module")
def seen(kitchen: Scene, fetch: Robot, task: Task) -> OpeningMap:
    return opening_map(kitchen, fetch, task, load_reach_map(fetch), cell=0.4)


def pose_of(seen: OpeningMap, row: int, column: int) -> tuple[float, float, float]:
    x, y = seen.low + seen.cell * (np.array([column, row]) + 0.5)
    return float(x), float(y), float(seen.yaw[row, column])


def test_from_every_colored_cell_the_part_opens_to_its_value(
    kitchen: Scene, fetch: Robot, task: Task, seen: OpeningMap
) -> None:
    cells = np.argwhere(np.isfinite(seen.farthest))
    assert len(cells) > 3
    assert len(np.unique(seen.farthest[np.isfinite(seen.farthest)])) > 1
    for row, column in cells.tolist():
        assert seen.farthest[row, column] in seen.values
        one = replace(task, to=float(seen.farthest[row, column]))
        pose = pose_of(seen, row, column)
        assert check_base_pose(kitchen, fetch, one, pose, how_far=False).motion is not None


def test_one_waypoint_beyond_the_value_of_a_cell_no_yaw_works(
    kitchen: Scene, fetch: Robot, task: Task, seen: OpeningMap
) -> None:
    row, column = np.argwhere(seen.farthest == np.nanmax(seen.farthest))[0].tolist()
    x, y, _ = pose_of(seen, row, column)
    beyond = seen.values[np.searchsorted(seen.values, seen.farthest[row, column]) + 1]
    one = replace(task, to=float(beyond))
    for yaw in (2 * np.pi / YAWS * np.arange(YAWS) - np.pi).tolist():
        assert check_base_pose(kitchen, fetch, one, (x, y, yaw), how_far=False).motion is None


def test_a_cell_has_the_color_of_its_value_in_the_legend(
    kitchen: Scene, fetch: Robot, seen: OpeningMap, tmp_path: Path
) -> None:
    answer = answer_of(kitchen, fetch, "open", "dishwasher", "door_hinge")
    figure = _figure(kitchen, answer, seen)
    cells, bar = (axes.images[0] for axes in figure.axes)
    colors, legend = cells.to_rgba(cells.get_array()), bar.to_rgba(bar.get_array())
    ticks = figure.axes[1].get_yticks().astype(int)
    words = [label.get_text() for label in figure.axes[1].get_yticklabels()]
    assert words == [f"{np.degrees(seen.values[k]):.4g}°" for k in ticks]
    for row, column in np.argwhere(np.isfinite(seen.farthest)).tolist():
        k = int(np.searchsorted(seen.values, seen.farthest[row, column]))
        np.testing.assert_array_equal(colors[row, column], legend[k, 0])
    assert (colors[np.isnan(seen.farthest)][:, 3] == 0).all()
    assert len(np.unique(legend[:, 0], axis=0)) == len(seen.values)
    alone = _figure_alone(seen).axes[0].images[0]
    np.testing.assert_array_equal(alone.to_rgba(alone.get_array()), colors)
    path = tmp_path / "map.png"
    draw_opening_map(kitchen, answer, seen, path)
    assert size_of(path) == (1600, 1120)


def test_a_part_that_opens_from_nowhere_has_a_figure_too(
    kitchen: Scene, fetch: Robot, seen: OpeningMap, tmp_path: Path
) -> None:
    answer = answer_of(kitchen, fetch, "open", "dishwasher", "door_hinge")
    none = np.empty((0, 0))
    empty = replace(seen, farthest=none, yaw=none)
    path = tmp_path / "map.svg"
    draw_opening_map(kitchen, unsolved(answer, Search()), empty, path)
    assert path.read_bytes().startswith(b"<?xml")
    draw_opening_map_alone(empty, path)
    assert path.read_bytes().startswith(b"<?xml")


def test_the_map_option_writes_a_figure(tmp_path: Path) -> None:
    words = ["place", "open", "kitchen_small", "cabinet_left/drawer_slide", "--to", "5cm"]
    assert "unsupported figure format" in error_of(*words, "--map", str(tmp_path / "map.txt"))
    assert main([*words, "--map", str(tmp_path / "map.png")]) == 0
    assert size_of(tmp_path / "map.png") == (1600, 1120)


def test_a_time_limit_holds_for_the_map_and_leaves_the_plan(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def endless(*_: Any, **__: Any) -> OpeningMap:
        raise OutOfTimeError("the time limit of 100 s is over")

    monkeypatch.setattr(planning, "opening_map", endless)
    words = ["place", "open", "kitchen_small", "cabinet_left/drawer_slide", "--to", "5cm"]
    plan, drawn = tmp_path / "plan.json", tmp_path / "map.png"
    assert main([*words, "--timeout", "100", "--map", str(drawn), "--out", str(plan)]) == 4
    printed = capsys.readouterr()
    assert "solved" in printed.out
    assert printed.err.count("\n") == 1
    assert f"{drawn} is not written: the time limit of 100 s is over" in printed.err
    assert plan.exists()
    assert not drawn.exists()
