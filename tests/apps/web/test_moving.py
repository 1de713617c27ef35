"""What takes long to draw is drawn coarsely where a camera moves and pictures come slowly."""

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

from momapos.apps.web import moving
from momapos.apps.web.moving import APART, GAPS, REST, SLOW, TOGETHER, TRUST, Look, Moving, Pace


class Loop:
    """A loop whose time is told."""

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
        """Let time go by."""
        self.now += seconds
        due = [entry for entry in self.calls if entry[0] <= self.now]
        self.calls = [entry for entry in self.calls if entry[0] > self.now]
        for _, call in due:
            if call is not None:
                call()


class Browser:
    """What a browser is told to show, and a camera that can be moved."""

    def __init__(self) -> None:
        self.loop, self.told, self.wanted = Loop(), [], True  # type: ignore[var-annotated]
        self.look = Look(self.told.append, lambda: self.wanted)

    def move(self, pictures: int, gap: float) -> None:
        """Move the camera; so many pictures are drawn, so far apart."""
        for _ in range(pictures):
            self.loop.go(gap)
            self.look.moved(self.loop.asyncio)


@pytest.fixture
def browser() -> Browser:
    return Browser()


def test_a_quick_browser_shows_all_however_long_its_camera_moves(browser: Browser) -> None:
    for gap in (0.004, 0.017, 0.04, 0.1):
        browser.move(200, gap)
    assert browser.told == []


def test_a_slow_browser_shows_few_points_while_its_camera_moves_and_all_at_rest(
    browser: Browser,
) -> None:
    browser.move(GAPS, 0.3)
    assert browser.told == []  # it is not known yet
    browser.move(1, 0.3)
    assert browser.told == [True]
    browser.move(100, 0.08)  # it is quicker now
    assert browser.told == [True]
    browser.loop.go(REST + 0.01)
    assert browser.told == [True, False]
    browser.loop.go(10.0)
    browser.move(1, 0.0)
    assert browser.told == [True, False, True]  # at once this time


def test_a_slow_browser_shows_few_points_while_something_else_moves(browser: Browser) -> None:
    loop = browser.loop
    browser.look.stirred(loop.asyncio)
    assert browser.told == []  # nobody knows that it is slow
    browser.move(GAPS + 1, 0.3)
    loop.go(REST + 1.0)
    assert browser.told == [True, False]
    for _ in range(50):
        loop.go(0.04)
        browser.look.stirred(loop.asyncio)
    assert browser.told == [True, False, True]
    loop.go(2 * REST)
    assert browser.told == [True, False, True, False]


def test_a_browser_is_found_slow_anew_after_a_while(browser: Browser) -> None:
    browser.move(GAPS + 1, 0.2)
    browser.loop.go(TRUST * 0.2 + 1.0)
    assert browser.told == [True, False]
    browser.move(100, 0.02)
    assert browser.told == [True, False]
    browser.move(GAPS + 1, 0.2)
    assert browser.told == [True, False, True]


def test_a_camera_does_not_rest_between_two_slow_pictures(browser: Browser) -> None:
    browser.move(20, 1.5)
    assert browser.told == [True]
    browser.loop.go(2.9)
    assert browser.told == [True]
    browser.loop.go(0.2)
    assert browser.told == [True, False]


def test_a_pause_of_the_hand_is_no_slow_picture(browser: Browser) -> None:
    for pause in (0.5, 2.0, 20.0):
        for _ in range(20):
            browser.move(6, 0.02)
            browser.loop.go(pause)
    assert browser.told == []
    for _ in range(20):  # nor is a camera that is set now and then
        browser.move(1, APART + 1.0)
    assert browser.told == []


def test_what_is_told_twice_of_a_picture_does_not_make_a_browser_quick(browser: Browser) -> None:
    for _ in range(GAPS + 1):
        browser.move(1, 2 * SLOW)
        browser.move(1, TOGETHER / 2)
    assert browser.told == [True]


def test_where_there_is_nothing_to_be_drawn_coarsely_nothing_is_told(browser: Browser) -> None:
    browser.wanted = False
    browser.move(30, 0.5)
    assert browser.told == []
    browser.wanted = True
    browser.move(1, 0.5)
    assert browser.told == [True]
    browser.wanted = False
    browser.loop.go(2.0)
    assert browser.told == [True, False]  # what was hidden is shown again


def test_a_browser_that_has_gone_is_told_nothing(browser: Browser) -> None:
    browser.move(10, 0.5)
    browser.look.close()
    browser.loop.go(10.0)
    assert browser.told == [True]


def test_only_the_browser_whose_camera_moves_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(moving, "SLOW", -1.0)
    monkeypatch.setattr(moving, "TOGETHER", 0.0)
    monkeypatch.setattr(moving, "REST", 0.0)
    came: list[Any] = []
    went: list[Any] = []
    loop = asyncio.new_event_loop()
    server = Mock(
        ViserServer, on_client_connect=came.append, on_client_disconnect=went.append,
        get_event_loop=lambda: loop,
    )  # fmt: skip
    Moving(server, fine="/fine", coarse="/coarse", wanted=lambda: True)

    def client(number: int) -> Any:
        told: asyncio.Queue[Any] = asyncio.Queue()
        cameras: list[Any] = []
        return Mock(
            ClientHandle, client_id=number, told=told, cameras=cameras, atomic=nullcontext,
            camera=SimpleNamespace(on_update=cameras.append),
            _websock_connection=SimpleNamespace(queue_message=told.put_nowait),
        )  # fmt: skip

    async def meet() -> None:
        one, other = client(1), client(2)
        for each in (one, other):
            await came[0](each)
        for _ in range(GAPS + 1):
            await one.cameras[0](None)
        messages = [await asyncio.wait_for(one.told.get(), 60.0) for _ in range(4)]
        assert [(m.name, m.visible, m.owner) for m in messages] == [
            ("/fine", False, ""), ("/coarse", True, ""),
            ("/fine", True, ""), ("/coarse", False, ""),
        ]  # fmt: skip
        assert other.told.empty()
        await went[0](one)

    loop.run_until_complete(meet())
    loop.close()


def test_the_time_between_pictures_is_the_shortest_of_the_last() -> None:
    pace, rng = Pace(), np.random.default_rng(0)
    gaps = rng.uniform(2 * TOGETHER, 2 * SLOW, 200)
    for k, now in enumerate(np.cumsum(gaps)):
        pace.moved(float(now))
        if k >= GAPS:
            assert pace.gap == pytest.approx(gaps[k - GAPS + 1 : k + 1].min())
