"""Laws of quantities in words."""

from __future__ import annotations

import pytest

from momapos.core.units import contact_text, length_text


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.3, "0.30 m"), (0.0, "0.00 m"), (0.004, "4 mm"), (-0.0035, "-3.5 mm"), (0.01, "0.01 m")],
)
def test_a_length_below_a_centimeter_is_in_millimeters(value: float, text: str) -> None:
    assert length_text(value) == text


@pytest.mark.parametrize(
    ("depth", "words"),
    [
        (0.004, "a 4 mm in b"),
        (0.0004, "a 0.4 mm in b"),
        (-0.012, "a 12 mm from b"),
    ],
)
def test_a_contact_names_both_shapes_and_its_depth(depth: float, words: str) -> None:
    assert contact_text("a", "b", depth) == words
