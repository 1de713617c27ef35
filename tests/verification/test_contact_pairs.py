"""Laws of the contacts between objects."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from tests.cupboards import link

from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene
from momapos.model.scene.scene_object import SceneObject
from momapos.verification import contact_pairs
from momapos.verification.contact_pairs import object_contacts


def boxes(rng: np.random.Generator, count: int) -> Scene:
    return Scene(
        "r",
        tuple(
            SceneObject.box(f"b{k}", rng.uniform(0.1, 0.5, 3), rng.uniform(0, 2, 3))
            for k in range(count)
        ),
    )


def test_the_depth_of_aligned_boxes_is_their_smallest_overlap() -> None:
    scene = boxes(np.random.default_rng(1), 60)
    contacts = object_contacts(scene, 0.0)
    found = {(one.first, one.second): one.depth for one in contacts}
    assert [one.depth for one in contacts] == sorted(found.values(), reverse=True)
    expected = {}
    for i, j in combinations(range(60), 2):
        a, b = scene.objects[i].bounds, scene.objects[j].bounds
        depth = np.minimum(a[1] - b[0], b[1] - a[0]).min()
        if depth > 1e-6:
            expected[i, j] = depth
    assert len(expected) > 20
    assert found.keys() == expected.keys()
    for pair, depth in expected.items():
        assert found[pair] == pytest.approx(depth, abs=1e-5)


def test_objects_of_several_shapes_are_as_deep_in_each_other_as_their_deepest_shapes(
    tmp_path: Path,
) -> None:
    rng = np.random.default_rng(2)
    groups = []
    for k in range(25):
        sizes, centers = rng.uniform(0.1, 0.4, (3, 3)), rng.uniform(0, 2, (3, 3))
        both = [(tuple(a), tuple(b)) for a, b in zip(sizes, centers, strict=True)]
        path = tmp_path / f"g{k}.urdf"
        path.write_text(f'<robot name="g{k}">{link("body", *both)}</robot>')
        item = SceneObject.from_urdf(f"g{k}", path, (0.0, 0.0, 0.0))
        groups.append((item, centers - sizes / 2, centers + sizes / 2))
    expected = {}
    for (i, (_, low, high)), (j, (_, other_low, other_high)) in combinations(enumerate(groups), 2):
        above, below = high[:, None] - other_low[None], other_high[None] - low[:, None]
        depth = np.minimum(above, below).min(2).max()
        if depth > 1e-6:
            expected[i, j] = depth
    found = object_contacts(Scene("r", tuple(item for item, _, _ in groups)), 0.0)
    assert len(expected) > 20
    assert {(one.first, one.second): one.depth for one in found} == pytest.approx(
        expected, abs=1e-5
    )


def test_a_gap_is_a_negative_depth() -> None:
    a = SceneObject.box("a", (1, 1, 1), (0, 0, 0.5))
    b = SceneObject.box("b", (1, 1, 1), (1.01, 0, 0.5))
    (one,) = object_contacts(Scene("r", (a, b)), 0.02)
    assert one.depth == pytest.approx(-0.01, abs=1e-5)
    assert one.labels == ("a/box", "b/box")
    assert object_contacts(Scene("r", (a, b)), 0.005) == ()
    assert object_contacts(Scene("r", ()), 0.02) == ()


def test_contacts_do_not_depend_on_how_many_pairs_are_compared_together(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene = load_scene("kitchen_small")
    whole = object_contacts(scene, 0.02)
    monkeypatch.setattr(contact_pairs, "MAX_PAIRS", 50)
    assert object_contacts(scene, 0.02) == whole
