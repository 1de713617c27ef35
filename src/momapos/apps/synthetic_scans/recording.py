"""Plan the route of a scan, and render it into posed frames with the ground truth."""

from __future__ import annotations

import json
import os
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.spatial.transform import Rotation

from momapos.core import InputError, SceneError, in_threads, require, temporary_folder
from momapos.core.geometry import UprightBox, apply, contains, invert, pose, upright_frame
from momapos.model.records import Frame
from momapos.model.scene import Scene, SceneObject

from .depth_sensor import DepthSensor, drifting, sense
from .renderer import FLOOR_MARGIN, RenderWorld, look_at, pinhole, render_frame, render_world

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int


CELL = 0.05
"""Cell size of the floor grid [m]."""
CLEARANCE = 0.35
"""Minimum distance of a person from obstacles [m]."""
STANDING_HEIGHT, CROUCHING_HEIGHT = (1.2, 1.6), (0.6, 0.8)
"""Ranges of the camera height [m]."""
MIN_DISTANCE, MAX_DISTANCE = 0.8, 2.5
"""Range of the distance from the camera to its target [m]."""
OBSTACLE_HEIGHTS = (0.1, 1.9)
"""Heights in which an object blocks a person [m]."""
MIN_FRONTAL_COSINE = np.cos(np.radians(15.0))
"""Minimum cosine between a face's normal and the direction to the camera for a frontal view [-]."""
MIN_GOOD_VIEWS = 3
"""A face with fewer good views also accepts its next best ones [-]."""
GRID = 7
"""Points along each edge of a face [-]."""
MIN_FACE_SIZE = 0.2
"""Smaller faces have no door that needs a frontal view [m]."""
MAX_FACE_WIDTH = 1.3
"""Wider faces are split, because a long row does not fit into an image [m]."""
MAX_FACE_DEPTH = 0.2
"""A surface farther behind a face, such as below a table, is not the face [m]."""
MIN_VISIBLE_SHARE = 0.75
"""Minimum share of visible points of a face in a good view [-]; handles may hide some."""
FACE_WEIGHT = 400.0
"""Weight of a frontal view of a face, in points [-]."""
POINT_DECAY, FACE_DECAY = 0.45, 0.75
"""Factor on the weight of a point or face after each view [-]."""
POINTS = 3000
"""Number of points on all surfaces [-]."""
TOP_HEIGHTS = (0.3, 1.3)
"""Heights of the tops of tables and counters [m]."""
TOP_POINTS = 100
"""Points per area of a top [1/m^2]."""
TOP_WEIGHT = 4.0
"""Weight of a point on a top, in points: a square meter weighs as much as a face [-]."""
MIN_TOP_SINE = np.sin(np.radians(20.0))
"""Minimum sine of the viewing angle to a top [-]; depth fails at grazing angles."""
CROUCHING_SHARE = 0.15
"""Share of the random poses with a crouching person [-]."""
RANDOM_POSES, FACE_POSES = 500, 36
"""Candidates at random, and maximum number of candidates in front of each face [-]."""
DRAWS_PER_POSE = 5
"""Draws per candidate in front of a face; in narrow places few are on free floor [-]."""
PORTRAIT_SHARE = 0.5
"""Share of the candidates in front of a tall face with the camera on its side [-]."""
REDUCTION = 8
"""Reduction factor of the images in which visibility is checked [-]."""


@dataclass(frozen=True, eq=False)
class _FreeFloor:
    """Cells of a floor grid where a person can stand."""

    corner: Float[np.ndarray, "2"]
    free: Bool[np.ndarray, "nx ny"]

    def contains(self, xy: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, " n"]:
        cell = np.floor((xy - self.corner) / CELL).astype(int)
        inside = ((cell >= 0) & (cell < self.free.shape)).all(1)
        cell = np.clip(cell, 0, np.array(self.free.shape) - 1)
        return inside & self.free[cell[:, 0], cell[:, 1]]

    def places(self) -> Float[np.ndarray, "n 2"]:
        return self.corner + (np.argwhere(self.free) + 0.5) * CELL


@dataclass(frozen=True, eq=False)
class _Faces:
    """Upright sides of the bounding boxes of objects."""

    center: Float[np.ndarray, "f 3"]
    normal: Float[np.ndarray, "f 3"]
    size: Float[np.ndarray, "f 2"]
    """Width and height [m]."""
    points: Float[np.ndarray, "f p 3"]
    """A grid on each face, followed by its four corners."""


def scan_route(
    scene: Scene,
    world: RenderWorld,
    count: int,
    rng: np.random.Generator,
    *,
    focal: float = 560.0,
    size: tuple[int, int] = (640, 480),
) -> Float[np.ndarray, "n 4 4"]:
    """Choose camera poses that show every surface, tops from above, and every face frontally.

    The greedy choice takes the candidate with the largest weight of visible points and faces, and
    then lowers their weights. The order of the poses is that of a walk.

    Args:
        scene: The scene.
        world: Triangles of the scene.
        count: Number of poses.
        rng: Draws the candidates.
        focal: Focal length [px].
        size: Width and height of the images [px].

    Returns:
        Camera to world, axes as in OpenCV.

    Raises:
        SceneError: There is no free floor.
    """
    floor = free_floor(scene, world)
    if not floor.free.any():
        raise SceneError(
            f"{scene.path}: no free floor to scan from, at least {CLEARANCE:g} m from all objects"
        )
    faces = _faces(scene)
    points = np.concatenate([_surface_points(world, scene, rng), _top_points(world, rng)])
    scale = 1.1 * focal / np.array(size)
    candidates = _candidates(floor, faces, points, scale, rng)
    K = pinhole((size[0] // REDUCTION, size[1] // REDUCTION), focal / REDUCTION)
    seen, frontal = _views(world, candidates, K, points, faces)
    return _as_walk(candidates[_choose(seen, frontal, count)])


def free_floor(scene: Scene, world: RenderWorld) -> _FreeFloor:
    """Return the part of the floor where a person can stand."""
    if scene.floor_polygon is not None:
        low, high = scene.floor_polygon.min(0), scene.floor_polygon.max(0)
    else:
        corners = world.triangles[world.owner >= 0].reshape(-1, 3)[:, :2]
        corners = corners if len(corners) else np.zeros((1, 2))
        low, high = corners.min(0) - FLOOR_MARGIN, corners.max(0) + FLOOR_MARGIN
    count = np.maximum(np.ceil((high - low) / CELL).astype(int), 1)
    # The cells around the floor are blocked, to keep clear of its border too.
    free = np.ones(count + 2, bool)
    corner = low - CELL
    if scene.floor_polygon is not None:
        centers = corner + (np.argwhere(free) + 0.5) * CELL
        free = contains(scene.floor_polygon, centers).reshape(free.shape)
    free[[0, -1]] = free[:, [0, -1]] = False
    for item in scene.objects:
        for name, T in item.link_poses().items():
            for hull in item.model.hulls[name]:
                body = apply(T, hull.vertices)
                if (
                    body[:, 2].max() > OBSTACLE_HEIGHTS[0]
                    and body[:, 2].min() < OBSTACLE_HEIGHTS[1]
                ):
                    first = np.floor((body[:, :2].min(0) - corner) / CELL).astype(int)
                    last = np.floor((body[:, :2].max(0) - corner) / CELL).astype(int) + 1
                    (i, j), (m, n) = np.maximum(first, 0), np.maximum(last, 0)
                    free[i:m, j:n] = False
    return _FreeFloor(corner, distance_transform_edt(free) * CELL > CLEARANCE)


def _faces(scene: Scene) -> _Faces:
    """Return the upright sides of all objects except walls that are large enough for a door."""
    centers, normals, sizes, points = [], [], [], []
    along = (np.arange(GRID) + 0.5) / GRID - 0.5
    corners = np.array([[-0.5, -0.5, 0.5, 0.5], [-0.5, 0.5, -0.5, 0.5]])
    across, up = np.concatenate([np.reshape(np.meshgrid(along, along), (2, -1)), corners], axis=1)
    for item in scene.objects:
        if item.category == "wall":
            continue
        T = item.box_proxy.T_world_object
        half = np.array(item.box_proxy.model.urdf.links["box"].visuals[0].size) / 2
        for axis, side in ((0, 1), (0, -1), (1, 1), (1, -1)):
            if 2 * min(half[1 - axis], half[2]) < MIN_FACE_SIZE:
                continue
            count = int(np.ceil(2 * half[1 - axis] / MAX_FACE_WIDTH))
            width = 2 * half[1 - axis] / count
            for k in range(count):
                middle = np.zeros(3)
                middle[axis], middle[1 - axis] = side * half[axis], (k - (count - 1) / 2) * width
                local = np.tile(middle, (len(across), 1))
                local[:, 1 - axis] += width * across
                local[:, 2] += 2 * half[2] * up
                centers.append(apply(T, middle[None])[0])
                normals.append(side * T[:3, axis])
                sizes.append((width, 2 * half[2]))
                points.append(apply(T, local))
    return _Faces(
        np.reshape(centers, (-1, 3)),
        np.reshape(normals, (-1, 3)),
        np.reshape(sizes, (-1, 2)),
        np.reshape(points, (-1, len(across), 3)),
    )


def _surface_points(
    world: RenderWorld, scene: Scene, rng: np.random.Generator
) -> Float[np.ndarray, "n 3"]:
    """Sample points on the objects, and fewer on floor and walls."""
    area = _areas(world.triangles)
    shell = np.array([item.category == "wall" for item in scene.objects] + [True])[world.owner]
    weight = np.where(shell, 0.15 * area, area)
    picked = rng.choice(len(area), POINTS, p=weight / weight.sum())
    return _spread(world.triangles[picked], rng)


def _top_points(world: RenderWorld, rng: np.random.Generator) -> Float[np.ndarray, "n 3"]:
    """Sample points on upward surfaces at the heights of tables and counters."""
    height = world.triangles[:, :, 2].mean(axis=1)
    flat = (world.normals[:, 2] > 0.9) & (height > TOP_HEIGHTS[0]) & (height < TOP_HEIGHTS[1])
    flat &= world.owner >= 0
    if not flat.any():
        return np.zeros((0, 3))
    area = _areas(world.triangles[flat])
    count = int(np.ceil(TOP_POINTS * area.sum()))
    picked = rng.choice(np.flatnonzero(flat), count, p=area / area.sum())
    return _spread(world.triangles[picked], rng)


def _areas(triangles: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, " n"]:
    a, b, c = np.moveaxis(triangles, 1, 0)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


def _spread(
    triangles: Float[np.ndarray, "n 3 3"], rng: np.random.Generator
) -> Float[np.ndarray, "n 3"]:
    """Sample one point uniformly in each triangle."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    u, v = rng.random((2, len(triangles), 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    return a + u * (b - a) + v * (c - a)


def _candidates(
    floor: _FreeFloor,
    faces: _Faces,
    points: Float[np.ndarray, "n 3"],
    scale: Float[np.ndarray, "2"],
    rng: np.random.Generator,
) -> Float[np.ndarray, "c 4 4"]:
    """Draw poses on free floor that look at random points, and frontally at faces.

    `scale` is the distance at which a face fits into the image per width and height of the face.
    """
    places = floor.places()
    xy = places[rng.integers(len(places), size=4 * RANDOM_POSES)]
    target = points[rng.integers(len(points), size=len(xy))]
    distance = np.linalg.norm(target[:, :2] - xy, axis=1)
    good = np.flatnonzero((distance > MIN_DISTANCE) & (distance < MAX_DISTANCE))
    good = good[:RANDOM_POSES] if len(good) else np.arange(RANDOM_POSES)
    crouched = rng.random(len(good)) < CROUCHING_SHARE
    crouching = rng.uniform(*CROUCHING_HEIGHT, len(good))
    standing = rng.uniform(*STANDING_HEIGHT, len(good))
    height = np.where(crouched, crouching, standing)
    eyes, targets = np.column_stack([xy[good], height]), target[good]
    face = np.repeat(np.arange(len(faces.center)), DRAWS_PER_POSE * FACE_POSES)
    tall = (faces.size[:, 1] > faces.size[:, 0])[face] & (rng.random(len(face)) < PORTRAIT_SHARE)
    size = np.where(tall[:, None], faces.size[face, ::-1], faces.size[face])
    fits = np.maximum((size * scale).max(1), MIN_DISTANCE)
    low, high = np.maximum(0.6 * fits, MIN_DISTANCE), np.maximum(1.2 * fits, MAX_DISTANCE)
    out = low + rng.random(len(face)) * (high - low)
    normal, middle = faces.normal[face], faces.center[face]
    side = np.tan(rng.uniform(-0.2, 0.2, len(face))) * out
    across = np.stack([-normal[:, 1], normal[:, 0], 0 * side], axis=1)
    front = middle + out[:, None] * normal + side[:, None] * across
    front[:, 2] = np.clip(
        middle[:, 2] + rng.uniform(-0.15, 0.25, len(face)), CROUCHING_HEIGHT[0], STANDING_HEIGHT[1]
    )
    possible = floor.contains(front[:, :2]).reshape(-1, DRAWS_PER_POSE * FACE_POSES)
    stands = (possible & (np.cumsum(possible, axis=1) <= FACE_POSES)).ravel()
    eyes = np.concatenate([eyes, front[stands]])
    targets = np.concatenate([targets, middle[stands]])
    targets = targets + rng.normal(0, 0.05, targets.shape)
    roll = np.radians(rng.normal(0, 1.5, len(eyes)))
    roll[len(good) :] += np.where(tall[stands], np.pi / 2, 0.0)
    return np.stack([look_at(e, t, r) for e, t, r in zip(eyes, targets, roll, strict=True)])


def _views(
    world: RenderWorld,
    Ts_world_camera: Float[np.ndarray, "c 4 4"],
    K: Float[np.ndarray, "3 3"],
    points: Float[np.ndarray, "n 3"],
    faces: _Faces,
) -> tuple[Bool[np.ndarray, "c n"], Bool[np.ndarray, "c f"]]:
    """Return the points that each camera sees, and the faces that it sees frontally.

    The points after the first `POINTS` are on tops, and must be seen from above.
    """
    width, height = np.rint(2 * K[:2, 2] + 1).astype(int)
    xs, ys = (np.arange(width) - K[0, 2]) / K[0, 0], (np.arange(height) - K[1, 2]) / K[1, 1]
    corners = faces.points.reshape(-1, 3)
    both = np.concatenate([points, corners])
    count, tops = len(points), points[POINTS:]
    seen = np.zeros((len(Ts_world_camera), count), bool)
    whole = np.zeros((len(Ts_world_camera), len(faces.center)), bool)
    share = np.zeros(whole.shape)
    for k, T in enumerate(Ts_world_camera):
        inverse, _ = world.trace(T, xs, ys)
        visible, inside, solid = _visible(inverse, apply(invert(T), both), K)
        seen[k] = visible[:count]
        up = T[2, 3] - tops[:, 2]
        seen[k, POINTS:] &= up > MIN_TOP_SINE * np.linalg.norm(T[:3, 3] - tops, axis=1)
        toward = T[:3, 3] - faces.center
        toward /= np.linalg.norm(toward, axis=1, keepdims=True)
        frontal = (toward * faces.normal).sum(1) > MIN_FRONTAL_COSINE
        whole[k] = inside[count:].reshape(faces.points.shape[:2]).all(1)
        surface = (visible & solid)[count:].reshape(faces.points.shape[:2])
        share[k] = frontal * surface[:, :-4].mean(1)
    return seen, _frontal(whole, share)


def _frontal(
    whole: Bool[np.ndarray, "c f"], share: Float[np.ndarray, "c f"]
) -> Bool[np.ndarray, "c f"]:
    """Return the good views of each face; with too few of them, the best ones.

    Args:
        whole: Whether the whole face is in the image.
        share: Share of the face that is visible frontally.
    """
    good = whole & (share > MIN_VISIBLE_SHARE)
    scarce = good.sum(0) < MIN_GOOD_VIEWS
    best = share[:, scarce].max(0, initial=0.0)
    good[:, scarce] |= (share[:, scarce] > 0.9 * best) & (best > MIN_VISIBLE_SHARE / 2)
    return good


def _visible(
    inverse: Float[np.ndarray, "h w"], points: Float[np.ndarray, "n 3"], K: Float[np.ndarray, "3 3"]
) -> tuple[Bool[np.ndarray, " n"], Bool[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """Check points in the camera's frame: visible, in the image, with a surface close behind."""
    height, width = inverse.shape
    ahead = points[:, 2] > 0.05
    z = np.where(ahead, points[:, 2], 1.0)
    u = np.floor(points[:, 0] / z * K[0, 0] + K[0, 2] + 0.5).astype(int)
    v = np.floor(points[:, 1] / z * K[1, 1] + K[1, 2] + 0.5).astype(int)
    inside = ahead & (u >= 0) & (u < width) & (v >= 0) & (v < height)
    found = inverse[np.clip(v, 0, height - 1), np.clip(u, 0, width - 1)]
    # Tolerance of 10 cm: fronts lie a few centimeters behind their box, and pixels are large here.
    visible = inside & (found * (z - 0.1) < 1) & (z < 4.0)
    return visible, inside, found * (z + MAX_FACE_DEPTH) > 1


def _choose(
    seen: Bool[np.ndarray, "c n"], frontal: Bool[np.ndarray, "c f"], count: int
) -> Int[np.ndarray, " k"]:
    """Choose candidates greedily by the weight of what they show."""
    views, fronts = seen.astype(np.float32), frontal.astype(np.float32)
    points, faces = np.ones(seen.shape[1]), np.full(frontal.shape[1], FACE_WEIGHT)
    points[POINTS:] = TOP_WEIGHT
    unused = np.ones(len(seen), bool)
    chosen = []
    for _ in range(count):
        gain = views @ points + fronts @ faces
        best = int(np.argmax(np.where(unused, gain, -1.0)))
        chosen.append(best)
        unused[best] = unused.sum() == 1
        points[seen[best]] *= POINT_DECAY
        faces[frontal[best]] *= FACE_DECAY
    return np.array(chosen)


def _as_walk(Ts: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "n 4 4"]:
    """Order poses so that each is near the previous one, in position and direction."""
    views = np.concatenate([Ts[:, :3, 3], 0.7 * Ts[:, :3, 2]], axis=1)
    order, left = [0], list(range(1, len(Ts)))
    while left:
        distance = np.linalg.norm(views[left] - views[order[-1]], axis=1)
        order.append(left.pop(int(np.argmin(distance))))
    return Ts[order]


FORMAT, VERSION = "momapos-scan-truth", 1
SIZE = (640, 480)
FOCALS = (525.0, 600.0)
"""Range of focal lengths [px]; each scan draws one."""
MAX_FRAMES = 10_000
MAX_THREADS = 4
"""Maximum number of threads that render [-]."""


@dataclass(frozen=True, eq=False)
class SyntheticScan:
    """A scan to render, with its ground truth."""

    scene: Scene
    world: RenderWorld
    intrinsics: Float[np.ndarray, "3 3"]
    Ts_world_camera: Float[np.ndarray, "n 4 4"]
    """True poses in the scene's world."""
    Ts_scan_camera: Float[np.ndarray, "n 4 4"]
    """Estimated poses in the scan's world."""
    T_scan_scene: Float[np.ndarray, "4 4"]
    """From the scene's world to the scan's; identity unless tilted."""
    sensor: DepthSensor | None
    """Errors of the camera; None for perfect frames."""
    seed: int

    def frame(self, index: int) -> Frame:
        """Render one frame with its pose in the scan's world; repeated calls return the same."""
        name = f"frame-{index:06d}"
        exact = render_frame(self.world, self.Ts_world_camera[index], self.intrinsics, SIZE, name)
        if self.sensor is not None:
            exact = sense(exact, np.random.default_rng((self.seed, 2, index)), self.sensor)
        return replace(exact, T_world_camera=self.Ts_scan_camera[index])

    def frames(self) -> Iterator[Frame]:
        """Render all frames in order, in parallel."""
        yield from in_threads(self.frame, range(len(self.Ts_scan_camera)), MAX_THREADS)


def synthetic_scan(
    scene: Scene,
    *,
    frames: int = 60,
    seed: int = 0,
    sensor: DepthSensor | None = None,
    tilt: bool = False,
) -> SyntheticScan:
    """Plan a scan of a scene.

    Args:
        scene: The room.
        frames: Number of images.
        seed: Seed of materials, route and noise.
        sensor: Errors of the camera; None for perfect frames.
        tilt: Rotate the world of the scan at random, so that its z axis is not up.

    Raises:
        InputError: The number of frames or the seed is out of range.
        SceneError: There is no free floor for the camera.
        UrdfError: A mesh can't be read.
    """
    if not 1 <= frames <= MAX_FRAMES:
        raise InputError(f"frames must be between 1 and {MAX_FRAMES}, not {frames}")
    if seed < 0:
        raise InputError(f"seed must be at least 0, not {seed}")
    # The name makes rooms with equal seeds look different.
    rng = np.random.default_rng((seed, 1, zlib.crc32(scene.name.encode())))
    world = render_world(scene, rng)
    focal = round(float(rng.uniform(*FOCALS)), 1)
    Ts = scan_route(scene, world, frames, rng, focal=focal, size=SIZE)
    estimated = Ts if sensor is None else drifting(Ts, rng, sensor)
    T = pose((0, 0, 0), Rotation.random(rng=rng).as_matrix()) if tilt else np.eye(4)
    return SyntheticScan(scene, world, pinhole(SIZE, focal), Ts, T @ estimated, T, sensor, seed)


def truth(scan: SyntheticScan) -> dict[str, Any]:
    """Return the ground truth as plain values [m], [rad], with boxes in the scene's world."""
    return {
        "format": FORMAT,
        "version": VERSION,
        "scene": None if scan.scene.path is None else str(scan.scene.path),
        "T_scan_scene": scan.T_scan_scene.tolist(),
        "objects": [_true_object(scan, k) for k in range(len(scan.scene.objects))],
    }


def true_box(world: RenderWorld, item: SceneObject, number: int) -> UprightBox:
    """Return the upright box around an object's triangles, with the object's yaw."""
    R = upright_frame(item.T_world_object[:3, :3])
    local = world.triangles[world.owner == number].reshape(-1, 3) @ R
    if not len(local):
        return UprightBox(item.T_world_object[:3, 3].copy(), np.zeros(3))
    low, high = local.min(0), local.max(0)
    return UprightBox(R @ ((low + high) / 2), high - low, float(np.arctan2(R[1, 0], R[0, 0])))


def _true_object(scan: SyntheticScan, number: int) -> dict[str, Any]:
    item = scan.scene.objects[number]
    box = true_box(scan.world, item, number)
    values = item.values()
    joints = {
        name: {
            "kind": joint.kind,
            "value": values[name],
            "lower": joint.lower if np.isfinite(joint.lower) else None,
            "upper": joint.upper if np.isfinite(joint.upper) else None,
        }
        for name, joint in item.model.joints.items()
    }
    return {
        "name": item.name,
        "category": item.category,
        "center": box.center.tolist(),
        "size": box.size.tolist(),
        "yaw": box.yaw,
        "joints": joints,
    }


def refuse_used(folder: Path) -> None:
    """Check that a scan can be written to a folder.

    Raises:
        SceneError: The folder is not empty, or is a file.
    """
    try:
        if folder.is_dir():
            if any(folder.iterdir()):
                raise SceneError(f"{folder}: is not empty; choose a new folder for the scan")
        elif folder.exists():
            raise SceneError(f"{folder}: is a file; choose a new folder for the scan")
    except OSError as error:
        raise SceneError(f"{folder}: cannot be looked up ({error.strerror})") from error


def write_scan(
    scan: SyntheticScan, folder: Path, report: Callable[[float], None] = lambda _: None
) -> None:
    """Render a scan into a folder in the layout of 7-Scenes; write all of it or nothing.

    Args:
        scan: The scan.
        folder: A new or empty folder.
        report: Called with the finished share.

    Raises:
        SceneError: The folder is not empty or can't be written.
        MissingExtraError: Pillow is not installed.
    """
    with require("scan"):
        import PIL.Image  # noqa: F401 - fails before anything is rendered
    refuse_used(folder)
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with temporary_folder(folder.parent, folder.name) as partial:
            np.savetxt(partial / "camera-intrinsics.txt", scan.intrinsics)
            (partial / "truth.json").write_text(json.dumps(truth(scan), indent=1) + "\n")
            jobs = range(len(scan.Ts_scan_camera))
            written = in_threads(lambda k: _write(scan.frame(k), partial), jobs, MAX_THREADS)
            for done, _ in enumerate(written, 1):
                report(done / len(jobs))
            os.replace(partial, folder)
    except OSError as error:
        raise SceneError(f"{folder}: cannot be written ({error.strerror})") from error


def _write(frame: Frame, folder: Path) -> None:
    from PIL import Image

    assert frame.depth is not None
    millimeters = np.clip(np.rint(1000 * frame.depth), 0, 65535).astype(np.uint16)
    stem = folder / frame.name
    Image.fromarray(frame.color).save(f"{stem}.color.jpg", quality=95)
    Image.fromarray(millimeters).save(f"{stem}.depth.png", compress_level=3)
    np.savetxt(f"{stem}.pose.txt", frame.T_world_camera)
