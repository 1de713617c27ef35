"""Build an articulated scene from a scan, one call per stage (MoMa-Pos, sections III-B, III-C)."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

from momapos.core import Clock, InputError, Stopwatch
from momapos.core.geometry import UprightBox, apply, bottom, to_local, top
from momapos.model.records import (
    ArticulationPredictor,
    Cloud,
    Detection,
    Detector,
    FaceImage,
    Frame,
    Front,
    Instance,
    Scan,
)

from .detection import LABELS, WITHOUT_DOORS, detect, relabeled, vote, with_given_labels
from .fusion import align_to_gravity, complete, fuse
from .modeling import decide, shows_handles
from .reconstruction import FrontNetwork, GivenModel, TemplatePredictor, build_scene
from .records import Decision, Found, Modeled, Progress, ScanConfig, Survey, Target, Tools, silent
from .segmentation import (
    MIN_POINTS,
    ClassicalSegmenter,
    boxes,
    boxes_in_images,
    drop_fragments,
    find_room,
    inside,
    named,
    pointed_at,
    wall_detections,
    with_coverage,
    without_duplicates,
)
from .views import KnownFront, split_row

if TYPE_CHECKING:
    from jaxtyping import Bool, Float


CELL = 0.05
"""Edge of a cell of the floor [m]."""
MAX_FLOOR = 100.0
"""Larger rooms have no start [m]."""
LOW, HIGH = 0.05, 1.5
"""Boxes between these heights are in the way [m]; hanging cabinets are above counters."""
RADII = (0.45, 0.35, 0.25)
"""Radii of bases that must be able to drive from the start, the first that works is used [m]."""
WALKED = 0.3
"""Cells this close to the path of the camera were walked over [m]."""
MAX_STEP = 1.5
"""Two images farther apart show no path between them [m]."""
ROOMY = 1.0
"""More clearance than this is no advantage [m]; bases and arms at home reach about as far."""

CENTRAL = 0.05
"""Clearance that one meter closer to the middle of the free floor is worth [-]."""


def start_place(
    boxes: Sequence[UprightBox], floor: Sequence[tuple[float, float]], frames: Sequence[Frame]
) -> tuple[float, float, float] | None:
    """Return a free place with much clearance that is connected to most of the room.

    Args:
        boxes: All objects and walls.
        floor: Corners of the scanned rectangle [m].
        frames: With poses in the upright world. If they were carried over no free floor of the
            room, any place is taken.

    Returns:
        x [m], y [m], yaw [rad]: where the nearest camera looked; None if the floor has no room.
    """
    low, high = np.min(floor, axis=0), np.max(floor, axis=0)
    if (high - low).max() > MAX_FLOOR or (high - low).min() < 2 * CELL:
        return None
    steps = [np.arange(a + CELL / 2, b, CELL) for a, b in zip(low, high, strict=True)]
    cells = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1)
    clearance = _clearance(cells, boxes)
    cameras = np.array([frame.T_world_camera[:3, 3] for frame in frames]).reshape(-1, 3)
    walked = _walked(cells, cameras[:, :2])
    for near, radius in product((walked, np.ones_like(walked)), RADII):
        label, count = ndimage.label(clearance > radius)
        area = np.bincount(label.ravel(), minlength=count + 1)
        area = np.where(np.bincount(label[near], minlength=count + 1) > 0, area, 0)[1:]
        if area.any():
            part = label == 1 + int(np.argmax(area))
            away = np.linalg.norm(cells - cells[part].mean(axis=0), axis=-1)
            value = np.minimum(clearance, ROOMY) - CENTRAL * away
            place = cells.reshape(-1, 2)[np.argmax(np.where(part & near, value, -np.inf))]
            return float(place[0]), float(place[1]), _yaw(place, frames)
    return None


def _clearance(
    cells: Float[np.ndarray, "x y 2"], boxes: Sequence[UprightBox]
) -> Float[np.ndarray, "x y"]:
    """Return the distance to the nearest box, or to the end of the floor [m]."""
    points = np.concatenate([cells.reshape(-1, 2), np.zeros((cells[..., 0].size, 1))], axis=1)
    free = np.ones(len(points), bool)
    for box in boxes:
        if bottom(box) < HIGH and top(box) > LOW:
            inside = np.abs(to_local(points, box)[:, :2]) <= box.size[:2] / 2
            free &= ~inside.all(axis=1)
    padded = np.pad(free.reshape(cells.shape[:2]), 1)
    return CELL * ndimage.distance_transform_edt(padded)[1:-1, 1:-1]


def _walked(
    cells: Float[np.ndarray, "x y 2"], path: Float[np.ndarray, "n 2"]
) -> Bool[np.ndarray, "x y"]:
    """Return the cells near the path of the camera."""
    if not len(path):
        return np.zeros(cells.shape[:2], bool)
    parts = np.linspace(0.0, 1.0, int(MAX_STEP / WALKED) + 1)
    between = path[:-1, None] + parts[:, None] * np.diff(path, axis=0)[:, None]
    short = np.linalg.norm(np.diff(path, axis=0), axis=1) <= MAX_STEP
    places = np.concatenate([path, between[short].reshape(-1, 2)])
    low = cells[0, 0] - CELL / 2
    index = np.floor((places - low) / CELL).astype(int)
    index = index[((index >= 0) & (index < cells.shape[:2])).all(axis=1)]
    away = np.ones(cells.shape[:2], bool)
    away[tuple(index.T)] = False
    if away.all():
        return ~away
    return CELL * ndimage.distance_transform_edt(away) <= WALKED


def _yaw(place: Float[np.ndarray, "2"], frames: Sequence[Frame]) -> float:
    if not frames:
        return 0.0
    nearest = min(frames, key=lambda f: float(np.hypot(*(f.T_world_camera[:2, 3] - place))))
    x, y = nearest.T_world_camera[:2, 2]
    return float(np.arctan2(y, x))


def detections_of(
    frames: Sequence[Frame], detector: Detector | None, found: Found | None
) -> tuple[Found | None, frozenset[str]]:
    """Return the 2-D detections in all images, and the labels that their detector knows.

    Args:
        frames: In the upright world.
        detector: Runs on every image if `found` is None.
        found: Detections of another program, by frame name.
    """
    if found is not None or detector is None:
        return found, LABELS
    return detect(frames, detector), detector.labels


def with_labels(
    objects: Sequence[Detection],
    cloud: Cloud,
    frames: Sequence[Frame],
    found: Found | None,
    known: frozenset[str],
    given: Mapping[str, str] | None,
    opens: Callable[[Detection], bool],
) -> list[Detection]:
    """Label the objects of a scan, the most reliable source first.

    Args:
        objects: With labels by size and segmenter.
        cloud: In the upright world.
        frames: In the upright world.
        found: 2-D detections by frame name.
        known: Labels that the detector of `found` knows.
        given: Labels from the user, by the objects' default names.
        opens: Checks whether an object shows doors or drawers with handles. A detector's label
            without doors, such as a bed, is ignored for such an object.

    Raises:
        UnknownNameError, InputError: A given label names no object, or is empty.
    """
    if found is not None:
        looked_at = [frame for frame in frames if frame.name in found]
        verdicts = vote(objects, cloud, looked_at, found)
        verdicts = [
            replace(verdict, label="", confidence=0.0, hits=0)
            if verdict.label in WITHOUT_DOORS and opens(item)
            else verdict
            for verdict, item in zip(verdicts, objects, strict=True)
        ]
        objects = relabeled(objects, verdicts, known)
    objects = named(objects)
    return named(with_given_labels(objects, given)) if given else list(objects)


BUILDING = ("wall", "floor", "ceiling", "window", "door")
"""Segmenter labels that are part of the building, not furniture."""
DEFAULT = ScanConfig()


def default_tools() -> Tools:
    """Return tools that need no external models: the classical segmenter and our own network.

    Raises:
        MissingExtraError: onnxruntime is not installed.
    """
    network = FrontNetwork()
    return Tools(ClassicalSegmenter(), network, network, TemplatePredictor())


def survey(
    scan: Scan,
    tools: Tools,
    *,
    found: Found | None = None,
    labels: Mapping[str, str] | None = None,
    config: ScanConfig = DEFAULT,
    progress: Progress = silent,
    clock: Clock = time.perf_counter,
) -> Survey:
    """Find the objects of a scanned room; the arguments are those of `momapos.scan_to_scene`.

    Raises:
        InputError: The scan is empty or shows no objects.
    """
    watch = Stopwatch(clock)
    with watch.stage("fuse"):
        progress("fusing depth images", 0.0)
        cloud = scan.cloud or fuse(scan.frames, config.voxel, config.fusion)
    with watch.stage("boxes"):
        progress("finding objects", 0.2)
        T = align_to_gravity(cloud, scan.frames, scan.up)
        turned = _said_up(scan, T)
        cloud, frames = _transformed(cloud, scan.frames, T)
        measured = len(cloud.points)
        room = find_room(cloud)
        walls = [(wall.axis, wall.offset) for wall in room.walls]
        cloud = complete(cloud, frames, walls, config.voxel)
        given = boxes_in_images(found or {}, frames)
        read = given or tools.segment(cloud)
        single = without_duplicates(read, len(cloud.points))
        instances = [item for item in single if item.label not in BUILDING]
        detections = boxes(cloud, instances, room)
        lost = {
            "masks that repeat another": len(read) - len(single),
            "parts of the building": len(single) - len(instances),
            f"with fewer than {MIN_POINTS} points": len(instances) - len(detections),
        }
    with watch.stage("rows"):
        progress("splitting rows of cabinets", 0.3)
        instances, rows = split_rows(detections, cloud, frames, tools.look)
        if len(instances) > len(detections):
            detections = boxes(cloud, instances, room)
        detections = drop_fragments(detections, cloud)
    if not detections:
        raise InputError(f"{scan.name}: the scan shows only floor and walls; no object was found")
    boards = wall_detections(room)
    with watch.stage("labels"):
        progress("labeling objects", 0.35)
        detected, names = detections_of(frames, tools.detect, found)
        own = isinstance(tools.segment, ClassicalSegmenter) and not given
        said = turned if own else (*turned, *_said(lost, len(read)))
        located = detected if config.views == "first" else found
        seen = Survey(
            cloud, frames, T @ _to_origin(scan), room, tuple(detections), tuple(boards),
            tuple(rows), located, watch.seconds, said,
        )  # fmt: skip
        detections = with_labels(
            detections, cloud, frames, detected, names, labels,
            lambda item: shows_handles(item, seen, tools, config),
        )  # fmt: skip
        detections = with_coverage(detections, cloud, boards, measured)
    return replace(seen, detections=tuple(detections))


def model_room(
    seen: Survey,
    out: Path,
    tools: Tools,
    *,
    scores: Mapping[str, float] | None = None,
    alpha: float = 0.0,
    known: Mapping[str, Decision] | None = None,
    given: Mapping[str, GivenModel] | None = None,
    config: ScanConfig = DEFAULT,
    progress: Progress = silent,
    clock: Clock = time.perf_counter,
) -> Modeled:
    """Model the important objects of a surveyed room, and write the scene.

    Args:
        seen: The surveyed room.
        out: Scene file to write; URDF files go into a folder next to it.
        tools: Predictors.
        scores: Importance of objects by name; objects without a score are modeled.
        alpha: Objects of lower importance stay boxes [-].
        known: Earlier decisions; examined objects are not examined again.
        given, config, progress, clock: As for `scan_to_scene`.
    """
    watch, scores, known = Stopwatch(clock), scores or {}, known or {}
    decisions: list[Decision] = []
    with watch.stage("model"):
        for k, item in enumerate(seen.detections):
            progress(item.name, 0.4 + 0.6 * k / len(seen.detections))
            at, score, decision = clock(), scores.get(item.name), known.get(item.name)
            if decision is not None and decision.looked:
                decisions.append(decision)
            elif score is not None and score < alpha:
                reason = f"importance {score:.2f} is below alpha {alpha:.2f}"
                decisions.append(Decision(item, score, None, (), None, reason, looked=False))
            else:
                decision = decide(item, score, seen, tools, given or {}, config)
                decisions.append(replace(decision, seconds=clock() - at))
        decisions += [Decision(wall, None, None, (), None, "wall") for wall in seen.walls]
    with watch.stage("write"):
        models = {d.detection.name: d.model for d in decisions if d.model is not None}
        floor = floor_outline(seen.cloud)
        start = start_place([d.detection.box for d in decisions], floor, seen.frames)
        build_scene([d.detection for d in decisions], models, floor, out, start=start)
    timing = {**seen.timing, **watch.seconds}
    timing["total"] = sum(timing.values())
    return Modeled(
        out, seen.cloud, seen.frames, seen.T_scene_scan, tuple(decisions), timing,
        warnings=seen.warnings,
    )  # fmt: skip


# ----------------------------------------------------------------------------- geometry of the room


def _transformed(
    cloud: Cloud, frames: Sequence[Frame], T: Float[np.ndarray, "4 4"]
) -> tuple[Cloud, tuple[Frame, ...]]:
    turned = apply(T, cloud.points), cloud.normals @ T[:3, :3].T
    upright_cloud = replace(cloud, points=turned[0], normals=turned[1])
    return upright_cloud, tuple(replace(f, T_world_camera=T @ f.T_world_camera) for f in frames)


def _to_origin(scan: Scan) -> Float[np.ndarray, "4 4"]:
    """Return the transform from the recording's frame to that of the scan, which may be moved."""
    T = np.eye(4)
    T[:3, 3] = 0.0 if scan.origin is None else -scan.origin
    return T


def _said_up(scan: Scan, T: Float[np.ndarray, "4 4"]) -> tuple[str, ...]:
    """Return one line if a cloud without cameras is turned; none if its z axis is up."""
    if scan.frames or scan.up is not None or T[2, 2] > 0.5:
        return ()
    axis = int(np.argmax(np.abs(T[2, :3])))
    sign = "-" if T[2, axis] < 0 else ""
    return (f"{scan.name}: {sign}{'xyz'[axis]} is taken for up; --up states another axis",)


def _said(lost: Mapping[str, int], count: int) -> tuple[str, ...]:
    """Return one line about instances that are no objects of the scene; none if all are."""
    parts = ", ".join(f"{number} {why}" for why, number in lost.items() if number)
    return (f"dropped {sum(lost.values())} of {count} instances: {parts}",) if parts else ()


def split_rows(
    detections: Sequence[Detection],
    cloud: Cloud,
    frames: Sequence[Frame],
    look: ArticulationPredictor,
) -> tuple[list[Instance], list[KnownFront]]:
    """Split rows of furniture between their fronts.

    Args:
        detections: Objects with their boxes.
        cloud: In the upright world.
        frames: In the upright world.
        look: Finds the parts on a face.

    Returns:
        All objects, where pieces of split rows have no label yet; and the fronts of these rows.
    """
    instances: list[Instance] = []
    before: list[KnownFront] = []
    for item in detections:

        def seen(face: FaceImage, label: str = item.label) -> Front:
            return look(face, label)

        pieces, front = split_row(item.box, frames, seen)
        before += [front] if front is not None else []
        if len(pieces) == 1:
            instances.append(Instance(item.label, item.score, item.members, item.box, item.guesses))
            continue
        for box in pieces:
            members = item.members[inside(cloud.points[item.members], box)]
            instances.append(Instance("", 1.0, members, box))
    return instances, before


def floor_outline(cloud: Cloud) -> list[tuple[float, float]]:
    """Return the scanned rectangle in the floor plane [m]."""
    (x0, y0), (x1, y1) = np.percentile(cloud.points[:, :2], [0.2, 99.8], axis=0).tolist()
    return [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]


# --------------------------------------------------------------------------------------- the target


def name_of(target: Target, seen: Survey) -> str:
    """Return the name of a target, which may be a point or a pixel.

    Raises:
        InputError: No object is at that point or pixel.
    """
    if isinstance(target, str):
        return target
    return pointed_at(target, seen.detections, seen.frames).name
