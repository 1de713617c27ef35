"""Parts that several images of a front agree on."""

from __future__ import annotations

import pytest

from momapos.types import Part
from momapos.views.agreement import agreed

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
