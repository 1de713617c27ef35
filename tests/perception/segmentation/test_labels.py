"""Common objects get their labels, and the rules cover all of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from momapos.perception.segmentation.instance_boxes import RULES, BoxFeatures, fit, guesses_of

CABINET = BoxFeatures("floor", 0.86, 1.6, 0.6, 0.0, 0.9, 0.0, 0.0, 0.5)
CUP = BoxFeatures("support", 0.1, 0.08, 0.08, 0.9, 0.0, 0.0, 1.0, 0.5)
EXAMPLES = {
    "cabinet": CABINET,
    "fridge": replace(CABINET, height=1.75, width=0.75, depth=0.7),
    "oven": replace(CABINET, height=0.94, width=0.7, step=0.04),
    "dishwasher": replace(CABINET, width=0.6, bright=0.1),
    "kitchen island": replace(CABINET, height=0.9, width=1.4, depth=0.8, free=1.5),
    "table": replace(CABINET, height=0.74, width=1.4, depth=0.8, closed=0.1, free=1.0),
    "chair": replace(CABINET, height=0.9, width=0.45, depth=0.45, closed=0.2, free=1.0),
    "wall cabinet": BoxFeatures("hung", 0.7, 0.9, 0.35, 1.42, 0.9, 0.0, 0.0, 0.5),
    "range hood": BoxFeatures("hung", 0.9, 0.7, 0.55, 1.42, 0.4, 0.0, 0.0, 0.5),
    "counter": BoxFeatures("support", 0.04, 2.0, 0.62, 0.86, 0.0, 0.0, 0.0, 0.5),
    "microwave": BoxFeatures("support", 0.28, 0.48, 0.36, 0.9, 0.8, 0.0, 0.1, 0.3),
    "cup": CUP,
    "bottle": replace(CUP, height=0.24, width=0.07, depth=0.07),
    "apple": replace(CUP, height=0.07),
    "box": replace(CUP, height=0.24, width=0.17, depth=0.06),
}


@pytest.mark.parametrize("label", EXAMPLES)
def test_common_objects_get_their_labels(label: str) -> None:
    assert guesses_of(EXAMPLES[label])[0][0] == label


def test_a_box_that_fits_no_rule_has_no_label() -> None:
    assert guesses_of(replace(CUP, height=1.4, width=3.0, depth=2.0)) == ()


SIZES = st.floats(0.01, 4.0)


@given(st.sampled_from(["floor", "support", "hung"]), SIZES, SIZES, SIZES, SIZES)
def test_scores_are_confidences(stand, height, width, depth, bottom) -> None:
    looks = BoxFeatures(
        stand, height, max(width, depth), min(width, depth), bottom, 0.5, 0.0, 1.0, 0.5
    )
    for label, score in guesses_of(looks):
        assert 0.0 < score <= 1.0
        assert label in {rule.label for rule in RULES}


@given(st.lists(st.floats(-5, 5), min_size=4, max_size=4, unique=True), st.floats(-6, 6))
def test_the_fit_of_a_range_is_1_inside_and_0_outside(ends, value) -> None:
    low, full, still, high = sorted(ends)
    share = fit(value, (low, full, still, high))
    assert 0.0 <= share <= 1.0
    assert (share == 1.0) >= (full <= value <= still)
    assert (share == 0.0) >= (value <= low or value >= high)
    assert np.isfinite(share)
