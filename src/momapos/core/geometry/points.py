"""Sample points evenly, and measure how far the points of a cloud are apart.

The samples equal those of `scipy.stats.qmc`, which is slow to import.
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
    """Draw random points, one in each of `count` equal slices along every axis.

    McKay, Beckman, Conover: A comparison of three methods for selecting values of input variables
    (1979).
    """
    own = rng.spawn(1)[0]  # further draws of `rng` must not depend on the number of points
    within = own.uniform(size=(count, dimensions))
    slices = np.tile(np.arange(1, count + 1), (dimensions, 1))
    for row in slices:
        own.shuffle(row)
    return (slices.T - within) / count


def halton(count: int, dimensions: int) -> Float[np.ndarray, "count dimensions"]:
    """Return the first points of Halton's deterministic sequence, which starts at the origin.

    Along axis k, the digits of 0, 1, 2... in the base of the k-th prime are mirrored at the point.
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
    found: list[int] = []
    for number in itertools.count(2):
        if len(found) == count:
            break
        if all(number % prime for prime in found):
            found.append(number)
    return found


NEIGHBORS = 8
SAMPLED = 4_000
"""Number of points whose neighbors are measured [-]."""


def point_spacing(points: Float[np.ndarray, "n 3"], percent: float = 50.0) -> float:
    """Return the distance that a share of a cloud's points keep to their eight nearest neighbors.

    Args:
        points: The cloud [m].
        percent: The share [%].

    Returns:
        A percentile of the mean distance to the neighbors [m], about 1.2 times the step of a grid;
        0 for a cloud of fewer than nine points.
    """
    if len(points) <= NEIGHBORS:
        return 0.0
    from scipy.spatial import cKDTree

    sample = points[:: -(-len(points) // SAMPLED)]
    distances, _ = cKDTree(points).query(sample, k=NEIGHBORS + 1)
    return float(np.percentile(distances[:, 1:].mean(axis=1), percent))
