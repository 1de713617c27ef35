"""A large room gets plain light by default, and only changes are sent to browsers."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.apps.web.pages import serve

from momapos.apps.web.cameras import SUN_NODE
from momapos.apps.web.page import Page
from momapos.model.records.scans import Cloud
from momapos.model.scene.model_copies import copied
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene, save_scene
from momapos.model.scene.scene_object import SceneObject
from momapos.perception.records import Modeled

LONG = 60.0
KITCHEN = load_scene("kitchen_small")
MOVES = {"SetPositionMessage", "SetOrientationMessage"}


def hall() -> Scene:
    """Return the kitchen with crates around it."""
    crates = tuple(
        SceneObject.box(f"crate_{k}", (0.5,) * 3, (8 + k % 20, k // 20, 0.25)) for k in range(300)
    )
    return Scene("hall", (*KITCHEN.objects, *crates), start=KITCHEN.start)


def scan() -> Modeled:
    points = np.random.default_rng(0).uniform(0.0, 9.0, (60_000, 3))
    cloud = Cloud(points, np.tile([0.0, 0.0, 1.0], (len(points), 1)),
                  np.zeros((len(points), 3), np.uint8))  # fmt: skip
    return Modeled(Path("scan.json"), cloud, (), np.eye(4), ())


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    """A page without browsers, with a kitchen and a hall."""
    folder = tmp_path_factory.mktemp("page")
    file = folder / "hall.json"
    with copied(hall(), file) as whole:
        save_scene(whole, file)
    with serve(folder, str(file)) as (page, _):
        assert page.work.wait(LONG)
        yield page


@pytest.fixture
def sent(page: Page, monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """All messages to browsers."""
    messages: list[Any] = []
    interface = page.server.scene._websock_interface
    say = interface.queue_message

    def tell(message: Any) -> None:
        messages.append(message)
        say(message)

    monkeypatch.setattr(interface, "queue_message", tell)
    return messages


def of_light(sent: list[Any]) -> list[Any]:
    return [m for m in sent if kind(m) in ("HemisphereLightMessage", "EnvironmentMapMessage")]


def kind(message: Any) -> str:
    return type(message).__name__


def drawn(sent: list[Any]) -> list[str]:
    """Return the nodes that are drawn, redrawn or changed, except for their poses."""
    return [m.name for m in sent if hasattr(m, "name") and kind(m) not in MOVES]


def choose(page: Page, scene: str) -> None:
    page.panel.scene.value = scene
    page.change()
    assert page.work.wait(LONG)
    assert page.layers.wait(LONG)


def test_a_large_room_has_plain_light_until_a_user_changes_it(page: Page, sent: list[Any]) -> None:
    kitchen, large = page.panel.scene.options
    assert not page.panel.plain.value
    choose(page, large)
    assert page.panel.plain.value
    _, sky = of_light(sent)
    assert sky.hdri_data is None
    assert page.server.scene.get_handle_by_name(SUN_NODE) is None
    page.panel.plain.value = False
    page.light.changed()
    _, sky = of_light(sent)[2:]
    assert len(sky.hdri_data) > 0
    assert page.server.scene.get_handle_by_name(SUN_NODE) is not None
    choose(page, kitchen)
    choose(page, large)
    assert page.panel.plain.value
    choose(page, kitchen)
    assert not page.panel.plain.value


def test_unchanged_light_is_not_sent_again(page: Page, sent: list[Any]) -> None:
    page.light.changed()
    page.light.of_room(KITCHEN)
    assert sent == []
    page.panel.plain.value = True
    page.light.changed()
    page.light.changed()
    assert len(of_light(sent)) == 2
    page.panel.plain.value = False
    page.light.changed()
    assert len(of_light(sent)) == 4


def test_a_motion_in_a_large_room_sends_only_poses(page: Page, sent: list[Any]) -> None:
    choose(page, page.panel.scene.options[1])
    page.scan.show(scan())
    page.place()
    assert page.work.wait(LONG)
    assert page.layers.wait(LONG)
    duration = page.motion.player.duration
    assert duration > 0
    page.motion.seek(0.0)
    sent.clear()
    page.motion.seek(0.0)
    assert drawn(sent) == []
    assert not any(kind(message) in MOVES for message in sent)
    for share in np.linspace(0.0, 1.0, 20)[1:]:
        page.motion.seek(share * duration)
    assert drawn(sent) == []
    moved = {message.name for message in sent if kind(message) in MOVES}
    assert "/robot" in moved
    assert len(moved) > 5  # the arm's links, and the door
    assert not any(name.startswith("/room/batch") for name in moved)
    page.scan.show(None)


def test_a_drag_in_a_large_room_sends_only_what_changes(page: Page, sent: list[Any]) -> None:
    choose(page, page.panel.scene.options[1])

    def drag(x: float, y: float) -> None:
        gizmo = page.robot._frame
        gizmo.position, gizmo.wxyz = (x, y, 0.0), (1.0, 0.0, 0.0, 0.0)
        page.follow.dragged(SimpleNamespace(target=gizmo))
        assert page.follow.work.wait(LONG)

    drag(0.9, -0.2)  # in the furniture
    assert page.room._marks
    sent.clear()
    page.follow.dragged(SimpleNamespace(target=page.robot._frame))
    assert page.follow.work.wait(LONG)
    assert sent  # the text
    assert drawn(sent) == []
    for k in range(6):
        drag(0.9 + 0.2 * k, -1.2)
    names = {name.rstrip("0123456789") for name in drawn(sent)}
    assert names
    assert names <= {"/robot/footprint", "/room/mark"}


def test_marks_are_not_drawn_twice(page: Page, sent: list[Any]) -> None:
    choose(page, page.panel.scene.options[0])
    page.room.mark(["oven", "table"])
    assert drawn(sent)
    sent.clear()
    page.room.mark(["table", "oven"])
    assert sent == []
    page.room.mark(["table"])
    assert drawn(sent)
    page.room.mark(())
    assert page.room._marks == []
