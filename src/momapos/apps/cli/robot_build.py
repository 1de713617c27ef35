"""momapos robot build: join a base, a mast, arms and grippers into one robot."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import arg

from momapos.apps.plots import check_figure_path
from momapos.core import RobotError, check_outputs, parse_quantity, unknown_name

from .options import (
    Flag,
    LinksArg,
    OptionalFile,
    PackagesArg,
    PartsArg,
    PosesArg,
    XacroArg,
)
from .robot import check_robot, package_folders, pairs

if TYPE_CHECKING:
    from momapos.model.robots import Derived, RobotPart

BASE, MAST, ARM, GRIPPER = "base", "mast", "arm", "gripper"
_NAMED = re.compile(r"(\w+)=(.*)", re.DOTALL)


def robot_build(
    *,
    base: Annotated[Path, arg(metavar="FILE")],
    arm: PartsArg,
    gripper: PartsArg = (),
    mast: OptionalFile = None,
    at: PosesArg = (),
    on: LinksArg = (),
    out: OptionalFile = None,
    package: PackagesArg = (),
    xacro_arg: XacroArg = (),
    visual_hulls: Flag = False,
    plot: OptionalFile = None,
    json: Flag = False,
) -> int:
    """Build a robot from the descriptions of its parts: URDF, xacro or MJCF files.

    The parts become one URDF, from which a robot file is derived and tested as by 'robot check'.
    The parts are named base, mast, arm and gripper; several arms have names of their own, such as
    left, and their grippers are named left_gripper.

    Args:
        base: The mobile base.
        arm: An arm; several as NAME=FILE, with the option repeated.
        gripper: The gripper of each arm, or of one as ARM=FILE.
        mast: What stands between the base and the arms, such as a mast.
        at: Position [m] and roll, pitch, yaw [rad] or with unit of a part in the link that carries
            it; without a name, of the arm.
        on: The link that carries a part; without a name, the arm. By default a gripper or arm is on
            the tip of the arm or mast, and a mast or arm on the root link of the base.
        out: The robot file to write, next to its URDF (default: BASE_ARM.toml in this folder).
        package: Folder of a ROS package that a file names, as NAME=DIR.
        xacro_arg: An argument of all xacro files as NAME=VALUE, or of one as PART/NAME=VALUE.
        visual_hulls: Let the hulls of what is drawn stand in for bodies without collision shapes.
        plot: Draw the robot at home, from above and from its right (PNG, SVG or PDF).
        json: Print one JSON object instead of text.
    """
    check_outputs([out, plot])
    check_figure_path(plot)
    packages = package_folders(package)
    files = _files(base, mast, arm, gripper)
    carriers = _carriers(files, on)
    poses = _poses(files, at)
    args = _arguments(files, xacro_arg)
    for name, (_, below) in files.items():
        if below == BASE and name not in poses and name not in carriers:
            raise RobotError(
                f"{name}: give its place on the base: --at {name}=X,Y,Z,R,P,Y in its root link, or "
                f"--on {name}=LINK"
            )
    names = [file.name.partition(".")[0] for file, _ in files.values()]
    robot = out or Path(f"{names[0]}_{names[2 if mast else 1]}.toml")

    def derive(**options: Any) -> tuple[Path, Derived]:
        from momapos.model.robots import RobotPart, RobotSource, join_parts, write_robot
        from momapos.workflows import read_description

        parts: list[RobotPart] = []
        for name, (file, below) in files.items():
            meshes = f"{robot.stem}_meshes/{name}_"
            content = read_description(file, packages, args[name], meshes)
            other, link = carriers.get(name, (below, None))
            xyz, rpy = poses.get(name, ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
            parts.append(RobotPart(name, file, content, other, link, xyz, rpy))
        source = RobotSource(robot.with_suffix(".urdf"), visual_hulls=visual_hulls)
        joined = join_parts(robot.stem, parts)
        return write_robot(source, robot, expanded=joined, **options)

    return check_robot(base, derive, plot, json=json)


def _files(
    base: Path, mast: Path | None, arms: Sequence[str], grippers: Sequence[str]
) -> dict[str, tuple[Path, str]]:
    """Return the file of each part, and the part that carries it by default."""
    files = {BASE: (base, "")}
    if mast is not None:
        files[MAST] = (mast, BASE)
    named = _by_name(arms, "--arm", ARM)
    if not named:
        raise RobotError("--arm is missing; give the description of an arm: --arm FILE")
    if len(named) < len(arms) or (len(named) > 1 and ARM in named):
        raise RobotError("--arm: several arms need names, as in --arm left=FILE --arm right=FILE")
    files |= {name: (file, MAST if mast else BASE) for name, file in named.items()}
    hands = _by_name(grippers, "--gripper", "")
    if "" in hands:
        hands = dict.fromkeys(named, hands[""]) | {k: v for k, v in hands.items() if k}
    for name, file in hands.items():
        if name not in named:
            raise unknown_name("arm", name, named, "--arm (of --gripper)")
        files[GRIPPER if name == ARM else f"{name}_{GRIPPER}"] = (file, name)
    return files


def _by_name(words: Sequence[str], option: str, default: str) -> dict[str, Path]:
    """Parse [NAME=]FILE words; a file that exists is never split."""
    files = {}
    for word in words:
        named = None if Path(word).exists() else _NAMED.fullmatch(word)
        name, file = (named[1], named[2]) if named else (default, word)
        if name in (BASE, MAST) or not file:
            raise RobotError(f"{option} {word!r:.80} is not [NAME=]FILE")
        files[name] = Path(file)
    return files


def _of_part(files: Mapping[str, object], word: str, option: str) -> tuple[str, str]:
    """Split [PART=]VALUE; without a name, the part is the only arm."""
    named = _NAMED.fullmatch(word)
    name, value = (named[1], named[2]) if named else (ARM, word)
    if name not in files:
        raise unknown_name("part", name, files, f"the robot ({option} {word:.80})")
    return name, value


def _carriers(
    files: Mapping[str, tuple[Path, str]], on: Sequence[str]
) -> dict[str, tuple[str, str]]:
    """Return the part and its link that carry a part, where they are given."""
    found = {}
    for word in on:
        name, value = _of_part(files, word, "--on")
        other, slash, link = value.rpartition("/")
        if slash and other not in files:
            raise unknown_name("part", other, files, f"the robot (--on {word:.80})")
        if name == BASE or not link:
            raise RobotError(f"--on {word!r:.80} is not [PART=][OTHER/]LINK of a part on the base")
        found[name] = (other or files[name][1], link)
    return found


def _poses(
    files: Mapping[str, object], at: Sequence[str]
) -> dict[str, tuple[tuple[float, float, float], tuple[float, float, float]]]:
    """Return the position [m] and roll, pitch, yaw [rad] of each part that has one."""
    found = {}
    for word in at:
        name, value = _of_part(files, word, "--at")
        parts = value.split(",")
        if name == BASE or len(parts) not in (3, 6):
            raise RobotError(
                f"--at {word!r:.80} is not [PART=]X,Y,Z[,R,P,Y]; write it as 0.1,0,0.3,0,0,90deg"
            )
        numbers = [parse_quantity(part) for part in parts]
        x, y, z = (n.length(f"--at: {axis}") for n, axis in zip(numbers[:3], "XYZ", strict=True))
        turns = [n.angle(f"--at: {axis}") for n, axis in zip(numbers[3:], "RPY", strict=False)]
        roll, pitch, yaw = turns or (0.0, 0.0, 0.0)
        found[name] = ((x, y, z), (roll, pitch, yaw))
    return found


def _arguments(files: Mapping[str, object], words: Sequence[str]) -> dict[str, dict[str, str]]:
    """Return the arguments of the xacro file of each part."""
    found: dict[str, dict[str, str]] = {name: {} for name in files}
    for key, value in pairs(words, "--xacro-arg", empty=True).items():
        part, slash, name = key.rpartition("/")
        if slash and part not in files:
            raise unknown_name("part", part, files, f"the robot (--xacro-arg {key:.80})")
        for one in [part] if slash else files:
            found[one][name] = value
    return found
