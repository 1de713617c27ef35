"""Aligned parts fit the face and each other."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from tests.perception.reconstruction.fronts import any_parts, face_of, fronts, overlap, raised

from momapos.core.errors import InputError
from momapos.model.records.scans import Part
from momapos.perception.reconstruction.alignment import align
from momapos.perception.reconstruction.height_maps import Area

FACE = (0.6, 1.8)  # [m]


def inside(area: Area, width: float, height: float) -> bool:
    """Check whether an area lies on a face [m]."""
    low, high = min(area.left, area.bottom), max(area.right - width, area.top - height)
    return low >= -1e-9 and high <= 1e-9


@given(parts=any_parts(), grid=st.sampled_from([None, 12]))
@settings(max_examples=150)
def test_aligned_parts_lie_on_the_face_without_overlap(parts: list[Part], grid: int | None) -> None:
    aligned = align(face_of(*FACE), parts, grid)
    assert len(aligned) <= len(parts)
    assert all(inside(part.area, *FACE) for part in aligned)
    for part in aligned:
        assert part.area.width >= 0.08
        assert part.area.height >= (0.05 if part.kind == "drawer" else 0.08)
    for a, b in combinations(aligned, 2):
        assert overlap(a.area, b.area) < 1e-12


@given(parts=any_parts())
@example(parts=[Part("door_left", (0.0, 0.0, 1.0, 1.0), 0.5, handle=(0.34, 0.0, 0.35, 0.002))])
@settings(max_examples=150)
def test_every_handle_lies_on_its_part_and_can_be_grasped(parts: list[Part]) -> None:
    for part in align(face_of(*FACE), parts):
        if part.handle is not None:
            held, area = part.handle.area, part.area
            assert min(held.left - area.left, area.right - held.right) > -1e-9
            assert min(held.bottom - area.bottom, area.top - held.top) > -1e-9
            assert 0.008 - 1e-9 <= min(held.width, held.height) <= 0.035 + 1e-9
            assert part.handle.out == 0.04


@given(front=fronts())
@settings(max_examples=80)
def test_parts_that_fit_move_by_less_than_a_seam(
    front: tuple[tuple[float, float, float], list[Part]],
) -> None:
    (width, _, height), parts = front
    aligned = align(face_of(width, height), parts)
    assert len(aligned) == len(parts)
    scale = np.array([width, height, width, height])
    seen = np.array([part.box for part in parts]) * scale
    areas = [part.area for part in aligned]
    got = np.array([[a.left, height - a.top, a.right, height - a.bottom] for a in areas])
    off = np.abs(got[:, None] - seen[None]).max(-1)
    assert off.min(1).max() <= 0.015 + 1e-9


def test_neighbors_that_nearly_meet_share_a_seam_and_the_rim_is_one() -> None:
    parts = [
        Part("door_left", (0.01, 0.005, 0.49, 0.995), 0.9),
        Part("door_right", (0.505, 0.0, 1.0, 0.495), 0.9),
        Part("drawer", (0.51, 0.5, 0.99, 1.0), 0.9),
    ]
    left, upper, lower = align(face_of(*FACE), parts)
    assert left.area.right == upper.area.left == lower.area.left
    assert upper.area.bottom == lower.area.top
    assert (left.area.left, left.area.bottom, upper.area.right, upper.area.top) == (0, 0, *FACE)


def test_overlapping_neighbors_are_cut_at_the_middle_of_their_overlap() -> None:
    parts = [Part("drawer", (0.0, 0.0, 1.0, 0.4), 0.6), Part("drawer", (0.0, 0.3, 1.0, 1.0), 0.9)]
    upper, lower = align(face_of(*FACE), parts)
    assert upper.area.bottom == pytest.approx(0.65 * FACE[1])
    assert lower.area.top == upper.area.bottom


def test_the_more_certain_of_duplicate_parts_remains() -> None:
    parts = [
        Part("door_left", (0.0, 0.0, 0.9, 1.0), 0.5),
        Part("door_right", (0.1, 0.0, 1.0, 1.0), 0.8),
    ]
    (kept,) = align(face_of(*FACE), parts)
    assert kept.kind == "door_right"


@given(front=fronts())
@settings(max_examples=80)
def test_on_the_grid_edges_are_whole_steps_and_at_most_half_a_step_off(
    front: tuple[tuple[float, float, float], list[Part]],
) -> None:
    (width, _, height), parts = front
    for seen in parts:  # alone, for on a coarse grid neighbors can land on each other
        for part in align(face_of(width, height), [seen], 12):
            a = part.area
            got = np.array([a.left / width, 1 - a.top / height, a.right / width])
            steps = got * 12
            np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
            assert np.abs(got - seen.box[:3]).max() <= 0.5 / 12 + 1e-9 or a.width <= width / 11.9


@pytest.mark.parametrize("front", [-0.03, 0.0, 0.025])
def test_the_height_map_gives_the_protrusion_of_a_part_and_its_handle(front: float) -> None:
    handle = (0.85, 0.4, 0.89, 0.6)
    face = face_of(*FACE, 0.0)
    raised(face, (0.0, 0.1, 1.0, 1.0), front)
    raised(face, handle, front + 0.055)
    noise = np.random.default_rng(0).normal(0, 0.003, face.height_map.shape)
    face.height_map[...] += noise
    face.height_map[np.random.default_rng(1).random(face.height_map.shape) < 0.4] = np.nan
    (part,) = align(face, [Part("door_left", (0.0, 0.1, 1.0, 1.0), 0.9, handle)])
    assert part.out == pytest.approx(front, abs=1e-3)
    assert part.handle.out == pytest.approx(0.055, abs=4e-3)


@pytest.mark.parametrize(
    ("sign", "bar", "moves"),
    [(0.0, 0.1, True), (0.0, 0.02, False), (0.05, 0.1, False)],
    ids=["a flat sign beside a bar", "nothing stands out", "a handle beside a rail"],
)
def test_a_flat_sign_is_replaced_by_a_protruding_bar(sign: float, bar: float, moves: bool) -> None:
    seen, true = (0.6, 0.1, 0.9, 0.15), (0.1, 0.3, 0.15, 0.8)
    face = face_of(*FACE, 0.0)
    raised(face, seen, sign)
    raised(face, true, bar)
    (part,) = align(face, [Part("door_right", (0.0, 0.0, 1.0, 1.0), 0.9, seen)])
    middle = (part.handle.area.left + part.handle.area.right) / 2
    assert middle == pytest.approx((0.125 if moves else 0.75) * face.width, abs=0.02)


@pytest.mark.parametrize(("height_map", "out"), [(0.008, 0.04), (0.03, 0.03), (0.2, 0.12)])
def test_the_measured_protrusion_of_a_handle_is_used_within_limits(
    height_map: float, out: float
) -> None:
    handle = (0.8, 0.4, 0.85, 0.6)
    face = face_of(*FACE, 0.0)
    raised(face, handle, height_map)
    (part,) = align(face, [Part("door_left", (0.0, 0.0, 1.0, 1.0), 0.9, handle)])
    assert part.handle.out == pytest.approx(out, abs=1e-6)


def test_a_handle_outside_of_its_part_is_dropped() -> None:
    part = Part("drawer", (0.0, 0.0, 1.0, 0.3), 0.9, (0.4, 0.6, 0.6, 0.62))
    (aligned,) = align(face_of(*FACE), [part])
    assert aligned.handle is None


def test_a_rectangle_that_is_not_finite_is_refused_by_its_number() -> None:
    parts = [Part("drawer", (0.0, 0.0, float("nan"), 0.3), 0.9)]
    with pytest.raises(InputError, match="part 0 of the front"):
        align(face_of(*FACE), parts)
