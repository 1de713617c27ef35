"""Measure a large room on the web page: time to draw, and bytes sent to a browser.

    python benchmarks/large_page.py [--objects 1000] [--points 2000000]

A counting connection stands in for the browser. After the first load only changes may be sent. The
bytes of rest, dragging the base, playing a motion, another active object, and more points of the
scan are printed separately, with the number of meshes and clouds. `page_pictures.py` measures the
time of a frame.
"""

from __future__ import annotations

import argparse
import asyncio
import random
import tempfile
import time
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np

from hostile import CAMERA
from momapos.apps.web import OpenedScan, served
from momapos.apps.web.page import Page
from momapos.apps.web.panel import POINTS
from momapos.apps.web.playback import FRAME_GAPS, SLOW_FRAME_TIME
from momapos.core import USER_CACHE
from momapos.core.geometry import UprightBox
from momapos.model.records import Cloud, Detection, Scan
from momapos.model.scene import Scene, SceneObject, copied, load_scene, save_scene
from momapos.perception import Decision, Modeled
from pages import Tab

QUIET = 2.0
"""Time without data after which sending counts as finished [s]."""
WATCHED = 5.0
"""Duration of measuring rest and a playing motion [s]."""
SPREAD = 36.0
"""Edge of the hall [m]; with the kitchen it stays below the limit of 2,500 m^2 for driving."""


def crowded(count: int, rng: np.random.Generator) -> Scene:
    """Build a large hall: the built-in kitchen surrounded by boxes."""
    kitchen = load_scene("kitchen_small")
    places = rng.uniform([8.0, 0.0], [8.0 + SPREAD, SPREAD], (count, 2))
    boxes = tuple(
        SceneObject.box(f"box_{k}", (0.5, 0.4, 0.9), (float(x), float(y), 0.45), category="box")
        for k, (x, y) in enumerate(places)
    )
    return Scene("hall", (*kitchen.objects, *boxes), start=kitchen.start)


def scanned(scene: Path, count: int, rng: np.random.Generator) -> Modeled:
    """Build a point cloud of the hall, in 100 objects."""
    points = rng.uniform([0.0, -4.0, 0.0], [SPREAD, SPREAD, 2.5], (count, 3))
    cloud = Cloud(points, np.tile([0.0, 0.0, 1.0], (count, 1)),
                  rng.integers(0, 255, (count, 3)).astype(np.uint8))  # fmt: skip
    decisions = tuple(
        Decision(
            Detection(f"object_{k}", "box", 1.0,
                      UprightBox(points[k], np.array([0.5, 0.5, 0.5]), 0.0), members),
            None, None, (), None, "",
        )
        for k, members in enumerate(np.array_split(np.arange(count // 2), 100))
    )  # fmt: skip
    return Modeled(scene, cloud, (), np.eye(4), decisions)


async def settled(tab: Tab) -> float:
    """Wait until no more data arrives; return the time until the last data [s]."""
    began = time.monotonic()
    while time.monotonic() - max(tab.seen.last, began) < QUIET:
        await asyncio.sleep(0.05)
    return max(tab.seen.last - began, 0.0)


async def measured(page: Page, address: str) -> None:
    """Open a page, act on it, and print what was sent."""
    tab = Tab(address, 0)
    await tab.open()
    took = await settled(tab)
    print(f"opening a page: {tab.seen.received / 1e6:6.1f} MB in {took:.1f} s, "
          f"{len(tab.seen.nodes)} nodes")  # fmt: skip

    async def rest() -> None:
        await asyncio.sleep(WATCHED)

    async def drag() -> None:
        await tab.drag(random.Random(0))
        await asyncio.sleep(0.1)
        while page.follow.work.busy:
            await asyncio.sleep(0.05)

    async def place() -> None:
        await tab.press("Place")
        await asyncio.sleep(0.5)
        while tab.seen.busy:
            await asyncio.sleep(0.1)
        if page.shown.story is None:
            raise RuntimeError(page.panel.card.text)

    async def play() -> None:
        await tab.press("Play")
        await asyncio.sleep(WATCHED)
        await tab.press("Pause")

    async def turn() -> None:
        for k in range(2 * FRAME_GAPS):
            await tab.send({**CAMERA, "position": (3.0, 3.0, 3.0 + 0.1 * k)})
            await asyncio.sleep(2 * SLOW_FRAME_TIME)

    async def activate() -> None:
        assert page.shown.scene is not None
        page.room.show(page.shown.scene, "oven")

    async def show(number: str) -> None:
        page.panel.points.value = number
        page.scan.changed()

    few, more, every = POINTS
    changes: dict[str, Callable[[], Awaitable[None]]] = {
        f"{WATCHED:.0f} s of rest": rest, "the base is dragged": drag,
        "planning": place, f"{WATCHED:.0f} s of motion": play,
        "another active object": activate, "a slow camera moves and rests": turn,
        f"{more} points": partial(show, more), f"{every} points": partial(show, every),
        f"{few} again": partial(show, few), f"{every} again": partial(show, every),
    }  # fmt: skip
    for name, change in changes.items():
        before, nodes, own = tab.seen.received, tab.seen.drawn, time.process_time()
        began = time.monotonic()
        await change()
        await settled(tab)
        sent = (tab.seen.received - before) / 1e3
        print(f"{name:30} {sent:9.1f} kB and {tab.seen.drawn - nodes:3} nodes "
              f"in {max(tab.seen.last - began, 0.0):.2f} s, "
              f"{time.process_time() - own:.2f} s of processor", flush=True)  # fmt: skip
    await tab.close()


@contextmanager
def serving(objects: int, points: int) -> Iterator[tuple[Page, str]]:
    """Serve the room and its scan; yield the page and its address."""
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
            robot="segway_ur5e", cache=USER_CACHE, folder=Path(folder), opened=opened,
        ) as (page, address):  # fmt: skip
            page.work.wait(600.0)
            if page.shown.scene is None:
                raise RuntimeError(page.panel.card.text)
            print(f"loaded and drawn: {time.monotonic() - began:.1f} s, "
                  f"{time.process_time() - own:.1f} s of processor")  # fmt: skip
            yield page, address


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--objects", type=int, default=1000)
    parser.add_argument("--points", type=int, default=2_000_000)
    args = parser.parse_args()
    with serving(args.objects, args.points) as (page, address):
        asyncio.run(measured(page, address))
