"""Points that fill a unit cube evenly.

The same numbers as `scipy.stats.qmc` gives, whose import takes longer than many an answer.
"""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float


def latin_hypercube(
    rng: np.random.Generator, count: int, dimensions: int
) -> Float[np.ndarray, "count dimensions"]:
    """Random points, of which each of `count` equal slices along every axis holds one.

    McKay, Beckman, Conover: A comparison of three methods for selecting values of input variables
    (1979).
    """
    own = rng.spawn(1)[0]  # so that further draws do not depend on how many points these were
    within = own.uniform(size=(count, dimensions))
    slices = np.tile(np.arange(1, count + 1), (dimensions, 1))
    for row in slices:
        own.shuffle(row)
    return (slices.T - within) / count


def halton(count: int, dimensions: int) -> Float[np.ndarray, "count dimensions"]:
    """The first points of Halton's sequence, which begins at the origin and is not random.

    Along axis k the digits of 0, 1, 2... in the base of the k-th prime are mirrored at the point.
    """
    points = np.zeros((count, dimensions))
    for axis, base in enumerate(_primes(dimensions)):
        rest, weight = np.arange(count), 1.0 / base
        while rest.any():
            rest, digit = np.divmod(rest, base)
            points[:, axis] += digit * weight
            weight /= base
    return points


def _primes(count: int) -> list[int]:
    """The smallest primes."""
    found: list[int] = []
    for number in itertools.count(2):
        if len(found) == count:
            break
        if all(number % prime for prime in found):
            found.append(number)
    return found
