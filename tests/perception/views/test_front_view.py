from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.perception.views.painted_box import FRIDGE, camera, image

from momapos.core.geometry.polygons import UprightBox
from momapos.core.geometry.transforms import apply
from momapos.model.records.scans import FaceImage, Frame, Front, Part
from momapos.perception.views.faces import box_faces
from momapos.perception.views.front_view import (
    KnownFront,
    ViewMethod,
    choose_view,
    door_evidence,
    front_evidence,
    split_row,
)
from momapos.perception.views.placed_parts import most_confident, observations, transferred

FRONT = 2


def paint(world: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Paint the front red, and the other faces blue."""
    del world
    front = normals @ box_faces(FRIDGE)[FRONT].outward > 0.9
    return np.where(front[:, None], [200, 0, 0], [0, 0, 200])


def around(offsets: list[float], index: int) -> list[Frame]:
    """Return images of a face from places next to its normal."""
    face = box_faces(FRIDGE)[index]
    eyes = [apply(face.T_world_face, np.array([[off, 0.2, 2.2]]))[0] for off in offsets]
    return [image(camera(tuple(eye), tuple(FRIDGE.center)), FRIDGE, paint) for eye in eyes]


def red_is_front(face: FaceImage) -> Front:
    red = float((face.color[..., 0] > 100).mean())
    door = Part("door_left", (0.0, 0.0, 1.0, 1.0), red, handle=(0.8, 0.4, 0.9, 0.6))
    return Front(red, (door,) if red > 0.5 else ())


def test_the_front_is_the_face_for_which_the_images_vote() -> None:
    frames = around([0.0, 0.3, 0.9], 3) + around([-0.9, 0.2, 0.6], FRONT)
    view = choose_view(FRIDGE, frames, observations(FRIDGE, frames), red_is_front)
    assert view.face.index == FRONT
    assert view.frame == 4  # the one nearest to the normal
    assert np.degrees(view.angle) < 20
    assert view.evidence[FRONT] > 0.9 > 0.1 > view.evidence[3]
    assert len(view.front.parts) == 1


def test_the_front_of_two_similar_faces_is_the_one_away_from_the_wall() -> None:
    def all_fronts(face: FaceImage) -> Front:
        door = Part("door_left", (0.0, 0.0, 1.0, 1.0), 0.7, handle=(0.8, 0.4, 0.9, 0.6))
        return Front(0.9 if face.color[..., 2].mean() > 100 else 0.8, (door,))

    frames = around([0.0, 0.2], 3) + around([0.0, 0.2], FRONT)
    seen = observations(FRIDGE, frames)
    anywhere = choose_view(FRIDGE, frames, seen, all_fronts)
    assert anywhere.face.index == 3
    backed = [index == FRONT for index in range(4)]
    at_wall = choose_view(FRIDGE, frames, seen, all_fronts, "voting", (), backed)
    assert at_wall.face.index == FRONT


def test_voting_corrects_a_wrong_image_and_first_does_not() -> None:
    frames = around([0.0, 0.2, 0.1], 3) + around([0.1, 0.2, 0.3], FRONT)
    lies = replace(frames[0], color=np.full_like(frames[0].color, 0) + np.uint8([200, 0, 0]))
    frames[0] = lies
    seen = observations(FRIDGE, frames)
    voted = choose_view(FRIDGE, frames, seen, red_is_front)
    first = choose_view(FRIDGE, frames, seen[:1], red_is_front, "first")
    assert seen[0].frame == 0
    assert voted.face.index == FRONT
    assert first.face.index == 3


def test_the_score_of_a_front_is_the_mean_of_its_images() -> None:
    def by_brightness(face: FaceImage) -> Front:
        score = 0.2 if face.color[..., 0].max() < 220 else 0.9
        door = Part("door_left", (0.0, 0.0, 1.0, 1.0), 0.9, handle=(0.8, 0.4, 0.9, 0.6))
        return Front(score, (door,))

    frames = around([0.0, 0.1, 0.2], FRONT)
    frames[1:] = [
        replace(one, color=np.minimum(one.color, 199) + np.uint8(40)) for one in frames[1:]
    ]
    view = choose_view(FRIDGE, frames, observations(FRIDGE, frames), by_brightness)
    assert view.frame == 0
    assert view.front.score == pytest.approx((0.2 + 0.9 + 0.9) / 3)


def test_first_takes_the_most_central_frontal_image() -> None:
    frames = around([1.5, 0.2, 0.0], FRONT)
    seen = observations(FRIDGE, frames)
    view = choose_view(FRIDGE, frames, seen, red_is_front, "first")
    angles = {0: 34, 1: 5, 2: 0}
    passing = [s.frame for s in seen if angles[s.frame] < 30]
    assert view.frame == passing[0]


def test_a_frontal_classifier_decides_instead_of_pose_and_front_score() -> None:
    frames = [replace(f, name=f"view {k}") for k, f in enumerate(around([1.5, 0.2, 0.0], FRONT))]
    seen = observations(FRIDGE, frames)
    for chosen in range(3):
        scores = {f"view {k}": 0.9 if k == chosen else 0.4 for k in range(3)}
        view = choose_view(FRIDGE, frames, seen, red_is_front, "first", frontal=scores)
        assert view.frame == chosen
    assert choose_view(FRIDGE, frames, seen, red_is_front, "first", frontal={}) is None


def test_no_front_is_found_if_no_image_shows_one() -> None:
    frames = around([0.0], 3)
    seen = observations(FRIDGE, frames)
    methods: tuple[ViewMethod, ...] = ("voting", "first")
    for method in methods:
        assert choose_view(FRIDGE, frames, seen, red_is_front, method) is None
    assert choose_view(FRIDGE, [], [], red_is_front) is None


def test_handles_are_evidence_for_a_front_that_looks_like_a_panel() -> None:
    bare = Part("door_left", (0.0, 0.0, 1.0, 1.0), 0.8)
    held = replace(bare, handle=(0.8, 0.4, 0.9, 0.6))
    assert door_evidence(Front(0.4, (bare,))) == door_evidence(Front(0.4, ())) == 0.4
    assert door_evidence(Front(0.4, (held,))) > 0.5
    assert door_evidence(Front(0.4, (held, held))) > door_evidence(Front(0.4, (held,)))
    assert door_evidence(Front(1.0, ())) == 1.0


def test_parts_next_to_leg_space_make_a_front_and_parts_in_it_do_not() -> None:
    color = np.full((40, 80, 3), 150, np.uint8)
    height_map = np.where(np.arange(80) < 40, 0.0, -0.4) * np.ones((40, 1))
    desk = FaceImage(color, height_map.astype(np.float32), 1.6, 0.8)
    handle = (0.2, 0.2, 0.3, 0.25)
    beside = Part("drawer", (0.05, 0.1, 0.45, 0.9), 0.6, handle)
    within = replace(beside, box=(0.55, 0.1, 0.95, 0.9))
    looks = Front(0.4, ())
    assert front_evidence(looks, desk) == pytest.approx(0.2)
    assert front_evidence(replace(looks, parts=(within,)), desk) == pytest.approx(0.2)
    assert front_evidence(replace(looks, parts=(beside,)), desk) == pytest.approx(0.68)
    shut = replace(desk, height_map=np.zeros((40, 80), np.float32))
    front = replace(looks, parts=(beside, within))
    assert front_evidence(front, shut) == pytest.approx(door_evidence(front))


ROW = UprightBox(np.array([2.0, 0.0, 0.45]), np.array([0.6, 2.4, 0.9]))
DOORS = [(0.02, 0.58, "drawer"), (0.62, 1.0, "door_left"), (1.0, 1.38, "door_right"),
         (1.42, 1.98, "door_down")]  # fmt: skip
CODE = {"drawer": 60, "door_left": 110, "door_right": 160, "door_down": 210}


def row_paint(world: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Paint doors of the row in one gray per kind, and the rest black."""
    left = 1.2 - world[:, 1]  # seen from -x, y goes to the left
    gray = np.zeros(len(world))
    for a, b, kind in DOORS:
        gray[(left > a + 0.005) & (left < b - 0.005) & (normals[:, 0] < -0.9)] = CODE[kind]
    return np.repeat(gray[:, None], 3, axis=1)


def doors_in(face: FaceImage) -> Front:
    line = face.color[face.color.shape[0] // 2, :, 0].astype(float)
    parts = []
    for kind, code in CODE.items():
        flat = np.abs(line - code) < 12
        columns = np.flatnonzero(flat & np.roll(flat, 1) & np.roll(flat, -1))  # no blended edges
        if len(columns) > 20:
            box = (columns[0] / len(line), 0.1, (columns[-1] + 1) / len(line), 0.9)
            parts.append(Part(kind, box, 0.9))  # type: ignore[arg-type]
    return Front(0.9 if parts else 0.1, tuple(parts))


def test_a_row_is_cut_where_no_door_crosses_and_double_doors_stay_together() -> None:
    frames = [
        image(camera((-0.3, y, 0.9), (2.0, y, 0.45)), ROW, row_paint) for y in np.linspace(-1, 1, 7)
    ]
    pieces, front = split_row(ROW, frames, doors_in)
    assert sorted(part.kind for part in front.parts) == sorted(kind for _, _, kind in DOORS)
    widths = [piece.size[1] for piece in pieces]
    assert np.allclose(widths, [0.6, 0.8, 0.58, 0.42], atol=0.02)
    assert sum(widths) == np.float64(2.4)
    assert np.allclose([p.center[1] for p in pieces], [0.9, 0.2, -0.49, -0.99], atol=0.02)
    assert all(np.allclose(p.size[[0, 2]], ROW.size[[0, 2]]) for p in pieces)


def test_a_row_without_fronts_is_not_split() -> None:
    frames = [image(camera((-0.3, 0, 0.9), (2.0, 0, 0.45)), ROW, row_paint)]
    pieces, front = split_row(ROW, frames, lambda _: Front(0.1, ()))
    assert pieces == [ROW]
    assert front is None


def test_a_row_that_fits_one_window_returns_no_front() -> None:
    frames = [image(camera((-0.3, 0, 0.9), (2.0, 0, 0.45)), ROW, row_paint)]
    door = Front(0.9, (Part("door_down", (0.02, 0.1, 0.98, 0.9), 0.9),))
    pieces, front = split_row(ROW, frames, lambda _: door)
    assert pieces == [ROW]
    assert front is None
    pieces, front = split_row(ROW, frames, doors_in)
    assert len(pieces) == 4
    assert front is not None


def test_parts_of_a_row_keep_their_place_on_its_pieces() -> None:
    whole = box_faces(ROW)[2]
    part = Part("door_left", (0.55, 0.1, 0.75, 0.9), 0.9, handle=(0.7, 0.4, 0.72, 0.6))
    right = box_faces(UprightBox(np.array([2.0, -0.6, 0.45]), np.array([0.6, 1.2, 0.9])))[2]
    (there,) = transferred([part], whole, right)
    assert np.allclose(there.box, (0.1, 0.1, 0.5, 0.9))
    assert np.allclose(there.handle, (0.4, 0.4, 0.44, 0.6))
    (again,) = transferred([there], right, whole)
    assert np.allclose(again.box, part.box)


def test_parts_of_another_plane_are_not_on_a_face() -> None:
    whole, part = box_faces(ROW)[2], Part("door_left", (0.0, 0.1, 0.3, 0.9), 0.9)
    right = UprightBox(np.array([2.0, -0.6, 0.45]), np.array([0.6, 1.2, 0.9]))
    assert not transferred([part], whole, box_faces(right)[2])
    behind = UprightBox(np.array([2.5, 0.0, 0.45]), np.array([0.6, 2.4, 0.9]))
    assert not transferred([part], whole, box_faces(behind)[2])
    assert all(not transferred([part], whole, box_faces(ROW)[index]) for index in (0, 1, 3))


def test_the_more_confident_of_overlapping_parts_remains() -> None:
    wide = Part("drawer", (0.0, 0.0, 1.0, 1.0), 0.5)
    wings = [Part("door_left", (0.0, 0.0, 0.5, 1.0), 0.9), Part("door_right", (0.5, 0, 1, 1), 0.8)]
    assert most_confident([wide, *wings]) == tuple(wings)
    assert most_confident([replace(wide, score=0.95), *wings]) == (replace(wide, score=0.95),)
    assert most_confident(wings) == tuple(wings)


def test_a_part_without_a_handle_gives_way_to_several_inner_parts_with_handles() -> None:
    plain = Part("door_down", (0.0, 0.1, 1.0, 1.0), 0.9)
    low = Part("drawer", (0.0, 0.5, 1.0, 1.0), 0.3, handle=(0.4, 0.5, 0.6, 0.52))
    high = Part("drawer", (0.0, 0.0, 1.0, 0.5), 0.3, handle=(0.4, 0.1, 0.6, 0.12))
    assert most_confident([plain, low, high]) == (low, high)
    assert most_confident([plain, low, replace(low, score=0.2)]) == (plain,), "the same one twice"
    held = replace(plain, handle=(0.1, 0.15, 0.9, 0.18))
    assert most_confident([held, low, high]) == (held,)
    theirs = replace(plain, handle=(0.35, 0.5, 0.55, 0.53))
    assert most_confident([theirs, low, high]) == (low, high)


def test_a_part_does_not_give_way_to_pieces_of_itself_with_one_handle() -> None:
    bar = (0.9, 0.35, 0.95, 0.9)
    door = Part("door_left", (0.0, 0.0, 1.0, 1.0), 0.8, handle=bar)
    top = Part("door_left", (0.0, 0.0, 1.0, 0.55), 0.7, handle=(0.9, 0.35, 0.95, 0.55))
    low = Part("door_left", (0.0, 0.45, 1.0, 1.0), 0.7, handle=(0.9, 0.45, 0.95, 0.9))
    assert most_confident([door, top, low]) == (door,)


def test_a_door_known_from_the_row_makes_its_piece_a_front() -> None:
    frames = around([0.0, 0.2], FRONT)
    seen, face = observations(FRIDGE, frames), box_faces(FRIDGE)[FRONT]
    door = Part("door_left", (0.0, 0.0, 1.0, 1.0), 0.9)

    def blind(_: FaceImage) -> Front:
        return Front(0.2, ())

    assert choose_view(FRIDGE, frames, seen, blind) is None
    before = [KnownFront(face, 0.8, (door,))]
    view = choose_view(FRIDGE, frames, seen, blind, "voting", before)
    assert view.face.index == FRONT
    assert view.front.parts == (door,)
    assert choose_view(FRIDGE, frames, seen, blind, "first", before) is None, "one image decides"


def test_the_first_frontal_image_decides_alone() -> None:
    """Later images and parts known from a row change nothing (MoMa-Pos, III-B)."""
    frames = around([0.0, 0.2, 0.4], FRONT)
    seen, face = observations(FRIDGE, frames), box_faces(FRIDGE)[FRONT]
    looks = 0

    def half(image: FaceImage) -> Front:
        nonlocal looks
        looks += 1
        front = red_is_front(image)
        return replace(front, parts=tuple(replace(p, box=(0, 0, 0.5, 1)) for p in front.parts))

    other = KnownFront(face, 0.9, (Part("drawer", (0.5, 0.0, 1.0, 1.0), 0.9),))
    views = [
        choose_view(FRIDGE, frames, sights, half, "first", known)
        for sights, known in ((seen[:1], ()), (seen, ()), (seen, (other,)))
    ]
    assert looks == len(views)
    for view in views:
        assert view.frame == seen[0].frame
        assert [part.kind for part in view.front.parts] == ["door_left"]
        assert view.evidence == ()
