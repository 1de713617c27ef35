"""What is drawn belongs to what is asked, whoever draws at the same time."""

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
from viser import LineSegmentsHandle

from momapos.apps.web import answer_layers
from momapos.apps.web.map_layers import box_edges
from momapos.apps.web.page import Page
from momapos.apps.web.panel import POINTS
from momapos.apps.web.saving import FILMS, render, send_film
from momapos.apps.web.scan_view import FEW, FINE, ROOM, SIZE, boxes_of, thing_colors
from momapos.apps.web.serve import served
from momapos.apps.web.words import answer_words
from momapos.core.cache import user_cache
from momapos.core.errors import InputError
from momapos.core.geometry.upright_boxes import UprightBox, box_axes
from momapos.model.plan_files.plan_format import read_plan
from momapos.model.records.scans import Cloud, Detection
from momapos.perception.records import Decision, Modeled
from momapos.simulation.film_files import GIF, MP4

LONG = 60.0


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    """A page that nobody looks at."""
    with served(
        host="127.0.0.1", port=0, scenes=("kitchen_small",), robots=("segway_ur5e",),
        scene="kitchen_small", robot="segway_ur5e", cache=user_cache(),
        folder=tmp_path_factory.mktemp("page"),
    ) as (page, _):  # fmt: skip
        assert page.work.wait(LONG)
        page.place()
        assert page.work.wait(LONG)
        assert page.layers.wait(LONG)
        yield page


@pytest.fixture(autouse=True)
def no_warning() -> Iterator[None]:
    """viser warns of what is removed twice."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def test_kept_answers_stand_over_the_room_or_beside_it_and_are_forgotten(page: Page) -> None:
    compare = page.compare
    compare.keep()
    compare.keep()
    one, two = compare.kept
    np.testing.assert_allclose(one.frame.position, 0.0)
    assert one.room.scene is None
    alone = np.array(page.server.initial_camera.look_at)
    page.panel.beside.value = True
    compare.arrange()
    one_at, two_at = (np.array(kept.frame.position) for kept in (one, two))
    assert np.linalg.norm(one_at) > 4.0  # the room is 4.2 m wide
    np.testing.assert_allclose(two_at, 2 * one_at)
    assert one.room.scene is page.shown.scene
    # All three rooms are looked at, from farther away.
    target = np.array(page.server.initial_camera.look_at)
    assert (target - alone) @ one_at > 0.7 * one_at @ one_at
    page.motion.seek(0.0)
    np.testing.assert_allclose(one.robot.base, page.robot.base)  # in step
    page.panel.beside.value = False
    compare.arrange()
    np.testing.assert_allclose(one.frame.position, 0.0)
    np.testing.assert_allclose(page.server.initial_camera.look_at, alone)
    compare.forget()
    assert compare.kept == ()
    assert page.panel.kept.content == "Nothing is kept."


def test_no_more_than_four_answers_are_kept(page: Page) -> None:
    for _ in range(5):
        page.compare.keep()
    assert len(page.compare.kept) == 4
    assert "no more than four" in page.panel.kept.content
    page.compare.forget()


def test_a_layer_of_an_answer_that_is_no_longer_shown_is_not_left(
    page: Page, monkeypatch: pytest.MonkeyPatch
) -> None:
    answer = page.shown.answer
    scene, machine = page.shown.scene, page.shown.machine
    assert answer is not None
    assert scene is not None
    assert machine is not None

    def answered_meanwhile(layers: Any, name: str, of: Any, clock: Any) -> None:
        del of, clock
        page.server.scene.add_frame(f"{name}/late")
        layers.clear()

    monkeypatch.setitem(answer_layers.DRAW, "way", answered_meanwhile)
    reach = machine.reach_of(answer.prepared.robot.arm)
    page.layers.show(scene, answer, reach)
    assert page.layers.wait(LONG)
    assert not page.layers.drawn
    assert page.server.scene.get_handle_by_name("/layers/way/late") is None
    monkeypatch.undo()
    page.layers.show(scene, answer, reach)
    assert page.layers.wait(LONG)
    assert "way" in page.layers.drawn


def test_the_tolerance_is_measured_after_the_answer_and_saved_with_it(page: Page) -> None:
    answer = page.shown.answer
    assert answer is not None
    found = answer.plan.tolerance
    assert found is not None
    assert page.panel.result.content == answer_words(answer)
    assert f"{100 * found.radius:g} cm beside" in page.panel.result.content
    cover = page.server.scene.get_handle_by_name("/layers/tolerance/cover")
    assert isinstance(cover, LineSegmentsHandle)
    base = np.array(answer.plan.base_pose)
    away = np.linalg.norm(cover.points[..., :2] - base[:2], axis=-1)
    outer = np.linalg.norm(answer.prepared.robot.footprint, axis=-1).max()
    assert away.max() == pytest.approx(outer + found.radius, abs=2e-3)
    page.extras.save_plan("kept.json")
    assert page.extras.work.wait(LONG)
    assert read_plan(page.folder / "kept.json").tolerance == found


def test_the_tolerance_of_an_answer_that_is_no_longer_shown_is_not_told(page: Page) -> None:
    answer = page.shown.answer
    assert answer is not None
    before = replace(answer, plan=replace(answer.plan, tolerance=None))
    said = page.panel.result.content
    page.answer.measured(before, before)
    assert page.shown.answer is answer
    assert page.panel.result.content == said
    page.shown.answer = before
    page.tell("Something else.")
    page.answer.measured(before, answer)
    assert page.shown.answer is answer  # but what is said by now stays
    assert page.panel.result.content == "Something else."
    page.tell(said)


def test_what_is_found_for_a_question_of_before_is_not_shown(page: Page) -> None:
    probe = page.follow._probe()
    assert probe is not None
    page.shown.probe = None  # something else is asked
    words, base = page.panel.result.content, page.robot.base.copy()
    page.follow._show(probe.at(base, time.perf_counter), probe, 0.1)
    assert page.panel.result.content == words


def test_spheres_follow_the_arm_and_are_drawn_once(page: Page) -> None:
    page.robot.show_spheres(True)
    first = page.robot._spheres
    before = np.array(first.batched_positions)
    page.motion.seek(0.0)
    page.motion.seek(page.motion.player.duration / 2)
    assert page.robot._spheres is first
    assert np.abs(np.array(first.batched_positions) - before).max() > 0.05
    page.robot.show_spheres(False)


def test_points_of_a_scan_are_sent_once_and_only_as_many_as_are_asked_for(page: Page) -> None:
    count = 150_000
    rng = np.random.default_rng(0)
    points = rng.uniform(0.0, 4.0, (count, 3))
    cloud = Cloud(points, np.tile([0.0, 0.0, 1.0], (count, 1)), np.zeros((count, 3), np.uint8))
    box = UprightBox(np.array([1.0, 1.0, 0.5]), np.array([0.5, 0.5, 1.0]), 0.3)
    thing = Detection("cup_1", "cup", 1.0, box, np.arange(1000))
    modeled = Modeled(Path("x.json"), cloud, (), np.eye(4),
                      (Decision(thing, None, None, (), None, ""),))  # fmt: skip
    scan, few = page.scan, next(most for most in POINTS.values() if most is not None)

    def sizes() -> set[float]:
        return {node.point_size for part, node in scan._parts.items() if part[0] == FINE}

    scan.show(modeled)
    assert page.panel.scan_folder.visible
    assert scan.sent == few + FEW
    assert page.panel.points_shown.content == "50,000 of 150,000 points are drawn."
    assert sizes() == {SIZE * float(np.sqrt(3.0))}  # they cover as much as all do
    page.panel.points.value = "all"
    scan.changed()
    assert scan.sent == count + FEW
    assert sizes() == {SIZE}
    page.panel.points.value = next(iter(POINTS))
    scan.changed()
    page.panel.points.value = "all"
    scan.changed()
    assert scan.sent == count + FEW
    colors = thing_colors(modeled)
    assert len(np.unique(colors, axis=0)) == 2
    assert "#{:02x}{:02x}{:02x}".format(*colors[-1]) == ROOM
    assert scan.many
    page.panel.cloud.value = "none"
    scan.changed()
    assert not scan.many
    assert page.panel.points_shown.content == "0 of 150,000 points are drawn."
    page.panel.cloud.value = "by thing"
    scan.show(None)
    assert scan.sent == 0
    assert not page.panel.scan_folder.visible


def test_boxes_of_a_scan_stand_as_they_were_found() -> None:
    box = UprightBox(np.array([1.0, 2.0, 0.5]), np.array([0.5, 0.3, 1.0]), 0.4)
    edges = box_edges(boxes_of([box]))[0]
    lengths = np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1)
    np.testing.assert_allclose(np.sort(lengths), np.repeat(np.sort(box.size), 4))
    along = (edges[:, 1] - edges[:, 0])[np.isclose(lengths, 0.5)][0] / 0.5
    assert abs(along[:2] @ box_axes(box.yaw)[0]) == pytest.approx(1.0)


def test_a_picture_is_white_where_nothing_is() -> None:
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


def test_a_dear_layer_does_not_hold_up_the_others_and_ends_when_it_is_switched_off(
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

    monkeypatch.setitem(answer_layers.DRAW, "opening", endless)
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


def test_layers_that_nobody_looks_at_are_not_computed_on(
    page: Page, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun = threading.Event()

    def endless(layers: Any, name: str, of: Any, clock: Any) -> None:
        del layers, name, of
        begun.set()
        while True:
            clock()

    monkeypatch.setitem(answer_layers.DRAW, "opening", endless)
    page.panel.layers["opening"].value = True
    page.layers.changed()
    assert begun.wait(LONG)
    page.browsers._alone()
    assert page.layers.wait(LONG)
    page.panel.layers["opening"].value = False


class Browser:
    """What a film needs of a browser; it sends white pictures as long as it is there."""

    def __init__(self, pictures: int = 1000) -> None:
        self.left, self.files = pictures, {}  # type: ignore[var-annotated]

    def get_render(self, height: int, width: int, **_: Any) -> np.ndarray:
        self.left -= 1
        if self.left < 0:
            raise RuntimeError("the client has gone")
        return np.full((height, width, 4), 255, np.uint8)

    def send_file_download(self, name: str, content: bytes, *, save_immediately: bool) -> None:
        assert save_immediately  # else there is a link to it only
        self.files[name] = content


def test_a_film_of_the_page_shows_the_whole_motion() -> None:
    shown: list[float] = []
    browser = Browser()
    faster = send_film(browser, GIF, 12.0, shown.append, time.perf_counter)
    assert (shown[0], shown[-1]) == (0.0, 12.0)
    with Image.open(io.BytesIO(browser.files["momapos.gif"])) as film:
        assert film.size == FILMS[GIF].size
    assert faster == pytest.approx(12.0 * FILMS[GIF].rate / len(shown))


def test_a_film_as_mp4_is_720_high() -> None:
    av = optional.module("av")
    browser = Browser()
    send_film(browser, MP4, 0.2, lambda _: None, time.perf_counter)
    with av.open(io.BytesIO(browser.files["momapos.mp4"])) as film:
        stream = film.streams.video[0]
        assert (stream.codec_context.width, stream.codec_context.height) == (1280, 720)
        assert sum(1 for _ in film.decode(video=0)) == 5


def test_a_film_for_a_browser_that_has_gone_is_told_in_one_line() -> None:
    with pytest.raises(InputError, match="the browser sent no picture"):
        send_film(Browser(3), GIF, 2.0, lambda _: None, time.perf_counter)
    with pytest.raises(InputError, match="no motion"):
        send_film(Browser(), GIF, 0.0, lambda _: None, time.perf_counter)


def test_an_answer_stands_at_its_end_and_another_question_puts_the_part_back(page: Page) -> None:
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
    panel.to.value = "60deg"
    page.change()
    assert page.work.wait(LONG)
    np.testing.assert_allclose(doors(), closed, atol=1e-12)
    assert panel.joint_values == {}
    panel.to.value = ""
    page.place()
    assert page.work.wait(LONG)


def test_a_joint_that_is_moved_by_hand_leaves_the_others_where_they_stand(page: Page) -> None:
    _, slider = page.panel._joints["freezer_door_hinge"]
    slider.value = 30.0
    page.motion.move_joints()
    assert page.shown.joints == {
        "door_hinge": pytest.approx(np.pi / 2, abs=1e-4),
        "freezer_door_hinge": pytest.approx(np.pi / 6, abs=1e-4),
    }


def test_what_is_paused_by_a_hand_on_the_base_says_so(page: Page) -> None:
    page.motion.seek(0.0)
    page.motion.toggle()
    ends = time.monotonic() + LONG
    # The player's thread tells the time before it tells the button.
    while page.panel.play.label != "Pause" and time.monotonic() < ends:
        time.sleep(0.01)
    assert page.panel.play.label == "Pause"
    assert page.motion.player.playing
    page.motion.pause()
    assert page.panel.play.label == "Play"
    assert not page.motion.player.playing
