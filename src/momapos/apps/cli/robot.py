"""momapos robot: list, show, check and export robots."""

from __future__ import annotations

import json as json_format
import math
import shlex
import tomllib
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import Positional, arg

from momapos.apps.plots import check_figure_path
from momapos.core import RobotError, check_outputs, say
from momapos.model.robots import (
    MAP_JOINTS,
    export_robot,
    find_named_robot,
    library_file,
    library_names,
)

from .bounds import within_bounds
from .console import progress
from .options import BoxArg, Flag, HomeArg, OptionalFile, PackagesArg, RobotArg, XacroArg

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from momapos.model.robots import Derived, Expanded, Robot, RobotTest

SOLVED = 0
_ROW = "{:<14} {:>4} {:>6} {:>9} {:>12}  {:<12} {}"
DERIVED_FROM = (".urdf", ".xml", ".xacro")
"""Endings of files that robot files are derived from."""


def robot_list(*, json: Flag = False) -> int:
    """List the library robots.

    Args:
        json: Print one JSON object instead of a table.
    """
    robots = [_in_short(name) for name in library_names()]
    if json:
        say(json_format.dumps({"robots": robots}, indent=1))
        return SOLVED
    say(_ROW.format("name", "arms", "joints", "reach [m]", "payload [kg]", "drive", "map"))
    for robot in robots:
        cells = {key: "-" if value is None else value for key, value in robot.items()}
        say(_ROW.format(*(str(value) for value in cells.values())))
    say("Use a name or a robot file as --robot; 'momapos robot check FILE.urdf' writes one.")
    return SOLVED


def _in_short(name: str) -> dict[str, Any]:
    """Return the row of a library robot, from its robot file alone."""
    file = library_file(name)
    data = tomllib.loads(file.read_text(encoding="utf-8"))
    arms = list(data.get("arms", {"": data}).values())
    return {
        "name": data["name"],
        "arms": len(arms),
        "joints": len(arms[0]["arm_joints"]),
        "reach": arms[0].get("reach"),
        "payload": arms[0].get("payload"),
        "drive": data["base"]["drive"],
        "map": _map_of(file, len(arms[0]["arm_joints"])),
    }


def _map_of(file: Path, joints: int) -> str:
    """Return where the map of a library robot comes from."""
    if any(file.parent.glob("*.reach")):
        return "built in"
    return "at first use" if joints >= MAP_JOINTS else "none"


def robot_show(name: RobotArg, /, *, json: Flag = False) -> int:
    """Show a robot: joints, tool, footprint and inverse kinematics.

    Args:
        name: A library robot or a robot file.
        json: Print one JSON object instead of text.
    """
    find_named_robot(name)  # reports a mistyped name before anything heavy is imported
    from momapos.model.robots import load_robot

    facts = describe(load_robot(name))
    lines = [as_text(facts), *(f"  note      {text}" for text in facts["notes"])]
    say(json_format.dumps(facts, indent=1) if json else "\n".join(lines))
    return SOLVED


def robot_check(
    file: Annotated[Positional[Path], arg(metavar="FILE")],
    /,
    *,
    out: OptionalFile = None,
    on_box: BoxArg = None,
    package: PackagesArg = (),
    xacro_arg: XacroArg = (),
    visual_hulls: Flag = False,
    home: HomeArg = (),
    plot: OptionalFile = None,
    json: Flag = False,
) -> int:
    """Check a robot file, or derive one from a URDF, xacro or MJCF file.

    From a URDF, momapos guesses the base, the arms, their tools, a home configuration and the pairs
    of links that always touch. It prints every guess and writes the robot file for you to correct.

    Args:
        file: A robot file (TOML), a URDF, a xacro file, or MJCF with one robot.
        out: The robot file to write (default: the URDF's name with .toml).
        on_box: Put an arm without a base on a driving box of this size, LENGTHxWIDTHxHEIGHT [m].
        package: Folder of a ROS package that the file names, as NAME=DIR.
        xacro_arg: An argument of a xacro file, as NAME=VALUE.
        visual_hulls: Let the hulls of what is drawn stand in for bodies without collision shapes.
        home: The value of an arm's joint at home [m], [rad], instead of a guess; the arm's other
            joints rest at zero.
        plot: Draw the robot at home, from above and from its right (PNG, SVG or PDF).
        json: Print one JSON object instead of text.
    """
    check_outputs([out, plot])
    check_figure_path(plot)
    packages = package_folders(package)
    args, box = pairs(xacro_arg, "--xacro-arg", empty=True), _box(on_box)
    homes = {name: _value(name, word) for name, word in pairs(home, "--home").items()}
    derives = file.suffix.lower() in DERIVED_FROM
    if not derives:
        if (out, on_box, package, xacro_arg, visual_hulls, home) != (None, None, (), (), False, ()):
            raise RobotError(
                "--out, --on-box, --package, --xacro-arg, --visual-hulls and --home need a URDF; "
                f"{file} is a robot file"
            )
        find_named_robot(str(file))
        return check_robot(file, None, plot, json=json)
    from momapos.model.robots import Mount, RobotSource
    from momapos.workflows import is_mjcf, read_description

    mount = None if box is None else Mount((0.0, 0.0, box[2]), box=box)
    source = RobotSource(file, mount, packages, visual_hulls=visual_hulls, home=homes)
    robot = out or file.with_suffix(".toml")

    def described() -> Expanded | None:
        if not file.is_file() or not is_mjcf(file):
            return None
        return read_description(file, packages, args, f"{robot.stem}_meshes/")

    def derive(**options: Any) -> tuple[Path, Derived]:
        from momapos.model.robots import write_robot

        return write_robot(source, out, args=args, expanded=described(), **options)

    return check_robot(file, derive, plot, json=json)


def package_folders(words: Sequence[str]) -> dict[str, Path]:
    """Return the folders of --package by name.

    Raises:
        RobotError: A word is not NAME=DIR, or there is no such folder.
    """
    packages = {name: Path(folder) for name, folder in pairs(words, "--package").items()}
    for name, folder in packages.items():
        if not folder.is_dir():
            raise RobotError(f"--package {name}={folder}: no such folder")
    return packages


def check_robot(
    file: Path,
    derive: Callable[..., tuple[Path, Derived]] | None,
    plot: Path | None,
    *,
    json: bool,
) -> int:
    """Derive a robot file if needed, test it, and print what is known about it.

    Args:
        file: The robot file, or what it is derived from.
        derive: Writes the robot file, by `write_robot`; None if it exists.
        plot: See `robot_check`.
        json: See `robot_check`.
    """
    from momapos.core import USER_CACHE
    from momapos.model.robots import blocking, examine, load_arms
    from momapos.workflows import self_test

    from .compile import ANSWER, CHECK, compile_once

    if file.is_file():
        compile_once((*ANSWER, *CHECK))
    guesses: tuple[str, ...] = ()
    tests: list[RobotTest] = []
    what = f"{file}: checking it, with its meshes,"
    with progress(f"robot check {file.name}") as report, within_bounds(what):
        if derive is not None:

            def inspect(arms: Sequence[Robot]) -> None:
                report(0.9, "self-test")
                tests.extend(self_test(arms))

            file, derived = derive(cache=USER_CACHE, report=report, inspect=inspect)
            guesses = derived.assumptions
        arms = load_arms(file)
        tests = tests or list(self_test(arms))
        report(0.95, "searching for errors")
        doubts = [_of_arm(text, robot) for robot in arms for text in examine(robot)]
        shares = [_of_arm(text, robot) for robot in arms for text in blocking(robot)]
    if plot is not None:
        from momapos.apps.plots import draw_robot

        draw_robot(arms[0], plot, arms[1:])
    facts = {
        **describe(arms[0]), "written": bool(guesses), "assumptions": list(guesses),
        "self_test": [asdict(test) for test in tests],
        "doubts": doubts, "self_collision": shares, "plot": None if plot is None else str(plot),
        "arms": {robot.arm: describe(robot) for robot in arms if robot.arm}, "next": _next(arms[0]),
    }  # fmt: skip
    if json:
        say(json_format.dumps(facts, indent=1))
        return SOLVED
    _print_checked(arms, guesses, tests, doubts, shares, plot)
    return SOLVED


def _print_checked(
    arms: Sequence[Robot],
    guesses: Sequence[str],
    tests: Sequence[RobotTest],
    doubts: Sequence[str],
    shares: Sequence[str],
    plot: Path | None,
) -> None:
    failed = [f"FAILED: {_of_test(test)}; {test.remedy}" for test in tests if test.passed is False]
    important = [text for text in guesses if text.startswith("IMPORTANT")]
    first = [*failed, *important]
    if first:
        say("\n".join(first) + "\n")
    for robot in arms:
        say(as_text(describe(robot)))
    notes = () if guesses else arms[0].model.urdf.notes  # the guesses include them
    say("\n".join(f"  note      {text}" for text in notes), end="\n" * bool(notes))
    if guesses:
        say(f"\nwritten to {arms[0].path}; please check these assumptions:")
        say("\n".join(f"  - {text}" for text in guesses if text not in important))
    say("\nself-test:")
    say("\n".join(f"  {_mark(test)} {_of_test(test)}" for test in tests))
    if shares:
        say("\nlink pairs that collide in most arm configurations:")
        say("\n".join(f"  - {text}" for text in shares))
    if doubts:
        say("\nlikely errors:")
        say("\n".join(f"  - {text}" for text in doubts))
    if plot is not None:
        say(f"\nplot: {plot}")
    say(f"\nnext: {_next(arms[0])}")


def _of_test(test: RobotTest) -> str:
    arm = f"{test.arm}: " if test.arm else ""
    return f"{arm}{test.name}: {test.words}"


def _mark(test: RobotTest) -> str:
    return {True: "passed  ", False: "failed  ", None: "open    "}[test.passed]


def _next(robot: Robot) -> str:
    return f"momapos place open kitchen_small fridge/door_hinge --robot {shlex.quote(robot.source)}"


def _of_arm(text: str, robot: Robot) -> str:
    return f"{robot.arm}: {text}" if robot.arm else text


def pairs(words: Sequence[str], option: str, *, empty: bool = False) -> dict[str, str]:
    """Parse NAME=VALUE words, whose value may be empty or not."""
    pairs = {}
    for word in words:
        name, equals, value = word.partition("=")
        if not name or not (value or (empty and equals)):
            raise RobotError(f"{option} {word!r:.80} is not NAME=VALUE")
        pairs[name] = value
    return pairs


def _value(joint: str, word: str) -> float:
    """Parse the value of a joint [m] or [rad]."""
    try:
        value = float(word)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise RobotError(f"--home {joint}={word:.80} is not a number, in m or rad")
    return value


def _box(text: str | None) -> tuple[float, float, float] | None:
    """Parse a box such as 0.6x0.5x0.9 [m]."""
    if text is None:
        return None
    words = text.removesuffix("m").split("x")
    try:
        edges = [float(word) for word in words]
    except ValueError:
        edges = []
    if len(edges) != 3 or not all(0.05 <= edge <= 3 for edge in edges):
        raise RobotError(
            f"--on-box {text!r:.80}: give LENGTHxWIDTHxHEIGHT in m, each 0.05 to 3, such as "
            "0.6x0.5x0.9"
        )
    return (edges[0], edges[1], edges[2])


def robot_export(name: RobotArg, dir: Annotated[Positional[Path], arg(metavar="DIR")], /) -> int:
    """Copy a library robot to a folder, as a start for your own robot.

    Args:
        name: A library robot.
        dir: The folder; existing files are not overwritten.
    """
    for file in export_robot(name, dir):
        say(file)
    return SOLVED


def describe(robot: Robot) -> dict[str, Any]:
    """Return the facts about a robot as plain values [m], [rad]."""
    import numpy as np

    from momapos.model.robots import robot_loads

    chain, spheres = robot.chain, robot.spheres

    def finite(value: float) -> float | None:
        return float(value) if np.isfinite(value) else None

    joints = [
        {
            "name": name,
            "kind": "prismatic" if chain.prismatic[i] else "revolute",
            "lower": finite(chain.lower[i]),
            "upper": finite(chain.upper[i]),
            "home": float(robot.home[i]),
        }
        for i, name in enumerate(chain.names)
    ]
    return {
        "name": robot.name,
        "arm": robot.arm,
        "path": str(robot.path),
        "urdf": str(robot.model.urdf.path),
        "base_link": robot.base_link,
        "tool_link": robot.tool_link,
        "gripper_links": list(robot.gripper_links),
        "joints": joints,
        "reach": round(robot.outreach, 3),
        "payload": robot.payload,
        "ik": robot.ik.name,
        "spheres": len(spheres.radius),
        "self_collision_pairs": len(spheres.pairs) + int(spheres.base_pairs.any(1).sum()),
        "pairs_never_checked": len(robot.disabled),
        "base_size": np.ptp(robot.footprint, axis=0).round(3).tolist(),
        "drive": robot.drive,
        "min_turning_radius": robot.min_turning_radius,
        "max_speed": robot.max_speed,
        "max_yaw_rate": robot.max_yaw_rate,
        "approach_axis": robot.approach_axis.tolist(),
        "closing_axis": robot.closing_axis.tolist(),
        "opening": robot.opening,
        "grips": str(robot.grips),
        "grip_force": robot.grip_force,
        "assumed": list(robot.assumed),
        "loads": list(robot_loads(robot).notes),
        "notes": list(robot.model.urdf.notes),
    }


def as_text(facts: dict[str, Any]) -> str:
    """Format the facts about a robot."""
    length, width = facts["base_size"]
    arm = f", arm {facts['arm']}" if facts["arm"] else ""
    radius = facts["min_turning_radius"]
    turning = f", turns on {radius:.2f} m" if radius else ""
    lines = [
        f"{facts['name']}{arm} ({facts['path']})",
        f"  base      {facts['base_link']}, {length:.2f} x {width:.2f} m, "
        f"{facts['drive']} drive{turning}, {facts['max_speed']:g} m/s, "
        f"{facts['max_yaw_rate']:g} rad/s",
        f"  tool      {facts['tool_link']}, opening {facts['opening']:.3f} m, "
        f"grips with {facts['grips']}, {facts['grip_force']:g} N",
        f"  reach     {facts['reach']:.2f} m from the first revolute joint, with retracted "
        "telescopes",
        f"  IK        {facts['ik']}",
        f"  collision {facts['spheres']} spheres, {facts['self_collision_pairs']} self-collision "
        f"pairs, {facts['pairs_never_checked']} disabled",
        "  joints",
    ]
    for joint in facts["joints"]:
        unit = "m" if joint["kind"] == "prismatic" else "rad"
        if joint["lower"] is None:
            span = "unlimited"
        else:
            span = f"{joint['lower']:.2f} to {joint['upper']:.2f} {unit}"
        lines.append(f"    {joint['name']:26} {span}, home {joint['home']:.2f} {unit}")
    lines += [f"  assumed   {text}" for text in facts["assumed"]]
    return "\n".join([*lines, *(f"  loads     {text}" for text in facts["loads"])])
