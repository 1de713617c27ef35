"""Model one object from one photo: `momapos scan --photo FILE --box LEFT,TOP,RIGHT,BOTTOM`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import arg

from momapos.core import InputError

from .options import OptionalFile, Text, optional
from .scan_options import finite_numbers, given_models, tools_for

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
