"""momapos scan: build an articulated scene from a scan, or model one object of a photo."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

from tyro.conf import Positional, arg

from momapos.core import InputError, say

from .configuration import NO_SETTINGS, AlphaOption, ConfigArgs, ScorerOption, load_config
from .loading import print_warnings
from .options import Flag, OptionalFile, Text, optional
from .scan_options import (
    DEFAULT,
    ScanArgs,
    detector_of,
    find_target,
    finite_numbers,
    found_in,
    given_labels,
    given_models,
    read,
    scan_config,
    tools_for,
)

if TYPE_CHECKING:
    from momapos.model.records import Scan
    from momapos.perception import Modeled, ScanConfig

    from .scan_options import ScanOptions


PREDICTION = ("label", "predictor", "checkpoint", "models")
"""Options of a scan that apply to a photo."""


@dataclass(frozen=True)
class PhotoOptions:
    """One object in one photo, instead of a scan."""

    photo: OptionalFile = None
    """Model one object from this image, taken from the front, instead of a scan."""
    box: Annotated[Text, optional("LEFT,TOP,RIGHT,BOTTOM")] = None
    """Where the photo shows the front of the object [px]."""
    size: Annotated[Text, optional("WIDTH,DEPTH,HEIGHT")] = None
    """Size of the object in the photo [m] (default: usual for its --label)."""


PhotoArgs = Annotated[PhotoOptions, arg(name="")]
NO_PHOTO = PhotoOptions()


def is_photo(
    source: Path | None, photo: PhotoOptions, options: ScanOptions, others: Mapping[str, object]
) -> bool:
    """Tell whether a photo is modeled instead of a scan.

    Args:
        source: The scan.
        photo: Options of the photo.
        options: Options of the scan.
        others: Values of further options that apply to scans only, by name.

    Raises:
        InputError: Neither or both are given, the photo has no box, or an option applies to the
            other one.
    """
    if photo.photo is None:
        if photo.box is not None or photo.size is not None:
            raise InputError("--box and --size belong to --photo FILE; give it, too")
        if source is None:
            raise InputError("give a scan (DIR), or --photo FILE with --box")
        return False
    if source is not None:
        raise InputError(f"{source} is a scan and --photo {photo.photo} a photo; give one")
    if photo.box is None:
        raise InputError("--photo needs --box LEFT,TOP,RIGHT,BOTTOM of the object in pixels")
    usual = type(options)()
    extra = [
        field.name
        for field in fields(options)
        if field.name not in PREDICTION
        and getattr(options, field.name) != getattr(usual, field.name)
    ]
    extra += [name for name, value in others.items() if value is not None]
    if extra:
        raise InputError(f"--{extra[0].replace('_', '-')} applies to scans, not to --photo")
    return True


def model(
    photo: PhotoOptions, options: ScanOptions, config: ScanConfig, out: Path
) -> tuple[Modeled, Scan]:
    """Read the photo, model its object and write the scene.

    Raises:
        InputError: The file, the box, the size or the label is not usable.
    """
    from momapos.model.records import Scan
    from momapos.perception import Photo, model_photo
    from momapos.perception.recordings import read_color

    assert photo.photo is not None
    assert photo.box is not None
    left, top, right, bottom = finite_numbers(
        photo.box.split(","), 4, "--box", photo.box, "LEFT,TOP,RIGHT,BOTTOM in pixels"
    )
    size = None
    if photo.size is not None:
        wanted = "WIDTH,DEPTH,HEIGHT in meters"
        width, depth, height = finite_numbers(
            photo.size.split(","), 3, "--size", photo.size, wanted
        )
        if not all(0.05 <= side <= 5.0 for side in (width, depth, height)):
            raise InputError(f"--size {photo.size!r:.80}: must be {wanted}, from 0.05 to 5")
        size = (width, depth, height)
    scan = Scan(photo.photo.stem, ())
    tools, given = tools_for(scan, options, None), given_models(options)
    shown = Photo(
        str(photo.photo), read_color(photo.photo), (left, top, right, bottom), _label(options), size
    )
    return model_photo(shown, out, tools, given=given, config=config), scan


def _label(options: ScanOptions) -> str:
    """Return the label of the object, as LABEL or OBJECT=LABEL.

    Raises:
        InputError: Several are given, or one is empty.
    """
    labels = [text.rpartition("=")[2].strip().lower() for text in options.label] or ["cabinet"]
    if len(labels) > 1 or not labels[0]:
        raise InputError("--photo shows one object; give one --label LABEL")
    return labels[0]


SETTINGS = ("importance", "scan")
"""Fields and tables of a configuration that the command uses."""


def scan_room(
    source: Annotated[Positional[Optional[Path]], arg(metavar="[DIR]")] = None,  # noqa: UP045
    /,
    *,
    out: Annotated[Path, arg(metavar="FILE")],
    target: Annotated[Text, optional("OBJECT")] = None,
    target_at: Annotated[Text, optional("X,Y,Z")] = None,
    target_pixel: Annotated[Text, optional("FRAME,U,V")] = None,
    alpha: AlphaOption = None,
    scorer: ScorerOption = None,
    pictures: Flag = True,
    json: Flag = False,
    photo: PhotoArgs = NO_PHOTO,
    options: ScanArgs = DEFAULT,
    settings: ConfigArgs = NO_SETTINGS,
) -> int:
    """Build a scene from a scan of a room, or from one photo of an object, for `momapos place`.

    scan_report.json, next to the scene, explains the decisions.

    Args:
        source: Folder of posed color and depth images, a point cloud, or a robot's recording.
        out: The scene file.
        target: The object of the task: only objects that matter for it are modeled.
        target_at: The same, by a point in the object in the scene's frame [m].
        target_pixel: The same, by a pixel of an image: name of the frame, column, row.
        alpha: Objects of lower importance for the target stay boxes, in [0, 1].
        scorer: Importance score: reach, deepwalk, distance, size or names, see `momapos rank`.
        pictures: Don't draw an image for each object that explains its model.
        json: Print the report as one JSON object, and nothing else.
        photo: One object in one photo, instead of a scan.
        options: What is known about the scan.
        settings: Further settings.
    """
    from momapos.core import check_outputs
    from momapos.workflows import scan_to_scene

    from .console import progress
    from .scan_report import outputs_of

    configuration = load_config(settings, SETTINGS, scorer=scorer, alpha=alpha)
    config = scan_config(options, configuration.scan)
    scans_only = {
        "target": target, "target_at": target_at, "target_pixel": target_pixel,
        "alpha": alpha, "scorer": scorer,
    }  # fmt: skip
    if is_photo(source, photo, options, scans_only):
        check_outputs(*outputs_of(out, pictures=pictures))
        return _shown(*model(photo, options, config, out), out, pictures=pictures, json=json)
    assert source is not None
    given, labels = given_models(options), given_labels(options)
    wanted, detector = find_target(target, target_at, target_pixel), detector_of(options)
    check_outputs(*outputs_of(out, pictures=pictures))
    scan = read(source, options, configuration.scan)
    tools, found = tools_for(scan, options, detector), found_in(scan, options)
    with progress("scan") as report:
        result = scan_to_scene(
            scan, out, tools, target=wanted, found=found, labels=labels, given=given,
            config=config, importance=configuration.importance,
            progress=lambda what, share: report(share, what),
        )  # fmt: skip
    return _shown(result, scan, out, pictures=pictures, json=json)


def _shown(result: Modeled, scan: Scan, out: Path, *, pictures: bool, json: bool) -> int:
    """Write the report and the figures, and print a summary."""
    import json as encoder

    from .scan_report import report_to_dict, write_report

    print_warnings(result.warnings)
    print_warnings(text for decision in result.decisions for text in decision.warnings)
    data = report_to_dict(result, scan, result.target)
    folder = write_report(result, data, out, pictures=pictures)
    say(encoder.dumps(data, allow_nan=False) if json else table(result, data, out, folder))
    return 0


def table(result: Modeled, data: dict[str, Any], out: Path, folder: Path | None) -> str:
    """Tabulate all objects."""
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
    return "\n".join(lines)


def _count(parts: tuple[Any, ...]) -> str:
    kinds = [part.kind for part in parts]
    return ", ".join(f"{kinds.count(kind)} {kind}" for kind in dict.fromkeys(kinds)) or "a model"
