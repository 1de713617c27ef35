"""Faces with known parts that training never used: rendered simulator objects and real photos.

The objects are meshes with joints. A camera in front of one sees its closed face; the joint of the
mesh that each ray hits identifies the moving parts, so no box is drawn by hand.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
import yourdfpy
from PIL import Image
from scipy import ndimage

from momapos.apps.bench.articulated import set_of
from momapos.model.records import FaceImage, PartKind

PIXEL = 0.003
"""Size of a rendered pixel [m]."""
MIN_AREA = 0.01
"""Minimum share of the face of a part [-]."""
FAMILIES = ("Cabinet", "Fridge", "MiniFridge", "Microwave", "Oven", "Dishwasher", "Sink", "Kitchen")
OTHER_AXES = ("CabinetTop",)
"""Models whose axes are not x right, y up and z toward the viewer."""

Box = tuple[float, float, float, float]


@dataclass(frozen=True)
class TruePart:
    """A true part; boxes are fractions of the face."""

    kind: PartKind | None
    """None if unknown."""
    box: Box
    handles: tuple[Box, ...]


@dataclass(frozen=True)
class TrueFace:
    """A face and its parts."""

    name: str
    face: FaceImage
    parts: tuple[TruePart, ...]


@dataclass(frozen=True)
class _Solid:
    """All visible triangles of an object, with their joints."""

    mesh: trimesh.Trimesh
    colors: np.ndarray
    """(faces, 3) in [0, 1]."""
    moving: np.ndarray
    """(faces,) index of the joint that moves a triangle, -1 if none."""
    grips: np.ndarray
    """(faces,) whether it belongs to a handle."""
    kinds: list[tuple[str, np.ndarray, np.ndarray]]
    """Type, axis and origin of each joint, in the object's frame."""


def real_faces(
    shared: Path, variants: int, seed: int, subset: str | None = None
) -> Iterator[TrueFace]:
    """Render the closed fronts of the numbered objects.

    Args:
        shared: Folder of the real data.
        variants: Number of renderings of each, with different light and view.
        seed: Seed of light, view and noise.
        subset: Only the objects of one set, see `objects.py`.
    """
    scene = shared / "bestman" / "Asset" / "Scene"
    scales = _scales(scene)
    for path in sorted((scene / "Kitchen_models" / "models").glob("*/*/mobility.urdf")):
        family = path.parent.parent.name
        if not family.startswith(FAMILIES) or family in OTHER_AXES:
            continue
        if subset not in (None, set_of(f"Kitchen_models/models/{family}/{path.parent.name}")):
            continue
        solid = _load(path, scales.get(f"{family}/{path.parent.name}", 1.0))
        for i in range(variants):
            rng = np.random.default_rng([seed, i])
            yield _render(f"{family}/{path.parent.name}", solid, rng, straight=i == 0)


def _scales(scene: Path) -> dict[str, float]:
    """Return the scale of each model in the kitchens that use it."""
    found: dict[str, float] = {}
    for path in sorted((scene / "Scene").glob("*.json")):
        for item in json.loads(path.read_text()):
            parts = Path(item.get("model_path", "")).parts
            if len(parts) > 3 and isinstance(item.get("scale"), int | float):
                found.setdefault("/".join(parts[-3:-1]), float(item["scale"]))
    return found


def _load(path: Path, scale: float) -> _Solid:
    """Read a model's visual meshes with their colors, all joints closed."""
    urdf = yourdfpy.URDF.load(str(path), load_meshes=False, build_scene_graph=True)
    buttons = {
        link.name
        for link in urdf.robot.links
        if any(re.search("button|knob|switch", visual.name or "") for visual in link.visuals)
    }
    joints = [
        j
        for j in urdf.robot.joints
        if j.type in ("revolute", "prismatic") and j.child not in buttons
    ]
    carried = {j.child: i for i, j in enumerate(joints)}
    for _ in urdf.robot.joints:
        for joint in urdf.robot.joints:
            if joint.child not in carried and joint.parent in carried:
                carried[joint.child] = carried[joint.parent]
    # One fixed joint turns the root to z up; its child is the frame of the meshes.
    body = next(j.child for j in urdf.robot.joints if j.parent == urdf.base_link)
    meshes, colors, moving, grips = [], [], [], []
    for link in urdf.robot.links:
        T_body_link = urdf.get_transform(link.name, body)
        for visual in link.visuals:
            if visual.geometry is None or visual.geometry.mesh is None:
                continue
            loaded = trimesh.load(path.parent / visual.geometry.mesh.filename, force="scene")
            origin = np.eye(4) if visual.origin is None else visual.origin
            for piece in loaded.dump():
                piece.apply_transform(T_body_link @ origin)
                meshes.append(trimesh.Trimesh(piece.vertices, piece.faces, process=False))
                colors.append(np.tile(_color(piece), (len(piece.faces), 1)))
                moving.append(np.full(len(piece.faces), carried.get(link.name, -1)))
                grips.append(np.full(len(piece.faces), (visual.name or "").startswith("handle")))
    mesh = trimesh.util.concatenate(meshes)
    mesh.apply_scale(scale)
    kinds = []
    for joint in joints:
        T_body_joint = urdf.get_transform(joint.child, body)
        kinds.append((joint.type, T_body_joint[:3, :3] @ joint.axis, scale * T_body_joint[:3, 3]))
    return _Solid(
        mesh, np.concatenate(colors), np.concatenate(moving), np.concatenate(grips), kinds
    )


def _color(piece: trimesh.Trimesh) -> np.ndarray:
    """Return the mean color of a piece."""
    material = getattr(piece.visual, "material", None)
    texture = getattr(material, "image", None)
    if texture is not None:
        return np.asarray(texture.convert("RGB"), float).reshape(-1, 3).mean(axis=0) / 255
    if material is not None:
        return np.asarray(material.main_color, float)[:3] / 255
    return np.full(3, 0.6)


def _render(name: str, solid: _Solid, rng: np.random.Generator, *, straight: bool) -> TrueFace:
    """Render the front of an object, rectified onto the front of its box."""
    low, high = solid.mesh.bounds
    size = high - low
    columns, rows = (np.clip(size[:2] / PIXEL, 60, 640)).astype(int)
    x = low[0] + (np.arange(columns) + 0.5) * size[0] / columns
    y = high[1] - (np.arange(rows) + 0.5) * size[1] / rows
    plane = np.stack((*np.meshgrid(x, y), np.full((rows, columns), high[2])), axis=-1)
    plane = plane.reshape(-1, 3)
    if straight:
        origins = plane + np.array([0, 0, 0.5])
        rays = np.tile([0.0, 0.0, -1.0], (len(plane), 1))
    else:
        yaw, pitch = np.radians(rng.uniform((-15, -4), (15, 12)))
        away = rng.uniform(1.8, 3.0) * np.array([np.tan(yaw), np.tan(pitch), 1.0])
        origins = np.tile((low + high) / 2 * (1, 1, 0) + (0, 0, high[2]) + away, (len(plane), 1))
        rays = plane - origins
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    hit = solid.mesh.ray.intersects_first(origins, rays)
    seen = hit >= 0
    depth, color = np.full(len(plane), np.nan), np.full((len(plane), 3), rng.choice([0.95, 0.5]))
    corner = solid.mesh.triangles[hit[seen], 0]
    normal = solid.mesh.face_normals[hit[seen]]
    facing = np.einsum("ij,ij->i", normal, rays[seen])
    facing = np.where(np.abs(facing) < 1e-6, -1e-6, facing)
    along = np.einsum("ij,ij->i", corner - origins[seen], normal) / facing
    depth[seen] = np.clip((origins[seen] + along[:, None] * rays[seen])[:, 2], low[2], high[2])
    normal = normal * -np.sign(facing)[:, None]
    lamp = rng.normal((0, 0.5, 1.2), (0.5, 0.3, 0.0))
    lamp /= np.linalg.norm(lamp)
    light = 0.2 + 0.2 * np.abs(facing) + 0.4 * np.clip(normal @ lamp, 0, 1)
    color[seen] = solid.colors[hit[seen]] * light[:, None]
    shape = (rows, columns)
    parts = _parts(solid, np.where(seen, hit, -1).reshape(shape))
    face = _face(color.reshape(*shape, 3), depth.reshape(shape), size, rng)
    return TrueFace(name, face, parts)


def _face(
    color: np.ndarray, depth: np.ndarray, size: np.ndarray, rng: np.random.Generator
) -> FaceImage:
    """Darken corners, add a camera's noise, and measure depth from the fronts."""
    solid = np.where(np.isfinite(depth), depth, np.nanmin(depth))
    near = np.clip((ndimage.uniform_filter(solid, 9) - solid) / 0.03, 0, 1)
    wide = np.clip((ndimage.uniform_filter(solid, 41) - solid) / 0.15, 0, 1)
    image = color * (1 - 0.4 * near - 0.25 * wide)[..., None]
    image = np.clip(image * rng.uniform(0.8, 1.2), 0, 1) ** rng.uniform(0.7, 1.0)
    image = ndimage.gaussian_filter(image, (0.6, 0.6, 0)) + rng.normal(0, 0.012, image.shape)
    nearest = np.nanmax(depth)
    count, edges = np.histogram(depth[np.isfinite(depth)], 30, (nearest - 0.15, nearest))
    relief = depth - edges[count.argmax()] - 0.0025
    coarse = ndimage.zoom(rng.normal(0, 1, (24, 24)), np.array(depth.shape) / 24, order=1)
    relief = relief + rng.uniform(0.001, 0.006) * (coarse + rng.normal(0, 0.5, depth.shape))
    pixels = (np.clip(image, 0, 1) * 255).astype(np.uint8)
    return FaceImage(pixels, relief.astype(np.float32), float(size[0]), float(size[1]))


def _parts(solid: _Solid, hit: np.ndarray) -> tuple[TruePart, ...]:
    """Return the rectangles of moving parts from the triangle of each pixel."""
    owner = np.where(hit >= 0, solid.moving[hit], -1)
    grip = (hit >= 0) & solid.grips[hit]
    parts = []
    for i, (kind, axis, origin) in enumerate(solid.kinds):
        mask = owner == i
        if mask.mean() < MIN_AREA:
            continue
        bare = mask & ~grip
        box = _bounds(bare if bare.any() else mask, 0.003)
        low, high = solid.mesh.bounds
        center = np.array([(box[0] + box[2]) / 2, 1 - (box[1] + box[3]) / 2])
        center = low[:2] + center * (high - low)[:2]
        opens = _part_kind(kind, axis, origin[:2] - center)
        if opens is None:
            continue
        pieces, count = ndimage.label(ndimage.binary_dilation(mask & grip, iterations=4))
        handles = [_bounds((pieces == k) & mask & grip, 0.0) for k in range(1, count + 1)]
        parts.append(TruePart(opens, box, tuple(handles)))
    return tuple(parts)


def _bounds(mask: np.ndarray, tail: float) -> Box:
    """Return the rectangle around most pixels of a mask, as fractions."""
    rows, columns = np.nonzero(mask)
    left, right = np.quantile(columns, (tail, 1 - tail))
    top, bottom = np.quantile(rows, (tail, 1 - tail))
    height, width = mask.shape
    return _four(np.array([left, top, right + 1, bottom + 1]) / (width, height, width, height))


def _part_kind(kind: str, axis: np.ndarray, hinge: np.ndarray) -> PartKind | None:
    """Return the kind of a part; `hinge` points from its center to its axis, x right and y up."""
    main = int(np.abs(axis).argmax())
    if kind == "prismatic":
        return "drawer" if main == 2 else None
    if main == 1:
        return "door_left" if hinge[0] < 0 else "door_right"
    if main == 0:
        return "door_down" if hinge[1] < 0 else "door_up"
    return None


def photo_faces(shared: Path) -> Iterator[TrueFace]:
    """Yield the photos with hand-drawn boxes; a small box within a large one is its handle.

    Kinds are not labeled. A handle far from the center is that of a door hinged on the other side,
    which is true for all of them.
    """
    for path in sorted((shared / "cabinet_photos").glob("*.boxes.json")):
        rows = np.array(json.loads(path.read_text())["part_boxes_yxhw_normalized"])
        corner, size = rows[:, 1::-1], rows[:, 3:1:-1]
        boxes = np.concatenate((corner, corner + size), axis=1)
        middle, area = corner + size / 2, size.prod(axis=1)
        inside = (middle[:, None] > boxes[None, :, :2]) & (middle[:, None] < boxes[None, :, 2:])
        held = inside.all(axis=-1) & (area[None, :] > 3 * area[:, None])
        parts = []
        for i in np.nonzero(~held.any(axis=1))[0]:
            grips = np.nonzero(held[:, i])[0]
            off = (middle[grips, 0].mean() - middle[i, 0]) / size[i, 0] if len(grips) else 0.0
            door: PartKind = "door_left" if off > 0 else "door_right"
            kind = door if abs(off) > 0.25 else "drawer"
            parts.append(TruePart(kind, _four(boxes[i]), tuple(_four(boxes[j]) for j in grips)))
        name = path.name.removesuffix(".boxes.json")
        image = np.asarray(Image.open(path.with_name(f"{name}.png")).convert("RGB"))
        blank = np.full(image.shape[:2], np.nan, np.float32)
        yield TrueFace(name, FaceImage(image, blank, 1.0, 1.0), tuple(parts))


def _four(box: np.ndarray) -> Box:
    return (float(box[0]), float(box[1]), float(box[2]), float(box[3]))
