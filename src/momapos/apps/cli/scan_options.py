"""Options about a scan, and what they choose: the reader, predictors, detections and models."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, Optional, cast

from tyro.conf import arg

from momapos.core import InputError

from .configuration import ScanSettings
from .loading import print_warnings
from .options import LabelsArg, Number, OptionalFile, Text, optional

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Int

    from momapos.model.records import ArticulationPredictor, Detector, Scan, Segmenter
    from momapos.perception import Found, ScanConfig, Target, Tools
    from momapos.perception.reconstruction import GivenModel
    from momapos.perception.recordings import UpAxis

Predictor = Literal["network", "template"]
PoseDirection = Literal["given", "inverted"]
CameraAxes = Literal["opencv", "opengl"]
UP = ("x", "-x", "y", "-y", "z", "-z")


@dataclass(frozen=True)
class ScanOptions:
    """What is known about a scan, and what interprets it."""

    instances: OptionalFile = None
    """Instances from another program: Mask3D, OpenMask3D, labels per point, or boxes (JSON)."""
    detections: OptionalFile = None
    """Detections in the images: results of Detectron2, or of Omni3D with 3-D boxes."""
    categories: OptionalFile = None
    """Names of the categories in --detections, as COCO's dataset files and Omni3D have them."""
    frontal: OptionalFile = None
    """Scores of a frontal classifier by image (JSON); the first frontal image then chooses the
    front of an object, as in the paper."""
    detector: Annotated[Text, optional("DETECTOR")] = None
    """Detector that labels objects: a YOLOX ONNX file, or a name of `momapos models list`."""
    label: LabelsArg = ()
    """Set the label of an object, by the name that it has without this option."""
    predictor: Predictor = "network"
    """What finds doors and drawers: our network, or a template for each label."""
    models: Annotated[
        tuple[str, ...], arg(metavar="[NAME=FILE.urdf ...]", help_behavior_hint="")
    ] = ()
    """Known models of objects, by name or label; they need no prediction."""
    max_frames: int = 150
    """Maximum number of images, evenly spaced."""
    depth_scale: Annotated[Number, optional("UNITS")] = None
    """Units of integer depth per meter (default: 5000 in TUM's folders, else 1000, if it fits)."""
    poses: Annotated[Optional[PoseDirection], optional("given|inverted")] = None  # noqa: UP045
    """Poses from camera to world (given) or from world to camera (inverted)."""
    camera_axes: Annotated[Optional[CameraAxes], optional("opencv|opengl")] = None  # noqa: UP045
    """Camera axes: x right, y down, z forward (opencv), or x right, y up, z backward (opengl)."""
    up: Annotated[Text, optional("AXIS")] = None
    """Axis of the scan's frame that points up: x, -x, y, -y, z or -z."""

    def __post_init__(self) -> None:
        if self.categories is not None and self.detections is None:
            raise InputError("--categories names the categories of --detections; give both")
        if self.up is not None and self.up not in UP:
            raise InputError(f"--up must be {', '.join(UP[:-1])} or {UP[-1]}, not {self.up!r:.20}")
        if self.depth_scale is not None and not 1e-6 <= self.depth_scale <= 1e9:
            raise InputError(
                f"--depth-scale must be between 1e-6 and 1e9, not {self.depth_scale:g}"
            )
        if not 1 <= self.max_frames <= 100_000:
            raise InputError(f"--max-frames must be between 1 and 100000, not {self.max_frames}")


ScanArgs = Annotated[ScanOptions, arg(name="")]
DEFAULT = ScanOptions()


def read(source: Path, options: ScanOptions, settings: ScanSettings) -> Scan:
    """Read a scan and print its warnings."""
    from momapos.perception.recordings import BagTopics, read_scan

    topics = BagTopics(
        settings.depth_topic, settings.color_topic, settings.info_topic, settings.fixed_frame
    )
    scan = read_scan(
        source, max_frames=options.max_frames, depth_scale=options.depth_scale, topics=topics,
        poses=options.poses, axes=options.camera_axes, up=cast("UpAxis | None", options.up),
    )  # fmt: skip
    print_warnings(scan.warnings)
    return scan


def scan_config(options: ScanOptions, settings: ScanSettings) -> ScanConfig:
    """Build the configuration of the perception.

    Raises:
        InputError: An option contradicts a setting.
    """
    from momapos.perception import ScanConfig
    from momapos.perception.reconstruction import ModelConfig

    if options.frontal is not None and settings.views == "voting":
        raise InputError("--frontal names the image that decides; leave out scan.views=voting")
    return ScanConfig(
        voxel=settings.voxel,
        views=settings.views if options.frontal is None else "first",
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
    segment = tools.segment if options.instances is None else _reader(scan, options.instances)
    frontal = None
    if options.frontal is not None:
        from momapos.perception.detection import read_frontal

        frontal = read_frontal(options.frontal, scan.frames)
    return replace(tools, segment=segment, predict=predict, frontal=frontal)


def _reader(scan: Scan, path: Path) -> Segmenter:
    """Build a segmenter that reads instances from a file."""
    from momapos.model.records import Cloud, Instance
    from momapos.perception.recordings import read_instances

    def read(cloud: Cloud) -> list[Instance]:
        if scan.cloud is None and path.suffix != ".json":
            raise InputError(
                f"{path}: masks need a scan with a point cloud, and {scan.name} has none"
            )
        rows = cloud.rows
        if rows is None:
            return read_instances(path, len(cloud.points))
        return [
            item if item.members is None else replace(item, members=_rows_of(rows, item.members))
            for item in read_instances(path, len(rows))
        ]

    return read


def _rows_of(
    rows: Int[np.ndarray, " file"], members: Int[np.ndarray, " k"]
) -> Int[np.ndarray, " m"]:
    """Return the points of a cloud for points of its file."""
    import numpy as np

    found = np.unique(rows[members])
    return found[found >= 0]


def stand_ins(options: ScanOptions) -> dict[str, str]:
    """Return what does the work of each network of MoMa-Pos, section III-B, by its name."""
    projected = "projections of the 3-D boxes"
    detections = options.detections or options.detector
    predictors: dict[Predictor, str] = {
        "network": "momapos' front networks",
        "template": "templates by label",
    }
    predictor = predictors[options.predictor]
    return {
        "Detectron2": projected if detections is None else f"{detections}, else {projected}",
        "ResNet50": str(options.frontal or "camera poses and momapos' front network"),
        "URDFormer": f"{', '.join(options.models)}, else {predictor}"
        if options.models
        else predictor,
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
    """Read the detections of another program, if any, and print what was skipped.

    Raises:
        InputError: They have 3-D boxes, and --instances is given.
    """
    from momapos.perception.detection import read_coco

    if options.detections is None:
        return None
    results = read_coco(options.detections, scan.frames, options.categories)
    print_warnings(results.warnings)
    boxed = any(item.corners is not None for one in results.found.values() for item in one)
    if boxed and options.instances is not None:
        raise InputError(
            f"{options.detections} has 3-D boxes of the objects, as --instances has; give one"
        )
    return results.found


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
        x, y, z = finite_numbers(at.split(","), 3, "--target-at", at, "X,Y,Z in meters")
        return PointAt((x, y, z))
    if pixel is not None:
        frame, *rest = pixel.rsplit(",", 2)
        u, v = finite_numbers(
            rest, 2, "--target-pixel", pixel, "FRAME,U,V, as in frame-000020,310,95"
        )
        return PixelOf(frame, u, v)
    return target


def finite_numbers(
    words: list[str], count: int, option: str, text: str, wanted: str
) -> list[float]:
    """Parse the numbers in the value of an option.

    Raises:
        InputError: One is not a finite number, or there are more or fewer than `count`.
    """
    try:
        values = [float(word) for word in words]
    except ValueError:
        values = []
    if len(values) != count or not all(math.isfinite(value) for value in values):
        raise InputError(f"{option} {text!r:.80}: must be {wanted}")
    return values
