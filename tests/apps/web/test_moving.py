"""Slow browsers draw a scan coarsely while the view moves."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from viser import ClientHandle, ViserServer

from momapos.apps.web import playback
from momapos.apps.web.playback import (
    FRAME_GAPS,
    NEW_MOVEMENT_TIME,
    REST_TIME,
    SAME_FRAME_TIME,
    SLOW_FRAME_TIME,
    SLOW_FRAMES,
    BrowserDetail,
    DetailControl,
    FrameTimer,
)


class Loop:
    """An event loop with a simulated clock."""

    def __init__(self) -> None:
        self.now = 100.0
        self.calls: list[list[Any]] = []
        self.asyncio = Mock(asyncio.AbstractEventLoop, time=self.time, call_later=self.call_later)

    def time(self) -> float:
        return self.now

    def call_later(self, after: float, call: Callable[[], None]) -> Any:
        entry = [self.now + after, call]
        self.calls.append(entry)

        class Handle:
            def cancel(inner) -> None:
                entry[1] = None

        return Handle()

    def go(self, seconds: float) -> None:
        """Advance the clock [s]."""
        self.now += seconds
        due = [entry for entry in self.calls if entry[0] <= self.now]
        self.calls = [entry for entry in self.calls if entry[0] > self.now]
        for _, call in due:
            if call is not None:
                call()


class Browser:
    """A browser with a movable camera, and a record of what it is commanded to show."""

    def __init__(self) -> None:
        self.loop, self.shown, self.wanted = Loop(), [], True  # type: ignore[var-annotated]
        self.detail = BrowserDetail(self.shown.append, lambda: self.wanted)

    def move(self, frames: int, gap: float) -> None:
        """Move the camera for some frames with a frame time [s]."""
        for _ in range(frames):
            self.loop.go(gap)
            self.detail.camera_moved(self.loop.asyncio)


@pytest.fixture
def browser() -> Browser:
    return Browser()


def test_a_fast_browser_always_shows_all_points(browser: Browser) -> None:
    for gap in (0.004, 0.017, 0.04, 0.1):
        browser.move(200, gap)
    assert browser.shown == []


def test_a_slow_browser_shows_few_points_while_its_camera_moves_and_all_at_rest(
    browser: Browser,
) -> None:
    browser.move(FRAME_GAPS, 0.3)
    assert browser.shown == []  # not measured yet
    browser.move(1, 0.3)
    assert browser.shown == [True]
    browser.move(100, 0.08)  # faster now
    assert browser.shown == [True]
    browser.loop.go(REST_TIME + 0.01)
    assert browser.shown == [True, False]
    browser.loop.go(10.0)
    browser.move(1, 0.0)
    assert browser.shown == [True, False, True]  # at once, as it is known to be slow


def test_a_slow_browser_shows_few_points_while_something_else_moves(browser: Browser) -> None:
    loop = browser.loop
    browser.detail.scene_moved(loop.asyncio)
    assert browser.shown == []  # not known to be slow
    browser.move(FRAME_GAPS + 1, 0.3)
    loop.go(REST_TIME + 1.0)
    assert browser.shown == [True, False]
    for _ in range(50):
        loop.go(0.04)
        browser.detail.scene_moved(loop.asyncio)
    assert browser.shown == [True, False, True]
    loop.go(2 * REST_TIME)
    assert browser.shown == [True, False, True, False]


def test_a_slow_browser_is_measured_again_after_a_while(browser: Browser) -> None:
    browser.move(FRAME_GAPS + 1, 0.2)
    browser.loop.go(SLOW_FRAMES * 0.2 + 1.0)
    assert browser.shown == [True, False]
    browser.move(100, 0.02)
    assert browser.shown == [True, False]
    browser.move(FRAME_GAPS + 1, 0.2)
    assert browser.shown == [True, False, True]


def test_a_camera_does_not_rest_between_two_slow_frames(browser: Browser) -> None:
    browser.move(20, 1.5)
    assert browser.shown == [True]
    browser.loop.go(2.9)
    assert browser.shown == [True]
    browser.loop.go(0.2)
    assert browser.shown == [True, False]


def test_a_pause_of_the_hand_is_not_a_slow_frame(browser: Browser) -> None:
    for pause in (0.5, 2.0, 20.0):
        for _ in range(20):
            browser.move(6, 0.02)
            browser.loop.go(pause)
    assert browser.shown == []
    for _ in range(20):  # nor is a camera that moves once in a while
        browser.move(1, NEW_MOVEMENT_TIME + 1.0)
    assert browser.shown == []


def test_two_messages_in_one_frame_do_not_make_a_browser_fast(browser: Browser) -> None:
    for _ in range(FRAME_GAPS + 1):
        browser.move(1, 2 * SLOW_FRAME_TIME)
        browser.move(1, SAME_FRAME_TIME / 2)
    assert browser.shown == [True]


def test_nothing_is_sent_if_there_is_nothing_to_draw_coarsely(browser: Browser) -> None:
    browser.wanted = False
    browser.move(30, 0.5)
    assert browser.shown == []
    browser.wanted = True
    browser.move(1, 0.5)
    assert browser.shown == [True]
    browser.wanted = False
    browser.loop.go(2.0)
    assert browser.shown == [True, False]  # hidden points are shown again


def test_nothing_is_sent_to_a_disconnected_browser(browser: Browser) -> None:
    browser.move(10, 0.5)
    browser.detail.close()
    browser.loop.go(10.0)
    assert browser.shown == [True]


def test_only_the_browser_whose_camera_moves_is_switched(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(playback, "SLOW_FRAME_TIME", -1.0)
    monkeypatch.setattr(playback, "SAME_FRAME_TIME", 0.0)
    monkeypatch.setattr(playback, "REST_TIME", 0.0)
    came: list[Any] = []
    went: list[Any] = []
    loop = asyncio.new_event_loop()
    server = Mock(
        ViserServer, on_client_connect=came.append, on_client_disconnect=went.append,
        get_event_loop=lambda: loop,
    )  # fmt: skip
    DetailControl(server, fine="/fine", coarse="/coarse", wanted=lambda: True)

    def client(number: int) -> Any:
        sent: asyncio.Queue[Any] = asyncio.Queue()
        cameras: list[Any] = []
        return Mock(
            ClientHandle, client_id=number, sent=sent, cameras=cameras, atomic=nullcontext,
            camera=SimpleNamespace(on_update=cameras.append),
            _websock_connection=SimpleNamespace(queue_message=sent.put_nowait),
        )  # fmt: skip

    async def meet() -> None:
        one, other = client(1), client(2)
        for each in (one, other):
            await came[0](each)
        for _ in range(FRAME_GAPS + 1):
            await one.cameras[0](None)
        messages = [await asyncio.wait_for(one.sent.get(), 60.0) for _ in range(4)]
        assert [(m.name, m.visible, m.owner) for m in messages] == [
            ("/fine", False, ""), ("/coarse", True, ""),
            ("/fine", True, ""), ("/coarse", False, ""),
        ]  # fmt: skip
        assert other.sent.empty()
        await went[0](one)

    loop.run_until_complete(meet())
    loop.close()


def test_the_frame_time_is_the_shortest_of_the_last_intervals() -> None:
    timer, rng = FrameTimer(), np.random.default_rng(0)
    gaps = rng.uniform(2 * SAME_FRAME_TIME, 2 * SLOW_FRAME_TIME, 200)
    for k, now in enumerate(np.cumsum(gaps)):
        timer.camera_moved(float(now))
        if k >= FRAME_GAPS:
            assert timer.gap == pytest.approx(gaps[k - FRAME_GAPS + 1 : k + 1].min())
