"""Overviews show labeled boxes and parts on the images that together show most objects."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image
from tests.furnished import Camera, Corners, cloud_of, look_at, photograph

from momapos.apps.plots.scan_overview import draw_overviews
from momapos.core.geometry.polygons import from_corners
from momapos.model.records.scans import Detection, FaceImage, Front, Part
from momapos.perception.reconstruction.object_model import furniture_model
from momapos.perception.records import Decision, Modeled, PartSource
from momapos.perception.segmentation.instance_boxes import inside
from momapos.perception.views.faces import box_faces
from momapos.perception.views.front_view import FaceSurroundings, FrontView

CABINET: Corners = ((-0.4, 0.0, 0.0), (0.4, 0.6, 0.9))
CRATE: Corners = ((2.5, -2.8, 0.0), (3.0, -2.2, 0.5))
FRAMES = (
    ("dull", look_at((0.0, -2.0, 1.2), (0.0, -4.0, 1.0))),
    ("cabinet", look_at((0.2, -2.0, 1.2), (0.0, 0.0, 0.5))),
    ("again", look_at((0.3, -2.1, 1.2), (0.0, 0.0, 0.5))),
    ("crate", look_at((1.0, -2.5, 1.2), (2.7, -2.5, 0.3))),
)
FLOOR: Corners = ((-3.0, -3.0, -0.1), (3.0, 1.0, 0.0))


def made() -> Modeled:
    """Return a room with a cabinet that opens and a crate that does not."""
    cloud = cloud_of([CABINET, CRATE, FLOOR], np.random.default_rng(0), 0.03)
    frames = tuple(
        replace(photograph([CABINET, CRATE, FLOOR], T, Camera(320, 240, 260.0)), name=name)
        for name, T in FRAMES
    )
    decisions = []
    for name, corners in (("cabinet", CABINET), ("crate", CRATE)):
        box = from_corners(*map(np.array, corners))
        members = np.flatnonzero(inside(cloud.points, box))
        item = Detection(f"{name}_1", name, 0.9, box, members)
        decisions.append(Decision(item, None, None, (), None, "no front"))
    part = Part("door_left", (0.0, 0.0, 1.0, 1.0), 0.8, (0.85, 0.4, 0.9, 0.6))
    face = box_faces(decisions[0].detection.box)[3]
    gray = np.full((90, 80, 3), 90, np.uint8)
    image = FaceImage(gray, np.zeros((90, 80), np.float32), face.width, face.height)
    view = FrontView(face, 1, 0.0, image, Front(0.9, (part,)), FaceSurroundings(face, (image,)), ())
    model = furniture_model(decisions[0].detection, -np.pi / 2, image, (part,))
    decisions[0] = replace(
        decisions[0], view=view, parts=(part,), source=PartSource.PREDICTED, model=model, reason=""
    )
    return Modeled(Path("a.json"), cloud, frames, np.eye(4), tuple(decisions))


def test_two_images_show_both_objects_and_the_door_is_tinted(tmp_path: Path) -> None:
    room = made()
    files = draw_overviews(room, tmp_path)
    assert [file.name for file in files] == ["overview_1.png", "overview_2.png"]
    plain = replace(room.decisions[0], parts=())
    (tmp_path / "plain").mkdir()
    others = draw_overviews(replace(room, decisions=(plain, room.decisions[1])), tmp_path / "plain")
    first, bare = (
        np.asarray(Image.open(path).convert("RGB"), int) for path in (files[0], others[0])
    )
    assert first.shape == bare.shape
    changed = (np.abs(first - bare).max(axis=2) > 20).mean()
    assert 0.03 < changed < 0.5, "the door covers a part of the image"
    second, same = (np.asarray(Image.open(path)) for path in (files[1], others[1]))
    np.testing.assert_array_equal(second, same)


def test_a_cloud_without_images_has_no_overview(tmp_path: Path) -> None:
    assert draw_overviews(replace(made(), frames=()), tmp_path) == []
    assert draw_overviews(replace(made(), decisions=()), tmp_path) == []
