"""Leaves: the seam behind a door is found where it is painted, and nothing where there is none."""

from __future__ import annotations

import numpy as np
import pytest
from tests.views.painted_box import FRIDGE, Paint, camera, image

from momapos.geometry.transforms import apply, invert
from momapos.types import Frame, Part
from momapos.views.faces import box_faces
from momapos.views.leaf_edges import leaf_rear

FACES = box_faces(FRIDGE)
FRONT = FACES[2]
SIDES = tuple(FACES[k] for k in FRONT.beside)
DOOR = [Part("door_left", (0.0, 0.05, 1.0, 0.95), 0.9)]


def painted(*, seam: float | None = None, body: float = 0.8, level: bool = False) -> Paint:
    """A gray box with a dark line of 6 mm so far behind the front, or along its middle height.

    Args:
        seam: Where the leaf ends [m]; None without one.
        body: Brightness of what is behind the seam, that of the leaf is 0.8 [-].
        level: Whether there is a level line.
    """

    def paint(world: np.ndarray, normals: np.ndarray) -> np.ndarray:
        behind = -apply(invert(FRONT.T_world_face), world)[:, 2]
        shade = np.full(len(world), 0.8)
        on_side = np.abs(normals @ FRONT.outward) < 0.5
        if seam is not None:
            shade[on_side & (behind > seam)] = body
            shade[on_side & (behind > seam) & (behind < seam + 0.006)] = 0.3
        if level:
            shade[np.abs(world[:, 2] - FRIDGE.center[2]) < 0.01] = 0.3
        grain = np.random.default_rng(0).normal(0.0, 0.02, (len(world), 1))
        return (255 * np.clip(shade[:, None] + grain, 0.0, 1.0)).astype(np.uint8).repeat(3, axis=1)

    return paint


def frames(paint: Paint, sides: tuple[int, ...] = (0, 1)) -> list[Frame]:
    """Two images of some sides of the box, and one of its front."""
    eyes = [FRONT.T_world_face[:3, 3] + 1.5 * FRONT.outward]
    for k in sides:
        middle = SIDES[k].T_world_face[:3, 3]
        eyes += [middle + 1.2 * SIDES[k].outward + s * FRONT.outward for s in (0.2, 0.6)]
    return [image(camera(tuple(eye), tuple(FRIDGE.center)), FRIDGE, paint) for eye in eyes]


@pytest.mark.parametrize("seam", [0.02, 0.055, 0.09])
@pytest.mark.parametrize("sides", [(0,), (1,), (0, 1)])
def test_the_seam_behind_a_door_is_found_from_either_side(
    seam: float, sides: tuple[int, ...]
) -> None:
    rear = leaf_rear(FRONT, SIDES, DOOR, frames(painted(seam=seam), sides))
    assert rear == pytest.approx(seam, abs=0.005)


def test_a_body_darker_than_its_door_shows_where_that_ends() -> None:
    rear = leaf_rear(FRONT, SIDES, DOOR, frames(painted(seam=0.05, body=0.5)))
    assert rear == pytest.approx(0.05, abs=0.005)


@pytest.mark.parametrize("level", [True, False])
def test_a_plain_side_shows_no_seam(level: bool) -> None:
    assert leaf_rear(FRONT, SIDES, DOOR, frames(painted(level=level))) is None


def test_images_of_the_front_alone_show_no_seam() -> None:
    assert leaf_rear(FRONT, SIDES, DOOR, frames(painted(seam=0.05), ())) is None
