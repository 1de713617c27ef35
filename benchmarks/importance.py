"""Measure the time of ranking, and how much the scores depend on the seed.

    python benchmarks/importance.py [--scenes DIR] [--repeats 5]

Synthetic rooms: boxes of 0.1 to 0.8 m, scattered over a floor that grows with their number, or all
at one place. Kitchens of the simulator: the BestMan scenes and their variants in DIR (the folder
that holds bestman/, by default $MOMAPOS_SHARED). Processor times, with compiled kernels and with
the scene's hulls, which the first ranking of a scene builds.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import cast

import numpy as np

from momapos.core.geometry import pose
from momapos.model.scene import Scene, SceneObject, builtin_names, load_scene
from momapos.model.urdf import Articulated, box_urdf
from momapos.planning.importance import KINDS, ImportanceConfig, ScorerName, rank
from momapos.planning.importance.config import GraphConfig
from momapos.planning.importance.scene_graph import build_graph
from momapos.planning.importance.scorers import SCORERS

SEEDS = 8
REAL = (
    "Asset/Scene/Scene/Kitchen.json", "Asset/Scene/Scene/Kitchen_1.json",
    "Asset/Scene/Scene/b512.json", "derived/kitchen_v2.json", "derived/MoMa_Kitchen.json",
)  # fmt: skip


def boxes(count: int, *, scattered: bool) -> Scene:
    """Build a room of boxes."""
    rng = np.random.default_rng(0)
    items = []
    for k in range(count):
        size = tuple(rng.uniform(0.1, 0.8, 3))
        x, y = rng.uniform(0, 0.8 * np.sqrt(count), 2) * scattered
        model = Articulated(box_urdf(f"box_{k}", size))
        items.append(SceneObject(f"box_{k}", "box", pose((x, y, size[2] / 2)), model))
    return Scene(f"{count} boxes {'scattered' if scattered else 'at one place'}", tuple(items))


def milliseconds(work: Callable[[], object], repeats: int) -> float:
    """Return the median processor time of some work [ms]."""
    times = []
    for _ in range(repeats):
        began = time.process_time()
        work()
        times.append(time.process_time() - began)
    return 1000 * float(np.median(times))


def measure(scene: Scene, target: str, repeats: int) -> str:
    """Return one row of the table."""
    first = milliseconds(lambda: build_graph(scene), 1)
    graph = build_graph(scene)
    kinds = np.bincount(graph.kind, minlength=len(KINDS))
    cells = [scene.name, str(len(scene.objects)), " / ".join(map(str, kinds)), f"{first:.0f}"]
    cells.append(f"{milliseconds(lambda: build_graph(scene), repeats):.0f}")
    for scorer in SCORERS:
        config = ImportanceConfig(scorer=cast(ScorerName, scorer))
        cells.append(f"{milliseconds(partial(rank, scene, target, config), repeats):.0f}")
    cells.append(noise(scene, target))
    return f"| {' | '.join(cells)} |"


def noise(scene: Scene, target: str) -> str:
    """Return the standard deviation of deepwalk's scores over seeds, and how many cross alpha."""
    if len(scene.objects) > 100:
        return "-"
    graph = GraphConfig(edges="near")
    walks = ImportanceConfig(scorer="deepwalk", weights="scaled", exceed=False, graph=graph)
    runs = [rank(scene, target, walks, seed=seed) for seed in range(SEEDS)]
    scores = np.array([[run.score(name) for name in run.graph.names] for run in runs])
    mean, alpha = scores.mean(0), runs[0].alpha
    related = mean > 1e-3
    changes = ((scores >= alpha) != (mean >= alpha)).mean()
    return f"{scores[:, related].std(0).mean():.3f}, {100 * changes:.1f} %"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=Path, default=os.environ.get("MOMAPOS_SHARED"))
    parser.add_argument("--repeats", type=int, default=5)
    args = parser.parse_args()
    scenes = [load_scene(name) for name in builtin_names()]
    folder = None if args.scenes is None else Path(args.scenes)
    if folder is not None and (folder / "data").is_dir():
        folder = folder / "data"
    if folder is not None and (folder / "bestman").is_dir():
        scenes += [load_scene(folder / "bestman" / name) for name in REAL]
    scenes += [boxes(30, scattered=True), boxes(100, scattered=True), boxes(1000, scattered=True)]
    scenes.append(boxes(1000, scattered=False))
    rank(scenes[0], scenes[0].objects[0].name)  # compiles the kernels
    head = ["room", "objects", " / ".join(KINDS), "first graph", "graph", *SCORERS, "seeds"]
    print(f"| {' | '.join(head)} |\n|{'---|' * len(head)}")
    for scene in scenes:
        fridge = [item.name for item in scene.objects if item.category == "fridge"]
        print(measure(scene, (fridge or [scene.objects[0].name])[0], args.repeats), flush=True)


if __name__ == "__main__":
    main()
