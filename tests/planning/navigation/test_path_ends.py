"""Starts and goals are joined to the lattice by the cheapest of their exits."""

from __future__ import annotations

import numpy as np
import pytest

from momapos.model.robots.robot import load_robot
from momapos.model.scene.scene_files import load_scene
from momapos.planning.navigation.footprint_map import NavigationMap, build_navigation_map
from momapos.planning.navigation.lattice import connections
from momapos.planning.navigation.path_ends import (
    DEFAULT,
    NEEDED,
    Attached,
    PathEnd,
    lattice_poses,
    path_end,
    path_model,
)

AROUND = 0.15, 0.3
"""How far states are from an exit, and from the start or goal itself [m]."""
BESIDE = np.array([0.6, -1.6, -2.0])


@pytest.fixture(scope="module", params=["segway_ur5e", "ranger_rm63"])
def nav_map(request: pytest.FixtureRequest) -> NavigationMap:
    return build_navigation_map(load_scene("kitchen_small"), load_robot(request.param))


def through(end: PathEnd, attached: Attached, states: np.ndarray, exit_: int) -> np.ndarray:
    """Cost to each state by one exit alone [m]."""
    exits = attached.exits
    poses = lattice_poses(end.nav_map, states)
    at = np.broadcast_to(exits.poses[exit_], poses.shape).copy()
    needed = end.needed if exits.near_root()[exit_] else NEEDED
    model = path_model(end.nav_map, DEFAULT, needed)
    ends = (poses, at) if end.is_goal else (at, poses)
    return np.asarray(exits.cost[exit_] + connections(*ends, model)[0])


@pytest.mark.parametrize("is_goal", [False, True])
@pytest.mark.parametrize("shuffle", [False, True])
def test_no_exit_leads_to_a_state_more_cheaply(
    nav_map: NavigationMap, is_goal: bool, shuffle: bool
) -> None:
    end = path_end(nav_map, DEFAULT, BESIDE, NEEDED, is_goal=is_goal)
    attached = end.shuffling if shuffle else end.simply
    near = np.random.default_rng(0).choice(len(attached.states), 40, replace=False)
    states, cost, via = attached.states[near], attached.cost[near], attached.via[near]
    for exit_ in range(len(attached.exits.poses)):
        by = through(end, attached, states, exit_)
        taken = via == exit_
        np.testing.assert_array_equal(cost[taken], by[taken])
        asked = np.isin(states, end._near(attached.exits.poses[exit_], AROUND[exit_ == 0]))
        assert (cost[asked] <= by[asked] + 1e-12).all()


def test_an_end_is_kept(nav_map: NavigationMap) -> None:
    ends = [path_end(nav_map, DEFAULT, BESIDE, NEEDED, is_goal=False) for _ in range(2)]
    assert ends[0] is ends[1]
    other = path_end(nav_map, DEFAULT, BESIDE, NEEDED, is_goal=True)
    assert other is not ends[0]
