"""momapos view: a web page that shows a room, a robot and its answers."""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from momapos.cli.options import OptionalPath, OptionalText
from momapos.errors import InputError, require
from momapos.files import check_outputs
from momapos.robots.names import find_named_robot, library_names
from momapos.scene.names import builtin_names, find_scene

if TYPE_CHECKING:
    from momapos.page.question import Opened

PORT = 8080
FIRST_SCENE, FIRST_ROBOT = "kitchen_small", "segway_ur5e"
_PLAN = "momapos-plan"
_HEAD = 300
"""A plan says within so many bytes that it is one."""


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

    The page can be reached from this machine alone, unless another address is given. All browsers
    see the same. It ends with Ctrl-C.

    Args:
        source: A scene file, the name of a built-in kitchen, or a plan file.
        robot: A library robot or a robot file; by default the one of the plan.
        scene_root: Folder for what a plan names and does not lie beside it.
        static: Write a solved plan as one page that plays without a server, and serve nothing.
        host: The address on which the page can be reached; 0.0.0.0 for all of this machine.
        port: Its port; 0 for any that is free.
    """
    is_plan = _is_plan(source)
    if not is_plan:
        find_scene(source)
        find_named_robot(robot or FIRST_ROBOT)
    if static is not None:
        if not is_plan:
            raise InputError(
                f"--static shows a plan, and {source} is none; momapos place ... --out plan.json "
                "writes one"
            )
        check_outputs([static])
    with require("view"):
        import viser  # noqa: F401
    opened = _opened(Path(source), scene_root, robot) if is_plan else None
    if static is not None and opened is not None:
        from momapos.page.static import write_page

        write_page(opened.scene, opened.robot, opened.plan, static)
        print(f"{static}: {static.stat().st_size / 1e6:.1f} MB, plays in any browser")
        return 0
    return _serve(source, robot or FIRST_ROBOT, opened, host, port)


def _serve(source: str, robot: str, opened: Opened | None, host: str, port: int) -> int:
    from momapos.cache import user_cache
    from momapos.cli.compile import ANSWER, RANK, compile_once
    from momapos.page.origin import LOOPBACK
    from momapos.page.serve import served

    if host not in LOOPBACK:
        print(
            f"momapos: {host} is no loopback address: whoever can reach this machine can use the "
            "page, and write plans and scenes into this folder",
            file=sys.stderr,
        )
    compile_once((*ANSWER, *RANK))
    machine = robot if opened is None else opened.robot.source
    with served(
        host=host, port=port, scene=source, robot=machine, cache=user_cache(), folder=Path.cwd(),
        scenes=tuple(dict.fromkeys((source, *builtin_names()))),
        robots=tuple(dict.fromkeys((machine, *library_names()))), opened=opened,
    ) as (page, address):  # fmt: skip
        print(f"momapos: {address} shows {source} (Ctrl-C ends it)", flush=True)
        with contextlib.suppress(KeyboardInterrupt):  # how it is ended
            page.server.sleep_forever()
    return 0


def _is_plan(source: str) -> bool:
    """Whether a file calls itself a plan; what else is wrong with it its reader says."""
    path = Path(source)
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD)
    except (OSError, ValueError):  # a name, or what the reader of scenes refuses
        return False
    return f'"{_PLAN}"'.encode() in head


def _opened(path: Path, scene_root: Path | None, robot: str | None) -> Opened:
    from momapos.cli.plan_files import open_plan
    from momapos.page.question import Opened

    plan, scene, machine = open_plan(path, scene_root, robot, "to show")
    return Opened(str(path), scene, machine, plan)
