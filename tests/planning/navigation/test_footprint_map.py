"""The map of the real footprint: its kernels against plain outlines."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from tests.planning.navigation.boxes import room, square

from momapos.core.errors import SceneError
from momapos.core.geometry.polygons import edge_normals
from momapos.core.geometry.transforms import apply, invert
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.planning.navigation.convex_polygons import obstacles_of, planning_outlines, prisms_of
from momapos.planning.navigation.cost_map import CELL
from momapos.planning.navigation.footprint_map import (
    HEADINGS,
    build_navigation_map,
    navigation_map_of,
    with_object_moved,
)
from momapos.planning.navigation.judge import FootprintCollisionChecker
from momapos.planning.navigation.outline_gaps import gaps

CLUTTER = [
    (0.5, 0.3, 0.6, 0.4, 0.3),
    (0.5, 0.3, 0.2, 0.2, 0.3),
    (-1.2, 0.9, 0.8, 0.3, -0.7),
    (0.1, -1.4, 0.05, 1.0, 1.0),
    (1.9, -1.7, 0.5, 0.5, 0.0),
]


def test_a_gap_is_positive_without_overlap_and_at_most_the_distance(robot: Robot) -> None:
    nav_map = build_navigation_map(room(CLUTTER), robot)
    judge = FootprintCollisionChecker(nav_map.prisms, nav_map.obstacles, None)
    rng = np.random.default_rng(0)
    poses = np.column_stack([rng.uniform(-2.5, 2.5, (400, 2)), rng.uniform(-3.14, 3.14, 400)])
    found = gaps(poses, nav_map.prisms, nav_map.obstacles, cap=0.5)
    distance, touched = judge.distance(poses)
    free = np.array([not name for name in touched])
    assert 50 < free.sum() < 350
    assert ((found > 0) == free).all()
    assert (found[free] <= distance[free] + 1e-9).all()


def test_a_cell_is_free_where_the_footprint_is_clear_and_on_the_floor(husky: Robot) -> None:
    nav_map = build_navigation_map(room(CLUTTER), husky)
    judge = FootprintCollisionChecker(nav_map.prisms, nav_map.obstacles, nav_map.floor_polygon)
    rng = np.random.default_rng(1)
    h, i, j = (rng.integers(n, size=500) for n in nav_map.gap.shape)
    centers = nav_map.origin + (np.stack([j, i], -1) + 0.5) * CELL
    _, touched = judge.distance(np.column_stack([centers, HEADINGS[h]]))
    free = np.array([not name for name in touched])
    assert 50 < free.sum() < 450
    assert (nav_map.free[h, i, j] == free).all()


def test_dropping_outlines_inside_other_ones_changes_no_gap(fetch: Robot) -> None:
    body = prisms_of(fetch)
    everything = obstacles_of(room(CLUTTER), body)
    fewer = planning_outlines(everything, None)
    assert len(fewer) < len(everything)
    rng = np.random.default_rng(2)
    poses = np.column_stack([rng.uniform(-2, 2, (200, 2)), rng.uniform(-3.14, 3.14, 200)])
    full = gaps(poses, body, everything)
    outside = full > 0
    np.testing.assert_allclose(gaps(poses, body, fewer)[outside], full[outside], atol=1e-12)


def test_only_objects_between_the_floor_and_the_top_of_the_robot_are_obstacles(
    robot: Robot,
) -> None:
    body = prisms_of(robot)
    box = [(0.0, 0.0, 1.0, 1.0, 0.0)]
    assert len(obstacles_of(room(box), body)) > 0
    above = room(box, low=body.heights[-1] + 0.01, high=body.heights[-1] + 1.0)
    mat = room(box, low=0.0, high=0.003)
    assert len(obstacles_of(above, body)) == len(obstacles_of(mat, body)) == 0


def test_a_low_base_passes_under_a_shelf_that_its_arm_clears(husky: Robot) -> None:
    body = prisms_of(husky)
    fronts = [float(outline[:, 0].max()) for outline in body.outlines]
    thin = int(np.argmin(fronts))
    assert fronts[thin] < fronts[0] - 0.05
    slab, (low, high) = [(0.0, 0.0, 2.0, 0.1, 0.0)], body.heights[thin : thin + 2]
    shelf = room(slab, low=low + 0.01, high=high - 0.01)
    pose = np.array([[0.0, -0.05 - fronts[thin] - 0.01, np.pi / 2]])
    assert gaps(pose, body, obstacles_of(shelf, body))[0] > 0
    step = room(slab, high=body.heights[1])
    assert gaps(pose, body, obstacles_of(step, body))[0] < 0


def test_the_prisms_of_a_robot_contain_all_of_it(robots: Callable[[str], Robot]) -> None:
    for name in ("fetch", "husky_ur5e", "ranger_rm63", "segway_ur5e"):
        robot = robots(name)
        body = prisms_of(robot)
        poses = robot.model.link_poses(dict(zip(robot.arm_joints, robot.home, strict=True)))
        T_base_root = invert(poses[robot.base_link])
        assert (np.diff(body.heights) > 0).all()
        for link, hulls in robot.model.hulls.items():
            for hull in hulls:
                points = apply(T_base_root @ poses[link], hull.vertices)
                for k, outline in enumerate(body.outlines):
                    low, high = body.heights[k : k + 2]
                    within = (points[:, 2] > low) & (points[:, 2] < high)
                    corner, normal = outline, edge_normals(outline)
                    level = np.einsum("ki,ki->k", corner, normal)
                    assert (points[within, :2] @ normal.T <= level + 1e-9).all()


def test_an_obstacle_of_several_nested_prisms_is_checked_against_the_widest(robot: Robot) -> None:
    body = prisms_of(robot)
    pillar = room([(0.0, 0.0, 0.1, 0.1, 0.0)], low=0.0, high=body.heights[-1])
    layers = set(obstacles_of(pillar, body).layer.tolist())
    for k in range(len(body.outlines)):
        held = any(body.inside[k, j] for j in layers)
        assert held or k in layers
    assert all(not body.inside[a, b] for a in layers for b in layers if a != b)


def test_a_scene_too_large_for_a_map_is_refused(fetch: Robot) -> None:
    body = prisms_of(fetch)
    with pytest.raises(SceneError, match="covers at most"):
        navigation_map_of(fetch, body, obstacles_of(room([]), body), square(1000.0))


@pytest.mark.parametrize("back", [False, True])
def test_an_updated_map_equals_the_map_of_the_scene_after_the_motion(
    back: bool, kitchen: Scene, segway: Robot
) -> None:
    """A drawer is pulled out, or pushed in; the objects in it stay in place."""
    scene = kitchen
    name, joint = "cabinet_right", "drawer_middle_slide"
    after = scene.with_joint(name, joint, 0.4)
    if back:
        scene, after = after, scene
    outlines = obstacles_of(replace(after, objects=(after.object(name),)), prisms_of(segway))
    before = build_navigation_map(scene, segway)
    moved, rebuilt = with_object_moved(before, name, outlines), build_navigation_map(after, segway)
    rng = np.random.default_rng(2)
    low, high = rebuilt.obstacles.bounds[:, :2].min(0), rebuilt.obstacles.bounds[:, 2:].max(0)
    xy = rng.uniform(low - 0.5, high + 0.5, (4000, 2))
    poses = np.column_stack([xy, rng.uniform(-3.14, 3.14, 4000)])
    free = gaps(poses, rebuilt.prisms, rebuilt.planning_obstacles) > 0
    assert (free == (gaps(poses, moved.prisms, moved.planning_obstacles) > 0)).all()
    every = [gaps(poses, one.prisms, one.obstacles) > 0 for one in (rebuilt, moved)]
    assert (every[0] == every[1]).all()
    assert (free != (gaps(poses, before.prisms, before.planning_obstacles) > 0)).any()
    assert sorted(moved.obstacles.names) == sorted(rebuilt.obstacles.names)
    assert moved.shape == before.shape
