"""momapos scan: build an articulated scene from a scan of a room."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Optional

from tyro.conf import Positional, arg

from momapos.core import InputError

from .configuration import (
    NO_SETTINGS,
    AlphaOption,
    ConfigArgs,
    ScanSettings,
    ScorerOption,
    load_config,
)
from .loading import print_warnings
from .options import Flag, LabelsArg, Number, OptionalFile, Text, optional

if TYPE_CHECKING:
    from momapos.model.records import ArticulationPredictor, Detector, Scan, Segmenter
    from momapos.perception import Found, Modeled, ScanConfig, Target, Tools
    from momapos.perception.reconstruction import GivenModel, SeenMotion

Predictor = Literal["network", "template", "urdformer"]


SETTINGS = ("importance", "scan")
"""Fields and tables of a configuration that the command uses."""


@dataclass(frozen=True)
class ScanOptions:
    """What is known about a scan, and what interprets it."""

    instances: OptionalFile = None
    """Instances from another program: Mask3D, OpenMask3D, labels per point, or boxes (JSON)."""
    detections: OptionalFile = None
    """Detections in the images, as Detectron2's coco_instances_results.json."""
    detector: Annotated[Text, optional("DETECTOR")] = None
    """Detector that labels objects: a YOLOX ONNX file, or a name of `momapos models list`."""
    label: LabelsArg = ()
    """Set the label of an object, by the name that it has without this option."""
    predictor: Predictor = "network"
    """What finds doors and drawers: our network, a template for each label, or URDFormer."""
    checkpoint: OptionalFile = None
    """URDFormer's part.pth."""
    models: Annotated[
        tuple[str, ...], arg(metavar="[NAME=FILE.urdf ...]", help_behavior_hint="")
    ] = ()
    """Known models of objects, by name or label; they need no prediction."""
    max_frames: int = 150
    """Maximum number of images, evenly spaced."""
    depth_scale: Annotated[Number, optional("UNITS")] = None
    """Units of integer depth per meter (default: 5000 in TUM's folders, else 1000)."""

    def __post_init__(self) -> None:
        if self.depth_scale is not None and not 1e-6 <= self.depth_scale <= 1e9:
            raise InputError(
                f"--depth-scale must be between 1e-6 and 1e9, not {self.depth_scale:g}"
            )
        if not 1 <= self.max_frames <= 100_000:
            raise InputError(f"--max-frames must be between 1 and 100000, not {self.max_frames}")


ScanArgs = Annotated[ScanOptions, arg(name="")]
DEFAULT = ScanOptions()


def scan_room(
    source: Annotated[Positional[Path], arg(metavar="DIR")],
    /,
    *,
    out: Annotated[Path, arg(metavar="FILE")],
    after: Annotated[Optional[Path], optional("DIR")] = None,  # noqa: UP045
    target: Annotated[Text, optional("OBJECT")] = None,
    target_at: Annotated[Text, optional("X,Y,Z")] = None,
    target_pixel: Annotated[Text, optional("FRAME,U,V")] = None,
    alpha: AlphaOption = None,
    scorer: ScorerOption = None,
    pictures: Flag = True,
    json: Flag = False,
    options: ScanArgs = DEFAULT,
    settings: ConfigArgs = NO_SETTINGS,
) -> int:
    """Build a scene from a scan of a room, for `momapos place`.

    scan_report.json, next to the scene, explains the decisions.

    Args:
        source: Folder of posed color and depth images, a point cloud, or a robot's recording.
        out: The scene file.
        after: A second scan after doors or drawers were opened: shows how they move; the scene has
            them open.
        target: The object of the task: only objects that matter for it are modeled.
        target_at: The same, by a point in the object in the scene's frame [m].
        target_pixel: The same, by a pixel of an image: name of the frame, column, row.
        alpha: Objects of lower importance for the target stay boxes, in [0, 1].
        scorer: Importance score: reach, deepwalk, distance, size or names, see `momapos rank`.
        pictures: Don't draw an image for each object that explains its model.
        json: Print the report as one JSON object, and nothing else.
        options: What is known about the scan.
        settings: Further settings.
    """
    import json as encoder

    from momapos.core import check_outputs
    from momapos.workflows import scan_to_scene

    from .console import progress
    from .scan_report import outputs_of, report_to_dict, write_report

    configuration = load_config(settings, SETTINGS, scorer=scorer, alpha=alpha)
    config = scan_config(options, configuration.scan)
    given, labels = given_models(options), given_labels(options)
    wanted, detector = find_target(target, target_at, target_pixel), detector_of(options)
    check_outputs(*outputs_of(out, pictures=pictures))
    scan = read(source, options, configuration.scan)
    later = None if after is None else read(after, options, configuration.scan)
    tools, found = tools_for(scan, options, detector), found_in(scan, options)
    with progress("scan") as report:
        result = scan_to_scene(
            scan, out, tools, target=wanted, after=later, found=found, labels=labels, given=given,
            config=config, importance=configuration.importance,
            progress=lambda what, share: report(share, what),
        )  # fmt: skip
    print_warnings(text for decision in result.decisions for text in decision.warnings)
    if later is not None and not any(decision.moved for decision in result.decisions):
        print(f"momapos: {after}: no part moved since {source}", file=sys.stderr)
    data = report_to_dict(result, scan, result.target)
    folder = write_report(result, data, out, pictures=pictures)
    print(encoder.dumps(data, allow_nan=False) if json else table(result, data, out, folder))
    return 0


def table(result: Modeled, data: dict[str, Any], out: Path, folder: Path | None) -> str:
    """Tabulate all objects, and what to scan again."""
    width = max(len(d.detection.name) for d in result.decisions)
    lines = []
    for decision in result.decisions:
        item = decision.detection
        size = " x ".join(f"{v:.2f}" for v in item.box.size)
        x, y, z = item.box.center
        what = decision.reason or f"{decision.source}: {_count(decision.parts)}"
        seen = "   -" if item.seen is None else f"{item.seen:4.0%}"
        lines.append(
            f"  {item.name:<{width}}  {size} m at ({x:.2f}, {y:.2f}, {z:.2f})  seen {seen}  {what}"
        )
    lines += [
        f"  {d.detection.name}/{name}  opened by {_amount(motion)}, as a {motion.kind}"
        for d in result.decisions
        for name, motion in d.moved.items()
    ]
    modeled = sum(d.model is not None for d in result.decisions)
    stages = ", ".join(f"{n} {s:.1f}" for n, s in result.timing.items() if n != "total")
    lines += [
        "",
        f"  {len(result.decisions)} objects, {modeled} modeled with joints",
        *(f"  scan        {note}" for note in data["notes"]),
        f"  time        {result.timing['total']:.1f} s ({stages})",
        f"  scene       {out}",
        f"  report      {out.parent / 'scan_report.json'}",
    ]
    if folder is not None:
        lines.append(f"  images      {folder}")
    if data["scan_again"]:
        lines += ["", "  scan again (positions in the scene's frame):"]
    for one in data["scan_again"]:
        stand, look = (", ".join(f"{v:.1f}" for v in one[key]) for key in ("position", "look_at"))
        lines.append(
            f"    {one['object']:<{width}}  from ({stand}) toward ({look}): {one['reason']}"
        )
    return "\n".join(lines)


def _amount(seen: SeenMotion) -> str:
    if seen.kind == "drawer":
        return f"{100 * seen.value:.0f} cm"
    return f"{math.degrees(seen.value):.0f} deg"


def _count(parts: tuple[Any, ...]) -> str:
    kinds = [part.kind for part in parts]
    return ", ".join(f"{kinds.count(kind)} {kind}" for kind in dict.fromkeys(kinds)) or "a model"


# ---------------------------------------------------------------------------------- from options


def read(source: Path, options: ScanOptions, settings: ScanSettings) -> Scan:
    """Read a scan and print its warnings."""
    from momapos.perception.recordings import BagTopics, read_scan

    topics = BagTopics(
        settings.depth_topic, settings.color_topic, settings.info_topic, settings.fixed_frame
    )
    scan = read_scan(
        source, max_frames=options.max_frames, depth_scale=options.depth_scale, topics=topics
    )
    print_warnings(scan.warnings)
    return scan


def scan_config(options: ScanOptions, settings: ScanSettings) -> ScanConfig:
    """Build the configuration of the perception.

    Raises:
        InputError: URDFormer is chosen without its weights.
    """
    from momapos.perception import ScanConfig
    from momapos.perception.reconstruction import ModelConfig

    if options.predictor == "urdformer" and options.checkpoint is None:
        raise InputError("--predictor urdformer needs --checkpoint PATH/part.pth")
    return ScanConfig(
        voxel=settings.voxel,
        views=settings.views,
        model=ModelConfig(grid=12 if settings.grid else None),
    )


def tools_for(scan: Scan, options: ScanOptions, detector: Detector | None) -> Tools:
    """Choose what segments, predicts and detects."""
    from momapos.perception import default_tools

    tools = replace(default_tools(), detect=detector)
    predict: ArticulationPredictor = tools.predict
    if options.predictor == "template":
        assert tools.guess is not None
        predict = tools.guess
    elif options.predictor == "urdformer":
        from momapos.perception.reconstruction import UrdformerPredictor, load_urdformer

        assert options.checkpoint is not None, "scan_config checks it"
        predict = UrdformerPredictor(load_urdformer(options.checkpoint), tools.look)
    segment = tools.segment if options.instances is None else _reader(scan, options.instances)
    return replace(tools, segment=segment, predict=predict)


def _reader(scan: Scan, path: Path) -> Segmenter:
    """Build a segmenter that reads instances from a file."""
    from momapos.model.records import Cloud, Instance
    from momapos.perception.recordings import read_instances

    def read(cloud: Cloud) -> list[Instance]:
        if scan.cloud is None and path.suffix != ".json":
            raise InputError(
                f"{path}: masks need a scan with a point cloud, and {scan.name} has none"
            )
        return read_instances(path, len(cloud.points))

    return read


def stand_ins(options: ScanOptions) -> dict[str, str]:
    """Return what does the work of each network of MoMa-Pos, section III-B, by its name."""
    projected = "projections of the 3-D boxes"
    detections = options.detections or options.detector
    predictors: dict[Predictor, str] = {
        "network": "momapos' front networks",
        "template": "templates by label",
        "urdformer": f"URDFormer ({options.checkpoint}), on part boxes of momapos' networks",
    }
    return {
        "Detectron2": projected if detections is None else f"{detections}, else {projected}",
        "ResNet50": "camera poses and momapos' front network",
        "URDFormer": predictors[options.predictor],
        "Mask3D": "momapos' segmentation" if options.instances is None else str(options.instances),
    }


def given_models(options: ScanOptions) -> dict[str, GivenModel]:
    """Parse the models of objects, by name or label.

    Raises:
        InputError: One is not NAME=FILE, or there is no such file.
    """
    from momapos.perception.reconstruction import GivenModel

    given = {}
    for text in options.models:
        name, equals, file = text.partition("=")
        if not equals or not name or not Path(file).is_file():
            raise InputError(f"--models {text!r}: must be NAME=FILE of an existing URDF")
        given[name] = GivenModel(Path(file))
    return given


def found_in(scan: Scan, options: ScanOptions) -> Found | None:
    """Read the detections of another program, if any."""
    from momapos.perception.detection import read_coco

    return None if options.detections is None else read_coco(options.detections, scan.frames)


def given_labels(options: ScanOptions) -> dict[str, str]:
    """Parse the labels of objects, by name.

    Raises:
        InputError: One is not OBJECT=LABEL, or an object is named twice.
    """
    from momapos.perception.detection import parse_labels

    return parse_labels(options.label)


def detector_of(options: ScanOptions) -> Detector | None:
    """Load the detector, if any.

    Raises:
        InputError: There is no such file or model, it has another layout, or --detections is given.
    """
    if options.detector is None:
        return None
    if options.detections is not None:
        raise InputError("--detector and --detections exclude each other; give one")
    from momapos.core import default_cache_dir
    from momapos.perception.detection import YoloxDetector, find_model

    return YoloxDetector(find_model(options.detector, default_cache_dir()))


def find_target(target: str | None, at: str | None, pixel: str | None) -> Target | None:
    """Parse the object of the task: a name, a point or a pixel.

    Raises:
        InputError: Several are given, or the point or pixel is malformed.
    """
    from momapos.perception.segmentation import PixelOf, PointAt

    if sum(word is not None for word in (target, at, pixel)) > 1:
        raise InputError("--target, --target-at and --target-pixel exclude each other; give one")
    if at is not None:
        x, y, z = _finite(at.split(","), 3, "--target-at", at, "X,Y,Z in meters")
        return PointAt((x, y, z))
    if pixel is not None:
        frame, *rest = pixel.rsplit(",", 2)
        u, v = _finite(rest, 2, "--target-pixel", pixel, "FRAME,U,V, as in frame-000020,310,95")
        return PixelOf(frame, u, v)
    return target


def _finite(words: list[str], count: int, option: str, text: str, wanted: str) -> list[float]:
    try:
        values = [float(word) for word in words]
    except ValueError:
        values = []
    if len(values) != count or not all(math.isfinite(value) for value in values):
        raise InputError(f"{option} {text!r:.80}: must be {wanted}")
    return values
