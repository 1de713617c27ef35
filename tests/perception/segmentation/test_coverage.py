"""Coverage is the seen share of the visible surface."""

from __future__ import annotations

import numpy as np
import pytest

from momapos.core.geometry.polygons import UprightBox
from momapos.core.geometry.transforms import apply, pose, rotation_about
from momapos.model.records.scans import Cloud, Detection
from momapos.perception.segmentation.pointing import SIDES, coverage, with_coverage

SIZE = np.array([0.6, 0.8, 1.0])


def surface(box: UprightBox, faces: tuple[int, ...]) -> tuple[Detection, Cloud]:
    """Return points on some faces of a box."""
    points, normals = [], []
    steps = np.linspace(-0.5, 0.5, 60)
    for axis, sign in (SIDES[k] for k in faces):
        a, b = (k for k in range(3) if k != axis)
        local = np.zeros((60, 60, 3))
        local[..., a], local[..., b] = (steps * box.size[a])[:, None], (steps * box.size[b])[None]
        local[..., axis] = sign * box.size[axis] / 2
        normal = np.zeros(3)
        normal[axis] = sign
        points.append(local.reshape(-1, 3))
        normals.append(np.tile(normal, (3600, 1)))
    R = rotation_about(np.array([0.0, 0, 1]), box.yaw)
    at = apply(pose(box.center, R), np.concatenate(points))
    colors = np.zeros((len(at), 3), np.uint8)
    cloud = Cloud(at, np.concatenate(normals) @ R.T, colors)
    return Detection("a", "cabinet", 0.5, box, np.arange(len(at))), cloud


@pytest.mark.parametrize("yaw", [0.0, 0.7])
@pytest.mark.parametrize("faces", [(0,), (0, 1), (0, 1, 2, 3, 4)])
def test_the_share_is_the_area_of_the_faces_that_were_seen(faces, yaw: float) -> None:
    item, cloud = surface(UprightBox(np.array([1.0, 2.0, 0.5]), SIZE, yaw), faces)
    found = coverage(cloud, item, [])
    np.testing.assert_allclose(found.open, 1.0)
    np.testing.assert_allclose(found.seen, [k in faces for k in range(5)], atol=0.06)
    areas = [SIZE[1] * SIZE[2], SIZE[0] * SIZE[2]] * 2 + [SIZE[0] * SIZE[1]]
    np.testing.assert_allclose(found.areas, areas)
    assert found.share == pytest.approx(sum(areas[k] for k in faces) / sum(areas), abs=0.06)


def test_a_face_behind_a_neighbor_does_not_lower_the_coverage() -> None:
    item, cloud = surface(UprightBox(np.array([1.0, 2.0, 0.5]), SIZE), (0, 1, 3, 4))
    wall = UprightBox(np.array([1.0 - 0.3 - 0.05, 2.0, 1.0]), np.array([0.1, 4.0, 2.0]))
    assert coverage(cloud, item, []).share < 0.85
    assert coverage(cloud, item, [wall]).share > 0.95
    assert coverage(cloud, item, [wall]).open[2] == 0.0
    (known,) = with_coverage([item], cloud, [Detection("w", "wall", 1, wall, np.zeros(0, int))])
    assert known.seen == coverage(cloud, item, [wall]).share


def test_completed_points_belong_to_an_object_but_do_not_count_as_seen() -> None:
    item, cloud = surface(UprightBox(np.array([1.0, 2.0, 0.5]), SIZE), (0, 1))
    front, _ = surface(item.box, (0,))
    (known,) = with_coverage([item], cloud, [], measured=len(front.members))
    assert known.seen == coverage(cloud, front, []).share
    assert known.completed == pytest.approx(0.5)
    (known,) = with_coverage([item], cloud, [])
    assert known.completed == 0.0


def test_the_far_side_of_a_face_is_not_the_face() -> None:
    item, cloud = surface(UprightBox(np.array([1.0, 2.0, 0.5]), SIZE), (0,))
    inside = Cloud(cloud.points, -cloud.normals, cloud.colors)
    assert coverage(inside, item, []).share == 0.0
