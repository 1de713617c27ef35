"""A part needs a handle, or a seam where its surface continues."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.perception.views.painted_box import FRIDGE, camera, image

from momapos.core.geometry.transforms import apply
from momapos.model.records.scans import FaceImage, Front, Part
from momapos.perception.views.faces import Face, box_faces
from momapos.perception.views.front_view import FaceSurroundings, FrontView, choose_view
from momapos.perception.views.part_evidence import borders, parts_with_evidence, tilt
from momapos.perception.views.placed_parts import observations

PIXEL = 0.003
AROUND = 0.1
DOOR = Part("door_left", (0.3, 0.2, 0.7, 0.8), 0.6)
WHOLE = Part("door_left", (0.0, 0.0, 1.0, 1.0), 0.6)
HANDLE = (0.4, 0.25, 0.6, 0.265)
"""A level bar of 12 x 0.9 cm near the top of DOOR."""
KNOB = (0.5, 0.4, 0.55, 0.45)
"""A knob of 3 cm."""
FACE = Face(0, np.eye(4), 0.6, 0.6)


def plain(seed: int = 0) -> FaceImage:
    """Return a flat gray face of 60 cm with surroundings in its plane, with a camera's noise."""
    rng = np.random.default_rng(seed)
    side = round((FACE.width + 2 * AROUND) / PIXEL)
    color = np.clip(150 + rng.normal(0, 4, (side, side, 3)), 0, 255).astype(np.uint8)
    heights = rng.normal(0, 0.003, (side, side)).astype(np.float32)
    return FaceImage(color, heights, FACE.width + 2 * AROUND, FACE.height + 2 * AROUND)


def pixels(box: tuple[float, float, float, float]) -> tuple[int, int, int, int]:
    """Return the edges of a box on the face, in pixels of its image with the surroundings."""
    left, top, right, bottom = (round((AROUND + v * FACE.width) / PIXEL) for v in box)
    return left, top, right, bottom


def with_seam(image: FaceImage, box: tuple[float, float, float, float], sides: str) -> FaceImage:
    """Darken a line of one pixel along some sides of a box."""
    color = image.color.copy()
    left, top, right, bottom = pixels(box)
    for side, rows, columns in (
        ("left", slice(top, bottom), left), ("right", slice(top, bottom), right),
        ("top", top, slice(left, right)), ("bottom", bottom, slice(left, right)),
    ):  # fmt: skip
        if side in sides:
            color[rows, columns] = color[rows, columns] * 0.6
    return replace(image, color=color)


def with_bar(image: FaceImage, box: tuple[float, float, float, float], out: float) -> FaceImage:
    """Paint a bright bar that protrudes [m]."""
    color, heights = image.color.copy(), image.height_map.copy()
    left, top, right, bottom = pixels(box)
    color[top:bottom, left:right] = 230
    heights[top:bottom, left:right] += out
    return replace(image, color=color, height_map=heights)


def kept(image: FaceImage, *parts: Part, score: float = 0.9) -> tuple[Part, ...]:
    return kept_in([image], *parts, score=score)


def kept_in(images: list[FaceImage], *parts: Part, score: float = 0.9) -> tuple[Part, ...]:
    around = replace(FACE, width=images[0].width, height=images[0].height)
    return parts_with_evidence(parts, FACE, FaceSurroundings(around, tuple(images)), score)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("part", [DOOR, WHOLE, replace(DOOR, handle=HANDLE)])
def test_nothing_opens_on_a_plain_surface(part: Part, seed: int) -> None:
    assert kept(plain(seed), part) == ()


def test_a_box_that_ends_at_its_edges_shows_no_seam() -> None:
    image = plain()
    heights = np.full_like(image.height_map, -0.5)
    left, top, right, bottom = pixels(WHOLE.box)
    heights[top:bottom, left:right] = image.height_map[top:bottom, left:right]
    blank = replace(image, height_map=heights)
    assert not any(edge.flush for edge in borders([blank], (0.125, 0.125, 0.875, 0.875)))
    assert kept(blank, WHOLE) == ()


def test_a_seam_around_a_part_is_enough() -> None:
    image = with_seam(plain(), DOOR.box, "left top right bottom")
    assert kept(image, DOOR) == (DOOR,)


@pytest.mark.parametrize("sides", ["left right bottom", "left", "top bottom"])
def test_a_part_without_a_handle_needs_a_seam_on_every_side(sides: str) -> None:
    assert kept(with_seam(plain(), DOOR.box, sides), DOOR) == ()


def test_a_part_of_another_color_without_a_seam_is_a_picture() -> None:
    image = plain()
    left, top, right, bottom = pixels(DOOR.box)
    color = image.color.copy()
    color[top:bottom, left:right] = 60
    assert kept(replace(image, color=color), DOOR) == ()


def test_a_handle_is_enough_even_if_no_seam_is_visible() -> None:
    held = replace(DOOR, handle=HANDLE)
    assert kept(with_bar(plain(), HANDLE, 0.03), held) == (held,)
    assert kept(with_bar(plain(), HANDLE, 0.0), held) == (held,)  # too thin for the depth camera


def test_a_line_that_runs_beyond_a_handle_on_both_sides_is_no_handle() -> None:
    held = replace(DOOR, handle=HANDLE)
    line = (DOOR.box[0], HANDLE[1], DOOR.box[2], HANDLE[3])
    assert kept(with_bar(plain(), line, 0.0), held) == ()


def test_a_pale_knob_is_a_handle_if_several_images_show_it() -> None:
    held = replace(DOOR, handle=KNOB)

    def with_knob(seed: int) -> FaceImage:
        image = plain(seed)
        left, top, right, bottom = pixels(KNOB)
        color = image.color.copy()
        color[top:bottom, left:right] -= 12
        return replace(image, color=color)

    shown, blank = [with_knob(seed) for seed in range(3)], [plain(seed) for seed in range(3)]
    assert kept_in(shown, held) == (held,)
    assert kept_in(shown[:1], held) == ()
    assert kept_in([shown[0], *blank[1:]], held) == ()
    assert kept_in(blank, held) == ()


def test_on_an_improbable_front_a_handle_must_protrude() -> None:
    held = replace(DOOR, handle=HANDLE)
    assert kept(with_bar(plain(), HANDLE, 0.0), held, score=0.1) == ()
    assert kept(with_bar(plain(), HANDLE, 0.04), held, score=0.1) == (held,)


def test_a_leaning_surface_is_no_front() -> None:
    held = replace(DOOR, handle=HANDLE)
    image = with_bar(with_seam(plain(), DOOR.box, "left top right bottom"), HANDLE, 0.03)
    slope = np.tan(np.radians(20)) * PIXEL * np.arange(len(image.height_map))[:, None]
    leaning = replace(image, height_map=(image.height_map + slope).astype(np.float32))
    assert tilt(leaning, DOOR.box) == pytest.approx(20, abs=1)
    assert kept(leaning, held) == ()


def test_neighbors_of_one_size_are_supported_together() -> None:
    held = replace(DOOR, box=(0.0, 0.2, 0.33, 0.8), handle=(0.1, 0.25, 0.23, 0.265))
    next_to_it = replace(DOOR, box=(0.33, 0.2, 0.66, 0.8))
    after_that = replace(DOOR, box=(0.66, 0.2, 0.99, 0.8))
    wider = replace(DOOR, box=(0.33, 0.2, 0.99, 0.8))
    image = with_bar(plain(), held.handle, 0.03)
    assert kept(image, held, next_to_it, after_that) == (held, next_to_it, after_that)
    assert kept(image, held, wider) == (held,)


def test_three_stacked_parts_with_handles_in_line_support_each_other() -> None:
    stack = [
        Part("drawer", (0.2, top, 0.8, top + 0.3), 0.6, (0.4, top + 0.05, 0.6, top + 0.06))
        for top in (0.0, 0.31, 0.62)
    ]
    assert kept(plain(), *stack) == tuple(stack)
    assert kept(plain(), *stack[:2]) == ()
    bare = [replace(part, handle=None) for part in stack]
    assert kept(plain(), *bare) == ()


def test_a_strip_between_two_seams_needs_a_handle() -> None:
    strip = replace(DOOR, box=(0.1, 0.4, 0.9, 0.5))
    assert kept(with_seam(plain(), strip.box, "left top right bottom"), strip) == ()


def seen_front(seam: float) -> tuple[FrontView, tuple[Part, ...]]:
    """Return the front of a box with a seam of 8 mm of this darkness, and the parts that remain of
    a freezer door and a fridge door without handles, which a network sees on it."""
    face = box_faces(FRIDGE)[2]

    def paint(world: np.ndarray, normals: np.ndarray) -> np.ndarray:
        front = normals @ face.outward > 0.9
        dark = front & (np.abs(world[:, 2] - 1.26) < 0.004)
        return np.full(world.shape, 180.0) * np.where(dark, 1.0 - seam, 1.0)[:, None]

    eyes = [apply(face.T_world_face, np.array([[x, 0.2, 2.2]]))[0] for x in (-0.3, 0.0, 0.4)]
    frames = [image(camera(tuple(eye), tuple(FRIDGE.center)), FRIDGE, paint) for eye in eyes]
    doors = (
        Part("door_left", (0.0, 0.0, 1.0, 0.3), 0.9), Part("door_left", (0.0, 0.3, 1.0, 1.0), 0.9),
    )  # fmt: skip

    def look(seen: FaceImage) -> Front:
        margin = (seen.height - face.height) / 2 / seen.height
        scale, shift = face.height / seen.height, np.array([0.0, margin, 0.0, margin])
        boxes = [np.array(door.box) * (1, scale, 1, scale) + shift for door in doors]
        return Front(
            1.0, tuple(replace(d, box=tuple(b)) for d, b in zip(doors, boxes, strict=True))
        )

    view = choose_view(FRIDGE, frames, observations(FRIDGE, frames), look)
    kept = parts_with_evidence(view.front.parts, view.face, view.surroundings, view.front.score)
    return view, kept


def test_in_images_of_a_box_a_seam_decides_whether_it_has_doors() -> None:
    view, parts = seen_front(seam=0.7)
    assert len(view.front.parts) == len(view.surroundings.images) - 1 == len(parts) == 2
    view, parts = seen_front(seam=0.0)
    assert len(view.front.parts) == 2
    assert parts == ()


def test_no_parts_stay_no_parts() -> None:
    assert kept(plain()) == ()
