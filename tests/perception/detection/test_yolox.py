"""The YOLOX detector decodes, suppresses and refuses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests import optional
from tests.real import DATA

import momapos.perception.reconstruction
from momapos.core.errors import FileFormatError, InputError
from momapos.model.records.scans import Frame, ImageDetection
from momapos.perception.detection.coco import COCO80, LABELS, WITHOUT_DOORS, label_of_class
from momapos.perception.detection.relabel import LONGEST_EDGE
from momapos.perception.detection.yolox import (
    YoloxDetector,
    decode,
    detect,
    letterbox,
    suppress,
    turned_back,
    turns_to_upright,
)
from momapos.perception.recordings.scan_reader import read_scan

FRONT = Path(momapos.perception.reconstruction.__file__).parent / "weights" / "front_face.onnx"
"""A network of another layout."""


def yolox() -> Path:
    return optional.there(DATA / "models" / "yolox_nano.onnx")


def iou(a: np.ndarray, b: np.ndarray) -> float:
    both = np.prod(np.maximum(np.minimum(a[2:], b[2:]) - np.maximum(a[:2], b[:2]), 0))
    return float(both / (np.prod(a[2:] - a[:2]) + np.prod(b[2:] - b[:2]) - both))


def test_decoding_undoes_the_encoding_of_boxes_by_cells() -> None:
    rng = np.random.default_rng(0)
    boxes = np.sort(rng.uniform(0, 400, (50, 2, 2)), axis=1).reshape(50, 4)
    corners = rng.integers(0, 50, (50, 2)).astype(float)
    strides = rng.choice([8.0, 16.0, 32.0], (50, 1))
    classes = rng.integers(0, 80, 50)
    rows = np.zeros((50, 85))
    rows[:, :2] = (boxes[:, :2] + boxes[:, 2:]) / 2 / strides - corners
    rows[:, 2:4] = np.log((boxes[:, 2:] - boxes[:, :2]) / strides)
    rows[:, 4], rows[np.arange(50), 5 + classes] = 0.9, 0.8
    rows[::5, 4] = 0.2
    found, scores, kinds = decode(rows, corners, strides, 0.3)
    kept = np.arange(50) % 5 != 0
    np.testing.assert_allclose(found, boxes[kept], atol=1e-9)
    np.testing.assert_allclose(scores, 0.72)
    np.testing.assert_array_equal(kinds, classes[kept])


@given(st.integers(0, 2**32 - 1))
def test_suppression_keeps_the_best_box_of_each_group(seed: int) -> None:
    rng = np.random.default_rng(seed)
    low = rng.uniform(0, 60, (30, 2))
    boxes = np.hstack([low, low + rng.uniform(5, 60, (30, 2))])
    scores, classes = rng.uniform(size=30), rng.integers(0, 3, 30)
    kept = suppress(boxes, scores, classes, 0.4).tolist()
    for k in range(30):
        stronger = [
            j for j in kept
            if j != k and classes[j] == classes[k] and scores[j] >= scores[k]
            and iou(boxes[j], boxes[k]) > 0.4
        ]  # fmt: skip
        assert (k in kept) == (not stronger)


def test_an_image_keeps_its_aspect_ratio_and_is_padded_with_gray() -> None:
    color = np.zeros((480, 640, 3), np.uint8)
    color[..., 0] = 200  # red
    padded, scale = letterbox(color, (416, 416))
    assert padded.shape == (1, 3, 416, 416)
    assert scale == pytest.approx(0.65)
    assert (padded[0, 2, :312] == 200).all()
    assert (padded[0, :2, :312] == 0).all()
    assert (padded[0, :, 312:] == 114).all()


@pytest.mark.parametrize("turns", [0, 1, 2, 3])
def test_a_rectangle_of_a_rotated_image_maps_back_to_the_original_image(turns: int) -> None:
    taken = np.zeros((40, 60))
    taken[5:12, 20:50] = 1
    rows, columns = np.nonzero(np.rot90(taken, turns))
    left, top = float(columns.min()), float(rows.min())
    box = (left, top, float(columns.max()) + 1, float(rows.max()) + 1)
    assert turned_back(box, turns, (60, 40)) == (20, 5, 50, 12)


@pytest.mark.parametrize("turns", [0, 1, 2, 3])
def test_the_image_of_a_camera_on_its_side_is_rotated_upright(turns: int) -> None:
    # The mark points to the world's up; the camera is rolled.
    roll = turns * np.pi / 2
    R = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    c, s = np.cos(roll), np.sin(roll)
    T = np.eye(4)
    T[:3, :3] = R @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    up = T[:3, :3].T @ [0, 0, 1]
    taken = np.zeros((41, 41, 3), np.uint8)
    taken[round(20 + 15 * up[1]), round(20 + 15 * up[0])] = 255
    shown = np.rot90(taken, turns_to_upright(T))
    assert shown[5, 20].all()


def test_detections_are_given_in_the_original_image() -> None:
    T = np.eye(4)
    T[:3, :3] = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]) @ np.diag([-1.0, -1.0, 1.0])
    frame = Frame("f", np.zeros((40, 60, 3), np.uint8), None, np.eye(3), T)
    frame.color[2:6, 3:9] = 255

    class Bright:
        labels = frozenset({"cup"})

        def __call__(self, color: np.ndarray) -> list[ImageDetection]:
            rows, columns = np.nonzero(color[..., 0])
            assert rows.min() > 20  # it was upside down
            box = (columns.min(), rows.min(), columns.max() + 1, rows.max() + 1)
            return [ImageDetection(tuple(map(float, box)), "cup", 0.5)]

    assert detect([frame], Bright())["f"] == [ImageDetection((3.0, 2.0, 9.0, 6.0), "cup", 0.5)]


def test_every_label_has_a_size_and_people_are_not_objects() -> None:
    assert len(COCO80) == 80
    assert set(LONGEST_EDGE) == LABELS - {""}
    assert WITHOUT_DOORS < LABELS
    assert label_of_class(COCO80.index("refrigerator")) == "fridge"
    assert label_of_class(COCO80.index("person")) == ""
    assert label_of_class(80) == ""


@pytest.mark.parametrize(
    ("content", "word"),
    [
        (b"", "ONNX network"),
        (b"\x08\x07" * 50, "ONNX network"),
        (FRONT.read_bytes(), "80 classes of COCO"),
    ],
)
def test_a_file_that_is_not_such_a_detector_is_refused_in_one_line(
    content: bytes, word: str, tmp_path: Path
) -> None:
    path = tmp_path / "network.onnx"
    path.write_bytes(content)
    with pytest.raises(FileFormatError, match=word) as caught:
        YoloxDetector(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
    with pytest.raises(FileFormatError, match="no such file"):
        YoloxDetector(tmp_path / "none.onnx")


def test_thresholds_out_of_range_are_refused() -> None:
    with pytest.raises(InputError, match="between 0 and 1"):
        YoloxDetector(FRONT, score=0.0)


def test_chair_table_and_cup_are_detected_in_a_real_kitchen() -> None:
    detector = YoloxDetector(yolox())
    scan = read_scan(optional.there(DATA / "redkitchen"), max_frames=2)
    found = detector(scan.frames[0].color)
    labels = {item.label for item in found if item.score > 0.4}
    assert {"chair", "table", "cup"} <= labels
    height, width = scan.frames[0].color.shape[:2]
    for item in found:
        left, top, right, bottom = item.box
        assert 0 <= left < right <= width
        assert 0 <= top < bottom <= height
        assert item.label in LABELS
