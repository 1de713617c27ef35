"""Export runs as a set of episodes, for `momapos export`."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from momapos.core import InputError, MomaposError, check_outputs, resolved, say, temporary_folder

from .loading import print_warnings
from .plan_sources import file_format, open_run

if TYPE_CHECKING:
    from momapos.apps.export import Camera, Episode
    from momapos.model.scene import Scene

SETS = {"lerobot": "_lerobot", "hdf5": ".hdf5"}
"""Ending of the name of each kind of set."""
MAX_SIZE = 2048
"""Largest width and height of an image [px]."""
MAX_RUNS = 1_000_000


def export_episodes(
    source: Path, to: str, out: Path | None, scene_root: Path | None, robot: str | None,
    cameras: str, size: str,
) -> None:  # fmt: skip
    """Write the runs of a record or of a folder of records as one set.

    Raises:
        MomaposError: A file is unusable, or the set cannot be written; then nothing is written.
    """
    chosen, pixels = _cameras(cameras), _size(size)
    runs = _runs(source)
    target = Path(resolved(source).stem + SETS[to]) if out is None else out
    if target.exists() or target.is_symlink():
        raise InputError(f"{target}: exists already; remove it, or choose another name with --out")
    check_outputs(folders=[target.absolute().parent])
    from momapos.apps.export import write_hdf5, write_lerobot

    from .console import progress

    rooms: dict[Path, Scene] = {}
    without_arm = 0
    with progress(f"{len(runs)} runs") as report:

        def episodes() -> Iterator[tuple[str, Episode]]:
            nonlocal without_arm
            for done, run in enumerate(runs):
                episode = _episode(run, scene_root, robot, chosen, pixels, rooms)
                if episode is not None:
                    yield str(run), episode
                else:
                    without_arm += 1
                report((done + 1) / len(runs))
            if without_arm == len(runs):
                raise InputError(f"{source}: no run came so far that the arm moved")

        target.parent.mkdir(parents=True, exist_ok=True)
        with temporary_folder(target.absolute().parent, target.name) as folder:
            draft = folder / "set"
            if to == "lerobot":
                count = write_lerobot(episodes(), draft)
            else:
                count = write_hdf5(episodes(), draft)
            draft.rename(target)
    if without_arm:
        ended = f"{source}: {without_arm} of {len(runs)} runs ended before the arm moved"
        print_warnings([f"{ended}; they are left out"])
    say(f"{target}: {count} episodes")


def _episode(
    run: Path, scene_root: Path | None, robot: str | None, cameras: tuple[Camera, ...],
    size: tuple[int, int], rooms: dict[Path, Scene],
) -> Episode | None:  # fmt: skip
    """Return a run as an episode; None if it ended before the arm moved."""
    from momapos.apps.export import episode_of

    record, _, scene, machine = open_run(
        run, scene_root, robot, "to export", allow_assumed=True, read=rooms
    )
    if record.motion is not None and record.motion.times and not record.motion.joints:
        return None
    try:
        return episode_of(record, scene, machine, cameras, size)
    except MomaposError as error:
        raise InputError(f"{run}: {error}") from error


def _runs(source: Path) -> list[Path]:
    """Return the run records that a name stands for, in order.

    Raises:
        InputError: There are none.
    """
    if not source.is_dir():
        return [source]
    found = sorted(
        path for path in source.glob("*.json")
        if path.is_file() and not path.name.startswith(".") and file_format(path) == "momapos-run"
    )  # fmt: skip
    if not found or len(found) > MAX_RUNS:
        raise InputError(
            f"{source}: needs 1 to {MAX_RUNS} run records (momapos run PLAN --out FILE), not "
            f"{len(found)}"
        )
    return found


def _cameras(text: str) -> tuple[Camera, ...]:
    from momapos.apps.export import CAMERAS

    names = [] if text == "none" else text.split(",")
    chosen = tuple(camera for camera in CAMERAS if camera in names)
    if len(chosen) != len(names):
        raise InputError(
            f"--cameras must name some of {', '.join(CAMERAS)}, or be none, not {json.dumps(text)}"
        )
    return chosen


def _size(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d{1,4})x(\d{1,4})", text)
    if match is None or not all(8 <= int(side) <= MAX_SIZE for side in match.groups()):
        raise InputError(
            f"--image-size must be WIDTHxHEIGHT, each from 8 to {MAX_SIZE} px, not "
            f"{json.dumps(text)}"
        )
    return int(match[1]), int(match[2])
