"""Test the restrictions of base poses."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from momapos.core.geometry.polygons import any_overlap
from momapos.core.geometry.transforms import place_points
from momapos.model.records.outcomes import PoseStatus
from momapos.model.records.plans import ANYWHERE, BaseRegion
from momapos.planning.placement.area import PlacementGeometry
from momapos.planning.placement.problem import rules

SQUARE = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0))
NORTH = ((0.0, 1.0), (1.0, 1.0), (1.0, 2.0), (0.0, 2.0))


def satisfied(
    region: BaseRegion, geometry: PlacementGeometry, poses: Float[np.ndarray, "n 3"]
) -> dict[PoseStatus, list[bool]]:
    travel = np.hypot(poses[:, 0], poses[:, 1])
    every = rules(region, geometry)
    return {rule.otherwise.status: rule.keeps(poses, travel).tolist() for rule in every}


def test_without_a_region_the_base_may_stand_anywhere(geometry: PlacementGeometry) -> None:
    assert rules(ANYWHERE, geometry) == []


def test_the_whole_footprint_lies_in_one_keep_in_area(geometry: PlacementGeometry) -> None:
    middle, edge, other = [0.5, 0.5, 0.3], [0.95, 0.5, 0.0], [0.5, 1.5, 1.0]
    poses = np.array([middle, edge, other])
    one = satisfied(BaseRegion(keep_in=(SQUARE,)), geometry, poses)
    assert one == {PoseStatus.NOT_KEPT_IN: [True, False, False]}
    two = satisfied(BaseRegion(keep_in=(SQUARE, NORTH)), geometry, poses)
    assert two == {PoseStatus.NOT_KEPT_IN: [True, False, True]}


def test_no_part_of_the_footprint_touches_a_keep_out_area(geometry: PlacementGeometry) -> None:
    poses = np.array([[0.5, 0.5, 0.3], [1.05, 0.5, 0.0], [3.0, 0.5, 0.0]])
    out = satisfied(BaseRegion(keep_out=(SQUARE,)), geometry, poses)
    assert out == {PoseStatus.NOT_KEPT_OUT: [False, False, True]}


def test_the_base_faces_the_grasp(geometry: PlacementGeometry) -> None:
    x, y = geometry.Ts_world_tool[0, 1, :2, 3]
    poses = np.array([[x, y - 1.0, np.pi / 2], [x, y - 1.0, 0.0], [x - 1.0, y, -2 * np.pi + 0.1]])
    facing = satisfied(BaseRegion(facing=np.radians(30.0)), geometry, poses)
    assert facing == {PoseStatus.NOT_FACING: [True, False, True]}


def test_the_drive_is_not_longer_than_allowed(geometry: PlacementGeometry) -> None:
    poses = np.array([[1.0, 0.0, 0.0], [0.0, 3.0, 0.0]])
    near = satisfied(BaseRegion(most_driving=2.0), geometry, poses)
    assert near == {PoseStatus.TOO_LONG_A_DRIVE: [True, False]}


def test_outlines_overlap_if_one_contains_the_other_or_edges_cross() -> None:
    small = place_points(np.array([[0.5, 0.5, 0.2]]), 0.1 * np.array(SQUARE))
    large = place_points(np.array([[-2.0, -2.0, 0.0]]), 9.0 * np.array(SQUARE))
    across = np.array([[[-1.0, 0.4], [2.0, 0.4], [2.0, 0.6], [-1.0, 0.6]]])
    apart = place_points(np.array([[2.0, 0.0, 0.5]]), 0.5 * np.array(SQUARE))
    square = np.array(SQUARE)
    for outline, overlaps in ((small, True), (large, True), (across, True), (apart, False)):
        assert any_overlap(square, outline).tolist() == [overlaps]
