"""What a family of grasps implies for all stages."""

from __future__ import annotations

import pytest

from momapos.model.records.plans import FAMILIES, Family, Hold
from momapos.model.robots.robot import Grip
from momapos.planning.grasps.config import GraspConfig


def test_plans_and_settings_name_the_same_families() -> None:
    assert GraspConfig().families == tuple(str(family) for family in FAMILIES)
    for family in FAMILIES:
        assert Hold(0, 1, family=str(family)).kind is family


@pytest.mark.parametrize("word", ["", "grab", "Pinch", "push "])
def test_another_word_states_no_family(word: str) -> None:
    assert Hold(0, 1, family=word).kind is Family.UNSTATED


def test_what_holds_closes_or_sticks_and_what_pushes_does_neither() -> None:
    for family in FAMILIES:
        assert (family.closes or family.sticks) is (family is not Family.PUSH)
        assert not (family.closes and family.sticks)
        assert not family.turns or family.closes
        assert not family.is_one_sided or (family.closes and family.leads)


def test_every_tool_can_push_and_hold_in_some_way() -> None:
    for grip in Grip:
        able = [family for family in FAMILIES if grip in family.tools]
        assert Family.PUSH in able
        assert any(family.closes or family.sticks for family in able)
