"""Distances over cells equal those of scipy to the last bit."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from momapos.planning.navigation.cost_map import clearance, path_lengths

CELL = 0.05


@pytest.mark.parametrize("shape", [(1, 1), (1, 30), (40, 1), (30, 50), (60, 25)])
@pytest.mark.parametrize("share", [0.001, 0.02, 0.5, 1.0])
def test_clearance_is_the_exact_euclidean_distance_transform(
    shape: tuple[int, int], share: float
) -> None:
    rng = np.random.default_rng(0)
    blocked = rng.random(shape) < share
    blocked[rng.integers(shape[0]), rng.integers(shape[1])] = True
    np.testing.assert_array_equal(clearance(blocked), distance_transform_edt(~blocked))


def test_a_cap_bounds_the_clearance_and_changes_no_smaller_one() -> None:
    rng = np.random.default_rng(2)
    blocked = rng.random((40, 55)) < 0.01
    every = clearance(blocked)
    assert every.max() > 5.3
    np.testing.assert_array_equal(clearance(blocked, cap=5.3), np.minimum(every, 5.3))


def test_clearance_is_infinite_where_nothing_is_blocked() -> None:
    assert np.isinf(clearance(np.zeros((3, 4), bool))).all()


@pytest.mark.parametrize("share", [0.4, 0.7, 1.0])
def test_path_lengths_are_those_of_dijkstra_over_the_graph_of_sixteen_neighbors(
    share: float,
) -> None:
    rng = np.random.default_rng(1)
    free = rng.random((25, 40)) < share
    cells = np.argwhere(free)
    sources = np.flatnonzero(free)[rng.integers(len(cells), size=3)]
    step = np.abs(cells[:, None] - cells[None])
    near = (step.max(-1) <= 2) & (np.gcd(step[..., 0], step[..., 1]) == 1)
    a, b = np.nonzero(near)
    index = np.ravel_multi_index(cells.T, free.shape)
    length = CELL * np.hypot(*(cells[b] - cells[a]).T)
    graph = csr_matrix((length, (index[a], index[b])), shape=(free.size, free.size))
    expected = dijkstra(graph, indices=sources, min_only=True).reshape(free.shape)
    np.testing.assert_array_equal(path_lengths(free, sources, CELL), expected)
    assert np.isinf(path_lengths(free, sources, CELL)[~free]).all()
