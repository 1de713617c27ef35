"""Parts that several images of a front agree on."""

from __future__ import annotations

import pytest

from momapos.model.records.scans import Part
from momapos.perception.views.agreement import agreed

WHOLE = Part("drawer", (0.0, 0.0, 1.0, 1.0), 0.7)
HALVES = (
    Part("drawer", (0.0, 0.0, 1.0, 0.5), 0.7),
    Part("drawer", (0.0, 0.5, 1.0, 1.0), 0.7),
)


def test_what_most_images_show_is_kept() -> None:
    parts = agreed([(WHOLE,), HALVES, HALVES])
    assert sorted(part.box for part in parts) == [part.box for part in HALVES]


def test_the_kind_is_what_most_images_say() -> None:
    flap = Part("door_down", WHOLE.box, 0.7, None, (("door_down", 0.6), ("drawer", 0.4)))
    drawer = Part("drawer", WHOLE.box, 0.7, None, (("drawer", 0.8), ("door_down", 0.2)))
    (part,) = agreed([(flap,), (drawer,), (drawer,)])
    assert part.kind == "drawer"
    assert sum(share for _, share in part.odds) == pytest.approx(1.0)


def test_a_part_of_one_image_among_many_is_none() -> None:
    weak = Part("drawer", WHOLE.box, 0.3)
    assert agreed([(weak,), (), (), ()]) == ()
    assert agreed([]) == ()


def test_parts_that_explain_every_handle_are_kept_before_one_that_does_not() -> None:
    high, low = (
        Part("drawer", half.box, 0.6, (0.3, half.box[1] + 0.05, 0.7, half.box[1] + 0.1))
        for half in HALVES
    )
    whole = Part("drawer", WHOLE.box, 0.75, low.handle)
    plain = (Part("drawer", part.box, 0.6) for part in (high, low))
    assert [part.box for part in agreed([tuple(plain), (whole,), (whole,)])] == [WHOLE.box]
    parts = agreed([(high, low), (high, low), (whole,), (whole,)])
    assert sorted(part.box for part in parts) == [part.box for part in HALVES]
    assert {part.handle for part in parts} == {high.handle, low.handle}


def test_one_image_that_sees_a_part_too_large_takes_no_room_from_its_neighbor() -> None:
    high = Part("drawer", (0.0, 0.0, 1.0, 0.35), 0.4)
    low = Part("drawer", (0.0, 0.37, 1.0, 1.0), 0.4)
    large = Part("drawer", (0.0, 0.1, 1.0, 1.0), 0.6)
    parts = agreed([(high, low), (high, low), (high, low), (large,)])
    assert sorted(part.box for part in parts) == [high.box, low.box]


def test_the_handle_of_a_neighbor_on_the_rim_does_not_speak_against_a_part() -> None:
    high = Part("drawer", HALVES[0].box, 0.6, (0.3, 0.05, 0.7, 0.1))
    low = Part("drawer", (0.0, 0.45, 1.0, 1.0), 0.6, (0.3, 0.46, 0.7, 0.49))
    assert len(agreed([(high, low), (high, low)])) == 2
