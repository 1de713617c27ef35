"""Only what a user could do on the page reaches it, whatever a browser or a program sends."""

from __future__ import annotations

import logging
import math
import random
import time
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest
import viser
from benchmarks.hostile import hostile_frame
from tests.apps.web.pages import serve
from viser import _messages as messages
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from momapos.apps.web.page import Page
from momapos.apps.web.serve import LOG, MAX_BYTES, MessageGate, Server, accepts, quiet, small_png

LONG = 60.0
SPOKEN = Subprotocol(f"viser-v{viser.__version__}")
HUGE = 12345678901234567890


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Page, str]]:
    with serve(tmp_path_factory.mktemp("files")) as (page, address):
        assert page.work.wait(LONG)
        yield page, address


@pytest.fixture(scope="module")
def gate(site: tuple[Page, str]) -> MessageGate:
    gate = MessageGate()
    gate.server = site[0].server
    return gate


def frame(kind: str, **fields: Any) -> bytes:
    return msgspec.msgpack.encode({"type": kind, **fields})


def update(handle: Any, value: Any, name: str = "value") -> bytes:
    return frame("GuiUpdateMessage", uuid=handle._impl.uuid, updates={name: value})


def drag(*position: float, wxyz: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)) -> bytes:
    return frame("TransformControlsUpdateMessage", name="/robot", owner="", wxyz=wxyz,
                 position=position)  # fmt: skip


def test_a_control_takes_what_its_user_could_choose_and_nothing_else(
    site: tuple[Page, str], gate: MessageGate
) -> None:
    panel = site[0].panel
    right = [(panel.verb, "close"), (panel.slider, 45), (panel.slider, 45.5), (panel.seed, 7),
             (panel.plan_name, "a.json"), (panel.dark, True), (panel.place, True)]  # fmt: skip
    wrong = [
        (panel.verb, "eat"), (panel.verb, 1), (panel.scene, "/etc/passwd"), (panel.robot, "../x"),
        (panel.slider, 1e9), (panel.slider, "45"), (panel.slider, True), (panel.slider, None),
        (panel.seed, HUGE), (panel.seed, -1), (panel.seed, 0.5), (panel.seed, math.nan),
        (panel.plan_name, "a" * 300), (panel.plan_name, "a\x1b[2Jb"), (panel.plan_name, 3),
        (panel.dark, 1), (panel.dark, "yes"), (panel.place, "x"), (panel.stop, True),
    ]  # fmt: skip
    assert [gate.admits(update(*one)) for one in right] == [True] * len(right)
    assert [gate.admits(update(*one)) for one in wrong] == [False] * len(wrong)
    for name in ("label", "update_cb", "uuid", "__class__"):
        assert not gate.admits(update(panel.seed, 1, name))
    assert not gate.admits(frame("GuiUpdateMessage", uuid="gone", updates={"value": 1}))


def test_a_kind_of_control_that_the_page_does_not_have_takes_nothing() -> None:
    assert not accepts(SimpleNamespace(visible=True, disabled=False, value=1), 1)


@pytest.mark.parametrize(
    "raw",
    [
        b"", b"\xc1", b"\x80", "text", None,
        frame("FileTransferStartUpload", filename="a"), frame("ShareUrlRequest"),
        frame("RunJavascriptMessage", source="alert(1)"),
        frame("CommandTriggerMessage", uuid="no such command"),
        frame("CommandTriggerMessage"), frame("CommandTriggerMessage", uuid=3),
        frame("CommandTriggerMessage", uuid="x", more=1),
        frame("SceneNodeDragMessage", name="/robot", phase="start"),
        frame("TransformControlsUpdateMessage", name="/nothing", owner="",
              wxyz=(1, 0, 0, 0), position=(0, 0, 0)),
        b"\x91" * 100_000,
        b"x" * (MAX_BYTES + 1),
    ],
)  # fmt: skip
def test_other_messages_are_refused(gate: MessageGate, raw: object) -> None:
    refused = gate.refused
    assert not gate.admits(raw)
    assert gate.refused == refused + 1


def test_a_base_is_dragged_on_the_floor_only(site: tuple[Page, str], gate: MessageGate) -> None:
    page = site[0]
    before = np.array(page.robot._frame.position)
    turned = (math.cos(0.5), 0.0, 0.0, math.sin(0.5))
    assert gate.admits(drag(1.0, -1.0, 0.0, wxyz=turned))
    for position in ((math.nan, 0.0, 0.0), (0.0, 0.0, 1.0), (1e9, 0.0, 0.0), (0.0, 0.0)):
        assert not gate.admits(drag(*position))
    for wxyz in ((0.7, 0.7, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0), (9.0, 0.0, 0.0, 0.0)):
        assert not gate.admits(drag(1.0, -1.0, 0.0, wxyz=wxyz))
    np.testing.assert_array_equal(page.robot._frame.position, before)


def test_a_click_of_a_candidate_that_does_not_exist_is_ignored(
    site: tuple[Page, str], gate: MessageGate
) -> None:
    page = site[0]
    name = next(n for n in page.server.scene._handle_from_node_name if n.startswith("/room/o"))
    ray = {"ray_origin": (0, 0, 2), "screen_pos": (0.5, 0.5), "modifier": None, "owner": ""}
    for index, direction, right in (
        (None, (0, 0, -1), True), (3, (0, 0, -1), True), (-1, (0, 0, -1), False),
        (10**9, (0, 0, -1), False), (None, (0, 0, 0), False), (None, (0, math.inf, 0), False),
    ):  # fmt: skip
        raw = frame("SceneNodeClickMessage", name=name, instance_index=index,
                    ray_direction=direction, **ray)  # fmt: skip
        assert gate.admits(raw) is right


def test_an_image_is_a_png_of_bounded_size(gate: MessageGate) -> None:
    def head(width: int, height: int) -> bytes:
        sides = width.to_bytes(4, "big") + height.to_bytes(4, "big")
        return b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR" + sides

    assert small_png(head(1280, 720))
    assert not any(map(small_png, (b"", head(1280, 720)[:20], head(2**31 - 1, 9), head(0, 5))))
    large = frame("GetRenderResponseMessage", payload=head(64, 64) + b"x" * 10**6, render_uuid="a")
    assert gate.admits(large)
    other = frame("CommandTriggerMessage", uuid="GetRenderResponseMessage" + "x" * 10**6)
    assert not gate.admits(other)


def test_twenty_digits_in_a_number_field_change_nothing_and_are_corrected(
    site: tuple[Page, str], gate: MessageGate, monkeypatch: pytest.MonkeyPatch
) -> None:
    page, sent = site[0], []
    queue = page.server.gui._websock_interface.queue_message
    monkeypatch.setattr(page.server.gui._websock_interface, "queue_message",
                        lambda message: (sent.append(message), queue(message))[1])  # fmt: skip
    assert not gate.admits(update(page.panel.seed, HUGE))
    (correction,) = sent
    assert isinstance(correction, messages.GuiUpdateMessage)
    assert correction.updates == {"value": 0}
    assert correction.excluded_self_client is None
    assert page.choice.question.seed == 0


def test_the_server_passes_only_admitted_messages_to_viser(site: tuple[Page, str]) -> None:
    page, address = site
    with connect(address.replace("http", "ws"), subprotocols=[SPOKEN]) as line:
        for raw in (update(page.panel.seed, HUGE), update(page.panel.seed, 5)):
            line.send(raw)
        ends = time.monotonic() + LONG
        while page.panel.seed.value == 0 and time.monotonic() < ends:
            time.sleep(0.02)
    assert page.panel.seed.value == 5
    page.panel.seed.value = 0
    page.change()
    assert page.work.wait(LONG)


def test_a_program_of_another_version_is_refused_without_a_word(
    site: tuple[Page, str], capsys: pytest.CaptureFixture[str]
) -> None:
    for spoken in (None, [Subprotocol("viser-v0.0.1"), SPOKEN]):
        with pytest.raises(InvalidStatus) as refused:
            connect(site[1].replace("http", "ws"), subprotocols=spoken)
        assert refused.value.response.status_code == 400
    assert capsys.readouterr() == ("", "")


def test_hostile_messages_leave_no_traceback_and_the_page_goes_on_planning(
    site: tuple[Page, str], capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    page, address = site
    rng = random.Random(3)
    ids = [*page.server.gui._gui_input_handle_from_uuid]
    names = [*page.server.scene._handle_from_node_name]
    asyncio_log = logging.getLogger("asyncio")
    with connect(address.replace("http", "ws"), subprotocols=[SPOKEN], max_size=None) as line:
        for _ in range(600):
            line.send(hostile_frame(rng, ids, names))
        line.send(update(page.panel.seed, 77))
        ends = time.monotonic() + LONG
        while page.panel.seed.value != 77 and time.monotonic() < ends:  # all are read
            time.sleep(0.02)
    for handle in page.panel.question:
        value = handle.value
        if hasattr(handle, "options"):
            assert value in handle.options
    for _ in range(9):  # the last right ones, such as Stop, may still act
        page.panel.verb.value, page.panel.target.value = "open", "fridge/door_hinge"
        page.start_of_scene()
        assert page.work.wait(LONG)
        page.place()
        assert page.work.wait(LONG)
        if page.panel.card.shown.headline == "Solved":
            break
    assert page.panel.card.shown.headline == "Solved"
    output = capsys.readouterr()
    assert "Traceback" not in output.err + output.out
    traced = [r for r in caplog.records if r.exc_info and r.name in (asyncio_log.name, LOG.name)]
    assert traced == []


def test_bytes_that_are_no_request_leave_no_traceback(
    caplog: pytest.LogCaptureFixture, capsys: pytest.CaptureFixture[str]
) -> None:
    import socket

    from momapos.apps.web.serve import open_server

    server: Server = open_server("127.0.0.1", 0)
    for content in (b"\x00\xff\xfe\r\n\r\n", b"GET /" + b"a" * 20_000 + b"\r\n\r\n", b"\r\n"):
        with socket.create_connection(("127.0.0.1", server.get_port())) as line:
            line.sendall(content)
            line.shutdown(socket.SHUT_WR)
            line.settimeout(LONG)
            try:
                while line.recv(1000):
                    pass
            except ConnectionError:
                pass
    with quiet():
        server.stop()
    assert not any(record.exc_info for record in caplog.records)
    assert "Traceback" not in "".join(capsys.readouterr())
