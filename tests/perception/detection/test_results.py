"""Wrong files of 2-D detections are refused in one line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from momapos.core.errors import FileFormatError
from momapos.model.records.scans import Frame
from momapos.perception.detection.coco_results import read_coco


def frames() -> list[Frame]:
    gray = np.zeros((4, 6, 3), np.uint8)
    return [Frame(f"frame-{k:06d}", gray, None, np.eye(3), np.eye(4)) for k in range(3)]


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("{}", "list"),
        ("[", "JSON"),
        ('[{"bbox": [1, 2, 3]}]', "detection 0"),
        ('[{"image_id": 0, "bbox": [1, 2, 3, 4], "score": 1}]', "category_id"),
        ('[{"image_id": 0, "category_id": 1, "bbox": [1, 2, -3, 4], "score": 1}]', "not empty"),
        ('[{"image_id": 0, "category_id": 1e999, "bbox": [1, 2, 3, 4], "score": 1}]', "infinity"),
        (
            f'[{{"image_id": 0, "category_id": 1, "bbox": [1, 2, 3, 1{"0" * 400}], "score": 1}}]',
            "too large",
        ),
        (
            '[{"image_id": [[]], "category_id": 1, "bbox": [1, 2, 3, 4], "score": 1}]',
            "an integer",
        ),
        ('[{"image_id": "x", "category_id": 1, "bbox": [1, 2, 3, 4], "score": 1}]', "image_id"),
    ],
)
def test_a_wrong_detector_file_is_refused_by_name(tmp_path: Path, text: str, word: str) -> None:
    path = tmp_path / "found.json"
    path.write_text(text)
    with pytest.raises(FileFormatError, match=word) as caught:
        read_coco(path, frames())
    assert str(path) in str(caught.value)
