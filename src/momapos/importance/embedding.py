"""Skip-gram over walks or words: what keeps the same company gets similar vectors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int


LEARNING_RATE = 0.1
"""Four times gensim's own: a room's corpus is small, and is seen few times [-]."""
NEGATIVE = 3
"""Words drawn as no company for each that is [-]."""


@dataclass(frozen=True)
class SkipGram:
    """How vectors are learnt."""

    dimensions: int
    """Length of a vector [-]."""
    window: int
    """Words before and after that count as company [-]."""
    epochs: int
    """Passes over the sentences [-]."""
    seed: int


def embed_walks(
    walks: Int[np.ndarray, "w length"], count: int, config: SkipGram
) -> Float[np.ndarray, "count d"]:
    """Vectors of the objects that walks pass (DeepWalk, Perozzi et al. 2014).

    Args:
        walks: Indices of objects; each object occurs.
        count: Number of objects.
        config: How vectors are learnt.
    """
    words = np.array([str(i) for i in range(count)], object)
    vectors = embed_words(words[walks].tolist(), config)
    return np.array([vectors[word] for word in words])


def embed_words(
    sentences: Sequence[Sequence[str]], config: SkipGram
) -> dict[str, Float[np.ndarray, " d"]]:
    """Vectors of words by skip-gram with negative sampling (Mikolov et al. 2013).

    One worker trains, or the order would be left to chance; gensim draws the first vectors from
    the seed alone, and not from Python's hash of the words. Common words are not thinned out
    (`sample=0`): the counter that everything stands on is a common word.
    """
    from gensim.models import Word2Vec

    learnt = Word2Vec(
        [list(words) for words in sentences], sg=1, negative=NEGATIVE, sample=0, min_count=1, workers=1,
        seed=config.seed, vector_size=config.dimensions, window=config.window,
        epochs=config.epochs, alpha=LEARNING_RATE,
    ).wv  # fmt: skip
    return dict(zip(learnt.index_to_key, learnt.vectors.astype(float), strict=True))


def cosine(vectors: Float[np.ndarray, "n d"], target: int) -> Float[np.ndarray, " n"]:
    """Cosine of the angle between each vector and the target's, in [-1, 1]; 0 for zero vectors."""
    length = np.linalg.norm(vectors, axis=1)
    product = vectors @ vectors[target]
    scale = length * length[target]
    return np.clip(np.divide(product, scale, out=np.zeros(len(vectors)), where=scale > 0), -1, 1)
