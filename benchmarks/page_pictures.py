"""Measure the cost of a frame of the web page: empty, the demo kitchen, and a large room.

    python benchmarks/page_pictures.py [--objects 1000] [--points 2000000] [--rounds 2]
                                       [--only nothing|cloud|kitchen|hall ...]

Chromium renders 1280 x 720 while the mouse rotates the room. Prints the frame rate, the processor
time per frame, and the draw calls and primitives, with the name of the renderer. Without a GPU a
software renderer is used, and an empty page is the upper bound. On a busy machine compare ratios,
not frame rates.
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
from momapos.apps.web import playback, room_view, served
from momapos.apps.web.page import Page
from momapos.apps.web.panel import POINTS
from momapos.apps.web.scan_view import COARSE_POINTS
from momapos.apps.web.serve import open_server, quiet
from momapos.core import USER_CACHE
from page import serving

LOOKS = ("nothing", "cloud", "kitchen", "hall")
SIZES = (0.001, 0.012, 0.024, 0.05)
"""Point sizes that are measured [m]."""
WINDOW = {"width": 1280, "height": 720}
START, WAY = (300, 360), 300
"""Start of the mouse drag that rotates the room, and its length [px]."""
QUIET, SETTLED = 2.0, 30.0
"""Minimum and maximum time for the browser to process new data [s]."""
COUNT = """(() => {
  const all = {calls: 0, triangles: 0, points: 0, frames: 0, done: 0, seen: 0};
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
    if (all.done > all.seen) all.frames += 1;
    all.seen = all.done;
    window.whole = {...all};
    requestAnimationFrame(next);
  };
  requestAnimationFrame(next);
})();"""
"""Counts frames with draw calls, since a page draws only after a change. The counts are read
between two frames."""
MIN_FRAMES, MAX_FACTOR = 3, 6.0
"""Minimum number of frames per measurement [-], and how many times longer than --seconds it may
therefore take [-]."""
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
"""Resolves once the page has rendered 30 consecutive frames in time."""
RENDERER = """() => {
  const gl = document.querySelector("canvas").getContext("webgl2");
  return gl.getParameter(gl.getExtension("WEBGL_debug_renderer_info").UNMASKED_RENDERER_WEBGL);
}"""


class Watch:
    """Measure views of pages, and print their cost."""

    def __init__(self, browser: Any, seconds: float) -> None:
        self._browser, self._seconds = browser, seconds
        self._tab: Any = None

    def open(self, address: str) -> None:
        """Open a page."""
        self.close()
        self._tab = self._browser.new_page(viewport=WINDOW)
        self._tab.add_init_script(COUNT)
        self._tab.goto(address)
        self._tab.locator("canvas").first.wait_for(timeout=1000 * SETTLED)

    def close(self) -> None:
        """Close the page."""
        if self._tab is not None:
            self._tab.close()
            self._tab = None

    @property
    def renderer(self) -> str:
        """Return the name of the renderer."""
        return str(self._tab.evaluate(RENDERER))

    def turn(self, name: str) -> None:
        """Rotate the room once with the mouse, and print the cost of its frames."""
        tab = self._tab
        tab.wait_for_timeout(1000 * QUIET)
        tab.evaluate(STEADY, 1000 * SETTLED)
        x, y = START
        tab.mouse.move(x, y)
        tab.mouse.down()
        first, used, began = self._counted(), processor_time(), time.monotonic()
        last, share = first, 0.0
        while share < 1.0 or (last["frames"] - first["frames"] < MIN_FRAMES and share < MAX_FACTOR):
            tab.mouse.move(x + WAY * (share % 1.0), y)
            share = (time.monotonic() - began) / self._seconds
            last = self._counted()
        took = time.monotonic() - began
        spent = processor_time() - used
        tab.mouse.up()
        drawn = max(last["frames"] - first["frames"], 1)
        calls, triangles, points = (
            (last[key] - first[key]) / drawn for key in ("calls", "triangles", "points")
        )
        print(f"{name:44} {drawn / took:5.1f} frames/s, {1000 * spent / drawn:4.0f} ms of "
              f"processor: {calls:4.0f} calls, {triangles:6.0f} triangles, {points:7.0f} points",
              flush=True)  # fmt: skip

    def _counted(self) -> dict[str, float]:
        counted: dict[str, float] = self._tab.evaluate("() => window.whole")
        return counted


def processor_time() -> float:
    """Return the processor time of all child processes, including the browser [s]."""
    used: dict[int, tuple[int, float]] = {}
    for file in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):  # the process has ended
            fields = file.read_text().rpartition(")")[2].split()
            ticks = int(fields[11]) + int(fields[12])
            used[int(file.parent.name)] = int(fields[1]), ticks / os.sysconf("SC_CLK_TCK")
    ours, grown = {os.getpid()}, True
    while grown:
        more = {pid for pid, (parent, _) in used.items() if parent in ours} - ours
        ours, grown = ours | more, bool(more)
    return sum(used[pid][1] for pid in ours - {os.getpid()} if pid in used)


def light(page: Page, *, plain: bool) -> None:
    """Set the light of the room."""
    page.panel.plain.value = plain
    page.light.changed()


def points(page: Page, coloring: str, number: str = "") -> None:
    """Show the points of the scan; "none" hides them."""
    page.panel.cloud.value, page.panel.boxes.value = coloring, coloring != "none"
    if number:
        page.panel.points.value = number
    page.scan.changed()


def empty(watch: Watch) -> None:
    """Measure a page without a room."""
    server = open_server("127.0.0.1", 0)
    watch.open(f"http://127.0.0.1:{server.get_port()}")
    print(f"drawn by {watch.renderer}", flush=True)
    watch.turn("nothing")
    watch.close()
    with quiet():
        server.stop()


def cloud(watch: Watch) -> None:
    """Measure points only, by number and size."""
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
    """Measure the demo kitchen in both lights."""
    with tempfile.TemporaryDirectory() as folder, served(
        host="127.0.0.1", port=0, scenes=("kitchen_small",), robots=("segway_ur5e",),
        scene="kitchen_small", robot="segway_ur5e", cache=USER_CACHE, folder=Path(folder),
    ) as (page, address):  # fmt: skip
        page.work.wait(600.0)
        watch.open(address)
        for plain in (False, True):
            light(page, plain=plain)
            watch.turn(f"demo kitchen{', plain light' * plain}")
        watch.close()


def hall(watch: Watch, page: Page, address: str, rounds: int) -> None:
    """Measure the large room with its costs removed step by step, then with its scan."""
    points(page, "none")
    watch.open(address)
    for _ in range(rounds):
        light(page, plain=False)
        one_by_one(page, apart=True)
        watch.turn("large room, one mesh per object")
        one_by_one(page, apart=False)
        watch.turn("large room, merged meshes")
        light(page, plain=True)
        watch.turn("large room, merged meshes, plain light")
    first, second, _ = POINTS
    for number in (first, second):
        points(page, "by object", number)
        with all_drawn():
            watch.turn(f"and its scan, {number} points all the time")
    points(page, "by object", first)
    watch.turn("the page detects a slow browser")
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
    """Treat every browser as fast."""
    slow, playback.SLOW_FRAME_TIME = playback.SLOW_FRAME_TIME, math.inf
    try:
        yield
    finally:
        playback.SLOW_FRAME_TIME = slow


def one_by_one(page: Page, *, apart: bool) -> None:
    """Draw a large room with one mesh per object, or with merged meshes."""
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
    parser.add_argument("--seconds", type=float, default=5.0, help="duration of each measurement")
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
