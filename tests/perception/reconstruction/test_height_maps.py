"""Bars in the height map of a face."""

from __future__ import annotations

import numpy as np
import pytest
from tests.perception.reconstruction.fronts import face_of, raised

from momapos.perception.reconstruction.height_maps import area_of, bars

WHOLE = (0.0, 0.0, 1.0, 1.0)


@pytest.mark.parametrize(
    ("bar", "part"),
    [
        ((0.96, 0.3, 0.975, 0.5), (0.0, 0.0, 0.975, 1.0)),
        ((0.3, 0.03, 0.5, 0.04), (0.0, 0.03, 1.0, 1.0)),
    ],
)
@pytest.mark.parametrize("beyond", [-0.3, np.nan, 0.12])
def test_noise_at_the_end_of_a_face_is_not_a_bar(
    bar: tuple[float, float, float, float], part: tuple[float, float, float, float], beyond: float
) -> None:
    face = face_of(0.6, 0.8, 0.0)
    raised(face, bar, 0.04)
    assert len(bars(face, area_of(part, face), 0.02, 0.06, 0.06)) == 1
    raised(face, WHOLE, beyond)
    raised(face, part, 0.0)
    raised(face, bar, 0.04)
    assert not bars(face, area_of(part, face), 0.02, 0.06, 0.06)


def test_a_thick_handle_at_the_end_of_a_face_is_a_bar() -> None:
    face = face_of(0.6, 0.8, 0.0)
    raised(face, (0.94, 0.3, 0.975, 0.5), 0.04)
    raised(face, (0.975, 0.0, 1.0, 1.0), -0.3)
    (bar,) = bars(face, area_of(WHOLE, face), 0.02, 0.06, 0.06)
    assert bar.width == pytest.approx(0.021, abs=0.005)


def test_the_surface_that_an_object_stands_on_is_not_a_bar_of_its_face() -> None:
    face = face_of(0.45, 0.24, 0.0)
    raised(face, (0.0, 0.97, 1.0, 1.0), 0.044)
    assert not bars(face, area_of(WHOLE, face), 0.03, 0.1, 0.12)
