"""Colors that are drawn together are distinguishable in all kinds of color vision."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from momapos.apps.plots.answer_plot import KINDS
from momapos.apps.plots.palette import RELATIONS
from momapos.apps.web.answer_view import legend_rows
from momapos.apps.web.colors import (
    COMPARED,
    DRIVE,
    FEASIBLE,
    FORCE,
    INFEASIBLE,
    PART,
    TARGET,
    TOOL,
    VERDICTS,
    rgb,
)
from momapos.apps.web.panel import LAYERS
from momapos.apps.web.scan_view import BACKGROUND, OBJECT_COLORS

VISIONS = {
    "all cones": np.eye(3),
    # Machado, Oliveira, Fernandes: A physiologically-based model for simulation of color vision
    # deficiency, 2009, severity 1; of linear red, green and blue.
    "protanopia": np.array([[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216],
                            [-0.003882, -0.048116, 1.051998]]),
    "deuteranopia": np.array([[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
                              [-0.011820, 0.042940, 0.968881]]),
    "tritanopia": np.array([[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602],
                            [0.004733, 0.691367, 0.303900]]),
}  # fmt: skip
XYZ = np.array([[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750],
                [0.0193339, 0.1191920, 0.9503041]])  # fmt: skip
WHITE = XYZ.sum(1)
MIN_DISTANCE = 13.0
"""Minimum distance in CIELAB; 2.3 is just noticeable [-]."""
TOGETHER = {
    "candidates": [kind.color for kind in KINDS],
    "verdicts on the base": list(VERDICTS.values()),
    "objects of a scan": [*OBJECT_COLORS, BACKGROUND],
    "compared answers": list(COMPARED.values()),
    "relations": [line.color for line in RELATIONS.values()],
    "lines of an answer": [DRIVE, TOOL, FEASIBLE, FORCE],
    "objects": [TARGET, PART, INFEASIBLE],
}
"""Colors that are drawn together with different meanings."""


def lab(color: str, vision: str) -> np.ndarray:
    """Convert a color, as perceived with a kind of color vision, to CIELAB."""
    coded = np.array(rgb(color)) / 255.0
    linear = np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4)
    x, y, z = XYZ @ np.clip(VISIONS[vision] @ linear, 0.0, 1.0) / WHITE
    fx, fy, fz = (np.cbrt(t) if t > 216 / 24389 else (24389 / 27 * t + 16) / 116 for t in (x, y, z))
    return np.array([116 * fy - 16, 500 * (fx - fy), 200 * (fy - fz)])


def test_colors_in_cielab_have_their_defined_values() -> None:
    np.testing.assert_allclose(lab("#ffffff", "all cones"), [100.0, 0.0, 0.0], atol=1e-3)
    np.testing.assert_allclose(lab("#ff0000", "all cones"), [53.24, 80.09, 67.20], atol=0.02)
    red_green = [np.linalg.norm(lab("#b00000", v) - lab("#506a00", v)) for v in VISIONS]
    assert red_green[0] > 70.0
    assert min(red_green[1:3]) < 20.0  # confused without red or green cones


@pytest.mark.parametrize("vision", VISIONS)
@pytest.mark.parametrize("group", TOGETHER)
def test_colors_drawn_together_are_distinguishable(group: str, vision: str) -> None:
    colors = {color: lab(color, vision) for color in TOGETHER[group]}
    assert len(colors) == len(TOGETHER[group])
    near = {
        pair: np.linalg.norm(colors[pair[0]] - colors[pair[1]]) for pair in combinations(colors, 2)
    }
    pair = min(near, key=lambda one: float(near[one]))
    assert near[pair] >= MIN_DISTANCE, pair


MIN_DIFFERENCE = 8.0
"""Minimum distance in CIELAB of two colors of the page with all cones: a few grays are near [-]."""


def test_each_color_of_the_legend_has_one_meaning_and_each_meaning_one_color() -> None:
    rows = legend_rows(LAYERS, [kind.name for kind in KINDS])
    words = [meaning for _, meaning in rows]
    assert len(set(words)) == len(words)
    single = {ramp[0]: lab(ramp[0], "all cones") for ramp, _ in rows if len(ramp) == 1}
    assert len(single) == sum(len(ramp) == 1 for ramp, _ in rows)
    for one, other in combinations(single, 2):
        assert np.linalg.norm(single[one] - single[other]) >= MIN_DIFFERENCE, (one, other)
    ramps = [ramp for ramp, _ in rows if len(ramp) > 1]
    assert len(set(ramps)) == len(ramps)
