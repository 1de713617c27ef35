"""The page is served on this machine only, and errors are reported in one line."""

from __future__ import annotations

import asyncio
import socket
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from tests.apps.web.pages import serve
from tests.commands import error_of
from viser import _messages as messages
from viser.infra import ClientId

from momapos.apps.cli.main import main
from momapos.apps.web.page import Page
from momapos.apps.web.playback import Player
from momapos.apps.web.question import VERBS, RobotLoader, targets
from momapos.apps.web.serve import check_free, open_server, quiet
from momapos.apps.web.static import check_page
from momapos.core.cache import USER_CACHE
from momapos.core.errors import InputError
from momapos.model.scene.scene import Scene

LONG = 60.0


@pytest.fixture
def busy_port() -> Iterator[int]:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        yield taken.getsockname()[1]


def test_a_port_in_use_is_reported_in_one_line(
    busy_port: int, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["view", "--port", str(busy_port)]) == 2
    assert (
        capsys.readouterr()
        .err.strip()
        .endswith(f"port {busy_port} is in use; choose another one, or 0 for a free one")
    )


@pytest.mark.parametrize(("host", "port"), [("no.such.host.invalid", 0), ("127.0.0.1", 70000)])
def test_an_invalid_address_is_refused(host: str, port: int) -> None:
    with pytest.raises(InputError):
        check_free(host, port)


def test_an_address_of_another_machine_is_reported() -> None:
    with pytest.raises(InputError, match=r"host 192\.0\.2\.1: not an address of this machine"):
        check_free("192.0.2.1", 0)


def test_a_server_opens_no_tunnel_to_the_outside() -> None:
    server = open_server("127.0.0.1", 0)
    try:
        assert server.request_share_url() is None
        assert server.get_host() == "127.0.0.1"
    finally:
        server.stop()


def test_uploads_are_refused() -> None:
    server = open_server("127.0.0.1", 0)
    gui = server.gui
    start = messages.FileTransferStartUpload(
        gui.add_text("Name", "")._impl.uuid, "transfer", "a.bin", "", 2, 10**12
    )
    part = messages.FileTransferPart("", "transfer", 0, b"x" * 1000)
    for message in (start, part):
        asyncio.run(gui._websock_interface._handle_incoming_message(ClientId(0), message))
    assert gui._current_file_upload_states == {}
    with quiet():
        server.stop()


def test_a_page_is_written_only_for_a_plan(tmp_path: Path) -> None:
    assert "--static needs a plan" in error_of(
        "view", "kitchen_small", "--static", str(tmp_path / "page.html")
    )
    with pytest.raises(InputError, match="unsupported page format"):
        check_page(tmp_path / "page.png")


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    """A page without browsers, with a valid and a damaged scene."""
    folder = tmp_path_factory.mktemp("page")
    damaged = folder / "damaged.json"
    damaged.write_text('{"format": "momapos-scene", "version": 1, "name": "x", "objects": [{}]}')
    with serve(folder, str(damaged)) as (page, _):
        assert page.work.wait(LONG)
        yield page


def test_a_damaged_scene_is_reported_on_page_and_terminal_and_the_page_survives(
    page: Page, caplog: pytest.LogCaptureFixture
) -> None:
    good, damaged = page.panel.scene.options
    page.panel.scene.value = damaged
    page.change()
    assert page.work.wait(LONG)
    assert page.panel.card.shown.headline == "Error"
    assert "damaged" in page.panel.card.text
    (line,) = caplog.messages
    assert line.startswith(f"momapos: {damaged}")
    assert "\n" not in line
    page.panel.scene.value = good
    page.change()
    assert page.work.wait(LONG)
    assert "Press Place" in page.panel.card.text


def test_an_invalid_task_is_reported_on_the_page(page: Page) -> None:
    page.panel.show_to("400deg")
    page.place()
    assert page.work.wait(LONG)
    assert "outside its limits" in page.panel.card.text
    page.panel.show_to("")


def test_work_is_canceled_without_browsers(page: Page) -> None:
    begun = threading.Event()

    def endless(clock: Callable[[], float]) -> None:
        begun.set()
        while True:
            clock()

    page.work.put(endless)
    assert begun.wait(LONG)
    page.browsers._on_empty()
    assert page.work.wait(LONG)


def test_an_answer_stays_with_its_question(page: Page) -> None:
    for k in range(6):
        page.panel.target.value = ("fridge/door_hinge", "microwave/door_hinge")[k % 2]
        page.place()
    assert page.work.wait(LONG)
    answer = page.shown.answer
    assert answer.plan.task.object == "microwave"
    assert page.panel.target.value == "microwave/door_hinge"


def test_every_verb_has_targets(kitchen: Scene) -> None:
    for verb in VERBS:
        assert targets(kitchen, verb)
    assert targets(kitchen, "open")[0] == "fridge/door_hinge"
    assert "wall_back" not in targets(kitchen, "pick")


def test_a_player_stops_at_the_end_and_plays_again_from_the_beginning() -> None:
    shown: list[float] = []
    ended = threading.Event()

    def show(seconds: float, playing: bool) -> None:
        shown.append(seconds)
        if not playing and seconds >= 0.2:
            ended.set()

    player = Player(show)
    player.load(0.2)
    for _ in range(2):
        ended.clear()
        player.play()
        assert ended.wait(LONG)
        assert not player.playing
    assert shown[-1] == pytest.approx(0.2)
    assert (np.diff(shown) < 0).sum() == 1
    player.seek(9.0)
    assert player.now == pytest.approx(0.2)


def test_a_robot_is_loaded_once() -> None:
    loader = RobotLoader(USER_CACHE)

    def report(what: str, share: float) -> None:
        assert what
        assert 0.0 <= share <= 1.0

    first = loader.load("segway_ur5e", "any", time.perf_counter, report)
    loader.load("fetch", "any", time.perf_counter, report)
    assert loader.load("segway_ur5e", "any", time.perf_counter, report) is first
