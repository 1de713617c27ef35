"""The edges of the graph are a choice, which follows from the scorer unless it is made."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from tests.planning.importance.small_rooms import box, room

from momapos.model.scene.scene_files import load_scene
from momapos.planning.config import PipelineConfig
from momapos.planning.importance.config import EdgesName, GraphConfig, ImportanceConfig, ScorerName
from momapos.planning.importance.ranking import rank
from momapos.planning.importance.scene_graph import KINDS, SceneGraph, build_graph
from momapos.planning.importance.scorers import authors_transitions
from momapos.planning.placement.config import PlaceConfig

KITCHEN = load_scene("kitchen_small")


def graph_of(edges: EdgesName) -> SceneGraph:
    return build_graph(KITCHEN.furniture, GraphConfig(edges=edges))


def test_dense_edges_relate_every_two_objects_that_nothing_carries() -> None:
    support, dense = graph_of("support"), graph_of("dense")
    carried = set(support.child.tolist())
    lowest = [k for k in range(len(support)) if k not in carried]
    near = dense.kind == KINDS.index("near")
    pairs = {
        tuple(sorted(pair)) for pair in zip(dense.child[near], dense.parent[near], strict=True)
    }
    assert pairs == set(combinations(lowest, 2))
    np.testing.assert_array_equal(dense.edges[~near], support.edges)


def test_the_edges_of_support_are_among_those_of_the_other_choices() -> None:
    rows = {name: set(map(tuple, graph_of(name).edges.tolist())) for name in EDGES}
    assert rows["support"] < rows["near"]
    assert rows["support"] < rows["dense"]


EDGES: tuple[EdgesName, ...] = ("support", "near", "dense")


@pytest.mark.parametrize(
    ("scorer", "edges"),
    [("deepwalk", "support"), ("node2vec", "dense"), ("reach", "near"), ("distance", "near")],
)
def test_a_scorer_has_edges_of_its_own(scorer: ScorerName, edges: EdgesName) -> None:
    found = rank(KITCHEN, "fridge", ImportanceConfig(scorer=scorer))
    assert found.graph.config.edges == edges
    given = ImportanceConfig(scorer=scorer, graph=GraphConfig(edges="near"))
    assert rank(KITCHEN, "fridge", given).graph.config.edges == "near"


def test_the_scorer_of_the_paper_means_the_same_as_its_method() -> None:
    config = PipelineConfig(place=PlaceConfig(method="paper"))
    by_method = rank(KITCHEN, "fridge", config.ranking)
    by_scorer = rank(KITCHEN, "fridge", ImportanceConfig(scorer="deepwalk"))
    assert by_method.by_name == by_scorer.by_name
    assert by_method.selected() == by_scorer.selected()


def test_a_walk_of_the_authors_goes_to_near_objects_more_often_and_leaves_what_is_carried() -> None:
    size = (0.4, 0.4, 0.4)
    items = [box(f"b{k}", size, (x, 0.0, 0.0)) for k, x in enumerate((0.0, 1.0, 3.0))]
    cup = box("cup", (0.1, 0.1, 0.1), (0.0, 0.0, 0.4))
    graph = build_graph(room(*items, cup), GraphConfig(edges="dense"))
    P = authors_transitions(graph).dense()
    np.testing.assert_allclose(P.sum(1), 1.0)
    assert P[3].tolist() == [1.0, 0.0, 0.0, 0.0]
    assert not P[:, 3].any()
    # 1 / d is 1, 1/2 and 1/3, which is 10, 2.5 and 0 after scaling.
    assert P[0, 1] == pytest.approx(1.0, abs=1e-5)
    assert P[1, 0] == pytest.approx(10.0 / 12.5, abs=1e-5)
    assert P[2, 1] == pytest.approx(1.0, abs=1e-5)


def test_a_graph_without_edges_or_with_one_has_transitions() -> None:
    one, two = (room(*(box(f"b{k}", (1, 1, 1), (3.0 * k, 0, 0)) for k in range(n))) for n in (1, 2))
    config = GraphConfig(edges="dense")
    assert not authors_transitions(build_graph(one, config)).dense().any()
    np.testing.assert_array_equal(
        authors_transitions(build_graph(two, config)).dense(), [[0.0, 1.0], [1.0, 0.0]]
    )


def test_the_score_of_the_authors_is_repeatable_and_higher_for_what_a_walk_reaches() -> None:
    config = ImportanceConfig(scorer="node2vec")
    a, b, c = (rank(KITCHEN, "bottle", config, seed=seed) for seed in (3, 3, 4))
    assert a.by_name == b.by_name
    assert a.by_name != c.by_name
    support = next(n for n, how in zip(a.names, a.relations, strict=True) if how == "carries")
    assert a.score(support) > np.median(a.scores)
    assert replace(config, alpha=0.0).resolved.scorer == "node2vec"
