"""A tour plays task by task, each in the room as the last task left it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.apps.web.pages import serve
from tests.commands import error_of

from momapos.apps.cli.main import main
from momapos.apps.cli.view import opened_source
from momapos.apps.web.opened import Opened
from momapos.apps.web.playback import TourStory
from momapos.core.errors import InputError
from momapos.model.plan_files.tour_format import read_tour

DRAWER = ("cabinet_right", "drawer_middle_slide")
LONG = 60.0


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tour of three tasks at one stop, with its plans."""
    path = tmp_path_factory.mktemp("tour") / "tour.json"
    name = "/".join(DRAWER)
    words = ["open", "kitchen_small", name, "then", "pick", "bottle", "then", "close", name]
    assert main(["place", *words, "--robot", "segway_ur5e", "--out", str(path)]) == 0
    return path


@pytest.fixture(scope="module")
def tour(file: Path) -> Opened:
    with opened_source(str(file), None) as opened:
        assert isinstance(opened, Opened)
        return opened


def test_the_tasks_of_a_tour_play_one_after_the_other(tour: Opened) -> None:
    story = tour.story()
    assert isinstance(story, TourStory)
    assert [one.task.verb for one in story.stories] == ["open", "pick", "close"]
    ends = np.cumsum([one.duration for one in story.stories])
    assert story.duration == pytest.approx(ends[-1])
    for number, (end, one) in enumerate(zip(ends, story.stories, strict=True), start=1):
        moment = story.at(end - one.duration / 2)
        assert moment.phase.startswith(f"task {number} of 3, {one.task.verb} {one.task.object}: ")
        assert moment.room.active == one.task.object
        np.testing.assert_array_equal(moment.base, one.at(one.duration / 2).base)
    for end in ends[:-1]:  # neither the base nor the arm jumps between tasks
        before, after = story.at(end - 1e-6), story.at(end + 1e-6)
        np.testing.assert_allclose(after.base, before.base, atol=1e-3)
        for joint, value in before.joints.items():
            assert after.joints[joint] == pytest.approx(value, abs=1e-2)
    assert story.at(-1.0).phase.startswith("task 1")
    assert story.at(story.duration + 1.0).phase.startswith("task 3")


def test_each_task_is_in_the_room_as_the_last_task_left_it(tour: Opened) -> None:
    story = tour.story()
    assert isinstance(story, TourStory)
    closed, opened, still = story.scenes
    assert closed.object(DRAWER[0]).values()[DRAWER[1]] == 0.0
    assert tour.plan.task.to is not None
    for room in (opened, still):
        assert room.object(DRAWER[0]).values()[DRAWER[1]] == pytest.approx(tour.plan.task.to)
    # Unchanged objects are identical, so that they are not drawn again.
    same = [one is other for one, other in zip(closed.objects, opened.objects, strict=True)]
    assert same.count(False) == 1


def test_a_page_opened_with_a_tour_plays_it_and_then_answers_questions(
    file: Path, tour: Opened, tmp_path: Path
) -> None:
    with serve(tmp_path, scene=str(file), opened=tour) as (page, _):
        assert page.work.wait(LONG)
        tasks = f"open {'/'.join(DRAWER)}, then pick bottle, then close {'/'.join(DRAWER)}"
        assert page.panel.card.text.startswith(f"Solved\n{tasks} with ")
        assert "2.: pick bottle from x" in page.panel.card.text
        assert "A picked object is drawn at its old place" in page.panel.card.text
        story = tour.story()
        assert isinstance(story, TourStory)
        assert page.motion.player.duration == story.duration
        first = story.stories[0].duration
        page.motion.seek(first / 2)
        assert page.room.active == DRAWER[0]
        page.motion.seek(first + story.stories[1].duration / 2)
        assert page.room.active == "bottle"
        assert page.room.scene is tour.then[0].scene
        assert "task 2 of 3, pick bottle" in page.panel.moment.content
        page.motion.move_joints()  # with the sliders, in the room of the question
        assert page.room.active == DRAWER[0]
        assert page.room.scene is tour.scene
        page.motion.seek(story.duration)
        page.place()
        assert page.work.wait(LONG)
        assert page.room.scene is tour.scene
        assert page.motion.player.duration == pytest.approx(first, rel=0.5)
        assert page.shown.answer.plan.task.verb == "open"


def test_a_tour_is_written_as_one_page(file: Path, tmp_path: Path) -> None:
    page = tmp_path / "tour.html"
    assert main(["view", str(file), "--static", str(page)]) == 0
    assert "__VISER_EMBED_DATA__" in page.read_text()


def test_an_unusable_tour_is_reported_in_one_line(file: Path, tour: Opened) -> None:
    content = json.loads(file.read_text())
    cases = {
        "unsolved.json": ({**content, "status": "infeasible"}, "there is nothing to show"),
        "later.json": ({**content, "version": 99}, "version 99"),
        "gone.json": ({**content, "steps": [{"stop": 1, "plan": "no.json"}]}, "no.json"),
    }
    for name, (held, words) in cases.items():
        path = file.with_name(name)
        path.write_text(json.dumps(held))
        assert words in error_of("view", str(path), "--port", "0")
    assert len(read_tour(file).steps) == 3
    other = replace(tour.then[0], plan=replace(tour.then[0].plan, joints=("another",)))
    with pytest.raises(InputError, match="plan 2 of the tour is for another robot"):
        replace(tour, then=(other,)).story()
