"""Random drives through kitchens, with noise: does the base arrive, how long is its way?

Starts and goals are free poses of the footprint that a disc of the inscribed radius can drive
between, at least 1.5 m apart that way. The way's length is compared with that geodesic length, the
one that placement counts as cost. Prints a line a drive, then totals and every failure.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from momapos.geometry.polygons import inscribed_radius
from momapos.geometry.transforms import wrap_angle
from momapos.manipulation.motion import room_boxes
from momapos.navigation.clearance import gaps
from momapos.navigation.cost_map import CELL, build_cost_map, floor_plan
from momapos.navigation.drive import DriveConfig, DriveRecord, drive
from momapos.navigation.footprint_map import HEADINGS, Ground, survey
from momapos.robots.robot import library_names, load_robot
from momapos.scene.files import builtin_names, load_scene
from momapos.scene.kitchens import LAYOUTS, generate_kitchen
from momapos.scene.scene import Scene

FARTHER_THAN = 1.5
"""Geodesic length of a drive at least [m]."""
ROOM = 0.01
"""Gap around start and goal at least [m]; placement asks for the same."""


def rooms(folder: Path, layouts: int) -> Iterator[Scene]:
    """The built-in kitchens, and one of each of some generated layouts."""
    for name in builtin_names():
        yield load_scene(name)
    for seed, layout in enumerate(LAYOUTS[:layouts]):
        yield load_scene(generate_kitchen(layout, seed=seed, out=folder / f"{layout}.json"))


def questions(
    ground: Ground, scene: Scene, rng: np.random.Generator
) -> Iterator[tuple[np.ndarray, np.ndarray, float]]:
    """Random starts and goals, with the geodesic length between them."""
    robot = ground.robot
    plan = floor_plan(room_boxes(scene), height=ground.body.cut, margin=2.0, floor=scene.floor)
    states = np.argwhere(ground.free)
    while True:
        h, i, j = states[rng.integers(len(states), size=2)].T
        xy = ground.origin + (np.stack([j, i], -1) + rng.uniform(0, 1, (2, 2))) * CELL
        ends = np.column_stack([xy, wrap_angle(HEADINGS[h] + rng.uniform(-0.1, 0.1, 2))])
        if (gaps(ends, ground.body, ground.things) < ROOM).any():
            continue
        cost = build_cost_map(plan, ends[0, :2], radius=inscribed_radius(robot.footprint))
        length = float(cost.lengths(ends[1:, :2])[0])
        if FARTHER_THAN <= length < np.inf:
            yield ends[0], ends[1], length


def line(room: str, robot: str, geodesic: float, record: DriveRecord) -> str:
    """One drive as a row of the table."""
    error = record.goal - record.pose
    slowest = 1000 * record.step_times.max(initial=0.0)
    return (
        f"{room:<16} {robot:<12} {geodesic:5.2f} {record.length / geodesic:6.3f} "
        f"{record.time:6.1f} {100 * record.clearance:6.1f} {100 * np.hypot(*error[:2]):5.1f} "
        f"{np.degrees(abs(float(wrap_angle(error[2])))):5.2f} {record.ways:4d} {slowest:6.1f}  "
        f"{record.reason or 'arrived'}"
    )


def main() -> None:
    """Drive, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--drives", type=int, default=200, help="in all [-]")
    parser.add_argument("--layouts", type=int, default=4, help="generated kitchens [-]")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    robots = [load_robot(name) for name in library_names()]
    print(
        f"{'room':<16} {'robot':<12} {'geo m':>5} {'length':>6} {'time s':>6} {'gap cm':>6} "
        f"{'cm':>5} {'deg':>5} {'ways':>4} {'max ms':>6}"
    )
    records, ratios, kinds, lines = [], [], [], []
    with tempfile.TemporaryDirectory() as folder:
        scenes = list(rooms(Path(folder), args.layouts))
        each = -(-args.drives // (len(scenes) * len(robots)))
        for scene in scenes:
            for robot in robots:
                ground = survey(scene, robot)
                rng = np.random.default_rng(args.seed)
                asked = questions(ground, scene, rng)
                for _ in range(min(each, args.drives - len(records))):
                    start, goal, length = next(asked)
                    # Time on the processor: what else runs is not the controller's.
                    record = drive(ground, start, goal, rng=rng, clock=time.process_time)
                    records.append(record)
                    ratios.append(record.length / length)
                    kinds.append(robot.drive)
                    lines.append(line(scene.name, robot.name, length, record))
                    print(lines[-1], flush=True)
    arrived = np.array([record.arrived for record in records])
    print()
    for kind in sorted(set(kinds)):
        of_kind = np.array([k == kind for k in kinds])
        ratio = np.array(ratios)[of_kind & arrived]
        # The first steps of a process load the compiled kernels.
        steps = np.concatenate(
            [r.step_times[5:] for r, k in zip(records, of_kind, strict=True) if k]
        )
        print(
            f"{kind}: {of_kind.sum()} drives, {arrived[of_kind].mean():.1%} arrived, "
            f"{sum(bool(r.hit) for r, k in zip(records, of_kind, strict=True) if k)} collisions; "
            f"length mean {ratio.mean():.3f}, 95 % {np.quantile(ratio, 0.95):.3f}, "
            f"most {ratio.max():.3f} of the geodesic; "
            f"step median {1000 * np.median(steps):.1f} ms, 99 % "
            f"{1000 * np.quantile(steps, 0.99):.1f} ms, most {1000 * steps.max():.1f} ms"
        )
    tolerance = DriveConfig().tolerance
    print(f"arrived: within {100 * tolerance:.0f} cm and 2 degrees of the goal, in truth")
    for row in (row for row, good in zip(lines, arrived, strict=True) if not good):
        print("FAILED", row)


if __name__ == "__main__":
    main()
