"""Provide rooms with known truth and their scans, generated once and stored in a folder."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from momapos.apps.synthetic_scans import DepthSensor, synthetic_scan, write_scan
from momapos.model.records import Scan
from momapos.model.scene import LAYOUTS, Scene, generate_kitchen, load_scene
from momapos.perception.recordings import read_scan


@dataclass(frozen=True)
class Room:
    """A room and its scan."""

    name: str
    scene: Scene
    scan: Scan


def rooms(folder: Path, count: int, frames: int = 100) -> Iterator[Room]:
    """Yield generated kitchens of all layouts in turn, each with a scan; generate missing ones."""
    for k in range(count):
        layout, seed = LAYOUTS[k % len(LAYOUTS)], k // len(LAYOUTS)
        home = folder / f"{layout}_{seed}"
        path, scan = home / "scene" / "scene.json", home / "scan"
        if not path.exists():
            generate_kitchen(layout, seed=seed, out=path)
        scene = load_scene(str(path))
        if not scan.exists():
            write_scan(synthetic_scan(scene, frames=frames, seed=seed, sensor=DepthSensor()), scan)
        yield Room(home.name, scene, read_scan(scan))
