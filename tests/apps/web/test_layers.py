"""Layers and motions have the right geometry, and answers the right text."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from momapos.apps.web.map_layers import box_edges, covered, free_area
from momapos.apps.web.playback import Story
from momapos.apps.web.words import answer_card
from momapos.core.errors import escape_markdown
from momapos.core.geometry.transforms import place_points, pose_planar
from momapos.model.records.outcomes import Tolerance
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_object import SceneObject, upright_boxes
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.planning.placement.area import BaseStatus, base_pose_status
from momapos.planning.result import PlacementResult
from momapos.planning.robust import unit_offsets


@pytest.fixture(scope="module")
def answer(kitchen: Scene, segway: Robot) -> PlacementResult:
    task = make_task(kitchen, "open", "fridge", "door_hinge")
    return plan_base_placement(kitchen, segway, task)


def test_the_free_area_is_where_the_base_stands_clear(answer: PlacementResult) -> None:
    geometry = answer.prepared.geometry
    bounds = np.array([[0.0, -3.9], [4.2, 0.0]])
    share, (left, right, bottom, top) = free_area(geometry, bounds, cell=0.3)
    rows, columns = share.shape
    rng = np.random.default_rng(0)
    for row, column in rng.integers(0, [rows, columns], (40, 2)):
        x = left + (column + 0.5) * (right - left) / columns
        y = bottom + (row + 0.5) * (top - bottom) / rows
        poses = np.array([[x, y, yaw] for yaw in np.arange(8) * np.pi / 4])
        clear = base_pose_status(geometry, poses)[0] == BaseStatus.CLEAR
        assert share[row, column] == pytest.approx(clear.mean())
    assert share.max() > 0


def test_boxes_are_drawn_with_their_twelve_edges() -> None:
    box = SceneObject.box("crate", (1.0, 2.0, 3.0), (5.0, 0.0, 1.5), yaw=0.3)
    lengths = np.linalg.norm(np.diff(box_edges(upright_boxes([box])), axis=2)[0, :, 0], axis=-1)
    np.testing.assert_allclose(np.sort(lengths), np.repeat([1.0, 2.0, 3.0], 4))


def test_a_motion_begins_at_the_start_and_ends_as_the_plan_does(answer: PlacementResult) -> None:
    plan, robot = answer.plan, answer.prepared.robot
    story = Story.of(plan, robot, answer.prepared.scene)
    first, last = story.at(-1.0), story.at(story.duration + 1.0)
    assert plan.base_pose is not None
    np.testing.assert_allclose(pose_planar(first.base), pose_planar(answer.start), atol=1e-6)
    np.testing.assert_allclose(
        pose_planar(last.base), pose_planar(np.array(plan.base_pose)), atol=1e-6
    )
    np.testing.assert_allclose(list(last.joints.values()), plan.motion.q[-1], atol=1e-3)
    assert last.object_q == {"door_hinge": pytest.approx(plan.motion.object_q[-1])}


def test_the_text_of_an_answer_contains_the_base_pose(answer: PlacementResult) -> None:
    words = str(answer_card(answer))
    assert words.startswith("Solved\n")
    assert f"x {answer.plan.base_pose[0]:.3f} m" in words  # type: ignore[index]


def test_a_measured_tolerance_is_in_the_text_even_if_it_is_zero(answer: PlacementResult) -> None:
    assert "tolerance" not in str(answer_card(answer))
    some, none = Tolerance(0.03, np.radians(1.8), 100), Tolerance(0.0, 0.0, 100)
    timing = {**answer.plan.timing, "tolerance": 0.4567}

    def text(found: Tolerance) -> str:
        plan = replace(answer.plan, tolerance=found, timing=timing)
        return str(answer_card(replace(answer, plan=plan)))

    line = "\ntolerance: ±3 cm, ±1.8° (100 sampled poses)"
    assert line in text(some)
    assert "\ntolerance: none" in text(none)
    # Its time is neither in the total nor among the slowest stages.
    assert text(some).replace(line, "") == str(answer_card(answer))


def test_the_hull_encloses_tightly_the_footprints_of_all_poses_within_a_tolerance() -> None:
    footprint = np.array([[0.4, -0.3], [0.4, 0.3], [-0.3, 0.3], [-0.3, -0.3]])
    base, found = np.array([1.0, -2.0, 0.7]), Tolerance(0.1, np.radians(6.0), 100)
    hull = covered(footprint, base, found)
    edges = np.roll(hull, -1, 0) - hull
    outward = np.stack([edges[:, 1], -edges[:, 0]], -1) / np.linalg.norm(edges, axis=1)[:, None]
    offset = (outward * hull).sum(1)
    size = np.array([found.radius, found.radius, found.turn])
    poses = base + unit_offsets(4000, np.random.default_rng(0)) * size
    corners = place_points(poses, footprint).reshape(-1, 2)
    beyond = corners @ outward.T - offset
    assert beyond.max() < 0.003  # the circle has 48 corners, and 9 yaws are sampled
    # Some pose nearly reaches each edge of the hull.
    assert (beyond.max(0) > -0.012).all()


def test_text_from_files_is_escape_markdown() -> None:
    assert escape_markdown("<img src=x>") == "\\<img src=x\\>"
    assert escape_markdown("a*b_c") == "a\\*b\\_c"


def test_a_picked_object_moves_with_the_hand_after_it_is_grasped(
    kitchen: Scene, segway: Robot
) -> None:
    plan = plan_base_placement(kitchen, segway, make_task(kitchen, "pick", "cup")).plan
    story = Story.of(plan, segway, kitchen)
    rest = kitchen.object("cup").link_poses()[kitchen.object("cup").model.urdf.root]
    first, last = story.at(0.0), story.at(story.duration)
    np.testing.assert_allclose(first.T_world_object, rest)
    moved = plan.motion.Ts_world_tool[-1] @ np.linalg.inv(plan.motion.Ts_world_tool[0])
    np.testing.assert_allclose(last.T_world_object, moved @ rest, atol=2e-3)
    assert last.T_world_object[2, 3] > rest[2, 3] + 0.049  # by 5 cm
    begins = next(t for t in np.arange(0, story.duration, 0.04) if "gripper" in story.at(t).phase)
    np.testing.assert_allclose(story.at(begins).T_world_object, rest, atol=2e-3)  # it does not jump


def test_a_placed_object_is_in_the_hand_until_it_stands_in_its_place(
    kitchen: Scene, segway: Robot
) -> None:
    plan = plan_base_placement(kitchen, segway, make_task(kitchen, "place", "cup")).plan
    assert plan.motion is not None
    story = Story.of(plan, segway, kitchen)
    rest = kitchen.object("cup").link_poses()[kitchen.object("cup").model.urdf.root]
    T = story.at(0.0).T_world_object
    assert np.linalg.norm(T[:3, 3] - rest[:3, 3]) > 0.5
    np.testing.assert_allclose(story.at(story.duration).T_world_object, rest)
    steps = np.array([story.at(t).T_world_object for t in np.arange(0, story.duration, 0.04)])
    assert np.linalg.norm(np.diff(steps[:, :3, 3], axis=0), axis=1).max() < 0.1  # it does not jump
