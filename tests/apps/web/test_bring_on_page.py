"""To bring an object is an answer of two tasks, of which most answers have one."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace

import numpy as np
import pytest
from tests.apps.web.pages import serve

from momapos.apps.web.page import Page
from momapos.apps.web.panel import CLICKS, POINT
from momapos.model.plan_files.tour_format import read_tour
from momapos.verification.plan_check import verify_files

LONG = 60.0


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    with serve(tmp_path_factory.mktemp("files")) as (page, _):
        page.panel.verb.value = "bring"
        page.change()
        assert page.work.wait(LONG)
        yield page


def test_an_object_is_brought_to_a_clicked_point_and_the_tour_is_saved(page: Page) -> None:
    panel, scene = page.panel, page.shown.scene
    page._pick("bottle", None)
    assert page.work.wait(LONG)
    assert panel.target.value == "bottle"
    assert panel.clicks.value == CLICKS[1]  # the next click chooses the place
    top = scene.object("table").bounds
    at = np.array([*top.mean(0)[:2], top[1, 2]])
    above = SimpleNamespace(
        ray_origin=at + np.array([0.0, 0.0, 2.0]), ray_direction=(0.0, 0.0, -1.0)
    )
    page.room._clicked("table", above)
    page.place()
    assert page.work.wait(LONG)
    assert panel.goal.value == POINT
    pick, place = page.shown.tour.steps
    assert (pick.plan.task.verb, place.plan.task.verb) == ("pick", "place")
    goal = page.shown.tour.scenes[1].object("bottle").bounds
    np.testing.assert_allclose([*goal.mean(0)[:2], goal[0, 2]], at, atol=1e-3)
    assert "pick bottle, then place bottle" in panel.card.text
    assert "old place" not in panel.card.text
    assert page.motion.player.now == 0.0  # a tour is shown from its beginning
    page.motion.seek(page.motion.player.duration)
    assert "task 2 of 2, place bottle" in panel.moment.content

    page.files.save_plan("bring.json")
    assert page.files.work.wait(LONG)
    for step in read_tour(page.files.folder / "bring.json").steps:
        assert verify_files(page.files.folder / step.plan).valid
    (page.files.folder / "other_room_2.json").write_text("mine")
    page.files.save_plan("other.json")
    assert page.files.work.wait(LONG)
    assert "file exists" in panel.files.content
    assert (page.files.folder / "other_room_2.json").read_text() == "mine"


def test_places_are_objects_parts_and_areas_and_a_wrong_point_is_named(page: Page) -> None:
    panel = page.panel
    assert "cabinet_right/drawer_middle_slide" in panel.goal.options
    assert "table" in panel.goal.options
    assert "bottle" not in panel.goal.options
    panel.goal.value, panel.point.value = POINT, "1.2,0.4"
    page.place()
    assert page.work.wait(LONG)
    assert "'1.2,0.4' is not X,Y,Z" in panel.card.text
    panel.verb.value = "open"
    page.change()
    assert page.work.wait(LONG)
    assert not panel.goal.visible
    assert not panel.clicks.visible
