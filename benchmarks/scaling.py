"""Measure how the processor time of an answer grows with objects, waypoints and samples.

    python benchmarks/scaling.py [--out docs/images/scaling.png]

The task is always the same: segway_ur5e opens the microwave of kitchen_small. Added objects are
boxes on the floor of a hall around the kitchen.
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from momapos.model.scene import Scene, SceneObject, load_scene
from momapos.planning import PipelineConfig, plan_base_placement
from momapos.planning.grasps import MotionConfig, make_task
from momapos.planning.placement import PlaceConfig
from placement import arm
from rows import commands

REPEATS = 5
LABELS = {
    "objects": "objects in the room", "waypoints": "waypoints of the motion",
    "samples": "base poses sampled",
}  # fmt: skip
TICKS = (20, 50, 100, 200, 500, 1000)
"""Times that are marked [ms]."""


def crowd(scene: Scene, count: int) -> Scene:
    """Add boxes outside the kitchen, up to a number of objects."""
    rng = np.random.default_rng(0)
    more = []
    for i in range(count - len(scene.objects)):
        angle = rng.uniform(0, 2 * np.pi)
        x, y = np.array([2.0, -2.0]) + rng.uniform(4.0, 6.0) * np.array(
            [np.cos(angle), np.sin(angle)]
        )
        size = rng.uniform(0.1, 0.5, 3)
        more.append(SceneObject.box(f"box_{i}", size, (x, y, size[2] / 2), category="box"))
    return replace(scene, objects=(*scene.objects[: max(count, 1)], *more), floor_polygon=None)


def main(out: Path | None = None) -> None:
    """Measure the three curves, print them, and draw them.

    Args:
        out: PNG file.
    """
    robot, reach = arm("segway_ur5e")
    kitchen = load_scene("kitchen_small")

    def seconds(scene: Scene, config: PipelineConfig) -> float:
        task = make_task(scene, "open", "microwave")
        times = []
        for _ in range(REPEATS + 1):
            began = time.process_time()
            plan_base_placement(scene, robot, task, reach, config=config)
            times.append(time.process_time() - began)
        return float(np.median(times[1:]))

    plain = PipelineConfig()
    curves = {
        "objects": {n: seconds(crowd(kitchen, n), plain) for n in (10, 30, 100, 300, 1000)},
        "waypoints": {
            n: seconds(kitchen, PipelineConfig(motion=MotionConfig(waypoints=n)))
            for n in (5, 10, 20, 50, 100)
        },
        "samples": {
            n: seconds(kitchen, PipelineConfig(place=PlaceConfig(count=n)))
            for n in (64, 256, 1024, 4096)
        },
    }
    for name, curve in curves.items():
        print(f"{name:<10}" + "  ".join(f"{n}: {1000 * t:.0f} ms" for n, t in curve.items()))
    if out:
        draw(curves, out)


def draw(curves: dict[str, dict[int, float]], path: Path) -> None:
    """Draw three panels, time over size."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(16, 6.4), dpi=100, layout="constrained")
    for ax, (name, curve) in zip(figure.subplots(1, 3, sharey=True), curves.items(), strict=True):
        sizes, times = list(curve), [1000 * t for t in curve.values()]
        ax.loglog(sizes, times, "o-", color="#0072b2", linewidth=4, markersize=11)
        for size, took in zip(sizes, times, strict=True):
            ax.annotate(f"{took:.0f}", (size, took), (0, 13), textcoords="offset points",
                        fontsize=17, ha="center", color="#0072b2")  # fmt: skip
        ax.set_title(LABELS[name], fontsize=22)
        ax.margins(x=0.1)
        ax.set_xticks(sizes, [f"{size:,}" for size in sizes], fontsize=17)
        ax.set_yticks(TICKS, [f"{tick:g}" for tick in TICKS], fontsize=17)
        ax.minorticks_off()
        ax.set(ylim=(TICKS[0], TICKS[-1]))
        ax.grid(alpha=0.3)
        for side in ("top", "right"):
            ax.spines[side].set_visible(False)
    figure.axes[0].set_ylabel("processor time of an answer [ms]", fontsize=20)
    FigureCanvasAgg(figure).print_png(str(path))


if __name__ == "__main__":
    commands(__doc__, main)
