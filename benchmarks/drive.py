"""Measure random drives through kitchens, with noise: success and path length.

Starts and goals are free poses of the footprint, with a geodesic distance of at least 1.5 m for a
disc of the inscribed radius. The path length is compared with this geodesic length, which placement
uses as cost, and with that of the footprint. Prints one line per drive, then totals and failures;
for a drive without a path also whether a fine grid of poses finds one.
"""

from __future__ import annotations

import argparse
import gc
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from drive_figure import draw_drive
from drive_rooms import People, Question, connected, questions, rooms
from momapos.core.geometry import wrap_angle
from momapos.model.robots import Robot, library_names, load_robot
from momapos.model.scene import Scene
from momapos.planning.navigation import (
    DriveConfig,
    DriveRecord,
    NavigationMap,
    build_navigation_map,
    drive,
)
from momapos.planning.navigation.driving import DriveEnding


@dataclass(frozen=True, eq=False)
class Result:
    """One drive and its question."""

    room: str
    robot: Robot
    question: Question
    record: DriveRecord
    waited: Float[np.ndarray, " k"]
    """Wall time of each control step [s]; the record has processor time."""
    note: str = ""
    """Remark on a failure."""

    @property
    def row(self) -> str:
        """Return the drive as a row of the table."""
        record, question = self.record, self.question
        error = record.goal - record.pose
        return (
            f"{self.room:<16} {self.robot.name:<12} {question.disc:5.2f} "
            f"{record.length / question.disc:6.3f} {record.length / question.footprint:6.3f} "
            f"{record.time:6.1f} {100 * record.clearance:6.1f} {100 * np.hypot(*error[:2]):5.1f} "
            f"{np.degrees(abs(float(wrap_angle(error[2])))):5.2f} {record.paths:4d} "
            f"{1000 * record.step_times.max(initial=0.0):6.2f} "
            f"{1000 * self.waited.max(initial=0.0):6.1f}  {record.reason or 'arrived'}{self.note}"
        )


class _Clock:
    """Measure processor time, which excludes other programs; also record wall time."""

    def __init__(self) -> None:
        self.wall: list[float] = []

    def __call__(self) -> float:
        self.wall.append(time.perf_counter())
        return time.process_time()

    @property
    def steps(self) -> Float[np.ndarray, " k"]:
        """Return the wall time of each step [s]."""
        return np.diff(np.array(self.wall).reshape(-1, 2), axis=1)[:, 0]


def driven(
    scene: Scene, nav_map: NavigationMap, question: Question, seed: int, *, crowded: bool
) -> Result:
    """Simulate one drive."""
    clock, rng = _Clock(), np.random.default_rng(seed)
    around: dict[str, Any] = {}
    if crowded:
        walking = People(nav_map, question.start, rng)
        around = {"moving": walking, "on_pose": walking.meet}
    record = drive(nav_map, question.start, question.goal, rng=rng, clock=clock, **around)
    note = ""
    if record.ending in (DriveEnding.NO_PATH, DriveEnding.NO_PATH_FROM_ESTIMATE):
        found = connected(nav_map, question.start, question.goal)
        note = f" (a fine grid finds {'one' if found else 'none either'})"
    if record.hit == "a moving obstacle":
        stood = not np.abs(record.velocities[-3:]).max() > 0.02
        note = " while it " + ("stood" if stood else "moved")
    return Result(scene.name, nav_map.robot, question, record, clock.steps, note)


def totals(kind: str, results: list[Result]) -> str:
    """Summarize the drives of one kind of base."""
    records = [result.record for result in results]
    good = [r for r in results if r.record.arrived]
    lines = [
        f"{kind}: {len(good)} of {len(results)} drives arrived ({len(good) / len(results):.1%}), "
        f"{sum(bool(r.hit) for r in records)} with a collision"
    ]
    for name in ("disc", "footprint"):
        ratio = np.array([r.record.length / getattr(r.question, name) for r in good])
        lines.append(
            f"  length over the geodesic of the {name}: mean {ratio.mean():.3f}, "
            f"95 % {np.quantile(ratio, 0.95):.3f}, max {ratio.max():.3f}, "
            f"{(ratio > 1.15).sum()} above 1.15"
        )
    errors = np.abs([r.goal - r.pose for r in records if r.arrived])
    off, turned = 100 * np.hypot(*errors.T[:2]), np.degrees(np.abs(wrap_angle(errors[:, 2])))
    lines.append(
        f"  true error at the end: median {np.median(off):.1f} cm, max {off.max():.1f} cm, "
        f"{turned.max():.1f} degrees; smallest distance to furniture "
        f"{100 * min(r.clearance for r in records):.1f} cm; "
        f"time median {np.median([r.time for r in records if r.arrived]):.1f} s"
    )
    for name, steps in (
        ("processor", np.concatenate([r.step_times for r in records])),
        ("wall", np.concatenate([r.waited for r in results])),
    ):
        lines.append(
            f"  control step {name}: median {1000 * np.median(steps):.2f} ms, "
            f"99.9 % {1000 * np.quantile(steps, 0.999):.2f} ms, max {1000 * steps.max():.2f} ms, "
            f"{(steps > 0.005).sum()} of {len(steps)} above 5 ms"
        )
    return "\n".join(lines)


def main() -> None:
    """Run the drives and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--drives", type=int, default=200, help="total number")
    parser.add_argument("--robots", nargs="+", default=list(library_names()))
    parser.add_argument("--layouts", type=int, default=4, help="number of generated kitchens")
    parser.add_argument("--people", action="store_true", help="two people walk in each room")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--figure", type=Path, help="draw the most winding drive of kitchen_small")
    args = parser.parse_args()
    robots = [load_robot(name) for name in args.robots]
    print(
        f"{'room':<16} {'robot':<12} {'geo m':>5} {'disc':>6} {'foot':>6} {'time s':>6} "
        f"{'gap cm':>6} {'cm':>5} {'deg':>5} {'ways':>4} {'cpu ms':>6} {'ms':>6}"
    )
    results: list[Result] = []
    shown: list[tuple[Result, Scene, NavigationMap]] = []
    with tempfile.TemporaryDirectory() as folder:
        scenes = list(rooms(Path(folder), args.layouts))
        each, left = divmod(args.drives, len(scenes) * len(robots))
        warm = set()
        for n, (scene, robot) in enumerate((s, r) for s in scenes for r in robots):
            nav_map = build_navigation_map(scene, robot)
            drives = questions(nav_map, scene, np.random.default_rng(args.seed))
            for k in range(each + (n < left)):
                question = next(drives)
                if robot.drive not in warm:
                    # The first drive of a process loads the kernels.
                    driven(scene, nav_map, question, args.seed, crowded=args.people)
                    warm.add(robot.drive)
                gc.collect()
                gc.freeze()  # garbage collection must not scan the rooms within a control step
                result = driven(scene, nav_map, question, args.seed + k, crowded=args.people)
                results.append(result)
                if scene.name == "kitchen_small" and result.record.arrived:
                    shown.append((result, scene, nav_map))
                print(result.row, flush=True)
    print()
    for kind in sorted({robot.drive for robot in robots}):
        print(totals(kind, [r for r in results if r.robot.drive == kind]))
    tolerance = DriveConfig().tolerance
    print(f"arrived: within {100 * tolerance:.0f} cm and 2 degrees of the goal, true pose")
    for result in results:
        if not result.record.arrived:
            print("FAILED", result.row)
    if args.figure and shown:
        best, scene, nav_map = max(shown, key=lambda s: s[0].question.detour)
        draw_drive(scene, nav_map, best.question, best.record, args.figure)


if __name__ == "__main__":
    main()
