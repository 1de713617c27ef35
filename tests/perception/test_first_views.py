"""The image that the paper's section III-B chooses: detection, centrality, then a classifier."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from tests.perception.views.painted_box import FRIDGE, camera, image

from momapos.core.geometry.transforms import apply
from momapos.model.records.protocols import ArticulationPredictor
from momapos.model.records.scans import (
    Cloud,
    Detection,
    FaceImage,
    Frame,
    Front,
    ImageDetection,
    Part,
)
from momapos.perception.modeling import front_of
from momapos.perception.records import Found, ScanConfig, Survey, Tools
from momapos.perception.segmentation.room_shell import RoomShell
from momapos.perception.views.faces import box_faces
from momapos.perception.views.placed_parts import observations, projection

FIRST = ScanConfig(views="first")
ITEM = Detection("fridge_1", "fridge", 1.0, FRIDGE, np.zeros(0, int))
DOOR = Part("door_left", (0.0, 0.0, 1.0, 1.0), 0.9, handle=(0.8, 0.4, 0.9, 0.6))


def gray(world: np.ndarray, normals: np.ndarray) -> np.ndarray:
    del normals
    return np.full((len(world), 3), 128)


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    """Return three frontal images in which the box is ever less central."""
    face = box_faces(FRIDGE)[2]
    (eye,) = apply(face.T_world_face, np.array([[0.0, 0.2, 2.6]]))
    targets = FRIDGE.center + np.outer([0.0, 0.15, 0.3], [0.0, 1.0, 0.0])
    return [
        image(camera(tuple(eye), tuple(at)), FRIDGE, gray, name=str(k))
        for k, at in enumerate(targets)
    ]


def always(_: FaceImage, label: str) -> Front:
    del label
    return Front(0.9, (DOOR,))


def surveyed(frames: Sequence[Frame], found: Found | None) -> Survey:
    nothing = Cloud(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3), np.uint8))
    return Survey(
        nothing, tuple(frames), np.eye(4), RoomShell(), (ITEM,), (), (), found, {}
    )  # fmt: skip


def chosen(
    frames: Sequence[Frame], found: Found | None, look: ArticulationPredictor = always
) -> str:
    """Return the name of the image that shows the front; "" without a front."""
    tools = Tools(lambda _: [], look, look)
    view = front_of(ITEM, surveyed(frames, found), tools, FIRST)
    return "" if view is None else frames[view.frame].name


def detected(frame: Frame, score: float) -> list[ImageDetection]:
    rectangle = projection(FRIDGE, frame)
    return [ImageDetection(rectangle, "fridge", score)]


def test_the_most_central_image_that_detects_the_object_is_chosen(frames: list[Frame]) -> None:
    scores = {"1": 0.6, "2": 0.95}
    found = {f.name: detected(f, scores[f.name]) for f in frames if f.name in scores}
    assert chosen(frames, found) == "1"  # centrality decides, not the score


def test_a_doubtful_detection_does_not_locate_an_object(frames: list[Frame]) -> None:
    scores = {"0": 0.4, "1": 0.4, "2": 0.9}
    assert chosen(frames, {f.name: detected(f, scores[f.name]) for f in frames}) == "2"
    found = {f.name: detected(f, 0.3) for f in frames}
    assert observations(FRIDGE, frames, found)
    assert observations(FRIDGE, frames, found, 0.5) == []


def test_projections_locate_an_object_that_no_image_detects(frames: list[Frame]) -> None:
    assert chosen(frames, None) == "0"
    assert chosen(frames, {}) == "0"
    assert chosen(frames, {f.name: detected(f, 0.1) for f in frames}) == "0"


def test_the_next_image_is_tried_if_the_classifier_rejects_the_first(frames: list[Frame]) -> None:
    dark = [replace(frames[0], color=frames[0].color // 4), *frames[1:]]

    def bright(face: FaceImage, label: str) -> Front:
        return always(face, label) if face.color.mean() > 100 else Front(0.1, ())

    assert chosen(frames, None, bright) == "0"
    assert chosen(dark, None, bright) == "1"
    assert chosen(dark[:1], None, bright) == ""
