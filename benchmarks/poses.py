"""Compare `momapos place reach` with exhaustive search, on drawn sets of tool poses.

    python benchmarks/poses.py sets [--count 50] [--seed 0] [--out FILE]
    python benchmarks/poses.py sizes [--robot segway_ur5e]
    python benchmarks/poses.py wall [--robot segway_ur5e] [--holes 245]
    python benchmarks/poses.py grasps [--count 20] [--seed 0]

A room has three to six boxes. Poses are drawn on their sides, 5 to 15 cm off, with the hand toward
them. Exhaustive search tries all base poses of a lattice (20 cm, 30 deg) and those of the answer
with all poses within the arm's length, by the same inverse kinematics and collision checks; the
integer program without bounds gives the least number of stops, and for up to three stops all
choices of so many stops give the shortest drive. Poses that the lattice does not serve are left out
beforehand. `sizes` measures the processor time by number of poses. `grasps` picks up objects of the
built-in kitchens by three grasps of one's own alone, which are ours, shifted by up to 5 mm and
turned by up to 5 degrees; where none is taken, every base pose of the lattice around the object is
checked with all three.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise, permutations
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse import csr_array

from momapos.core import MomaposError
from momapos.core.geometry import rotation_about
from momapos.core.geometry import rotation_of as turned
from momapos.model.plan_files import write_plan
from momapos.model.records import Task, ToolPose
from momapos.model.robots import Robot
from momapos.model.scene import Scene, SceneObject, builtin_names, load_scene, save_scene
from momapos.planning import (
    BasePoseChecks,
    PipelineConfig,
    PlacementQuery,
    plan_base_placement,
)
from momapos.planning.grasps import MotionConfig
from momapos.planning.grasps.rigid_grasps import select_object_grasps
from momapos.planning.reach_poses import PoseSearch, ServingBases, plan_pose_stops
from momapos.verification import verify_files
from placement import arm
from rows import commands, emit, markdown

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

ROBOTS = ("fetch", "tiago", "segway_ur5e", "husky_ur5e", "ranger_rm63")
SIZES = (3, 5, 8, 12, 20, 30, 40, 60)
ROOM = 3.0
"""Half the edge of the room [m]."""
CELL, TURN = 0.2, np.radians(30.0)
MAX_CHOSEN = 3
"""Number of stops up to which all choices are compared by their drive [-]."""
CONFIG = PipelineConfig(timeout=60.0)


def room(rng: np.random.Generator) -> Scene:
    """Draw a room with boxes: tables, cabinets and columns, away from the start in its middle."""
    objects: list[SceneObject] = []
    while len(objects) < 3 + rng.integers(4):
        size = rng.uniform([0.3, 0.3, 0.5], [1.6, 0.8, 1.8])
        xy = rng.uniform(-ROOM + 0.6, ROOM - 0.6, 2)
        yaw = rng.integers(4) * np.pi / 2 + rng.uniform(-0.3, 0.3)
        if np.linalg.norm(xy) < 1.4 or any(
            np.linalg.norm(xy - other.T_world_object[:2, 3]) < 1.7 for other in objects
        ):
            continue
        name = f"box_{len(objects)}"
        objects.append(SceneObject.box(name, size, [*xy, size[2] / 2], yaw=yaw))
    corners = ROOM * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    return Scene("room", tuple(objects), floor_polygon=corners, start=np.zeros(3)).with_walls()


def drawn(scene: Scene, robot: Robot, count: int, rng: np.random.Generator) -> tuple[ToolPose, ...]:
    """Draw poses at the sides of the boxes of a room."""
    boxes = [item for item in scene.objects if item.wall is None]
    poses: list[ToolPose] = []
    while len(poses) < count:
        item = boxes[rng.integers(len(boxes))]
        size = np.ptp(item.box_proxy.vertices, axis=0)
        side, sign = int(rng.integers(2)), rng.choice([-1.0, 1.0])
        local = rng.uniform(-0.5, 0.5, 3) * size
        local[side] = sign * (size[side] / 2 + rng.uniform(0.05, 0.15))
        T = item.T_world_object
        point = T[:3, :3] @ local + T[:3, 3]
        normal = sign * T[:3, side]
        if point[2] < 0.4 or np.abs(point[:2]).max() > ROOM - 0.5:
            continue
        R = _facing(robot, -normal)
        lean = turned(rng.uniform(-0.35, 0.35, 3))
        roll = rotation_about(robot.approach_axis, rng.uniform(-0.5, 0.5))
        x, y, z, w = _quaternion(lean @ R @ roll)
        poses.append(ToolPose(tuple(point.tolist()), (w, x, y, z)))
    return tuple(poses)


def _facing(robot: Robot, direction: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Return a tool's rotation with its approach axis along a direction, its fingers level."""
    level = np.cross([0.0, 0.0, 1.0], direction)
    level /= np.linalg.norm(level)
    own = np.column_stack(
        [robot.approach_axis, robot.closing_axis, np.cross(robot.approach_axis, robot.closing_axis)]
    )
    wanted = np.column_stack([direction, level, np.cross(direction, level)])
    return np.asarray(wanted @ own.T)


def _quaternion(R: Float[np.ndarray, "3 3"]) -> list[float]:
    from scipy.spatial.transform import Rotation

    quaternion: list[float] = Rotation.from_matrix(R).as_quat().tolist()
    return quaternion


def lattice(search: PoseSearch, also: Float[np.ndarray, "k 3"]) -> ServingBases:
    """Return all base poses of a lattice that stand clear, and what each serves."""
    along = np.arange(-ROOM, ROOM + 1e-9, CELL)
    x, y, yaw = np.meshgrid(along, along, np.arange(-np.pi, np.pi - 1e-9, TURN), indexing="ij")
    bases = np.concatenate([np.column_stack([x.ravel(), y.ravel(), yaw.ravel()]), also])
    rows = search.rows_of(bases, by_map=False)
    search.check(rows, np.arange(len(rows.bases)))
    return rows


def least_stops(serves: Bool[np.ndarray, "n p"]) -> int:
    """Return the least number of base poses that serve all tool poses."""
    _, first = np.unique(np.packbits(serves, axis=1), axis=0, return_index=True)
    kept = serves[first]
    found = milp(
        np.ones(len(kept)), integrality=np.ones(len(kept)), bounds=Bounds(0.0, 1.0),
        constraints=LinearConstraint(csr_array(kept.T.astype(float)), lb=1.0),
    )  # fmt: skip
    return round(float(found.fun))


def shortest_drive(search: PoseSearch, rows: ServingBases, stops: int) -> float:
    """Return the shortest drive to so many base poses that serve all tool poses [m]."""
    serves, travel, best = rows.serves, rows.travel, np.inf
    if stops == 1:
        return float(travel[serves.all(1)].min())
    from_row: dict[int, np.ndarray] = {}

    def lengths(row: int) -> Float[np.ndarray, " n"]:
        if row not in from_row:
            from_row[row] = search.travel(rows.bases[row])(rows.bases)
        return from_row[row]

    rarest = int(serves.sum(0).argmin())
    for a in np.flatnonzero(serves[:, rarest])[np.argsort(travel[serves[:, rarest]])].tolist():
        best = min(best, _with(a, [], serves, travel, lengths, stops, best))
    return best


def _with(
    row: int, before: list[int], serves: Any, travel: Any, lengths: Any, stops: int, best: float
) -> float:
    """Return the shortest drive to stops among which are some, or the best known one."""
    chosen = [*before, row]
    if travel[chosen].max() >= best:
        return best
    left = ~serves[chosen].any(0)
    if not left.any():
        orders = (
            travel[o[0]] + sum(lengths(a)[b] for a, b in pairwise(o)) for o in permutations(chosen)
        )
        return min(best, float(min(orders)))
    if len(chosen) == stops:
        return best
    if len(chosen) == stops - 1:
        able = np.flatnonzero(serves[:, left].all(1) & (travel < best))
        if not len(able):
            return best
        for order in permutations([*chosen, -1]):
            cost = np.zeros(len(able))
            for k, stop in enumerate(order):
                if k == 0:
                    cost = cost + (travel[able] if stop < 0 else travel[stop])
                elif stop < 0:
                    cost = cost + lengths(order[k - 1])[able]
                elif order[k - 1] < 0:
                    cost = cost + lengths(stop)[able]
                else:
                    cost = cost + lengths(order[k - 1])[stop]
            best = min(best, float(cost.min()))
        return best
    pose = np.flatnonzero(left)[serves[:, left].sum(0).argmin()]
    able = np.flatnonzero(serves[:, pose] & (travel < best))
    for other in able[np.argsort(travel[able])].tolist():
        best = min(best, _with(other, chosen, serves, travel, lengths, stops, best))
    return best


def compare(name: str, count: int, seed: int) -> dict[str, Any]:
    """Answer for a drawn set, check the answer's files, and compare with exhaustive search."""
    rng = np.random.default_rng(seed)
    robot, reach = arm(name)
    scene = room(rng)
    query = _query(scene, robot, drawn(scene, robot, 2 * count, rng), reach)
    served = lattice(PoseSearch.of(query, in_order=False), np.zeros((0, 3))).serves.any(0)
    poses = tuple(query.task.poses[k] for k in np.flatnonzero(served)[:count])
    row: dict[str, Any] = {"robot": name, "seed": seed, "poses": len(poses)}
    query = _query(scene, robot, poses, reach)
    began = time.process_time()
    try:
        tour = plan_pose_stops(query)
    except MomaposError as error:
        return row | {"status": str(error)}
    row |= {"status": tour.status, "seconds": time.process_time() - began}
    row |= {"stops": len(tour.steps), "met": tour.done, "drive": tour.driving}
    with tempfile.TemporaryDirectory() as folder:
        scene = save_scene(scene, Path(folder) / "room.json")
        row["valid"] = all(
            _valid(step.plan, scene, Path(folder) / "plan.json")
            for step in tour.steps
            if step.plan.feasible
        )
    if tour.status != "solved":
        return row
    search = PoseSearch.of(query, in_order=False)
    rows = lattice(search, np.array([step.plan.base_pose for step in tour.steps]))
    row["least"] = least_stops(rows.serves)
    if row["least"] <= MAX_CHOSEN:
        row["least_drive"] = shortest_drive(search, rows, row["least"])
        row["own_drive"] = own_drive(search, tour)
    return row


def own_drive(search: PoseSearch, tour: Any) -> float:
    """Return the drive of an answer by the lengths that exhaustive search compares [m]."""
    at, total = search.start, 0.0
    for step in tour.steps:
        base = np.array(step.plan.base_pose)
        total += float(search.travel(at)(base[None])[0])
        at = base
    return total


def _query(scene: Scene, robot: Robot, poses: tuple[ToolPose, ...], reach: Any) -> PlacementQuery:
    return PlacementQuery.of(scene, robot, Task("reach", "", poses=poses), reach, config=CONFIG)


def _valid(plan: Any, scene: Scene, path: Path) -> bool:
    write_plan(replace(plan, scene=str(scene.path)), path)
    return verify_files(path).valid


def sets(*, count: int = 50, seed: int = 0, out: Path | None = None) -> None:
    """Compare answers with exhaustive search.

    Args:
        count: Number of sets.
        seed: Seed of the first; each further one has the next.
        out: Write the rows to this JSON file.
    """
    found = []
    for k in range(count):
        row = compare(ROBOTS[k % len(ROBOTS)], SIZES[k // len(ROBOTS) % len(SIZES)], seed + k)
        found.append(row)
        print(json.dumps(row), file=sys.stderr, flush=True)
    if out is not None:
        out.write_text(json.dumps(found))
    print(table(found))


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Summarize by number of poses."""
    lines = []
    for size in [*sorted({row["poses"] for row in rows}), "all"]:
        some = [row for row in rows if size in ("all", row["poses"])]
        solved = [row for row in some if row["status"] == "solved"]
        more = [row["stops"] - row["least"] for row in solved]
        longer = [row["own_drive"] / row["least_drive"] - 1 for row in solved if "own_drive" in row]
        seconds = [row["seconds"] for row in solved]
        lines.append([
            size, len(some), len(solved), sum(row["valid"] for row in some),
            " / ".join(str(sum(one == k for one in more)) for k in (0, 1)),
            sum(one > 1 for one in more),
            f"{100 * np.median(longer):.0f} % ({100 * max(longer):.0f} %)" if longer else "",
            f"{np.median(seconds):.2f} s ({max(seconds):.2f} s)" if seconds else "",
        ])  # fmt: skip
    head = ("poses", "sets", "solved", "valid", "stops +0 / +1", "more", "longer drive", "time")
    return markdown(head, lines)


def sizes(*, robot: str = "segway_ur5e", seed: int = 0) -> None:
    """Measure the processor time for 20 to 500 poses in one room.

    Args:
        robot: The robot.
        seed: Seed of the room and the poses.
    """
    machine, reach = arm(robot)
    for count in (20, 20, 50, 100, 200, 500):
        rng = np.random.default_rng(seed)
        scene = room(rng)
        query = _query(scene, machine, drawn(scene, machine, count, rng), reach)
        began = time.process_time()
        tour = plan_pose_stops(query)
        seconds = time.process_time() - began
        emit({
            "poses": count, "met": tour.done, "stops": max(tour.stops), "status": tour.status,
            "seconds": seconds, "stages": query.watch.timing,
        })  # fmt: skip


def wall(*, robot: str = "segway_ur5e", holes: int = 245, radius: float = 3.0) -> None:
    """Reach holes in a curved wall, evenly over 90 degrees of it and heights of 0.6 to 1.4 m.

    Args:
        robot: The robot.
        holes: Number of holes.
        radius: Radius of the wall [m].
    """
    machine, reach = arm(robot)
    angles = np.radians(np.linspace(-50.0, 50.0, 21))
    width = 2 * (radius + 0.1) * np.tan((angles[1] - angles[0]) / 2)
    boxes = tuple(
        SceneObject.box(
            f"wall_{k}", (0.1, float(width), 1.8),
            ((radius + 0.05) * np.cos(a), (radius + 0.05) * np.sin(a), 0.9), yaw=float(a),
        )
        for k, a in enumerate(angles.tolist())
    )  # fmt: skip
    corners = np.array([[-1, -5], [5, -5], [5, 5], [-1, 5]], float)
    scene = Scene("wall", boxes, floor_polygon=corners, start=np.zeros(3))
    rows = max(1, round(np.sqrt(holes * 0.8 / (radius * np.pi / 2))))
    columns = -(-holes // rows)
    poses = []
    for k in range(holes):
        a = np.radians(-45.0 + 90.0 * (k // rows) / max(columns - 1, 1))
        z = 0.6 + 0.8 * (k % rows) / max(rows - 1, 1)
        out = np.array([np.cos(a), np.sin(a), 0.0])
        x, y, _ = (radius - 0.05) * out
        i, j, m, w = _quaternion(_facing(machine, out))
        axis = machine.approach_axis
        axis_of = (float(axis[0]), float(axis[1]), float(axis[2]))
        poses.append(ToolPose((x, y, z), (w, i, j, m), axis=axis_of, spin=np.pi))
    began = time.process_time()
    tour = plan_pose_stops(_query(scene, machine, tuple(poses), reach))
    emit({
        "holes": holes, "met": tour.done, "stops": max(tour.stops), "status": tour.status,
        "drive": tour.driving, "seconds": time.process_time() - began,
    })  # fmt: skip


def grasps(*, count: int = 20, seed: int = 0) -> None:
    """Count picks by grasps of one's own that are taken, and those that any base pose could take.

    Args:
        count: Number of picks.
        seed: Seed of the draws.
    """
    rng = np.random.default_rng(seed)
    scenes = [load_scene(name) for name in builtin_names()]
    rows: list[dict[str, Any]] = []
    while len(rows) < count:
        scene = scenes[rng.integers(len(scenes))]
        rigid = [o for o in scene.objects if not o.model.joints and o.wall is None]
        item = rigid[rng.integers(len(rigid))]
        robot, reach = arm(ROBOTS[len(rows) % len(ROBOTS)])
        ours = select_object_grasps(
            robot, item, item.T_world_object, MotionConfig().grasps, carried=False
        )
        if ours.reason or not len(ours.Ts_part_tool):
            continue
        Ts = ours.Ts_part_tool[rng.choice(len(ours.Ts_part_tool), 3)]
        Ts[:, :3, :3] = Ts[:, :3, :3] @ turned(rng.uniform(-0.05, 0.05, (3, 3)))
        Ts[:, :3, 3] += rng.uniform(-0.005, 0.005, (3, 3))
        own = robot.with_grasps(lambda _name, _joint, Ts=Ts: Ts)
        only = replace(CONFIG.motion.grasps, own="only")
        config = replace(CONFIG, motion=replace(CONFIG.motion, grasps=only))
        query = PlacementQuery.of(scene, own, Task("pick", item.name), reach, config=config)
        row: dict[str, Any] = {"scene": scene.name, "object": item.name, "robot": robot.name}
        try:
            row["status"] = plan_base_placement(query).plan.status
        except MomaposError as error:
            row["status"] = str(error)
        if row["status"] != "solved":
            row["any"] = _any_base(query, item)
        rows.append(row)
        emit(row)
    taken = sum(row["status"] == "solved" for row in rows)
    emit({"taken": taken, "could": taken + sum(row.get("any", False) for row in rows)})


def _any_base(query: PlacementQuery, item: SceneObject) -> bool:
    """Return whether a base pose of the lattice around an object picks it up."""
    try:
        checks = BasePoseChecks(query)
    except MomaposError:
        return False
    along = np.arange(-1.4, 1.4 + 1e-9, CELL)
    x, y, yaw = np.meshgrid(along, along, np.arange(-np.pi, np.pi - 1e-9, TURN), indexing="ij")
    bases = np.column_stack([x.ravel(), y.ravel(), yaw.ravel()])
    bases[:, :2] += item.T_world_object[:2, 3]
    return any(checks(base).motion is not None for base in bases)


if __name__ == "__main__":
    commands(__doc__, sets, sizes, wall, grasps)
