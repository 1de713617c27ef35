"""Entry point: find the command, run it, turn errors into one line and an exit status.

Exit status: 0 solved; 1 a plan that does not hold (verify, run); 2 input that cannot be used;
3 no feasible base pose; 4 out of time.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Sequence

COMMANDS: dict[str, tuple[str, str | dict[str, str]]] = {
    "place": (
        "where to stand and how to move, to open, close, pick or place something",
        {
            "open": "place:place_open", "close": "place:place_close",
            "pick": "place:place_pick", "place": "place:place_place",
        },
    ),
    "view": ("a web page: ask, drag the base, watch the answer move", "view:view"),
    "verify": ("check a plan again, from the files alone", "verify:verify"),
    "run": ("carry a plan out in physics: is it really open then?", "run:run"),
    "export": ("plans and runs for ROS 2, MoveIt, Foxglove, spreadsheets", "export:export"),
    "rank": ("which objects matter for a task with one of them", "rank:rank_objects"),
    "scene": (
        "rooms: list, show, generate, convert, scan",
        {
            "list": "scene:scene_list", "show": "scene:scene_show", "new": "scene:scene_new",
            "convert": "scene:scene_convert", "scan": "scan_synthetic:scene_scan",
        },
    ),
    "robot": (
        "robots: list, show, check a URDF or robot file, export",
        {
            "list": "robot:robot_list", "show": "robot:robot_show",
            "check": "robot:robot_check", "export": "robot:robot_export",
        },
    ),
    "scan": ("a scene that moves, from a scan of a room", "scan:scan_room"),
    "models": (
        "weights of detectors: list, get",
        {"list": "models:models_list", "get": "models:models_get"},
    ),
    "solve": ("all of it: from a scan of a room to an opened door", "solve:solve"),
    "reach": (
        "reachability maps: build, evaluate",
        {"build": "reach:reach_build", "eval": "reach:reach_eval"},
    ),
    "bench": (
        "methods compared: run a suite of tasks, report on it",
        {"run": "bench:bench_run", "report": "bench:bench_report"},
    ),
}  # fmt: skip
"""What each command is for, and its function, or those of its subcommands, in `momapos.apps.cli`.

Modules of commands import nothing heavy: help, completion, lists and wrong names come at once.
"""
EXAMPLES = """examples:
  momapos place open kitchen_small fridge/door_hinge --robot segway_ur5e --plot plan.png
  momapos place open kitchen.json cabinet/door_left --robot fetch --to 90deg --out plan.json
  momapos place open kitchen_small cabinet_right/drawer_top_slide then pick bottle --out tour.json
  momapos verify plan.json
  momapos run plan.json --record film.png
  momapos rank kitchen_small fridge --plot graph.png
  momapos robot check my_robot.urdf --plot robot.png"""
HELP = ("-h", "--help")
COMPLETION = "--tyro-print-completion"
SHELLS = ("bash", "zsh", "fish")
COMPLETE = f"""completion of commands and options in bash (zsh and fish likewise):
  eval "$(momapos {COMPLETION} bash)\""""


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
        return leaving.code if isinstance(leaving.code, int) else 0 if leaving.code is None else 2
    except BrokenPipeError:
        return 0
    except KeyboardInterrupt:
        print("momapos: interrupted", file=sys.stderr)
        return 130
    except MemoryError:
        print(
            "momapos: not enough memory; give a smaller input, or close other programs",
            file=sys.stderr,
        )
        return 2
    except Exception as error:
        from momapos.core import MomaposError, one_line

        if not isinstance(error, MomaposError | OSError):
            raise
        print(f"momapos: {one_line(str(error))}", file=sys.stderr)
        return 2


def _run(args: list[str]) -> int:
    from momapos.core import unknown_name

    name, rest = args[0], args[1:]
    if name == COMPLETION:
        return _print_completion(rest)
    if name not in COMMANDS:
        raise unknown_name("command", name, COMMANDS, "momapos")
    if name == "place" and "then" in rest:
        from .tour import run_tour

        return run_tour(rest)
    function, prog = COMMANDS[name][1], f"momapos {name}"
    if isinstance(function, dict):
        if not rest or rest[0] in HELP:
            print(_group(name, function))
            return 0 if rest else 2
        if rest[0] not in function:
            raise unknown_name("command", rest[0], function, prog)
        function, prog, rest = function[rest[0]], f"{prog} {rest[0]}", rest[1:]
    from .parse import parse

    command = _load(function)
    rules = getattr(sys.modules[command.__module__], "tyro_rules", None)
    return parse(command, rest, prog, None if rules is None else rules(rest))()


def _load(function: str) -> Callable[..., int]:
    """The function of a command, as the table names it."""
    module, name = function.split(":")
    loaded: Callable[..., int] = getattr(
        importlib.import_module(f"momapos.apps.cli.{module}"), name
    )
    return loaded


def _print_completion(shell: list[str]) -> int:
    """Print what makes a shell complete all commands and their options.

    One application of all commands can do that; answers do not go through it, since it reads the
    options of every command first, and tells a wrong word in more than one line.
    """
    from tyro.extras import SubcommandApp

    from momapos.core import InputError

    if len(shell) != 1 or shell[0] not in SHELLS:
        raise InputError(f"{COMPLETION} is followed by one of {', '.join(SHELLS)}")
    app = SubcommandApp()
    for name, (_, functions) in COMMANDS.items():
        if isinstance(functions, str):
            app.command(name=name)(_load(functions))
            continue
        group = SubcommandApp()
        for sub, function in functions.items():
            group.command(name=sub)(_load(function))
        app.command(group, name=name)
    app.cli(prog="momapos", args=[COMPLETION, *shell])
    return 0


def _overview() -> str:
    lines = ["usage: momapos COMMAND ...", "", "commands:"]
    lines += [f"  {name:<8} {text}" for name, (text, _) in COMMANDS.items()]
    lines += ["", "momapos COMMAND --help says more.", "", EXAMPLES, "", COMPLETE]
    return "\n".join(lines)


def _group(name: str, functions: dict[str, str]) -> str:
    lines = [f"usage: momapos {name} {{{','.join(functions)}}} ...", "", COMMANDS[name][0], ""]
    for sub, function in functions.items():
        first = (_load(function).__doc__ or "").partition("\n")[0]
        lines.append(f"  {sub:<8} {first}")
    return "\n".join([*lines, "", f"momapos {name} {next(iter(functions))} --help says more."])


def entry() -> None:
    """Console script."""
    sys.exit(main())
