"""momapos view: show a scene and plans, or one robot, on a web page."""

from __future__ import annotations

import contextlib
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, arg

from momapos.core import (
    InputError,
    MomaposError,
    UnknownNameError,
    check_outputs,
    open_regular,
    require,
    say,
    temporary_folder,
    unknown_name,
)
from momapos.model.robots import find_named_robot, library_names
from momapos.model.scene import builtin_names, find_scene

from .bounds import within_bounds
from .console import progress
from .loading import file_format, print_warnings
from .options import OptionalFile, OptionalFolder, OptionalRobot

if TYPE_CHECKING:
    from momapos.apps.web import Opened, OpenedScan


Kind = Literal["scene", "robot", "plan", "run", "scan"]
MAX_FILES = 500
"""Files of a folder that are looked at [-]."""
MAX_SCENE = 2_000_000
"""Size of a file of the folder whose format does not stand at its beginning [bytes]."""
_KINDS: dict[str, Kind] = {"momapos-plan": "plan", "momapos-run": "run", "momapos-tour": "plan"}
_SCANS = (b"ply", b"# .PCD", b"#ROSBAG", b"\x89MCAP0", b"SQLite format 3")
"""First bytes of point clouds and recordings."""


def kind_of(source: str) -> Kind:
    """Identify a source by its first bytes or its format; its reader reports everything else."""
    path = Path(source)
    suffix = path.suffix.lower()
    if source in library_names() or suffix == ".toml" or (suffix == ".urdf" and _has_arm(path)):
        return "robot"
    try:
        if path.is_dir():
            return "scan"
        with open_regular(path) as file:
            head = file.read(max(map(len, _SCANS)))
    except (OSError, ValueError, MomaposError):  # a name, or a file that the scene reader refuses
        return "scene"
    if head.startswith(_SCANS):
        return "scan"
    return _KINDS.get(file_format(path), "scene")


def _has_arm(urdf: Path) -> bool:
    """Return whether as many joints follow each other as in an arm; in furniture one or two do."""
    from momapos.model.robots import MIN_ARM_JOINTS
    from momapos.model.urdf import read_urdf

    try:
        model = read_urdf(urdf, find_mesh=lambda _: urdf, visuals=False)
    except MomaposError:  # its reader reports it
        return False
    depth = {model.root: 0}
    for joint in model.joints:
        depth[joint.child] = depth[joint.parent] + int(joint.movable and joint.mimic is None)
    return max(depth.values()) >= MIN_ARM_JOINTS


def source_in(source: str) -> str:
    """Return the record or the plan in an output folder of `momapos solve`; else the source."""
    inside = (Path(source) / name for name in ("run.json", "plan.json"))
    return next((str(path) for path in inside if path.is_file()), source)


def scenes_in(folder: Path) -> tuple[str, ...]:
    """Return the names of the scene files in a folder, which the page offers; no links."""
    found = []
    for path in sorted(folder.glob("*.json"))[:MAX_FILES]:
        usable = path.is_file() and not path.is_symlink()
        if usable and file_format(path, MAX_SCENE) == "momapos-scene":
            found.append(path.name)
    return tuple(found)


@contextmanager
def opened_source(
    source: str, robot: str | None, scene_root: Path | None = None
) -> Iterator[Opened | OpenedScan | None]:
    """Read a source for the page; None for a scene, which the page loads itself.

    Args:
        source: A file, a folder, or a name.
        robot: A library robot or a robot file; None for the robot of the plan.
        scene_root: Folder for files that are not next to the plan.

    Raises:
        MomaposError: The source can't be read.
    """
    kind = kind_of(source)
    if kind == "scene":
        yield None
    elif kind != "scan":
        yield _opened(Path(source), kind, scene_root, robot)
    else:
        with temporary_folder(Path(tempfile.gettempdir()), "momapos-scan") as folder:
            yield _scan(Path(source), folder)


def _opened(path: Path, kind: Kind, scene_root: Path | None, robot: str | None) -> Opened:
    """Read a plan, the plans of a tour, or a run with its plan."""
    from momapos.apps.web import Opened

    from .loading import open_plans, open_run, plans_of

    if kind == "plan":
        plans = open_plans(
            plans_of(path, "to show"), scene_root, robot, "to show", allow_assumed=True
        )
        first, *then = (Opened(str(path), scene, one, plan) for plan, scene, one in plans)
        return replace(first, then=tuple(then))
    record, plan, scene, machine = open_run(path, scene_root, robot, "to show", allow_assumed=True)
    return Opened(str(path), scene, machine, plan, record)


def _scan(path: Path, folder: Path) -> OpenedScan:
    from momapos.apps.web import OpenedScan
    from momapos.perception.recordings import read_scan

    scan = read_scan(path)
    print_warnings(scan.warnings)
    return OpenedScan(str(path), scan, folder)


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
    A robot alone gets sliders for its joints, shows which links touch, and saves a home.

    Only this machine can open the page, unless you give another --host. All browsers see the same
    page. Ctrl-C stops the server.

    Args:
        source: A scene file, a built-in kitchen, a plan, a tour, the record of a run, a scan, an
            output folder of `momapos solve`, or a library robot, a robot file or its URDF.
        robot: A library robot or a robot file (default: the robot of the plan).
        scene_root: Folder for files that are not next to the plan.
        static: Write a solved plan, tour or run as one page that plays without a server, and exit.
        host: Address of the page; 0.0.0.0 for all addresses of this machine.
        port: Port of the page; 0 for any free port.
    """
    source = source_in(source)
    kind = kind_of(source)
    if kind == "scene":
        try:
            find_scene(source)
        except UnknownNameError as error:
            known = (*builtin_names(), *library_names())
            raise unknown_name(
                "kitchen or robot", source[:80], known, "the built-in ones (or give a file)"
            ) from error
    if kind in ("scene", "scan"):
        find_named_robot(robot or FIRST_ROBOT)
    if kind == "robot" and robot is not None:
        raise InputError(f"--robot is for a scene, and {source} is a robot; leave out one of them")
    if static is not None:
        if kind not in ("plan", "run"):
            raise InputError(
                f"--static needs a plan or a run, and {source} is neither; momapos place ... --out "
                "plan.json writes a plan"
            )
        check_outputs([static])
    with require("view"):
        import viser  # noqa: F401
    if kind == "robot":
        return _serve_robot(robot_file(source), host, port)
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


def robot_file(source: str) -> str:
    """Return a robot name or file; of a URDF the file next to it, which is derived if missing."""
    urdf = Path(source)
    if urdf.suffix.lower() != ".urdf":
        find_named_robot(source)
        return source
    file = urdf.with_suffix(".toml")
    if not file.exists():
        from momapos.core import USER_CACHE
        from momapos.model.robots import write_robot

        what = f"{urdf}: deriving a robot file, with its meshes,"
        with progress(f"view {urdf.name}") as report, within_bounds(what):
            write_robot(urdf, cache=USER_CACHE, report=report)
        say(f"momapos: robot file written to {file}; momapos robot check {file} tests it")
    return str(file)


def _serve_robot(source: str, host: str, port: int) -> int:
    from momapos.apps.web import served_robot
    from momapos.model.robots import load_arms

    from .compile import VERIFY, compile_once

    _warn_of_others(host)
    arms = load_arms(source)
    compile_once(VERIFY)
    with served_robot(arms, Path.cwd(), host, port) as (page, address):
        say(f"momapos: {address} shows {source} (Ctrl-C stops it)", flush=True)
        with contextlib.suppress(KeyboardInterrupt):  # the way to stop it
            page.server.sleep_forever()
    return 0


def _warn_of_others(host: str) -> None:
    from momapos.apps.web import LOOPBACK

    if host not in LOOPBACK:
        say(
            f"momapos: {host} is not a loopback address: anyone who can reach this machine can use "
            "the page, and write plans, scenes and homes into files",
            file=sys.stderr,
        )


def _serve(
    source: str, robot: str, opened: Opened | OpenedScan | None, host: str, port: int
) -> int:
    from momapos.apps.web import Opened, served
    from momapos.core import USER_CACHE

    from .compile import ANSWER, RANK, compile_once

    _warn_of_others(host)
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
