"""Postures are smoothed by a Gaussian filter that keeps the ends of the path."""

from __future__ import annotations

import numpy as np
import pytest

from momapos.planning.arm_motion.free_turn import SPREADS, _smoothed


@pytest.mark.parametrize("count", [4, 9, 25, 26, 120])
@pytest.mark.parametrize("spread", SPREADS)
def test_states_are_filtered_as_by_scipy(spread: float, count: int) -> None:
    from scipy.ndimage import gaussian_filter1d

    q = np.random.default_rng(count).uniform(-3.0, 3.0, (count, 7))
    more = min(count - 1, int(4 * spread))
    padded = np.pad(q, ((more, more), (0, 0)), mode="reflect", reflect_type="odd")
    expected = gaussian_filter1d(padded, spread, axis=0)[more:-more]
    np.testing.assert_allclose(_smoothed(q, spread), expected, atol=1e-12)


def test_an_even_motion_stays_as_it_is() -> None:
    q = np.linspace([0.0, 1.0], [3.0, -2.0], 60)
    np.testing.assert_allclose(_smoothed(q, SPREADS[0]), q, atol=1e-12)
