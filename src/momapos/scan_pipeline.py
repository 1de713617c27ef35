"""From a scan to a scene that moves, one call a stage (MoMa-Pos, sections III-B and III-C)."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.errors import InputError
from momapos.fusion.gravity import GravityConfig, align_to_gravity
from momapos.fusion.tsdf import FusionConfig, fuse
from momapos.geometry.transforms import apply, pose, rotation_about
from momapos.importance.config import ImportanceConfig
from momapos.importance.rank import rank
from momapos.kinematics.articulated import Articulated
from momapos.kinematics.urdf import box_urdf
from momapos.protocols import ArticulationPredictor, Clock, Segmenter
from momapos.reconstruction.build import GivenModel, build_scene, place_model
from momapos.reconstruction.model import ModelConfig, furniture_model
from momapos.reconstruction.network import FrontNetwork
from momapos.reconstruction.templates import TemplatePredictor
from momapos.scene.library.furniture import Piece
from momapos.scene.scene import Scene, SceneObject
from momapos.segmentation.boxes import (
    BoxConfig,
    boxes,
    inside,
    named,
    wall_detections,
    without_pieces,
)
from momapos.segmentation.room import Room, RoomConfig, at_wall, find_room
from momapos.segmentation.segmenter import ClassicalSegmenter
from momapos.types import (
    Cloud,
    Detection,
    FaceImage,
    Frame,
    Front,
    ImageDetection,
    Instance,
    Part,
    Scan,
    UprightBox,
)
from momapos.views.faces import box_faces, stands_free
from momapos.views.front_view import Seen, View, ViewConfig, choose_view
from momapos.views.projection import sights, vote_label
from momapos.views.rows import RowConfig, split_row

if TYPE_CHECKING:
    from jaxtyping import Float

Progress = Callable[[str, float], None]
"""Told what is at work, and the share of the whole that is done."""
Found = Mapping[str, Sequence[ImageDetection]]
"""What a 2-D detector found, by the frame's name."""

BUILDING = ("wall", "floor", "ceiling", "window", "door")
"""Labels of segmenters for what is no furniture."""


@dataclass(frozen=True)
class ScanConfig:
    """How a scan becomes a scene."""

    voxel: float = 0.015
    """Edge of the voxels that depth images are fused in [m]."""
    least_sides: tuple[float, float] = (0.1, 0.2)
    """Things whose shortest or middle edge is shorter than this have no doors or drawers [m]."""
    fusion: FusionConfig = field(default_factory=FusionConfig)
    gravity: GravityConfig = field(default_factory=GravityConfig)
    room: RoomConfig = field(default_factory=RoomConfig)
    boxes: BoxConfig = field(default_factory=BoxConfig)
    rows: RowConfig = field(default_factory=RowConfig)
    view: ViewConfig = field(default_factory=ViewConfig)
    importance: ImportanceConfig = field(default_factory=ImportanceConfig)
    """Which objects are modeled when a target is named."""
    model: ModelConfig = field(default_factory=ModelConfig)


@dataclass(frozen=True, eq=False)
class Tools:
    """The parts that can be exchanged."""

    segment: Segmenter
    look: ArticulationPredictor
    """Tells fronts from other faces, and where a row is to be cut."""
    predict: ArticulationPredictor
    """Finds the parts of an object; often the same as `look`."""
    guess: ArticulationPredictor | None = None
    """Asked where `predict` sees a front but no parts on it."""


def default_tools() -> Tools:
    """What works without anything from elsewhere: no trained segmenter, our own network.

    Raises:
        MissingExtraError: onnxruntime is not installed.
    """
    network = FrontNetwork()
    return Tools(ClassicalSegmenter(), network, network, TemplatePredictor())


class PartSource(StrEnum):
    """Where the parts of an object are from."""

    PREDICTED = "predicted"
    """Seen on the images."""
    GUESSED = "guessed"
    """From a template, for a front on which nothing was seen."""
    GIVEN = "given"
    """A URDF file of the user's."""


@dataclass(frozen=True, eq=False)
class Decision:
    """What was decided about one object, and why."""

    detection: Detection
    importance: float | None
    """Score against the target; None where no target was named."""
    view: View | None
    """Its front; None where it was not looked for, or none was seen."""
    parts: tuple[Part, ...]
    source: PartSource | None
    """Where the parts are from; None for a box."""
    reason: str
    """Why it stays a box; "" where it is modeled."""
    seconds: float = 0.0
    model: Piece | SceneObject | None = None
    """What stands in the scene; None for a box."""
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Modeled:
    """A scene made from a scan, with all that was decided on the way."""

    scene: Path
    cloud: Cloud
    """The room, upright."""
    frames: tuple[Frame, ...]
    """The images, with poses in the upright world."""
    T_scene_scan: Float[np.ndarray, "4 4"]
    decisions: tuple[Decision, ...]
    timing: Mapping[str, float] = field(default_factory=dict)
    """Seconds by stage, and "total"."""


def scan_to_scene(
    scan: Scan,
    out: Path,
    tools: Tools | None = None,
    *,
    target: str | None = None,
    found: Found | None = None,
    given: Mapping[str, GivenModel] | None = None,
    config: ScanConfig | None = None,
    progress: Progress | None = None,
    clock: Clock = time.perf_counter,
) -> Modeled:
    """Make a scene whose doors and drawers open from a scan of a room.

    Args:
        scan: Posed images, a cloud, or both.
        out: The scene file to write; URDF files go into a folder beside it.
        tools: Segmenter and predictors; `default_tools` by default.
        target: Object that the task will be about: only what matters for it is modeled. By
            default everything is that has a front.
        found: What a 2-D detector found in the images; projected boxes by default.
        given: URDF files for objects by name or label, which need no prediction.
        config: How every stage works.
        progress: Told what goes on.
        clock: Measures the stages.

    Raises:
        InputError: The scan holds nothing, or no object has the target's name.
    """
    tools = tools or default_tools()
    config, progress = config or ScanConfig(), progress or _silent
    began, marks = clock(), {}
    progress("fusing", 0.0)
    cloud = scan.cloud or fuse(scan.frames, config.voxel, config.fusion)
    marks["fuse"] = clock()
    progress("finding objects", 0.2)
    T = align_to_gravity(cloud, scan.frames, config.gravity)
    cloud, frames = _turned(cloud, scan.frames, T)
    room = find_room(cloud, config.room)
    things = [item for item in tools.segment(cloud) if item.label not in BUILDING]
    detections = boxes(cloud, things, room, config.boxes)
    marks["boxes"] = clock()
    progress("dividing rows", 0.3)
    instances, before = divide(detections, cloud, frames, tools.look, config)
    if len(instances) > len(detections):
        detections = boxes(cloud, instances, room, config.boxes)
    detections = without_pieces(detections, cloud)
    if found is not None:
        detections = [_relabeled(item, frames, found) for item in detections]
    detections = named(detections)
    marks["rows"] = clock()
    if not detections:
        raise InputError(f"{scan.name}: nothing was found in the scan but floor and walls")
    scores = importance(detections, target, config)
    walls = wall_detections(room, config.boxes)
    solids = [item.box for item in [*detections, *walls]]
    decisions: list[Decision] = []
    for k, item in enumerate(detections):
        progress(item.name, 0.4 + 0.6 * k / len(detections))
        at = clock()
        score = scores.get(item.name)
        others = [box for box in solids if box is not item.box]
        decision = _decide(
            item, score, frames, before, room, others, tools, found, given or {}, config
        )
        decisions.append(replace(decision, seconds=clock() - at))
    marks["model"] = clock()
    decisions += [Decision(wall, None, None, (), None, "a wall") for wall in walls]
    models = {d.detection.name: d.model for d in decisions if d.model is not None}
    build_scene([d.detection for d in decisions], models, floor_outline(cloud), out)
    marks["write"] = clock()
    timing = dict(zip(marks, np.diff([began, *marks.values()]).tolist(), strict=True))
    timing["total"] = clock() - began
    return Modeled(out, cloud, frames, T, tuple(decisions), timing)


def _silent(what: str, share: float) -> None:
    del what, share


# ----------------------------------------------------------------------------------- what is where


def _turned(
    cloud: Cloud, frames: Sequence[Frame], T: Float[np.ndarray, "4 4"]
) -> tuple[Cloud, tuple[Frame, ...]]:
    """Everything in the upright world."""
    upright_cloud = Cloud(apply(T, cloud.points), cloud.normals @ T[:3, :3].T, cloud.colors)
    return upright_cloud, tuple(replace(f, T_world_camera=T @ f.T_world_camera) for f in frames)


def divide(
    detections: Sequence[Detection],
    cloud: Cloud,
    frames: Sequence[Frame],
    look: ArticulationPredictor,
    config: ScanConfig,
) -> tuple[list[Instance], list[Seen]]:
    """Cut rows of furniture between their fronts.

    Returns:
        All things, the pieces of rows without a label yet; and what was seen on the rows.
    """
    instances: list[Instance] = []
    before: list[Seen] = []
    for item in detections:

        def seen(face: FaceImage, label: str = item.label) -> Front:
            return look(face, label)

        pieces, front = split_row(item.box, frames, seen, config.rows, config.view)
        before += [front] if front is not None else []
        if len(pieces) == 1:
            instances.append(Instance(item.label, item.score, item.members, item.box))
            continue
        for box in pieces:
            members = item.members[inside(cloud.points[item.members], box)]
            instances.append(Instance("", 1.0, members, box))
    return instances, before


def _relabeled(item: Detection, frames: Sequence[Frame], found: Found) -> Detection:
    """A 2-D detector that was trained on images knows better what a thing is."""
    return replace(item, label=vote_label(item.box, frames, found) or item.label)


def floor_outline(cloud: Cloud) -> list[tuple[float, float]]:
    """The rectangle that was scanned, seen from above [m]."""
    (x0, y0), (x1, y1) = np.percentile(cloud.points[:, :2], [0.2, 99.8], axis=0).tolist()
    return [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]


# ----------------------------------------------------------------------------------- what matters


def importance(
    detections: Sequence[Detection], target: str | None, config: ScanConfig
) -> dict[str, float]:
    """Scores of all objects against the target, from their boxes alone; none without a target.

    Raises:
        UnknownNameError: No object has that name.
    """
    if target is None:
        return {}
    room = Scene("scan", tuple(_boxed(item) for item in detections))
    ranked = rank(room, target, config.importance)
    return dict(zip(ranked.names, map(float, ranked.scores), strict=True))


def _boxed(item: Detection) -> SceneObject:
    x, y, z = map(float, item.box.size)
    model = Articulated(box_urdf(item.name, (x, y, z)))
    R = rotation_about(np.array([0.0, 0.0, 1.0]), item.box.yaw)
    return SceneObject(item.name, item.label, pose(item.box.center, R), model)


# ------------------------------------------------------------------------------------ how it moves


def _decide(
    item: Detection,
    score: float | None,
    frames: Sequence[Frame],
    before: Sequence[Seen],
    room: Room,
    others: Sequence[UprightBox],
    tools: Tools,
    found: Found | None,
    given: Mapping[str, GivenModel],
    config: ScanConfig,
) -> Decision:
    """Look at one object, and model it if it matters and has a front."""
    alpha = config.importance.alpha
    box = Decision(item, score, None, (), None, "")
    if score is not None and score < alpha:
        return replace(box, reason=f"importance {score:.2f} is below alpha {alpha:.2f}")
    if (np.sort(item.box.size)[:2] < config.least_sides).any():
        return replace(box, reason="too small for doors or drawers")

    def look(face: FaceImage) -> Front:
        return tools.look(face, item.label)

    seen = sights(item.box, frames, found)
    faces = box_faces(item.box)
    sides = [at_wall(room, face.T_world_face[:3, 3], face.outward) for face in faces]
    backed = [sides[face.opposite] for face in faces]
    view = choose_view(item.box, frames, seen, look, config.view, before, backed)
    if view is None:
        return replace(box, reason="no image shows a front")
    facing = float(np.arctan2(view.face.outward[1], view.face.outward[0]))
    own = given.get(item.name, given.get(item.label))
    if own is not None:
        model, warnings = place_model(item, facing, own)
        return replace(box, view=view, source=PartSource.GIVEN, model=model, warnings=warnings)
    parts, source = _parts(view, item.label, tools)
    if not parts:
        return replace(box, view=view, reason="a front without doors or drawers")
    left, right = (stands_free(faces[k], others) for k in view.face.beside)
    piece = furniture_model(item, facing, view.image, parts, config.model, free=(left, right))
    return replace(box, view=view, parts=parts, source=source, model=piece)


def _parts(view: View, label: str, tools: Tools) -> tuple[tuple[Part, ...], PartSource]:
    """Doors and drawers of a front, and where they are from."""
    same = tools.predict is tools.look
    parts = view.front.parts if same else tools.predict(view.image, label).parts
    if parts or tools.guess is None:
        return parts, PartSource.PREDICTED
    return tools.guess(view.image, label).parts, PartSource.GUESSED
