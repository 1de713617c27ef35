"""Eight numbers at once: vectors of single precision that kernels keep in one register.

These functions define what kernels compute, with NumPy arrays of shape (8,). In compiled code they
are single instructions of the processor, see `compiler`. Sums, differences and products of
vectors are written with operators.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float32

LANES = 8


def load_lanes(rows: Float32[np.ndarray, "k 8"], i: int) -> Float32[np.ndarray, "8"]:
    """Return a row."""
    return rows[i].copy()


def store_lanes(rows: Float32[np.ndarray, "k 8"], i: int, value: Float32[np.ndarray, "8"]) -> None:
    """Write a row."""
    rows[i] = value


def spread(x: float) -> Float32[np.ndarray, "8"]:
    """Return a number in all lanes."""
    return np.full(LANES, x, np.float32)


def magnitude(a: Float32[np.ndarray, "8"]) -> Float32[np.ndarray, "8"]:
    """Return absolute values."""
    return np.abs(a)


def larger(a: Float32[np.ndarray, "8"], b: Float32[np.ndarray, "8"]) -> Float32[np.ndarray, "8"]:
    """Return the larger number of each lane."""
    return np.maximum(a, b)


def root(a: Float32[np.ndarray, "8"]) -> Float32[np.ndarray, "8"]:
    """Return square roots of numbers that are not negative."""
    return np.sqrt(a)


def less(a: Float32[np.ndarray, "8"], b: Float32[np.ndarray, "8"]) -> int:
    """Return in which lanes a < b: bit k is lane k."""
    return int(np.packbits(a < b, bitorder="little")[0])


def highest(a: Float32[np.ndarray, "8"]) -> float:
    """Return the largest number of all lanes."""
    return float(a.max())
