"""What a picture of the page costs: nothing, the demo kitchen, a large room, in one run.

    python benchmarks/page_pictures.py [--objects 1000] [--points 2000000] [--rounds 2]
                                       [--only nothing|cloud|kitchen|hall ...]

A Chromium draws, 1280 x 720, while the mouse turns the room; how many pictures come a second, what
each takes of the processor, and what is drawn for it. By what it draws is printed: without a
graphics card a program does, and nothing is drawn faster than an empty page. On a machine that has
other work the ratios count, not the pictures a second.
"""

from __future__ import annotations

import argparse
import math
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from gallery import browsing
from large_page import serving
from momapos.apps.web import moving, room_view
from momapos.apps.web.page import Page
from momapos.apps.web.panel import POINTS
from momapos.apps.web.scan_view import COARSE_POINTS
from momapos.apps.web.serve import open_server, quiet, served
from momapos.core.cache import user_cache

LOOKS = ("nothing", "cloud", "kitchen", "hall")
SIZES = (0.001, 0.012, 0.024, 0.05)
"""Of points whose cost is measured [m]."""
WINDOW = {"width": 1280, "height": 720}
START, WAY = (300, 360), 300
"""Where the mouse takes hold of the room, and how far it then drags it round [px]."""
QUIET, SETTLED = 2.0, 30.0
"""A browser gets at least and at most so long to take in what is new [s]."""
COUNT = """(() => {
  const all = {calls: 0, triangles: 0, points: 0, pictures: 0, done: 0, seen: 0};
  const gl = WebGL2RenderingContext.prototype;
  const watch = (name, at, copies) => {
    const draw = gl[name];
    gl[name] = function (...given) {
      const corners = given[at] * (copies ? given[copies] : 1);
      all.calls += 1;
      all.done += 1;
      if (given[0] === gl.TRIANGLES) all.triangles += corners / 3;
      if (given[0] === gl.POINTS) all.points += corners;
      return draw.apply(this, given);
    };
  };
  watch("drawElements", 1);
  watch("drawArrays", 2);
  watch("drawElementsInstanced", 1, 4);
  watch("drawArraysInstanced", 2, 3);
  const clear = gl.clear;
  gl.clear = function (...given) { all.done += 1; return clear.apply(this, given); };
  const next = () => {
    if (all.done > all.seen) all.pictures += 1;
    all.seen = all.done;
    window.whole = {...all};
    requestAnimationFrame(next);
  };
  requestAnimationFrame(next);
})();"""
"""A page draws only when something changes, so that its pictures are those in which it drew; what
was counted is read between two of them."""
LEAST, LONGEST = 3, 6.0
"""So many pictures are waited for [-], so many times longer at most than others are watched [-]."""
STEADY = """most => new Promise(done => {
  const began = performance.now();
  let last = began, good = 0;
  const next = () => {
    const now = performance.now();
    good = now - last < 60 ? good + 1 : 0;
    last = now;
    if (good < 30 && now - began < most) requestAnimationFrame(next); else done();
  };
  requestAnimationFrame(next);
})"""
"""What is new is taken in when the page has had time for 30 pictures in a row."""
RENDERER = """() => {
  const gl = document.querySelector("canvas").getContext("webgl2");
  return gl.getParameter(gl.getExtension("WEBGL_debug_renderer_info").UNMASKED_RENDERER_WEBGL);
}"""


class Watch:
    """Measures looks, and tells what each is of the kitchen and of an empty page."""

    def __init__(self, browser: Any, seconds: float) -> None:
        self._browser, self._seconds = browser, seconds
        self._tab: Any = None

    def open(self, address: str) -> None:
        """Look at another page."""
        self.close()
        self._tab = self._browser.new_page(viewport=WINDOW)
        self._tab.add_init_script(COUNT)
        self._tab.goto(address)
        self._tab.locator("canvas").first.wait_for(timeout=1000 * SETTLED)

    def close(self) -> None:
        """Look at nothing any more."""
        if self._tab is not None:
            self._tab.close()
            self._tab = None

    @property
    def renderer(self) -> str:
        """What draws."""
        return str(self._tab.evaluate(RENDERER))

    def turn(self, name: str) -> None:
        """Drag the room round once, and tell what its pictures cost."""
        tab = self._tab
        tab.wait_for_timeout(1000 * QUIET)
        tab.evaluate(STEADY, 1000 * SETTLED)
        x, y = START
        tab.mouse.move(x, y)
        tab.mouse.down()
        first, used, began = self._counted(), processor_time(), time.monotonic()
        last, share = first, 0.0
        while share < 1.0 or (last["pictures"] - first["pictures"] < LEAST and share < LONGEST):
            tab.mouse.move(x + WAY * (share % 1.0), y)
            share = (time.monotonic() - began) / self._seconds
            last = self._counted()
        took = time.monotonic() - began
        spent = processor_time() - used
        tab.mouse.up()
        drawn = max(last["pictures"] - first["pictures"], 1)
        calls, triangles, points = (
            (last[key] - first[key]) / drawn for key in ("calls", "triangles", "points")
        )
        print(f"{name:44} {drawn / took:5.1f} a second, {1000 * spent / drawn:4.0f} ms of "
              f"processor: {calls:4.0f} calls, {triangles:6.0f} triangles, {points:7.0f} points",
              flush=True)  # fmt: skip

    def _counted(self) -> dict[str, float]:
        counted: dict[str, float] = self._tab.evaluate("() => window.whole")
        return counted


def processor_time() -> float:
    """Of all processes that this one has begun, the browser's among them [s]."""
    used: dict[int, tuple[int, float]] = {}
    for file in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):  # it has ended meanwhile
            fields = file.read_text().rpartition(")")[2].split()
            ticks = int(fields[11]) + int(fields[12])
            used[int(file.parent.name)] = int(fields[1]), ticks / os.sysconf("SC_CLK_TCK")
    ours, grown = {os.getpid()}, True
    while grown:
        more = {pid for pid, (parent, _) in used.items() if parent in ours} - ours
        ours, grown = ours | more, bool(more)
    return sum(used[pid][1] for pid in ours - {os.getpid()} if pid in used)


def light(page: Page, *, plain: bool) -> None:
    """Light the room."""
    page.panel.plain.value = plain
    page.light.changed()


def points(page: Page, coloring: str, number: str = "") -> None:
    """Show points of the scan; "none": nothing of it."""
    page.panel.cloud.value, page.panel.boxes.value = coloring, coloring != "none"
    if number:
        page.panel.points.value = number
    page.scan.changed()


def empty(watch: Watch) -> None:
    """A page without a room."""
    server = open_server("127.0.0.1", 0)
    watch.open(f"http://127.0.0.1:{server.get_port()}")
    print(f"drawn by {watch.renderer}", flush=True)
    watch.turn("nothing")
    watch.close()
    with quiet():
        server.stop()


def cloud(watch: Watch) -> None:
    """Points and nothing else: what their number costs, and what their size."""
    server = open_server("127.0.0.1", 0)
    server.scene.configure_default_lights(cast_shadow=False)
    server.scene.configure_environment_map(None)
    watch.open(f"http://127.0.0.1:{server.get_port()}")
    rng = np.random.default_rng(0)
    for number in (COARSE_POINTS, 50_000):
        places = rng.uniform([-5.0, -5.0, 0.0], [5.0, 5.0, 2.5], (number, 3))
        colors = rng.integers(0, 255, (number, 3)).astype(np.uint8)
        for size in SIZES:
            server.scene.add_point_cloud(
                "/points", places, colors, point_size=size, point_shape="square",
                precision="float16",
            )  # fmt: skip
            watch.turn(f"{number} points of {1000 * size:.0f} mm")
    watch.close()
    with quiet():
        server.stop()


def kitchen(watch: Watch) -> None:
    """The demo kitchen, in both lights."""
    with tempfile.TemporaryDirectory() as folder, served(
        host="127.0.0.1", port=0, scenes=("kitchen_small",), robots=("segway_ur5e",),
        scene="kitchen_small", robot="segway_ur5e", cache=user_cache(), folder=Path(folder),
    ) as (page, address):  # fmt: skip
        page.work.wait(600.0)
        watch.open(address)
        for plain in (False, True):
            light(page, plain=plain)
            watch.turn(f"demo kitchen{', plain light' * plain}")
        watch.close()


def hall(watch: Watch, page: Page, address: str, rounds: int) -> None:
    """The large room, each time with one cost less, then with the points of its scan."""
    points(page, "none")
    watch.open(address)
    for _ in range(rounds):
        light(page, plain=False)
        one_by_one(page, apart=True)
        watch.turn("large room, each thing by itself")
        one_by_one(page, apart=False)
        watch.turn("large room, many things in one mesh")
        light(page, plain=True)
        watch.turn("large room, plain light too")
    first, second, _ = POINTS
    for number in (first, second):
        points(page, "by object", number)
        with all_drawn():
            watch.turn(f"and its scan, {number} points all the time")
    points(page, "by object", first)
    watch.turn("the page finds that this browser is slow")
    for number in POINTS:
        points(page, "by object", number)
        watch.turn(f"and its scan, {number} points at rest")
    points(page, "by object", first)
    with all_drawn():
        watch.open(f"{address}/?fixedDpr=0.5")
        watch.turn(f"{first} all the time, a quarter of the pixels")
    watch.close()


@contextmanager
def all_drawn() -> Iterator[None]:
    """No browser counts as slow."""
    slow, moving.SLOW_FRAME_TIME = moving.SLOW_FRAME_TIME, math.inf
    try:
        yield
    finally:
        moving.SLOW_FRAME_TIME = slow


def one_by_one(page: Page, *, apart: bool) -> None:
    """Draw each thing of a large room by itself, or many in one mesh."""
    scene, active, most = page.room.scene, page.room.active, room_view.MAX_SEPARATE_OBJECTS
    assert scene is not None
    room_view.MAX_SEPARATE_OBJECTS = len(scene.objects) if apart else most
    try:
        page.room.remove()
        page.room.show(scene, active)
    finally:
        room_view.MAX_SEPARATE_OBJECTS = most


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--objects", type=int, default=1000)
    parser.add_argument("--points", type=int, default=2_000_000)
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--seconds", type=float, default=5.0, help="of each look")
    parser.add_argument("--only", nargs="*", choices=LOOKS, default=LOOKS)
    parser.add_argument("--chromium", default=shutil.which("chromium") or "chromium")
    args = parser.parse_args()
    with browsing(args.chromium) as browser:
        watch = Watch(browser, args.seconds)
        for name, look in {"nothing": empty, "cloud": cloud, "kitchen": kitchen}.items():
            if name in args.only:
                look(watch)
        if "hall" in args.only:
            with serving(args.objects, args.points) as (page, address):
                hall(watch, page, address, args.rounds)
