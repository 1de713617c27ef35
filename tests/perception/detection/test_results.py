"""Detections are read with the numbers of their writers, and wrong files are refused in one line.

The list of results is what `instances_to_coco_json` and `COCOEvaluator` of Detectron2
(detectron2/evaluation/coco_evaluation.py) write: `category_id` is mapped back to the dataset's
numbers, and a model without boxes, such as Mask2Former, leaves `bbox` at zero. Omni3D's
`instances_to_coco_json` (cubercnn/evaluation/omni3d_evaluation.py) adds bbox3D, center_cam,
dimensions and pose.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from momapos.core.errors import FileFormatError
from momapos.model.records.scans import Frame
from momapos.perception.detection.coco import (
    CATEGORIES,
    Results,
    read_categories,
    read_coco,
    read_frontal,
)


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
        ('[{"image_id": 0, "category_id": 1, "bbox": [1, 2, -3, 4], "score": 1}]', "not negative"),
        (
            '[{"image_id": 0, "category_id": 1, "bbox": [1, 2, 3, 4], "score": 1.9}]',
            r"from 0 to 1, not 1\.9",
        ),
        ('[{"image_id": 0, "category_id": 1e999, "bbox": [1, 2, 3, 4], "score": 1}]', "infinity"),
        (
            f'[{{"image_id": 0, "category_id": 1, "bbox": [1, 2, 3, 1{"0" * 400}], "score": 1}}]',
            "too large",
        ),
        ('[{"image_id": [[]], "category_id": 1, "bbox": [1, 2, 3, 4], "score": 1}]', "an integer"),
        ('[{"image_id": "x", "category_id": 1, "bbox": [1, 2, 3, 4], "score": 1}]', "image_id"),
    ],
)
def test_a_wrong_detector_file_is_refused_by_name(tmp_path: Path, text: str, word: str) -> None:
    path = tmp_path / "found.json"
    path.write_text(text)
    with pytest.raises(FileFormatError, match=word) as caught:
        read_coco(path, frames())
    assert str(path) in str(caught.value)


def result(category: int, **changes: Any) -> dict[str, Any]:
    """Return an entry as Detectron2 writes it."""
    entry = {
        "image_id": 0, "category_id": category, "bbox": [1.0, 1.0, 3.0, 2.0], "score": 0.9,
        "segmentation": {"size": [1024, 1024], "counts": "PPPP1"},
    }  # fmt: skip
    return {**entry, **changes}


def written(path: Path, content: Any) -> Path:
    path.write_text(json.dumps(content))
    return path


def with_indices(*indices: int, name: str = "view {}") -> list[Frame]:
    gray = np.zeros((4, 6, 3), np.uint8)
    return [
        Frame(name.format(chr(97 + k)), gray, None, np.eye(3), np.eye(4), k) for k in indices
    ]  # fmt: skip


def ids(tmp_path: Path, listed: list[Any], images: list[Frame]) -> Results:
    return read_coco(written(tmp_path / "a.json", [result(62, image_id=k) for k in listed]), images)


def test_numbers_count_the_images_of_the_recording_not_those_that_the_scan_uses(
    tmp_path: Path,
) -> None:
    results = ids(tmp_path, [0, 1, 2, 3, 4, 5], with_indices(0, 2, 5))
    assert {name: len(one) for name, one in results.found.items()} == {
        "view a": 1, "view c": 1, "view f": 1
    }  # fmt: skip
    (line,) = results.warnings
    assert (
        "3 of 6 detections are in 3 images that the scan does not use, such as image_id 1" in line
    )


def test_numbers_from_one_are_recognized_by_the_last(tmp_path: Path) -> None:
    results = ids(tmp_path, [1, 2, 3], with_indices(0, 1, 2))
    assert set(results.found) == {"view a", "view b", "view c"}
    (line,) = results.warnings
    assert (
        "counted from 1; a file of categories with the names of its images says otherwise" in line
    )
    assert set(ids(tmp_path, [1, 2], with_indices(0, 1, 2)).found) == {"view b", "view c"}
    assert set(ids(tmp_path, [3], with_indices(0, 1, 2)).found) == {"view c"}


def test_the_number_in_a_name_comes_before_the_index(tmp_path: Path) -> None:
    images = [
        Frame(f"frame-{n:06d}", f.color, None, f.intrinsics, f.T_world_camera, f.index)
        for n, f in zip((10, 20, 30), with_indices(0, 1, 2), strict=True)
    ]
    results = ids(tmp_path, [10, 20, 21, "frame-000030"], images)
    assert set(results.found) == {"frame-000010", "frame-000020", "frame-000030"}
    assert "1 of 4 detections" in results.warnings[0]
    assert set(ids(tmp_path, [0, 1], images).found) == {"frame-000010", "frame-000020"}


@pytest.mark.parametrize(
    "content",
    [{"view a": 0.9, "view c": 0}, [{"image_id": 0, "score": 0.9}, {"image_id": 2, "score": 0}]],
)
def test_scores_of_a_frontal_classifier_belong_to_frames(tmp_path: Path, content: Any) -> None:
    found = read_frontal(written(tmp_path / "s.json", content), with_indices(0, 2))
    assert found == {"view a": 0.9, "view c": 0.0}


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"view a": 1.5}, r"score of 'view a': must be from 0 to 1, not 1\.5"),
        ({"view a": float("nan")}, "must be from 0 to 1, not nan"),
        ([{"score": 0.5}], "needs image_id"),
        ({"other": 0.5}, "none of its images is one of the scan"),
        (3, "must be an object of scores by image, or a list"),
    ],
)
def test_a_wrong_file_of_frontal_scores_is_refused_in_one_line(
    tmp_path: Path, content: Any, words: str
) -> None:
    with pytest.raises(FileFormatError, match=words):
        read_frontal(written(tmp_path / "s.json", content), with_indices(0, 2))


def labels(results: Results) -> list[str]:
    return [item.label for one in results.found.values() for item in one]


def test_category_numbers_are_those_of_coco_with_gaps(tmp_path: Path) -> None:
    path = written(tmp_path / "a.json", [result(n) for n in (62, 72, 82, 44, 1)])
    results = read_coco(path, frames())
    assert labels(results) == ["chair", "screen", "fridge", "bottle", ""]
    assert results.warnings == ()
    assert len(CATEGORIES) == 80
    assert (CATEGORIES[1], CATEGORIES[90]) == ("person", "toothbrush")
    assert (CATEGORIES[13], CATEGORIES[67], CATEGORIES[84]) == (
        "stop sign", "dining table", "book",
    )  # fmt: skip


@pytest.mark.parametrize("number", [0, 12, 68, 71])
def test_a_number_that_coco_skips_means_numbers_from_0_to_79_and_is_said(
    tmp_path: Path, number: int
) -> None:
    path = written(tmp_path / "a.json", [result(72), result(number)])
    results = read_coco(path, frames())
    assert labels(results)[0] == "fridge"
    assert len(results.warnings) == 1
    assert f"category {number} is not in COCO's files" in results.warnings[0]


@pytest.mark.parametrize(
    ("content", "names"),
    [
        ({"categories": [{"id": 7, "name": "dishwasher"}, {"id": 9, "name": "Refrigerator"}]}, 2),
        ([{"id": 7, "name": "dishwasher"}, {"id": 9, "name": "refrigerator"}], 2),
        ([*"abcdefg", "dishwasher", "x", "refrigerator"], 10),
        (
            {
                "thing_classes": ["refrigerator", "dishwasher"],
                "thing_dataset_id_to_contiguous_id": {"7": 1, "9": 0},
            },
            2,
        ),
    ],
)
def test_a_file_of_categories_names_the_numbers(tmp_path: Path, content: Any, names: int) -> None:
    path = written(tmp_path / "a.json", [result(7), result(9)])
    file = written(tmp_path / "categories.json", content)
    assert labels(read_coco(path, frames(), file)) == ["dishwasher", "fridge"]
    assert len(read_categories(file).names) == names


def test_a_dataset_file_names_its_own_categories_and_images(tmp_path: Path) -> None:
    content = {
        "images": [{"id": 412, "file_name": "color/frame-000002.jpg"}],
        "categories": [{"id": 1, "name": "oven"}],
        "annotations": [{"image_id": 412, "category_id": 1, "bbox": [0, 0, 2, 2]}],
    }
    found = read_coco(written(tmp_path / "a.json", content), frames()).found
    assert [(name, one[0].label) for name, one in found.items()] == [("frame-000002", "oven")]


@pytest.mark.parametrize(
    ("numbers", "content", "hint"),
    [
        ([62, 95], None, "category 95 is not among COCO's"),
        ([-1], None, "category -1 is not among COCO's"),
        ([1, 3], [{"id": 1, "name": "oven"}], "category 3 is not among the categories of"),
        ([1], {"categories": []}, "has no categories"),
        ([1], [{"id": "1", "name": "oven"}], "category 0 needs a whole 'id' and a 'name'"),
        ([1], {"thing_classes": ["oven"]}, "numbers are missing"),
        ([1], [{"id": 1, "name": "a"}, {"id": 1, "name": "b"}], "category 1 twice"),
    ],
)
def test_a_category_without_a_name_is_refused_in_one_line(
    tmp_path: Path, numbers: list[int], content: Any, hint: str
) -> None:
    path = written(tmp_path / "a.json", [result(number) for number in numbers])
    file = None if content is None else written(tmp_path / "names.json", content)
    with pytest.raises(FileFormatError, match=hint) as caught:
        read_coco(path, frames(), file)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("empty", [[0.0, 0.0, 0.0, 0.0], [3, 2, 0, 5]])
def test_empty_boxes_are_skipped_and_counted(tmp_path: Path, empty: list[float]) -> None:
    path = written(tmp_path / "a.json", [result(62), result(1, bbox=empty), result(72, bbox=empty)])
    results = read_coco(path, frames())
    assert labels(results) == ["chair"]
    assert results.warnings == (f"{path}: skipped 2 of 3 detections with an empty box",)
    alone = read_coco(written(tmp_path / "b.json", [result(1, bbox=empty)]), frames())
    assert alone.found == {}
    assert "skipped 1 of 1" in alone.warnings[0]


def test_the_boxes_of_omni3d_keep_their_corners_and_need_names(tmp_path: Path) -> None:
    corners = [[x, y, z] for z in (2.0, 2.6) for x, y in ((0, 0), (0.6, 0), (0.6, 1.8), (0, 1.8))]
    rest = {"depth": 2.3, "center_cam": [0.3, 0.9, 2.3], "dimensions": [0.6, 1.8, 0.6]}
    ones = np.ones((8, 3)).tolist()  # what it writes for a model without 3-D boxes
    path = written(
        tmp_path / "omni_instances_results.json",
        [result(9, bbox3D=corners, pose=np.eye(3).tolist(), **rest), result(9, bbox3D=ones)],
    )
    results = read_coco(path, frames())
    first, second = results.found["frame-000000"]
    assert (first.label, second.corners) == ("", None)
    np.testing.assert_allclose(first.corners, corners)
    assert "--categories" in results.warnings[0]
    for bad in ([[1, 2, 3]], "x", [[np.inf] * 3] * 8):
        path = written(tmp_path / "bad.json", [result(9, bbox3D=bad)])
        with pytest.raises(FileFormatError, match="bbox3D must be"):
            read_coco(path, frames())


def encoded(mask: np.ndarray) -> dict[str, Any]:
    """Return a mask as pycocotools' `encode` does (rleEncode and rleToString in maskApi.c)."""
    flat = mask.T.ravel()
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flat, [2]])))
    runs = np.diff(np.concatenate([[0], edges])).tolist()
    text = ""
    for k, run in enumerate(runs):
        value = run - runs[k - 2] if k > 2 else run
        while True:
            code = value & 31
            value >>= 5
            more = value != (-1 if code & 16 else 0)
            text += chr(48 + (code | 32 if more else code))
            if not more:
                break
    return {"size": list(mask.shape), "counts": text}


@pytest.mark.parametrize("seed", range(20))
def test_a_mask_gives_the_box_that_the_detector_left_empty(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    mask = np.zeros((40, 60), int)
    top, left = rng.integers(0, 20), rng.integers(0, 30)
    low, right = top + rng.integers(1, 20), left + rng.integers(1, 30)
    mask[top:low, left:right] = rng.random((low - top, right - left)) < rng.uniform(0.2, 1.2)
    rows, columns = np.nonzero(mask)
    zero = [0.0, 0.0, 0.0, 0.0]
    entries = [result(62, bbox=zero, segmentation=encoded(mask)), result(1)]
    found = read_coco(written(tmp_path / "a.json", entries), frames()).found["frame-000000"]
    if len(rows):
        expected = (columns.min(), rows.min(), columns.max() + 1, rows.max() + 1)
        assert found[0].box == expected
    assert len(found) == 1 + bool(len(rows))


@pytest.mark.parametrize(
    "mask",
    [
        None, [], {"size": [4, 6]}, {"size": [4], "counts": [24]}, {"size": [4, 6], "counts": [5]},
        {"size": [4, 6], "counts": "\u00ff"}, {"size": [4, 10**9], "counts": [4 * 10**9]},
        {"size": [4, 6], "counts": [-1, 25]}, {"size": [4, 6], "counts": "o" * 99},
    ],
)  # fmt: skip
def test_a_mask_that_is_none_is_refused_in_one_line(tmp_path: Path, mask: Any) -> None:
    path = written(tmp_path / "a.json", [result(1, bbox=[0, 0, 0, 0], segmentation=mask)])
    with pytest.raises(FileFormatError, match="detection 0: bbox is empty and segmentation"):
        read_coco(path, frames())
