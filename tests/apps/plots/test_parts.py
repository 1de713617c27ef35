"""Parts of figures: outlines, outcomes, the potential map, names, the arm."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.testing import assert_allclose
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from momapos.apps.plots.answer_plot import (
    KIND_OF,
    KINDS,
    YAWS,
    outcomes,
    potential_map,
    thin,
    wrapped,
)
from momapos.apps.plots.room_plot import (
    arm_frames,
    box_bounds,
    box_outlines,
    draw_room,
    name_objects,
    room_bounds,
)
from momapos.core.geometry.polygons import signed_area
from momapos.core.geometry.transforms import pose_planar
from momapos.model.records.outcomes import PoseOutcome, PoseStatus
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.model.urdf.hulls import Boxes
from momapos.planning.grasps.config import MotionConfig
from momapos.planning.grasps.task_motions import task_motion
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.placement.area import BaseStatus, base_pose_status
from momapos.planning.placement.problem import PoseOutcomes, Search
from momapos.planning.task_setup import placement_geometry


class Always:
    """A map on which the arm reaches everything."""

    def min_score(self, bases: np.ndarray, Ts_world_tool: np.ndarray) -> np.ndarray:
        return np.ones((len(bases), len(Ts_world_tool)))


@pytest.mark.parametrize("upright", [True, False])
def test_the_outline_of_a_box_is_the_hull_of_its_corners(upright: bool) -> None:
    rng = np.random.default_rng(1)
    turns = Rotation.random(50, rng=1).as_matrix()
    if upright:
        yaw = Rotation.from_rotvec(rng.uniform(-3, 3, (50, 1)) * [0, 0, 1]).as_matrix()
        swaps = Rotation.create_group("O").as_matrix()[rng.integers(0, 24, 50)]
        turns = yaw @ swaps
    boxes = Boxes(rng.normal(size=(50, 3)), turns, rng.uniform(0.1, 1, (50, 3)))
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    for b, xy in enumerate(box_outlines(boxes)):
        corners = (signs * boxes.half[b]) @ boxes.rotation[b].T + boxes.center[b]
        assert_allclose(signed_area(xy), ConvexHull(corners[:, :2]).volume)
        assert_allclose([xy.min(0), xy.max(0)], [corners.min(0)[:2], corners.max(0)[:2]])
        assert_allclose(box_bounds(boxes)[[b, b + 50]], [xy.min(0), xy.max(0)])


def test_every_candidate_is_counted_once() -> None:
    blocked, feasible = PoseOutcome(PoseStatus.BASE_BLOCKED), PoseOutcome(PoseStatus.FEASIBLE)
    hit = [PoseOutcome(PoseStatus.ARM_COLLISION, "a/b", where) for where in ("waypoint 3", "x")]
    search = Search(
        poses=[np.zeros((12, 3)), np.zeros((1, 3))],
        outcomes=[PoseOutcomes([blocked, *hit] * 4), PoseOutcomes([feasible])],
    )
    seen = outcomes(search)
    assert {words: count for (_, words), count in seen.counts.items()} == {
        "base in collision": 4, "arm hits a/b": 8, "feasible": 1,
    }  # fmt: skip
    assert len(seen.poses) == len(seen.kind) == 13


@pytest.mark.parametrize("status", PoseStatus)
def test_every_status_is_drawn_as_one_kind(status: PoseStatus) -> None:
    assert [status in kind.statuses for kind in KINDS].count(True) == 1
    assert status in KINDS[KIND_OF[status]].statuses


def test_thinning_keeps_the_best_of_every_place() -> None:
    rng = np.random.default_rng(2)
    points, rank = rng.uniform(-2, 2, (20_000, 2)), rng.integers(0, 5, 20_000)
    best = int(np.argmax(rank == 4))
    rank[rank == 4] = 3
    rank[best] = 4
    chosen = thin(points, rank, 1500)
    assert 300 < len(chosen) <= 1500
    assert best in chosen
    assert len(np.unique(chosen)) == len(chosen)
    assert_allclose(thin(points[:1500], rank[:1500], 1500), np.arange(1500))


def test_the_potential_is_zero_where_the_base_cannot_stand_and_nowhere_else(
    kitchen: Scene, fetch: Robot
) -> None:
    motion = task_motion(kitchen, fetch, make_task(kitchen, "pick", "cup"), MotionConfig())
    geometry = placement_geometry(kitchen, fetch, motion, clearance=0.01)
    potential = potential_map(geometry, Always(), cell=0.2)
    i, j = np.indices(potential.value.shape).reshape(2, -1)
    xy = potential.low + 0.2 * (np.stack([j, i], -1) + 0.5)
    yaw = np.tile(2 * np.pi / YAWS * np.arange(YAWS), len(xy))
    poses = np.column_stack([np.repeat(xy, YAWS, axis=0), yaw])
    stands = (base_pose_status(geometry, poses)[0] == BaseStatus.CLEAR).reshape(-1, YAWS).any(1)
    assert stands.any()
    assert ((potential.value.ravel() > 0) == stands).all()
    assert potential.value.max() <= 1.0


def test_names_overlap_neither_each_other_nor_given_rectangles(kitchen: Scene) -> None:
    figure = Figure(figsize=(5, 5), dpi=100)
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.05, 0.05, 0.9, 0.9))
    low, high = room_bounds(kitchen)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    draw_room(axes, kitchen, target="fridge")
    clear = np.array([[1.0, -0.7], [1.6, -0.2]])
    name_objects(axes, kitchen, target="fridge", keep_clear=[clear])
    names = {text.get_text(): text.get_window_extent() for text in axes.texts}
    assert {"fridge", "table", "oven"} <= set(names)
    assert not any(name.startswith("wall_b") for name in names)
    assert not any(a.overlaps(b) for a, b in combinations(names.values(), 2))
    corners = axes.transData.transform(clear)
    for box in names.values():
        assert (box.max <= corners[0]).any() or (box.min >= corners[1]).any()


def test_the_arm_is_drawn_to_its_tool(fetch: Robot) -> None:
    base = np.array([1.0, 2.0, 0.7])
    poses, line = arm_frames(fetch, base, fetch.home)
    T_world_tool = pose_planar(base) @ fetch.chain.tool_poses(fetch.home)
    assert_allclose(line[-1], T_world_tool[:2, 3], atol=1e-12)
    assert_allclose(poses[fetch.tool_link], T_world_tool, atol=1e-12)


def test_a_long_reason_is_wrapped_completely() -> None:
    reason = (
        "exact check: arm collision with the scene: "
        "left_finger_link and cabinet_right/drawer_bottom"
    )
    lines = wrapped(reason)
    assert len(lines) > 1
    assert all(len(line) <= 38 for line in lines)
    assert " ".join(lines) == reason
    assert "".join(wrapped("x" * 100)) == "x" * 100
