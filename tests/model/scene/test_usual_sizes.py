"""Laws of the recognition of units."""

from __future__ import annotations

import pytest

from momapos.core.errors import SceneError
from momapos.model.scene.object_reader import UNITS, size_hint, unit_factors, usual_edge
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import check_room_size
from momapos.model.scene.scene_object import SceneObject

FRIDGE = (0.6, 0.7, 1.8)


@pytest.mark.parametrize(("unit", "length"), [unit for unit in UNITS if unit[0] != "inches"])
def test_a_fridge_in_another_unit_is_recognized(unit: str, length: float) -> None:
    usual = usual_edge("fridge", "f", jointed=True)
    assert unit_factors(max(FRIDGE) / length, usual)[0] == (unit, length)
    assert unit_factors(max(FRIDGE) * length, usual)[0] == (unit, 1 / length)
    assert size_hint(FRIDGE, usual) == ""


def test_an_object_in_inches_is_recognized() -> None:
    hint = size_hint([edge / 0.0254 for edge in FRIDGE], usual_edge("", "x", jointed=True))
    assert "inches" in hint
    assert "0.6 x 0.7 x 1.8 m" in hint


def test_the_category_decides_before_the_name() -> None:
    assert usual_edge("cup", "table_1", jointed=False) == usual_edge("cup", "", jointed=False)
    assert usual_edge("", "my_cup_2", jointed=False) == usual_edge("cup", "", jointed=False)


def test_a_room_that_is_too_large_names_the_unit() -> None:
    box = SceneObject.box("fridge", (600, 700, 1800), (0, 0, 900), category="fridge")
    with pytest.raises(SceneError, match=r"millimeters \(factor 0\.001: 0\.6 x 0\.7 x 1\.8 m\)"):
        check_room_size(Scene("r", (box,)))
    far = SceneObject.box("crate", (1, 1, 1), (600, 0, 0.5))
    near = [SceneObject.box(f"c{k}", (1, 1, 1), (k, 0, 0.5)) for k in range(3)]
    with pytest.raises(SceneError, match=r"check 'crate'$"):
        check_room_size(Scene("r", (far, *near)))
