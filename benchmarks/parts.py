"""Evaluate the front network on unseen faces: doors, drawers and handles.

    PYTHONPATH=. python benchmarks/parts.py [--drawn 100] [--variants 3] [--pictures DIR]
                                            [--set development|test] [--walls 250]

Four sets: newly drawn faces, ordinary and hard; rendered simulator objects, optionally of one set
(`objects.py`); and real photos. Only sums are printed for the test set. With --walls there are two
sets instead: drawn low cabinets, and wall cabinets with many lifted doors, each evaluated with and
without knowledge of the height. A part is located if a predicted part of any kind overlaps it with
an IoU of 0.5; a handle, if the center of the predicted one lies within it.

The objects are meshes with joints. A camera in front of one sees its closed face; the joint of the
mesh that each ray hits identifies the moving parts, so no box is drawn by hand.
"""

from __future__ import annotations

import itertools
import json
import re
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import trimesh
import yourdfpy
from PIL import Image, ImageDraw
from scipy import ndimage
from training.fronts import cabinets, generator

from momapos.apps.bench.articulated import SETS, set_of
from momapos.model.records import FaceImage, Front, PartKind
from momapos.perception.reconstruction import FrontNetwork, weighted_by_height
from momapos.perception.reconstruction.decode import overlaps
from momapos.perception.reconstruction.usual_kinds import EYE_HEIGHT
from objects import Subset
from placement import shared as default_shared
from rows import commands

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


MAX_HUNG_HEIGHT = 1.05
"""Lower cabinets may hang on a wall [m]."""
LIFTED = generator.Mix({cabinets.hung: 1.0}, bare=generator.LAST.bare)
"""Wall cabinets only."""
COLORS = {
    "door_left": "red",
    "door_right": "lime",
    "door_down": "cyan",
    "door_up": "magenta",
    "drawer": "yellow",
}


@dataclass
class Tally:
    """Counts over some faces."""

    parts: int = 0
    located: int = 0
    found: int = 0
    kinds: int = 0
    hinges: int = 0
    doors: int = 0
    handles: int = 0
    held: int = 0
    faces: int = 0
    seconds: list[float] = field(default_factory=list)
    wrong: Counter[tuple[str, str]] = field(default_factory=Counter)
    """Number of parts of the first kind that are classified as the second."""

    def row(self, name: str) -> str:
        """Return one line of the table."""
        return (
            f"| {name} | {self.faces} | {_share(self.located, self.parts)} "
            f"| {_share(self.located, self.found)} | {_share(self.kinds, self.located)} "
            f"| {_share(self.hinges, self.doors)} | {_share(self.held, self.handles)} |"
        )


def _share(part: int, whole: int) -> str:
    return f"{part / whole:.2f} ({part}/{whole})" if whole else "-"


def matches(true: TrueFace, front: Front) -> list[tuple[int, int]]:
    """Return pairs of overlapping true and predicted parts, the best first."""
    if not true.parts or not front.parts:
        return []
    common = overlaps(
        np.array([p.box for p in true.parts]), np.array([p.box for p in front.parts])
    )[0]
    pairs = []
    while common.max() >= 0.5:
        i, j = np.unravel_index(int(common.argmax()), common.shape)
        pairs.append((int(i), int(j)))
        common[i], common[:, j] = -1, -1
    return pairs


def count(true: TrueFace, front: Front, tallies: Iterable[Tally]) -> None:
    """Add one face to tallies."""
    pairs = matches(true, front)
    for tally in tallies:
        tally.faces += 1
        tally.parts += len(true.parts)
        tally.found += len(front.parts)
        tally.located += len(pairs)
        tally.handles += sum(bool(p.handles) for p in true.parts)
        for i, j in pairs:
            part, predicted = true.parts[i], front.parts[j]
            tally.kinds += part.kind == predicted.kind
            tally.wrong[str(part.kind), predicted.kind] += part.kind != predicted.kind
            if part.kind in ("door_left", "door_right"):
                tally.doors += 1
                tally.hinges += part.kind == predicted.kind
            tally.held += predicted.handle is not None and _within(predicted.handle, part)


def _within(handle: tuple[float, float, float, float], part: TruePart) -> bool:
    x, y = (handle[0] + handle[2]) / 2, (handle[1] + handle[3]) / 2
    return any(h[0] <= x <= h[2] and h[1] <= y <= h[3] for h in part.handles)


def drawn_faces(number: int, seed: int, mix: generator.Mix) -> Iterator[TrueFace]:
    """Yield faces of the generator that training did not use."""
    return itertools.islice(_drawn(seed, mix), number)


def wall_faces(number: int, seed: int) -> Iterator[TrueFace]:
    """Yield drawn cabinets that may hang: low, with doors and flaps only."""

    def hangs(true: TrueFace) -> bool:
        kinds = {part.kind for part in true.parts}
        low = true.name == "cabinet" and true.face.height < MAX_HUNG_HEIGHT
        return low and bool(kinds) and "drawer" not in kinds

    return itertools.islice(filter(hangs, _drawn(seed, generator.ORDINARY)), number)


def _drawn(seed: int, mix: generator.Mix) -> Iterator[TrueFace]:
    for i in itertools.count():
        drawn = generator.draw(np.random.default_rng([seed, i]), mix)
        parts = tuple(TruePart(p.kind, p.box, (p.handle,) if p.handle else ()) for p in drawn.parts)
        yield TrueFace(drawn.family, drawn.face, parts)


def comparison(true: TrueFace, front: Front, side: int = 320) -> Image.Image:
    """Return an image of a face with its true (left) and predicted parts (right)."""
    sheet = Image.new("RGB", (2 * side + 4, side))
    image = Image.fromarray(true.face.color).resize((side, side))
    right = image.copy()
    for canvas, parts in ((image, true.parts), (right, front.parts)):
        pen = ImageDraw.Draw(canvas)
        for part in parts:
            pen.rectangle([v * side for v in part.box], outline=COLORS[part.kind or "drawer"])
            grips = part.handles if isinstance(part, TruePart) else (part.handle,)
            for grip in grips:
                if grip is not None:
                    pen.rectangle([v * side for v in grip], outline="orange", width=2)
    sheet.paste(image, (0, 0))
    sheet.paste(right, (side + 4, 0))
    ImageDraw.Draw(sheet).text((side + 8, 4), f"{true.name} front {front.score:.2f}", fill="blue")
    return sheet


def evaluate(
    name: str,
    faces: Iterable[TrueFace],
    network: Callable[[FaceImage, str], Front],
    out: Path | None,
    *,
    sums: bool = False,
) -> None:
    """Print a table of one set, or its sums only."""
    tallies: defaultdict[str, Tally] = defaultdict(Tally)
    whole = Tally()
    right = [0, 0, 0, 0]
    for i, true in enumerate(faces):
        began = time.perf_counter()
        front = network(true.face, true.name)
        whole.seconds.append(time.perf_counter() - began)
        count(true, front, (whole, tallies[true.name.split("/")[0]]))
        real = bool(true.parts)
        right[2 * real] += 1
        right[2 * real + 1] += (front.score > 0.5) == real
        if out is not None:
            out.mkdir(parents=True, exist_ok=True)
            comparison(true, front).save(out / f"{name}_{i:03d}.png")
    print(f"\n| {name} | faces | located | precision | kind | hinge side | handles |")
    print("|---|---|---|---|---|---|---|")
    for key in () if sums else sorted(tallies):
        print(tallies[key].row(key))
    print(whole.row("all"))
    for (kind, predicted), times in () if sums else (+whole.wrong).most_common():
        print(f"{times} {kind} classified as {predicted}")
    print(
        f"fronts recognized: {_share(right[3], right[2])}, "
        f"others recognized: {_share(right[1], right[0])}; "
        f"{1000 * float(np.median(whole.seconds)):.0f} ms a face, "
        f"slowest {1000 * max(whole.seconds):.0f} ms"
    )


def main(
    shared: Path | None = None,
    drawn: int = 100,
    variants: int = 3,
    seed: int = 90001,
    pictures: Path | None = None,
    subset: Subset = None,
    walls: int = 0,
) -> None:
    """Print a table of each set.

    Args:
        shared: Folder of the real data, by default that of MOMAPOS_SHARED; its sets are skipped
            if it is missing.
        drawn: Number of newly drawn faces of each of the two mixes.
        variants: Number of renderings of each real object.
        seed: Seed of drawn faces, light, view and noise; training used others.
        pictures: Folder for an image of each face.
        subset: Only the real objects of one set, see `objects.py`.
        walls: Number of drawn cabinets that may hang; they replace all other sets.
    """
    network = FrontNetwork()

    def hung(face: FaceImage, label: str) -> Front:
        front = network(face, label)
        return replace(front, parts=weighted_by_height(front.parts, face, EYE_HEIGHT))

    if walls:
        for name, more in (
            ("wall cabinets", wall_faces(walls, seed)),
            ("wall cabinets, many lifted", drawn_faces(walls, seed, LIFTED)),
        ):
            faces = list(more)
            evaluate(name, faces, network, pictures)
            evaluate(f"{name}, height known", faces, hung, None)
        return
    evaluate("drawn", drawn_faces(drawn, seed, generator.ORDINARY), network, pictures)
    evaluate("drawn, hard", drawn_faces(drawn, seed + 1, generator.HARD), network, pictures)
    data = default_shared() if shared is None else shared
    if not (data / "bestman").is_dir():
        print(f"\nno simulator objects and no photos: {data / 'bestman'} does not exist")
        return
    objects, sums = real_faces(data, variants, seed, subset), subset == SETS[1]
    kept = None if sums else pictures
    evaluate("simulator objects", objects, network, kept, sums=sums)
    evaluate("photos", photo_faces(data), network, pictures)


if __name__ == "__main__":
    commands(__doc__, main)
