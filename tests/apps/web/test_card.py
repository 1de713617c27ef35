"""The answer card, the guide, the stages and the phases of a static page."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

from momapos.apps.web.cameras import FIELD, front_of, hidden, task_viewpoint
from momapos.apps.web.card import TONES, WORKING, Card
from momapos.apps.web.colors import VERDICTS
from momapos.apps.web.page import StageCard
from momapos.apps.web.panel import WORDS, Guide, guide_html
from momapos.apps.web.static import phases, with_overlay
from momapos.model.scene.scene import Scene

EVIL = "</script><script>alert(1)</script>"


class Gui:
    """Counts what is sent."""

    def __init__(self) -> None:
        self.content, self.visible = "", True

    def add_html(self, content: str) -> Gui:
        self.content = content
        return self


def test_text_from_files_is_escaped_in_every_part_of_a_card() -> None:
    row = ((EVIL, EVIL),)
    card = Card(EVIL, "bad", EVIL, row, (EVIL,), row, ((3, EVIL),), ((EVIL, 0.1),), 0.5)
    assert "<script" not in card.html
    assert card.html.count("&lt;script&gt;") >= 8
    assert EVIL in str(card)


def test_a_card_has_the_color_of_the_footprint() -> None:
    assert [TONES[t] for t in ("", "good", "part", "bad")] == [
        VERDICTS[v] for v in ("", "feasible", "partly", "infeasible")
    ]
    assert TONES["bad"] in Card("No", "bad").html


def test_the_reasons_of_a_no_are_open_and_those_of_a_yes_can_be_opened() -> None:
    for tone, is_open in (("good", False), ("bad", True)):
        html = Card("?", tone, counts=((7, "out of reach"),)).html  # type: ignore[arg-type]
        assert ("<details open>" in html) is is_open
        assert "out of reach" in html


def test_the_guide_names_the_next_step_and_disappears_after_the_last() -> None:
    gui = Gui()
    guide = Guide(gui)
    assert WORDS["choose"][1] in gui.content
    guide.done("place")
    assert WORDS["choose"][1] in gui.content  # still the first one that is not done
    guide.done("choose")
    assert WORDS["play"][1] in gui.content
    guide.done("play", "drag", "why")
    assert not gui.visible
    assert guide_html(set(WORDS)).count("✓") == len(WORDS)


def test_a_search_shows_its_stages_and_their_times() -> None:
    shown: list[Card] = []
    now = iter(np.arange(0.0, 100.0, 0.5))
    card = StageCard(shown.append, lambda: float(next(now)))
    for stage in ("importance", "model", "importance", "search"):
        card.begin(stage)
    assert [one.progress for one in shown] == [WORKING] * len(shown)
    assert shown[-1].headline == "Searching: search"
    assert dict(shown[-1].stages) == {"importance": 1.0, "model": 0.5}


def test_phases_cover_the_film_without_gaps() -> None:
    found = phases(["drive", "drive", "arm", "open", "arm"], 0.5)
    assert found == [("drive", 0.0, 1.0), ("arm", 1.0, 1.5), ("open", 1.5, 2.0), ("arm", 2.0, 2.5)]


def test_a_static_page_is_titled_by_its_task_and_no_name_ends_its_script() -> None:
    page = "<html><head><title>Viser</title></head><body><div></div></body></html>"
    card = Card("Solved", "good", f"open {EVIL}")
    done = with_overlay(page, card, [(EVIL, 0.0, 1.0)], 1.5)
    assert "<title>open &lt;/script&gt;" in done
    assert ": solved</title>" in done
    assert done.endswith("</body></html>")
    assert "alert(1)</script>" not in done
    (rows,) = re.findall(r"phases=(\[.*?\]),bar", done)
    assert json.loads(rows) == [[EVIL, 0.0, 1.0]]


@pytest.mark.parametrize("target", ["fridge/door_hinge", "oven/door_hinge", "table"])
def test_the_camera_frames_robot_and_task_and_sees_the_front(target: str, kitchen: Scene) -> None:
    name = target.partition("/")[0]
    base = np.array([2.0, -1.7, 0.5])
    front = front_of(kitchen, target, base)
    eye, look_at = task_viewpoint(kitchen, name, front, base[None])
    ahead = (look_at - eye) / np.linalg.norm(look_at - eye)
    points = np.array([[*base[:2], 0.1], [*base[:2], 1.4], kitchen.object(name).bounds.mean(0)])
    away = (points - eye) / np.linalg.norm(points - eye, axis=1)[:, None]
    assert (np.arccos(away @ ahead) < FIELD).all()
    middle = kitchen.object(name).bounds.mean(0)[:2]
    assert (eye[:2] - middle) @ front > 0.0  # in front of it
    others = [o.bounds for o in kitchen.objects if o.name != name and o.category != "wall"]
    assert hidden(eye[None], points[1:2], np.array(others)).mean() == 0.0


def test_a_box_hides_what_is_behind_it_and_nothing_else() -> None:
    box = np.array([[[1.0, -1.0, -1.0], [2.0, 1.0, 1.0]]])
    points = np.array([[3.0, 0.0, 0.0], [0.5, 0.0, 0.0], [3.0, 5.0, 0.0], [-3.0, 0.0, 0.0]])
    assert hidden(np.zeros((1, 3)), points, box).tolist() == [[True, False, False, False]]
    assert not hidden(np.zeros((1, 3)), points, np.zeros((0, 2, 3))).any()
