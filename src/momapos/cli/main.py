"""Entry point: find the command, run it, turn errors into one line and an exit status.

Exit status: 0 solved; 1 a plan that does not hold (verify, run); 2 input that cannot be used;
3 no feasible base pose; 4 out of time.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence

COMMANDS: dict[str, tuple[str, dict[str, str] | str, str]] = {
    "place": (
        "momapos.cli.place",
        {
            "open": "place_open", "close": "place_close", "pick": "place_pick",
            "place": "place_place",
        },
        "where to stand and how to move, to open, close, pick or place something",
    ),
    "verify": ("momapos.cli.verify", "verify", "check a plan again, from the files alone"),
    "run": (
        "momapos.cli.run", "run", "carry a plan out in physics: is it really open then?",
    ),
    "rank": (
        "momapos.cli.rank", "rank_objects", "which objects matter for a task with one of them",
    ),
    "scene": (
        "momapos.cli.scene",
        {
            "list": "scene_list", "show": "scene_show", "new": "scene_new",
            "convert": "scene_convert", "scan": "momapos.cli.scan_synthetic:scene_scan",
        },
        "rooms: list, show, generate, convert, scan",
    ),
    "robot": (
        "momapos.cli.robot",
        {
            "list": "robot_list", "show": "robot_show", "check": "robot_check",
            "export": "robot_export",
        },
        "robots: list, show, check a URDF or robot file, export",
    ),
    "scan": ("momapos.cli.scan", "scan_room", "a scene that moves, from a scan of a room"),
    "reach": (
        "momapos.cli.reach",
        {"build": "reach_build", "eval": "reach_eval"},
        "reachability maps: build, evaluate",
    ),
}  # fmt: skip
EXAMPLES = """examples:
  momapos place open kitchen_small fridge/door_hinge --robot segway_ur5e --plot plan.png
  momapos place open kitchen.json cabinet/door_left --robot fetch --to 90deg --out plan.json
  momapos verify plan.json
  momapos run plan.json --record film.png
  momapos rank kitchen_small fridge --plot graph.png
  momapos robot check my_robot.urdf --plot robot.png"""
HELP = ("-h", "--help")


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command and return its exit status."""
    args = list(sys.argv[1:] if argv is None else argv)
    if not args or args[0] in HELP:
        print(_overview())
        return 0 if args else 2
    if args[0] == "--version":
        from momapos import __version__

        print(f"momapos {__version__}")
        return 0
    try:
        return _run(args)
    except SystemExit as leaving:  # tyro ends the process itself on --help and on wrong words
        return leaving.code if isinstance(leaving.code, int) else 2
    except BrokenPipeError:
        return 0
    except KeyboardInterrupt:
        print("momapos: interrupted", file=sys.stderr)
        return 130
    except Exception as error:
        from momapos.errors import MomaposError, one_line

        if not isinstance(error, MomaposError | OSError):
            raise
        print(f"momapos: {one_line(str(error))}", file=sys.stderr)
        return 2


def _run(args: list[str]) -> int:
    from momapos.errors import unknown_name

    name, rest = args[0], args[1:]
    if name not in COMMANDS:
        raise unknown_name("command", name, COMMANDS, "momapos")
    module, functions, _ = COMMANDS[name]
    if isinstance(functions, str):
        function, prog = functions, f"momapos {name}"
    else:
        if not rest or rest[0] in HELP:
            print(_group(name))
            return 0 if rest else 2
        if rest[0] not in functions:
            raise unknown_name("command", rest[0], functions, f"momapos {name}")
        function, prog = functions[rest[0]], f"momapos {name} {rest[0]}"
        rest = rest[1:]
    import tyro

    if ":" in function:  # a subcommand that has a module of its own
        module, function = function.split(":")
    run = getattr(importlib.import_module(module), function)
    result = tyro.cli(run, args=rest, prog=prog)
    return int(result)


def _overview() -> str:
    lines = ["usage: momapos COMMAND ...", "", "commands:"]
    lines += [f"  {name:<8} {text}" for name, (_, _, text) in COMMANDS.items()]
    lines += ["", "momapos COMMAND --help says more.", "", EXAMPLES]
    return "\n".join(lines)


def _group(name: str) -> str:
    _, functions, text = COMMANDS[name]
    assert isinstance(functions, dict)
    return (
        f"usage: momapos {name} {{{','.join(functions)}}} ...\n\n{text}\n\n"
        f"momapos {name} {next(iter(functions))} --help says more."
    )


def entry() -> None:
    """Console script."""
    sys.exit(main())
