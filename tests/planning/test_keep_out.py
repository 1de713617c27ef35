"""The base keeps out of areas where it stands, as it drives and as it moves."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.rooms import Everywhere, cabinet_room

from momapos.core.geometry.polygons import any_overlap
from momapos.core.geometry.transforms import place_points
from momapos.model.plan_files.plan_format import write_plan
from momapos.model.records.plans import BaseRegion, Outline
from momapos.model.robots.robot import Robot, load_robot
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import save_scene
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.planning.navigation.driving import drive
from momapos.planning.navigation.footprint_map import build_navigation_map
from momapos.planning.result import PlacementResult
from momapos.verification.plan_check import verify_files

FLOOR = np.array([[-2.5, -4.0], [2.5, -4.0], [2.5, 0.1], [-2.5, 0.1]])
START = np.array([0.0, -3.2, np.pi / 2])
LEFT_OPEN: Outline = ((-0.8, -2.6), (2.5, -2.6), (2.5, -2.2), (-0.8, -2.2))
"""A strip that leaves a way on its left."""
ACROSS: Outline = ((-2.5, -2.45), (2.5, -2.45), (2.5, -2.4), (-2.5, -2.4))
"""A thin strip from wall to wall."""
SMALL: Outline = ((-0.05, -2.5), (0.05, -2.5), (0.0, -2.4))
"""An area smaller than the base, in its way."""
HOOK: Outline = (
    (-1.2, -2.6), (1.2, -2.6), (1.2, -3.6), (1.3, -3.6), (1.3, -2.5), (-1.2, -2.5),
)  # fmt: skip
"""An area that is not convex: the robot starts in its corner."""


def room(folder: Path) -> Scene:
    return replace(cabinet_room(folder), floor_polygon=FLOOR, areas={"people": ACROSS})


def answer(scene: Scene, *areas: Outline, robot: str = "segway_ur5e") -> PlacementResult:
    machine = load_robot(robot)
    return plan_base_placement(
        scene, machine, make_task(scene, "open", "cabinet", "hinge"), Everywhere(), start=START,
        region=BaseRegion(keep_out=areas),
    )  # fmt: skip


@pytest.mark.parametrize("area", [LEFT_OPEN, SMALL, HOOK])
def test_the_base_drives_around_areas(tmp_path: Path, area: Outline) -> None:
    scene = room(tmp_path)
    free, found = answer(scene), answer(scene, area)
    assert found.plan.feasible
    outline = found.prepared.robot.base_outline
    for plan, crosses in ((free.plan, True), (found.plan, False)):
        overlaps = any_overlap(np.array(area), place_points(plan.base_path, outline))
        assert overlaps.any() == crosses


def test_areas_that_block_every_path_are_named(tmp_path: Path) -> None:
    plan = answer(room(tmp_path), ACROSS).plan
    assert plan.status == "infeasible"
    assert [*plan.candidates.rejections] == [
        "no way to drive there outside the keep-out area 'people'"
    ]


def test_a_start_in_an_area_is_named(tmp_path: Path) -> None:
    plan = answer(room(tmp_path), ((-0.1, -3.3), (0.1, -3.3), (0.1, -3.1))).plan
    assert plan.status == "infeasible"
    assert next(iter(plan.candidates.rejections)).endswith("where the robot starts")


@pytest.mark.parametrize("area", [LEFT_OPEN, SMALL, ACROSS])
def test_verify_finds_areas_that_the_base_crosses(tmp_path: Path, area: Outline) -> None:
    scene = room(tmp_path)
    save_scene(scene, tmp_path / "scene.json")
    plan = replace(answer(scene).plan, scene=str(tmp_path / "scene.json"))
    name = "base in a keep-out area"
    for region, valid in ((BaseRegion(), True), (BaseRegion(keep_out=(area,)), False)):
        write_plan(replace(plan, region=region), tmp_path / "plan.json")
        report = verify_files(tmp_path / "plan.json")
        assert [check.name for check in report.violations] == ([] if valid else [name])


def test_a_drive_in_closed_loop_keeps_out(tmp_path: Path, segway: Robot) -> None:
    scene = room(tmp_path)
    goal = np.array([0.0, -1.6, np.pi / 2])
    nav_map = build_navigation_map(scene, segway, (LEFT_OPEN,))
    driven = drive(nav_map, START, goal, rng=np.random.default_rng(0))
    assert driven.arrived
    outlines = place_points(driven.poses, segway.base_outline)
    assert not any_overlap(np.array(LEFT_OPEN), outlines).any()
