"""Scorers of objects relative to a target, all with the same signature."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from momapos.core import InputError
from momapos.model.scene import builtin_names, load_scene

from .config import ImportanceConfig
from .embedding import SkipGram, cosine, embed_walks, embed_words
from .random_walks import authors_transitions, transitions, walk
from .scene_graph import SceneGraph
from .word_vectors import read_word_vectors

if TYPE_CHECKING:
    from jaxtyping import Float

MIN_SCORE = 1e-6
"""Lowest score [-]; Lemma 1 of MoMa-Pos excludes 0."""
KNEE = 0.05
"""Cosines from this value on are scores; lower ones are compressed to [MIN_SCORE, KNEE] [-]."""

RUNS = 100
"""Trainings that the authors' code averages over [-]."""

Path: TypeAlias = "Float[np.ndarray, 'k 3'] | None"
Scorer: TypeAlias = (
    "Callable[[SceneGraph, int, ImportanceConfig, int, Path], Float[np.ndarray, ' n']]"
)
"""Scores of all objects in (0, 1] from the graph, the target's index, the configuration, a seed."""


def deepwalk(
    graph: SceneGraph, target: int, config: ImportanceConfig, seed: int, path: Path = None
) -> Float[np.ndarray, " n"]:
    """Score by the cosine of skip-gram vectors over biased walks (MoMa-Pos, section III-A).

    Objects more than two windows away share no context with the target. Their cosine is random, so
    they get the lowest score.
    """
    del path
    steps = graph.steps(target)
    rng = np.random.default_rng(seed)
    first = np.repeat(np.arange(len(graph)), config.walks)
    rng.shuffle(first)
    probabilities = transitions(graph, k0=config.k0, printed=config.weights == "printed")
    walks = walk(probabilities, first, config.length, rng)
    vectors = embed_walks(walks, len(graph), _skip_gram(config, seed))
    scores = score_of_cosine(cosine(vectors, target))
    return np.where((steps >= 0) & (steps <= 2 * config.window), scores, MIN_SCORE)


def node2vec(
    graph: SceneGraph, target: int, config: ImportanceConfig, seed: int, path: Path = None
) -> Float[np.ndarray, " n"]:
    """Score as the authors' public code: vectors of short walks, averaged over `RUNS` trainings.

    Each training has one walk of four objects from each object, vectors of ten numbers and a window
    of two; both of node2vec's biases are 1 there, which is DeepWalk.

    Source: Project_MoMa-Pos, `main_step1_test.py`.
    """
    del path
    steps, runs = authors_transitions(graph), np.arange(len(graph))
    rng = np.random.default_rng(seed)
    skip_gram = SkipGram(dimensions=10, window=2, epochs=config.epochs, seed=seed)
    vectors = sum(
        embed_walks(walk(steps, runs, 4, rng), len(graph), skip_gram) for _ in range(RUNS)
    )
    return score_of_cosine(cosine(np.asarray(vectors), target))


def distance(
    graph: SceneGraph, target: int, config: ImportanceConfig, seed: int, path: Path = None
) -> Float[np.ndarray, " n"]:
    """Score by 1 / (1 + d / 1 m), where d is the horizontal gap between the boxes [m]."""
    del config, seed, path
    return np.maximum(1 / (1 + graph.gaps(target)), MIN_SCORE)


def size(
    graph: SceneGraph, target: int, config: ImportanceConfig, seed: int, path: Path = None
) -> Float[np.ndarray, " n"]:
    """Score by s / (s + d): the ratio r = s / d of size and gap, mapped to r / (1 + r)."""
    del config, seed, path
    return np.maximum(graph.size / (graph.size + graph.gaps(target)), MIN_SCORE)


def reach(
    graph: SceneGraph, target: int, config: ImportanceConfig, seed: int, path: Path = None
) -> Float[np.ndarray, " n"]:
    """Score by s / (s + d), where d is the 3D distance from a box to the hand's path [m].

    Which objects obstruct the task depends on the path of the handle, not on the target's position.
    """
    del target, config, seed
    assert path is not None
    box = graph.upright
    local = np.einsum("nji,nkj->nki", box.rotation, path[None] - box.center[:, None])
    gaps = np.linalg.norm(np.maximum(np.abs(local) - box.half[:, None], 0.0), axis=-1).min(1)
    return np.maximum(graph.size / (graph.size + gaps), MIN_SCORE)


def names(
    graph: SceneGraph, target: int, config: ImportanceConfig, seed: int, path: Path = None
) -> Float[np.ndarray, " n"]:
    """Score by the cosine of the mean vectors of the objects' words.

    The paper tried word vectors and found them inadequate. Without a file of vectors, they are
    trained on the words that occur together in a room: the built-in kitchens and this scene. An
    object without a word in the file gets the lowest score.

    Raises:
        FileFormatError: The file cannot be used.
        InputError: The file has none of the target's words.
    """
    del path
    own = [words(name, kind) for name, kind in zip(graph.names, graph.categories, strict=True)]
    if config.vectors is not None:
        return _by_file(config.vectors, own, target)
    rooms = [*_library_words(), tuple(dict.fromkeys(word for some in own for word in some))]
    rng = np.random.default_rng(seed)
    # Shuffled: the context is the room, not the order of objects in its file.
    sentences = [
        [str(word) for word in rng.permutation(room)] for room in rooms for _ in range(config.walks)
    ]
    vectors = embed_words(sentences, _skip_gram(config, seed))
    mean = np.array([np.mean([vectors[word] for word in some], axis=0) for some in own])
    return score_of_cosine(cosine(mean, target))


def _by_file(file: str, own: list[tuple[str, ...]], target: int) -> Float[np.ndarray, " n"]:
    """Score objects by their words with the vectors of a file."""
    known = read_word_vectors(FilePath(file), {word for some in own for word in some})
    if not any(word in known for word in own[target]):
        raise InputError(f"{file} has none of the target's words: {', '.join(own[target])}")
    zero = np.zeros(len(next(iter(known.values()))))
    vectors = [[known[word] for word in some if word in known] for some in own]
    mean = np.array([np.mean(some, axis=0) if some else zero for some in vectors])
    scores = score_of_cosine(cosine(mean, target))
    return np.where([bool(some) for some in vectors], scores, MIN_SCORE)


SCORERS: dict[str, Scorer] = {
    "reach": reach, "deepwalk": deepwalk, "node2vec": node2vec, "distance": distance,
    "size": size, "names": names,
}  # fmt: skip


def score_of_cosine(value: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Map a cosine in [-1, 1] to a score in (0, 1], in the same order.

    From `KNEE` on the score is the cosine, so that the paper's alpha keeps its meaning. [-1, KNEE]
    is mapped to [MIN_SCORE, KNEE], because Lemma 1 needs every object in S for some alpha above 0.
    """
    share = (1 + value) / (1 + KNEE)
    return np.where(value >= KNEE, value, MIN_SCORE + (KNEE - MIN_SCORE) * share)


def words(name: str, category: str) -> tuple[str, ...]:
    """Split an object's name and category into lower-case words without digits."""
    text = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", f"{category} {name}")
    found = re.findall(r"[^\W\d_]+", text)
    return tuple(dict.fromkeys(word.lower() for word in found)) or (name,)


@lru_cache(maxsize=1)
def _library_words() -> tuple[tuple[str, ...], ...]:
    rooms = [load_scene(name).objects for name in builtin_names()]
    return tuple(
        tuple(dict.fromkeys(word for item in room for word in words(item.name, item.category)))
        for room in rooms
    )


def _skip_gram(config: ImportanceConfig, seed: int) -> SkipGram:
    return SkipGram(config.dimensions, config.window, config.epochs, seed)
