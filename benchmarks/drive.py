"""Measure random drives through kitchens, with noise: success and path length.

Starts and goals are free poses of the footprint, with a geodesic distance of at least 1.5 m for a
disc of the inscribed radius. The path length is compared with this geodesic length, which placement
uses as cost, and with that of the footprint. Prints one line per drive, then totals and failures;
for a drive without a path also whether a fine grid of poses finds one.
"""

from __future__ import annotations

import gc
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from scipy.ndimage import label
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from momapos.apps.plots import GOOD, INK, SELECTED, SOFT_INK, WAYPOINT, room_bounds
from momapos.apps.plots.room_plot import draw_footprint, draw_room, name_objects
from momapos.core.geometry import inscribed_radius, place_points, wrap_angle
from momapos.model.robots import Robot, library_names, load_robot
from momapos.model.scene import LAYOUTS, Scene, builtin_names, generate_kitchen, load_scene
from momapos.planning.grasps import scene_boxes
from momapos.planning.navigation import (
    CELL,
    DriveConfig,
    DriveRecord,
    NavigationMap,
    base_height,
    build_cost_map,
    build_navigation_map,
    drive,
    floor_plan,
    gaps,
    plan_path,
)
from momapos.planning.navigation.cost_map import FloorPlan
from momapos.planning.navigation.driving import DriveEnding
from momapos.planning.navigation.footprint_map import HEADINGS
from rows import commands

MIN_LENGTH = 1.5
"""Minimum geodesic length of a drive [m]."""
MIN_GAP = 0.01
"""Minimum gap around start and goal [m], as in placement."""
PERSON = 0.25
"""Radius of a person [m]."""
PACE = 0.3, 0.6
"""Range of walking speeds [m/s]."""
AWAY, PATIENCE = 0.4, 3.0
"""Distance from the robot at which people stop [m], and how long they wait there [s]."""
_FINE, _TURNS = CELL / 2, 72
"""Cell size [m] and number of headings [-] of the grid that checks whether a path exists."""


@dataclass(frozen=True, eq=False)
class Question:
    """A requested drive."""

    start: Float[np.ndarray, "3"]
    goal: Float[np.ndarray, "3"]
    disc: float
    """Geodesic length for a disc of the inscribed radius, placement's cost [m]."""
    footprint: float
    """Geodesic length over cells in which the footprint fits at some heading [m]."""

    @property
    def detour(self) -> float:
        """Return how much longer the path is than the straight line [m]."""
        return self.disc - float(np.hypot(*(self.goal - self.start)[:2]))


def rooms(folder: Path, layouts: int) -> Iterator[Scene]:
    """Yield the built-in kitchens and one kitchen of each generated layout."""
    for name in builtin_names():
        yield load_scene(name)
    for seed, layout in enumerate(LAYOUTS[:layouts]):
        yield load_scene(generate_kitchen(layout, seed=seed, out=folder / f"{layout}.json"))


def questions(nav_map: NavigationMap, scene: Scene, rng: np.random.Generator) -> Iterator[Question]:
    """Yield random starts and goals that the disc can drive between."""
    robot = nav_map.robot
    plan = floor_plan(
        scene_boxes(scene), height=base_height(robot), floor_polygon=scene.floor_polygon
    )
    # Minus half a cell: a footprint that fits between two cell centers also counts.
    fits = FloorPlan(nav_map.origin, np.asarray(~(nav_map.gap > -CELL / 2).any(0)))
    states = np.argwhere(nav_map.free)
    while True:
        h, i, j = states[rng.integers(len(states), size=2)].T
        xy = nav_map.origin + (np.stack([j, i], -1) + rng.uniform(0, 1, (2, 2))) * CELL
        ends = np.column_stack([xy, wrap_angle(HEADINGS[h] + rng.uniform(-0.1, 0.1, 2))])
        if (gaps(ends, nav_map.prisms, nav_map.planning_obstacles) < MIN_GAP).any():
            continue
        cost = build_cost_map(plan, ends[0, :2], radius=inscribed_radius(robot.footprint))
        length = float(cost.lengths(ends[1:, :2])[0])
        if MIN_LENGTH <= length < np.inf:
            real = build_cost_map(fits, ends[0, :2], radius=0.0)
            yield Question(ends[0], ends[1], length, float(real.lengths(ends[1:, :2])[0]))


def connected(
    nav_map: NavigationMap, start: Float[np.ndarray, "3"], goal: Float[np.ndarray, "3"]
) -> bool:
    """Return whether a fine grid of free poses connects two poses, by steps of one cell or turn.

    It ignores the kinematics of the base, so it may find a path that the base cannot drive.
    """
    high = nav_map.origin + np.array(nav_map.gap.shape[:0:-1]) * CELL
    x, y = (np.arange(nav_map.origin[k] + _FINE / 2, high[k], _FINE) for k in (0, 1))
    X, Y = (a.ravel() for a in np.meshgrid(x, y))
    turns = np.arange(_TURNS) * 2 * np.pi / _TURNS
    room = [
        gaps(
            np.column_stack([X, Y, np.full(X.size, t)]),
            nav_map.prisms,
            nav_map.planning_obstacles,
            cap=0.05,
        )
        for t in turns
    ]
    parts, count = label((np.array(room) > 0).reshape(_TURNS, len(y), len(x)))
    around = (parts[0] > 0) & (parts[-1] > 0)  # the last heading is next to the first one
    pairs = parts[0][around], parts[-1][around]
    ones = np.ones(len(pairs[0]))
    _, group = connected_components(coo_matrix((ones, pairs), (count + 1, count + 1)), False)

    def near(pose: np.ndarray) -> set[int]:
        i, j = np.abs(y - pose[1]).argmin(), np.abs(x - pose[0]).argmin()
        h = np.abs(wrap_angle(turns - pose[2])).argmin()
        found = parts[np.arange(h - 1, h + 2) % _TURNS, i - 1 : i + 2, j - 1 : j + 2]
        return set(group[found[found > 0]].tolist())

    return bool(near(start) & near(goal))


class People:
    """Two people who walk back and forth between free places, and stop in front of the robot.

    They treat the robot as a disc and keep a step away from it; after a long wait they turn back.
    They start at least a meter from it.
    """

    def __init__(
        self, nav_map: NavigationMap, start: Float[np.ndarray, "3"], rng: np.random.Generator
    ) -> None:
        self.robot, self.radius, self.time = start[:2], nav_map.prisms.radius, 0.0
        self.begin, self.toward, self.length = self._walks(nav_map, rng)
        self.pace = rng.uniform(*PACE, size=2)
        self.gone, self.sense, self.waited = np.zeros(2), np.ones(2), np.zeros(2)

    def _walks(
        self, nav_map: NavigationMap, rng: np.random.Generator
    ) -> tuple[Float[np.ndarray, "2 2"], Float[np.ndarray, "2 2"], Float[np.ndarray, " 2"]]:
        fits = np.asarray((nav_map.gap > 0.0).any(0))
        cells = np.argwhere(fits)
        walks: list[tuple[np.ndarray, np.ndarray, float]] = []
        while len(walks) < 2:
            i, j = cells[rng.integers(len(cells), size=2)].T
            a, b = nav_map.origin + (np.stack([j, i], -1) + 0.5) * CELL
            length = float(np.hypot(*(b - a)))
            away = float(np.hypot(*(a - self.robot))) - self.radius - PERSON
            line = a + np.linspace(0, 1, 100)[:, None] * (b - a)
            column, row = np.floor((line - nav_map.origin) / CELL).astype(int).T
            if length > 1.0 and away > 1.0 and fits[row, column].all():
                walks.append((a, (b - a) / length, length))
        begin, toward, lengths = (np.array(parts) for parts in zip(*walks, strict=True))
        return begin, toward, lengths

    def meet(self, robot: Float[np.ndarray, "3"]) -> None:
        """Observe the position of the robot."""
        self.robot = robot[:2]

    def __call__(self, time: float) -> Float[np.ndarray, "2 5"]:
        """Advance to a time [s] and return the states of the people."""
        dt, self.time = time - self.time, time
        where = self.begin + self.toward * self.gone[:, None]
        to_robot = self.robot - where
        near = np.hypot(*to_robot.T) < self.radius + PERSON + AWAY
        ahead = self.sense * (to_robot * self.toward).sum(1) > 0
        stopped = near & ahead
        self.waited = np.where(stopped, self.waited + dt, 0.0)
        turned = self.waited > PATIENCE
        self.gone += np.where(stopped, 0.0, self.sense * self.pace * dt)
        at_end = (self.gone >= self.length) & (self.sense > 0)
        turned |= at_end | (self.gone <= 0) & (self.sense < 0)
        self.sense = np.where(turned, -self.sense, self.sense)
        self.waited[turned] = 0.0
        self.gone = np.clip(self.gone, 0.0, self.length)
        velocity = np.where(stopped, 0.0, self.sense * self.pace)[:, None] * self.toward
        where = self.begin + self.toward * self.gone[:, None]
        return np.column_stack([where, velocity, np.full(2, PERSON)])


EVERY = 0.25
"""Path length between two drawn footprints; a radian counts as 0.5 m [m]."""


def draw_drive(
    scene: Scene, nav_map: NavigationMap, question: Question, record: DriveRecord, path: Path
) -> None:
    """Draw a drive into a PNG file."""
    figure = Figure(figsize=(7.2, 5.4), dpi=130, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_axes((0.09, 0.08, 0.68, 0.85))
    low, high = room_bounds(scene)
    axes.set_aspect("equal")
    axes.set_xlim(low[0] - 0.1, high[0] + 0.1)
    axes.set_ylim(low[1] - 0.1, high[1] + 0.1)
    draw_room(axes, scene)
    poses = record.poses
    step = np.diff(poses, axis=0)
    turn = np.abs(wrap_angle(step[:, 2]))
    gone = np.concatenate([[0], np.cumsum(np.hypot(*step.T[:2]) + 0.5 * turn)])
    some = np.unique(np.searchsorted(gone, np.arange(0, gone[-1], EVERY)))
    outlines = place_points(poses[some], nav_map.prisms.outlines[0])
    blue: dict[str, Any] = {
        "facecolors": (0.16, 0.48, 0.72, 0.05),
        "edgecolors": (0.16, 0.48, 0.72, 0.35),
    }
    axes.add_collection(
        PolyCollection(list(outlines), linewidths=0.7, zorder=8, label="footprint", **blue)
    )
    planned = plan_path(nav_map, question.start, question.goal)
    if planned is not None:
        line: dict[str, Any] = {"color": WAYPOINT, "lw": 1.3, "ls": (0, (4, 2)), "zorder": 14}
        axes.plot(*planned.poses.T[:2], label=f"planned, {planned.length:.2f} m", **line)
    driven = f"driven, {record.length:.2f} m"
    axes.plot(*poses.T[:2], color=SELECTED, lw=1.8, zorder=13, label=driven)
    draw_footprint(axes, nav_map.robot, question.start, dashed=True)
    draw_footprint(axes, nav_map.robot, question.goal)
    for name, pose, color in (("start", question.start, INK), ("goal", question.goal, GOOD)):
        axes.plot(*pose[:2], "o", ms=5, color=color, zorder=16, label=name)
    name_objects(axes, scene)
    axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), fontsize=8, frameon=False)
    axes.set_xlabel("x [m]", fontsize=8, color=SOFT_INK)
    axes.set_ylabel("y [m]", fontsize=8, color=SOFT_INK)
    axes.tick_params(labelsize=7, colors=SOFT_INK)
    axes.set_title(
        f"{nav_map.robot.name} in {scene.name}: {record.time:.0f} s, nearest to furniture "
        f"{100 * record.clearance:.0f} cm", fontsize=9, color=INK, loc="left",
    )  # fmt: skip
    path.parent.mkdir(parents=True, exist_ok=True)
    canvas.print_png(str(path))


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


def main(
    drives: int = 200, robots: tuple[str, ...] = tuple(library_names()), layouts: int = 4,
    people: bool = False, seed: int = 0, figure: Path | None = None,
) -> None:  # fmt: skip
    """Run the drives and print the table.

    Args:
        drives: Total number.
        robots: Robots of the library, or robot files.
        layouts: Number of generated kitchens.
        people: Two people walk in each room.
        seed: Seed of questions and noise.
        figure: PNG file of the most winding drive of kitchen_small.
    """
    print(
        f"{'room':<16} {'robot':<12} {'geo m':>5} {'disc':>6} {'foot':>6} {'time s':>6} "
        f"{'gap cm':>6} {'cm':>5} {'deg':>5} {'ways':>4} {'cpu ms':>6} {'ms':>6}"
    )
    results: list[Result] = []
    shown: list[tuple[Result, Scene, NavigationMap]] = []
    arms, warm = [load_robot(name) for name in robots], set()
    with tempfile.TemporaryDirectory() as folder:
        pairs = list(product(rooms(Path(folder), layouts), arms))
        each, left = divmod(drives, len(pairs))
        for n, (scene, robot) in enumerate(pairs):
            nav_map = build_navigation_map(scene, robot)
            drawn = questions(nav_map, scene, np.random.default_rng(seed))
            for k in range(each + (n < left)):
                question = next(drawn)
                if robot.drive not in warm:
                    # The first drive of a process loads the kernels.
                    driven(scene, nav_map, question, seed, crowded=people)
                    warm.add(robot.drive)
                gc.collect()
                gc.freeze()  # garbage collection must not scan the rooms within a control step
                results.append(driven(scene, nav_map, question, seed + k, crowded=people))
                if scene.name == "kitchen_small" and results[-1].record.arrived:
                    shown.append((results[-1], scene, nav_map))
                print(results[-1].row, flush=True)
    print()
    for kind in sorted({robot.drive for robot in arms}):
        print(totals(kind, [r for r in results if r.robot.drive == kind]))
    tolerance = DriveConfig().tolerance
    print(f"arrived: within {100 * tolerance:.0f} cm and 2 degrees of the goal, true pose")
    for result in results:
        if not result.record.arrived:
            print("FAILED", result.row)
    if figure and shown:
        best, scene, nav_map = max(shown, key=lambda s: s[0].question.detour)
        draw_drive(scene, nav_map, best.question, best.record, figure)


if __name__ == "__main__":
    commands(__doc__, main)
