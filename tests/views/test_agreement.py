"""What several looks at one front say of its parts together."""

from __future__ import annotations

from dataclasses import replace

import pytest

from momapos.types import Front, Part, PartKind
from momapos.views.agreement import agreed, surest

BOX = (0.1, 0.1, 0.6, 0.9)
BESIDE = (0.6, 0.1, 0.9, 0.9)


def part(drawer: float, box: tuple[float, float, float, float] = BOX, score: float = 0.8) -> Part:
    """A drawer with a probability, else a flap."""
    odds: dict[PartKind, float] = {"drawer": drawer, "door_down": 1.0 - drawer}
    ranked = tuple(sorted(odds.items(), key=lambda pair: -pair[1]))
    return Part(ranked[0][0], box, score, odds=ranked)


def looks(*drawer: float) -> list[Front]:
    return [Front(0.9, (part(share),)) for share in drawer]


def test_two_looks_that_are_surer_outvote_the_first() -> None:
    (found,) = agreed(looks(0.55, 0.1, 0.2)).parts
    assert found.kind == "door_down" == found.odds[0][0]
    assert sum(share for _, share in found.odds) == pytest.approx(1.0)
    assert found.box == BOX
    assert found.score == 0.8


def test_looks_that_say_the_same_do_not_make_each_other_surer() -> None:
    (found,) = agreed(looks(0.7, 0.7, 0.7)).parts
    assert dict(found.odds) == pytest.approx({"drawer": 0.7, "door_down": 0.3})


def test_the_order_of_the_other_looks_does_not_matter() -> None:
    one, other = (agreed(looks(0.6, *rest)).parts[0] for rest in ((0.2, 0.9), (0.9, 0.2)))
    assert dict(one.odds) == pytest.approx(dict(other.odds))


def test_a_look_that_shows_another_part_says_nothing_of_this_one() -> None:
    first = Front(0.9, (part(0.6),))
    assert agreed([first, Front(0.9, (part(0.0, BESIDE),)), Front(0.1, ())]) == first


def test_a_look_without_odds_says_nothing() -> None:
    first, bare = Front(0.9, (part(0.6),)), replace(part(0.1), odds=())
    assert agreed([first, Front(0.9, (bare,))]) == first
    assert agreed([Front(0.9, (bare,)), first]).parts == (bare,)


def test_one_look_that_excludes_a_kind_does_not_decide_alone() -> None:
    (found,) = agreed(looks(0.0, 0.9999, 0.9999)).parts
    assert found.kind == "drawer"


def test_what_was_left_out_has_a_say_in_how_the_surest_opens() -> None:
    (found,) = surest([part(0.6, score=0.9), part(0.1, score=0.7)])
    assert found.score == 0.9
    assert found.kind == "door_down"
