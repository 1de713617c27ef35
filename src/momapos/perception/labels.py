"""Label the objects of a scan: by the user, by the images, by size."""

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

from .records import Found


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
