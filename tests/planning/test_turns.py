"""Laws of turning a wheel by several grasps: equal turns that end at the value."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from tests.cupboards import furniture_room, link

from momapos.core.errors import TaskError
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.task_requests import GRASP_TURN, make_task, turns_to
from momapos.planning.keyword_forms import plan_tour
from momapos.planning.tour import Request, expanded

RIM = [
    ((0.02, 0.026, 0.02), (0.0, 0.1 * math.cos(a), 0.1 * math.sin(a)))
    for a in np.linspace(0, 2 * np.pi, 25)[:-1]
]
SPOKES = [((0.016, 0.2, 0.016), (0.0, 0.0, 0.0)), ((0.016, 0.016, 0.2), (0.0, 0.0, 0.0))]


def valve(folder: Path, limit: str = "") -> Scene:
    """Return a room with a hand wheel on a stand; without limits it turns for ever."""
    stand = link(
        "stand", ((0.1, 0.1, 0.95), (0.1, 0, 0.475)), ((0.16, 0.024, 0.024), (0.06, 0, 1.0))
    )
    kind = "revolute" if limit else "continuous"
    turn = (
        f'<joint name="turn" type="{kind}"><parent link="stand"/><child link="wheel"/>'
        f'<origin xyz="-0.05 0 1.0"/><axis xyz="-1 0 0"/>{limit}</joint>'
    )
    return furniture_room(folder, [stand, link("wheel", *RIM, *SPOKES), turn], "valve")


@pytest.mark.parametrize(("turn", "count"), [("200deg", 3), ("360deg", 4), ("-720deg", 8)])
def test_a_wheel_is_turned_in_equal_parts_that_end_at_the_value(
    tmp_path: Path, turn: str, count: int
) -> None:
    scene = valve(tmp_path)
    requests = expanded([Request("open", "valve", None, turn)], scene)
    values = [0.0, *(float(one.to or 0.0) for one in requests)]
    assert len(requests) == count
    assert values[-1] == pytest.approx(math.radians(float(turn[:-3])))
    steps = np.diff(values)
    np.testing.assert_allclose(steps, steps[0])
    assert abs(steps[0]) <= GRASP_TURN + 1e-9
    assert expanded(requests, scene) == requests


def test_each_turn_of_a_tour_begins_where_the_one_before_ended(tmp_path: Path) -> None:
    scene = valve(tmp_path)
    to_and_fro = [Request("open", "valve", None, "400deg"), Request("close", "valve", None, "0deg")]
    values = [0.0, *(float(one.to or 0.0) for one in expanded(to_and_fro, scene))]
    assert max(values) == pytest.approx(math.radians(400.0))
    assert values[-1] == 0.0
    assert np.abs(np.diff(values)).max() <= GRASP_TURN + 1e-9


def test_parts_with_limits_and_short_turns_take_one_grasp(tmp_path: Path) -> None:
    endless = valve(tmp_path)
    assert turns_to(endless, "open", "valve", None, "180deg") is None
    assert turns_to(endless, "open", "valve", None, None) is None
    folder = tmp_path / "limited"
    folder.mkdir()
    limited = valve(folder, '<limit lower="0" upper="6.2" effort="9" velocity="1"/>')
    assert turns_to(limited, "open", "valve", None, "300deg") is None
    with pytest.raises(TaskError, match="a tour turns a part without limits by several grasps"):
        make_task(endless, "open", "valve", to="720deg")


def test_a_full_turn_is_done_from_one_base_pose(tmp_path: Path, fetch: Robot) -> None:
    scene = valve(tmp_path)
    config = PipelineConfig(timeout=60.0)
    tour = plan_tour(scene, fetch, [Request("open", "valve", None, "360deg")], config=config)
    assert [step.plan.status for step in tour.steps] == ["solved"] * 4
    assert set(tour.stops) == {1}
    ends = [step.plan.task.to for step in tour.steps]
    np.testing.assert_allclose(np.degrees(np.array(ends, float)), [90, 180, 270, 360])
