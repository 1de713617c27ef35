"""In a notebook records show themselves."""

from __future__ import annotations

import html
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from momapos.apps.web import notebook_page as inline
from momapos.core.errors import InputError
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene_files import load_scene
from momapos.planning.grasps.tasks import make_task
from momapos.planning.plan import plan_base_placement

PNG = b"\x89PNG\r\n\x1a\n"


def test_a_scene_and_an_answer_are_pictures_and_an_answer_plays(
    robots: Callable[[str], Robot], monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = load_scene("kitchen_small")
    task = make_task(scene, "open", "fridge", "door_hinge")
    answer = plan_base_placement(scene, robots("segway_ur5e"), task)
    assert scene._repr_png_().startswith(PNG)
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


def test_a_page_within_a_page_keeps_to_itself() -> None:
    page = '<script>"&"</script>'
    frame = inline.frame_of(page)
    assert html.unescape(frame.split('srcdoc="')[1].split('"')[0]) == page
    assert 'sandbox="allow-scripts"' in frame
