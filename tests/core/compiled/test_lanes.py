"""Compiled lanes compute what their NumPy definitions do."""

from __future__ import annotations

import numpy as np

from momapos.core.compiled import (
    LANES,
    S2,
    entry,
    highest,
    larger,
    less,
    load_lanes,
    magnitude,
    root,
    spread,
    store_lanes,
)


@entry
def every_operation(rows: S2, number: float) -> float:
    a, b = load_lanes(rows, 0), load_lanes(rows, 1)
    store_lanes(rows, 2, larger(a, b))
    store_lanes(rows, 3, magnitude(a * b - spread(number)))
    store_lanes(rows, 4, a + b)
    rows[5, 0] = less(a, b)
    store_lanes(rows, 6, root(a * a))
    return highest(load_lanes(rows, 3))


def test_compiled_lanes_agree_with_numpy() -> None:
    start = np.random.default_rng(0).normal(size=(7, LANES)).astype(np.float32)
    compiled, plain = start.copy(), start.copy()
    results = every_operation(compiled, 0.25), every_operation.py_func(plain, 0.25)
    np.testing.assert_allclose(results[0], results[1], rtol=1e-6)
    np.testing.assert_allclose(compiled, plain, rtol=1e-6, atol=1e-7)
    np.testing.assert_array_equal(plain[2], np.maximum(start[0], start[1]))
    bits = [int(plain[5, 0]) >> lane & 1 for lane in range(LANES)]
    np.testing.assert_array_equal(bits, start[0] < start[1])


def test_a_loaded_row_does_not_change_with_the_array() -> None:
    rows = np.ones((1, LANES), np.float32)
    kept = load_lanes(rows, 0)
    store_lanes(rows, 0, spread(2.0))
    assert kept.sum() == LANES
    assert rows.sum() == 2 * LANES
