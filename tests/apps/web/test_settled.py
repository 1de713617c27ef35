"""All browsers show the last value that one of them has set."""

from __future__ import annotations

import threading
from types import SimpleNamespace
from typing import Any

import pytest

from momapos.apps.web.panel import Resender, send_pose, send_value
from momapos.apps.web.serve import open_server

LONG = 20.0


def control(uuid: str) -> Any:
    return SimpleNamespace(_impl=SimpleNamespace(uuid=uuid))


def test_many_changes_are_sent_once(monkeypatch: pytest.MonkeyPatch) -> None:
    shown: list[str] = []
    both = threading.Event()

    def tell(handle: Any) -> None:
        shown.append(handle._impl.uuid)
        if len(set(shown)) == 2:
            both.set()

    monkeypatch.setattr("momapos.apps.web.panel.send_value", tell)
    resender = Resender(wait=0.3)
    for _ in range(5):
        resender.control(control("a"))
    resender.control(control("b"))
    assert both.wait(LONG)
    assert sorted(shown) == ["a", "b"]
    resender.close()
    resender.control(control("c"))
    assert resender._timers == {}


def test_the_value_of_the_server_is_sent_to_all_browsers(monkeypatch: pytest.MonkeyPatch) -> None:
    server = open_server("127.0.0.1", 0)
    try:
        box = server.gui.add_checkbox("box", True)
        node = server.scene.add_transform_controls("/node", position=(1.0, 2.0, 3.0))
        sent: list[Any] = []
        monkeypatch.setattr(server.gui._websock_interface, "queue_message", sent.append)
        monkeypatch.setattr(server.scene, "_queue_scene_message", sent.append)
        box.value = True  # viser sends nothing without a change
        assert sent == []
        send_value(box)
        send_pose(node)
        update, position, turn = sent
        assert update.updates == {"value": True}
        assert position.position == (1.0, 2.0, 3.0)
        assert turn.wxyz == (1.0, 0.0, 0.0, 0.0)
        monkeypatch.undo()
        box.remove()
        node.remove()
        monkeypatch.setattr(server.gui._websock_interface, "queue_message", sent.append)
        monkeypatch.setattr(server.scene, "_queue_scene_message", sent.append)
        send_value(box)
        send_pose(node)
        assert len(sent) == 3
    finally:
        server.stop()
