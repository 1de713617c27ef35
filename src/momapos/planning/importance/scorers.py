"""Scorers of objects relative to a target, all with the same signature.

The training of the skip-gram is a kernel of plain arithmetic in a fixed order, so that a seed gives
the same vectors on every machine. A BLAS sums in an order that depends on the processor, and the
chain of small updates amplifies its rounding to 2e-4 in the cosine (measured with gensim, one
worker).
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

from momapos.core import FileFormatError, InputError, open_regular
from momapos.core.compiled import F1, F2, I1, entry, kernel
from momapos.model.scene import builtin_names, load_scene

from .config import ImportanceConfig
from .scene_graph import KINDS, SceneGraph

if TYPE_CHECKING:
    from jaxtyping import Float, Int


MAX_LINE = 1 << 16
"""Longest line [bytes]: a word and several thousand numbers."""
MAX_SHOWN = 40
"""Number of characters of a word that messages show [-]."""


def read_word_vectors(path: Path, wanted: Collection[str]) -> dict[str, Float[np.ndarray, " d"]]:
    """Read the vectors of some words in one pass, without loading the whole file.

    Args:
        path: File with a word and its numbers per line, separated by spaces. The first line may
            hold the number of words and of dimensions, as word2vec writes it.
        wanted: Words in lower case.

    Returns:
        Vectors of one length by word, without words that are not in the file.

    Raises:
        FileFormatError: The file cannot be read, or a line is invalid; the message names the line.
    """
    left = {word.encode(): word for word in wanted}
    found: dict[str, Float[np.ndarray, " d"]] = {}
    dimensions = None
    with open_regular(path) as file:
        number = 0
        while left and (line := _line(file.readline, path, number + 1)):
            number += 1
            first, _, rest = line.rstrip().partition(b" ")
            if number == 1 and first.isdigit() and rest.isdigit():
                continue  # the header of word2vec
            if dimensions is None:
                dimensions = len(rest.split())
            word = left.pop(first, None)
            if word is not None:
                found[word] = _vector(
                    rest, dimensions, f"{path}, line {number}: {word[:MAX_SHOWN]!r}"
                )
    return found


def _line(read: Callable[[int], bytes], path: Path, number: int) -> bytes:
    try:
        line = read(MAX_LINE)
    except OSError as error:
        raise FileFormatError(f"{path}: cannot be read ({error.strerror})") from error
    if len(line) >= MAX_LINE:
        raise FileFormatError(
            f"{path}, line {number}: longer than {MAX_LINE} bytes; each line must have a word and "
            "its numbers"
        )
    return line


def _vector(text: bytes, dimensions: int, where: str) -> Float[np.ndarray, " d"]:
    try:
        numbers = [float(part) for part in text.split()]
    except ValueError as error:
        raise FileFormatError(f"{where} must be followed by numbers only") from error
    if not numbers or len(numbers) != dimensions:
        raise FileFormatError(
            f"{where} has {len(numbers)} numbers; the file's first word has {dimensions}"
        )
    if not all(map(math.isfinite, numbers)):
        raise FileFormatError(f"{where} has a number that is not finite")
    return np.array(numbers)


LEARNING_RATE = 0.1
"""Initial learning rate, which decreases to almost 0 [-]; high, because the corpus is small."""
NEGATIVE = 3
"""Negative samples per context word [-]."""
_TABLE = 1 << 17
_UPDATES = 10_000_000
"""Updated numbers between two looks at the clock, which take less than 0.1 s [-]."""
_STEP, _SHIFT = np.uint64(6364136223846793005), np.uint64(33)
_ODD = np.uint64(1442695040888963407)


@dataclass(frozen=True)
class SkipGram:
    """Parameters of the training."""

    dimensions: int
    """Length of a vector [-]."""
    window: int
    """Number of words before and after that count as context [-]."""
    epochs: int
    """Number of passes over the sentences [-]."""
    seed: int


def embed_walks(
    walks: Int[np.ndarray, "w length"], count: int, config: SkipGram
) -> Float[np.ndarray, "count d"]:
    """Train vectors of `count` objects on walks over them (DeepWalk, Perozzi et al. 2014)."""
    start = np.arange(len(walks) + 1) * walks.shape[1]
    return _skip_gram(walks.ravel(), start, count, config)


def embed_words(
    sentences: Sequence[Sequence[str]], config: SkipGram
) -> dict[str, Float[np.ndarray, " d"]]:
    """Train vectors of words on sentences (Mikolov et al. 2013)."""
    known = {word: k for k, word in enumerate(dict.fromkeys(w for s in sentences for w in s))}
    tokens = np.array([known[word] for sentence in sentences for word in sentence], int)
    start = np.r_[0, np.cumsum([len(sentence) for sentence in sentences])]
    return dict(zip(known, _skip_gram(tokens, start, len(known), config), strict=True))


def _skip_gram(
    tokens: Int[np.ndarray, " t"], start: Int[np.ndarray, " s_plus_1"], count: int, config: SkipGram
) -> Float[np.ndarray, "count d"]:
    """Train skip-gram with negative sampling as word2vec does, without subsampling common words.

    Negative samples are drawn with the frequency to the power 3/4.
    """
    rng = np.random.default_rng(config.seed)
    vectors = (rng.random((count, config.dimensions)) - 0.5) / config.dimensions
    root = np.sqrt(np.bincount(tokens, minlength=count))
    share = np.cumsum(root * np.sqrt(root))
    table = np.searchsorted(share, (np.arange(_TABLE) + 0.5) / _TABLE * share[-1])
    text = Text(tokens.astype(np.int64), start.astype(np.int64))
    changed = Vectors(vectors, np.zeros_like(vectors), np.empty(config.dimensions))
    training = Training(config.window, config.epochs, NEGATIVE, LEARNING_RATE)
    state, sentences = np.uint64(config.seed), len(start) - 1
    updates = len(tokens) * config.window * config.dimensions
    step = max(1, _UPDATES * sentences // updates)
    for epoch in range(config.epochs):
        for first in range(0, sentences, step):
            part = epoch, first, min(first + step, sentences)
            state = np.uint64(_train(text, table, changed, training, part, state))
    return vectors


class Text(NamedTuple):
    """Sentences, one after the other."""

    tokens: I1
    start: I1
    """Index of each sentence's first token, and the number of tokens."""


class Vectors(NamedTuple):
    """Vectors of each word, changed in place."""

    words: F2
    outputs: F2
    change: F1
    """Memory of one update."""


class Training(NamedTuple):
    """Parameters of the training for the kernels, see `SkipGram`."""

    window: int
    epochs: int
    negative: int
    rate: float


@kernel
def _sigmoid(x):
    """Return 1 / (1 + exp(-x)) within 1e-5, by Lambert's fraction of tanh(x / 2); 0 or 1 beyond 6.

    As in word2vec, training stops at a product beyond 6: otherwise products of words that never
    occur together would grow without bound.
    """
    if abs(x) > 6.0:
        return 1.0 if x > 0.0 else 0.0
    y = x / 2
    z = y * y
    above = y * (135135.0 + z * (17325.0 + z * (378.0 + z)))
    return 0.5 + 0.5 * above / (135135.0 + z * (62370.0 + z * (3150.0 + z * 28.0)))


@kernel
def _dot(a, b):
    """Return the dot product in four sums: the processor overlaps them, the order is fixed."""
    size = len(a)
    s0, s1, s2, s3 = 0.0, 0.0, 0.0, 0.0
    whole = size - size % 4
    for k in range(0, whole, 4):
        s0 += a[k] * b[k]
        s1 += a[k + 1] * b[k + 1]
        s2 += a[k + 2] * b[k + 2]
        s3 += a[k + 3] * b[k + 3]
    for k in range(whole, size):
        s0 += a[k] * b[k]
    return (s0 + s1) + (s2 + s3)


@kernel
def _learn(word, company, vectors, table, negative, rate, state):
    """Do one update: make `word` predict `company`, and not the negative samples."""
    words, outputs, change = vectors
    mine = words[word]
    for k in range(len(change)):
        change[k] = 0.0
    for draw in range(negative + 1):
        other, label = company, 1.0
        if draw > 0:
            state = state * _STEP + _ODD
            other, label = table[np.int64(state >> _SHIFT) % len(table)], 0.0
            if other == company:
                continue
        output = outputs[other]
        step = rate * (label - _sigmoid(_dot(mine, output)))
        for k in range(len(change)):
            change[k] += step * output[k]
            output[k] += step * mine[k]
    for k in range(len(change)):
        mine[k] += change[k]
    return state


@entry
def _train(
    text: Text,
    table: I1,
    vectors: Vectors,
    training: Training,
    part: tuple[int, int, int],
    state: np.uint64,
) -> np.uint64:
    """Train in an epoch on the sentences from one to before another; return the next state."""
    tokens, start = text
    window, epochs, negative, rate = training
    epoch, first, last = part
    seen, total = epoch * len(tokens) + start[first], epochs * len(tokens)
    for s in range(first, last):
        for here in range(start[s], start[s + 1]):
            now = rate * max(1.0 - seen / total, 1e-4)
            seen += 1
            # The window's width is random, so near words count more often than far ones.
            state = state * _STEP + _ODD
            width = 1 + np.int64(state >> _SHIFT) % window
            begin, end = max(start[s], here - width), min(start[s + 1] - 1, here + width)
            for there in range(begin, end + 1):
                if there != here:
                    state = _learn(
                        tokens[there], tokens[here], vectors, table, negative, now, state
                    )
    return state


def cosine(vectors: Float[np.ndarray, "n d"], target: int) -> Float[np.ndarray, " n"]:
    """Return the cosine between each vector and the target's, in [-1, 1]; 0 for zero vectors.

    It is rounded to 1e-9, so that it does not depend on the order of summation.
    """
    length = np.linalg.norm(vectors, axis=1)
    product = vectors @ vectors[target]
    scale = length * length[target]
    value = np.divide(product, scale, out=np.zeros(len(vectors)), where=scale > 0)
    return np.clip(np.round(value, 9), -1.0, 1.0)


MIN_DISTANCE, MIN_SPREAD = 1e-3, 1e-9
"""Lower bounds of the distance of two objects [m], and of the spread of its inverse [1/m]."""
MIN_WEIGHT = 1e-5
"""What the authors' code adds to each weight, so that the farthest pair has one [-]."""


@dataclass(frozen=True, eq=False)
class Transitions:
    """Transition probabilities of a walk: the neighbors of each object, row by row."""

    start: Int[np.ndarray, " n_plus_1"]
    target: Int[np.ndarray, " m"]
    probability: Float[np.ndarray, " m"]
    """Sums to 1 over each row that is not empty."""

    def dense(self) -> Float[np.ndarray, "n n"]:
        """Return the matrix P(i, j); rows of objects without neighbors are 0."""
        n = len(self.start) - 1
        matrix = np.zeros((n, n))
        matrix[np.repeat(np.arange(n), np.diff(self.start)), self.target] = self.probability
        return matrix


def transitions(graph: SceneGraph, *, k0: float, printed: bool = False) -> Transitions:
    """Compute P(i, j) = w(i, j) / sum over the neighbors u of w(i, u).

    MoMa-Pos, section III-A, gives w = k0 / dist_xy(i, j) + (1 - k0) size(j). The terms have
    different units, which makes k0 hard to interpret. Scaled, each is in (0, 1]: the first relative
    to the closest pair of neighbors, the second to the largest object. Edges are undirected;
    otherwise a cup on a table would be a dead end.

    Args:
        graph: Relations, distances and sizes.
        k0: Weight of the distance against the size, in [0, 1].
        printed: Use the paper's terms, in 1/m and m, instead of the scaled ones.
    """
    edges = graph.adjacency
    edge = edges.data - 1
    closest = 1.0 if printed else graph.dist_xy.min(initial=np.inf)
    largest = 1.0 if printed else graph.size.max()
    near, large = closest / graph.dist_xy[edge], graph.size[edges.indices] / largest
    weight = k0 * near + (1 - k0) * large
    row = np.repeat(np.arange(len(graph)), np.diff(edges.indptr))
    total = np.bincount(row, weight, minlength=len(graph))
    return Transitions(
        edges.indptr.astype(np.int64), edges.indices.astype(np.int64), weight / total[row]
    )


def authors_transitions(graph: SceneGraph) -> Transitions:
    """Return the transition probabilities of the authors' public code.

    Every two objects on the floor are related, with 10 times their inverse distance scaled to
    [0, 1] over the graph. What is carried leads to its support only, with the weight 1.

    Source: Project_MoMa-Pos, `utils_EdgeBuilder.py` and `utils_Graph.py`.
    """
    near = graph.kind == KINDS.index("near")
    child, parent = graph.child[near], graph.parent[near]
    center = graph.upright.center
    inverse = 1 / np.maximum(np.linalg.norm(center[child] - center[parent], axis=1), MIN_DISTANCE)
    spread = max(float(np.ptp(inverse)), MIN_SPREAD) if len(inverse) else 1.0
    floor = 10.0 * (inverse - inverse.min(initial=np.inf)) / spread + MIN_WEIGHT
    rows = np.r_[child, parent, graph.child[~near]]
    columns = np.r_[parent, child, graph.parent[~near]]
    weight = np.r_[floor, floor, np.ones(np.count_nonzero(~near))]
    order = np.lexsort((columns, rows))
    rows, columns, weight = rows[order], columns[order], weight[order]
    start = np.searchsorted(rows, np.arange(len(graph) + 1))
    total = np.bincount(rows, weight, minlength=len(graph))
    return Transitions(start.astype(np.int64), columns.astype(np.int64), weight / total[rows])


@entry
def _walk(start: I1, target: I1, cumulative: F1, first: I1, draws: F2) -> np.ndarray:
    out = np.empty((len(first), draws.shape[1] + 1), np.int64)
    for w in range(len(first)):
        here = first[w]
        out[w, 0] = here
        for s in range(draws.shape[1]):
            low, high = start[here], start[here + 1]
            if high > low:
                next_edge = low + np.searchsorted(cumulative[low:high], draws[w, s], side="right")
                here = target[min(next_edge, high - 1)]
            out[w, s + 1] = here
    return out


def walk(
    steps: Transitions, first: Int[np.ndarray, " w"], length: int, rng: np.random.Generator
) -> Int[np.ndarray, "w length"]:
    """Walk from each given object; without neighbors, a walk stays at its object.

    Args:
        steps: Transition probabilities.
        first: First object of each walk.
        length: Number of objects in a walk.
        rng: Source of the random steps.
    """
    row = np.repeat(np.arange(len(steps.start) - 1), np.diff(steps.start))
    total = np.r_[0.0, np.cumsum(steps.probability)]
    cumulative = total[1:] - total[steps.start[row]]
    draws = rng.random((len(first), length - 1))
    return _walk(steps.start, steps.target, cumulative, np.asarray(first, np.int64), draws)


MIN_SCORE = 1e-6
"""Lowest score [-]; Lemma 1 of MoMa-Pos excludes 0."""
KNEE = 0.05
"""Cosines from this value on are scores; lower ones are compressed to [MIN_SCORE, KNEE] [-]."""

RUNS = 100
"""Trainings that the authors' code averages over [-]."""

PathPoints: TypeAlias = "Float[np.ndarray, 'k 3'] | None"
Scorer: TypeAlias = (
    "Callable[[SceneGraph, int, ImportanceConfig, int, PathPoints], Float[np.ndarray, ' n']]"
)
"""Scores of all objects in (0, 1] from the graph, the target's index, the configuration, a seed."""


def deepwalk(
    graph: SceneGraph, target: int, config: ImportanceConfig, seed: int, path: PathPoints = None
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
    vectors = embed_walks(walks, len(graph), _skip_gram_config(config, seed))
    scores = score_of_cosine(cosine(vectors, target))
    return np.where((steps >= 0) & (steps <= 2 * config.window), scores, MIN_SCORE)


def node2vec(
    graph: SceneGraph, target: int, config: ImportanceConfig, seed: int, path: PathPoints = None
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
    graph: SceneGraph, target: int, config: ImportanceConfig, seed: int, path: PathPoints = None
) -> Float[np.ndarray, " n"]:
    """Score by 1 / (1 + d / 1 m), where d is the horizontal gap between the boxes [m]."""
    del config, seed, path
    return np.maximum(1 / (1 + graph.gaps(target)), MIN_SCORE)


def size(
    graph: SceneGraph, target: int, config: ImportanceConfig, seed: int, path: PathPoints = None
) -> Float[np.ndarray, " n"]:
    """Score by s / (s + d): the ratio r = s / d of size and gap, mapped to r / (1 + r)."""
    del config, seed, path
    return np.maximum(graph.size / (graph.size + graph.gaps(target)), MIN_SCORE)


def reach(
    graph: SceneGraph, target: int, config: ImportanceConfig, seed: int, path: PathPoints = None
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
    graph: SceneGraph, target: int, config: ImportanceConfig, seed: int, path: PathPoints = None
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
    vectors = embed_words(sentences, _skip_gram_config(config, seed))
    mean = np.array([np.mean([vectors[word] for word in some], axis=0) for some in own])
    return score_of_cosine(cosine(mean, target))


def _by_file(file: str, own: list[tuple[str, ...]], target: int) -> Float[np.ndarray, " n"]:
    """Score objects by their words with the vectors of a file."""
    known = read_word_vectors(Path(file), {word for some in own for word in some})
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


def _skip_gram_config(config: ImportanceConfig, seed: int) -> SkipGram:
    return SkipGram(config.dimensions, config.window, config.epochs, seed)
