"""Measure box detection in scans of built-in kitchens: recall, accuracy and time.

    python benchmarks/boxes.py FOLDER [--count 20] [--frames 50] [--shared] [--out docs/data]

Kitchens are generated, furnished with a table and a microwave where they fit, scanned by the
synthetic scanner and stored in FOLDER; a second run only measures. With --shared the shared
kitchens are measured separately. An object counts as found if a box covers it with an intersection
over union of at least 0.5 (furniture) or 0.25 (small objects), after rows of furniture are split by
the fronts in the images.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from importance_rooms import is_wall
from momapos.apps.synthetic_scans import DepthSensor, synthetic_scan, write_scan
from momapos.core.geometry import UprightBox, apply, pose
from momapos.model.records import ArticulationPredictor, Cloud, Detection
from momapos.model.scene import LAYOUTS, Scene, SceneObject, generate_kitchen, load_scene
from momapos.model.urdf import Articulated, box_urdf
from momapos.model.urdf.reader import Geometry, Link, Urdf
from momapos.perception import ScanConfig
from momapos.perception.fusion import align_to_gravity, fuse
from momapos.perception.pipeline import split_rows
from momapos.perception.reconstruction import FrontNetwork
from momapos.perception.recordings import read_scan
from momapos.perception.segmentation import ClassicalSegmenter, boxes, find_room
from placement import SCENES, machine, shared

FURNITURE = ("fridge", "oven", "dishwasher", "microwave", "table")
SMALL = ("cup", "apple", "bottle", "cereal box")
OVERLAP, OVERLAP_SMALL = 0.5, 0.25
COVERED = 0.7
"""An object is part of a detected row if one box covers this share of it [-]."""
TABLE, LEG = (1.4, 0.8, 0.74), 0.06  # [m]
MICROWAVE = (0.48, 0.36, 0.28)  # [m]
ALIKE = {
    "cabinet": {"cabinet", "wall cabinet"},
    "sink": {"cabinet", "sink", "counter"},
    "kitchen island": {"kitchen island", "cabinet", "counter"},
    "counter": {"counter", "cabinet"},
    "cereal box": {"box"},
}
"""Correct labels of a category, if there are others than its own name."""


@dataclass(frozen=True)
class Room:
    """A scene and the folder of its scan."""

    key: str
    scene: Scene
    folder: Path
    shared: bool
    """Whether it is a shared kitchen."""


def rooms(folder: Path, count: int, frames: int, *, with_shared: bool) -> Iterator[Room]:
    """Yield kitchens with their scans, which are generated if missing."""
    for k in range(count):
        layout, seed = LAYOUTS[k % len(LAYOUTS)], 100 + k // len(LAYOUTS)
        key = f"{layout}_{seed}"
        file = folder / key / "scene.json"
        if not file.exists():
            file.parent.mkdir(parents=True, exist_ok=True)
            generate_kitchen(layout, seed=seed, out=file)
        scene = furnished(load_scene(file), np.random.default_rng((seed, k)))
        yield Room(
            key, scene, _scanned(scene, folder / key / f"scan_{frames}", frames, seed), False
        )
    for name in SCENES if with_shared else ():
        scene = load_scene(shared() / "bestman" / name)
        key = Path(name).stem
        scan = _scanned(scene, folder / key / f"scan_{frames}", frames, 0)
        yield Room(key, scene, scan, True)


def _scanned(scene: Scene, folder: Path, frames: int, seed: int) -> Path:
    if not (folder / "truth.json").exists():
        folder.parent.mkdir(parents=True, exist_ok=True)
        write_scan(synthetic_scan(scene, frames=frames, seed=seed, sensor=DepthSensor()), folder)
    return folder


def furnished(scene: Scene, rng: np.random.Generator) -> Scene:
    """Put a microwave on a counter and a table on the floor if they fit."""
    bounds = np.array([item.bounds for item in scene.objects])
    for item in scene.objects:
        low, high = item.bounds
        size = np.array(MICROWAVE)
        deep = int(np.argmin(high[:2] - low[:2]))
        if deep == 0:
            size[:2] = size[1::-1]
        if item.category != "counter" or high[2] > 1.0 or ((high - low)[:2] < size[:2] + 0.1).any():
            continue
        center = np.array([*(low + high)[:2] / 2, high[2] + size[2] / 2 + 0.001])
        if _clear(bounds, center, size, 0.03):
            model = Articulated(box_urdf("microwave", tuple(size.tolist())))
            new = SceneObject("microwave", "microwave", pose(tuple(center.tolist())), model)
            scene = replace(scene, objects=(*scene.objects, new))
            break
    if scene.floor_polygon is not None:
        low, high = scene.floor_polygon.min(0), scene.floor_polygon.max(0)
        for _ in range(400):
            xy = rng.uniform(low, high)
            center = np.array([*xy, TABLE[2] / 2])
            inside = (
                (xy - np.array(TABLE[:2]) / 2 > low) & (xy + TABLE[:2] / np.array(2) < high)
            ).all()
            if inside and _clear(bounds, center, np.array(TABLE), 0.75):
                new = SceneObject("table", "table", pose((*xy.tolist(), 0.0)), _table())
                return replace(scene, objects=(*scene.objects, new))
    return scene


def _clear(
    bounds: Float[np.ndarray, "n 2 3"], center: Float[np.ndarray, "3"],
    size: Float[np.ndarray, "3"], gap: float,
) -> bool:  # fmt: skip
    """Return whether a box has a horizontal gap of at least `gap` [m] to all others."""
    away = np.maximum(bounds[:, 0] - center, center - bounds[:, 1]) - size / 2
    return bool(((away[:, :2] > gap).any(axis=1) | (away[:, 2] > -1e-3)).all())


def _table() -> Articulated:
    """Return a table: a top on four legs; its frame is on the floor below the center."""
    x, y, z = TABLE
    legs = [(sx * (x - LEG) / 2, sy * (y - LEG) / 2) for sx in (-1, 1) for sy in (-1, 1)]
    shapes = [Geometry("box", (x, y, 0.04), pose((0.0, 0.0, z - 0.02)))]
    shapes += [Geometry("box", (LEG, LEG, z - 0.04), pose((*leg, (z - 0.04) / 2))) for leg in legs]
    link = Link("table", tuple(shapes), tuple(shapes))
    return Articulated(Urdf("table", None, "table", {"table": link}, ()))


def detect(
    folder: Path, look: ArticulationPredictor, config: ScanConfig
) -> tuple[list[Detection], dict[str, float]]:
    """Read a scan and detect boxes; return them with the seconds of each stage."""
    marks = {"": time.perf_counter()}
    scan = read_scan(folder)
    marks["read"] = time.perf_counter()
    cloud = fuse(scan.frames, config.voxel, config.fusion)
    marks["fuse"] = time.perf_counter()
    T = align_to_gravity(cloud, scan.frames)
    cloud = Cloud(apply(T, cloud.points), cloud.normals @ T[:3, :3].T, cloud.colors)
    frames = [replace(f, T_world_camera=T @ f.T_world_camera) for f in scan.frames]
    marks["upright"] = time.perf_counter()
    instances = ClassicalSegmenter()(cloud)
    marks["segment"] = time.perf_counter()
    room = find_room(cloud)
    found = boxes(cloud, instances, room)
    marks["boxes"] = time.perf_counter()
    pieces, _ = split_rows(found, cloud, frames, look)
    if len(pieces) > len(found):
        found = boxes(cloud, pieces, room)
    marks["rows"] = time.perf_counter()
    return found, dict(zip(list(marks)[1:], np.diff(list(marks.values())).tolist(), strict=True))


def overlap(true: UprightBox, box: UprightBox) -> tuple[float, float]:
    """Return the intersection over union, and the share of the true box within the other one."""
    steps = (np.arange(12) + 0.5) / 12 - 0.5
    grid = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    points = _turn(grid * true.size, true.yaw) + true.center
    local = _turn(points - box.center, -box.yaw)
    share = float((np.abs(local) <= box.size / 2).all(axis=1).mean())
    volume, other = float(np.prod(true.size)), float(np.prod(box.size))
    return share * volume / (volume + other - share * volume), share


def _turn(points: Float[np.ndarray, "n 3"], yaw: float) -> Float[np.ndarray, "n 3"]:
    out = points.copy()
    c, s = np.cos(yaw), np.sin(yaw)
    out[:, :2] = points[:, :2] @ np.array([[c, s], [-s, c]])
    return out


def body_bounds(item: SceneObject) -> Float[np.ndarray, "2 3"]:
    """Return the corners of an object without its handles, in the world [m]."""
    low, high = [], []
    for link, T in item.link_poses().items():
        for hull in item.model.hulls[link]:
            corners = apply(T, hull.vertices)
            if np.sort(np.ptp(corners, axis=0))[1] > 0.05:
                low.append(corners.min(0))
                high.append(corners.max(0))
    return np.stack([np.min(low, axis=0), np.max(high, axis=0)]) if low else item.bounds


def face_errors(item: SceneObject, box: UprightBox) -> list[float]:
    """Return the distances of a box's six faces from the true ones [m]; none for rotated boxes."""
    quarter = box.yaw / (np.pi / 2)
    if abs(quarter - round(quarter)) > 0.03:
        return []
    size = np.array(box.size)
    if round(quarter) % 2:
        size[:2] = size[1::-1]
    corners = np.stack([box.center - size / 2, box.center + size / 2])
    return np.abs(corners - body_bounds(item)).ravel().tolist()


def judge(room: Room, found: list[Detection], *, report: bool) -> list[dict[str, Any]]:
    """Evaluate the detection of each object in a room."""
    truth = json.loads((room.folder / "truth.json").read_text())["objects"]
    rows = []
    for true in truth:
        item = room.scene.object(true["name"])
        if is_wall(item) or min(true["size"]) <= 0:
            continue
        box = UprightBox(np.array(true["center"]), np.array(true["size"]), true["yaw"])
        pairs = [overlap(box, detection.box) for detection in found]
        best = max(range(len(found)), key=lambda k: pairs[k][0], default=None)
        score = pairs[best][0] if best is not None else 0.0
        label = found[best].label if best is not None else ""
        small = max(true["size"]) < 0.3
        hit = score >= (OVERLAP_SMALL if small else OVERLAP)
        category = true["category"]
        rows.append(
            {
                "shared": room.shared,
                "category": category,
                "overlap": score,
                "found": hit,
                "row": hit or max((share for _, share in pairs), default=0.0) >= COVERED,
                "labeled": label in ALIKE.get(category, {category}) if hit else None,
                "faces": face_errors(item, found[best].box)
                if hit and best is not None and not small
                else [],
            }
        )
        if report and not hit:
            name = found[best].name if best is not None else "-"
            print(f"   missed {room.key}/{true['name']}: {score:.2f} with {name}, as {label}")
    return rows


def summary(rows: list[dict[str, Any]]) -> dict[str, dict[str, float]]:
    """Return rates and errors by category."""
    groups: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for row in rows:
        groups[row["category"]].append(row)
        if row["category"] in SMALL:
            groups["small objects"].append(row)
        if row["category"] in FURNITURE:
            groups["furniture"].append(row)
    out = {}
    for name, group in sorted(groups.items()):
        labels = [row["labeled"] for row in group if row["labeled"] is not None]
        faces = [error for row in group for error in row["faces"]]
        out[name] = {
            "count": len(group),
            "found": float(np.mean([row["found"] for row in group])),
            "row_found": float(np.mean([row["row"] for row in group])),
            "label_right": float(np.mean(labels)) if labels else float("nan"),
            "face_median_m": float(np.median(faces)) if faces else float("nan"),
            "face_p90_m": float(np.percentile(faces, 90)) if faces else float("nan"),
        }
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="folder of scenes and scans")
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--frames", type=int, default=50)
    parser.add_argument("--shared", action="store_true", help="also measure the shared kitchens")
    parser.add_argument("--verbose", action="store_true", help="print missed objects")
    parser.add_argument("--out", type=Path, default=None, help="folder for boxes.json")
    args = parser.parse_args()
    rows, seconds, look = [], [], FrontNetwork()
    for room in rooms(args.folder, args.count, args.frames, with_shared=args.shared):
        found, timing = detect(room.folder, look, ScanConfig())
        rows += judge(room, found, report=args.verbose)
        seconds.append(timing)
        print(f"{room.key:18s}", {k: round(v, 2) for k, v in timing.items()}, flush=True)
    table = {}
    for title, shared_ones in (("built-in", False), ("shared", True)):
        group = [row for row in rows if row["shared"] is shared_ones]
        table[title] = summary(group)
        print(title)
        for name, row in table[title].items():
            figures = " ".join(f"{key} {value:.3f}" for key, value in row.items() if key != "count")
            print(f"  {name:16s} {row['count']:4d}  {figures}")
    # The first room includes loading the kernels.
    stages = {key: float(np.median([s[key] for s in seconds[1:] or seconds])) for key in seconds[0]}
    to_boxes = sum(seconds for stage, seconds in stages.items() if stage != "rows")
    print("median seconds", stages, "to boxes, before rows are cut:", to_boxes)
    if args.out is not None:
        args.out.mkdir(parents=True, exist_ok=True)
        record = {"machine": machine(), "frames": args.frames, "table": table, "seconds": stages}
        (args.out / "boxes.json").write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()
