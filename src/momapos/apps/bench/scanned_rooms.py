"""Rooms as a robot knows them that has scanned them: made once a room, kept in the results folder.

scans/ROOM/scene.json   the room as it was modeled, all of it
scans/ROOM/scan.json    where the true room stands in it, and what the making took
"""

from __future__ import annotations

import json
import os
import re
import shutil
import tempfile
import time
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.apps.synthetic_scans import DepthSensor, synthetic_scan
from momapos.core import FileFormatError, InputError, read_bytes_bounded, user_cache
from momapos.core.geometry import apply, compose, local_points, wrap_angle
from momapos.model.records import Scan, Task
from momapos.model.scene import Scene, load_scene
from momapos.perception import ScanConfig, Tools, default_tools, model_room, survey
from momapos.planning.grasps import hand_path, make_task
from momapos.simulation import moved, true_world

from .bench_records import Pose, from_plain, to_plain

if TYPE_CHECKING:
    from jaxtyping import Float

CONFIG = ScanConfig(voxel=0.008)
"""Finer than the scan's own: coarse voxels make a thing 2 cm wider than it is, and no hand is left
that opens so far."""
SCENE, RECORD = "scene.json", "scan.json"
MAX_BYTES = 1_000_000
MARGIN = 0.02
"""The middle of a thing is in its box in the scan, or this near to it [m]."""


@dataclass(frozen=True)
class ScanRecord:
    """What is kept of how a room was scanned and modeled."""

    frames: int
    """Images."""
    room: Pose
    """Where the true room's origin stands in the scene that was made [m], [rad]."""
    survey: Mapping[str, float]
    """Processor time by stage until every thing has its box, and for writing the scene [s]."""
    models: Mapping[str, float]
    """Processor time for looking at each thing and modeling it, by name [s]."""


@dataclass(frozen=True)
class ScannedRoom:
    """A room as it was modeled from a scan, and the true one in its frame."""

    scene: Scene
    truth: Scene
    record: ScanRecord

    def modeling(self, names: Collection[str] | None) -> float:
        """Processor time from the images to a scene with models of some things, or of all [s]."""
        models = self.record.models
        chosen = models if names is None else [name for name in models if name in names]
        return sum(self.record.survey.values()) + sum(models[name] for name in chosen)

    def start(self, pose: Float[np.ndarray, "3"] | None) -> Float[np.ndarray, "3"] | None:
        """A base pose of the true room, in the scene that was made."""
        return None if pose is None else compose(np.array(self.record.room), pose[None])[0]

    def in_room(self, pose: Pose) -> Pose:
        """A base pose of the scene that was made, in the true room."""
        x, y, turn = self.record.room
        (back,) = local_points(np.array([x, y, turn]), np.array([pose[:2]])).tolist()
        return back[0], back[1], float(wrap_angle(pose[2] - turn))

    def task(self, verb: str, name: str, joint: str | None, to: float | None) -> Task | None:
        """What a task in the true room means in the scene; None where nothing stands for it.

        Args:
            verb, name, joint, to: As for `make_task` in the true room.

        Raises:
            TaskError: The true room has no such task, or the scene's model does not allow it.
        """
        asked = make_task(self.truth, verb, name, joint, to)
        if asked.joint is None:
            found = self._thing_at(hand_path(self.truth, name)[0])
            return None if found is None else make_task(self.scene, asked.verb, found)
        handle = hand_path(self.truth, name, asked.joint, asked.to)[0]
        try:
            there = true_world(self.scene, self.truth, asked, handle).task
        except InputError:  # nothing that opens was seen there
            return None
        return make_task(self.scene, asked.verb, there.object, there.joint, there.to)

    def _thing_at(self, point: Float[np.ndarray, "3"]) -> str | None:
        """The smallest thing around a point."""
        around = [
            item
            for item in self.scene.objects
            for low, high in [item.bounds]
            if (point >= low - MARGIN).all() and (point <= high + MARGIN).all()
        ]
        smallest = min(around, key=lambda item: float(np.ptp(item.bounds, 0).prod()), default=None)
        return None if smallest is None else smallest.name


def scanned_room(folder: Path, name: str, truth: Scene, frames: int, seed: int) -> ScannedRoom:
    """A room by its scan; it is scanned and modeled where the folder does not hold it yet.

    Args:
        folder: The results folder.
        name: Of the room, as tasks have it.
        truth: The room as it is.
        frames: Images of the scan.
        seed: Of materials, route and noise.

    Raises:
        InputError: It cannot be written, or nothing is found in the scan.
        MissingExtraError: What reads scans is not installed.
    """
    home = folder / "scans" / re.sub(r"[^A-Za-z0-9_.-]", "_", Path(name).stem)
    if not (home / RECORD).exists():
        _make(home, truth, frames, seed)
    record = _read(home / RECORD)
    scene = load_scene(home / SCENE, cache=user_cache())
    if truth.floor_polygon is None:  # the outline of what was seen is no end of such a room
        scene = replace(scene, floor_polygon=None)
    return ScannedRoom(scene, moved(truth, np.array(record.room)), record)


def _make(home: Path, truth: Scene, frames: int, seed: int) -> None:
    """Scan a room, model all of it and keep that, the whole of it or nothing."""
    tools = default_tools()
    images = synthetic_scan(truth, frames=frames, seed=seed, sensor=DepthSensor())
    scan = Scan(truth.name, tuple(images.frames()))
    try:
        home.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{home.name}_", dir=home.parent) as temporary:
            new = Path(temporary) / "new"
            new.mkdir()
            record = _modeled(scan, new / SCENE, tools, frames)
            (new / RECORD).write_text(json.dumps(to_plain(record), indent=1) + "\n")
            if home.exists() and not (home / RECORD).exists():
                shutil.rmtree(home)
            if not home.exists():  # else another worker was quicker: one seed, one scan
                os.rename(new, home)
    except OSError as error:
        if not (home / RECORD).exists():
            why = error.strerror or error
            raise InputError(f"{home}: cannot be written ({why})") from error


def _modeled(scan: Scan, out: Path, tools: Tools, frames: int) -> ScanRecord:
    clock = time.process_time
    seen = survey(scan, tools, config=CONFIG, clock=clock)
    made = model_room(seen, out, tools, config=CONFIG, clock=clock)
    T = seen.T_scene_scan
    x, y, _ = apply(T, np.zeros((1, 3)))[0].tolist()
    turn = float(np.arctan2(T[1, 0], T[0, 0]))
    models = {one.detection.name: one.seconds for one in made.decisions}
    spent = {**seen.timing, "write": made.timing["write"]}
    return ScanRecord(frames, (x, y, turn), spent, models)


def _read(path: Path) -> ScanRecord:
    try:
        data = json.loads(read_bytes_bounded(path, MAX_BYTES))
    except (ValueError, RecursionError) as error:
        raise FileFormatError(f"{path}: damaged JSON ({error})") from error
    return from_plain(data, ScanRecord, str(path))
