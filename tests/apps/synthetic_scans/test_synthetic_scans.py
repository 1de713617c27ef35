"""Laws of synthetic scans: exact images match the geometry, noise is as stated, routes are free."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from jaxtyping import Float

from momapos.apps.synthetic_scans.depth_sensor import DepthSensor, drifting, sense
from momapos.apps.synthetic_scans.recording import SIZE, SyntheticScan, synthetic_scan, true_box
from momapos.apps.synthetic_scans.renderer import (
    RenderWorld,
    ear_clipped,
    join_worlds,
    look_at,
    moved_world,
    pinhole,
    render_backdrop,
    render_frame,
    render_world,
)
from momapos.core.geometry.transforms import apply, invert, pose
from momapos.model.records.scans import Frame
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_object import SceneObject
from momapos.model.urdf.articulated import Articulated
from momapos.model.urdf.reader import box_urdf

K = pinhole(SIZE, 560.0)


def a_box(
    name: str, size: tuple[float, float, float], xyz: tuple[float, float, float]
) -> SceneObject:
    return SceneObject(name, name, pose(xyz), Articulated(box_urdf(name, size)))


def a_room(*objects: SceneObject) -> Scene:
    return Scene("room", objects)


@pytest.fixture(scope="module")
def world(kitchen: Scene) -> RenderWorld:
    return render_world(kitchen, np.random.default_rng(0))


def world_points(frame: Frame, step: int = 1) -> Float[np.ndarray, "n 3"]:
    v, u = np.nonzero(frame.depth)
    v, u = v[::step], u[::step]
    rays = np.column_stack([u, v, np.ones(len(u))]) @ np.linalg.inv(frame.intrinsics).T
    return apply(frame.T_world_camera, rays * frame.depth[v, u][:, None])


def wall_ahead(distance: float) -> Frame:
    scene = a_room(a_box("wall", (0.2, 9.0, 9.0), (distance + 0.1, 0.0, 0.0)))
    world = render_world(scene, np.random.default_rng(0), floor=False)
    return render_frame(world, look_at(np.zeros(3), np.array([1.0, 0, 0])), K, SIZE)


def test_a_wall_at_two_meters_has_depth_two_everywhere() -> None:
    np.testing.assert_allclose(wall_ahead(2.0).depth, 2.0, atol=1e-4)


def test_a_slanted_box_has_the_depth_of_its_rays() -> None:
    box = SceneObject(
        "box", "box", look_at(np.array([2.0, 0.2, 0.1]), np.array([0.0, 0.7, 0.9])),
        Articulated(box_urdf("box", (0.8, 0.5, 0.6))),
    )  # fmt: skip
    world = render_world(a_room(box), np.random.default_rng(0), floor=False)
    frame = render_frame(world, look_at(np.zeros(3), np.array([2.0, 0.2, 0.1])), K, SIZE)
    assert frame.depth is not None
    rays = np.stack(np.meshgrid(np.arange(640), np.arange(480)), axis=-1).reshape(-1, 2)
    rays = np.column_stack([rays, np.ones(len(rays))]) @ np.linalg.inv(K).T
    T = invert(box.T_world_object) @ frame.T_world_camera
    with np.errstate(divide="ignore"):
        slabs = (np.array([-1, 1])[:, None, None] * np.array([0.8, 0.5, 0.6]) / 2 - T[:3, 3]) / (
            rays @ T[:3, :3].T
        )
    enter, leave = slabs.min(0).max(1), slabs.max(0).min(1)
    expected = np.where(enter < leave, enter, 0.0).reshape(480, 640)
    differs = np.abs(frame.depth - expected) > 1e-4
    # rays along an edge may hit either side
    assert differs.sum() <= 2
    assert (expected > 0).sum() > 20_000


def test_points_of_exact_frames_lie_on_the_surfaces_of_the_scene(
    kitchen: Scene, world: RenderWorld
) -> None:
    low, high = kitchen.object("fridge").bounds
    middle = (low + high) / 2
    frame = render_frame(world, look_at(middle + np.array([-0.7, -2.0, 0.4]), middle), K, SIZE)
    points = world_points(frame, step=97)
    mesh = trimesh.Trimesh(
        world.triangles.reshape(-1, 3), np.arange(3 * len(world.triangles)).reshape(-1, 3)
    )
    distance = trimesh.proximity.closest_point(mesh, points)[1]
    assert len(points) > 1000
    assert distance.max() < 1e-4


def test_nearer_surfaces_occlude_farther_ones() -> None:
    scene = a_room(
        a_box("near", (0.2, 0.4, 0.4), (1.1, 0, 0)), a_box("far", (0.2, 8, 8), (3.1, 0, 0))
    )
    world = render_world(scene, np.random.default_rng(0), floor=False)
    frame = render_frame(world, look_at(np.zeros(3), np.array([1.0, 0, 0])), K, SIZE)
    assert frame.depth[240, 320] == pytest.approx(1.0, abs=1e-4)
    assert frame.depth[20, 20] == pytest.approx(3.0, abs=1e-4)


def test_a_backdrop_leaves_images_and_depth_as_they_are(kitchen: Scene, world: RenderWorld) -> None:
    size = (160, 120)
    lens, aim = pinhole(size, 130.0), kitchen.object("fridge").bounds.mean(0)
    T = look_at(aim + np.array([-0.7, -2.0, 0.4]), aim)
    behind = render_backdrop(world, T, lens, size)
    box = render_world(a_room(a_box("box", (0.3, 0.3, 0.3), (0, 0, 0))), np.random.default_rng(0),
                       floor=False)  # fmt: skip
    joined = join_worlds(world, box)
    for shift in ((0.0, -0.7, 0.0), (0.3, -0.4, 0.2), (0.0, 0.1, 0.0), (0.0, -9.0, 0.0)):
        moved = moved_world(joined, box.triangles + aim + np.array(shift))
        plain, fast = (
            render_frame(moved, T, lens, size, backdrop=known) for known in (None, behind)
        )
        np.testing.assert_array_equal(plain.color, fast.color)
        np.testing.assert_array_equal(plain.depth, fast.depth)
        assert (fast.color != behind.color).any() == (shift[1] in (-0.7, -0.4))


def test_joint_values_move_the_rendered_parts(kitchen: Scene) -> None:
    joint = next(iter(kitchen.object("fridge").model.joints))
    opened = kitchen.with_joint("fridge", joint, kitchen.object("fridge").model.joint(joint).upper)
    boxes = [
        true_box(
            render_world(s, np.random.default_rng(0)),
            s.object("fridge"),
            s.objects.index(s.object("fridge")),
        )
        for s in (kitchen, opened)
    ]
    assert boxes[1].size.max() > 0
    assert np.prod(boxes[1].size) > 1.3 * np.prod(boxes[0].size)


def test_a_dark_seam_shows_between_two_doors() -> None:
    gap = 0.003
    doors = [
        a_box(f"cabinet_{k}", (0.02, 0.4, 0.7), (1.5, y, 0.0))
        for k, y in enumerate((-0.2 - gap / 2, 0.2 + gap / 2))
    ]
    back = a_box("cabinet_back", (0.02, 0.8, 0.7), (1.53, 0.0, 0.0))
    world = render_world(a_room(*doors, back), np.random.default_rng(0), floor=False)
    frame = render_frame(world, look_at(np.zeros(3), np.array([1.0, 0, 0])), K, SIZE)
    row = frame.color[200:280].astype(float).mean((0, 2))
    assert row[318:322].min() < 0.85 * min(np.median(row[290:310]), np.median(row[330:350]))


def test_an_outline_is_cut_into_triangles_of_the_same_area() -> None:
    outline = np.array([[0, 0], [4, 0], [4, 3], [2, 3], [2, 1], [1, 1], [1, 3], [0, 3.0]])
    for corners in (outline, outline[::-1]):
        a, b, c = np.moveaxis(corners[ear_clipped(corners)], 1, 0)
        ab, ac = b - a, c - a
        areas = (ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]) / 2
        assert (areas >= 0).all()
        assert areas.sum() == pytest.approx(4 * 3 - 1 * 2)


# ------------------------------------------------------------------------------------------- sensor


def test_depth_noise_on_a_plane_has_the_stated_deviation() -> None:
    exact = wall_ahead(2.0)
    found = sense(exact, np.random.default_rng(1)).depth
    stated = 2.0**2 * 0.08 / (560 * 0.05)
    seen = found[found > 0]
    assert (found > 0).mean() > 0.95
    assert np.std(seen) == pytest.approx(stated, rel=0.2)
    assert np.mean(seen) == pytest.approx(2.0, abs=0.002)
    error = np.where(found > 0, found - 2.0, 0.0)
    alike = (error[:, 100:-2] * error[:, 102:]).mean() / (error**2).mean()
    assert alike > 0.3


def test_depth_is_missing_left_of_nearer_surfaces_and_beyond_the_range() -> None:
    scene = a_room(
        a_box("near", (0.2, 0.4, 0.4), (1.1, 0, 0)), a_box("far", (0.2, 8, 8), (3.1, 0, 0))
    )
    world = render_world(scene, np.random.default_rng(0), floor=False)
    frame = render_frame(world, look_at(np.zeros(3), np.array([1.0, 0, 0])), K, SIZE)
    found = sense(frame, np.random.default_rng(2)).depth
    left, right = 320 - round(0.2 * 560), 320 + round(0.2 * 560)
    shadow = 560 * 0.05 * (1 / 1.0 - 1 / 3.0)
    missing = found[240] == 0
    assert missing[left - 40 : left].sum() == pytest.approx(shadow, abs=2.5)
    assert not missing[right + 2 : right + 40].any()
    far = sense(wall_ahead(6.5), np.random.default_rng(3)).depth
    assert (far > 0).mean() < 0.05


def test_surfaces_seen_at_a_grazing_angle_have_no_depth() -> None:
    sensor = DepthSensor()
    eye = np.array([0.0, 0.0, 0.8])
    ends = [a_box(f"end_{x}", (0.1, 0.1, 0.1), (x, 0, 0)) for x in (-1, 8)]
    world = render_world(a_room(*ends), np.random.default_rng(0))
    frame = render_frame(world, look_at(eye, np.array([2.5, 0.0, 0.0])), K, SIZE)
    noisy = sense(frame, np.random.default_rng(4), sensor)
    ray = world_points(frame) - eye
    floor = ray[:, 2] < -0.79
    angle = np.degrees(np.arccos(-ray[:, 2] / np.linalg.norm(ray, axis=1)))
    found = noisy.depth[frame.depth > 0] > 0
    assert not found[floor & (angle > sensor.grazing + 0.5)].any()
    assert found[floor & (angle < sensor.grazing - 0.5)].mean() > 0.99


def test_poses_drift_slowly_and_stay_rigid() -> None:
    sensor = DepthSensor()
    found = drifting(np.tile(np.eye(4), (4000, 1, 1)), np.random.default_rng(0), sensor)
    np.testing.assert_allclose(
        np.swapaxes(found[:, :3, :3], 1, 2) @ found[:, :3, :3],
        np.tile(np.eye(3), (4000, 1, 1)),
        atol=1e-12,
    )
    offset = found[:, :3, 3]
    assert offset.std() == pytest.approx(sensor.position, rel=0.2)
    assert np.diff(offset, axis=0).std() < 0.6 * offset.std()


# ------------------------------------------------------------------------------------------- route


@pytest.fixture(scope="module")
def scan(kitchen: Scene) -> SyntheticScan:
    return synthetic_scan(kitchen, frames=60, seed=0)


def test_the_camera_is_above_free_floor_and_sees_every_object(
    kitchen: Scene, scan: SyntheticScan
) -> None:
    assert len(scan.Ts_world_camera) == 60
    eyes = scan.Ts_world_camera[:, :3, 3]
    assert ((eyes[:, 2] >= 0.6) & (eyes[:, 2] <= 1.6)).all()
    for item in kitchen.objects:
        low, high = item.bounds
        if low[2] < 1.6:
            away = np.maximum(np.maximum(low[:2] - eyes[:, :2], eyes[:, :2] - high[:2]), 0.0)
            assert np.linalg.norm(away, axis=1).min() > 0.25, item.name
    xs, ys = (np.arange(0, 640, 8) - K[0, 2]) / 560, (np.arange(0, 480, 8) - K[1, 2]) / 560
    ids = np.stack([scan.world.trace(T, xs, ys)[1] for T in scan.Ts_world_camera])
    pixels = np.bincount(scan.world.owner[ids[ids >= 0]] + 1, minlength=len(kitchen.objects) + 1)
    assert (pixels[1:] > 0).all()


def test_the_whole_fridge_is_seen_frontally(kitchen: Scene, scan: SyntheticScan) -> None:
    item = kitchen.object("fridge")
    index = kitchen.objects.index(item)
    box = true_box(scan.world, item, index)
    joint = next(iter(item.model.joints))
    door = item.link_poses()[item.model.moved_by(joint)[0]][:2, 3] - box.center[:2]
    axes = np.array([[np.cos(box.yaw), np.sin(box.yaw)], [-np.sin(box.yaw), np.cos(box.yaw)]])
    corners = np.array(np.meshgrid(*[[-0.5, 0.5]] * 3)).reshape(3, -1).T * box.size
    corners[:, :2] = corners[:, :2] @ axes
    corners += box.center
    front = np.array([*(axes[1] * np.sign(axes[1] @ door)), 0.0])
    good = 0
    for T in scan.Ts_world_camera:
        pixels = apply(invert(T), corners) @ scan.intrinsics.T
        uv = pixels[:, :2] / pixels[:, 2:]
        whole = ((uv >= 0) & (uv <= np.array(SIZE) - 1)).all() and (pixels[:, 2] > 0).all()
        toward = T[:3, 3] - (box.center + front * box.size[1] / 2)
        good += bool(whole and front @ toward > np.cos(np.radians(15)) * np.linalg.norm(toward))
    assert good >= 3


def test_a_table_is_seen_from_above_more_than_once(kitchen: Scene, scan: SyntheticScan) -> None:
    low, high = kitchen.object("table").bounds
    steps = (np.arange(12) + 0.5) / 12
    x, y = (grid.ravel() for grid in np.meshgrid(*(low[:2] + steps[:, None] * (high - low)[:2]).T))
    top = np.column_stack([x, y, np.full(len(x), high[2])])
    views = np.zeros(len(top), int)
    for T in scan.Ts_world_camera:
        local = apply(invert(T), top)
        uv = local @ scan.intrinsics.T
        uv = np.rint(uv[:, :2] / uv[:, 2:]).astype(int)
        above = T[2, 3] - high[2] > np.sin(np.radians(20)) * np.linalg.norm(T[:3, 3] - top, axis=1)
        ahead = (local[:, 2] > 0) & (uv >= 0).all(1) & (uv < np.array(SIZE)).all(1)
        views += above & ahead
    assert np.mean(views >= 2) > 0.9


def frontal_views(scan_poses: np.ndarray, middle: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Return poses within 20 degrees of a normal whose images contain a point."""
    toward = scan_poses[:, :3, 3] - middle
    cosine = toward @ normal / np.linalg.norm(toward, axis=1)
    local = np.stack([apply(invert(T), middle[None])[0] for T in scan_poses])
    uv = local @ K.T
    uv = uv[:, :2] / uv[:, 2:]
    inside = (local[:, 2] > 0) & (uv > 0).all(1) & (uv < np.array(SIZE)).all(1)
    return scan_poses[inside & (cosine > np.cos(np.radians(20)))]


def test_a_long_row_is_seen_frontally_from_end_to_end() -> None:
    row = a_box("cabinet", (3.6, 0.6, 0.9), (0.0, 0.3, 0.45))
    scan = synthetic_scan(a_room(row), frames=20, seed=0)
    for x in (-1.6, 0.0, 1.6):
        place = np.array([x, 0.0, 0.45])
        assert len(frontal_views(scan.Ts_world_camera, place, np.array([0.0, -1.0, 0.0]))) >= 1


def test_the_camera_is_on_its_side_in_front_of_a_tall_object_in_a_narrow_place() -> None:
    fridge = a_box("fridge", (0.7, 0.7, 1.8), (0.0, 0.35, 0.9))
    counter = a_box("cabinet", (4.0, 0.6, 0.9), (0.0, -1.9, 0.45))
    scan = synthetic_scan(a_room(fridge, counter), frames=40, seed=0)
    views = frontal_views(scan.Ts_world_camera, np.array([0.0, 0.0, 0.9]), np.array([0, -1, 0]))
    on_its_side = np.abs(views[:, 2, 0]) > 0.9  # the image's long side points up
    assert on_its_side.sum() >= 2
