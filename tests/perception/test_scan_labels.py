"""Labels of the objects of a scan."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.perception.views.painted_box import FRIDGE, camera, image

from momapos.core.geometry.transforms import apply
from momapos.model.records.scans import Cloud, Detection, Frame, ImageDetection
from momapos.perception.detection.coco import LABELS
from momapos.perception.pipeline import with_labels

EYES = [(-0.5, 0.5, 1.0), (-0.4, 0.2, 1.2), (-0.6, 0.9, 1.1)]


def gray(world: np.ndarray, normals: np.ndarray) -> np.ndarray:
    del normals
    return np.full((len(world), 3), 128)


def whole(frame: Frame, label: str) -> ImageDetection:
    """Return a detection of a whole image."""
    rows, columns = np.nonzero(frame.depth)
    box = (columns.min(), rows.min(), columns.max() + 1, rows.max() + 1)
    return ImageDetection(tuple(map(float, box)), label, 0.9)


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    return [
        image(camera(eye, FRIDGE.center), FRIDGE, gray, name=str(k)) for k, eye in enumerate(EYES)
    ]


@pytest.fixture(scope="module")
def unlabeled(frames: list[Frame]) -> tuple[Detection, Cloud]:
    v, u = np.nonzero(frames[0].depth)
    z = frames[0].depth[v, u].astype(float)
    rays = np.linalg.solve(frames[0].intrinsics, np.stack([u, v, np.ones(len(u))]))
    points = apply(frames[0].T_world_camera, (rays * z).T)[::50]
    normals = np.tile([-1.0, 0, 0], (len(points), 1))
    cloud = Cloud(points, normals, np.zeros((len(points), 3), np.uint8))
    guesses = (("cabinet", 0.5),)
    item = Detection("a", "cabinet", 0.5, FRIDGE, np.arange(len(points)), guesses=guesses)
    return replace(item, label_from="size"), cloud


@pytest.mark.parametrize(
    ("label", "handles", "called"),
    [("bed", False, "bed"), ("bed", True, "cabinet"), ("fridge", True, "fridge")],
)
def test_furniture_with_handles_is_not_a_bed(
    frames: list[Frame],
    unlabeled: tuple[Detection, Cloud],
    label: str,
    *,
    handles: bool,
    called: str,
) -> None:
    item, cloud = unlabeled
    found = {frame.name: [whole(frame, label)] for frame in frames}
    looked_at = []

    def opens(item: Detection) -> bool:
        looked_at.append(item)
        return handles

    (named,) = with_labels([item], cloud, frames, found, LABELS, None, opens)
    assert (named.label, named.name) == (called, f"{called}_1")
    assert len(looked_at) == (label == "bed")
