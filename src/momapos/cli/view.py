"""momapos view: a web page that shows a room, a robot and its answers."""

from __future__ import annotations

import sys
from pathlib import Path

from tyro.conf import Positional

from momapos.errors import require
from momapos.robots.names import find_named_robot, library_names
from momapos.scene.names import builtin_names, find_scene

PORT = 8080
FIRST = "kitchen_small"


def view(
    source: Positional[str] = FIRST,
    /,
    *,
    robot: str = "segway_ur5e",
    host: str = "127.0.0.1",
    port: int = PORT,
) -> int:
    """Show a room and a robot on a web page: ask, drag the base, watch the answer move.

    The page can be reached from this machine alone, unless another address is given. All browsers
    see the same. It ends with Ctrl-C.

    Args:
        source: A scene file or the name of a built-in kitchen.
        robot: A library robot or a robot file.
        host: The address on which the page can be reached; 0.0.0.0 for all of this machine.
        port: Its port; 0 for any that is free.
    """
    find_scene(source)
    find_named_robot(robot)
    with require("view"):
        import viser  # noqa: F401
    from momapos.cache import user_cache
    from momapos.cli.compile import ANSWER, RANK, compile_once
    from momapos.page.serve import LOOPBACK, served

    if host not in LOOPBACK:
        print(
            f"momapos: {host} is no loopback address: whoever can reach this machine can use the "
            "page, and write plans and scenes into this folder",
            file=sys.stderr,
        )
    compile_once((*ANSWER, *RANK))
    choices = {
        "scenes": tuple(dict.fromkeys((source, *builtin_names()))),
        "robots": tuple(dict.fromkeys((robot, *library_names()))),
    }
    with served(
        host=host, port=port, scene=source, robot=robot, cache=user_cache(), folder=Path.cwd(),
        **choices,
    ) as (page, address):  # fmt: skip
        print(f"momapos: {address} shows {source} (Ctrl-C ends it)", flush=True)
        page.server.sleep_forever()
    return 0
