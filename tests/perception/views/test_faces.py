from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.perception.views.painted_box import FRIDGE, camera, image

from momapos.core.geometry.polygons import UprightBox
from momapos.core.geometry.transforms import apply, invert
from momapos.model.records.scans import Frame
from momapos.perception.views.faces import (
    box_faces,
    coplanar_share,
    face_image,
    neighbor_protrusion,
    visible_share,
)
from momapos.perception.views.placed_parts import corners


def checks(world: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Paint red by height, green as a checkerboard, blue by side."""
    red = 255 * world[:, 2] / 1.8
    green = 200.0 * ((world[:, 2] // 0.3) % 2)
    return np.stack([red, green, 100 + 100 * normals[:, 0]], -1).clip(0, 255)


def view_of(index: int, off: float = 0.0) -> Frame:
    face = box_faces(FRIDGE)[index]
    eye = apply(face.T_world_face, np.array([[off, 0.3, 2.4]]))[0]
    return image(camera(tuple(eye), tuple(FRIDGE.center)), FRIDGE, checks)


def test_faces_lie_on_the_box_and_look_outward() -> None:
    points = corners(FRIDGE)
    for face in box_faces(FRIDGE):
        local = apply(invert(face.T_world_face), points)
        assert np.allclose(np.sort(local[:, 2])[-4:], 0.0)  # four corners on it, the rest behind
        assert np.ptp(local[:, 0]) == pytest.approx(face.width)
        assert np.ptp(local[:, 1]) == pytest.approx(face.height)
        assert np.linalg.det(face.T_world_face[:3, :3]) == pytest.approx(1.0)
        assert face.T_world_face[2, 1] == 1.0  # its y axis is up


@pytest.mark.parametrize("out", [-0.2, 0.0, 0.07])
def test_the_protrusion_of_a_neighbor_is_relative_to_the_front(out: float) -> None:
    for front in box_faces(FRIDGE):
        for k in front.neighbors:
            side = box_faces(FRIDGE)[k]
            edge = front.T_world_face[:3, 3] + side.outward * front.width / 2
            for gap, near in ((0.01, True), (0.3, False)):
                place = edge + (gap + 0.25) * side.outward + (out - 0.25) * front.outward
                small = UprightBox(place, np.array([0.5, 0.5, 1.0]), FRIDGE.yaw)
                found = neighbor_protrusion(side, front, [small])
                assert found == (pytest.approx(out) if near else None)
            assert neighbor_protrusion(side, front, []) is None


def test_neighboring_and_opposite_faces_are_indexed_as_seen_from_outside() -> None:
    faces = box_faces(FRIDGE)
    for face in faces:
        left, right = (faces[k].outward for k in face.neighbors)
        np.testing.assert_allclose(right, face.T_world_face[:3, 0], atol=1e-9)
        np.testing.assert_allclose(left, -right, atol=1e-9)
        np.testing.assert_allclose(faces[face.opposite].outward, -face.outward, atol=1e-9)


@pytest.mark.parametrize("off", [0.0, 0.8])
def test_a_face_seen_at_an_angle_is_rectified(off: float) -> None:
    face = box_faces(FRIDGE)[2]
    image = face_image(face, [view_of(2, off)])
    rows, columns = image.height_map.shape
    heights = 1.8 * (1 - (np.arange(rows) + 0.5) / rows)
    error = image.color[:, columns // 2, 0] - 255 * heights / 1.8
    assert np.abs(error[2:-2]).max() < 3  # the border mixes with what lies behind
    assert np.abs(np.nanmedian(image.height_map)) < 1e-3
    assert (image.width, image.height) == (face.width, face.height)


def test_protrusions_of_a_face_are_in_the_height_map() -> None:
    thin = replace(FRIDGE, size=FRIDGE.size - [0.1, 0.0, 0.0])  # its true front lies 5 cm behind
    image = face_image(box_faces(thin)[0], [view_of(0)])
    middle = image.height_map[image.height_map.shape[0] // 2, image.height_map.shape[1] // 2]
    assert middle == pytest.approx(0.05, abs=2e-3)


def test_the_height_map_is_the_median_of_the_frames() -> None:
    face = box_faces(FRIDGE)[1]
    frames = [view_of(1)]
    frames += [replace(frames[0], depth=frames[0].depth + step) for step in (0.0, 0.3)]
    assert abs(np.nanmedian(face_image(face, frames).height_map)) < 1e-3


def test_a_face_is_visible_from_its_own_side_only() -> None:
    faces = box_faces(FRIDGE)
    assert visible_share(faces[3], view_of(3)) > 0.9
    assert visible_share(faces[1], view_of(3)) == 0.0


def test_a_hidden_face_is_not_visible() -> None:
    frame = view_of(3)
    hidden = replace(frame, depth=np.where(np.arange(640) < 320, 0.5, frame.depth).astype("f4"))
    assert visible_share(box_faces(FRIDGE)[3], hidden) == pytest.approx(0.5, abs=0.1)


def test_open_places_of_a_face_do_not_lower_its_visibility() -> None:
    face, frame = box_faces(FRIDGE)[3], view_of(3)
    left, right = np.arange(640) < 315, np.arange(640) > 325
    through = np.where(left, frame.depth + 0.5, frame.depth).astype("f4")
    assert visible_share(face, replace(frame, depth=through)) > 0.9
    both = np.where(right, 0.5, through).astype("f4")
    assert visible_share(face, replace(frame, depth=both)) < 0.3


def test_an_obstruction_in_one_frame_is_replaced_by_another_frame() -> None:
    face = box_faces(FRIDGE)[0]
    free = view_of(0)
    hidden = replace(free, color=free.color.copy(), depth=free.depth.copy())
    hidden.color[240:] = 7
    hidden.depth[240:] = 1.0  # something stands a meter from the camera
    image = face_image(face, [hidden, free])
    alone = face_image(face, [free])
    np.testing.assert_array_equal(image.color, alone.color)
    measured = np.isfinite(alone.height_map)
    np.testing.assert_allclose(image.height_map[measured], alone.height_map[measured], atol=1e-6)
    only = face_image(face, [hidden])
    assert (only.color[-5:] == 7).all()
    assert np.nanmin(only.height_map[-5:]) > 0.5


def test_surfaces_behind_a_face_lower_its_coplanar_share() -> None:
    image = face_image(box_faces(FRIDGE)[0], [view_of(0)])
    rows = image.height_map.shape[0]
    legs = image.height_map - 0.3 * (np.arange(rows) > rows / 2)[:, None]
    assert coplanar_share(image) > 0.99
    half = replace(image, height_map=legs.astype("f4"))
    assert coplanar_share(half) == pytest.approx(0.5, abs=0.02)
    assert coplanar_share(half, (0.1, 0.0, 0.9, 0.4)) == 1.0
    assert coplanar_share(half, (0.1, 0.6, 0.9, 1.0)) == 0.0
    assert coplanar_share(replace(image, height_map=np.full_like(image.height_map, np.nan))) == 1.0


def test_a_front_below_a_protruding_top_is_coplanar() -> None:
    image = face_image(box_faces(FRIDGE)[0], [view_of(0)])
    rows = image.height_map.shape[0]
    below = image.height_map - 0.12 * (np.arange(rows) > rows / 10)[:, None]
    desk = replace(image, height_map=below.astype("f4"))
    assert coplanar_share(desk, (0.0, 0.2, 1.0, 1.0)) > 0.99
    assert 0.85 < coplanar_share(desk) < 0.95
