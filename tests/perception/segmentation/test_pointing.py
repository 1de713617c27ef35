"""A point and a pixel select the same object."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.perception.views.painted_box import FRIDGE, camera, image

from momapos.core.errors import InputError, UnknownNameError
from momapos.core.geometry.polygons import UprightBox
from momapos.model.records.scans import Detection
from momapos.perception.segmentation.pointing import PixelOf, PointAt, pointed_at

CUP = UprightBox(np.array([2.0, 0.5, 1.85]), np.array([0.1, 0.1, 0.1]))


def detection(name: str, box: UprightBox) -> Detection:
    return Detection(name, name, 1.0, box, np.zeros(0, int))


DETECTIONS = [detection("fridge", FRIDGE), detection("cup", CUP)]
FRAME = image(
    camera((-0.5, 0.4, 1.2), tuple(FRIDGE.center)),
    FRIDGE,
    lambda world, _: np.zeros((len(world), 3)),
    name="f",
)


def test_a_point_selects_the_smallest_object_around_it_or_the_nearest() -> None:
    assert pointed_at(PointAt((2.0, 0.5, 1.0)), DETECTIONS, ()).name == "fridge"
    assert pointed_at(PointAt((2.0, 0.5, 1.85)), DETECTIONS, ()).name == "cup"
    nested = [*DETECTIONS, detection("shelf", UprightBox(FRIDGE.center, np.array([0.2, 0.2, 0.2])))]
    assert pointed_at(PointAt(tuple(FRIDGE.center)), nested, ()).name == "shelf"
    assert pointed_at(PointAt((2.0, 0.5, 1.99)), DETECTIONS, ()).name == "cup"
    with pytest.raises(InputError, match="the nearest is fridge"):
        pointed_at(PointAt((0.0, 0.5, 1.0)), DETECTIONS, ())


@pytest.mark.parametrize("blind", [False, True])
def test_a_pixel_selects_what_it_shows_with_and_without_depth(blind: bool) -> None:
    frame = replace(FRAME, depth=None) if blind else FRAME
    assert pointed_at(PixelOf("f", 320, 240), DETECTIONS, [frame]).name == "fridge"
    behind = [
        detection("behind", replace(FRIDGE, center=FRIDGE.center + np.array([1.0, 0, 0]))),
        *DETECTIONS,
    ]
    assert pointed_at(PixelOf("f", 320, 240), behind, [frame]).name == "fridge"
    with pytest.raises(InputError, match="there is no object"):
        pointed_at(PixelOf("f", 2, 2), DETECTIONS, [frame])


def test_a_pixel_outside_of_the_images_is_refused() -> None:
    with pytest.raises(InputError, match="640 x 480"):
        pointed_at(PixelOf("f", 640, 0), DETECTIONS, [FRAME])
    with pytest.raises(UnknownNameError, match="no frame"):
        pointed_at(PixelOf("g", 0, 0), DETECTIONS, [FRAME])
