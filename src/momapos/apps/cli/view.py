"""momapos view: a web page that shows a room, a robot and its answers."""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from momapos.core import InputError, check_outputs, require
from momapos.model.robots import find_named_robot, library_names
from momapos.model.scene import builtin_names, find_scene

from .options import OptionalPath, OptionalText
from .view_sources import kind_of, opened_source, source_in

if TYPE_CHECKING:
    from momapos.apps.web import Opened, OpenedScan

PORT = 8080
FIRST_SCENE, FIRST_ROBOT = "kitchen_small", "segway_ur5e"


def view(
    source: Positional[str] = FIRST_SCENE,
    /,
    *,
    robot: OptionalText = None,
    scene_root: OptionalPath = None,
    static: OptionalPath = None,
    host: str = "127.0.0.1",
    port: int = PORT,
) -> int:
    """Show a room and a robot on a web page: ask, drag the base, watch the answer move.

    A plan plays, a tour task by task, a run as physics did it; of a scan the points are shown and a
    scene is made.

    The page can be reached from this machine alone, unless another address is given. All browsers
    see the same. It ends with Ctrl-C.

    Args:
        source: A scene file, the name of a built-in kitchen, a plan, a tour, the record of a run,
            a scan, or a folder that momapos solve has written.
        robot: A library robot or a robot file; by default the one of the plan.
        scene_root: Folder for what a plan names and does not lie beside it.
        static: Write a solved plan, tour or run as one page that plays without a server; serve
            nothing.
        host: The address on which the page can be reached; 0.0.0.0 for all of this machine.
        port: Its port; 0 for any that is free.
    """
    source = source_in(source)
    kind = kind_of(source)
    if kind == "scene":
        find_scene(source)
    if kind in ("scene", "scan"):
        find_named_robot(robot or FIRST_ROBOT)
    if static is not None:
        if kind not in ("plan", "run"):
            raise InputError(
                f"--static shows a plan or a run, and {source} is none; momapos place ... --out "
                "plan.json writes one"
            )
        check_outputs([static])
    with require("view"):
        import viser  # noqa: F401
    with opened_source(source, robot, scene_root) as opened:
        if static is not None:
            _write(opened, static)
            return 0
        return _serve(source, robot or FIRST_ROBOT, opened, host, port)


def _write(opened: Opened | OpenedScan | None, static: Path) -> None:
    from momapos.apps.web import Opened, write_page

    assert isinstance(opened, Opened), "a plan or a run"
    write_page(
        opened.scene, opened.robot, opened.plan, static, story=opened.story(),
        active=opened.question.target.partition("/")[0],
    )  # fmt: skip
    print(f"{static}: {static.stat().st_size / 1e6:.1f} MB, plays in any browser")


def _serve(
    source: str, robot: str, opened: Opened | OpenedScan | None, host: str, port: int
) -> int:
    from momapos.apps.web import LOOPBACK, Opened, served
    from momapos.core import user_cache

    from .compile import ANSWER, RANK, compile_once

    if host not in LOOPBACK:
        print(
            f"momapos: {host} is no loopback address: whoever can reach this machine can use the "
            "page, and write plans and scenes into this folder",
            file=sys.stderr,
        )
    compile_once((*ANSWER, *RANK))
    machine = opened.robot.source if isinstance(opened, Opened) else robot
    with served(
        host=host, port=port, scene=source, robot=machine, cache=user_cache(), folder=Path.cwd(),
        scenes=tuple(dict.fromkeys((source, *builtin_names()))),
        robots=tuple(dict.fromkeys((machine, *library_names()))), opened=opened,
    ) as (page, address):  # fmt: skip
        print(f"momapos: {address} shows {source} (Ctrl-C ends it)", flush=True)
        with contextlib.suppress(KeyboardInterrupt):  # how it is ended
            page.server.sleep_forever()
    return 0
