"""Scan and model the rooms of a run, once per room; results stay in the results folder.

scans/ROOM/scene.json   the complete model of the room
scans/ROOM/scan.json    pose of the true room in the model, and the time of modeling
"""

from __future__ import annotations

import json
import os
import re
import shutil
import time
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.apps.synthetic_scans import DepthSensor, synthetic_scan
from momapos.core import (
    FileFormatError,
    InputError,
    read_bytes_bounded,
    temporary_folder,
)
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
"""Finer than the default, whose voxels make objects 2 cm too wide for most hands."""
SCENE, RECORD = "scene.json", "scan.json"
MAX_BYTES = 1_000_000
BOX_MARGIN = 0.02
"""Maximum distance of an object's true center from its box in the scan [m]."""


@dataclass(frozen=True)
class ScanRecord:
    """Contents of scan.json."""

    frames: int
    """Number of images."""
    room: Pose
    """Pose of the true room's origin in the modeled scene [m], [rad]."""
    survey: Mapping[str, float]
    """Processor time by stage for the boxes of all objects, and for writing the scene [s]."""
    models: Mapping[str, float]
    """Processor time to model each object, by name [s]."""


@dataclass(frozen=True)
class ScannedRoom:
    """A room modeled from a scan, and the true room in the frame of the model."""

    scene: Scene
    truth: Scene
    record: ScanRecord

    @property
    def surveying(self) -> float:
        """Return the processor time from the images to the boxes of all objects [s]."""
        return sum(self.record.survey.values())

    def modeling(self, names: Collection[str] | None) -> float:
        """Return the processor time to model some objects [s].

        Args:
            names: The modeled objects; None for all.
        """
        models = self.record.models
        return sum(models[name] for name in models if names is None or name in names)

    def start(self, pose: Float[np.ndarray, "3"] | None) -> Float[np.ndarray, "3"] | None:
        """Transform a base pose from the true room to the scene."""
        return None if pose is None else compose(np.array(self.record.room), pose[None])[0]

    def in_room(self, pose: Pose) -> Pose:
        """Transform a base pose from the scene to the true room."""
        ((x, y),) = local_points(np.array(self.record.room), np.array([pose[:2]])).tolist()
        return x, y, float(wrap_angle(pose[2] - self.record.room[2]))

    def task(self, verb: str, name: str, joint: str | None, to: float | None) -> Task | None:
        """Translate a task in the true room to the scene; None if the scene has no such object.

        Args:
            verb, name, joint, to: Arguments of `make_task` in the true room.

        Raises:
            TaskError: The true room has no such task, or the scene's model does not allow it.
        """
        true_task = make_task(self.truth, verb, name, joint, to)
        if true_task.joint is None:
            found = self._object_at(hand_path(self.truth, name)[0])
            return None if found is None else make_task(self.scene, true_task.verb, found)
        handle = hand_path(self.truth, name, true_task.joint, true_task.to)[0]
        try:
            there = true_world(self.scene, self.truth, true_task, handle).task
        except InputError:  # the scan shows nothing that opens there
            return None
        return make_task(self.scene, true_task.verb, there.object, there.joint, there.to)

    def _object_at(self, point: Float[np.ndarray, "3"]) -> str | None:
        """Return the smallest object whose box contains a point."""
        around = [
            item
            for item in self.scene.objects
            for low, high in [item.bounds]
            if (point >= low - BOX_MARGIN).all() and (point <= high + BOX_MARGIN).all()
        ]
        smallest = min(around, key=lambda item: float(np.ptp(item.bounds, 0).prod()), default=None)
        return None if smallest is None else smallest.name


def scanned_room(folder: Path, name: str, truth: Scene, frames: int, seed: int) -> ScannedRoom:
    """Return a scanned room; scan and model it if the folder does not have it.

    Args:
        folder: The results folder.
        name: Name of the room in the tasks.
        truth: The true room.
        frames: Number of images of the scan.
        seed: Seed of materials, route and noise.

    Raises:
        InputError: The folder can't be written, or the scan shows nothing.
        MissingExtraError: Packages for scans are missing.
    """
    home = folder / "scans" / re.sub(r"[^A-Za-z0-9_.-]", "_", Path(name).stem)
    if not (home / RECORD).exists():
        _make(home, truth, frames, seed)
    record = _read(home / RECORD)
    scene = load_scene(home / SCENE)
    if truth.floor_polygon is None:  # the room continues beyond the scanned floor
        scene = replace(scene, floor_polygon=None)
    return ScannedRoom(scene, moved(truth, np.array(record.room)), record)


def _make(home: Path, truth: Scene, frames: int, seed: int) -> None:
    """Scan and model a room; write the complete result or nothing."""
    tools = default_tools()
    images = synthetic_scan(truth, frames=frames, seed=seed, sensor=DepthSensor())
    scan = Scan(truth.name, tuple(images.frames()))
    try:
        home.parent.mkdir(parents=True, exist_ok=True)
        with temporary_folder(home.parent, home.name) as temporary:
            new = temporary / "new"
            new.mkdir()
            record = _modeled(scan, new / SCENE, tools, frames)
            (new / RECORD).write_text(json.dumps(to_plain(record), indent=1) + "\n")
            if home.exists() and not (home / RECORD).exists():
                shutil.rmtree(home)
            if not home.exists():  # else another worker was faster, with an equal result
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
