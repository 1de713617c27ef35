"""Distances of shapes from polygons on the floor agree with plane geometry."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from jaxtyping import Float

from momapos.core.geometry.transforms import pose, rotation_about
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_object import SceneObject
from momapos.model.urdf.articulated import Articulated
from momapos.model.urdf.reader import Geometry, Link, Urdf
from momapos.verification.exact_check import outside_note
from momapos.verification.exact_shapes import Shapes, join, shapes_of
from momapos.verification.link_bodies import bodies_of
from momapos.verification.motion_loads import depths_in, farthest_outside, outline_of, outside

FLOOR = np.array([[-2.0, -1.5], [2.0, -1.5], [2.0, 1.5], [-2.0, 1.5]])
UP = np.array([0.0, 0.0, 1.0])
BOX, BALL, ROD = (0.2, 0.4, 0.1), (0.15,), (0.1, 0.6)


def shapes(*kinds: str) -> Shapes:
    """Return shapes that are placed on their own: a box, a ball or an upright rod."""
    sizes = {"box": BOX, "sphere": BALL, "cylinder": ROD}
    parts = []
    for kind in kinds:
        link = Link(kind, (Geometry(kind, sizes[kind], np.eye(4)),), ())
        model = Articulated(Urdf("shapes", None, kind, {kind: link}, ()))
        parts.append(shapes_of(model, bodies_of(model)))
    return join(parts, [""] * len(parts))


def rectangle(
    center: Float[np.ndarray, "2"], size: tuple[float, float], yaw: float
) -> Float[np.ndarray, "4 2"]:
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * np.array(size) / 2
    return np.asarray(center + corners @ rotation_about(UP, np.array(yaw))[:2, :2].T)


def sampled_depth(area: Float[np.ndarray, "k 2"], outline: Float[np.ndarray, "m 2"]) -> float:
    """Return the depth of corners in the area, and of the middles of its edges in the outline."""
    depth = max(0.0, float(-outside(area, outline).min()))
    share = np.linspace(0.0, 1.0, 4001)[:, None]
    for a, b in zip(area, np.roll(area, -1, axis=0), strict=True):
        points = a + share * (b - a)
        within = points[outside(outline, points) <= 0.0]
        if len(within):
            middle = (within[:1] + within[-1:]) / 2
            depth = max(depth, float(-outside(outline, middle)[0]))
    return depth


@pytest.mark.parametrize("seed", range(3))
def test_depths_in_an_area_are_those_of_corners_and_of_edges_within(seed: int) -> None:
    rng = np.random.default_rng(seed)
    area = rectangle(np.zeros(2), (1.0, 0.3), 0.4)
    outlines = np.array([
        rectangle(rng.uniform(-0.6, 0.6, 2), tuple(rng.uniform(0.05, 1.5, 2)), rng.uniform(0, 6))
        for _ in range(80)
    ])  # fmt: skip
    expected = [sampled_depth(area, outline) for outline in outlines]
    np.testing.assert_allclose(depths_in(area, outlines), expected, atol=1e-3)
    assert 10 < np.count_nonzero(expected) < 80


def test_a_small_area_and_a_strip_across_an_outline_count() -> None:
    outline = rectangle(np.zeros(2), (1.0, 0.8), 0.0)
    small = rectangle(np.array([0.1, 0.0]), (0.02, 0.02), 0.0)
    strip = rectangle(np.array([0.2, 0.0]), (0.1, 5.0), 0.0)
    far = rectangle(np.array([3.0, 0.0]), (0.1, 5.0), 0.0)
    for area, depth in ((small, 0.4), (strip, 0.35), (far, 0.0)):
        assert depths_in(area, outline[None])[0] == pytest.approx(depth, abs=0.011)


@pytest.mark.parametrize("kind", ["box", "sphere", "cylinder"])
@pytest.mark.parametrize("yaw", [0.0, 0.5, 2.0])
def test_the_farthest_point_of_a_shape_is_outside_by_its_extent(kind: str, yaw: float) -> None:
    extent = {
        "box": abs(np.cos(yaw)) * BOX[0] / 2 + abs(np.sin(yaw)) * BOX[1] / 2,
        "sphere": BALL[0],
        "cylinder": ROD[0],
    }[kind]
    one = shapes(kind)
    Ts = np.array(
        [pose((x, 0.2, 0.5), rotation_about(UP, np.array(yaw))) for x in (0.0, 1.97, 1.9)]
    )
    distance, state = farthest_outside(FLOOR, one, Ts[:, None])
    assert (distance, state) == (pytest.approx(1.97 + extent - 2.0, abs=2e-3), 1)
    assert farthest_outside(FLOOR, one, Ts[:1, None]) == (0.0, 0)


def test_the_outline_of_shapes_is_as_wide_as_they_are() -> None:
    both = shapes("sphere", "box")
    Ts = np.array([pose((0.0, 0.0, 0.4)), pose((1.0, 0.0, 0.4))])
    outline = outline_of(both, Ts)
    np.testing.assert_allclose(outline.min(0), [-BALL[0], -BOX[1] / 2], atol=1e-9)
    np.testing.assert_allclose(outline.max(0), [1.0 + BOX[0] / 2, BOX[1] / 2], atol=1e-9)


def note_of(scene: Scene, moving: Shapes, Ts: np.ndarray) -> tuple[str, float, float, float] | None:
    """Return the name of a shape outside, its distance [cm] and its farthest point."""
    words = outside_note(scene, [(moving, Ts)])
    if words is None:
        return None
    found = re.match(r"(\S+) is up to (\d+) cm .* at \((\S+), (\S+)\);", words)
    assert found is not None
    return found[1], float(found[2]), float(found[3]), float(found[4])


def test_the_note_names_the_shape_that_is_farthest_outside_and_where() -> None:
    scene = Scene("room", (), floor_polygon=FLOOR)
    both, count = shapes("box", "sphere"), 200
    Ts = np.tile(np.eye(4), (count, 2, 1, 1))
    Ts[:, 0, 1, 3] = 1.3 + 0.3 * np.sin(np.linspace(0.0, np.pi, count))  # along y, to 1.6 + 0.2
    Ts[:, 1, 0, 3] = -1.9  # to -2.05
    assert note_of(scene, both, Ts) == ("box", 30.0, pytest.approx(0.0, abs=0.11), 1.8)
    Ts[:, 0, 1, 3] = 1.0
    assert note_of(scene, both, Ts) == ("sphere", 5.0, pytest.approx(-1.9, abs=0.2), 0.0)
    Ts[:, 1, 0, 3] = -1.845  # 5 mm outside
    assert note_of(scene, both, Ts) is None


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_note_is_of_the_state_in_which_a_shape_is_farthest_outside(side: float) -> None:
    Ts = np.array([pose((x, 0.0, 0.5)) for x in (side * 1.99, side * -1.95)])[:, None]
    found = note_of(Scene("room", (), floor_polygon=FLOOR), shapes("box"), Ts)
    assert found == ("box", 9.0, pytest.approx(side * 2.09, abs=0.01), pytest.approx(0.0, abs=0.21))


def test_what_is_above_an_object_or_behind_walls_is_not_noted() -> None:
    scene = Scene("room", (), floor_polygon=FLOOR)
    box = shapes("box")
    Ts = pose((2.3, 0.0, 1.0))[None, None]
    assert note_of(scene, box, Ts) == ("box", 40.0, 2.4, pytest.approx(0.0, abs=0.21))
    table = SceneObject.box("table", (1.0, 1.0, 0.8), (2.4, 0.0, 0.4))
    assert note_of(replace(scene, objects=(table,)), box, Ts) is None
    aside = SceneObject.box("table", (1.0, 1.0, 0.8), (2.4, 1.0, 0.4))
    assert note_of(replace(scene, objects=(aside,)), box, Ts) is not None
    assert note_of(replace(scene, floor_polygon=None), box, Ts) is None
