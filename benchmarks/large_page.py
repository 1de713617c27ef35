"""A large room on the page: how long it takes to draw, and how many bytes go to a browser.

    python benchmarks/large_page.py [--objects 1000] [--points 2000000] [--browser]

The browser is a connection that counts. After the first load only what changes may be sent: what a
moment of a motion, another active object, and more points of the scan cost is printed apart.

With `--browser` a Chromium draws it instead, 1280 x 720, and tells how many pictures a second come
while the camera turns; by what it draws is printed, for without a graphics card that is all.
"""

from __future__ import annotations

import argparse
import asyncio
import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from gallery import browsing
from momapos.cache import user_cache
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
SETTLED, WATCHED = 8.0, 4.0
"""A browser gets so long to take in what is new; then its pictures are counted for so long [s]."""
RENDERER = """() => {
  const gl = document.querySelector("canvas").getContext("webgl2");
  return gl.getParameter(gl.getExtension("WEBGL_debug_renderer_info").UNMASKED_RENDERER_WEBGL);
}"""
RATE = """wait => new Promise(done => {
  let drawn = 0;
  const began = performance.now();
  const next = () => {
    drawn += 1;
    const past = performance.now() - began;
    if (past < wait) requestAnimationFrame(next); else done(1000 * drawn / past);
  };
  requestAnimationFrame(next);
})"""
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
        page.panel.points.value = "400 thousand"
        page.scan.changed()

    def all_points() -> None:
        page.panel.points.value = "all"
        page.scan.changed()

    def fewer_points() -> None:
        page.panel.points.value = "100 thousand"
        page.scan.changed()

    changes: dict[str, Callable[[], None]] = {
        "the base is moved": drag, "another object is asked about": activate,
        "400 thousand points": more_points, "all points": all_points,
        "100 thousand again": fewer_points, "all again": all_points,
    }  # fmt: skip
    for name, change in changes.items():
        before, own = tab.told.received, time.process_time()
        change()
        took = await settled(tab)
        print(f"{name:30} {(tab.told.received - before) / 1e3:9.1f} kB in {took:.2f} s, "
              f"{time.process_time() - own:.2f} s of processor")  # fmt: skip
    await tab.close()


def pictures(page: Page, address: str) -> None:
    """Let a Chromium draw the room without points, and with more and more of them."""
    with browsing(shutil.which("chromium") or "chromium") as browser:
        tab = browser.new_page(viewport=WINDOW)
        tab.goto(address)
        tab.locator("canvas").first.wait_for(timeout=60_000.0)
        tab.wait_for_timeout(1000 * SETTLED)
        print(f"drawn by {tab.evaluate(RENDERER)}", flush=True)
        for points in ("none", *POINTS):
            page.panel.cloud.value = "none" if points == "none" else "by thing"
            page.panel.points.value = next(iter(POINTS)) if points == "none" else points
            page.scan.changed()
            tab.wait_for_timeout(1000 * SETTLED)
            rates = []
            for _ in range(3):
                tab.mouse.move(300, 360)
                tab.mouse.down()
                tab.mouse.move(320, 360)
                rates.append(tab.evaluate(RATE, 1000 * WATCHED))
                tab.mouse.up()
            print(f"{points + ' points':22} {sorted(rates)[1]:5.1f} pictures a second", flush=True)


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
