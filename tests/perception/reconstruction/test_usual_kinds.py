"""Labels and heights change the probabilities of part kinds."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from momapos.model.records.scans import FaceImage, Part, PartKind
from momapos.perception.reconstruction import decode
from momapos.perception.reconstruction.usual_kinds import (
    EYE_HEIGHT,
    HIGH,
    LOW,
    TRAINING_SHARES,
    USUAL,
    weighted_by_height,
    weighted_by_label,
    weighted_by_size,
)

BOX = (0.0, 0.0, 1.0, 1.0)


def seen(odds: dict[PartKind, float]) -> Part:
    """Return a part with these odds."""
    ranked = decode.ranked(odds)
    return Part(ranked[0][0], BOX, 0.8, None, ranked)


LIKE_A_DRAWER = seen(
    {"drawer": 0.6, "door_down": 0.3, "door_left": 0.05, "door_right": 0.04, "door_up": 0.01}
)


@pytest.mark.parametrize("shares", [TRAINING_SHARES, HIGH, LOW, *USUAL.values()])
def test_shares_of_the_kinds_are_of_all_kinds_and_sum_to_one(shares: dict[PartKind, float]) -> None:
    assert set(shares) == set(decode.KINDS)
    assert sum(shares.values()) == pytest.approx(1.0)
    assert min(shares.values()) > 0.0


def test_an_apparent_drawer_of_an_oven_is_its_flap() -> None:
    (part,) = weighted_by_label([LIKE_A_DRAWER], "Stove", 1.0)
    assert part.kind == "door_down"
    odds = dict(part.odds)
    before, usual = dict(LIKE_A_DRAWER.odds), USUAL["oven"]
    # Bayes' rule: the ratio of two kinds changes by the ratio of their likelihoods.
    ratio = (usual["door_down"] / TRAINING_SHARES["door_down"]) / (
        usual["drawer"] / TRAINING_SHARES["drawer"]
    )
    assert odds["door_down"] / odds["drawer"] == pytest.approx(
        ratio * before["door_down"] / before["drawer"]
    )


def test_an_uncertain_label_does_not_change_a_clear_kind() -> None:
    clear = seen({"door_left": 0.95, "door_right": 0.02, "drawer": 0.02, "door_down": 0.01})
    (part,) = weighted_by_label([clear], "oven", 0.4)
    assert part.kind == "door_left"


@given(
    st.lists(st.floats(1e-3, 1.0), min_size=5, max_size=5),
    st.sampled_from(sorted(USUAL)),
    st.floats(0.0, 1.0),
)
def test_weighted_odds_sum_to_one_and_the_first_is_the_kind(
    raw: list[float], label: str, sure: float
) -> None:
    odds = {kind: value / sum(raw) for kind, value in zip(decode.KINDS, raw, strict=True)}
    (part,) = weighted_by_label([seen(odds)], label, sure)
    assert sum(share for _, share in part.odds) == pytest.approx(1.0)
    assert part.kind == part.odds[0][0]
    assert part.odds == decode.ranked(dict(part.odds))


@pytest.mark.parametrize(("label", "sure"), [("cabinet", 1.0), ("", 1.0), ("microwave", 0.0)])
def test_labels_without_known_shares_change_nothing(label: str, sure: float) -> None:
    (part,) = weighted_by_label([LIKE_A_DRAWER], label, sure)
    assert dict(part.odds) == pytest.approx(dict(LIKE_A_DRAWER.odds))
    bare = Part("drawer", BOX, 0.8)
    assert weighted_by_label([bare], label, sure) == (bare,)


def test_drawers_are_improbable_above_eye_level_and_lifted_doors_below_it() -> None:
    face = FaceImage(np.zeros((4, 4, 3), np.uint8), np.zeros((4, 4), np.float32), 0.6, 0.8)
    level = {"drawer": 0.4, "door_up": 0.4, "door_left": 0.1, "door_right": 0.09, "door_down": 0.01}
    odds = decode.ranked(level)
    upper = Part("drawer", (0.0, 0.0, 1.0, 0.5), 0.8, None, odds)
    lower = Part("door_up", (0.0, 0.5, 1.0, 1.0), 0.8, None, odds)
    high, low = weighted_by_height([upper, lower], face, EYE_HEIGHT - 0.4)
    assert (high.kind, low.kind) == ("door_up", "drawer")
    assert sum(share for _, share in high.odds) == pytest.approx(1.0)
    assert weighted_by_height([upper], face, EYE_HEIGHT - 0.7)[0].kind == "drawer"


FLAP_ODDS: dict[PartKind, float] = {
    "door_down": 0.7, "drawer": 0.1, "door_left": 0.12, "door_right": 0.07, "door_up": 0.01,
}  # fmt: skip


def front_of(*widths: float, height: float = 0.7) -> tuple[FaceImage, list[Part]]:
    """Return a row of fronts with level bars at their tops, of these widths [m]."""
    edges = np.concatenate([[0.0], np.cumsum(widths)]) / sum(widths)
    boxes = [(float(a), 0.0, float(b), 1.0) for a, b in pairwise(edges)]
    image = FaceImage(
        np.zeros((8, 8, 3), np.uint8), np.zeros((8, 8), np.float32), sum(widths), height
    )
    return image, [replace(seen(FLAP_ODDS), box=box) for box in boxes]


def test_a_narrow_front_with_a_level_bar_is_a_door_and_a_dishwasher_stays_a_flap() -> None:
    image, parts = front_of(0.3)
    (narrow,) = weighted_by_size(parts, image)
    assert narrow.kind == "door_left"
    image, parts = front_of(0.6)
    (wide,) = weighted_by_size(parts, image)
    assert wide.kind == "door_down"


def test_two_flaps_of_one_size_side_by_side_are_doors() -> None:
    image, parts = front_of(0.6, 0.6)
    assert [part.kind for part in weighted_by_size(parts, image)] == ["door_left"] * 2
    image, parts = front_of(0.6, 1.2)
    assert [part.kind for part in weighted_by_size(parts, image)] == ["door_down"] * 2
    image, (part,) = front_of(0.6)
    adjacent = replace(part, box=(1.01, 0.0, 2.0, 1.0))
    assert weighted_by_size([part], image, [adjacent])[0].kind == "door_left"


def test_every_kind_stays_possible_in_every_size() -> None:
    for width in (0.2, 0.5, 1.5):
        for height in (0.15, 0.7, 1.8):
            image, parts = front_of(width, height=height)
            (part,) = weighted_by_size(parts, image)
            assert sum(p for _, p in part.odds) == pytest.approx(1.0)
            assert min(p for _, p in part.odds) > 0.0
