"""Render a scene as an ideal camera sees it.

The CPU rasterizes triangles. Depth is exact, and the shading shows seams, edges and handles.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.ndimage import maximum_filter

from momapos.core.geometry import invert, pose, signed_area
from momapos.model.records import Frame
from momapos.model.scene import Scene, SceneObject

from .rasterizer import (
    CREVICE_RAYS,
    Appearance,
    Buffers,
    Lamps,
    Surfaces,
    View,
    rasterize,
    shade_image,
)
from .surfaces import Material, Palette, Role, SurfacePatch, linear, patches, urdf_paints

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int, UInt8

FLOOR_MARGIN = 2.0
"""Margin of the floor around the objects in a scene without a floor outline [m]."""
LAMPS = 6
LAMP_LIGHT = 1.1
"""Light of all lamps together on a surface that faces them [-]."""
LAMP_DISTANCE = 60.0
"""Distance of the lamps, for nearly parallel light [m]."""
SHADOW_TEXELS = 768
BACKGROUND = (0.75, 0.78, 0.80)
"""sRGB color of the background."""
_TO_SRGB = np.rint(255 * np.linspace(0, 1, 4097) ** (1 / 2.2)).astype(np.uint8)


class Backdrop(NamedTuple):
    """What a camera sees of the first triangles of a world, which don't move."""

    number: int
    """Number of these triangles [-]."""
    buffers: Buffers
    color: UInt8[np.ndarray, "h w 3"]
    """Their image."""


@dataclass(frozen=True, eq=False)
class RenderWorld:
    """A scene as triangles."""

    triangles: Float[np.ndarray, "n 3 3"]
    """Corners in the world [m]."""
    closed: Bool[np.ndarray, " n"]
    """Triangles of closed bodies, which are visible only from outside."""
    owner: Int[np.ndarray, " n"]
    """Index of the scene's object; -1 for the floor."""
    surface: Int[np.ndarray, " n"]
    materials: tuple[Material, ...]
    """One for each surface."""

    @cached_property
    def normals(self) -> Float[np.ndarray, "n 3"]:
        """Unit normals; zero for triangles without area."""
        return _normals_of(self.triangles)

    @cached_property
    def _surfaces(self) -> Surfaces:
        colors = linear(np.array([m.color for m in self.materials]))
        grain = np.array([(m.strength, *m.frequency) for m in self.materials])
        return Surfaces(self.normals, self.surface.astype(np.int32), colors, grain)

    @cached_property
    def _lamps(self) -> Lamps:
        """Shadow maps of lamps above the scene, spread over the hemisphere."""
        points = self.triangles.reshape(-1, 3)
        middle = (points.min(0) + points.max(0)) / 2
        radius = float(np.linalg.norm(points - middle, axis=1).max())
        turn = np.arange(LAMPS) * np.pi * (3 - np.sqrt(5.0))
        height = np.linspace(0.25, 0.9, LAMPS)
        flat = np.sqrt(1 - height**2)
        toward = np.stack([flat * np.cos(turn), flat * np.sin(turn), height], axis=1)
        eyes = middle + (LAMP_DISTANCE + radius) * toward
        Ts_world_lamp = np.stack([look_at(eye, middle) for eye in eyes])
        scale = SHADOW_TEXELS / 2 * (LAMP_DISTANCE + radius) / radius
        grid = (np.arange(SHADOW_TEXELS) - (SHADOW_TEXELS - 1) / 2) / scale
        maps = np.empty((LAMPS, SHADOW_TEXELS, SHADOW_TEXELS), np.float32)
        ids = np.empty((SHADOW_TEXELS, SHADOW_TEXELS), np.int32)
        Ts_lamp_world = invert(Ts_world_lamp)
        for T, image in zip(Ts_lamp_world, maps, strict=True):
            rasterize(self._seen_from(T), self.closed, grid, grid, Buffers(image, ids))
        strength = LAMP_LIGHT / LAMPS * np.linspace(1.4, 0.6, LAMPS)
        return Lamps(Ts_lamp_world, strength, np.full(LAMPS, scale), maps)

    def _seen_from(self, T_camera_world: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "n 3 3"]:
        return self.triangles @ T_camera_world[:3, :3].T + T_camera_world[:3, 3]

    def trace(
        self,
        T_world_camera: Float[np.ndarray, "4 4"],
        xs: Float[np.ndarray, " w"],
        ys: Float[np.ndarray, " h"],
        backdrop: Backdrop | None = None,
    ) -> Buffers:
        """Find the nearest triangles along rays (x, y, 1) of a camera.

        With a backdrop of the same rays, only the triangles after it are drawn.
        """
        shape = len(ys), len(xs)
        buffers = Buffers(np.empty(shape, np.float32), np.empty(shape, np.int32))
        T = invert(T_world_camera)
        if backdrop is None:
            rasterize(self._seen_from(T), self.closed, xs, ys, buffers)
            return buffers
        first, (inverse, nearest) = backdrop.number, backdrop.buffers
        moving = self.triangles[first:] @ T[:3, :3].T + T[:3, 3]
        rasterize(moving, self.closed[first:], xs, ys, buffers)
        hidden = inverse >= buffers.inverse
        return Buffers(
            np.where(hidden, inverse, buffers.inverse),
            np.where(hidden, nearest, buffers.nearest + np.int32(first)),
        )


def _normals_of(triangles: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, "n 3"]:
    a, b, c = np.moveaxis(triangles, 1, 0)
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.divide(normals, length, out=np.zeros_like(normals), where=length > 0)


def render_world(scene: Scene, rng: np.random.Generator, *, floor: bool = True) -> RenderWorld:
    """Convert a scene with its current joint values to triangles with colors.

    A scene may be one object, as `load_scene` returns for a URDF; numbered PartNet objects then
    stand upright with their front toward -x.

    Args:
        scene: The scene.
        rng: Draws materials for objects without colors, and small differences.
        floor: Whether to add the floor.

    Raises:
        UrdfError: A mesh can't be read.
    """
    palette = Palette(rng)
    found: list[tuple[SurfacePatch, int, Material]] = []
    paints = {item.model.urdf.path: urdf_paints(item.model.urdf.path) for item in scene.objects}
    for number, item in enumerate(scene.objects):
        for role, patch in _object_patches(item, paints[item.model.urdf.path]):
            material = palette.material(item.name, item.category, role, patch.paint)
            found.append((patch, number, material))
    if floor:
        triangles = _floor_triangles(scene, [patch.triangles for patch, _, _ in found])
        found.append((SurfacePatch(triangles, None, closed=False), -1, palette.floor()))
    counts = [len(patch.triangles) for patch, _, _ in found]
    return RenderWorld(
        triangles=np.concatenate([patch.triangles for patch, _, _ in found]),
        closed=np.repeat([patch.closed for patch, _, _ in found], counts),
        owner=np.repeat([number for _, number, _ in found], counts),
        surface=np.repeat(np.arange(len(found)), counts),
        materials=tuple(material for _, _, material in found),
    )


def link_of_triangles(item: SceneObject) -> Int[np.ndarray, " n"]:
    """Return the link of each triangle of a world of one object, as an index into its links."""
    counts = [
        sum(len(patch.triangles) for shape in link.visuals or link.collisions
            for patch in patches(shape, None))
        for link in item.model.urdf.links.values()
    ]  # fmt: skip
    return np.repeat(np.arange(len(counts)), counts)


def join_worlds(still: RenderWorld, moving: RenderWorld) -> RenderWorld:
    """Return a world with what stands still and what moves, lit as if only the former were there.

    The shadows are those of what stands still, which are expensive.
    """
    both = RenderWorld(
        np.concatenate([still.triangles, moving.triangles]),
        np.concatenate([still.closed, moving.closed]),
        np.concatenate([still.owner, moving.owner]),
        np.concatenate([still.surface, moving.surface + len(still.materials)]),
        (*still.materials, *moving.materials),
    )
    vars(both)["_lamps"] = still._lamps
    return both


def moved_world(world: RenderWorld, moving: Float[np.ndarray, "m 3 3"]) -> RenderWorld:
    """Return a world whose last triangles are elsewhere [m], with the shadows that it has."""
    first = len(world.triangles) - len(moving)
    found = replace(world, triangles=np.concatenate([world.triangles[:first], moving]))
    normals = np.concatenate([world.normals[:first], _normals_of(moving)])
    surfaces = world._surfaces._replace(normals=normals)
    vars(found).update(normals=normals, _surfaces=surfaces, _lamps=world._lamps)
    return found


def _object_patches(
    item: SceneObject, paints: dict[str, list[tuple[float, float, float] | None]]
) -> Iterator[tuple[Role, SurfacePatch]]:
    """Yield the shapes of an object in the world: visuals, or collisions of a link without any."""
    model, poses = item.model, item.link_poses()
    moving = {link for joint in model.joints for link in model.moved_by(joint)}
    for name, link in model.urdf.links.items():
        shapes = link.visuals or link.collisions
        given = paints.get(name, []) if link.visuals else []
        given = given if len(given) == len(shapes) else [None] * len(shapes)
        for shape, paint in zip(shapes, given, strict=True):
            words = f"{name} {shape.name}".lower()
            held = "handle" in words or "knob" in words
            role: Role = "handle" if held else "front" if name in moving else "body"
            for patch in patches(shape, paint):
                T = poses[name]
                triangles = patch.triangles @ T[:3, :3].T + T[:3, 3]
                yield role, SurfacePatch(triangles, patch.paint, patch.closed)


def _floor_triangles(scene: Scene, parts: list[np.ndarray]) -> Float[np.ndarray, "n 3 3"]:
    """Return the floor at height 0: the scene's outline, or a rectangle around everything."""
    if scene.floor_polygon is not None:
        corners = np.column_stack([scene.floor_polygon, np.zeros(len(scene.floor_polygon))])
        return corners[ear_clipped(scene.floor_polygon)]
    points = np.concatenate([part.reshape(-1, 3) for part in parts] or [np.zeros((1, 3))])
    low, high = points.min(0), points.max(0)
    (x0, y0), (x1, y1) = low[:2] - FLOOR_MARGIN, high[:2] + FLOOR_MARGIN
    corners = np.array([[x0, y0, 0.0], [x1, y0, 0.0], [x1, y1, 0.0], [x0, y1, 0.0]])
    return corners[[[0, 1, 2], [0, 2, 3]]]


def ear_clipped(outline: Float[np.ndarray, "k 2"]) -> Int[np.ndarray, "m 3"]:
    """Triangulate a simple polygon by ear clipping; return indices of its corners."""
    index = list(range(len(outline)))
    if signed_area(outline) < 0:
        index.reverse()
    found = []
    while len(index) > 3:
        ears = (k for k in range(len(index)) if _is_ear(outline, index, k))
        k = next(ears, 0)  # collinear corners have no ear; any cut is valid
        found.append([index[k - 1], index[k], index[(k + 1) % len(index)]])
        del index[k]
    return np.array([*found, index])


def _is_ear(outline: Float[np.ndarray, "k 2"], index: list[int], k: int) -> bool:
    ear = [index[k - 1], index[k], index[(k + 1) % len(index)]]
    triangle = outline[ear]
    if signed_area(triangle) <= 0:
        return False
    others = outline[[i for i in index if i not in ear]]
    edge = np.roll(triangle, -1, axis=0) - triangle
    away = others[:, None] - triangle
    return not (edge[:, 0] * away[..., 1] - edge[:, 1] * away[..., 0] > 0).all(1).any()


def look_at(
    eye: Float[np.ndarray, "3"], target: Float[np.ndarray, "3"], roll: float = 0.0
) -> Float[np.ndarray, "4 4"]:
    """Return the world pose of an upright camera that looks at a target.

    Args:
        eye, target: Positions of the camera and of the point in the middle of its image [m].
        roll: Rotation about the optical axis [rad].
    """
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    length = float(np.linalg.norm(right))
    right = right / length if length > 1e-6 else np.array([1.0, 0.0, 0.0])
    down = np.cross(forward, right)
    c, s = np.cos(roll), np.sin(roll)
    return pose(eye, np.stack([c * right + s * down, c * down - s * right, forward], axis=1))


def pinhole(size: tuple[int, int], focal: float) -> Float[np.ndarray, "3 3"]:
    """Return the intrinsics [px] of a centered pinhole camera.

    Args:
        size: Width and height of the image [px].
        focal: Focal length [px].
    """
    width, height = size
    return np.array([[focal, 0.0, (width - 1) / 2], [0.0, focal, (height - 1) / 2], [0, 0, 1.0]])


def render_frame(
    world: RenderWorld,
    T_world_camera: Float[np.ndarray, "4 4"],
    intrinsics: Float[np.ndarray, "3 3"],
    size: tuple[int, int],
    name: str = "",
    backdrop: Backdrop | None = None,
) -> Frame:
    """Render an image without noise; integer coordinates are pixel centers.

    Args:
        world: From `render_world`.
        T_world_camera: Camera pose, axes as in OpenCV: x right, y down, z forward.
        intrinsics: Pinhole intrinsics without skew [px].
        size: Width and height of the image [px].
        name: Name of the frame.
        backdrop: What this camera sees of the world's first triangles, if it is known, see
            `render_backdrop`.

    Returns:
        Color, and depth along the optical axis [m], 0 for none.
    """
    K = intrinsics
    xs, ys = _rays(K, size)
    buffers = world.trace(T_world_camera, xs, ys, backdrop)
    color = _shaded(world, View(xs, ys, buffers, *_position(T_world_camera)), size, backdrop)
    inverse = buffers.inverse[1::2, 1::2]
    depth = np.divide(1.0, inverse, out=np.zeros_like(inverse), where=inverse > 0)
    return Frame(name, color, depth, np.array(K, float), np.array(T_world_camera, float))


def _shaded(
    world: RenderWorld, view: View, size: tuple[int, int], backdrop: Backdrop | None
) -> UInt8[np.ndarray, "h w 3"]:
    """Color a view; pixels near which nothing is in front of the backdrop have its color."""
    width, height = size
    if backdrop is None:
        color, known = np.empty((height, width, 3), np.uint8), np.zeros((height, width), bool)
    else:
        # A color depends on the rays next to its pixel and on those around them.
        near = maximum_filter(
            view.buffers.nearest != backdrop.buffers.nearest, 2 * (CREVICE_RAYS + 1) + 1
        )
        color, known = backdrop.color.copy(), ~near[1::2, 1::2]
    look = Appearance(world._surfaces, world._lamps, linear(np.array(BACKGROUND)))
    shade_image(view, look, _TO_SRGB, known, color)
    return color


def _position(
    T_world_camera: Float[np.ndarray, "4 4"],
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]:
    return np.ascontiguousarray(T_world_camera[:3, :3]), T_world_camera[:3, 3].copy()


def render_backdrop(
    still: RenderWorld,
    T_world_camera: Float[np.ndarray, "4 4"],
    intrinsics: Float[np.ndarray, "3 3"],
    size: tuple[int, int],
) -> Backdrop:
    """Draw what does not move, for a camera that does not move; arguments as in `render_frame`.

    Worlds that begin with the same triangles are rendered faster with it.
    """
    xs, ys = _rays(intrinsics, size)
    buffers = still.trace(T_world_camera, xs, ys)
    color = _shaded(still, View(xs, ys, buffers, *_position(T_world_camera)), size, None)
    return Backdrop(len(still.triangles), buffers, color)


def _rays(
    K: Float[np.ndarray, "3 3"], size: tuple[int, int]
) -> tuple[Float[np.ndarray, " w"], Float[np.ndarray, " h"]]:
    """Return rays twice as dense as pixels, one beyond each border: pixel i is ray 2 i + 1."""
    width, height = size
    xs = (np.arange(2 * width + 1) / 2 - 0.5 - K[0, 2]) / K[0, 0]
    ys = (np.arange(2 * height + 1) / 2 - 0.5 - K[1, 2]) / K[1, 1]
    return xs, ys
