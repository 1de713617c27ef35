"""The drawing matches the question, even with several threads."""

from __future__ import annotations

import io
import threading
import time
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from tests import optional
from tests.apps.web.pages import serve
from viser import LineSegmentsHandle

from momapos.apps.web import answer_view
from momapos.apps.web.card import Card
from momapos.apps.web.extras import FILMS, render, send_film
from momapos.apps.web.map_layers import box_edges
from momapos.apps.web.page import Page
from momapos.apps.web.panel import POINTS
from momapos.apps.web.scan_view import (
    BACKGROUND,
    COARSE_POINTS,
    FINE,
    POINT_SIZE,
    object_colors,
    oriented_boxes,
)
from momapos.apps.web.words import answer_card
from momapos.core.errors import InputError
from momapos.core.geometry.polygons import UprightBox, box_axes
from momapos.model.plan_files.plan_format import read_plan
from momapos.model.records.scans import Cloud, Detection
from momapos.perception.records import Decision, Modeled
from momapos.simulation.film import GIF, MP4

LONG = 60.0


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    """A page without browsers."""
    with serve(tmp_path_factory.mktemp("page")) as (page, _):
        assert page.work.wait(LONG)
        page.place()
        assert page.work.wait(LONG)
        assert page.layers.wait(LONG)
        yield page


@pytest.fixture(autouse=True)
def no_warning() -> Iterator[None]:
    """viser warns about nodes that are removed twice."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def test_compared_answers_stand_in_the_room_and_can_be_removed(page: Page) -> None:
    compare = page.compare
    compare.add()
    compare.add()
    page.motion.seek(0.0)
    for one in compare.answers:
        np.testing.assert_allclose(one.robot.base, page.robot.base)  # in step
    compare.clear()
    assert compare.answers == ()
    assert page.panel.comparison.content == "No answers to compare."


def test_no_more_than_four_answers_are_compared(page: Page) -> None:
    for _ in range(5):
        page.compare.add()
    assert len(page.compare.answers) == 4
    assert "the limit is four answers" in page.panel.comparison.content
    page.compare.clear()


def test_a_layer_of_an_outdated_answer_is_removed(
    page: Page, monkeypatch: pytest.MonkeyPatch
) -> None:
    answer = page.shown.answer
    scene, arms = page.shown.scene, page.shown.arms

    def answered_meanwhile(layers: Any, name: str, of: Any, clock: Any) -> None:
        del of, clock
        page.server.scene.add_frame(f"{name}/late")
        layers.clear()

    monkeypatch.setitem(answer_view.DRAW, "path", answered_meanwhile)
    reach = arms.reach_of(answer.prepared.robot.arm)
    page.layers.show(scene, answer, reach)
    assert page.layers.wait(LONG)
    assert not page.layers.drawn
    assert page.server.scene.get_handle_by_name("/layers/path/late") is None
    monkeypatch.undo()
    page.layers.show(scene, answer, reach)
    assert page.layers.wait(LONG)
    assert "path" in page.layers.drawn


def test_the_tolerance_is_measured_after_the_answer_and_saved_with_it(page: Page) -> None:
    answer = page.shown.answer
    found = answer.plan.tolerance
    assert page.panel.card.shown == answer_card(answer)
    assert f"±{100 * found.radius:g} cm" in page.panel.card.text
    cover = page.server.scene.get_handle_by_name("/layers/tolerance/cover")
    assert isinstance(cover, LineSegmentsHandle)
    base = np.array(answer.plan.base_pose)
    away = np.linalg.norm(cover.points[..., :2] - base[:2], axis=-1)
    outer = np.linalg.norm(answer.prepared.robot.footprint, axis=-1).max()
    assert away.max() == pytest.approx(outer + found.radius, abs=2e-3)
    page.files.save_plan("measured.json")
    assert page.files.work.wait(LONG)
    assert read_plan(page.files.folder / "measured.json").tolerance == found


def test_the_tolerance_of_an_outdated_answer_is_not_shown(page: Page) -> None:
    answer = page.shown.answer
    before = replace(answer, plan=replace(answer.plan, tolerance=None))
    said = page.panel.card.shown
    page.layers.use_tolerance(before, before)
    assert page.shown.answer is answer
    assert page.panel.card.shown == said
    page.shown.tour = replace(page.shown.tour, steps=(before,))
    page.state.show(Card("Something else"))
    page.layers.use_tolerance(before, answer)
    assert page.shown.answer is answer  # but a newer text stays
    assert page.panel.card.text == "Something else"
    page.state.show(said)


def test_a_finding_for_an_outdated_question_is_not_shown(page: Page) -> None:
    probe = page.follow._probe()
    page.shown.probe = None  # the question has changed
    words, base = page.panel.card.text, page.robot.base.copy()
    page.follow._show(probe.at(base, time.perf_counter), probe, 0.1)
    assert page.panel.card.text == words


def test_spheres_follow_the_arm_and_are_drawn_once(page: Page) -> None:
    page.robot.show_spheres(True)
    first = page.robot._spheres
    before = np.array(first.batched_positions)
    page.motion.seek(0.0)
    page.motion.seek(page.motion.player.duration / 2)
    assert page.robot._spheres is first
    assert np.abs(np.array(first.batched_positions) - before).max() > 0.05
    page.robot.show_spheres(False)


def test_points_of_a_scan_are_sent_once_and_only_as_many_as_selected(page: Page) -> None:
    count = 150_000
    rng = np.random.default_rng(0)
    points = rng.uniform(0.0, 4.0, (count, 3))
    cloud = Cloud(points, np.tile([0.0, 0.0, 1.0], (count, 1)), np.zeros((count, 3), np.uint8))
    box = UprightBox(np.array([1.0, 1.0, 0.5]), np.array([0.5, 0.5, 1.0]), 0.3)
    detection = Detection("cup_1", "cup", 1.0, box, np.arange(1000))
    modeled = Modeled(Path("x.json"), cloud, (), np.eye(4),
                      (Decision(detection, None, None, (), None, ""),))  # fmt: skip
    scan, few = page.scan, next(limit for limit in POINTS.values() if limit is not None)

    def sizes() -> set[float]:
        return {node.point_size for part, node in scan._parts.items() if part[0] == FINE}

    scan.show(modeled)
    assert page.panel.scan_folder.visible
    assert scan.sent == few + COARSE_POINTS
    assert page.panel.points_shown.content == "50,000 of 150,000 points drawn."
    assert sizes() == {POINT_SIZE * float(np.sqrt(3.0))}  # they cover as much as all do
    page.panel.points.value = "all"
    scan.changed()
    assert scan.sent == count + COARSE_POINTS
    assert sizes() == {POINT_SIZE}
    page.panel.points.value = next(iter(POINTS))
    scan.changed()
    page.panel.points.value = "all"
    scan.changed()
    assert scan.sent == count + COARSE_POINTS
    colors = object_colors(modeled)
    assert len(np.unique(colors, axis=0)) == 2
    assert "#{:02x}{:02x}{:02x}".format(*colors[-1]) == BACKGROUND
    assert scan.many
    page.panel.cloud.value = "none"
    scan.changed()
    assert not scan.many
    assert page.panel.points_shown.content == "0 of 150,000 points drawn."
    page.panel.cloud.value = "by object"
    scan.show(None)
    assert scan.sent == 0
    assert not page.panel.scan_folder.visible


def test_boxes_of_a_scan_are_drawn_at_their_poses() -> None:
    box = UprightBox(np.array([1.0, 2.0, 0.5]), np.array([0.5, 0.3, 1.0]), 0.4)
    edges = box_edges(oriented_boxes([box]))[0]
    lengths = np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1)
    np.testing.assert_allclose(np.sort(lengths), np.repeat(np.sort(box.size), 4))
    along = (edges[:, 1] - edges[:, 0])[np.isclose(lengths, 0.5)][0] / 0.5
    assert abs(along[:2] @ box_axes(box.yaw)[0]) == pytest.approx(1.0)


def test_an_image_is_white_where_nothing_is_drawn() -> None:
    class Browser:
        def get_render(
            self, height: int, width: int, transport_format: str, timeout: float
        ) -> np.ndarray:
            assert transport_format == "png"
            assert timeout > 0
            picture = np.zeros((height, width, 4), np.uint8)
            picture[: height // 2] = (10, 20, 30, 255)
            return picture

    picture = render(Browser(), (8, 6))
    assert picture.shape == (6, 8, 3)
    assert picture[0, 0].tolist() == [10, 20, 30]
    assert picture[-1, 0].tolist() == [255, 255, 255]


def test_a_slow_layer_does_not_delay_others_and_is_canceled_when_switched_off(
    page: Page, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun, ended = threading.Event(), threading.Event()

    def endless(layers: Any, name: str, of: Any, clock: Any) -> None:
        del layers, name, of
        begun.set()
        try:
            while True:
                clock()
        finally:
            ended.set()

    monkeypatch.setitem(answer_view.DRAW, "opening", endless)
    boxes = page.panel.layers
    boxes["opening"].value = True
    page.layers.changed()
    assert begun.wait(LONG)
    boxes["potential"].value = True
    page.layers.changed()
    assert page.layers.work.wait(LONG)
    assert "potential" in page.layers.drawn
    assert not ended.is_set()
    assert page.layers.busy
    boxes["opening"].value = boxes["potential"].value = False
    page.layers.changed()
    assert page.layers.wait(LONG)
    assert ended.is_set()


def test_layers_are_canceled_without_browsers(page: Page, monkeypatch: pytest.MonkeyPatch) -> None:
    begun = threading.Event()

    def endless(layers: Any, name: str, of: Any, clock: Any) -> None:
        del layers, name, of
        begun.set()
        while True:
            clock()

    monkeypatch.setitem(answer_view.DRAW, "opening", endless)
    page.panel.layers["opening"].value = True
    page.layers.changed()
    assert begun.wait(LONG)
    page.browsers._on_empty()
    assert page.layers.wait(LONG)
    page.panel.layers["opening"].value = False


class Browser:
    """A browser that sends a number of white images and then disconnects."""

    def __init__(self, images: int = 1000) -> None:
        self.left, self.files = images, {}  # type: ignore[var-annotated]

    def get_render(self, height: int, width: int, **_: Any) -> np.ndarray:
        self.left -= 1
        if self.left < 0:
            raise RuntimeError("the client has gone")
        return np.full((height, width, 4), 255, np.uint8)

    def send_file_download(self, name: str, content: bytes, *, save_immediately: bool) -> None:
        assert save_immediately  # otherwise only a link appears
        self.files[name] = content


def test_a_film_of_the_page_shows_the_whole_motion() -> None:
    shown: list[float] = []
    browser = Browser()
    speed = send_film(browser, GIF, 12.0, shown.append, time.perf_counter)
    assert (shown[0], shown[-1]) == (0.0, 12.0)
    with Image.open(io.BytesIO(browser.files["momapos.gif"])) as film:
        assert film.size == FILMS[GIF].size
    assert speed == pytest.approx(12.0 * FILMS[GIF].rate / len(shown))


def test_a_film_as_mp4_is_720_high() -> None:
    av = optional.module("av")
    browser = Browser()
    send_film(browser, MP4, 0.2, lambda _: None, time.perf_counter)
    with av.open(io.BytesIO(browser.files["momapos.mp4"])) as film:
        stream = film.streams.video[0]
        assert (stream.codec_context.width, stream.codec_context.height) == (1280, 720)
        assert sum(1 for _ in film.decode(video=0)) == 5


def test_a_film_for_a_disconnected_browser_is_reported_in_one_line() -> None:
    with pytest.raises(InputError, match="the browser sent no image"):
        send_film(Browser(3), GIF, 2.0, lambda _: None, time.perf_counter)
    with pytest.raises(InputError, match="no motion"):
        send_film(Browser(), GIF, 0.0, lambda _: None, time.perf_counter)


def test_an_answer_is_shown_at_its_end_and_a_new_question_resets_the_part(page: Page) -> None:
    def doors() -> np.ndarray:
        return np.concatenate([[*n.position, *n.wxyz] for n in page.room._links.values()])

    panel, player = page.panel, page.motion.player
    page.motion.seek(0.0)
    closed = doors()
    page.place()
    assert page.work.wait(LONG)
    assert player.now == player.duration == pytest.approx(panel.time.value, abs=0.02)
    assert panel.moment.content.startswith(f"{player.duration:.1f} s")
    assert panel.joint_values == {"door_hinge": pytest.approx(np.pi / 2, abs=1e-4)}
    assert np.abs(doors() - closed).max() > 0.3
    panel.show_to("60deg")
    page.change()
    assert page.work.wait(LONG)
    np.testing.assert_allclose(doors(), closed, atol=1e-12)
    assert panel.joint_values == {}
    panel.show_to("")
    page.place()
    assert page.work.wait(LONG)


def test_a_joint_moved_with_its_slider_leaves_the_others_unchanged(page: Page) -> None:
    _, slider = page.panel._joints["freezer_door_hinge"]
    slider.value = 30.0
    page.motion.move_joints()
    assert page.shown.joints == {
        "door_hinge": pytest.approx(np.pi / 2, abs=1e-4),
        "freezer_door_hinge": pytest.approx(np.pi / 6, abs=1e-4),
    }


def test_the_play_button_shows_that_the_motion_is_paused(page: Page) -> None:
    page.motion.seek(0.0)
    page.motion.toggle()
    ends = time.monotonic() + LONG
    # The player's thread sets the time before the label of the button.
    while page.panel.play.label != "Pause" and time.monotonic() < ends:
        time.sleep(0.01)
    assert page.panel.play.label == "Pause"
    assert page.motion.player.playing
    page.motion.pause()
    assert page.panel.play.label == "Play"
    assert not page.motion.player.playing
