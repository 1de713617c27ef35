"""Walks: transition probabilities, the effect of k0, and the kernel that draws the steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.planning.importance.small_rooms import box, room

from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene
from momapos.planning.importance.config import GraphConfig
from momapos.planning.importance.scene_graph import SceneGraph, build_graph
from momapos.planning.importance.scorers import transitions, walk

ALL = GraphConfig(neighbors=10, near=100.0)


def triple(far: float = 2.0, size: float = 0.3) -> SceneGraph:
    """Build a graph of three objects: a middle one, one 1 m to its left, one `far` to its right."""
    return build_graph(
        room(
            box("middle", (0.3, 0.3, 0.3), (0, 0, 0)), box("left", (0.3, 0.3, 0.3), (-1, 0, 0)),
            box("right", (size, size, size), (far, 0, 0)),
        ), ALL,
    )  # fmt: skip


@settings(max_examples=20)
@given(st.integers(0, 10_000), st.floats(0, 1))
def test_probabilities_sum_to_one_over_undirected_edges(seed: int, k0: float) -> None:
    rng = np.random.default_rng(seed)
    items = [
        box(f"b{k}", tuple(rng.uniform(0.01, 1, 3)), (*rng.uniform(-2, 2, 2), 0.0))
        for k in range(12)
    ]
    graph = build_graph(room(*items))
    P = transitions(graph, k0=k0).dense()
    related = np.zeros((12, 12), bool)
    related[graph.child, graph.parent] = related[graph.parent, graph.child] = True
    assert np.array_equal(P > 0, related)
    assert P.sum(1) == pytest.approx(related.any(1).astype(float))


@pytest.mark.parametrize("printed", [True, False])
def test_probabilities_follow_the_formula_of_the_paper_as_printed_or_scaled(
    printed: bool, kitchen: Scene
) -> None:
    graph, k0 = build_graph(kitchen), 0.3
    P = transitions(graph, k0=k0, printed=printed).dense()
    n = len(graph)
    w = np.zeros((n, n))
    nearest, largest = (1.0, 1.0) if printed else (graph.dist_xy.min(), graph.size.max())
    for child, parent, length in zip(graph.child, graph.parent, graph.dist_xy, strict=True):
        for i, j in ((child, parent), (parent, child)):
            w[i, j] = k0 * nearest / length + (1 - k0) * graph.size[j] / largest
    assert np.allclose(P * w.sum(1, keepdims=True), w)


def test_the_nearer_of_two_equal_neighbors_gets_the_larger_probability() -> None:
    for k0 in (0.1, 0.5, 1.0):
        P = transitions(triple(far=2.0), k0=k0).dense()
        assert P[0, 1] > P[0, 2]


def test_the_larger_of_two_equally_near_neighbors_gets_the_larger_probability() -> None:
    for k0 in (0.0, 0.5, 0.9):
        P = transitions(triple(far=1.0, size=0.6), k0=k0).dense()
        assert P[0, 2] > P[0, 1]


def altered(graph: SceneGraph, **values: np.ndarray) -> SceneGraph:
    """Copy a graph with other values of derived properties."""
    copy = replace(graph)
    copy.__dict__.update(values)
    return copy


def test_k0_of_one_ignores_sizes_and_k0_of_zero_ignores_distances() -> None:
    graph = triple()
    other_sizes = altered(graph, size=graph.size * np.array([1, 5, 0.2]))
    other_places = altered(graph, dist_xy=graph.dist_xy * np.array([1, 3, 7])[: len(graph.dist_xy)])
    assert np.allclose(
        transitions(graph, k0=1.0).probability, transitions(other_sizes, k0=1.0).probability
    )
    assert np.allclose(
        transitions(graph, k0=0.0).probability, transitions(other_places, k0=0.0).probability
    )


def test_changing_the_unit_of_length_changes_no_probability() -> None:
    graph = build_graph(load_scene("kitchen_island"))
    feet = altered(graph, dist_xy=graph.dist_xy / 0.3048, size=graph.size / 0.3048)
    assert np.allclose(
        transitions(graph, k0=0.5).probability, transitions(feet, k0=0.5).probability
    )


def test_steps_of_the_kernel_are_as_frequent_as_their_probabilities(kitchen: Scene) -> None:
    graph = build_graph(kitchen)
    steps, n = transitions(graph, k0=0.5), len(graph)
    walks = walk(steps, np.tile(np.arange(n), 1000), 20, np.random.default_rng(0))
    pairs = np.bincount((walks[:, :-1] * n + walks[:, 1:]).ravel(), minlength=n * n).reshape(n, n)
    P, visits = steps.dense(), pairs.sum(1, keepdims=True)
    error = np.sqrt(P * (1 - P) / visits)
    assert (pairs[P == 0] == 0).all()
    assert (np.abs(pairs / visits - P) <= 5 * error + 1e-9).all()


def test_a_kernel_step_inverts_the_cumulative_probabilities() -> None:
    """Compares the kernel with a reference implementation."""
    steps = transitions(build_graph(load_scene("kitchen_island")), k0=0.5)
    first = np.arange(len(steps.start) - 1)
    walks = walk(steps, first, 8, np.random.default_rng(3))
    draws = np.random.default_rng(3).random((len(first), 7))
    for w in range(len(first)):
        here = first[w]
        for s in range(7):
            row = slice(steps.start[here], steps.start[here + 1])
            edge = np.searchsorted(np.cumsum(steps.probability[row]), draws[w, s], side="right")
            here = steps.target[row][min(edge, row.stop - row.start - 1)]
            assert walks[w, s + 1] == here


def test_a_walk_leaves_a_leaf_of_the_graph() -> None:
    scene = room(box("table", (1, 1, 0.7), (0, 0, 0)), box("cup", (0.1, 0.1, 0.1), (0, 0, 0.7)))
    steps = transitions(build_graph(scene), k0=0.5)
    walks = walk(steps, np.array([1]), 5, np.random.default_rng(0))
    assert walks.tolist() == [[1, 0, 1, 0, 1]]


def test_a_walk_stays_at_an_object_without_relations() -> None:
    scene = room(box("a", (1, 1, 1), (0, 0, 0)), box("b", (1, 1, 1), (9, 0, 0)))
    steps = transitions(build_graph(scene), k0=0.5)
    assert walk(steps, np.array([0, 1]), 4, np.random.default_rng(0)).tolist() == [[0] * 4, [1] * 4]
