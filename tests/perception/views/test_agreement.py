"""Consensus of several images on the parts of a front."""

from __future__ import annotations

import pytest

from momapos.model.records.scans import Part
from momapos.perception.views.front_view import consensus

WHOLE = Part("drawer", (0.0, 0.0, 1.0, 1.0), 0.7)
HALVES = (Part("drawer", (0.0, 0.0, 1.0, 0.5), 0.7), Part("drawer", (0.0, 0.5, 1.0, 1.0), 0.7))


def test_parts_that_most_images_show_are_kept() -> None:
    parts = consensus([(WHOLE,), HALVES, HALVES])
    assert sorted(part.box for part in parts) == [part.box for part in HALVES]


def test_the_kind_is_that_of_most_images() -> None:
    flap = Part("door_down", WHOLE.box, 0.7, None, (("door_down", 0.6), ("drawer", 0.4)))
    drawer = Part("drawer", WHOLE.box, 0.7, None, (("drawer", 0.8), ("door_down", 0.2)))
    (part,) = consensus([(flap,), (drawer,), (drawer,)])
    assert part.kind == "drawer"
    assert sum(share for _, share in part.odds) == pytest.approx(1.0)


def test_a_part_that_one_of_many_images_shows_is_dropped() -> None:
    weak = Part("drawer", WHOLE.box, 0.3)
    assert consensus([(weak,), (), (), ()]) == ()
    assert consensus([]) == ()


def test_parts_that_explain_every_handle_are_kept_before_one_that_does_not() -> None:
    high, low = (
        Part("drawer", half.box, 0.6, (0.3, half.box[1] + 0.05, 0.7, half.box[1] + 0.1))
        for half in HALVES
    )
    whole = Part("drawer", WHOLE.box, 0.75, low.handle)
    plain = (Part("drawer", part.box, 0.6) for part in (high, low))
    assert [part.box for part in consensus([tuple(plain), (whole,), (whole,)])] == [WHOLE.box]
    parts = consensus([(high, low), (high, low), (whole,), (whole,)])
    assert sorted(part.box for part in parts) == [part.box for part in HALVES]
    assert {part.handle for part in parts} == {high.handle, low.handle}


def test_one_image_with_an_oversized_part_does_not_displace_its_neighbor() -> None:
    high = Part("drawer", (0.0, 0.0, 1.0, 0.35), 0.4)
    low = Part("drawer", (0.0, 0.37, 1.0, 1.0), 0.4)
    large = Part("drawer", (0.0, 0.1, 1.0, 1.0), 0.6)
    parts = consensus([(high, low), (high, low), (high, low), (large,)])
    assert sorted(part.box for part in parts) == [high.box, low.box]


def test_a_neighbors_handle_on_the_rim_does_not_count_against_a_part() -> None:
    high = Part("drawer", HALVES[0].box, 0.6, (0.3, 0.05, 0.7, 0.1))
    low = Part("drawer", (0.0, 0.45, 1.0, 1.0), 0.6, (0.3, 0.46, 0.7, 0.49))
    assert len(consensus([(high, low), (high, low)])) == 2
