"""What a page set last all pages show, whichever messages met on the way."""

from __future__ import annotations

import threading
from types import SimpleNamespace
from typing import Any

import pytest

from momapos.apps.web.serve import open_server
from momapos.apps.web.settled import Settled, tell_pose, tell_value

LONG = 20.0


def control(uuid: str) -> Any:
    return SimpleNamespace(_impl=SimpleNamespace(uuid=uuid))


def test_of_many_changes_the_last_is_told_once(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[str] = []
    both = threading.Event()

    def tell(handle: Any) -> None:
        told.append(handle._impl.uuid)
        if len(set(told)) == 2:
            both.set()

    monkeypatch.setattr("momapos.apps.web.settled.tell_value", tell)
    settled = Settled(wait=0.3)
    for _ in range(5):
        settled.control(control("a"))
    settled.control(control("b"))
    assert both.wait(LONG)
    assert sorted(told) == ["a", "b"]
    settled.close()
    settled.control(control("c"))
    assert settled._timers == {}


def test_all_pages_are_told_what_the_server_knows(monkeypatch: pytest.MonkeyPatch) -> None:
    server = open_server("127.0.0.1", 0)
    try:
        box = server.gui.add_checkbox("box", True)
        node = server.scene.add_transform_controls("/node", position=(1.0, 2.0, 3.0))
        sent: list[Any] = []
        monkeypatch.setattr(server.gui._websock_interface, "queue_message", sent.append)
        monkeypatch.setattr(server.scene, "_queue_scene_message", sent.append)
        box.value = True  # viser says nothing, for nothing has changed
        assert sent == []
        tell_value(box)
        tell_pose(node)
        update, position, turn = sent
        assert update.updates == {"value": True}
        assert position.position == (1.0, 2.0, 3.0)
        assert turn.wxyz == (1.0, 0.0, 0.0, 0.0)
        monkeypatch.undo()
        box.remove()
        node.remove()
        monkeypatch.setattr(server.gui._websock_interface, "queue_message", sent.append)
        monkeypatch.setattr(server.scene, "_queue_scene_message", sent.append)
        tell_value(box)
        tell_pose(node)
        assert len(sent) == 3
    finally:
        server.stop()
