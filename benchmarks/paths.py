"""Count `momapos place follow` on drawn paths of the tool: lines, arcs and wiped faces.

    python benchmarks/paths.py [--count 100] [--seed 0] [--out FILE]

Rooms and robots are those of `poses.py`. A line is 0.3 to 1.2 m long and 5 cm off a side of a box;
an arc of 60 to 180 degrees has a radius of 10 to 30 cm there; a wipe covers the top of a box of at
most 1.1 m with a tool of 15 cm. The tool may turn about its approach. Every path has breaks. Plans
are read back from their files: the deviation is the distance of the tool from the lines through the
requested points, at 20 states between each two of the plan, and the speed is that of each joint
between two states over its limit.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from momapos.core import InputError, MomaposError
from momapos.core.geometry import pose_planar
from momapos.model import with_times
from momapos.model.plan_files import read_plan, write_plan
from momapos.model.records import PlacementPlan, ToolPath, ToolPose
from momapos.model.robots import Robot
from momapos.model.scene import Scene, save_scene
from momapos.planning import PipelineConfig, plan_follow
from momapos.planning.grasps import wipe_path
from momapos.verification import verify_files
from placement import arm
from poses import ROBOTS, drawn, room
from rows import commands, markdown

KINDS = ("line", "arc", "wipe")
CONFIG = PipelineConfig(timeout=60.0)
FINE = 20
"""Number of states between two of a plan at which the tool is compared with the path [-]."""


def path_of(kind: str, scene: Scene, robot: Robot, rng: np.random.Generator) -> ToolPath:
    """Draw a path of a kind in a room."""
    if kind == "wipe":
        tops = [item for item in scene.objects if item.wall is None and item.bounds[1, 2] < 1.0]
        while tops:
            item = tops.pop(int(rng.integers(len(tops))))
            try:
                found = wipe_path(scene, robot, f"{item.name}/top", 0.15, tool_length=0.05)
            except InputError:
                continue
            if np.ptp([pose.xyz for pose in found.poses], axis=0).max() < 1.1:
                return found
        kind = "line"
    begin = drawn(scene, robot, 1, rng)[0]
    T = begin.T_world_tool
    out = T[:3, :3] @ robot.approach_axis
    side = np.cross([0.0, 0.0, 1.0], out)
    side /= np.linalg.norm(side)
    up = np.cross(out, side)
    if kind == "line":
        angle = rng.uniform(-np.pi, np.pi)
        s = np.linspace(0.0, rng.uniform(0.3, 1.2), 5)[:, None]
        points = T[:3, 3] + s * (np.cos(angle) * side + 0.5 * np.sin(angle) * up)
    else:
        radius, turn = rng.uniform(0.1, 0.3), np.linspace(0, np.radians(rng.uniform(60, 180)), 19)
        points = T[:3, 3] + radius * (
            np.sin(turn)[:, None] * side + (1 - np.cos(turn))[:, None] * up
        )
    axis = tuple(robot.approach_axis.tolist())
    poses = tuple(
        replace(begin, xyz=tuple(p), name=f"point {k}", axis=axis, spin=np.pi)
        for k, p in enumerate(points.tolist(), 1)
    )
    return ToolPath(poses, tuple(range(1, len(poses) - 1)))


def deviation(plan: PlacementPlan, robot: Robot, poses: Sequence[ToolPose]) -> float:
    """Return the largest distance of the tool from the lines through some points [m]."""
    motion = plan.motion
    assert motion is not None
    assert plan.base_pose is not None
    rows = slice(motion.holds[0].first, motion.holds[-1].last + 1)
    states = np.column_stack([motion.q, motion.base_poses(plan.base_pose)])[rows]
    at = np.linspace(0.0, len(states) - 1, FINE * (len(states) - 1) + 1)
    fine = np.stack([np.interp(at, np.arange(len(states)), c) for c in states.T], axis=1)
    chain = robot.chain
    tools = pose_planar(fine[:, -3:]) @ chain.tool_poses(chain.freedom_values(fine[:, :-3]))
    p = np.array([pose.xyz for pose in poses])
    a, d = p[:-1], np.diff(p, axis=0)
    away = tools[:, None, :3, 3] - a
    share = (away * d).sum(-1) / np.maximum((d * d).sum(-1), 1e-12)
    off = away - np.clip(share, 0.0, 1.0)[..., None] * d
    return float(np.linalg.norm(off, axis=-1).min(1).max())


def fastest(plan: PlacementPlan, robot: Robot) -> float:
    """Return the largest joint speed between two states over its limit [-]."""
    motion = plan.motion
    assert motion is not None
    assert motion.times is not None
    limit = np.array([robot.model.joint(name).velocity for name in plan.joints])
    passed = np.maximum(np.diff(motion.times), 1e-9)[:, None]
    moved = np.abs(np.diff(motion.q, axis=0))
    return float(np.where(moved > 1e-9, moved / passed / limit, 0.0).max())


def count_path(name: str, kind: str, seed: int, folder: Path) -> dict[str, Any]:
    """Answer for a drawn path, and measure what its files state."""
    rng = np.random.default_rng(seed)
    robot, reach = arm(name)
    scene = save_scene(room(rng), folder / "room.json")
    path = path_of(kind, scene, robot, rng)
    row: dict[str, Any] = {"robot": name, "seed": seed, "kind": kind, "points": len(path.poses)}
    began = time.process_time()
    try:
        tour = plan_follow(scene, robot, path, reach, config=CONFIG)
    except MomaposError as error:
        return row | {"status": "refused", "reason": str(error)}
    row |= {"status": tour.status, "seconds": time.process_time() - began}
    row |= {"stops": len(tour.steps)}
    if tour.status != "solved":
        reasons = tour.steps[-1].plan.candidates.rejections
        return row | {"reason": max(reasons, key=reasons.__getitem__, default="")}
    found = []
    for k, step in enumerate(tour.steps):
        file = folder / f"{k}.json"
        write_plan(with_times(step.plan, robot), file)
        plan = read_plan(file)
        found.append((
            deviation(plan, robot, plan.task.poses), fastest(plan, robot), verify_files(file).valid
        ))  # fmt: skip
    off, speed, valid = zip(*found, strict=True)
    return row | {"deviation": max(off), "speed": max(speed), "valid": all(valid)}


def paths(*, count: int = 100, seed: int = 0, out: Path | None = None) -> None:
    """Count drawn paths.

    Args:
        count: Number of paths.
        seed: Seed of the first; each further one has the next.
        out: Write the rows to this JSON file.
    """
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for k in range(count):
            kind = KINDS[k // len(ROBOTS) % len(KINDS)]
            row = count_path(ROBOTS[k % len(ROBOTS)], kind, seed + k, Path(folder))
            rows.append(row)
            print(json.dumps(row), file=sys.stderr, flush=True)
    if out is not None:
        out.write_text(json.dumps(rows))
    lines = []
    for kind in (*KINDS, "all"):
        some = [row for row in rows if kind in ("all", row["kind"])]
        solved = [row for row in some if row["status"] == "solved"]
        if not solved:
            continue
        seconds = [row["seconds"] for row in solved]
        lines.append([
            kind, len(some), len(solved), sum(row["valid"] for row in solved),
            " / ".join(str(sum(row["stops"] == k for row in solved)) for k in (1, 2, 3)),
            f"{1000 * max(row['deviation'] for row in solved):.2f} mm",
            f"{100 * max(row['speed'] for row in solved):.0f} %",
            f"{np.median(seconds):.1f} s ({max(seconds):.1f} s)",
        ])  # fmt: skip
    head = ("path", "drawn", "solved", "valid", "stops 1 / 2 / 3", "deviation", "speed", "time")
    print(markdown(head, lines))


if __name__ == "__main__":
    commands(__doc__, paths)
