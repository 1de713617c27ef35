"""Where somebody stands who scans a room, and what they look at."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import distance_transform_edt

from momapos.core import SceneError
from momapos.core.geometry import apply, contains, invert
from momapos.model.scene import Scene

from .renderer import FLOOR_MARGIN, RenderWorld, look_at, pinhole

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

CELL = 0.05  # [m] of the grid of places to stand
CLEARANCE = 0.35
"""A person keeps this far from what stands on the floor [m]."""
HIGH, LOW = (1.2, 1.6), (0.6, 0.8)
"""Heights of the camera, in the hand and while crouching [m]."""
NEAR, FAR = 0.8, 2.5
"""Distance to what is looked at [m]."""
BLOCKS = (0.1, 1.9)
"""What reaches into these heights stops a person [m]."""
STRAIGHT = np.cos(np.radians(15.0))
"""A face is seen straight on where the camera is this close to its normal."""
TIMES = 3
"""With fewer good views of a front than this, the next best will do [-]."""
GRID = 7
"""Points along each edge of a face that are looked for [-]."""
FRONT = 0.2
"""Faces less wide or high than this have no door to be seen straight on [m]."""
STRETCH = 1.3
"""Wider faces are looked at stretch by stretch [m]: a long row does not fit into an image."""
SOLID = 0.2
"""What is seen farther than this behind a face is not it: a table's side is open [m]."""
WHOLE = 0.75
"""A face counts as seen when this share of its points is [-]; handles may hide some."""
FRONT_WORTH = 400.0
"""What a front seen straight on is worth in single points [-]."""
FADING, FADING_FRONT = 0.45, 0.75
"""What points and fronts are worth that were seen once already [-]."""
POINTS = 3000
TOPS = (0.3, 1.3)
"""Heights of the tops that a person looks down on [m]."""
TOP_POINTS = 100
"""Points on each square meter of such a top [1/m2]."""
TOP_WORTH = 4.0
"""What each of them is worth in single points: a square meter is worth as much as a front [-]."""
STEEP = np.sin(np.radians(20.0))
"""A top is seen where the eye is at least this far above its plane: depth fails at a graze."""
CROUCHED = 0.15
"""Share of the random poses that are low [-]."""
RANDOM, AIMED = 500, 36
"""Poses that are tried: at random, and in front of each face at most [-]."""
DRAWN = 5
"""So many times more are drawn before a face: in narrow places few are on free floor [-]."""
UPRIGHT = 0.5
"""Share of the poses before what is higher than wide in which the camera is on its side [-]."""
REDUCED = 8
"""Visibility is looked up in images that are smaller by this factor [-]."""


@dataclass(frozen=True, eq=False)
class _Room:
    """Where one may stand: cells of a grid on the floor."""

    corner: Float[np.ndarray, "2"]
    free: Bool[np.ndarray, "nx ny"]

    def stands(self, xy: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, " n"]:
        cell = np.floor((xy - self.corner) / CELL).astype(int)
        inside = ((cell >= 0) & (cell < self.free.shape)).all(1)
        cell = np.clip(cell, 0, np.array(self.free.shape) - 1)
        return inside & self.free[cell[:, 0], cell[:, 1]]

    def places(self) -> Float[np.ndarray, "n 2"]:
        return self.corner + (np.argwhere(self.free) + 0.5) * CELL


@dataclass(frozen=True, eq=False)
class _Faces:
    """Upright sides of the boxes around things."""

    center: Float[np.ndarray, "f 3"]
    normal: Float[np.ndarray, "f 3"]
    size: Float[np.ndarray, "f 2"]
    """Width and height [m]."""
    points: Float[np.ndarray, "f p 3"]
    """A grid on each face, and after it the four corners."""


def scan_route(
    scene: Scene,
    world: RenderWorld,
    count: int,
    rng: np.random.Generator,
    *,
    focal: float = 560.0,
    size: tuple[int, int] = (640, 480),
) -> Float[np.ndarray, "n 4 4"]:
    """Choose camera poses that show every surface, tops from above, and every front straight on.

    Of many poses where a person can stand, the one that shows most of what was seen least is taken
    again and again; the order is then that of a walk.

    Args:
        scene: The room.
        world: The same as triangles.
        count: Number of poses.
        rng: Chooses the poses that are tried.
        focal: Focal length [px].
        size: Width and height of the images [px].

    Returns:
        Camera to world, axes as in OpenCV.

    Raises:
        SceneError: There is no free floor to stand on.
    """
    room = free_floor(scene, world)
    if not room.free.any():
        raise SceneError(
            f"{scene.path}: there is no free floor to scan from, {CLEARANCE:g} m from all things"
        )
    faces = _faces(scene)
    points = np.concatenate([_surface_points(world, scene, rng), _top_points(world, rng)])
    needed = 1.1 * focal / np.array(size)
    tried = _candidates(room, faces, points, needed, rng)
    K = pinhole((size[0] // REDUCED, size[1] // REDUCED), focal / REDUCED)
    seen, straight = _views(world, tried, K, points, faces)
    return _as_walk(tried[_choose(seen, straight, count)])


def free_floor(scene: Scene, world: RenderWorld) -> _Room:
    """The part of the floor where a person can stand."""
    used = world.owner >= 0
    spots = world.triangles[used].reshape(-1, 3)
    spots = spots if len(spots) else np.zeros((1, 3))
    low, high = spots[:, :2].min(0) - FLOOR_MARGIN, spots[:, :2].max(0) + FLOOR_MARGIN
    if scene.floor_polygon is not None:
        low, high = scene.floor_polygon.min(0), scene.floor_polygon.max(0)
    count = np.maximum(np.ceil((high - low) / CELL).astype(int), 1)
    # one cell around the floor is never free, so that its border is kept clear of too
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
                if body[:, 2].max() > BLOCKS[0] and body[:, 2].min() < BLOCKS[1]:
                    first = np.floor((body[:, :2].min(0) - corner) / CELL).astype(int)
                    last = np.floor((body[:, :2].max(0) - corner) / CELL).astype(int) + 1
                    (i, j), (m, n) = np.maximum(first, 0), np.maximum(last, 0)
                    free[i:m, j:n] = False
    return _Room(corner, distance_transform_edt(free) * CELL > CLEARANCE)


def _faces(scene: Scene) -> _Faces:
    """Upright sides of everything but walls that are large enough for a door, in stretches."""
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
            if 2 * min(half[1 - axis], half[2]) < FRONT:
                continue
            count = int(np.ceil(2 * half[1 - axis] / STRETCH))
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
    """Points on the things of the room, and fewer on floor and walls."""
    a, b, c = np.moveaxis(world.triangles, 1, 0)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    room = np.array([item.category == "wall" for item in scene.objects] + [True])[world.owner]
    weight = np.where(room, 0.15 * area, area)
    picked = rng.choice(len(area), POINTS, p=weight / weight.sum())
    return _spread(world.triangles[picked], rng)


def _top_points(world: RenderWorld, rng: np.random.Generator) -> Float[np.ndarray, "n 3"]:
    """Points on what faces up at the height of tables and counters, evenly spread."""
    a, b, c = np.moveaxis(world.triangles, 1, 0)
    height = world.triangles[:, :, 2].mean(axis=1)
    flat = (world.normals[:, 2] > 0.9) & (height > TOPS[0]) & (height < TOPS[1])
    flat &= world.owner >= 0
    if not flat.any():
        return np.zeros((0, 3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)[flat] / 2
    count = int(np.ceil(TOP_POINTS * area.sum()))
    picked = rng.choice(np.flatnonzero(flat), count, p=area / area.sum())
    return _spread(world.triangles[picked], rng)


def _spread(
    triangles: Float[np.ndarray, "n 3 3"], rng: np.random.Generator
) -> Float[np.ndarray, "n 3"]:
    """One point in each triangle, evenly."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    u, v = rng.random((2, len(triangles), 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    return a + u * (b - a) + v * (c - a)


def _candidates(
    room: _Room,
    faces: _Faces,
    points: Float[np.ndarray, "n 3"],
    needed: Float[np.ndarray, "2"],
    rng: np.random.Generator,
) -> Float[np.ndarray, "c 4 4"]:
    """Poses on free floor: some look at a random point, some straight at a face.

    `needed` is the distance from which a face fits into the image, over its width and height.
    """
    places = room.places()
    xy = places[rng.integers(len(places), size=4 * RANDOM)]
    target = points[rng.integers(len(points), size=len(xy))]
    distance = np.linalg.norm(target[:, :2] - xy, axis=1)
    good = np.flatnonzero((distance > NEAR) & (distance < FAR))
    good = good[:RANDOM] if len(good) else np.arange(RANDOM)
    crouched = rng.random(len(good)) < CROUCHED
    height = np.where(crouched, rng.uniform(*LOW, len(good)), rng.uniform(*HIGH, len(good)))
    eyes, targets = np.column_stack([xy[good], height]), target[good]
    face = np.repeat(np.arange(len(faces.center)), DRAWN * AIMED)
    # What is higher than wide is often taken with the camera turned on its side.
    tall = (faces.size[:, 1] > faces.size[:, 0])[face] & (rng.random(len(face)) < UPRIGHT)
    size = np.where(tall[:, None], faces.size[face, ::-1], faces.size[face])
    fits = np.maximum((size * needed).max(1), NEAR)
    low, high = np.maximum(0.6 * fits, NEAR), np.maximum(1.2 * fits, FAR)
    out = low + rng.random(len(face)) * (high - low)
    normal, middle = faces.normal[face], faces.center[face]
    side = np.tan(rng.uniform(-0.2, 0.2, len(face))) * out
    across = np.stack([-normal[:, 1], normal[:, 0], 0 * side], axis=1)
    front = middle + out[:, None] * normal + side[:, None] * across
    front[:, 2] = np.clip(middle[:, 2] + rng.uniform(-0.15, 0.25, len(face)), LOW[0], HIGH[1])
    possible = room.stands(front[:, :2]).reshape(-1, DRAWN * AIMED)
    stands = (possible & (np.cumsum(possible, axis=1) <= AIMED)).ravel()
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
    """Which points each camera sees, and which faces it sees straight on.

    The points after the first `POINTS` are on tops, and are seen from above.
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
        seen[k, POINTS:] &= up > STEEP * np.linalg.norm(T[:3, 3] - tops, axis=1)
        toward = T[:3, 3] - faces.center
        toward /= np.linalg.norm(toward, axis=1, keepdims=True)
        straight = (toward * faces.normal).sum(1) > STRAIGHT
        whole[k] = inside[count:].reshape(faces.points.shape[:2]).all(1)
        surface = (visible & solid)[count:].reshape(faces.points.shape[:2])
        share[k] = straight * surface[:, :-4].mean(1)
    return seen, _frontal(whole, share)


def _frontal(
    whole: Bool[np.ndarray, "c f"], share: Float[np.ndarray, "c f"]
) -> Bool[np.ndarray, "c f"]:
    """Which views of a face are as good as the room allows.

    Args:
        whole: Whether the face is in the image as a whole.
        share: Part of it that is seen straight on.
    """
    good = whole & (share > WHOLE)
    scarce = good.sum(0) < TIMES
    best = share[:, scarce].max(0, initial=0.0)
    good[:, scarce] |= (share[:, scarce] > 0.9 * best) & (best > WHOLE / 2)
    return good


def _visible(
    inverse: Float[np.ndarray, "h w"], points: Float[np.ndarray, "n 3"], K: Float[np.ndarray, "3 3"]
) -> tuple[Bool[np.ndarray, " n"], Bool[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """Which points of the camera's frame nothing hides, which lie in the image, and which have
    a surface close behind them."""
    height, width = inverse.shape
    ahead = points[:, 2] > 0.05
    z = np.where(ahead, points[:, 2], 1.0)
    u = np.floor(points[:, 0] / z * K[0, 0] + K[0, 2] + 0.5).astype(int)
    v = np.floor(points[:, 1] / z * K[1, 1] + K[1, 2] + 0.5).astype(int)
    inside = ahead & (u >= 0) & (u < width) & (v >= 0) & (v < height)
    found = inverse[np.clip(v, 0, height - 1), np.clip(u, 0, width - 1)]
    # fronts lie behind their handles' box by some centimeters, and pixels here are large
    return inside & (found * (z - 0.1) < 1) & (z < 4.0), inside, found * (z + SOLID) > 1


def _choose(
    seen: Bool[np.ndarray, "c n"], straight: Bool[np.ndarray, "c f"], count: int
) -> Int[np.ndarray, " k"]:
    """Take what adds most, again and again."""
    views = seen.astype(np.float32)
    fronts = straight.astype(np.float32)
    worth, wanted = np.ones(seen.shape[1]), np.full(straight.shape[1], FRONT_WORTH)
    worth[POINTS:] = TOP_WORTH
    unused = np.ones(len(seen), bool)
    chosen = []
    for _ in range(count):
        gain = views @ worth + fronts @ wanted
        best = int(np.argmax(np.where(unused, gain, -1.0)))
        chosen.append(best)
        unused[best] = unused.sum() == 1
        worth[seen[best]] *= FADING
        wanted[straight[best]] *= FADING_FRONT
    return np.array(chosen)


def _as_walk(Ts: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "n 4 4"]:
    """Order poses so that each is near the one before, in place and direction."""
    what = np.concatenate([Ts[:, :3, 3], 0.7 * Ts[:, :3, 2]], axis=1)
    order, left = [0], list(range(1, len(Ts)))
    while left:
        distance = np.linalg.norm(what[left] - what[order[-1]], axis=1)
        order.append(left.pop(int(np.argmin(distance))))
    return Ts[order]
