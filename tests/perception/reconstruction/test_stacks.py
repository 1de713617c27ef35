"""Similar stacked parts open in the same way."""

from __future__ import annotations

from dataclasses import replace

import pytest
from tests.perception.reconstruction.fronts import face_of

from momapos.model.records.scans import Part, PartKind
from momapos.perception.reconstruction.front_network import DRAWER_PRIOR, weigh_stacks

FACE = face_of(0.8, 0.8, 0.0)
HIGH = Part("drawer", (0.0, 0.0, 1.0, 0.4), 0.5, (0.1, 0.05, 0.9, 0.08))
LOW = Part("door_down", (0.0, 0.4, 1.0, 1.0), 0.5, (0.1, 0.45, 0.9, 0.48))


def doubted(part: Part, drawer: float) -> Part:
    """Return a part that is a drawer with a probability, else a flap, with 2 % for other kinds."""
    odds: dict[PartKind, float] = {"drawer": 0.98 * drawer, "door_down": 0.98 * (1 - drawer)}
    ranked = tuple(sorted({**odds, "door_up": 0.02}.items(), key=lambda pair: -pair[1]))
    return replace(part, kind=ranked[0][0], odds=ranked)  # type: ignore[arg-type]


def test_a_flap_below_a_similar_drawer_is_a_drawer() -> None:
    high, low = weigh_stacks(FACE, [doubted(HIGH, 0.6), doubted(LOW, 0.1)])
    assert (high.kind, low.kind) == ("drawer", "drawer")
    for part in (high, low):
        assert part.kind == part.odds[0][0]
        assert sum(share for _, share in part.odds) == pytest.approx(1.0)
        assert dict(part.odds)["door_up"] == pytest.approx(0.02)


def test_ambiguous_stacked_parts_are_drawers() -> None:
    parts = [doubted(HIGH, 0.15), doubted(LOW, 0.15)]
    first, second = weigh_stacks(FACE, parts)
    assert (first.kind, second.kind) == ("drawer", "drawer")
    share = DRAWER_PRIOR * 0.15 / (DRAWER_PRIOR * 0.15 + 0.85)
    assert dict(first.odds)["drawer"] == pytest.approx(0.98 * share)


def test_two_that_are_clearly_flaps_stay_flaps() -> None:
    found = weigh_stacks(FACE, [doubted(HIGH, 0.005), doubted(LOW, 0.005)])
    assert [part.kind for part in found] == ["door_down", "door_down"]


def test_an_oven_above_its_drawer_stays_a_flap() -> None:
    found = weigh_stacks(FACE, [doubted(HIGH, 0.03), doubted(LOW, 0.99)])
    assert [part.kind for part in found] == ["door_down", "drawer"]


def test_stacked_parts_as_high_as_ovens_keep_their_odds() -> None:
    tall = face_of(0.6, 1.2, 0.0)
    high = replace(HIGH, box=(0.0, 0.0, 1.0, 0.5))
    low = replace(LOW, box=(0.0, 0.5, 1.0, 1.0), handle=(0.1, 0.55, 0.9, 0.58))
    found = weigh_stacks(tall, [doubted(high, 0.3), doubted(low, 0.3)])
    assert [part.kind for part in found] == ["door_down", "door_down"]
    found = weigh_stacks(face_of(0.6, 0.5, 0.0), [doubted(high, 0.3), doubted(low, 0.3)])
    assert [part.kind for part in found] == ["drawer", "drawer"]


@pytest.mark.parametrize(
    "low",
    [
        replace(LOW, handle=None),
        replace(LOW, handle=(0.1, 0.7, 0.9, 0.73)),
        replace(LOW, handle=(0.4, 0.45, 0.6, 0.48)),
        replace(LOW, box=(0.0, 0.5, 1.0, 1.0), handle=(0.1, 0.55, 0.9, 0.58)),
        replace(LOW, box=(0.0, 0.4, 0.8, 1.0)),
    ],
)
def test_dissimilar_parts_stay_unchanged(low: Part) -> None:
    parts = [doubted(HIGH, 0.6), doubted(low, 0.1)]
    found = weigh_stacks(FACE, parts)
    assert [part.kind for part in found] == ["drawer", "door_down"]
    for one, other in zip(found, parts, strict=True):
        assert dict(one.odds) == pytest.approx(dict(other.odds))


def test_parts_without_odds_stay_unchanged() -> None:
    assert weigh_stacks(FACE, [HIGH, LOW]) == (HIGH, LOW)
    assert weigh_stacks(FACE, []) == ()
