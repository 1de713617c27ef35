"""Run a command; turn errors into one line and an exit status.

Exit status: 0 solved; 1 plan invalid or run failed (verify, run); 2 unusable input; 3 no feasible
base pose; 4 out of time.
"""

from __future__ import annotations

import gc
import importlib
import io
import os
import sys
from collections.abc import Callable, Sequence
from contextlib import redirect_stdout, suppress

COMMANDS: dict[str, tuple[str, str | dict[str, str]]] = {
    "place": (
        "plan base poses and motions to open, close, press, pick, place, bring, reach or follow",
        {
            "open": "tour:place_open", "close": "tour:place_close",
            "press": "place:place_press",
            "pick": "place:place_pick", "place": "place:place_place",
            "bring": "tour:place_bring", "reach": "tour:place_reach",
            "follow": "tour:place_follow",
        },
    ),
    "view": ("show a scene, a plan or a run on a web page; plan there", "view:view"),
    "verify": ("check a plan independently, from its files", "verify:verify"),
    "run": ("execute a plan in a physics simulation", "run:run"),
    "export": ("write plans and runs for ROS 2, MoveIt, Foxglove, spreadsheets", "export:export"),
    "rank": ("score which objects matter for a task", "rank:rank_objects"),
    "scene": (
        "list, show, check, generate, convert and scan scenes",
        {
            "list": "scene:scene_list", "show": "scene:scene_show",
            "check": "scene:scene_check", "new": "scene:scene_new",
            "convert": "scene:scene_convert", "scan": "scan_synthetic:scene_scan",
        },
    ),
    "robot": (
        "list, show, check, build and export robots",
        {
            "list": "robot:robot_list", "show": "robot:robot_show",
            "check": "robot:robot_check", "build": "robot_build:robot_build",
            "export": "robot:robot_export",
        },
    ),
    "scan": ("build an articulated scene from a scan of a room", "scan:scan_room"),
    "models": (
        "list and download detector weights",
        {"list": "models:models_list", "get": "models:models_get"},
    ),
    "solve": ("go from a scan to an executed task in one command", "solve:solve"),
    "schema": ("print the JSON Schema of a file format", "schema:schema"),
    "reach": (
        "build and evaluate reachability maps, study how a surface is reached",
        {
            "build": "reach:reach_build", "eval": "reach:reach_eval",
            "study": "reach_study:reach_study",
        },
    ),
    "bench": (
        "compare methods: run a suite of tasks, report the results",
        {
            "run": "bench:bench_run", "report": "bench:bench_report",
            "data": "bench:bench_data",
        },
    ),
}  # fmt: skip
"""Summary of each command, and its function, or those of its subcommands, in `momapos.apps.cli`.

Command modules import nothing heavy, so that help, completion, lists and name errors are fast.
"""
EXAMPLES = """examples:
  momapos place open kitchen_small fridge/door_hinge --robot segway_ur5e --plot plan.png
  momapos place open kitchen.json cabinet/door_left --robot fetch --to 90deg --out plan.json
  momapos place open kitchen_small cabinet_right/drawer_top_slide then pick bottle --out tour.json
  momapos place bring kitchen_small bottle --to table --out bring.json
  momapos verify plan.json
  momapos run plan.json --record film.png
  momapos rank kitchen_small fridge --plot graph.png
  momapos robot check my_robot.urdf --plot robot.png"""
HELP = ("-h", "--help")
HELP_ALL = "--help-all"
COMPLETION = "--tyro-print-completion"
COMPLETE = f"""shell completion, in bash or zsh, and in fish:
  eval "$(momapos {COMPLETION} bash)"
  momapos {COMPLETION} fish | source"""


def main(argv: Sequence[str] | None = None, *, began: float | None = None) -> int:
    """Run a command and return its exit status.

    Args:
        argv: The words of the command; those of the process by default.
        began: Processor time from which a time limit counts [s]; now by default.
    """
    from .bounds import counting_from

    try:
        with counting_from(began):
            return _run(list(sys.argv[1:] if argv is None else argv))
    except SystemExit as leaving:  # tyro exits on --help and on wrong arguments
        return leaving.code if isinstance(leaving.code, int) else 0 if leaving.code is None else 2
    except BrokenPipeError:
        return 0
    except KeyboardInterrupt:
        print("momapos: interrupted", file=sys.stderr)
        return 130
    except MemoryError:
        print(
            "momapos: not enough memory; use a smaller input, or close other programs",
            file=sys.stderr,
        )
        return 2
    except Exception as error:
        from momapos.core import MomaposError, OutOfTimeError, one_line

        if not isinstance(error, MomaposError | OSError):
            raise
        print(f"momapos: {one_line(str(error))}", file=sys.stderr)
        return 4 if isinstance(error, OutOfTimeError) else 2


def _run(args: list[str]) -> int:
    if not args or args[0] in HELP:
        print(_overview())
        return 0 if args else 2
    if args[0] == "--version":
        from momapos import __version__

        print(f"momapos {__version__}")
        return 0
    from momapos.core import unknown_name

    name, rest = args[0], args[1:]
    if name == COMPLETION:
        return _print_completion(rest)
    if name == "--complete-names":
        from .names import names_for

        print(*names_for(rest or [""]), sep="\n")
        return 0
    if name not in COMMANDS:
        raise unknown_name("command", name, COMMANDS, "momapos")
    if name == "place" and "then" in rest and HELP_ALL not in rest:
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
    command = _load(function)
    if HELP_ALL in rest and (used := getattr(sys.modules[command.__module__], "SETTINGS", None)):
        from .configuration import all_fields

        print(all_fields(used))
        return 0
    from .parse import parse

    return parse(command, rest, prog)()


def _load(function: str) -> Callable[..., int]:
    from .parse import with_time_limit

    module, name = function.split(":")
    return with_time_limit(getattr(importlib.import_module(f"momapos.apps.cli.{module}"), name))


def _print_completion(shell: list[str]) -> int:
    """Print a script that makes a shell complete all commands and their options.

    This needs one tyro application of all commands. Commands don't run through it, because it
    loads the options of every command first and reports a mistake in several lines.
    """
    from tyro.conf import FlagCreatePairsOff
    from tyro.extras import SubcommandApp

    from momapos.core import InputError

    from .names import SHELLS, completion_script

    if len(shell) != 1 or shell[0] not in SHELLS:
        raise InputError(f"{COMPLETION} needs one of {', '.join(SHELLS)}")
    app = SubcommandApp()
    for name, (_, functions) in COMMANDS.items():
        if isinstance(functions, str):
            app.command(name=name)(_load(functions))
            continue
        group = SubcommandApp()
        for sub, function in functions.items():
            group.command(name=sub)(_load(function))
        app.command(group, name=name)
    printed = io.StringIO()
    with redirect_stdout(printed), suppress(SystemExit):  # tyro exits after printing
        app.cli(prog="momapos", args=[COMPLETION, *shell], config=(FlagCreatePairsOff,))
    print(completion_script(shell[0], printed.getvalue()))
    return 0


def _overview() -> str:
    lines = ["usage: momapos COMMAND ...", "", "commands:"]
    lines += [f"  {name:<8} {text}" for name, (text, _) in COMMANDS.items()]
    lines += [
        "",
        "momapos COMMAND --help shows the options of a command.",
        "",
        EXAMPLES,
        "",
        COMPLETE,
    ]
    return "\n".join(lines)


def _group(name: str, functions: dict[str, str]) -> str:
    lines = [f"usage: momapos {name} {{{','.join(functions)}}} ...", "", COMMANDS[name][0], ""]
    for sub, function in functions.items():
        first = (_load(function).__doc__ or "").partition("\n")[0]
        lines.append(f"  {sub:<8} {first}")
    return "\n".join(
        [*lines, "", f"momapos {name} {next(iter(functions))} --help shows the options."]
    )


def entry() -> None:
    """Console script."""
    if isinstance(sys.stdout, io.TextIOWrapper):  # names may have letters that a terminal lacks
        sys.stdout.reconfigure(errors="backslashreplace")
    status = main(began=0.0)
    try:
        sys.stdout.flush()
    except BrokenPipeError:  # the reader, such as head, has closed it; Python would say so at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    gc.freeze()  # else Python looks for garbage among all objects at exit, which takes 0.2 to 0.5 s
    sys.exit(status)
