"""What the things of a scan are called: by the user, by the images, by their size."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from momapos.model.records import Cloud, Detection, Detector, Frame
from momapos.perception.detection import (
    LABELS,
    WITHOUT_DOORS,
    detect,
    relabeled,
    vote,
    with_given_labels,
)
from momapos.perception.segmentation import named

from .records import Found, ScanConfig


def with_labels(
    things: Sequence[Detection],
    cloud: Cloud,
    frames: Sequence[Frame],
    detector: Detector | None,
    found: Found | None,
    given: Mapping[str, str] | None,
    config: ScanConfig,
    opens: Callable[[Detection], bool],
) -> list[Detection]:
    """Name the things of a scan, the surest word first.

    Args:
        things: As their sizes and the segmenter call them.
        cloud: In the upright world.
        frames: In the upright world.
        detector: Looks at every image, unless `found` holds what another one saw.
        found: What was found in the images, by the frame's name.
        given: Labels from the user, by the names that things have without them.
        config: Constants.
        opens: Whether doors or drawers with handles are seen on a thing. It is asked of what the
            images take for a bed or another thing that has none; they then err.

    Raises:
        UnknownNameError, InputError: A given label is of nothing, or is none.
    """
    told = LABELS
    if found is None and detector is not None:
        found, told = detect(frames, detector), detector.labels
    if found is not None:
        looked_at = [frame for frame in frames if frame.name in found]
        verdicts = vote(things, cloud, looked_at, found, config.votes)
        verdicts = [
            replace(verdict, label="", confidence=0.0, hits=0)
            if verdict.label in WITHOUT_DOORS and opens(thing)
            else verdict
            for verdict, thing in zip(verdicts, things, strict=True)
        ]
        things = relabeled(things, verdicts, told, config.votes)
    things = named(things)
    return named(with_given_labels(things, given)) if given else list(things)
