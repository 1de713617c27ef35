"""The maps that ship with the library robots."""

from __future__ import annotations

from pathlib import Path

import pytest

from momapos.model.robots.robot import Robot, load_arms
from momapos.model.robots.robot_names import library_names
from momapos.planning.reachability.arm_axes import no_map
from momapos.planning.reachability.construct import default_config
from momapos.planning.reachability.map_store import load_reach_map, map_key, shipped


@pytest.mark.parametrize("name", library_names())
def test_each_arm_of_the_library_ships_with_its_own_map(name: str, tmp_path: Path) -> None:
    for robot in load_arms(name):
        if no_map(robot):
            continue
        key = map_key(robot, default_config(robot))
        found = shipped(robot, key)
        assert found is not None, "rebuild it: momapos reach build NAME --out NAME.reach"
        assert found.key == key
        assert load_reach_map(robot, tmp_path / "cache").key == key
        assert not (tmp_path / "cache").exists(), "a map was built"


def test_a_map_of_another_robot_is_not_used(robot: Robot) -> None:
    assert shipped(robot, "0" * 32) is None
