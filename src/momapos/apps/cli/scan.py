"""momapos scan: a scene that moves, from a scan."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import OmitArgPrefixes, Positional, arg

from momapos.core import InputError
from momapos.planning.importance import ImportanceConfig, ScorerName

from .loading import tell
from .options import LabelsArg, OptionalNumber, OptionalPath, OptionalText

if TYPE_CHECKING:
    from momapos.model.records import ArticulationPredictor, Detector, Scan, Segmenter
    from momapos.perception import Found, Modeled, ScanConfig, Target, Tools
    from momapos.perception.reconstruction import GivenModel, SeenMotion

Predictor = Literal["network", "template", "urdformer"]


@dataclass(frozen=True)
class ScanOptions:
    """Where knowledge comes from, beside the scan."""

    instances: OptionalPath = None
    """Instances found by another program: Mask3D's ScanNet export, OpenMask3D masks, labels a
    point, or a JSON of boxes. All but boxes need a scan with a cloud."""
    detections: OptionalPath = None
    """Detectron2's coco_instances_results.json for the images of the scan."""
    detector: OptionalText = None
    """Who tells in the images what things are: an ONNX file in the layout of YOLOX for COCO's
    classes, or a name of `momapos models list`. Without one, sizes tell."""
    label: LabelsArg = ()
    """What an object is, by the name it has without this; may be given several times."""
    predictor: Predictor = "network"
    """Who finds doors and drawers: our network, a template by label, or URDFormer."""
    checkpoint: OptionalPath = None
    """URDFormer's part.pth."""
    models: tuple[str, ...] = ()
    """NAME=FILE.urdf of objects, by name or label, that need no prediction."""
    views: Literal["voting", "first"] = "voting"
    """How the front is chosen: by votes of all images, or the paper's first that passes."""
    grid: bool = False
    """Put parts onto URDFormer's grid of 13 steps."""
    max_frames: int = 150
    """Images that are read at most, evenly spaced."""
    depth_scale: OptionalNumber = None
    """Units of integer depth in a meter; 5000 in TUM's folders, 1000 elsewhere by default."""
    voxel: float = 0.015
    """Edge of the voxels that depth is fused in [m]."""
    depth_topic: OptionalText = None
    """Topics of a recording, where their types and names do not tell."""
    color_topic: OptionalText = None
    info_topic: OptionalText = None
    fixed_frame: OptionalText = None
    """Frame of a recording that does not move; the root of tf by default."""

    def __post_init__(self) -> None:
        if not 1e-3 <= self.voxel <= 1.0:
            raise InputError(f"--voxel must be between 0.001 and 1 m, not {self.voxel:g}")
        if self.depth_scale is not None and not 1e-6 <= self.depth_scale <= 1e9:
            raise InputError(
                f"--depth-scale must be between 1e-6 and 1e9, not {self.depth_scale:g}"
            )
        if not 1 <= self.max_frames <= 100_000:
            raise InputError(f"--max-frames must be between 1 and 100000, not {self.max_frames}")


def scan_room(
    source: Annotated[Positional[Path], arg(metavar="DIR")],
    /,
    *,
    out: Path,
    after: Annotated[OptionalPath, arg(metavar="DIR")] = None,
    target: Annotated[OptionalText, arg(metavar="OBJECT")] = None,
    target_at: Annotated[OptionalText, arg(metavar="X,Y,Z")] = None,
    target_pixel: Annotated[OptionalText, arg(metavar="FRAME,U,V")] = None,
    alpha: float = ImportanceConfig.alpha,
    scorer: ScorerName = "reach",
    pictures: bool = True,
    json: bool = False,
    options: Annotated[ScanOptions, OmitArgPrefixes] = ScanOptions(),
) -> int:
    """Make a scene from a scan of a room, which place can use.

    Beside the scene it writes scan_report.json, which says what was decided and why, and a
    image of every object that was looked at.

    Args:
        source: Folder of posed color and depth images, a cloud, or a robot's log.
        out: The scene file.
        after: A second scan of the room, after doors or drawers were opened that are shut in the
            first: how these move is then seen, and the scene has them as open as they are there.
        target: Object that the task will be about: only what matters for it is modeled.
        target_at: The same by a place in it, in the scene's frame [m].
        target_pixel: The same by a pixel of an image: the frame's name, column, row.
        alpha: Objects that matter less for the target than this stay boxes, in [0, 1].
        scorer: How importance is measured, as for rank.
        pictures: Draw why every object was modeled as it was.
        json: Print one JSON object and nothing else.
        options: Where knowledge comes from.
    """
    import json as encoder

    from momapos.core import check_outputs
    from momapos.workflows import scan_to_scene

    from .console import progress
    from .scan_report import outputs_of, report_to_dict, write_report

    config = scan_config(options)
    given, labels = given_models(options), given_labels(options)
    wanted, detector = find_target(target, target_at, target_pixel), detector_of(options)
    check_outputs(*outputs_of(out, pictures=pictures))
    scan = read(source, options)
    later = None if after is None else read(after, options)
    tools, found = tools_for(scan, options, detector), found_in(scan, options)
    with progress("scan") as report:
        result = scan_to_scene(
            scan, out, tools, target=wanted, after=later, found=found, labels=labels, given=given,
            config=config, importance=ImportanceConfig(scorer=scorer, alpha=alpha),
            progress=lambda what, share: report(share, what),
        )  # fmt: skip
    tell(text for decision in result.decisions for text in decision.warnings)
    if later is not None and not any(decision.moved for decision in result.decisions):
        print(f"momapos: {after}: no part stands elsewhere than in {source}", file=sys.stderr)
    data = report_to_dict(result, scan, result.target)
    folder = write_report(result, data, out, pictures=pictures)
    print(encoder.dumps(data, allow_nan=False) if json else table(result, data, out, folder))
    return 0


def table(result: Modeled, data: dict[str, Any], out: Path, folder: Path | None) -> str:
    """All objects in a few columns, and what should be scanned again."""
    width = max(len(d.detection.name) for d in result.decisions)
    lines = []
    for decision in result.decisions:
        item = decision.detection
        size = " x ".join(f"{v:.2f}" for v in item.box.size)
        x, y, z = item.box.center
        what = decision.reason or f"{decision.source}: {_count(decision.parts)}"
        sure = "   -" if item.seen is None else f"{item.seen:4.0%}"
        lines.append(
            f"  {item.name:<{width}}  {size} m at ({x:.2f}, {y:.2f}, {z:.2f})  seen {sure}  {what}"
        )
    lines += [
        f"  {d.detection.name}/{name}  was opened, as a {seen.kind}, by {_amount(seen)}"
        for d in result.decisions
        for name, seen in d.moved.items()
    ]
    modeled = sum(d.model is not None for d in result.decisions)
    stages = ", ".join(f"{n} {s:.1f}" for n, s in result.timing.items() if n != "total")
    lines += [
        "",
        f"  {len(result.decisions)} objects, {modeled} of them modeled",
        *(f"  scan        {note}" for note in data["notes"]),
        f"  time        {result.timing['total']:.1f} s ({stages})",
        f"  scene       {out}",
        f"  report      {out.parent / 'scan_report.json'}",
    ]
    if folder is not None:
        lines.append(f"  images      {folder}")
    if data["scan_again"]:
        lines += ["", "  scan again, in the scene's frame:"]
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


def read(source: Path, options: ScanOptions) -> Scan:
    """Read a scan, and tell what is odd about it."""
    from momapos.perception.recordings import BagTopics, read_scan

    topics = BagTopics(
        options.depth_topic, options.color_topic, options.info_topic, options.fixed_frame
    )
    scan = read_scan(
        source, max_frames=options.max_frames, depth_scale=options.depth_scale, topics=topics
    )
    tell(scan.warnings)
    return scan


def scan_config(options: ScanOptions) -> ScanConfig:
    """How a scan becomes a scene.

    Raises:
        InputError: URDFormer is asked for without its weights.
    """
    from momapos.perception import ScanConfig
    from momapos.perception.reconstruction import AlignmentConfig, ModelConfig
    from momapos.perception.views import ViewConfig

    if options.predictor == "urdformer" and options.checkpoint is None:
        raise InputError("--predictor urdformer needs --checkpoint PATH/part.pth")
    alignment = AlignmentConfig(grid=12 if options.grid else None)
    return ScanConfig(
        voxel=options.voxel,
        view=ViewConfig(method=options.views),
        model=ModelConfig(alignment=alignment),
    )


def tools_for(scan: Scan, options: ScanOptions, detector: Detector | None) -> Tools:
    """Who segments, looks, predicts and detects."""
    from momapos.perception import default_tools

    tools = replace(default_tools(), detect=detector)
    predict: ArticulationPredictor = tools.predict
    if options.predictor == "template":
        assert tools.guess is not None
        predict = tools.guess
    elif options.predictor == "urdformer":
        from momapos.perception.reconstruction import UrdformerPredictor, load_urdformer

        assert options.checkpoint is not None, "scan_config has looked"
        predict = UrdformerPredictor(load_urdformer(options.checkpoint), tools.look)
    segment = tools.segment if options.instances is None else _reader(scan, options.instances)
    return replace(tools, segment=segment, predict=predict)


def _reader(scan: Scan, path: Path) -> Segmenter:
    """Instances from a file instead of a segmenter."""
    from momapos.model.records import Cloud, Instance
    from momapos.perception.recordings import read_instances

    def read(cloud: Cloud) -> list[Instance]:
        if scan.cloud is None and path.suffix != ".json":
            raise InputError(
                f"{path}: masks count the points of a cloud, but {scan.name} came without one"
            )
        return read_instances(path, len(cloud.points))

    return read


def given_models(options: ScanOptions) -> dict[str, GivenModel]:
    """URDF files of objects, by name or label.

    Raises:
        InputError: One is no NAME=FILE, or there is no such file.
    """
    from momapos.perception.reconstruction import GivenModel

    given = {}
    for text in options.models:
        name, equals, file = text.partition("=")
        if not equals or not name or not Path(file).is_file():
            raise InputError(f"--models {text!r}: must be NAME=FILE of a URDF that exists")
        given[name] = GivenModel(Path(file))
    return given


def found_in(scan: Scan, options: ScanOptions) -> Found | None:
    """What a 2-D detector has found in the images."""
    from momapos.perception.detection import read_coco

    return None if options.detections is None else read_coco(options.detections, scan.frames)


def given_labels(options: ScanOptions) -> dict[str, str]:
    """What the user says that objects are, by name.

    Raises:
        InputError: One is no OBJECT=LABEL, or an object is named twice.
    """
    from momapos.perception.detection import parse_labels

    return parse_labels(options.label)


def detector_of(options: ScanOptions) -> Detector | None:
    """Who looks at the images.

    Raises:
        InputError: There is no such file or model, it is of another layout, or the images were
            looked at by another program already.
    """
    if options.detector is None:
        return None
    if options.detections is not None:
        raise InputError("--detector and --detections exclude each other: one tells what is seen")
    from momapos.core import default_cache_dir
    from momapos.perception.detection import YoloxDetector, find_model

    return YoloxDetector(find_model(options.detector, default_cache_dir()))


def find_target(target: str | None, at: str | None, pixel: str | None) -> Target | None:
    """The object that the task is about: named, or pointed at.

    Raises:
        InputError: It is given twice, or its place is written otherwise.
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
    """Numbers of an option."""
    try:
        values = [float(word) for word in words]
    except ValueError:
        values = []
    if len(values) != count or not all(math.isfinite(value) for value in values):
        raise InputError(f"{option} {text!r:.80}: must be {wanted}")
    return values
