"""The page shows the plan, run or scan that it is opened with."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.commands import error_of

from momapos.apps.cli.view import kind_of, scenes_in, source_in
from momapos.apps.web.opened import Opened, RunStory, quantity_text
from momapos.apps.web.static import page_of
from momapos.apps.web.words import run_card
from momapos.core.errors import InputError
from momapos.core.units import parse_quantity
from momapos.model.records.plans import Task
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.simulation.run_record import Execution, Load, RunMotion, RunRecord, write_run

DONE = Execution(True, "", "contact", 0.0, 1.5, 1.5, load=Load(31.0, 2.0), ending="it went well")
MOTION = RunMotion(
    (0.0, 1.0, 3.0), ("drive", "manipulate", "dwell"),
    ((0.0, 0.0, 3.0), (1.0, 0.0, -3.0), (1.0, 2.0, -3.0)),
    {"elbow_joint": (0.0, 1.0, 3.0)}, (0.0, 0.0, 1.5), (),
    ((0.0, 0.0, 0.0), (0.0, 30.0, 0.0), (0.0, 1.0, 0.0)),
)  # fmt: skip
RECORD = RunRecord(
    "kitchen_small", "segway_ur5e", Task("open", "fridge", "door_hinge", 1.5), (), DONE,
    motion=MOTION,
)  # fmt: skip


def test_a_run_is_shown_as_recorded(segway: Robot) -> None:
    story = RunStory.of(RECORD, segway)
    assert story.duration == 3.0
    np.testing.assert_allclose(story.at(-1.0).base, MOTION.bases[0])
    last = story.at(9.0)
    np.testing.assert_allclose(last.base, MOTION.bases[-1])
    assert last.object_q == {"door_hinge": 1.5}
    between = story.at(2.0)
    np.testing.assert_allclose(between.base, [1.0, 1.0, -3.0])
    assert between.joints["elbow_joint"] == pytest.approx(2.0)
    assert between.object_q == {"door_hinge": pytest.approx(0.75)}
    yaw = story.at(0.5).base[2]  # across the shorter angle
    assert np.cos(yaw) == pytest.approx(-1.0, abs=1e-6)
    now = story.at(1.0)
    assert (now.phase, now.force.tolist()) == ("manipulate", [0.0, 30.0, 0.0])


def test_a_movable_object_moves_along(segway: Robot) -> None:
    poses = ((0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0),
             (0.5, 0.0, 1.2, 0.0, 0.0, 0.0, 1.0))  # fmt: skip
    motion = replace(MOTION, part=(), poses=poses)
    record = replace(RECORD, task=Task("pick", "cup"), motion=motion)
    moment = RunStory.of(record, segway).at(3.0)
    T = moment.T_world_object
    np.testing.assert_allclose(T[:3, 3], [0.5, 0.0, 1.2])
    np.testing.assert_allclose(T[:3, :3], np.diag([-1.0, -1.0, 1.0]), atol=1e-12)
    assert moment.object_q == {}


def test_a_record_without_motion_or_of_another_robot_is_refused(
    segway: Robot, fetch: Robot
) -> None:
    with pytest.raises(InputError, match="run record contains no motion"):
        RunStory.of(replace(RECORD, motion=None), segway)
    with pytest.raises(InputError, match="elbow_joint"):
        RunStory.of(RECORD, fetch)


def test_a_run_is_described_in_text() -> None:
    words = str(run_card(RECORD))
    assert words.startswith("Succeeded")
    assert "at most 31 N" in words
    failed = replace(RECORD, execution=replace(DONE, success=False, reason="the hold <b>broke"))
    assert run_card(failed).notes == ("the hold <b>broke",)
    assert "the hold &lt;b&gt;broke" in run_card(failed).html


def test_sources_are_recognized_by_their_content(tmp_path: Path) -> None:
    held = {
        "a.json": (b'{"format": "momapos-plan", "version": 1}', "plan"),
        "b.json": (b'{"format": "momapos-run", "version": 1}', "run"),
        "c.json": (b'{"format": "momapos-scene", "version": 1}', "scene"),
        "d.bin": (b"ply\nformat ascii 1.0\n", "scan"),
        "e.bin": (b"\x89MCAP0\r\n", "scan"),
    }
    for name, (content, kind) in held.items():
        (tmp_path / name).write_bytes(content)
        assert kind_of(str(tmp_path / name)) == kind
    assert kind_of(str(tmp_path)) == "scan"
    assert kind_of("kitchen_small") == "scene"


def test_the_page_offers_the_scene_files_of_the_working_folder_and_no_links(tmp_path: Path) -> None:
    here, elsewhere = tmp_path / "here", tmp_path / "elsewhere.json"
    here.mkdir()
    for path in (here / "room.json", elsewhere):
        path.write_text('{"format": "momapos-scene", "version": 1}')
    (here / "plan.json").write_text('{"format": "momapos-plan", "version": 1}')
    (here / "link.json").symlink_to(elsewhere)
    (here / "folder.json").mkdir()
    assert scenes_in(here) == ("room.json",)


def test_an_unusable_record_is_reported_in_one_line(tmp_path: Path) -> None:
    write_run(replace(RECORD, motion=None), tmp_path / "old.json")
    write_run(replace(RECORD, plan="gone.json"), tmp_path / "run.json")
    (tmp_path / "no_scan").mkdir()
    for name, words in (
        ("old.json", "the record has no motion"),
        ("run.json", "gone.json"),
        ("no_scan", "not a scan"),
    ):
        assert words in error_of("view", str(tmp_path / name), "--port", "0")


def test_a_solve_folder_is_shown_by_its_run_or_else_by_its_plan(tmp_path: Path) -> None:
    assert source_in(str(tmp_path)) == str(tmp_path)
    (tmp_path / "plan.json").touch()
    assert source_in(str(tmp_path)) == str(tmp_path / "plan.json")
    (tmp_path / "run.json").touch()
    assert source_in(str(tmp_path)) == str(tmp_path / "run.json")


def test_a_page_of_a_run_in_another_world_shows_that_world(kitchen: Scene, segway: Robot) -> None:
    plan = plan_base_placement(
        kitchen, segway, make_task(kitchen, "open", "fridge", "door_hinge")
    ).plan
    other = replace(plan, task=replace(plan.task, object="what the robot took it for"))
    world = replace(RECORD, true_task=plan.task)
    opened = Opened("world", kitchen, segway, other, world)
    assert opened.answer() is None
    assert opened.question.target == "fridge/door_hinge"
    page = page_of(kitchen, segway, other, opened.story(), "fridge")
    assert page.startswith("<!")
    assert len(page) > 100_000


@pytest.mark.parametrize("to", [np.pi / 2, np.pi / 3, 1.2345678901234567, -0.1])
def test_a_formatted_joint_value_is_parsed_to_the_same_value(to: float) -> None:
    assert parse_quantity(quantity_text(to, slides=False)).value == pytest.approx(to, rel=1e-12)
    assert quantity_text(np.pi / 2, slides=False) == "90deg"
    assert quantity_text(0.25, slides=True) == "0.25m"
