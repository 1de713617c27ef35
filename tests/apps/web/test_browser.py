"""The page in a real Chromium: plan, drag, play, reload, and use it in two tabs."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, ConsoleMessage, Error, Locator, expect, sync_playwright
from playwright.sync_api import Page as Tab
from playwright.sync_api import TimeoutError as NotInTime
from tests import optional
from tests.apps.web.pages import serve
from viser.transforms import SO3

from momapos.apps.web import playback
from momapos.apps.web.page import Page
from momapos.apps.web.playback import Moment, Story
from momapos.apps.web.scan_view import COARSE_POINTS
from momapos.apps.web.static import write_page
from momapos.core.errors import escape_markdown
from momapos.model.records.scans import Cloud
from momapos.perception.records import Modeled

pytestmark = [pytest.mark.slow, optional.needs("Chromium", optional.chromium() is not None)]
LONG = 120_000.0
"""Longer than anything on the page takes with a software renderer [ms]."""
SLOW = 0.05
"""Playback speed at which even a slow machine can pause before the end [-]."""
SIZE = {"width": 820, "height": 520}
SMALL = {"width": 620, "height": 240}
"""Window in which only the controls are used: a software renderer's time grows with its pixels."""
FLAGS = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
         "--no-sandbox"]  # fmt: skip


WATCH_POINTS = """() => {
  window.clouds = [];
  const gl = WebGL2RenderingContext.prototype, draw = gl.drawArrays;
  gl.drawArrays = function (mode, first, count) {
    if (mode === gl.POINTS) window.clouds.push(count);
    return draw.call(this, mode, first, count);
  };
}"""
"""Makes a page record the number of points of each cloud that it draws."""


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=optional.chromium(), args=FLAGS)
        yield chromium
        chromium.close()


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Page, str]]:
    with serve(tmp_path_factory.mktemp("files")) as (page, address):
        # Shadows take most of a software renderer's time.
        page.panel.plain.value = True
        page.light.changed()
        yield page, address


@pytest.fixture
def errors() -> list[str]:
    return []


@pytest.fixture
def opened(browser: Browser, errors: list[str]) -> Iterator[Callable[[str], Tab]]:
    """Return a function that opens a tab and records the errors on its console."""
    tabs: list[Tab] = []

    def record(message: ConsoleMessage) -> None:
        if message.type == "error":
            errors.append(message.text)

    def open_tab(address: str) -> Tab:
        tab = browser.new_page(viewport=SMALL)  # type: ignore[arg-type]
        tab.on("console", record)
        tab.on("pageerror", lambda error: errors.append(str(error)))
        tab.goto(address)
        tabs.append(tab)
        return tab

    yield open_tab
    for tab in tabs:
        tab.close()


def until(true: Callable[[], bool], timeout: float = LONG / 1000) -> bool:
    """Wait for a condition on the server, at most for a time [s]."""
    ends = time.monotonic() + timeout
    while not (reached := true()) and time.monotonic() < ends:
        time.sleep(0.02)
    return reached


def press(tab: Tab, role: Any, name: str) -> None:
    """Click a control without waiting until it is stable, which is slow in software."""
    found = tab.get_by_role(role, name=name, exact=True)
    found.wait_for(timeout=LONG)
    tried = time.monotonic()
    while not clicked(found) or (role == "tab" and found.get_attribute("aria-selected") != "true"):
        # The page may move a tab between the mouse and the click.
        if time.monotonic() - tried > LONG / 1000:
            raise NotInTime(f"the {role} {name!r} does not react")
        tab.wait_for_timeout(200)


def clicked(found: Locator) -> bool:
    """Click a control; return False if it is still outside of the viewport."""
    try:
        found.click(force=True, timeout=LONG)
    except Error as error:
        if "outside of the viewport" not in error.message:
            raise
        return False
    return True


def choose(tab: Tab, name: str, value: str) -> None:
    """Choose a value from a list, which closes again if the page is redrawn meanwhile."""
    option = tab.get_by_role("option", name=value, exact=True)
    tried = time.monotonic()
    while True:
        clicked(tab.get_by_label(name, exact=True))
        try:
            option.click(force=True, timeout=LONG / 12)
            return
        except NotInTime:
            if time.monotonic() - tried > LONG / 1000:
                raise


def drawn(tab: Tab) -> None:
    """Wait until a tab has drawn all that it has received."""
    tab.evaluate(
        "() => new Promise(done => { let left = 3; const next = () => "
        "left-- ? requestAnimationFrame(next) : done(); next(); })"
    )


def pixel(camera: Any, point: np.ndarray) -> tuple[float, float]:
    """Project a point of the world to a browser's window [px]."""
    x, y, z = SO3(camera.wxyz).as_matrix().T @ (point - camera.position)
    width, height = SIZE["width"], SIZE["height"]
    scale = height / 2 / math.tan(camera.fov / 2)
    return width / 2 + scale * x / z, height / 2 + scale * y / z


def ahead(page: Page, distance: float) -> np.ndarray:
    """Return a point on the forward arrow of the drag handle [m]."""
    x, y, yaw = page.robot.base
    return np.array([x + distance * math.cos(yaw), y + distance * math.sin(yaw), 0.0])


def pick_in_the_view(page: Page, tab: Tab) -> None:
    """Click two objects, at points that nothing else covers."""
    scene = page.shown.scene
    tab.set_viewport_size(SIZE)  # type: ignore[arg-type]
    (client,) = page.server.get_clients().values()
    assert until(lambda: client.camera.image_height == SIZE["height"])
    warning = tab.locator(".mantine-Notification-closeButton")  # without a graphics card
    while warning.count():
        with suppress(NotInTime):  # it also closes by itself
            warning.first.click(force=True, timeout=2_000)
        tab.wait_for_timeout(500)
    drawn(tab)
    for name in ("microwave", "fridge"):
        low, high = scene.object(name).bounds
        tab.mouse.move(*pixel(client.camera, np.append((low + high)[:2] / 2, high[2])))
        for act in (tab.mouse.down, tab.mouse.up):
            drawn(tab)  # the page must have found the object under the mouse
            act()
        assert until(lambda name=name: page.panel.target.value.startswith(f"{name}/"))  # type: ignore[misc]
        assert page.work.wait(LONG / 1000)
    tab.set_viewport_size(SMALL)  # type: ignore[arg-type]
    drawn(tab)  # the controls have moved


def test_a_user_plans_drags_plays_and_reloads(
    site: tuple[Page, str], opened: Callable[[str], Tab], errors: list[str]
) -> None:
    page, address = site
    tab = opened(address)
    tab.get_by_text("Press Place").wait_for(timeout=LONG)
    pick_in_the_view(page, tab)
    other = opened(address)
    press(tab, "button", "Place")
    for one in (tab, other):  # both see the answer
        one.get_by_text("Solved").wait_for(timeout=LONG)
    answer = page.shown.answer
    assert answer.plan.task.object == "fridge"
    np.testing.assert_allclose(page.robot.base, answer.plan.base_pose)

    other.close()
    before = page.robot.base.copy()
    assert until(lambda: len(page.server.get_clients()) == 1)
    (client,) = page.server.get_clients().values()
    tab.set_viewport_size(SIZE)  # type: ignore[arg-type]
    places = [pixel(client.camera, ahead(page, d)) for d in np.linspace(0.7, 1.4, 40)]
    drawn(tab)
    tab.mouse.move(*places[0])
    drawn(tab)
    tab.mouse.down()
    drawn(tab)
    for place in places:  # the page sends the dragged pose a few times a second
        tab.mouse.move(*place)
        if until(lambda: np.linalg.norm(page.robot.base[:2] - before[:2]) > 0.1, 0.25):
            break
    tab.mouse.up()
    assert np.linalg.norm(page.robot.base[:2] - before[:2]) > 0.1

    tab.set_viewport_size(SMALL)  # type: ignore[arg-type]
    tab.reload()
    tab.get_by_text("answered in").wait_for(timeout=LONG)  # the same state as before
    press(tab, "button", "Place")
    tab.get_by_text("Solved").wait_for(timeout=LONG)
    page.motion.set_speed(SLOW)
    press(tab, "button", "Play")
    assert until(lambda: 0.0 < page.motion.player.now < page.motion.player.duration)
    press(tab, "button", "Pause")
    assert until(lambda: not page.motion.player.playing)
    page.motion.set_speed(1.0)
    assert len(tab.screenshot()) > 10_000
    assert errors == []


def look_at_a_candidate(page: Page, client: Any) -> np.ndarray:
    """Turn a browser's camera to a candidate that nothing covers; return its position [m]."""
    scene, above = page.shown.scene, np.array([0.0, -0.5, 1.5])
    node = page.server.scene.get_handle_by_name("/layers/candidates/all")
    points = np.array(node.batched_positions)  # type: ignore[union-attr]
    objects = np.array([item.bounds for item in scene.objects])
    objects += [[-0.3, -0.3, 0.0], [0.3, 1.0, 0.0]]  # what they cover, seen from there
    free = (scene.floor_polygon.min(0) < points[:, :2]) & (
        points[:, :2] < scene.floor_polygon.max(0)
    )
    over = (points[:, None, :2] > objects[None, :, 0, :2]) & (
        points[:, None, :2] < objects[None, :, 1, :2]
    )
    away = np.linalg.norm(points[:, :2] - page.robot.base[:2], axis=1) > 0.8
    (point, *_) = points[free.all(1) & ~over.all(2).any(1) & away]
    client.camera.position, client.camera.look_at = point + above, point
    middle = np.array([SIZE["width"], SIZE["height"]]) / 2
    assert until(lambda: bool(np.abs(np.array(pixel(client.camera, point)) - middle).max() < 3))
    return np.array(point)


def test_a_clicked_candidate_shows_its_outcome_and_the_speed_can_be_chosen(
    site: tuple[Page, str], opened: Callable[[str], Tab], errors: list[str]
) -> None:
    page, address = site
    page.place()
    assert page.work.wait(LONG / 1000)
    answer = page.shown.answer
    tab = opened(address)
    choose(tab, "Speed", "4")
    assert until(lambda: page.motion.player.speed == 4.0)
    page.panel.speed.value = "1"
    page.motion.set_speed(1.0)

    press(tab, "tab", "Layers")
    tab.get_by_label("Candidates", exact=True).click(force=True)
    assert until(lambda: "candidates" in page.layers.drawn)
    assert until(lambda: len(page.server.get_clients()) == 1)
    (client,) = page.server.get_clients().values()
    tab.set_viewport_size(SIZE)  # type: ignore[arg-type]
    assert until(lambda: client.camera.image_height == SIZE["height"])
    drawn(tab)
    point = look_at_a_candidate(page, client)
    drawn(tab)
    tab.mouse.move(*pixel(client.camera, point))
    for act in (tab.mouse.down, tab.mouse.up):
        drawn(tab)
        act()
    assert until(lambda: bool(page.panel.clicked.content))
    every = [outcome for block in answer.search.outcomes for outcome in block]
    away = np.linalg.norm(np.concatenate(answer.search.poses)[:, :2] - point[:2], axis=1)
    reasons = {escape_markdown(str(every[k])) for k in np.flatnonzero(away < 0.1)}
    assert page.panel.clicked.content in {f"This candidate: **{words}**" for words in reasons}
    tab.get_by_text("This candidate:").wait_for(timeout=LONG)
    tab.get_by_label("Candidates", exact=True).click(force=True)
    assert until(lambda: not page.panel.layers["candidates"].value)
    assert errors == []


def test_two_tabs_act_on_one_state(
    site: tuple[Page, str], opened: Callable[[str], Tab], errors: list[str]
) -> None:
    page, address = site
    page.motion.set_speed(SLOW)
    one, two = opened(address), opened(address)
    for tab in (one, two):
        tab.get_by_text("Solved").wait_for(timeout=LONG)
    press(one, "button", "Play")
    two.get_by_role("button", name="Pause", exact=True).wait_for(timeout=LONG)
    two.keyboard.press("k")
    one.get_by_role("button", name="Play", exact=True).wait_for(timeout=LONG)
    at = page.motion.player.now
    one.keyboard.press("l")
    assert until(lambda: page.motion.player.now == pytest.approx(at + 1.0))
    page.motion.set_speed(1.0)
    press(one, "tab", "Layers")
    one.get_by_label("Potential", exact=True).click(force=True)
    assert until(lambda: "potential" in page.layers.drawn)
    press(two, "tab", "Layers")
    expect(two.get_by_label("Potential", exact=True)).to_be_checked(timeout=LONG)
    assert errors == []


def test_the_page_sends_an_image_and_a_film_and_saves_its_plan(
    site: tuple[Page, str], opened: Callable[[str], Tab], errors: list[str]
) -> None:
    page, address = site
    tab = opened(address)
    press(tab, "tab", "Files")
    with tab.expect_download(timeout=LONG) as download:
        press(tab, "button", "Image (PNG)")
    with Image.open(download.value.path()) as picture:
        assert picture.size == (1280, 720)
        assert len(picture.convert("RGB").getcolors(1280 * 720) or ()) > 20
    duration, page.motion.player.duration = page.motion.player.duration, 0.4
    with tab.expect_download(timeout=LONG) as download:
        press(tab, "button", "Film (GIF)")
    page.motion.player.duration = duration
    with Image.open(download.value.path()) as film:
        assert film.n_frames >= 2  # type: ignore[attr-defined]
        assert film.size == (640, 360)
    press(tab, "button", "Save plan")
    tab.get_by_text("Saved as plan.json").wait_for(timeout=LONG)
    assert (page.files.folder / "plan.json").is_file()
    assert errors == []


def of_points(tab: Tab) -> set[int]:
    """Return the sizes of the clouds that a tab has drawn since the last call [-]."""
    return set(tab.evaluate("() => { const all = window.clouds; window.clouds = []; return all; }"))


def test_a_slow_browser_draws_few_points_while_its_camera_moves_and_all_at_rest(
    site: tuple[Page, str],
    opened: Callable[[str], Tab],
    errors: list[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    page, address = site
    monkeypatch.setattr(playback, "SLOW_FRAME_TIME", 0.0)  # with any renderer
    monkeypatch.setattr(playback, "REST_TIME", 5.0)  # even if the mouse is slow
    points = np.random.default_rng(0).uniform([0.0, -3.0, 0.0], [4.0, 0.0, 2.0], (60_000, 3))
    cloud = Cloud(points, np.tile([0.0, 0.0, 1.0], (len(points), 1)),
                  np.zeros((len(points), 3), np.uint8))  # fmt: skip
    page.scan.show(Modeled(Path("scan.json"), cloud, (), np.eye(4), ()))
    shown, few = {50_000}, {COARSE_POINTS}
    tab = opened(address)
    tab.locator("canvas").first.wait_for(timeout=LONG)
    tab.evaluate(WATCH_POINTS)

    def become(look: Callable[[], set[int]], wanted: set[int]) -> bool:
        """Wait until a tab draws only these clouds; each look starts after the last one."""
        ends = time.monotonic() + LONG / 1000
        while (seen := look() & (shown | few)) != wanted and time.monotonic() < ends:
            time.sleep(0.05)
        return seen == wanted

    assert become(lambda: of_points(tab), shown)
    x, y = 100, 200  # below a message of the browser
    tab.mouse.move(x, y)
    tab.mouse.down()

    def turned(times: int) -> set[int]:
        """Move the camera for some frames; return the clouds that were drawn."""
        for k in range(times):
            tab.mouse.move(x + 5 * k, y)
            drawn(tab)
        return of_points(tab)

    assert become(lambda: turned(6), few)
    assert turned(10) & (shown | few) == few
    tab.mouse.up()
    assert become(lambda: of_points(tab), shown)
    page.scan.show(None)
    assert errors == []


@dataclass(frozen=True)
class Faster:
    """A motion at four times its speed: software draws a page slower than it plays."""

    story: Story

    @property
    def duration(self) -> float:
        """[s]"""
        return self.story.duration / 4

    def at(self, seconds: float) -> Moment:
        """Return the moment at a time [s]."""
        return self.story.at(4 * seconds)


def test_a_written_page_plays_without_a_network(
    site: tuple[Page, str], browser: Browser, tmp_path: Path
) -> None:
    page, _ = site
    answer = page.shown.answer
    plan, robot = answer.plan, answer.prepared.robot
    story = Faster(Story.of(plan, robot, answer.prepared.scene))
    write_page(answer.prepared.scene, robot, plan, tmp_path / "page.html", story=story)
    requests: list[str] = []
    with browser.new_context(viewport=SMALL, offline=True) as context:  # type: ignore[arg-type]
        tab = context.new_page()
        tab.on("request", lambda request: requests.append(request.url))
        tab.goto((tmp_path / "page.html").as_uri())
        tab.locator("canvas").first.wait_for(timeout=LONG)
        time_shown = tab.locator("input").first
        first = time_shown.input_value(timeout=LONG)
        assert until(lambda: time_shown.input_value() != first)
        assert tab.title() == "open fridge/door_hinge to 90° with segway_ur5e: solved"
        loops = [0.0]

        def repeats() -> bool:
            """Return whether the motion has ever begun again."""
            loops.append(float(time_shown.input_value()))
            return bool((np.diff(loops) < 0.0).any())

        assert until(repeats)

        def dark() -> bool:
            """Return whether a picture shows more than a fade to white."""
            shown = np.asarray(Image.open(BytesIO(tab.screenshot())).convert("L"))
            return bool(np.percentile(shown[40:200, 100:500], 10) < 200)

        assert until(dark)
        phases = tab.locator("#mm-phases button")
        names = [one.get_attribute("title") for one in phases.all()]
        assert names[0] == "drive"
        assert "open fridge" in names
        assert set(phases.all_inner_texts()) <= {"", *(str(n).replace(" the ", " ") for n in names)}
        phases.nth(1).click(force=True)  # seeks, and pauses there
        expect(tab.locator("#mm-phases button.on")).to_have_attribute(
            "title", str(names[1]), timeout=LONG
        )
        expect(tab.locator("#mm-now")).to_have_text(str(names[1]), timeout=LONG)
        tab.get_by_text("base pose").wait_for(state="attached", timeout=LONG)
    assert [url for url in requests if not url.startswith(("file:", "data:", "blob:"))] == []
    assert story.duration > 1.0
