"""The case of `door_case` with a base that moves, while the hand holds the door or between holds.

Again without a planner: the hand moves along the arc, the base along an arc of its own.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from jaxtyping import Float
from tests.moving_base import arc, follow
from tests.verification.door_case import (
    BASE,
    JOINTS,
    OPEN,
    Case,
    arm_path,
    make_case,
    robot_urdf,
    tool_poses,
)

from momapos.core.geometry.transforms import invert, pose, pose_planar
from momapos.model.kinematics.chain import Chain, build_chain
from momapos.model.urdf.articulated import Articulated
from momapos.model.urdf.reader import read_urdf

BACK, TURN = -0.2, 0.3
"""The base drives backwards [m] and turns [rad] while the hand opens the door."""
AWAY = 0.1
"""Distance from the handle to which the free hand retreats [m]."""


@cache
def chain() -> Chain:
    with TemporaryDirectory() as folder:
        (Path(folder) / "robot.urdf").write_text(robot_urdf())
        model = Articulated(read_urdf(Path(folder) / "robot.urdf"))
    return build_chain(model, "base", "tool", JOINTS)[0]


def away(T: Float[np.ndarray, "4 4"], count: int) -> Float[np.ndarray, "count 4 4"]:
    """Return tool poses from one off the handle to the handle."""
    return T @ np.array([pose((0.0, 0.0, z)) for z in np.linspace(-AWAY, 0.0, count)])


def case_of(
    values: Float[np.ndarray, " m"],
    Ts_world_tool: Float[np.ndarray, "m 4 4"],
    base: Float[np.ndarray, "m 3"],
    holds: list[list[int]],
    drive: str = "differential",
) -> Case:
    """Build a case of version 2; the approach is the first state."""
    _, known, at = arm_path()
    seeds = np.stack([np.interp(values, at, column) for column in known.T], axis=1)
    q = follow(chain(), seeds, invert(pose_planar(base)) @ Ts_world_tool)
    case = make_case()
    case.plan["version"] = 2
    case.plan["robot"]["drive"] = drive
    case.plan["base_pose"] = dict(zip(("x", "y", "yaw"), base[0].tolist(), strict=True))
    case.plan["approach"] = q[:1].tolist()
    case.plan["manipulation"] = {
        "q": q.tolist(),
        "object_q": values.tolist(),
        "T_world_tool": Ts_world_tool.tolist(),
        "base": base.tolist(),
        "holds": holds,
    }
    return case


def moving_case(
    drive: str = "differential", lead_in: int = 0, sideways: float = 0.0, turn: float = TURN
) -> Case:
    """Build a case whose base moves while the hand holds the door.

    Args:
        drive: How the base drives.
        lead_in: States in which base and hand move to the handle, before the hold.
        sideways: Distance by which the base moves along y meanwhile [m].
        turn: Angle by which the base turns [rad].
    """
    values = np.concatenate([np.zeros(lead_in), np.linspace(0.0, OPEN, 41)])
    Ts = tool_poses(values)
    if lead_in:
        Ts[: lead_in + 1] = away(Ts[0], lead_in + 1)
    base = arc(BASE, BACK, turn, len(values))
    base[:, 1] += sideways * np.linspace(0.0, 1.0, len(values))
    return case_of(values, Ts, base, [[lead_in, len(values) - 1]], drive)


def stops_case() -> Case:
    """Build a case in which the hand lets go, the base drives, and the hand takes hold again."""
    first, second = np.linspace(0.0, 0.5, 21), np.linspace(0.5, OPEN, 21)
    ajar = tool_poses(first[-1:])[0]
    out, there = away(ajar, 6)[::-1], arc(BASE, BACK, TURN, 15)
    carried = pose_planar(there) @ invert(pose_planar(np.array(BASE))) @ out[-1]
    parts = [
        (first, tool_poses(first), np.tile(BASE, (21, 1))),
        (np.full(6, 0.5), out, np.tile(BASE, (6, 1))),
        (np.full(15, 0.5), carried, there),  # the arm stands still
        (np.full(15, 0.5), carried[::-1], np.tile(there[-1], (15, 1))),
        (np.full(6, 0.5), out[::-1], np.tile(there[-1], (6, 1))),
        (second, tool_poses(second), np.tile(there[-1], (21, 1))),
    ]
    values, Ts, base = (np.concatenate(column) for column in zip(*parts, strict=True))
    return case_of(values, Ts, base, [[0, 20], [63, 83]])
