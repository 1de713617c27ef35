"""Fronts without depth are completed from the planes around them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.furnished import BACK, FLOOR, Camera, Corners, look_at, photograph

from momapos.model.records.scans import Cloud, Frame
from momapos.perception.fusion.completion import complete

LEFT: Corners = ((-1.2, 0.4, 0.0), (-0.3, 1.0, 0.9))
DARK: Corners = ((-0.3, 0.4, 0.0), (0.3, 1.0, 0.9))
RIGHT: Corners = ((0.3, 0.4, 0.0), (1.2, 1.0, 0.9))
TALL: Corners = ((1.2, 0.4, 0.0), (1.8, 1.0, 1.9))
ROW = (FLOOR, BACK, LEFT, DARK, RIGHT, TALL)
EYES = ((-0.7, -1.3, 1.5), (0.0, -1.4, 1.4), (0.8, -1.2, 1.5), (1.5, -1.4, 1.5))
NOTHING = Cloud(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3), np.uint8))


def frames_of(boxes: tuple[Corners, ...], dark: Corners | None) -> list[Frame]:
    """Return images of boxes, one of which has no depth."""
    frames = []
    for x, y, z in EYES:
        T = look_at((x, y, z), (0.5, 0.6, 0.6))
        frame = photograph(boxes, T, Camera(320, 240, 220.0), 0.003, np.random.default_rng(0))
        if dark is not None:
            gray = 40 + 10 * boxes.index(dark)
            frame = replace(frame, depth=np.where(frame.color[..., 0] == gray, 0.0, frame.depth))
        frames.append(frame)
    return frames


@pytest.mark.parametrize("dark", [DARK, TALL], ids=["between", "at the end"])
def test_a_front_without_depth_becomes_the_plane_of_its_neighbors(dark: Corners) -> None:
    found = complete(NOTHING, frames_of(ROW, dark))
    (x0, y0, _), (x1, _, z1) = dark
    front = found.points[found.normals[:, 1] == -1.0]
    assert len(front) > 0.9 * len(found.points)
    np.testing.assert_allclose(front[:, 1], y0, atol=0.015)
    inside = (front[:, 0] > x0 - 0.03) & (front[:, 0] < x1 + 0.03) & (front[:, 2] < z1 + 0.03)
    assert inside.mean() > 0.95  # the top of what is dark has no depth either
    cells = {tuple(cell) for cell in np.floor(front[inside][:, [0, 2]] / 0.05).astype(int)}
    assert len(cells) * 0.05**2 > 0.65 * (x1 - x0) * z1


def test_nothing_is_added_if_every_front_has_depth() -> None:
    cloud = Cloud(np.ones((5, 3)), np.ones((5, 3)), np.zeros((5, 3), np.uint8))
    found = complete(cloud, frames_of(ROW, None))
    np.testing.assert_array_equal(found.points, cloud.points)


def test_images_without_depth_or_of_few_pixels_add_nothing() -> None:
    frame = frames_of(ROW, DARK)[0]
    small = photograph(ROW, frame.T_world_camera, Camera(6, 3, 4.0))
    assert not len(complete(NOTHING, [replace(frame, depth=None), small] * 2).points)


def test_holes_that_are_seen_through_or_shown_by_one_image_stay_open() -> None:
    frames = frames_of(ROW, DARK)
    assert not len(complete(NOTHING, frames[:1]).points)
    through = frames_of((FLOOR, BACK, LEFT, RIGHT), None)[1]
    left = complete(NOTHING, [*frames, through]).points
    assert len(left) < 0.05 * len(complete(NOTHING, frames).points)


def test_holes_in_walls_and_below_tables_stay_open() -> None:
    window: Corners = ((-0.5, 0.99, 0.9), (0.5, 1.05, 1.5))
    boxes = (FLOOR, BACK, window)
    frames = frames_of(boxes, window)
    assert len(complete(NOTHING, frames).points)
    assert not len(complete(NOTHING, frames, [(1, 1.0)]).points)
    legs = [((x, 0.4, 0.0), (x + 0.06, 0.46, 0.7)) for x in (-0.6, 0.54)]
    top: Corners = ((-0.6, 0.4, 0.7), (0.6, 1.0, 0.74))
    wall = FLOOR, top, legs[0], legs[1]  # no wall behind: there is no depth
    assert not len(complete(NOTHING, frames_of(wall, None)).points)
