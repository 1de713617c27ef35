"""Read what `momapos view` can show."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from momapos.core import MomaposError, open_regular, temporary_folder

from .loading import print_warnings
from .plan_sources import file_format

if TYPE_CHECKING:
    from momapos.apps.web import Opened, OpenedScan

Kind = Literal["scene", "plan", "run", "scan"]
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

    from .plan_sources import open_plans, open_run, plans_of

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
