"""One object is modeled from one image and a box, to scale, or refused in one line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests import optional
from tests.commands import error_of, json_of

from momapos.core.errors import InputError
from momapos.model.records.scans import FaceImage, Front, Part
from momapos.model.scene.scene_files import load_scene
from momapos.perception.modeling import Photo, model_photo
from momapos.perception.records import Tools

DOOR = Part("door_left", (0.0, 0.4, 1.0, 1.0), 0.9, (0.8, 0.5, 0.9, 0.55))
DRAWER = Part("drawer", (0.0, 0.0, 1.0, 0.4), 0.8)


def tools(seen: list[FaceImage], score: float = 0.9) -> Tools:
    """Return a predictor that remembers what it was shown."""

    def look(face: FaceImage, _: str) -> Front:
        seen.append(face)
        return Front(score, (DOOR, DRAWER))

    return Tools(lambda _: [], look, look)


def photo(**changes: object) -> Photo:
    color = np.zeros((300, 400, 3), np.uint8)
    color[50:250, 100:220] = np.arange(120)[None, :, None]
    values = {"name": "p.jpg", "color": color, "box": (100.0, 50.0, 220.0, 250.0),
              "label": "cabinet", "size": None}  # fmt: skip
    return Photo(**{**values, **changes})  # type: ignore[arg-type]


def test_the_box_is_cut_out_and_its_parts_get_joints(tmp_path: Path) -> None:
    seen: list[FaceImage] = []
    made = model_photo(photo(size=(0.6, 0.5, 1.0)), tmp_path / "a.json", tools(seen))
    (face, *_) = seen
    assert face.color.shape == (200, 120, 3)
    np.testing.assert_array_equal(face.color[0, :, 0], np.arange(120))
    assert (face.width, face.height) == (0.6, 1.0)
    assert np.isnan(face.height_map).all()
    scene = load_scene(made.scene)
    (item,) = scene.objects
    assert item.name == "cabinet_1"
    assert len(item.model.joints) == 2
    assert scene.start[1] < -1.0, "in front of the front"
    assert made.warnings == ()


def test_the_front_lies_in_the_box_of_the_image(tmp_path: Path) -> None:
    made = model_photo(photo(), tmp_path / "a.json", tools([]))
    (decision,) = made.decisions
    frame, face = made.frames[0], decision.view.face
    corners = np.array([[x, y, 0, 1] for x in (-0.5, 0.5) for y in (-0.5, 0.5)], float)
    corners[:, :2] *= face.width, face.height
    local = np.linalg.inv(frame.T_world_camera) @ face.T_world_face @ corners.T
    pixels = (frame.intrinsics @ local[:3])[:2] / local[2]
    np.testing.assert_allclose(pixels.min(axis=1), (100, 50), atol=1e-6)
    np.testing.assert_allclose(pixels.max(axis=1), (220, 250), atol=1e-6)


@pytest.mark.parametrize(("label", "height"), [("fridge", 1.8), ("microwave", 0.28)])
def test_a_label_gives_the_usual_size_and_says_so(
    tmp_path: Path, label: str, height: float
) -> None:
    made = model_photo(photo(label=label), tmp_path / "a.json", tools([], score=0.2))
    size = made.decisions[0].detection.box.size
    assert size[2] == height
    assert size[0] == pytest.approx(0.6 * height), "the proportions of the box"
    assert f"{height:g} m high" in made.warnings[0]
    assert "probability 0.20" in made.warnings[1]


@pytest.mark.parametrize(
    ("changes", "hint"),
    [
        ({"box": (100, 50, 401, 250)}, "not within the image of 400 x 300"),
        ({"box": (220, 50, 100, 250)}, "not within"),
        ({"box": (100, 50, 120, 250)}, "too small"),
        ({"label": "spaceship"}, "give --size"),
    ],
)
def test_a_box_or_size_that_is_not_usable_is_refused(
    tmp_path: Path, changes: dict[str, object], hint: str
) -> None:
    with pytest.raises(InputError, match=hint) as caught:
        model_photo(photo(**changes), tmp_path / "a.json", tools([]))
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("words", "hint"),
    [
        ([], "give a scan (DIR), or --photo FILE with --box"),
        (["scan", "--photo", "p.png", "--box", "1,2,3,4"], "give one"),
        (["--photo", "p.png"], "--photo needs --box"),
        (["scan", "--box", "1,2,3,4"], "belong to --photo"),
        (["scan", "--size", "1,2,3"], "belong to --photo"),
        (["--photo", "p.png", "--box", "1,2,3"], "--box '1,2,3': must be LEFT,TOP,RIGHT,BOTTOM"),
        (["--photo", "p.png", "--box", "1,2,90,90", "--size", "1,2"], "must be WIDTH,DEPTH,HEIGHT"),
        (["--photo", "p.png", "--box", "1,2,90,90", "--size", "1,0,2"], "from 0.05 to 5"),
        (["--photo", "p.png", "--box", "1,2,90,90", "--up", "z"], "--up applies to scans"),
        (["--photo", "p.png", "--box", "1,2,90,90", "--instances", "a"], "--instances applies"),
        (["--photo", "p.png", "--box", "1,2,90,90", "--target", "a"], "--target applies to scans"),
        (["--photo", "p.png", "--box", "1,2,90,90", "--label", "a", "--label", "b"], "one --label"),
        (["--photo", "none.png", "--box", "1,2,90,90"], "no such file"),
        (["--photo", "p.txt", "--box", "1,2,90,90"], "not a JPEG or PNG"),
        (["--photo", "p.png", "--box", "1,2,900,90"], "not within the image of 100 x 100"),
    ],
)
def test_contradicting_options_are_one_line(
    words: list[str], hint: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Image.new("RGB", (100, 100)).save("p.png")
    Path("p.txt").write_text("text")
    assert hint in error_of("scan", *words, "--out", "new/a.json")
    assert not Path("new").exists()


def test_a_product_photo_gives_a_scene_with_its_doors_and_drawers(
    shared: Path, tmp_path: Path
) -> None:
    folder = optional.there(shared / "cabinet_photos")
    photo = ["--photo", str(folder / "label13.png"), "--box", "46,50,465,433"]
    for extra in ([], ["--models", f"cabinet={folder / 'label13.urdf'}"]):
        out = tmp_path / str(len(extra)) / "c.json"
        words = ["scan", *photo, "--size", "1,0.5,0.9", "--out", str(out), *extra]
        data = json_of(*words, "--json")
        kinds = sorted(part["kind"] for part in data["objects"][0]["parts"])
        assert kinds == ["door_left", "door_right", "drawer", "drawer"]
        assert len(load_scene(out).objects[0].model.joints) == 4
