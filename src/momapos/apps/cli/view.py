"""momapos view: show a scene, a robot and plans on a web page."""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from momapos.core import InputError, check_outputs, require, say
from momapos.model.robots import find_named_robot, library_names
from momapos.model.scene import builtin_names, find_scene

from .options import OptionalFile, OptionalFolder, OptionalRobot
from .view_sources import kind_of, opened_source, scenes_in, source_in

if TYPE_CHECKING:
    from momapos.apps.web import Opened, OpenedScan

PORT = 8080
FIRST_SCENE, FIRST_ROBOT = "kitchen_small", "segway_ur5e"


def view(
    source: Annotated[Positional[str], arg(metavar="SOURCE")] = FIRST_SCENE,
    /,
    *,
    robot: OptionalRobot = None,
    scene_root: OptionalFolder = None,
    static: OptionalFile = None,
    host: str = "127.0.0.1",
    port: int = PORT,
) -> int:
    """Show a scene and a robot on a web page; plan there and drag the base.

    A plan, a tour and a run are played. A scan is shown as points, and can be turned into a scene.

    Only this machine can open the page, unless you give another --host. All browsers see the same
    page. Ctrl-C stops the server.

    Args:
        source: A scene file, a built-in kitchen, a plan, a tour, the record of a run, a scan, or an
            output folder of `momapos solve`.
        robot: A library robot or a robot file (default: the robot of the plan).
        scene_root: Folder for files that are not next to the plan.
        static: Write a solved plan, tour or run as one page that plays without a server, and exit.
        host: Address of the page; 0.0.0.0 for all addresses of this machine.
        port: Port of the page; 0 for any free port.
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
                f"--static needs a plan or a run, and {source} is neither; momapos place ... --out "
                "plan.json writes a plan"
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
        active=opened.question.target, card=opened.card,
    )  # fmt: skip
    say(f"{static}: {static.stat().st_size / 1e6:.1f} MB; open it in any browser")


def _serve(
    source: str, robot: str, opened: Opened | OpenedScan | None, host: str, port: int
) -> int:
    from momapos.apps.web import LOOPBACK, Opened, served
    from momapos.core import USER_CACHE

    from .compile import ANSWER, RANK, compile_once

    if host not in LOOPBACK:
        say(
            f"momapos: {host} is not a loopback address: anyone who can reach this machine can use "
            "the page, and write plans and scenes into this folder",
            file=sys.stderr,
        )
    compile_once((*ANSWER, *RANK))
    machine = opened.robot.source if isinstance(opened, Opened) else robot
    with served(
        host=host, port=port, scene=source, robot=machine, cache=USER_CACHE, folder=Path.cwd(),
        scenes=tuple(dict.fromkeys((source, *builtin_names(), *scenes_in(Path.cwd())))),
        robots=tuple(dict.fromkeys((machine, *library_names()))), opened=opened,
    ) as (page, address):  # fmt: skip
        say(f"momapos: {address} shows {source} (Ctrl-C stops it)", flush=True)
        with contextlib.suppress(KeyboardInterrupt):  # the way to stop it
            page.server.sleep_forever()
    return 0
