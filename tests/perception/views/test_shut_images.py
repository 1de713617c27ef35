"""Images in which open leaves are closed."""

from __future__ import annotations

import numpy as np

from momapos.core.geometry.transforms import apply, invert, pose
from momapos.model.records.open_leaf import OpenLeaf
from momapos.model.records.scans import Frame, Part
from momapos.perception.views.closed_images import close_in_frames, close_leaf, part_on

SIZE = (160, 120)
INTRINSICS = np.array([[120.0, 0.0, 79.5], [0.0, 120.0, 59.5], [0.0, 0.0, 1.0]])
RED, GREEN, GRAY = (200, 30, 30), (30, 200, 30), (90, 90, 90)
BACK = 1.0
"""Distance of the wall behind the front [m]."""


def open_door() -> OpenLeaf:
    """Return a door of 0.6 x 0.8 m in the plane y = 0, hinge at the left, open by 80 degrees."""
    corner = np.array([0.0, 0.0, 0.2])
    along, out = np.array([1.0, 0.0, 0.0]), np.array([0.0, -1.0, 0.0])
    return OpenLeaf(corner, along, out, (0.6, 0.8), corner, float(np.radians(80.0)), 0.02)


def looking(eye: tuple[float, float, float], at: tuple[float, float, float]) -> np.ndarray:
    """Return the pose of a camera."""
    z = np.array(at) - eye
    z = z / np.linalg.norm(z)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x = x / np.linalg.norm(x)
    return pose(np.array(eye), np.stack([x, np.cross(z, x), z], axis=1))


def picture(T: np.ndarray, leaf: OpenLeaf) -> Frame:
    """Render the open door, its outer face half red and half green, in front of a gray wall."""
    v, u = np.indices(SIZE[::-1])
    rays = np.stack([u, v, np.ones(u.shape)], -1) @ np.linalg.inv(INTRINSICS).T @ T[:3, :3].T
    eye = T[:3, 3]
    depth = (BACK - eye[1]) / rays[..., 1]
    depth = np.where(depth > 0.0, depth, 0.0)
    color = np.full((*u.shape, 3), GRAY, np.uint8)
    shut_eye = leaf.local(apply(leaf.T_closed_open, eye[None]))[0]
    R = np.stack([leaf.along, leaf.out, leaf.across]) @ leaf.T_closed_open[:3, :3]
    turned = rays @ R.T
    t = -shut_eye[1] / turned[..., 1]
    place = shut_eye + turned * t[..., None]
    on = (t > 0.0) & (t < np.where(depth > 0.0, depth, np.inf))
    on &= (place[..., 0] > 0.0) & (place[..., 0] < 0.6)
    on &= (place[..., 2] > 0.0) & (place[..., 2] < 0.8)
    color[on] = np.where((place[on][:, 0] < 0.3)[:, None], RED, GREEN)
    depth = np.where(on, t, depth).astype(np.float32)
    return Frame("frame", color, depth, INTRINSICS, T)


def test_the_closed_door_is_painted_over_its_opening() -> None:
    leaf = open_door()
    straight = picture(looking((0.3, -2.0, 0.6), (0.3, 0.0, 0.6)), leaf)
    outer = picture(looking((-1.5, -0.5, 0.6), (0.1, -0.3, 0.6)), leaf)
    shut = close_leaf(leaf, [straight, outer])
    assert shut.known.mean() > 0.8
    painted, _ = close_in_frames([straight, outer], [shut])
    assert painted.depth is not None
    assert straight.depth is not None
    for x, color in ((0.2, RED), (0.5, GREEN)):
        place = apply(invert(straight.T_world_camera), np.array([[x, 0.0, 0.6]]))[0]
        u, v = np.round((INTRINSICS @ place / place[2])[:2]).astype(int)
        np.testing.assert_allclose(painted.color[v, u], color, atol=12)
        np.testing.assert_allclose(painted.depth[v, u], place[2], atol=0.01)
        assert straight.depth[v, u] > place[2] + 0.5


def test_an_object_in_front_of_the_opening_stays() -> None:
    leaf = open_door()
    frame = picture(looking((-0.4, -1.5, 0.6), (0.2, 0.0, 0.6)), leaf)
    (painted,) = close_in_frames([frame], [close_leaf(leaf, [frame])])
    assert painted.depth is not None
    assert frame.depth is not None
    changed = (painted.color != frame.color).any(-1)
    assert changed.any()
    assert (painted.depth[changed] < frame.depth[changed]).all()
    assert (painted.depth <= frame.depth).all()


def test_an_image_from_behind_stays_unchanged() -> None:
    leaf = open_door()
    behind = picture(looking((0.3, 0.9, 0.6), (0.3, 0.0, 0.6)), leaf)
    (painted,) = close_in_frames([behind], [close_leaf(leaf, [behind])])
    assert painted is behind


def test_a_leaf_is_a_part_of_its_kind_and_size_with_its_detected_handle() -> None:
    leaf = open_door()
    outer = picture(looking((-1.5, -0.3, 0.6), (0.1, -0.3, 0.6)), leaf)
    shut = close_leaf(leaf, [outer])
    bare = part_on(leaf, shut, None)
    assert [(p.kind, p.box, p.handle) for p in bare.parts] == [
        ("door_left", (0.0, 0.0, 1.0, 1.0), None)
    ]
    np.testing.assert_allclose(bare.face.T_world_face[:3, 3], [0.3, 0.0, 0.6])
    assert (bare.face.width, bare.face.height) == (0.6, 0.8)
    seen = Part("door_right", (0.0, 0.0, 1.0, 1.0), 0.7, handle=(0.9, 0.4, 0.95, 0.6))
    (held,) = part_on(leaf, shut, seen).parts
    assert held.kind == "door_left"
    assert held.handle is not None
    assert held.handle[0] > 0.8
