"""Laws of quantities in words."""

from __future__ import annotations

import pytest

from momapos.core.units import length_text


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.3, "0.30 m"), (0.0, "0.00 m"), (0.004, "4 mm"), (-0.0035, "-3.5 mm"), (0.01, "0.01 m")],
)
def test_a_length_below_a_centimeter_is_in_millimeters(value: float, text: str) -> None:
    assert length_text(value) == text
