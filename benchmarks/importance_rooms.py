"""Rooms for the ground truth of importance: shared kitchens, and furnished built-in ones."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from momapos.core.geometry import pose
from momapos.model.scene import LAYOUTS, Scene, SceneObject, generate_kitchen, load_scene
from momapos.model.urdf import Articulated, box_urdf
from momapos.planning.grasps import openable
from placement import SCENES, shared

OBJECTS = 30
"""Number of objects of a furnished built-in kitchen, without walls [-]."""
ON_COUNTERS = {
    "cup": (0.08, 0.08, 0.1), "box": (0.08, 0.18, 0.25), "kettle": (0.18, 0.16, 0.24),
    "bread_bin": (0.35, 0.25, 0.2), "jar": (0.1, 0.1, 0.16),
}  # fmt: skip
ON_FLOOR = {"stool": (0.35, 0.35, 0.65), "bin": (0.3, 0.25, 0.5), "crate": (0.4, 0.3, 0.3)}
"""Added objects and their sizes [m]."""
FLOOR_SHARE = 0.4
"""Share of added objects on the floor [-]."""
COUNTERS = ("counter", "kitchen island", "cabinet", "dishwasher")
TOP = (0.7, 1.1)
"""Range of heights of supporting surfaces [m]."""
TRIES = 300


@dataclass(frozen=True)
class Room:
    """A scene, its source and its openable parts."""

    key: str
    source: str
    """shared or built-in."""
    scene: Scene
    targets: tuple[tuple[str, str], ...]
    """(object, joint), in the order in which they are tried."""
    most: int
    """Maximum number of tasks, each with another object [-]."""


def is_wall(item: SceneObject) -> bool:
    """Return whether an object is part of the building, which is never removed or modeled."""
    return "wall" in item.category and "cabinet" not in item.category


def shared_rooms() -> Iterator[Room]:
    """Yield the shared kitchens; every openable object is a target."""
    for name in SCENES:
        scene = load_scene(shared() / "bestman" / name)
        targets = tuple(openable(scene))
        yield Room(Path(name).stem, "shared", scene, targets, len(targets))


def built_in_rooms(folder: Path, count: int, targets: int, workers: int) -> Iterator[Room]:
    """Yield generated kitchens of all layouts in turn, with some targets in each."""
    which = [(LAYOUTS[k % len(LAYOUTS)], 1 + k // len(LAYOUTS)) for k in range(count)]
    files = [folder / f"{layout}_{seed}.json" for layout, seed in which]
    folder.mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor(workers) as pool:
        rows = list(zip(which, files, strict=True))
        made = {row[1]: pool.submit(_generate, row) for row in rows if not row[1].exists()}
        for (layout, seed), file in rows:
            if file in made:
                made[file].result()
            rng = np.random.default_rng((seed, LAYOUTS.index(layout)))
            scene = furnish(load_scene(file), rng)
            doors = openable(scene)
            shuffled = tuple(doors[i] for i in rng.permutation(len(doors)))
            yield Room(f"{layout}_{seed}", "built-in", scene, shuffled, targets)


def _generate(row: tuple[tuple[str, int], Path]) -> None:
    (layout, seed), file = row
    generate_kitchen(layout, seed=seed, out=file)


def furnish(scene: Scene, rng: np.random.Generator) -> Scene:
    """Add small objects on counters and on the floor, until there are 30 objects."""
    wanted = OBJECTS - sum(not is_wall(item) for item in scene.objects)
    for k in range(max(0, wanted)):
        on_floor = rng.random() < FLOOR_SHARE
        kinds = ON_FLOOR if on_floor else ON_COUNTERS
        kind = str(rng.choice(list(kinds)))
        size = np.array(kinds[kind])
        spot = _spot(scene, size, rng, on_floor=on_floor)
        if spot is None:
            continue
        model = Articulated(box_urdf(f"{kind}_{k}", tuple(size.tolist())))
        added = SceneObject(f"{kind}_{k}", kind.replace("_", " "), pose(spot), model)
        scene = replace(scene, objects=(*scene.objects, added))
    return scene


def _spot(
    scene: Scene, size: Float[np.ndarray, "3"], rng: np.random.Generator, *, on_floor: bool
) -> tuple[float, float, float] | None:
    """Return a center at which a box is 2 cm clear of all others [m]; None if none was found."""
    bounds = np.array([item.bounds for item in scene.objects])
    tops = [
        item.bounds for item in scene.objects
        if item.category in COUNTERS and TOP[0] < item.bounds[1, 2] < TOP[1]
    ]  # fmt: skip
    for _ in range(TRIES):
        if on_floor and scene.floor_polygon is not None:
            low, high, z = scene.floor_polygon.min(0), scene.floor_polygon.max(0), 0.0
        elif tops:
            top = tops[int(rng.integers(len(tops)))]
            low, high, z = top[0, :2], top[1, :2], float(top[1, 2])
        else:
            return None
        slack = high - low - size[:2]
        if (slack < 0).any():
            continue
        x, y = low + size[:2] / 2 + rng.random(2) * slack
        center = np.array([x, y, z + 0.001 + size[2] / 2])
        near = np.maximum(bounds[:, 0] - center, center - bounds[:, 1]) < size / 2 + [0.02, 0.02, 0]
        if not near.all(1).any():
            return tuple(center.tolist())
    return None
