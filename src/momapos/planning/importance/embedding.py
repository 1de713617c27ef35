"""Skip-gram over walks or words: items in the same context get similar vectors.

The training is a kernel of plain arithmetic in a fixed order, so that a seed gives the same vectors
on every machine. A BLAS sums in an order that depends on the processor, and the chain of small
updates amplifies its rounding to 2e-4 in the cosine (measured with gensim, one worker).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from momapos.core.compiled import F1, F2, I1, entry, kernel

if TYPE_CHECKING:
    from jaxtyping import Float, Int

LEARNING_RATE = 0.1
"""Initial learning rate, which decreases to almost 0 [-]; high, because the corpus is small."""
NEGATIVE = 3
"""Negative samples per context word [-]."""
_TABLE = 1 << 17
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
    _train(
        Text(tokens.astype(np.int64), start.astype(np.int64)),
        table,
        Vectors(vectors, np.zeros_like(vectors), np.empty(config.dimensions)),
        Training(config.window, config.epochs, NEGATIVE, LEARNING_RATE),
        np.uint64(config.seed),
    )
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
def _train(text: Text, table: I1, vectors: Vectors, training: Training, state: np.uint64) -> None:
    tokens, start = text
    window, epochs, negative, rate = training
    seen, total = 0, epochs * len(tokens)
    for _ in range(epochs):
        for s in range(len(start) - 1):
            for here in range(start[s], start[s + 1]):
                now = rate * max(1.0 - seen / total, 1e-4)
                seen += 1
                # The window's width is random, so near words count more often than far ones.
                state = state * _STEP + _ODD
                width = 1 + np.int64(state >> _SHIFT) % window
                first, last = max(start[s], here - width), min(start[s + 1] - 1, here + width)
                for there in range(first, last + 1):
                    if there != here:
                        state = _learn(
                            tokens[there], tokens[here], vectors, table, negative, now, state
                        )


def cosine(vectors: Float[np.ndarray, "n d"], target: int) -> Float[np.ndarray, " n"]:
    """Return the cosine between each vector and the target's, in [-1, 1]; 0 for zero vectors.

    It is rounded to 1e-9, so that it does not depend on the order of summation.
    """
    length = np.linalg.norm(vectors, axis=1)
    product = vectors @ vectors[target]
    scale = length * length[target]
    value = np.divide(product, scale, out=np.zeros(len(vectors)), where=scale > 0)
    return np.clip(np.round(value, 9), -1.0, 1.0)
