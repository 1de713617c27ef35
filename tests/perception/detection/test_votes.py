"""Votes need rectangle and depth, and several images."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.perception.views.painted_box import FRIDGE, camera, image

from momapos.core.errors import InputError, UnknownNameError
from momapos.core.geometry.polygons import UprightBox
from momapos.core.geometry.transforms import apply
from momapos.model.records.scans import Cloud, Detection, Frame, ImageDetection
from momapos.perception.detection.relabel import (
    Verdict,
    parse_labels,
    relabeled,
    visible_points,
    vote,
    with_given_labels,
)

EYES = [(-0.5, 0.5, 1.0), (-0.4, 0.2, 1.2), (-0.6, 0.9, 1.1), (-0.3, 0.0, 1.3), (-0.5, 1.2, 1.0)]
KNOWN = frozenset({"fridge", "cup", "microwave"})


def gray(world: np.ndarray, normals: np.ndarray) -> np.ndarray:
    del normals
    return np.full((len(world), 3), 128)


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    return [
        image(camera(eye, FRIDGE.center), FRIDGE, gray, name=str(k)) for k, eye in enumerate(EYES)
    ]


def measured(frame: Frame) -> np.ndarray:
    """Return the surface points of one image, in the world."""
    v, u = np.nonzero(frame.depth)
    z = frame.depth[v, u].astype(float)
    rays = np.linalg.solve(frame.intrinsics, np.stack([u, v, np.ones(len(u))]))
    return apply(frame.T_world_camera, (rays * z).T)


def detected(points: np.ndarray, box: UprightBox, **more: object) -> tuple[Detection, Cloud]:
    cloud = Cloud(
        points, np.tile([-1.0, 0, 0], (len(points), 1)), np.zeros((len(points), 3), np.uint8)
    )
    return Detection("a", "microwave", 0.7, box, np.arange(len(points)), **more), cloud


@pytest.fixture(scope="module")
def fridge(frames: list[Frame]) -> tuple[Detection, Cloud]:
    return detected(measured(frames[0])[::50], FRIDGE)


def around(frame: Frame, label: str, score: float, shift: float = 0.0) -> ImageDetection:
    rows, columns = np.nonzero(frame.depth)
    left, right = float(columns.min()) + shift, float(columns.max()) + 1 + shift
    return ImageDetection((left, float(rows.min()), right, float(rows.max()) + 1), label, score)


def test_agreeing_images_label_an_object_with_a_confidence_that_grows_with_their_number(
    frames, fridge
) -> None:
    item, cloud = fridge
    before = 0.0
    for count in (2, 3, 5):
        found = {frame.name: [around(frame, "fridge", 0.6)] for frame in frames[:count]}
        (verdict,) = vote([item], cloud, frames, found)
        assert (verdict.label, verdict.hits, verdict.seen) == ("fridge", count, 5)
        assert before < verdict.confidence <= 1.0
        before = verdict.confidence


def test_a_single_image_never_labels_an_object(frames, fridge) -> None:
    item, cloud = fridge
    twice = [around(frames[0], "fridge", 0.99), around(frames[0], "fridge", 0.98, shift=2)]
    assert vote([item], cloud, frames, {"0": twice})[0] == Verdict("", 0.0, 0, 5)


def test_contradicting_images_lower_the_confidence_of_the_winning_label(frames, fridge) -> None:
    item, cloud = fridge
    alone = {frame.name: [around(frame, "fridge", 0.7)] for frame in frames}
    both = {
        name: [*found, replace(found[0], label="oven", score=0.3)] for name, found in alone.items()
    }
    (sure,), (doubted,) = (vote([item], cloud, frames, found) for found in (alone, both))
    assert sure.label == doubted.label == "fridge"
    assert doubted.confidence < sure.confidence


@pytest.mark.parametrize("shift", [200.0, -200.0])
def test_a_rectangle_next_to_an_object_does_not_vote_for_it(frames, fridge, shift: float) -> None:
    item, cloud = fridge
    found = {frame.name: [around(frame, "fridge", 0.9, shift)] for frame in frames}
    assert vote([item], cloud, frames, found)[0].label == ""


def test_an_object_behind_another_one_in_a_rectangle_is_not_labeled(frames, fridge) -> None:
    item, cloud = fridge
    away = replace(FRIDGE, center=FRIDGE.center + np.array([1.5, 0, 0]))
    hidden, behind = detected(cloud.points + np.array([1.5, 0, 0]), away)
    found = {frame.name: [around(frame, "fridge", 0.9)] for frame in frames}
    assert vote([hidden], behind, frames, found)[0].seen == 0
    without = [replace(frame, depth=None) for frame in frames]
    assert vote([hidden], behind, without, found)[0].seen == 5
    del item


def test_a_label_that_contradicts_the_size_is_ignored(frames, fridge) -> None:
    item, cloud = fridge
    found = {frame.name: [around(frame, "cup", 0.9)] for frame in frames}
    assert vote([item], cloud, frames, found)[0].label == ""


def test_a_point_is_visible_where_its_depth_or_no_depth_was_measured(frames) -> None:
    frame = frames[0]
    points = measured(frame)[::200]
    assert visible_points(frame, points, 0.03)[1].all()
    eye = frame.T_world_camera[:3, 3]
    assert not visible_points(frame, eye + 1.2 * (points - eye), 0.03)[1].any()
    blind = replace(frame, depth=np.zeros_like(frame.depth))
    assert visible_points(blind, eye + 1.2 * (points - eye), 0.03)[1].all()
    assert not visible_points(frame, eye - (points - eye), 0.03)[1].any()


GUESSES = (("microwave", 0.7), ("box", 0.4))


@pytest.mark.parametrize(
    ("seen", "known", "label"),
    [(0, KNOWN, "microwave"), (1, KNOWN, "microwave"), (3, KNOWN, "box"), (9, KNOWN, "box"),
     (9, frozenset({"cup"}), "microwave"), (9, KNOWN | {"box"}, "object")],
)  # fmt: skip
def test_a_label_by_size_is_dropped_after_enough_images_without_a_detection(
    fridge, seen: int, known: frozenset[str], label: str
) -> None:
    item = replace(fridge[0], label_from="size", guesses=GUESSES)
    (named,) = relabeled([item], [Verdict("", 0.0, 0, seen)], known)
    assert named.label == label
    assert named.score <= item.score


def test_labels_from_images_override_sizes_and_given_labels_override_both(fridge) -> None:
    item = replace(fridge[0], label_from="size", guesses=GUESSES)
    (named,) = relabeled([item], [Verdict("fridge", 0.9, 4, 5)], KNOWN)
    assert (named.label, named.score, named.label_from) == ("fridge", 0.9, "detector")
    (kept,) = relabeled([replace(item, label_from="segmenter")], [Verdict("", 0.0, 0, 9)], KNOWN)
    assert kept.label == "microwave"
    (given,) = with_given_labels([named], {"a": "wall cabinet"})
    assert (given.label, given.label_from) == ("wall cabinet", "given")
    with pytest.raises(UnknownNameError, match="no object 'b'"):
        with_given_labels([named], {"b": "fridge"})
    with pytest.raises(InputError, match="lowercase letters"):
        with_given_labels([named], {"a": "../fridge"})


@pytest.mark.parametrize("texts", [["a"], ["=b"], ["a="], ["a=b", "a=c"]])
def test_malformed_and_repeated_labels_are_refused(texts: list[str]) -> None:
    assert parse_labels(["a=b", "c=d e"]) == {"a": "b", "c": "d e"}
    with pytest.raises(InputError, match=r"^label "):
        parse_labels(texts)
