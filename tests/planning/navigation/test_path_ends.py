"""Connections of starts and goals to the lattice by the cheapest of their exits."""

from __future__ import annotations

import numpy as np
import pytest

from momapos.model.robots.robot import load_robot
from momapos.model.scene.scene import Scene
from momapos.planning.navigation.footprint_map import NavigationMap, build_navigation_map
from momapos.planning.navigation.lattice import connections
from momapos.planning.navigation.path_ends import (
    DEFAULT_CONFIG,
    MIN_GAP,
    LatticeEntries,
    PathEnd,
    lattice_poses,
    path_end,
    path_model,
)

RADII = 0.15, 0.3
"""Radius of the states connected to an exit, and to the start or goal itself [m]."""
POSE = np.array([0.6, -1.6, -2.0])


@pytest.fixture(scope="module", params=["segway_ur5e", "ranger_rm63"])
def nav_map(request: pytest.FixtureRequest, kitchen: Scene) -> NavigationMap:
    return build_navigation_map(kitchen, load_robot(request.param))


def through(end: PathEnd, entries: LatticeEntries, states: np.ndarray, exit_: int) -> np.ndarray:
    """Return the cost to each state through one exit only [m]."""
    exits = entries.exits
    poses = lattice_poses(end.nav_map, states)
    at = np.broadcast_to(exits.poses[exit_], poses.shape).copy()
    needed = end.needed if exits.near_root()[exit_] else MIN_GAP
    model = path_model(end.nav_map, DEFAULT_CONFIG, needed)
    ends = (poses, at) if end.is_goal else (at, poses)
    return np.asarray(exits.cost[exit_] + connections(*ends, model)[0])


@pytest.mark.parametrize("is_goal", [False, True])
@pytest.mark.parametrize("shuffle", [False, True])
def test_no_exit_leads_to_a_state_more_cheaply(
    nav_map: NavigationMap, is_goal: bool, shuffle: bool
) -> None:
    end = path_end(nav_map, DEFAULT_CONFIG, POSE, MIN_GAP, is_goal=is_goal)
    entries = end.shuffled if shuffle else end.straight
    near = np.random.default_rng(0).choice(len(entries.states), 40, replace=False)
    states, cost, via = entries.states[near], entries.cost[near], entries.via[near]
    for exit_ in range(len(entries.exits.poses)):
        by = through(end, entries, states, exit_)
        taken = via == exit_
        np.testing.assert_array_equal(cost[taken], by[taken])
        near_exit = np.isin(states, end._near(entries.exits.poses[exit_], RADII[exit_ == 0]))
        assert (cost[near_exit] <= by[near_exit] + 1e-12).all()


def test_path_ends_are_cached(nav_map: NavigationMap) -> None:
    ends = [path_end(nav_map, DEFAULT_CONFIG, POSE, MIN_GAP, is_goal=False) for _ in range(2)]
    assert ends[0] is ends[1]
    other = path_end(nav_map, DEFAULT_CONFIG, POSE, MIN_GAP, is_goal=True)
    assert other is not ends[0]
