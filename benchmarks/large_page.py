"""A large room on the page: how long it takes to draw, and how many bytes go to a browser.

    python benchmarks/large_page.py [--objects 1000] [--points 2000000] [--browser]

The browser is a connection that counts. After the first load only what changes may be sent: what a
moment of a motion, another active object, and more points of the scan cost is printed apart.

With `--browser` a Chromium draws it instead, 1280 x 720, and tells how many pictures a second come
while the mouse turns the room, and what each takes of the processor; by what it draws is printed,
for without a graphics card that is all.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import shutil
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from gallery import browsing
from momapos.cache import user_cache
from momapos.page import room_view
from momapos.page.opened import OpenedScan
from momapos.page.page import Page
from momapos.page.panel import POINTS
from momapos.page.serve import served
from momapos.scan_records import Decision, Modeled
from momapos.scene.copies import copied
from momapos.scene.files import load_scene, save_scene
from momapos.scene.scene import Scene, SceneObject
from momapos.types import Cloud, Detection, Scan, UprightBox
from pages import Tab

QUIET = 2.0
"""Nothing more is sent when nothing has come for so long [s]."""
WINDOW = {"width": 1280, "height": 720}
START = (300, 360)
"""Where the mouse takes hold of the room [px]."""
SETTLED, WATCHED = 30.0, 5.0
"""A browser gets so long to take in what is new; then its pictures are counted for so long [s]."""
COUNT = """(() => {
  window.counted = {calls: 0, pictures: 0, seen: 0};
  const gl = WebGL2RenderingContext.prototype;
  for (const name of ["drawElements", "drawArrays", "drawElementsInstanced",
                      "drawArraysInstanced"]) {
    const draw = gl[name];
    gl[name] = function (...given) { window.counted.calls += 1; return draw.apply(this, given); };
  }
  const next = () => {
    if (window.counted.calls > window.counted.seen) window.counted.pictures += 1;
    window.counted.seen = window.counted.calls;
    requestAnimationFrame(next);
  };
  requestAnimationFrame(next);
})();"""
"""A page draws only when something changes, so that its pictures are those in which it drew."""
STEADY = """most => new Promise(done => {
  const began = performance.now();
  let last = began, good = 0;
  const next = () => {
    const now = performance.now();
    good = now - last < 60 ? good + 1 : 0;
    last = now;
    if (good < 30 && now - began < most) requestAnimationFrame(next); else done(now - began);
  };
  requestAnimationFrame(next);
})"""
"""What is new is taken in when the page has had time for 30 pictures in a row."""
RENDERER = """() => {
  const gl = document.querySelector("canvas").getContext("webgl2");
  return gl.getParameter(gl.getExtension("WEBGL_debug_renderer_info").UNMASKED_RENDERER_WEBGL);
}"""
ROUNDS = 2
"""So many times the two ways of drawing are compared, one after the other [-]."""
SPREAD = 40.0
"""Edge of the room [m]."""


def crowded(count: int, rng: np.random.Generator) -> Scene:
    """A large hall: the built-in kitchen, and boxes all about it."""
    kitchen = load_scene("kitchen_small")
    places = rng.uniform([8.0, 0.0], [8.0 + SPREAD, SPREAD], (count, 2))
    boxes = tuple(
        SceneObject.box(f"box_{k}", (0.5, 0.4, 0.9), (float(x), float(y), 0.45), category="box")
        for k, (x, y) in enumerate(places)
    )
    return Scene("hall", (*kitchen.objects, *boxes), start=kitchen.start)


def scanned(scene: Path, count: int, rng: np.random.Generator) -> Modeled:
    """A cloud of that many points in it, in a hundred things."""
    points = rng.uniform([0.0, -4.0, 0.0], [SPREAD, SPREAD, 2.5], (count, 3))
    cloud = Cloud(points, np.tile([0.0, 0.0, 1.0], (count, 1)),
                  rng.integers(0, 255, (count, 3)).astype(np.uint8))  # fmt: skip
    decisions = tuple(
        Decision(
            Detection(f"thing_{k}", "box", 1.0,
                      UprightBox(points[k], np.array([0.5, 0.5, 0.5]), 0.0), members),
            None, None, (), None, "",
        )
        for k, members in enumerate(np.array_split(np.arange(count // 2), 100))
    )  # fmt: skip
    return Modeled(scene, cloud, (), np.eye(4), decisions)


async def settled(tab: Tab) -> float:
    """Wait until nothing comes any more; how long anything came [s]."""
    began = time.monotonic()
    while time.monotonic() - max(tab.told.last, began) < QUIET:
        await asyncio.sleep(0.05)
    return max(tab.told.last - began, 0.0)


async def measured(page: Page, address: str) -> None:
    """Open a page, change things, and tell what was sent."""
    tab = Tab(address, 0)
    await tab.open()
    took = await settled(tab)
    print(f"a page that is opened: {tab.told.received / 1e6:6.1f} MB in {took:.1f} s, "
          f"{len(tab.told.nodes)} nodes")  # fmt: skip
    base = page.robot.base.copy()

    def drag() -> None:
        page.robot.move(base + np.array([0.1, 0.0, 0.0]))

    def activate() -> None:
        scene = page.shown.scene
        assert scene is not None
        page.room.show(scene, "oven")

    def more_points() -> None:
        page.panel.points.value = "200 thousand"
        page.scan.changed()

    def all_points() -> None:
        page.panel.points.value = "all"
        page.scan.changed()

    def fewer_points() -> None:
        page.panel.points.value = "50 thousand"
        page.scan.changed()

    changes: dict[str, Callable[[], None]] = {
        "the base is moved": drag, "another object is asked about": activate,
        "200 thousand points": more_points, "all points": all_points,
        "50 thousand again": fewer_points, "all again": all_points,
    }  # fmt: skip
    for name, change in changes.items():
        before, own = tab.told.received, time.process_time()
        change()
        took = await settled(tab)
        print(f"{name:30} {(tab.told.received - before) / 1e3:9.1f} kB in {took:.2f} s, "
              f"{time.process_time() - own:.2f} s of processor")  # fmt: skip
    await tab.close()


def pictures(page: Page, address: str) -> None:
    """Let a Chromium draw the room thing by thing, then as the page does, then with points."""
    with browsing(shutil.which("chromium") or "chromium") as browser:
        tab = browser.new_page(viewport=WINDOW)
        tab.add_init_script(COUNT)
        tab.goto(address)
        tab.locator("canvas").first.wait_for(timeout=60_000.0)
        print(f"drawn by {tab.evaluate(RENDERER)}", flush=True)
        page.panel.cloud.value = "none"
        page.scan.changed()
        most, scene, active = room_view.MOST_NODES, page.room.scene, page.room.active
        assert scene is not None
        looks = (("each thing by itself", len(scene.objects)), ("as a crowd", most))
        for name, limit in ROUNDS * looks:
            room_view.MOST_NODES = limit
            page.room.remove()
            page.room.show(scene, active)
            turn(tab, f"no points, {name}")
        page.panel.cloud.value = "by thing"
        for points in POINTS:
            page.panel.points.value = points
            page.scan.changed()
            turn(tab, f"{points} points")


def turn(tab: Any, name: str) -> None:
    """Drag the room round, and tell how many pictures came meanwhile."""
    tab.wait_for_timeout(1000 * QUIET)
    ready = QUIET + tab.evaluate(STEADY, 1000 * SETTLED) / 1000
    x, y = START
    tab.mouse.move(x, y)
    tab.mouse.down()
    first, used, began = tab.evaluate("() => window.counted"), processor_time(), time.monotonic()
    step = 0
    while time.monotonic() - began < WATCHED:
        step += 1
        tab.mouse.move(x + 3 * (step % 100), y)
    last, took = tab.evaluate("() => window.counted"), time.monotonic() - began
    spent = processor_time() - used
    tab.mouse.up()
    drawn = max(last["pictures"] - first["pictures"], 1)
    calls = (last["calls"] - first["calls"]) / drawn
    print(f"{name:32} {drawn / took:5.1f} pictures a second, {calls:5.0f} calls and "
          f"{1000 * spent / drawn:4.0f} ms of processor each; ready after {ready:.1f} s",
          flush=True)  # fmt: skip


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


def run(objects: int, points: int, *, browser: bool) -> None:
    """Serve the room, and measure."""
    rng = np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "hall.json"
        scene = crowded(objects, rng)
        modeled = scanned(file, points, rng)
        opened = OpenedScan("hall", Scan("hall", (), modeled.cloud), Path(folder), modeled)
        with copied(scene, file) as whole:
            save_scene(whole, file)
        began, own = time.monotonic(), time.process_time()
        with served(
            host="127.0.0.1", port=0, scenes=("hall",), robots=("segway_ur5e",), scene="hall",
            robot="segway_ur5e", cache=user_cache(), folder=Path(folder), opened=opened,
        ) as (page, address):  # fmt: skip
            page.work.wait(600.0)
            if page.shown.scene is None:
                raise RuntimeError(page.panel.result.content)
            print(f"loaded and drawn: {time.monotonic() - began:.1f} s, "
                  f"{time.process_time() - own:.1f} s of processor")  # fmt: skip
            if browser:
                pictures(page, address)
            else:
                asyncio.run(measured(page, address))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--objects", type=int, default=1000)
    parser.add_argument("--points", type=int, default=2_000_000)
    parser.add_argument("--browser", action="store_true")
    args = parser.parse_args()
    run(args.objects, args.points, browser=args.browser)
