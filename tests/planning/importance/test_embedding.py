"""Skip-gram: the same context gives similar vectors, as in gensim, and reproducibly."""

from __future__ import annotations

import numpy as np
import pytest
from gensim.models import Word2Vec

from momapos.model.scene.scene_files import load_scene
from momapos.planning.importance import scorers
from momapos.planning.importance.scene_graph import build_graph
from momapos.planning.importance.scorers import (
    SkipGram,
    cosine,
    embed_walks,
    embed_words,
    transitions,
    walk,
)

CONFIG = SkipGram(dimensions=16, window=3, epochs=5, seed=1)


def island_walks(count: int) -> tuple[np.ndarray, int]:
    graph = build_graph(load_scene("kitchen_small"))
    rng = np.random.default_rng(0)
    first = np.repeat(np.arange(len(graph)), count)
    rng.shuffle(first)
    return walk(transitions(graph, k0=0.5), first, 20, rng), len(graph)


def test_words_of_one_group_are_closer_than_words_of_two() -> None:
    rng = np.random.default_rng(0)
    walks = np.concatenate([rng.integers(0, 4, (200, 10)), rng.integers(4, 8, (200, 10))])
    similar = np.array([cosine(embed_walks(walks, 8, CONFIG), k) for k in range(8)])
    group = np.arange(8) // 4
    same = group[:, None] == group[None]
    assert similar[same].min() > 0.5 > similar[~same].max()


def test_similarities_agree_with_gensim() -> None:
    walks, n = island_walks(50)
    config = SkipGram(dimensions=64, window=4, epochs=10, seed=0)
    mine = embed_walks(walks, n, config)
    words = np.array([str(k) for k in range(n)], object)
    model = Word2Vec(
        words[walks].tolist(), sg=1, negative=scorers.NEGATIVE, sample=0, min_count=1, workers=1,
        seed=0, vector_size=64, window=4, epochs=10, alpha=scorers.LEARNING_RATE,
    )  # fmt: skip
    theirs = model.wv[list(words)].astype(float)
    gap = np.array([cosine(mine, k) - cosine(theirs, k) for k in range(n)])
    assert np.abs(gap).mean() < 0.02
    assert np.abs(gap).max() < 0.1


def test_the_kernel_does_the_update_of_skip_gram() -> None:
    rng = np.random.default_rng(0)
    vectors, outputs = rng.normal(size=(2, 3, 6))
    table, state = np.array([2]), np.uint64(1)  # every negative sample is word 2
    u, v = vectors.copy(), outputs.copy()
    change = np.zeros(6)
    for other, label in ((1, 1.0), (2, 0.0), (2, 0.0)):
        step = 0.1 * (label - 1 / (1 + np.exp(-u[0] @ v[other])))
        change += step * v[other]
        v[other] += step * u[0]
    u[0] += change
    known = scorers.Vectors(vectors, outputs, np.empty(6))
    scorers._learn(0, 1, known, table, 2, 0.1, state)
    assert vectors == pytest.approx(u, abs=1e-5)
    assert outputs == pytest.approx(v, abs=1e-5)


def test_the_rational_sigmoid_is_the_sigmoid() -> None:
    x = np.linspace(-6, 6, 1001)
    values = np.array([scorers._sigmoid(value) for value in x])
    assert values == pytest.approx(1 / (1 + np.exp(-x)), abs=1e-5)
    assert (scorers._sigmoid(6.1), scorers._sigmoid(-6.1)) == (1.0, 0.0)


def test_a_seed_gives_the_same_vectors_and_another_seed_others() -> None:
    walks, n = island_walks(5)
    first, again = (embed_walks(walks, n, CONFIG) for _ in range(2))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, embed_walks(walks, n, SkipGram(16, 3, 5, seed=2)))


def test_vectors_do_not_depend_on_the_spelling_of_words() -> None:
    sentences = [["cup", "table"], ["cup", "plate", "table"]]
    renamed = [[{"cup": "a", "table": "b", "plate": "c"}[w] for w in s] for s in sentences]
    mine, theirs = embed_words(sentences, CONFIG), embed_words(renamed, CONFIG)
    assert np.array_equal(mine["plate"], theirs["c"])


def test_cosines_of_zero_vectors_are_zero() -> None:
    assert cosine(np.array([[0.0, 0.0], [1.0, 0.0]]), 0).tolist() == [0.0, 0.0]
    assert cosine(np.array([[1.0, 0.0], [-2.0, 0.0], [3.0, 0.0]]), 0).tolist() == [1.0, -1.0, 1.0]
