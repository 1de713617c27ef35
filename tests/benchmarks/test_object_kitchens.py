"""Laws of kitchens of many objects: no two objects overlap."""

from __future__ import annotations

import importlib
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_object import SceneObject

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


def alone(wide: float, *, carried: bool) -> Scene:
    """Build a box with its front toward -x at a wall, optionally on a wider counter."""
    above = 0.9 if carried else 0.0
    objects = [
        SceneObject.box("object", (0.4, wide, 0.5), (-0.2, 0.0, above + 0.25)),
        SceneObject.box("wall", (0.1, 3.0, 2.5), (0.05, 0.0, 1.25)),
    ]
    if carried:
        objects.append(SceneObject.box("counter", (0.6, 2.0, 0.9), (-0.3, 0.0, 0.45)))
    return Scene("alone", tuple(objects))


@pytest.mark.parametrize("count", [1, 2, 7])
def test_objects_and_their_counters_do_not_overlap(
    count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    kitchens = importlib.import_module("scan_objects")
    rooms = [(f"item/{k}", alone(0.4 + 0.1 * k, carried=k % 3 == 0)) for k in range(count)]
    place = kitchens.kitchen("kitchen", rooms)
    assert sorted(name for name, _ in place.objects.values()) == [name for name, _ in rooms]
    for one, other in combinations(place.scene.objects, 2):
        low = np.maximum(one.bounds[0], other.bounds[0])
        high = np.minimum(one.bounds[1], other.bounds[1])
        assert (high - low < 1e-6).any(), f"{one.name} overlaps {other.name}"
