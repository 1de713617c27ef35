"""`momapos robot`: list, show, check and export robots."""

from __future__ import annotations

import json as json_format
import shlex
import shutil
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Any

from momapos.apps.plots import check_picture
from momapos.core import RobotError, check_outputs, unknown_name
from momapos.model.robots import LIBRARY, MAP_JOINTS, find_named_robot, library_file, library_names

from .bounds import within_bounds
from .console import progress
from .options import BoxArg, OptionalPath, PackagesArg, XacroArg

if TYPE_CHECKING:
    from collections.abc import Sequence

    from momapos.model.robots import Robot

SOLVED = 0
_ROW = "{:<14} {:>4} {:>6} {:>9} {:>12}  {:<12} {}"
DERIVED_FROM = (".urdf", ".xml", ".xacro")
"""Endings of files that a robot file is derived from."""


def robot_list(*, json: bool = False) -> int:
    """List the robots that come with momapos.

    Args:
        json: Print one JSON object instead of a table.
    """
    robots = [_in_short(name) for name in library_names()]
    if json:
        print(json_format.dumps({"robots": robots}, indent=1))
        return SOLVED
    print(_ROW.format("name", "arms", "joints", "reach [m]", "payload [kg]", "drive", "map"))
    for robot in robots:
        cells = {key: "-" if value is None else value for key, value in robot.items()}
        print(_ROW.format(*(str(value) for value in cells.values())))
    print("Use a name as --robot, or a robot file; 'momapos robot check FILE.urdf' makes one.")
    return SOLVED


def _in_short(name: str) -> dict[str, Any]:
    """What `robot list` tells of a library robot, from its robot file alone."""
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
    """Whether a library robot brings a map; an arm of fewer than six joints has none."""
    if any(file.parent.glob("*.reach")):
        return "built in"
    return "at first use" if joints >= MAP_JOINTS else "none"


def robot_show(name: str, /, *, json: bool = False) -> int:
    """Show a robot: its joints, tool, footprint and how its arm is inverted.

    Args:
        name: Name of a robot in the library, or a robot file.
        json: Print one JSON object instead of text.
    """
    find_named_robot(name)  # a mistyped name is told before anything heavy is imported
    from momapos.core import user_cache
    from momapos.model.robots import load_robot

    facts = describe(load_robot(name, cache=user_cache()))
    print(json_format.dumps(facts, indent=1) if json else as_text(facts))
    return SOLVED


def robot_check(
    file: Path,
    /,
    *,
    out: OptionalPath = None,
    on_box: BoxArg = None,
    package: PackagesArg = (),
    xacro_arg: XacroArg = (),
    plot: OptionalPath = None,
    json: bool = False,
) -> int:
    """Check a robot file, or derive one from a URDF or xacro file alone.

    From a URDF, the base, the arms, their tools, a home state and the pairs of links that cannot
    help touching are guessed; every guess is printed, and the robot file is written for you to
    correct.

    Args:
        file: A robot file (TOML), a URDF or a xacro file.
        out: The robot file to write; where not given, the URDF's name with .toml.
        on_box: Put an arm that has no base on a box that drives, LENGTHxWIDTHxHEIGHT [m].
        package: Where a package lies that the file names, as NAME=DIR; repeatable.
        xacro_arg: Value of an argument of a xacro file, as NAME=VALUE; repeatable.
        plot: Draw the robot at home, from above and from its right, into this file (PNG, SVG, PDF).
        json: Print one JSON object instead of text.
    """
    check_outputs([out, plot])
    check_picture(plot)
    packages = {name: Path(folder) for name, folder in _pairs(package, "--package").items()}
    args, box = _pairs(xacro_arg, "--xacro-arg"), _box(on_box)
    derives = file.suffix.lower() in DERIVED_FROM
    if not derives:
        if (out, on_box, package, xacro_arg) != (None, None, (), ()):
            raise RobotError(
                f"--out, --on-box, --package and --xacro-arg are for a URDF; {file} is a robot file"
            )
        find_named_robot(str(file))
    for name, folder in packages.items():
        if not folder.is_dir():
            raise RobotError(f"--package {name}={folder}: there is no such folder")
    from momapos.core import user_cache
    from momapos.model.robots import blocking, examine, load_arms

    cache = user_cache()
    guesses: tuple[str, ...] = ()
    what = f"{file}: checking it, with its meshes,"
    with progress(f"robot check {file.name}") as report, within_bounds(what):
        if derives:
            from momapos.model.robots import Mount, Source, write_robot

            mount = None if box is None else Mount((0.0, 0.0, box[2]), box=box)
            source = Source(file, mount, packages)
            file, derived = write_robot(source, out, args=args, cache=cache, report=report)
            guesses = derived.assumptions
        arms = load_arms(file, cache=cache)
        report(0.95, "looking for what is wrong")
        doubts = [_of_arm(text, robot) for robot in arms for text in examine(robot)]
        shares = [_of_arm(text, robot) for robot in arms for text in blocking(robot)]
    if plot is not None:
        from momapos.apps.plots import draw_robot

        draw_robot(arms[0], plot, arms[1:])
    facts = {
        **describe(arms[0]), "written": bool(guesses), "assumptions": list(guesses),
        "doubts": doubts, "self_collision": shares, "plot": None if plot is None else str(plot),
        "arms": {robot.arm: describe(robot) for robot in arms if robot.arm}, "next": _next(arms[0]),
    }  # fmt: skip
    if json:
        print(json_format.dumps(facts, indent=1))
        return SOLVED
    _print_checked(arms, guesses, doubts, shares, plot)
    return SOLVED


def _print_checked(
    arms: Sequence[Robot],
    guesses: Sequence[str],
    doubts: Sequence[str],
    shares: Sequence[str],
    plot: Path | None,
) -> None:
    first = [text for text in guesses if text.startswith("IMPORTANT")]
    if first:
        print("\n".join(first) + "\n")
    for robot in arms:
        print(as_text(describe(robot)))
    if guesses:
        print(f"\nwritten to {arms[0].path}; what was assumed, please check:")
        print("\n".join(f"  - {text}" for text in guesses if text not in first))
    if shares:
        print("\npairs of links that block most states of the arm:")
        print("\n".join(f"  - {text}" for text in shares))
    if doubts:
        print("\nthis looks wrong:")
        print("\n".join(f"  - {text}" for text in doubts))
    if plot is not None:
        print(f"\ndrawn in {plot}")
    print(f"\nnext: {_next(arms[0])}")


def _next(robot: Robot) -> str:
    """The one line to run next."""
    return f"momapos place open kitchen_small fridge/door_hinge --robot {shlex.quote(robot.source)}"


def _of_arm(text: str, robot: Robot) -> str:
    return f"{robot.arm}: {text}" if robot.arm else text


def _pairs(words: Sequence[str], option: str) -> dict[str, str]:
    """What stands before and after the equals sign of each word."""
    pairs = {}
    for word in words:
        name, _, value = word.partition("=")
        if not name or not value:
            raise RobotError(f"{option} {word!r:.80} is not NAME=VALUE")
        pairs[name] = value
    return pairs


def _box(text: str | None) -> tuple[float, float, float] | None:
    """The edges of a box, written as 0.6x0.5x0.9 [m]."""
    if text is None:
        return None
    words = text.removesuffix("m").split("x")
    try:
        edges = [float(word) for word in words]
    except ValueError:
        edges = []
    if len(edges) != 3 or not all(0.05 <= edge <= 3 for edge in edges):
        raise RobotError(
            f"--on-box {text!r:.80}: give length x width x height in m, each 0.05 to 3, as "
            "0.6x0.5x0.9"
        )
    return (edges[0], edges[1], edges[2])


def robot_export(name: str, dir: Path, /) -> int:
    """Copy a robot of the library into a folder, to start a robot of your own from.

    Args:
        name: Name of a robot in the library.
        dir: The folder; files in it are not overwritten.
    """
    if name not in library_names():
        raise unknown_name("robot", name, library_names(), "the library")
    source = LIBRARY / name
    files = [path for path in sorted(source.rglob("*")) if path.is_file()]
    check_outputs(folders=[dir])
    taken = [path for path in files if (dir / path.relative_to(source)).exists()]
    if taken:
        raise RobotError(
            f"{dir / taken[0].relative_to(source)}: exists already; choose a new folder"
        )
    for path in files:
        target = dir / path.relative_to(source)
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, target)
        except OSError as error:
            raise RobotError(f"{target}: cannot be written ({error.strerror})") from error
        print(target)
    return SOLVED


def describe(robot: Robot) -> dict[str, Any]:
    """What `robot show` tells, as plain values [m], [rad]."""
    import numpy as np

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
        "max_speed": robot.max_speed,
        "max_yaw_rate": robot.max_yaw_rate,
        "approach_axis": robot.approach_axis.tolist(),
        "closing_axis": robot.closing_axis.tolist(),
        "opening": robot.opening,
        "grips": str(robot.grips),
        "grip_force": robot.grip_force,
        "assumed": list(robot.assumed),
    }


def as_text(facts: dict[str, Any]) -> str:
    """The facts about a robot, for people."""
    length, width = facts["base_size"]
    arm = f", arm {facts['arm']}" if facts["arm"] else ""
    lines = [
        f"{facts['name']}{arm} ({facts['path']})",
        f"  base      {facts['base_link']}, {length:.2f} x {width:.2f} m, {facts['drive']} drive, "
        f"{facts['max_speed']:g} m/s, {facts['max_yaw_rate']:g} rad/s",
        f"  tool      {facts['tool_link']}, opens {facts['opening']:.3f} m, "
        f"holds by {facts['grips']} with {facts['grip_force']:g} N",
        f"  reach     at most {facts['reach']:.2f} m from where the first turning joint is when "
        "telescopes are drawn in",
        f"  inverse   {facts['ik']}",
        f"  collision {facts['spheres']} spheres, {facts['self_collision_pairs']} pairs checked, "
        f"{facts['pairs_never_checked']} never",
        "  joints",
    ]
    for joint in facts["joints"]:
        if joint["lower"] is None:
            span = "without end"
        else:
            span = f"{joint['lower']:.2f} to {joint['upper']:.2f}"
        unit = "m" if joint["kind"] == "prismatic" else "rad"
        lines.append(f"    {joint['name']:26} {span} {unit}, home {joint['home']:.2f}")
    return "\n".join([*lines, *(f"  assumed   {text}" for text in facts["assumed"])])
