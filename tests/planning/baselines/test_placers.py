"""Test the proposals of the base placers."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from jaxtyping import Float
from tests.rooms import Everywhere, cabinet_room, move_scene

from momapos.core.geometry import apply, pose
from momapos.core.geometry.transforms import compose, local_points, place_points
from momapos.model.collision.arm_collision import FREE
from momapos.model.collision.base_collision import base_hits
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_object import SceneObject
from momapos.model.urdf.articulated import Articulated
from momapos.model.urdf.reader import box_urdf
from momapos.planning.baselines.by_method import PLACERS
from momapos.planning.baselines.habitat_placer import HINGED, habitat
from momapos.planning.baselines.m3_placer import HINGED as REGIONS
from momapos.planning.baselines.m3_placer import NOISE, m3
from momapos.planning.baselines.map_placers import reuleaux, rm4d
from momapos.planning.baselines.paper_placer import (
    BEST,
    RING,
    YAW,
    AuthorsPlacer,
    PaperPlacer,
    in_area,
    potential,
    printed_radius,
    samples_in_area,
)
from momapos.planning.baselines.placer_room import GRASP_WAYPOINT, BasePlacer, PlacerRoom
from momapos.planning.baselines.samplers import MAX_DISTANCE, behavior, momagen, pycram
from momapos.planning.config import BaselineConfig, PaperConfig, PipelineConfig
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.placement.area import base_pose_status
from momapos.planning.task_setup import cost_map, prepare

START = np.array([0.0, -2.5, np.pi / 2])


class OneSide:
    """A reach scorer that reaches only from the left half of the room."""

    def min_score(
        self, bases: Float[np.ndarray, "n 3"], Ts_world_tool: Float[np.ndarray, "g w 4 4"]
    ) -> Float[np.ndarray, "n g"]:
        """Return 1 on the left, else 0."""
        return np.repeat((bases[:, :1] < 0.0).astype(np.float32), len(Ts_world_tool), 1)


def placer_room(scene: Scene, robot: Robot, start: np.ndarray = START) -> PlacerRoom:
    task = make_task(scene, "open", "cabinet", to=1.2)
    prepared = prepare(scene, robot, task, PipelineConfig(), clearance=0.01)
    return PlacerRoom(prepared, Everywhere(), cost_map(prepared, start).lengths, start, 24)


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory, segway: Robot) -> PlacerRoom:
    return placer_room(cabinet_room(tmp_path_factory.mktemp("room")), segway)


def proposed(placer: BasePlacer, room: PlacerRoom, *, seed: int = 0) -> Float[np.ndarray, "n 3"]:
    return np.concatenate(list(placer(room, np.random.default_rng(seed))))


PAPER = PaperPlacer(PaperConfig(samples=40, batches=2))


@pytest.mark.parametrize("name", [*PLACERS, "paper"])
def test_proposals_stand_clear_and_repeat_with_the_seed(room: PlacerRoom, name: str) -> None:
    placer = PLACERS.get(name, PAPER)
    poses = proposed(placer, room)
    assert len(poses)
    if name == "paper":  # it checks the base only; the others also check the arm at home
        assert len(in_area(room, room.whole_boxes, poses)) == len(poses)
    else:
        assert room.stands_clear(poses).all()
    np.testing.assert_array_equal(poses, proposed(placer, room))


@pytest.mark.parametrize("placer", [habitat, m3, rm4d, behavior, momagen])
def test_proposals_move_with_the_scene(placer: BasePlacer, tmp_path: Path, segway: Robot) -> None:
    shift = np.array([0.5, -0.25, np.pi / 2])
    scene = cabinet_room(tmp_path)
    moved = placer_room(move_scene(scene, *shift), segway, compose(shift, START[None])[0])
    here, there = proposed(placer, placer_room(scene, segway)), proposed(placer, moved)
    front, back = placer_room(scene, segway).handle_frame, moved.handle_frame
    np.testing.assert_allclose(compose(shift, front[None])[0], back, atol=1e-9)
    low, high = local_points(front, here[:, :2]), local_points(back, there[:, :2])
    np.testing.assert_allclose(low.mean(0), high.mean(0), atol=0.15)


def test_habitat_starts_in_the_middle_of_its_area_and_faces_the_object(room: PlacerRoom) -> None:
    poses = proposed(habitat, room)
    local = local_points(room.object_frame, poses[:, :2])
    np.testing.assert_allclose(local[0], HINGED.mean(0), atol=0.05)
    assert (local > HINGED[0] - 0.1).all()
    assert (local < HINGED[1] + 0.1).all()
    away = room.object_frame[:2] - poses[:, :2]
    np.testing.assert_allclose(np.arctan2(away[:, 1], away[:, 0]), poses[:, 2], atol=1e-9)


def test_m3_proposes_the_nearest_navigable_cells_of_a_rigid_target_in_order(
    tmp_path: Path, segway: Robot
) -> None:
    can = SceneObject.box("can", (0.06, 0.06, 0.12), (0.9, -1.0, 0.80))
    stand = SceneObject.box("stand", (0.5, 0.5, 0.74), (0.9, -1.0, 0.37))
    scene = cabinet_room(tmp_path)
    scene = replace(scene, objects=(*scene.objects, can, stand))
    task = make_task(scene, "pick", "can")
    prepared = prepare(scene, segway, task, PipelineConfig(), clearance=0.01)
    travel = cost_map(prepared, START).lengths
    room = PlacerRoom(prepared, Everywhere(), travel, START, 24)
    poses = proposed(m3, room)
    away = np.linalg.norm(poses[:, :2] - room.target[:2], axis=1)
    assert (np.diff(away) >= -1e-6).all()
    cells = room.cells(room.target[:2], 2.5, 0.05)
    free = room.facing(cells[room.navigable(cells)], room.target[:2])
    free = free[room.stands_clear(free)]
    nearest = np.linalg.norm(free[:, :2] - room.target[:2], axis=1).min()
    assert away[0] == pytest.approx(nearest)
    equal = np.abs(away - away[0]) < 1e-6
    drives = travel(poses[equal, :2])
    assert drives[0] == drives.min()


def test_a_placer_that_knows_boxes_keeps_the_base_out_of_them(room: PlacerRoom) -> None:
    blind = replace(room, knows=BaselineConfig(boxes=True))
    cells = room.facing(room.cells(room.target[:2], 1.0, 0.05), room.target[:2])
    clear, boxed = room.stands_clear(cells), blind.stands_clear(cells)
    assert (clear & ~boxed).any()
    assert not (boxed & ~clear).any()
    hits = base_hits(cells[boxed], room.robot.base, room.whole_boxes, clearance=0.01)
    assert (hits == FREE).all()


def test_a_placer_that_knows_one_grasp_counts_only_that(room: PlacerRoom) -> None:
    one = replace(room, knows=BaselineConfig(one_grasp=True))
    assert len(one.Ts_world_tool) == 1 < len(room.Ts_world_tool)
    np.testing.assert_array_equal(one.Ts_world_tool[0], room.Ts_world_tool[0])
    np.testing.assert_array_equal(one.target, room.target)
    poses = proposed(reuleaux, one)
    assert len(poses)
    assert (one.scores(poses, [GRASP_WAYPOINT])[:, 0, 0] > 0).all()


def test_m3_stays_in_its_region_up_to_noise(room: PlacerRoom) -> None:
    local = local_points(room.object_frame, proposed(m3, room)[:, :2])
    margin = 2 * NOISE[0] * np.sqrt(2) + 1e-9
    assert (local > REGIONS[0][0] - margin).all()
    assert (local < REGIONS[0][1] + margin).all()


@pytest.mark.parametrize("placer", [reuleaux, rm4d])
def test_maps_propose_only_poses_that_reach_the_handle(
    room: PlacerRoom, placer: BasePlacer
) -> None:
    half = PlacerRoom(room.prepared, OneSide(), room.travel_cost, room.start, room.grasps)
    assert (proposed(placer, half)[:, 0] < 0.0).all()
    assert (proposed(placer, room)[:, 0] > 0.0).any()


def test_rm4d_proposes_the_cells_that_reach_most_grasps_first(room: PlacerRoom) -> None:
    class Share:
        def min_score(self, bases: np.ndarray, Ts_world_tool: np.ndarray) -> np.ndarray:
            """Reach more grasps farther left."""
            order = np.linspace(-1.0, 1.0, len(Ts_world_tool))
            return (order[None] > bases[:, :1]).astype(np.float32)

    poses = proposed(rm4d, PlacerRoom(room.prepared, Share(), room.travel_cost, room.start, 24))
    grasps = len(room.Ts_world_tool)
    count = (np.linspace(-1.0, 1.0, grasps)[None] > poses[:, :1]).sum(1)
    assert (np.diff(count) <= 0).all()


def test_samplers_propose_poses_with_an_exact_grasp(room: PlacerRoom) -> None:
    for placer in (behavior, momagen, pycram):
        poses = proposed(placer, room)[:5]
        assert room.holds_at(poses, [GRASP_WAYPOINT]).all()
    away = np.linalg.norm(proposed(behavior, room)[:, :2] - room.target[:2], axis=1)
    assert away.max() <= MAX_DISTANCE


def test_no_grasp_exists_from_across_the_room(room: PlacerRoom) -> None:
    far = room.facing(np.array([[0.0, -4.0]]), room.target[:2])
    assert not room.holds_at(far, [GRASP_WAYPOINT]).any()


def test_other_placers_propose_poses_that_block_the_door(room: PlacerRoom) -> None:
    """Our method never proposes a base in the path of the part."""
    geometry = room.prepared.geometry
    blocked = [
        (base_pose_status(geometry, proposed(placer, room))[0] == 1).any()
        for placer in (habitat, m3, rm4d, behavior)
    ]
    assert any(blocked)


def test_the_paper_s_area_excludes_whole_boxes(room: PlacerRoom) -> None:
    boxes = room.whole_boxes
    cells = room.facing(room.cells(room.target[:2], 1.0, 0.1), room.target[:2])
    inside = in_area(room, boxes, cells)
    assert 0 < len(inside) < len(cells)
    assert (base_hits(inside, room.robot.base, boxes, clearance=0.0) == FREE).all()


@pytest.mark.parametrize("count", [1, 40, 200])
def test_m_samples_are_in_the_paper_s_area_within_the_length_of_the_arm(
    room: PlacerRoom, count: int
) -> None:
    poses = samples_in_area(room, count, np.random.default_rng(0))
    assert len(poses) == count == len(in_area(room, room.whole_boxes, poses))
    geometry = room.prepared.geometry
    axes = place_points(poses, geometry.shoulder[None, :2])[:, 0]
    radius = printed_radius(geometry)
    assert np.linalg.norm(axes - room.target[:2], axis=1).max() <= radius + 1e-9
    dz = room.target[2] - geometry.shoulder[2]
    assert radius == pytest.approx(np.sqrt(room.robot.reach**2 - dz**2))
    few = replace(geometry, Ts_world_tool=geometry.Ts_world_tool[:1])
    assert printed_radius(few) == radius


def test_the_paper_proposes_nothing_for_a_target_above_the_length_of_the_arm(
    room: PlacerRoom,
) -> None:
    high = room.prepared.geometry.Ts_world_tool.copy()
    high[..., 2, 3] += 5.0
    above = replace(room.prepared.geometry, Ts_world_tool=high)
    assert printed_radius(above) is None
    unreachable = replace(room, prepared=replace(room.prepared, geometry=above))
    assert len(samples_in_area(unreachable, 10, np.random.default_rng(0))) == 0


def test_the_paper_keeps_samples_that_the_map_does_not_reach_unless_they_are_culled_early(
    room: PlacerRoom,
) -> None:
    half = replace(room, reach=OneSide())
    config = PaperConfig(samples=40, batches=1)
    assert (proposed(PaperPlacer(config), half)[:, 0] > 0.0).any()
    culled = proposed(PaperPlacer(replace(config, early_cull=True)), half)
    assert (culled[:, 0] < 0.0).all()


def test_the_potential_is_summed_over_waypoints_and_heights(room: PlacerRoom) -> None:
    boxes = room.whole_boxes
    poses = in_area(
        room, boxes, room.facing(room.cells(room.target[:2], 1.0, 0.2), room.target[:2])
    )
    waypoints = room.Ts_world_tool.shape[1]
    scores = np.random.default_rng(0).uniform(size=(len(poses), waypoints))
    low, high = np.array([0.4]), np.array([1.4])
    both = potential(room, boxes, poses, scores, np.append(low, high))
    each = [potential(room, boxes, poses, scores, z) for z in (low, high)]
    np.testing.assert_allclose(both, each[0] + each[1])
    blind = potential(room, boxes, poses, 0 * scores, low)
    np.testing.assert_allclose(each[0], blind + scores[:, GRASP_WAYPOINT:].sum(1))


def test_without_the_field_or_the_map_the_other_alone_decides(room: PlacerRoom) -> None:
    def proposed(**changes: bool) -> np.ndarray:
        config = PaperConfig(samples=64, batches=1, group=1, **changes)
        return np.vstack(list(PaperPlacer(config)(room, np.random.default_rng(0))))

    boxes, heights = room.whole_boxes, np.array(PaperConfig().heights)
    by_map, by_field = proposed(field=False), proposed(inverse_map=False)
    scores = room.scores(by_map, range(room.Ts_world_tool.shape[1])).max(1)
    assert (np.diff(scores[:, GRASP_WAYPOINT:].sum(1)) <= 1e-5).all()
    nothing = np.zeros((len(by_field), room.Ts_world_tool.shape[1]))
    assert (np.diff(potential(room, boxes, by_field, nothing, heights)) <= 1e-9).all()
    assert len(by_field) == len(by_map) == len(proposed()) == 64


def test_the_field_is_one_over_the_distance_where_the_handle_is_visible(room: PlacerRoom) -> None:
    boxes = room.whole_boxes
    targets = room.Ts_world_tool[0, GRASP_WAYPOINT:, :3, 3]
    in_front_and_behind = room.target[:2] + np.array([[0.0, -0.8], [0.0, 1.5]])
    poses = room.facing(in_front_and_behind, room.target[:2])
    axes = place_points(poses, room.prepared.geometry.shoulder[None, :2])[:, 0]
    nothing = np.zeros((2, room.Ts_world_tool.shape[1]))
    seen, hidden = potential(room, boxes, poses, nothing, room.target[2:])
    away = np.linalg.norm(targets[:, :2] - axes[:1], axis=1)
    assert seen == pytest.approx((1 / away).sum())
    assert hidden < (1 / np.linalg.norm(targets[:, :2] - axes[1:], axis=1)).sum()


def test_the_paper_tries_groups_of_high_potential_first(room: PlacerRoom) -> None:
    config = PaperConfig(samples=64, batches=1, group=4)
    groups = list(PaperPlacer(config)(room, np.random.default_rng(0)))
    assert all(len(group) == 4 for group in groups[:-1])
    boxes = room.whole_boxes
    ones = np.ones((4, room.Ts_world_tool.shape[1]))
    values = [
        potential(room, boxes, group, ones[: len(group)], np.array(config.heights))
        for group in groups
    ]
    for better, worse in pairwise(values):
        assert better.min() >= worse.max() - 1e-9


def test_the_authors_visit_the_best_five_of_a_ring_at_one_yaw(room: PlacerRoom) -> None:
    placer, cabinet = AuthorsPlacer(PaperConfig(), ""), room.prepared.scene.object("cabinet")
    down = pose((0.0, 0.0, -cabinet.bounds[0, 2]))  # what hangs is no obstacle to the authors
    cabinet = replace(cabinet, T_world_object=down @ cabinet.T_world_object)
    scene = replace(room.prepared.scene, objects=(cabinet,))
    room = replace(room, prepared=replace(room.prepared, scene=scene))
    poses = proposed(placer, room)
    away = np.linalg.norm(poses[:, :2] - room.target[:2], axis=1)
    assert 1 <= len(poses) <= BEST
    assert (poses[:, 2] == YAW).all()
    assert ((away >= RING[0]) & (away <= RING[1])).all()
    half = 0.5 * _side(room)
    for link, T in cabinet.link_poses().items():
        for hull in cabinet.model.hulls[link]:
            points = apply(T, hull.vertices)[:, :2]
            beside = (poses[:, :2] + half < points.min(0)) | (poses[:, :2] - half > points.max(0))
            assert beside.any(1).all()
    np.testing.assert_array_equal(poses, proposed(placer, room))


def test_the_authors_stay_where_they_are_if_boxes_hide_the_target(room: PlacerRoom) -> None:
    around = SceneObject(
        "cabinet", "", pose(room.target), Articulated(box_urdf("cabinet", (0.3,) * 3))
    )
    scene = replace(room.prepared.scene, objects=(around,))
    hidden = replace(room, prepared=replace(room.prepared, scene=scene))
    poses = proposed(AuthorsPlacer(PaperConfig(), ""), hidden)
    np.testing.assert_array_equal(poses, [[*room.start[:2], YAW]])


def _side(room: PlacerRoom) -> float:
    return float(np.ptp(room.robot.footprint, axis=0).max())
