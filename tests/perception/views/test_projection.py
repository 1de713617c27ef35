from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from tests.perception.views.painted_box import FRIDGE, camera, image

from momapos.model.records.scans import Frame
from momapos.perception.detection.coco import read_coco
from momapos.perception.views.placed_parts import observations, overlap, projection


def gray(world: np.ndarray, normals: np.ndarray) -> np.ndarray:
    del normals
    return np.full((len(world), 3), 128)


def frames() -> list[Frame]:
    eyes = [(-0.5, 0.5, 1.0), (0.0, -0.5, 1.4), (4.5, 1.0, 1.0)]
    targets = [(2.0, 0.9, 0.9), (2.0, 0.5, 0.9), (9.0, 1.0, 1.0)]  # the last looks away
    return [
        image(camera(eye, target), FRIDGE, gray, name=f"frame-{k:06d}")
        for k, (eye, target) in enumerate(zip(eyes, targets, strict=True))
    ]


def test_a_projected_box_contains_exactly_the_object_pixels() -> None:
    frame = frames()[0]
    rectangle = projection(FRIDGE, frame)
    rows, columns = np.nonzero(frame.color[..., 0])
    seen = (columns.min(), rows.min(), columns.max() + 1, rows.max() + 1)
    assert np.abs(np.subtract(rectangle, seen)).max() < 1.5


def test_images_are_sorted_by_centrality_without_those_that_look_away() -> None:
    seen = observations(FRIDGE, frames())
    assert [sight.frame for sight in seen] == [1, 0]
    assert seen[0].off_center < seen[1].off_center


def test_a_detector_file_locates_an_object(tmp_path: Path) -> None:
    images = frames()
    rectangle = projection(FRIDGE, images[0])
    left, top, right, bottom = rectangle
    entry = {
        "image_id": "frame-000000", "category_id": 72, "score": 0.9,
        "bbox": [left + 5, top, right - left - 5, bottom - top],
    }  # fmt: skip
    path = tmp_path / "coco_instances_results.json"
    path.write_text(json.dumps([entry, {**entry, "image_id": 1, "bbox": [0, 0, 9, 9]}]))
    found = read_coco(path, images).found
    assert [sight.frame for sight in observations(FRIDGE, images, found)] == [0]
    assert observations(FRIDGE, images, found)[0].box[0] == pytest.approx(left + 5)


def test_overlap_is_symmetric_and_one_for_itself() -> None:
    a, b = (0.0, 0.0, 2.0, 2.0), (1.0, 0.0, 3.0, 2.0)
    assert overlap(a, a) == 1.0
    assert overlap(a, b) == overlap(b, a) == pytest.approx(1 / 3)
    assert overlap(a, (5.0, 5.0, 6.0, 6.0)) == 0.0
