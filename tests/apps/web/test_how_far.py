"""The slider covers the joint's range, in degrees or centimeters, and asks what it shows."""

from __future__ import annotations

import math
from collections.abc import Iterator

import pytest
from tests.apps.web.pages import serve

from momapos.apps.web.page import Page
from momapos.apps.web.panel import HowFar, how_far
from momapos.core.errors import TaskError
from momapos.model.scene.scene_files import load_scene
from momapos.planning.grasps.task_requests import make_task

LONG = 60.0
KITCHEN = load_scene("kitchen_small")
PARTS = [(o.name, j) for o in KITCHEN.objects for j in o.model.joints]


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    with serve(tmp_path_factory.mktemp("page")) as (page, _):
        assert page.work.wait(LONG)
        yield page


@pytest.mark.parametrize(("name", "joint"), PARTS)
def test_every_value_of_the_slider_is_within_the_joint_limits(name: str, joint: str) -> None:
    offered, record = how_far(KITCHEN, "open", f"{name}/{joint}"), KITCHEN.object(name).joint(joint)
    assert offered.unit == ("cm" if record.kind == "prismatic" else "deg")
    factor = 0.01 if offered.unit == "cm" else math.radians(1.0)
    assert record.lower - 1e-6 <= factor * offered.low < factor * offered.high
    assert factor * offered.high <= record.upper + 1e-6
    usual = make_task(KITCHEN, "open", name, joint).to
    assert factor * offered.usual == pytest.approx(usual, abs=0.1 * factor)
    farthest = make_task(KITCHEN, "open", name, joint, offered.text(offered.high) or None).to
    assert abs(farthest) >= abs(usual) - 0.1 * factor


def test_a_value_is_written_and_read_as_on_the_command_line() -> None:
    offered = HowFar("cm", 0.0, 40.5, 40.5)
    assert offered.text(40.5) == ""
    assert offered.text(12.5) == "12.5cm"
    assert [offered.value(text) for text in ("", "max", "0.125m", "9m")] == [40.5, 40.5, 12.5, 40.5]
    with pytest.raises(TaskError):
        offered.value("far")


def test_a_whole_object_has_no_slider() -> None:
    assert how_far(KITCHEN, "pick", "apple") is None
    assert how_far(KITCHEN, "open", "fridge") is None


def test_the_question_is_what_the_slider_shows(page: Page) -> None:
    panel = page.panel
    assert (panel.slider.label, panel.to) == ("How far [deg]", "")
    panel.slider.value = 45.0
    assert panel.to == "45deg"
    panel.farthest.value = True
    assert panel.to == "max"
    panel.target.value = "cabinet_right/drawer_top_slide"
    page.change()
    assert page.work.wait(LONG)
    assert (panel.slider.label, panel.to) == ("How far [cm]", "")  # a new part begins as usual
    panel.show_to(f"{0.1 + 1e-9!r}m")
    assert panel.to == f"{0.1 + 1e-9!r}m"  # exact, as in the plan that is shown
    panel.slider.value = 20.0
    assert panel.to == "20cm"
    panel.verb.value = "pick"
    page.change()
    assert page.work.wait(LONG)
    assert not panel.slider.visible
    assert panel.to == ""
