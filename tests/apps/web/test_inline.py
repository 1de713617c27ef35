"""Records display themselves in notebooks."""

from __future__ import annotations

import html
from dataclasses import replace
from pathlib import Path

import pytest

from momapos.apps.web import static as inline
from momapos.core.errors import InputError
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement

PNG = b"\x89PNG\r\n\x1a\n"


def test_scenes_and_answers_are_images_and_answers_play(
    monkeypatch: pytest.MonkeyPatch, kitchen: Scene, segway: Robot
) -> None:
    task = make_task(kitchen, "open", "fridge", "door_hinge")
    answer = plan_base_placement(kitchen, segway, task)
    assert kitchen._repr_png_().startswith(PNG)
    assert answer._repr_png_().startswith(PNG)
    opened: list[str] = []
    monkeypatch.setattr(inline.webbrowser, "open", opened.append)
    answer.show()
    (address,) = opened
    page = Path(address.removeprefix("file://"))
    assert "__VISER_EMBED_DATA__" in page.read_text()
    page.unlink()
    unsolved = replace(answer, plan=replace(answer.plan, status="infeasible", motion=None))
    with pytest.raises(InputError, match="no motion"):
        unsolved.show()


def test_an_embedded_page_is_sandboxed() -> None:
    page = '<script>"&"</script>'
    frame = inline.frame_of(page)
    assert html.unescape(frame.split('srcdoc="')[1].split('"')[0]) == page
    assert 'sandbox="allow-scripts"' in frame
