"""Capture the images of docs/gallery.md: ten tasks as the web page shows them.

    python benchmarks/gallery.py [--out docs/images/gallery] [--only NAME ...]

The image `view` of the page with its controls (docs/view.md) is written next to their folder. Needs
Chromium. The commands run in order in an empty folder: later ones show files of earlier ones.
"""

from __future__ import annotations

import argparse
import io
import shlex
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import chdir, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from playwright.sync_api import sync_playwright

from momapos.apps.cli.main import main
from momapos.apps.cli.view import opened_source
from momapos.apps.web import served
from momapos.apps.web.cameras import FIELD, front_of, task_viewpoint
from momapos.apps.web.extras import render
from momapos.apps.web.page import Page
from momapos.core import USER_CACHE
from momapos.core.geometry import rotation

FLAGS = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
         "--no-sandbox"]  # fmt: skip
DRAWN, KEPT = (1280, 720), (960, 540)
"""Size of a rendered and of a stored image [px]."""
COLORS = 256
"""Colors of a stored image; with more, a point cloud would take three times the space [-]."""
SMALL = {"width": 800, "height": 450}
"""Window size, which determines the text size [px]."""
LONG = 300.0
"""Timeout [s]."""
SETTLED = 3.0
"""Time within which at least a part of the pending data reaches the browser [s]."""


@dataclass(frozen=True)
class Item:
    """One image."""

    name: str
    commands: tuple[str, ...]
    """The last command shows the page; those before write the files that it shows."""
    act: Callable[[Page], None]
    """Action on the page."""
    away: float = 3.7
    """Distance of the camera from its target [m]."""
    above: float = 25.0
    """Angle at which it looks down [deg]."""
    aside: float = 0.0
    """Offset of its target to the right of the task [m]."""
    around: float = 0.0
    """Rotation around the target to the right of the page's own view [deg]."""


def placed(**layers: bool) -> Callable[[Page], None]:
    """Plan, and show some layers only."""

    def act(page: Page) -> None:
        page.place()
        shown(**layers)(page)

    return act


def shown(**layers: bool) -> Callable[[Page], None]:
    """Show some layers only."""

    def act(page: Page) -> None:
        done(page)
        for key, box in page.panel.layers.items():
            box.value = layers.get(key, False)
        page.layers.changed()
        done(page)

    return act


def planned(
    verb: str, target: str, robot: str, *, to: str = "", **layers: bool
) -> Callable[[Page], None]:
    """Set another task, and plan."""

    def act(page: Page) -> None:
        page.panel.robot.value, page.panel.verb.value = robot, verb
        page.change()
        done(page)
        page.panel.target.value = target
        page.change()
        done(page)
        page.panel.show_to(to)
        page.change()
        done(page)
        placed(**layers)(page)

    return act


def on_the_floor(**layers: bool) -> Callable[[Page], None]:
    """Show layers on the floor without the objects on them."""

    def act(page: Page) -> None:
        planned("open", "fridge/door_hinge", page.panel.robot.value)(page)
        shown(**layers)(page)
        page.robot.remove()

    return act


def in_the_middle(page: Page) -> None:
    """Show a moment at which the hand pulls."""
    motion = page.shown.story
    assert motion is not None
    times = np.linspace(0.0, motion.duration, 400)
    pulls = [motion.at(float(t)).force for t in times]
    size = [0.0 if force is None else float(np.linalg.norm(force)) for force in pulls]
    page.motion.seek(float(times[int(np.argmax(size))]))


def relations(page: Page) -> None:
    """Show the importance of objects and their relations, which furniture would hide."""
    planned("open", "fridge/door_hinge", "segway_ur5e", importance=True)(page)
    scene = page.room.scene
    assert scene is not None
    furniture = {item.name for item in scene.objects if item.category != "wall"}
    for name, nodes in page.room._nodes.items():
        for node in nodes:
            node.visible = name not in furniture
    page.robot.remove()


def points(page: Page) -> None:
    """Show the points of a scan by object, without the reconstructed scene."""
    page.panel.furniture.value = False
    page.room.set_visible(False)
    page.robot.remove()


ROBOTS = ("segway_ur5e", "fetch", "tiago", "husky_ur5e", "ranger_rm63")
ITEMS = (
    Item("fridge", ("view kitchen_small --robot segway_ur5e",),
         planned("open", "fridge/door_hinge", "segway_ur5e", path=True, waypoints=True,
               tolerance=True)),
    Item("oven", ("view kitchen_small --robot fetch",),
         planned("open", "oven/door_hinge", "fetch", to="max", path=True, waypoints=True)),
    Item("drawer", ("view kitchen_small --robot tiago",),
         planned("open", "cabinet_right/drawer_top_slide", "tiago", path=True, waypoints=True)),
    Item("reach", ("view kitchen_small --robot husky_ur5e",),
         planned("open", "fridge/door_hinge", "husky_ur5e", reach=True, waypoints=True), away=4.5),
    Item("candidates", ("view kitchen_small --robot ranger_rm63",),
         on_the_floor(candidates=True), away=3.4, above=55.0),
    Item("opening", ("view kitchen_small --robot segway_ur5e",),
         on_the_floor(opening=True), above=50.0),
    Item("graph", ("view kitchen_small --robot segway_ur5e",), relations, away=4.6, aside=1.1),
    Item("run", ("place open kitchen_small fridge/door_hinge --robot segway_ur5e --out plan.json",
                 "run plan.json --out run.json", "view run.json"), in_the_middle,
         away=3.2, around=-65.0),
    Item("scan", ("scene scan kitchen_small --out scan", "view scan --robot segway_ur5e"), points,
         away=4.3, above=32.0, around=62.0),
)  # fmt: skip


def done(page: Page) -> None:
    """Wait until no work is running."""
    for work in (page.work, page.layers):
        if not work.wait(LONG):
            raise TimeoutError("the page did not finish")


@contextmanager
def browsing(executable: str) -> Iterator[Any]:
    """Start Chromium without a window."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=executable, args=FLAGS)
        yield browser
        browser.close()


def image_of(item: Item, browser: Any) -> Image.Image:
    """Return the page's image of an item."""
    for command in item.commands[:-1]:
        main(shlex.split(command))
    _, source, *options = shlex.split(item.commands[-1])
    robot = options[1] if options else None
    with opened_source(source, robot) as opened, served(
        host="127.0.0.1", port=0, scenes=(source,), robots=ROBOTS,
        scene=source, robot=robot or ROBOTS[0], cache=USER_CACHE, folder=Path.cwd(),
        opened=opened,
    ) as (page, address):  # fmt: skip
        done(page)
        item.act(page)
        done(page)
        if page.panel.card.shown.headline == "Error":
            raise RuntimeError(f"{item.name}: {page.panel.card.text}")
        aim(page, item)
        tab = browser.new_page(viewport=SMALL)
        tab.goto(address)
        tab.locator("canvas").first.wait_for(timeout=1000 * LONG)
        ends = time.monotonic() + LONG
        while not page.server.get_clients() and time.monotonic() < ends:
            time.sleep(0.1)
        (client,) = page.server.get_clients().values()
        pixels = settled(client)
        tab.close()
    return Image.fromarray(pixels)


def whole_page(browser: Any) -> Image.Image:
    """Return an image of the page with its controls and an answer."""
    with served(
        host="127.0.0.1", port=0, scenes=("kitchen_small",), robots=ROBOTS[:1],
        scene="kitchen_small", robot=ROBOTS[0], cache=USER_CACHE, folder=Path.cwd(),
    ) as (page, address):  # fmt: skip
        done(page)
        page.place()
        done(page)
        tab = browser.new_page(viewport=dict(zip(("width", "height"), DRAWN, strict=True)))
        tab.goto(address)
        tab.get_by_text("Solved").wait_for(timeout=1000 * LONG)
        # A browser without a GPU shows a warning.
        remark = tab.locator(".mantine-Notification-closeButton")
        if remark.count():
            remark.first.click(force=True, timeout=1000 * LONG)
        before, ends = b"", time.monotonic() + LONG
        while time.monotonic() < ends:
            time.sleep(SETTLED)
            pixels = tab.screenshot(timeout=1000 * LONG)
            if pixels == before:
                break
            before = pixels
        tab.close()
    return Image.open(io.BytesIO(before)).convert("RGB")


def fewer_colors(drawn: Image.Image) -> Image.Image:
    """Return an image with fewer colors."""
    # The median cut would give thin lines another color, since few pixels have theirs. Dithering
    # keeps the sky smooth.
    palette = drawn.quantize(COLORS, method=Image.Quantize.MAXCOVERAGE, kmeans=1)
    return drawn.quantize(palette=palette, dither=Image.Dither.FLOYDSTEINBERG)


def keep(drawn: Image.Image, file: Path) -> None:
    """Write an image and print its size."""
    drawn.save(file, optimize=True)
    print(f"{file}: {file.stat().st_size / 1e3:.0f} kB", flush=True)


def aim(page: Page, item: Item) -> None:
    """Aim the camera at robot and object, from the side of the page's own view."""
    scene, question = page.shown.scene, page.shown.question
    assert scene is not None
    assert question is not None
    name = question.target.partition("/")[0]
    target, base = scene.object(name).bounds.mean(0), page.robot.base
    front = front_of(scene, question.target, base)
    eye, seen = task_viewpoint(scene, name, front, base[None])
    middle = np.append((target[:2] + page.robot.base[:2]) / 2, 0.8)
    back = (eye - seen)[:2] / np.linalg.norm((eye - seen)[:2])
    back = rotation(np.radians(item.around)) @ back
    steep = np.radians(item.above)
    camera = page.server.initial_camera
    look_at = middle + item.aside * np.array([-back[1], back[0], 0.0])
    camera.position = look_at + item.away * np.append(np.cos(steep) * back, np.sin(steep))
    camera.look_at, camera.up = look_at, np.array([0.0, 0.0, 1.0])
    camera.fov = float(FIELD)
    page.robot.show_handle(False)


def settled(client: Any) -> np.ndarray:
    """Return the browser's image once all data, including light, has arrived."""
    before, ends = np.zeros(0), time.monotonic() + LONG
    while time.monotonic() < ends:
        time.sleep(SETTLED)
        pixels = render(client, DRAWN, timeout=LONG)
        if np.array_equal(pixels, before):
            break
        before = pixels
    return before


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("docs/images/gallery"))
    names = [item.name for item in ITEMS] + ["view"]
    parser.add_argument("--only", nargs="*", choices=names, default=names)
    parser.add_argument("--chromium", default=shutil.which("chromium") or "chromium")
    args = parser.parse_args()
    out = args.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder, chdir(folder), browsing(args.chromium) as browser:
        for item in (one for one in ITEMS if one.name in args.only):
            drawn = image_of(item, browser).resize(KEPT, Image.Resampling.LANCZOS)
            keep(fewer_colors(drawn), out / f"{item.name}.png")
        if "view" in args.only:
            keep(whole_page(browser), out.parent / "view.png")
