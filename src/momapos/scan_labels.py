"""What the things of a scan are called: by the user, by the images, by their size."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from momapos.detection.coco import LABELS
from momapos.detection.frames import detect
from momapos.detection.relabel import relabeled, with_given_labels
from momapos.detection.votes import vote
from momapos.protocols import Detector
from momapos.scan_records import Found, ScanConfig
from momapos.segmentation.boxes import named
from momapos.types import Cloud, Detection, Frame


def with_labels(
    things: Sequence[Detection],
    cloud: Cloud,
    frames: Sequence[Frame],
    detector: Detector | None,
    found: Found | None,
    given: Mapping[str, str] | None,
    config: ScanConfig,
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

    Raises:
        UnknownNameError, InputError: A given label is of nothing, or is none.
    """
    told = LABELS
    if found is None and detector is not None:
        found, told = detect(frames, detector), detector.labels
    if found is not None:
        looked_at = [frame for frame in frames if frame.name in found]
        verdicts = vote(things, cloud, looked_at, found, config.votes)
        things = relabeled(things, verdicts, told, config.votes)
    things = named(things)
    return named(with_given_labels(things, given)) if given else list(things)
