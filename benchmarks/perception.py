"""Measure boxes, long recordings and labels of scans, and draw what a real kitchen gives.

    python benchmarks/perception.py boxes FOLDER [--count 20] [--frames 50] [--shared]
    python benchmarks/perception.py walk FOLDER [--frames 100 1000]
    python benchmarks/perception.py labels SHARED [--detector FILE]
    python benchmarks/perception.py figure SCAN [--out docs/images/redkitchen.png]

Kitchens are scanned by the synthetic scanner.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.patches import Polygon

from importance import is_wall
from momapos.core import InputError
from momapos.core.geometry import UprightBox, apply, box_axes, pose
from momapos.model.records import ArticulationPredictor, Cloud, Detection, Frame, Part
from momapos.model.scene import LAYOUTS, Scene, SceneObject, generate_kitchen, load_scene
from momapos.model.urdf import Articulated
from momapos.model.urdf.reader import Geometry, Link, Urdf
from momapos.perception import Decision, Modeled, ScanConfig, Survey, default_tools, survey
from momapos.perception.detection import YoloxDetector
from momapos.perception.fusion import align_to_gravity, fuse
from momapos.perception.pipeline import split_rows
from momapos.perception.reconstruction import FrontNetwork
from momapos.perception.recordings import read_scan
from momapos.perception.segmentation import ClassicalSegmenter, PixelOf, find_room, pointed_at
from momapos.perception.segmentation import boxes as instance_boxes
from momapos.perception.views import Face
from momapos.workflows import scan_to_scene
from placement import SCENES, scene_of
from rows import child, commands
from scan import scanned

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
        home = folder / f"{layout}_{seed}"
        file = home / "scene.json"
        if not file.exists():
            home.mkdir(parents=True, exist_ok=True)
            generate_kitchen(layout, seed=seed, out=file)
        scene = furnished(load_scene(file), np.random.default_rng((seed, k)))
        yield Room(home.name, scene, scanned(scene, home / f"scan_{frames}", frames, seed), False)
    for name in SCENES if with_shared else ():
        scene, key = scene_of(name), Path(name).stem
        yield Room(key, scene, scanned(scene, folder / key / f"scan_{frames}", frames), True)


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
            new = SceneObject.box("microwave", size, center, category="microwave")
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
    found = instance_boxes(cloud, instances, room)
    marks["boxes"] = time.perf_counter()
    pieces, _ = split_rows(found, cloud, frames, look)
    if len(pieces) > len(found):
        found = instance_boxes(cloud, pieces, room)
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


def judge(room: Room, found: list[Detection]) -> list[dict[str, Any]]:
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
        faces = hit and best is not None and not small
        rows.append({
            "shared": room.shared, "category": category, "overlap": score, "found": hit,
            "row": hit or max((share for _, share in pairs), default=0.0) >= COVERED,
            "labeled": label in ALIKE.get(category, {category}) if hit else None,
            "faces": face_errors(item, found[best or 0].box) if faces else [],
        })  # fmt: skip
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


def boxes(folder: Path, count: int = 20, frames: int = 50, shared: bool = False) -> None:
    """Measure box detection in scans of kitchens: recall, accuracy and time.

    Kitchens are generated, furnished with a table and a microwave where they fit, scanned by the
    synthetic scanner and stored in FOLDER; a second run only measures. An object counts as found if
    a box covers it with an intersection over union of at least 0.5 (furniture) or 0.25 (small
    objects), after rows of furniture are split by the fronts in the images.

    Args:
        folder: Folder of scenes and scans.
        count: Number of generated kitchens.
        frames: Number of images of a scan.
        shared: Also measure the shared kitchens, separately.
    """
    rows, seconds, look = [], [], FrontNetwork()
    for room in rooms(folder, count, frames, with_shared=shared):
        found, timing = detect(room.folder, look, ScanConfig())
        rows += judge(room, found)
        seconds.append(timing)
        print(f"{room.key:18s}", {k: round(v, 2) for k, v in timing.items()}, flush=True)
    for title, of_shared in (("built-in", False), ("shared", True)):
        print(title)
        for name, row in summary([row for row in rows if row["shared"] is of_shared]).items():
            figures = " ".join(f"{key} {value:.3f}" for key, value in row.items() if key != "count")
            print(f"  {name:16s} {row['count']:4d}  {figures}")
    # The first room includes loading the kernels.
    stages = {key: float(np.median([s[key] for s in seconds[1:] or seconds])) for key in seconds[0]}
    to_boxes = sum(spent for stage, spent in stages.items() if stage != "rows")
    print("median seconds", stages, "to boxes, before rows are cut:", to_boxes)


def walk(
    folder: Path, frames: tuple[int, ...] = (100, 1000), scene: str = "kitchen_small", seed: int = 0
) -> None:
    """Measure time and memory of `momapos scan` by the number of frames.

    Walks along one path with increasing numbers of frames, as with a 30 Hz camera, are stored in
    FOLDER; `momapos scan` reads each in a separate process.

    Args:
        folder: Folder of the scans.
        frames: Numbers of frames.
        scene: Scene.
        seed: Seed of the walk.
    """
    for number in frames:
        home = folder / f"{Path(scene).stem}_{number}_{seed}"
        scanned(load_scene(scene), home, number, seed)
        out = home.with_name(f"{home.name}_found") / "scene.json"
        words = ["scan", str(home), "--out", str(out), "--json"]
        status, took, busy, memory = child([sys.executable, "-m", "momapos", *words])
        if status:
            sys.exit(f"{home}: momapos scan ended with {status}")
        made = load_scene(out)
        joints = sum(len(item.model.joints) for item in made.objects)
        report = json.loads((out.parent / "scan_report.json").read_text())
        print(
            f"{number} frames, {report['frames']} of them read: {took:.1f} s, {busy:.1f} s of the "
            f"processor, {memory:.2f} GB at most; {len(made.objects)} objects, {joints} joints; "
            f"{'; '.join(report['notes'])}",
            flush=True,
        )


THINGS: tuple[tuple[str, str, tuple[int, int, int], tuple[str, ...]], ...] = (
    ("dining table", "table", (0, 454, 300), ("table",)),
    ("chair at the table's left end", "chair", (0, 241, 140), ("chair",)),
    ("chair before the cabinets", "chair", (280, 340, 272), ("chair",)),
    ("chair before the shelf", "chair", (340, 529, 186), ("chair",)),
    ("chair at the right end, its back", "chair", (400, 600, 290), ("chair",)),
    ("chair nearest to the camera, its back", "chair", (20, 441, 440), ("chair",)),
    ("white mug", "cup", (0, 383, 184), ("cup",)),
    ("patterned mug", "cup", (280, 570, 350), ("cup",)),
    ("left screen", "screen", (460, 410, 60), ("screen",)),
    ("right screen", "screen", (460, 587, 134), ("screen",)),
    ("magazines on the table", "other", (0, 450, 210), ("book",)),
    ("lunch box", "other", (360, 423, 265), ("box", "bowl")),
    ("wooden case on the worktop", "other", (140, 353, 88), ("box",)),
    ("books on the red shelf", "other", (280, 413, 128), ("book", "shelf")),
    ("base cabinets, left row", "other", (160, 330, 270), ("cabinet",)),
    ("base cabinets, back row", "other", (740, 330, 250), ("cabinet",)),
)
"""Description, group, image number and pixel, and correct names."""
APPLIANCES = {"fridge", "oven", "microwave", "dishwasher", "range hood", "toaster"}


def labels(shared: Path, detector: Path | None = None) -> None:
    """Compare the labels of objects in a real kitchen with a list made by a person.

    A pixel of the depth image identifies each listed object (the color image is shifted by about 20
    pixels). Its label is right if the box found there has one of the listed names, not named if it
    is "object", and wrong otherwise. The images show no appliances, so every object labeled as one
    is counted.

    Args:
        shared: Folder of redkitchen/ and models/.
        detector: ONNX file of an object detector.
    """
    file = detector or shared / "models" / "yolox_nano.onnx"
    for title, detect in (("by size", None), (f"by {file.stem}", YoloxDetector(file))):
        start = time.process_time()
        scan = read_scan(shared / "redkitchen")
        seen = survey(scan, replace(default_tools(), detect=detect))
        seconds = time.process_time() - start
        print(f"\n{title}: {len(scan.frames)} images to boxes in {seconds:.1f} s of processor time")
        print("   ", ", ".join(f"{name} {value:.1f}" for name, value in seen.timing.items()))
        report(seen)


def report(seen: Survey) -> None:
    """Print each listed object, the counts by group, and objects labeled as appliances."""
    counts: dict[str, Counter[str]] = {}
    for name, group, (number, u, v), labels in THINGS:
        item = found(seen, PixelOf(f"frame-{number:06d}", u, v))
        verdict = judged(item, labels)
        counts.setdefault(group, Counter())[verdict] += 1
        text = "nothing" if item is None else f"{item.name} ({item.label_from}, {item.score:.2f})"
        print(f"    {name:<40} {verdict:<10} {text}")
    for group, count in counts.items():
        print(f"    {group:<8} {', '.join(f'{n} {verdict}' for verdict, n in count.items())}")
    called = [item.name for item in seen.detections if item.label in APPLIANCES]
    print(f"    labeled as an appliance: {', '.join(called) or 'none'}")


def found(seen: Survey, where: PixelOf) -> Detection | None:
    """Return the detection at a pixel."""
    try:
        return pointed_at(where, seen.detections, seen.frames)
    except InputError:
        return None


def judged(item: Detection | None, labels: tuple[str, ...]) -> str:
    """Return whether a detection has one of the correct names."""
    if item is None:
        return "not found"
    return "right" if item.label in labels else "not named" if item.label == "object" else "wrong"


COLORS = ("#0072b2", "#d55e00", "#009e73", "#aa3377", "#7a5c00", "#4b4bc8")
MIN_VOLUME = 0.04
"""Smaller boxes are not drawn [m^3]."""
UNNAMED = ("object", "wall")
"""Labels that say nothing."""
NARROW = 0.45
"""Boxes that are narrower get an upright name [m]."""
CEILING = 2.1
"""Points above are not drawn from above [m]."""
MARGIN = 0.02
"""A part is in an image if all corners are within it by this share of its size [-]."""
IMAGES = 2
"""Largest number of images [-]."""


def drawn(modeled: Modeled) -> list[Detection]:
    """Return the large objects, the largest first."""
    found = [one.detection for one in modeled.decisions]
    large = [
        one for one in found if np.prod(one.box.size) >= MIN_VOLUME and one.label not in UNNAMED
    ]
    return sorted(large, key=lambda one: -float(np.prod(one.box.size)))


def corners(box: UprightBox, columns: tuple[int, int]) -> np.ndarray:
    """Return the outline of a box from above, or from the front [m]."""
    half = np.asarray(box.size) / 2
    axes = np.eye(3)
    axes[:2, :2] = box_axes(box.yaw)
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    points = np.asarray(box.center) + (signs * half) @ axes
    if columns == (0, 1):
        return points[[0, 2, 6, 4]][:, :2]
    low, high = points[:, list(columns)].min(0), points[:, list(columns)].max(0)
    return np.array([low, [high[0], low[1]], high, [low[0], high[1]]])


def draw_above(axes: Axes, modeled: Modeled) -> int:
    """Draw points, boxes and names from above; return the number of boxes."""
    points, colors = modeled.cloud.points, modeled.cloud.colors / 255.0
    shown = points[:, 2] < CEILING
    order = np.argsort(points[shown][:, 2])
    flat = points[shown][order][:, :2]
    axes.scatter(flat[:, 0], flat[:, 1], s=3.5, c=colors[shown][order], linewidths=0)
    objects = drawn(modeled)
    for k, one in enumerate(objects):
        outline, color = corners(one.box, (0, 1)), COLORS[k % len(COLORS)]
        axes.add_patch(Polygon(outline, fill=False, edgecolor=color, linewidth=3.5))
        upright = np.ptp(outline[:, 0]) < NARROW
        x, y = outline.mean(0).tolist()
        write(axes, (x, y), one.label, color, 90 * upright)
    axes.set_aspect("equal")
    axes.tick_params(labelsize=15)
    axes.set_xlabel("x [m]", fontsize=17)
    axes.set_ylabel("y [m]", fontsize=17)
    return len(objects)


def write(axes: Axes, at: tuple[float, float], text: str, color: str, turn: float = 0.0) -> None:
    """Write words on a light ground."""
    axes.text(
        *at, text, color=color, fontsize=15, rotation=turn, weight="bold", ha="center",
        va="center", bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 2.5},
    )  # fmt: skip


def on_face(face: Face, box: Sequence[float]) -> np.ndarray:
    """Return the corners of a rectangle on a face, in the world [m]."""
    left, top, right, bottom = box
    x = (np.array([left, right, right, left]) - 0.5) * face.width
    y = (0.5 - np.array([top, top, bottom, bottom])) * face.height
    return apply(face.T_world_face, np.column_stack([x, y, np.zeros(4)]))


def pixels(frame: Frame, points: np.ndarray) -> np.ndarray | None:
    """Project points; None if one is outside of the image."""
    seen = apply(np.linalg.inv(frame.T_world_camera), points) @ frame.intrinsics.T
    if (seen[:, 2] <= 0).any():
        return None
    at, size = seen[:, :2] / seen[:, 2:], np.array(frame.color.shape[1::-1])
    inside = (at > MARGIN * size).all() and (at < (1 - MARGIN) * size).all()
    return at if inside else None


def best_images(modeled: Modeled) -> list[Frame]:
    """Return the images that show the parts, each the most of those that the others do not."""
    left, chosen = parts(modeled), list[Frame]()
    while left and len(chosen) < IMAGES:

        def shown(frame: Frame, left: list[tuple[Decision, Part]] = left) -> float:
            return sum(area(frame, *one) for one in left)

        frame = max(modeled.frames, key=shown)
        chosen.append(frame)
        left = [one for one in left if area(frame, *one) == 0.0]
    return chosen


def parts(modeled: Modeled) -> list[tuple[Decision, Part]]:
    """Return all parts with their objects."""
    return [(one, part) for one in modeled.decisions if one.view for part in one.parts]


def area(frame: Frame, decision: Decision, part: Part) -> float:
    """Return the area of a part in an image, as its root [px]; 0 if it is not all inside."""
    assert decision.view is not None
    at = pixels(frame, on_face(decision.view.face, part.box))
    if (
        at is None
        or decision.view.face.outward
        @ (frame.T_world_camera[:3, 3] - decision.view.face.T_world_face[:3, 3])
        <= 0.0
    ):
        return 0.0
    x, y = at.T
    return float(np.sqrt(abs(x @ np.roll(y, 1) - y @ np.roll(x, 1)) / 2))


def draw_image(axes: Axes, frame: Frame, modeled: Modeled) -> None:
    """Draw an image, and the parts that it shows."""
    axes.imshow(frame.color)
    for k, (decision, part) in enumerate(parts(modeled)):
        if area(frame, decision, part) == 0.0 or decision.view is None:
            continue
        face, color = decision.view.face, COLORS[k % len(COLORS)]
        outline = pixels(frame, on_face(face, part.box))
        assert outline is not None
        axes.add_patch(Polygon(outline, fill=False, edgecolor=color, linewidth=4))
        handle = None if part.handle is None else pixels(frame, on_face(face, part.handle))
        if handle is not None:
            axes.add_patch(Polygon(handle, fill=False, edgecolor="white", linewidth=3))
        x, y = outline.mean(0).tolist()
        kind = part.kind.replace("_", "\n")
        write(axes, (x, y), f"{k + 1} {decision.detection.label}\n{kind}", color)
    axes.set_axis_off()


def figure(scan: Path, out: Path = Path("docs/images/redkitchen.png")) -> None:
    """Draw what momapos finds in a scan of a real kitchen: from above, and on its images.

    Large objects are drawn with their names from above. On the images that show most doors and
    drawers, these and their handles are drawn. They are also printed as rows of a table.

    Args:
        scan: A scan, such as 7-Scenes RedKitchen.
        out: PNG file.
    """
    with tempfile.TemporaryDirectory() as folder:
        result = scan_to_scene(read_scan(scan), Path(folder) / "scene.json")
    frames = best_images(result)
    layout = ConstrainedLayoutEngine(h_pad=0.15)  # less would cut a title
    sheet = Figure(figsize=(19.2, 6.8), dpi=100, layout=layout)
    above, *images = sheet.subplots(1, 1 + len(frames), width_ratios=[1.15] + [1.0] * len(frames))
    count = draw_above(above, result)
    above.set_title("from above", fontsize=22)
    for axes, frame in zip(images, frames, strict=True):
        draw_image(axes, frame, result)
        axes.set_title(f"image {frame.name}", fontsize=22)
    FigureCanvasAgg(sheet).print_png(str(out))
    print(f"{out}: {count} of {len(result.decisions)} objects drawn")
    for k, (decision, part) in enumerate(parts(result)):
        x, y, z = on_face(decision.view.face, part.box).mean(0) if decision.view else (0, 0, 0)
        print(f"| {k + 1} | {decision.detection.label} at ({x:.2f}, {y:.2f}, {z:.2f}) | "
              f"{part.kind} | {part.score:.2f} | {'yes' if part.handle else 'no'} |")  # fmt: skip


if __name__ == "__main__":
    commands(__doc__, boxes, walk, labels, figure)
