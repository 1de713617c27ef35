"""Read a user's own grasps: tool poses, or what networks for grasps write.

| content | hand frame | fingertips |
|---|---|---|
| poses, as of `load_poses`, with `score` if known | the robot's tool link | |
| isaac_grasp (GraspGen, Isaac Sim) | z approaches, x closes | `depth` from its origin |
| GraspGen data: `grasps.transforms` | z approaches, x closes | `depth` from its origin |
| GraspNet: an array (n, 17) | x approaches, y closes | by its own depth |
| GPD: `approach`, `binormal` | these | at `top`, else `depth` from `position` |

A hand of another kind is replaced by the robot's: with the same fingertips, approach and closing
axis, which may point to either side, or pulled back by up to 3 cm.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from momapos.core import FileFormatError, InputError, as_path, finite_array, shown
from momapos.core.geometry import invert, pose_wxyz
from momapos.model.records import Task
from momapos.model.robots import Robot
from momapos.model.scene import Scene, frame_named, read_poses, transform_of

from .config import MAX_GRASPS
from .hand_boxes import hand_of

if TYPE_CHECKING:
    from jaxtyping import Float

FRANKA_DEPTH, GPD_DEPTH = 0.1034, 0.06
"""Distance of the fingertips from the origin of a Panda's hand, for which GraspGen's grasps are
made, and from the base of GPD's usual hand [m]."""
PULLED_BACK = (0.0, 0.01, 0.02, 0.03)
"""By how much a robot's hand is pulled back along its approach, as its palm may be nearer to the
fingertips than that of the hand for which the grasp was made [m]."""
_UNIT_ERROR = 1e-2
"""Largest deviation of an axis from a unit vector, and of two from a right angle [-]."""


@dataclass(frozen=True, eq=False)
class OwnGrasps:
    """Grasps of one object or part, as a `GraspSource`."""

    object: str
    joint: str | None
    Ts_link_tool: Float[np.ndarray, "g 4 4"]
    """Tool poses in the frame of the link that the task moves, the best score first."""
    names: tuple[str, ...]
    """Name of each grasp, with its score if it has one."""

    def __call__(self, name: str, joint: str | None, /) -> Float[np.ndarray, "g 4 4"]:
        """Return the tool poses; none for another object or part."""
        same = (name, joint) == (self.object, self.joint)
        return self.Ts_link_tool if same else self.Ts_link_tool[:0]


@dataclass(frozen=True, eq=False)
class _Listed:
    """Grasps of a file in its frame."""

    Ts: Float[np.ndarray, "g 4 4"]
    names: Sequence[str]
    scores: Float[np.ndarray, " g"]
    """NaN where there is none."""


_Hands: TypeAlias = (
    "tuple[Float[np.ndarray, 'g 3'], Float[np.ndarray, 'g 3'], Float[np.ndarray, 'g 3']]"
)


def load_grasps(
    path: str | Path,
    scene: Scene,
    robot: Robot,
    task: Task,
    *,
    frame: str | None = None,
    depth: float | None = None,
) -> OwnGrasps:
    """Read grasps for a task, as poses of the robot's tool link.

    Args:
        path: A .json, .yaml, .csv, .npy or .npz file, see the table of this module.
        scene: The scene as it is before the task.
        robot: The robot, whose hand takes the place of the file's.
        task: The task, which names the object and the joint.
        frame: Frame of the file: world, or an object or part; by default what the task moves.
        depth: Distance of the fingertips from the origin of the file's hand [m], where the format
            does not state it; by default that of a Panda's hand, or of GPD's.

    Raises:
        FileFormatError: The file is missing, damaged, or of another kind.
        InputError: A grasp is invalid; the message names it.
        UnknownNameError: The frame does not exist.
    """
    path = as_path("path", path)
    found = _listed(read_poses(path), path, robot, depth)
    if not len(found.Ts):
        raise InputError(f"{path}: has no grasps")
    if len(found.Ts) > MAX_GRASPS:
        raise InputError(f"{path}: has {len(found.Ts):,} grasps; at most {MAX_GRASPS:,} are tried")
    target = scene.object(task.object)
    link = target.model.urdf.root if task.joint is None else target.joint(task.joint).child
    T_world_link = target.link_poses()[link]
    T_world_frame = T_world_link if frame is None else frame_named(frame, scene)
    order = np.argsort(-np.nan_to_num(found.scores, nan=-np.inf), kind="stable")
    names = [
        name if math.isnan(score) else f"{name}, score {score:.3g}"
        for name, score in zip(found.names, found.scores.tolist(), strict=True)
    ]
    return OwnGrasps(
        task.object, task.joint, invert(T_world_link) @ T_world_frame @ found.Ts[order],
        tuple(names[k] for k in order.tolist()),
    )  # fmt: skip


def _listed(value: Any, path: Path, robot: Robot, depth: float | None) -> _Listed:
    """Return the grasps of a file's content."""
    if isinstance(value, np.ndarray) and value.shape[1:] == (17,):
        return _graspnet(value, path, robot)
    if isinstance(value, dict):
        grasps = value.get("grasps")
        if isinstance(grasps, dict) and "transforms" in grasps:
            return _graspgen_data(grasps, path, robot, depth)
        if isinstance(grasps, dict):
            return _isaac(grasps, path, robot, depth)
        value = grasps if isinstance(grasps, list) else value.get("poses", value)
    rows = value.tolist() if isinstance(value, np.ndarray) else value
    if not isinstance(rows, list):
        raise FileFormatError(f"{path}: must hold a list of grasps, not {shown(value)}")
    if rows and isinstance(rows[0], dict) and "approach" in rows[0]:
        return _gpd(rows, path, robot, depth)
    known = [row if isinstance(row, dict) else {} for row in rows]
    Ts = [
        transform_of({k: v for k, v in row.items() if k not in ("score", "name", "width")}
                     if isinstance(row, dict) else row, f"{path}: grasp {k}")
        for k, row in enumerate(rows, 1)
    ]  # fmt: skip
    names = [str(row.get("name", f"grasp {k}")) for k, row in enumerate(known, 1)]
    scores = [_score(row.get("score"), f"{path}: grasp {k}") for k, row in enumerate(known, 1)]
    return _Listed(np.array(Ts).reshape(-1, 4, 4), names, np.array(scores))


def _graspnet(rows: np.ndarray, path: Path, robot: Robot) -> _Listed:
    """Convert rows of graspnetAPI: score, width, height, depth, rotation (9), translation (3)."""
    rows = finite_array(str(path), rows, (None, 17))
    R = rows[:, 4:13].reshape(-1, 3, 3)
    tips = rows[:, 13:16] + rows[:, 3:4] * R[:, :, 0]
    names = [f"grasp {k + 1}" for k in range(len(rows))]
    return _with_hand(robot, names, (R[:, :, 0], R[:, :, 1], tips), rows[:, 0], path)


def _graspgen_data(
    grasps: Mapping[str, Any], path: Path, robot: Robot, depth: float | None
) -> _Listed:
    """Convert the grasps of a file of GraspGen's data that hold the object."""
    Ts = finite_array(f"{path}: grasps.transforms", grasps["transforms"], (None, 4, 4))
    holds = np.array(grasps.get("object_in_gripper", [True] * len(Ts)))
    if holds.shape != (len(Ts),) or holds.dtype.kind not in "bi":
        raise InputError(f"{path}: grasps.object_in_gripper must be {len(Ts)} truth values")
    rows = np.flatnonzero(holds)
    names = [f"grasp {k + 1}" for k in rows]
    return _panda(names, Ts[rows], np.full(len(rows), np.nan), path, robot, depth)


def _isaac(grasps: Mapping[str, Any], path: Path, robot: Robot, depth: float | None) -> _Listed:
    """Convert named grasps of an isaac_grasp file; those of confidence 0 have failed."""
    names, Ts, scores = [], [], []
    for name, one in grasps.items():
        where = f"{path}: {name}"
        turn = one.get("orientation") if isinstance(one, dict) else None
        if not isinstance(turn, dict) or "position" not in one:
            raise InputError(f"{where}: needs position and orientation {{w, xyz}}")
        xyz = finite_array(f"{where}: orientation.xyz", turn.get("xyz"), (3,)).tolist()
        wxyz = finite_array(f"{where}: orientation", [turn.get("w"), *xyz], (4,))
        if abs(np.linalg.norm(wxyz) - 1.0) > _UNIT_ERROR:
            raise InputError(f"{where}: orientation has length {np.linalg.norm(wxyz):.4g}, not 1")
        score = _score(one.get("confidence"), where)
        if score == 0.0:
            continue
        at = finite_array(f"{where}: position", one["position"], (3,))
        names.append(str(name))
        Ts.append(pose_wxyz(tuple(at.tolist()), tuple(wxyz.tolist())))
        scores.append(score)
    found = np.array(Ts).reshape(-1, 4, 4)
    return _panda(names, found, np.array(scores), path, robot, depth)


def _panda(
    names: Sequence[str], Ts: Float[np.ndarray, "g 4 4"], scores: Float[np.ndarray, " g"],
    path: Path, robot: Robot, depth: float | None,
) -> _Listed:  # fmt: skip
    """Convert poses of a hand that approaches along z and closes along x."""
    approach, closing = Ts[:, :3, 2], Ts[:, :3, 0]
    tips = Ts[:, :3, 3] + (FRANKA_DEPTH if depth is None else depth) * approach
    return _with_hand(robot, names, (approach, closing, tips), scores, path)


def _gpd(rows: Sequence[Any], path: Path, robot: Robot, depth: float | None) -> _Listed:
    """Convert messages of GPD: GraspConfig."""
    vectors: dict[str, list[np.ndarray]] = {"approach": [], "binormal": [], "tip": []}
    scores = []
    for k, row in enumerate(rows, 1):
        where = f"{path}: grasp {k}"
        if not isinstance(row, dict):
            raise InputError(f"{where}: must be an object, not {shown(row)}")
        for name in ("approach", "binormal"):
            vectors[name].append(_vector(row.get(name), f"{where}: {name}"))
        if "top" in row:
            tip = _vector(row["top"], f"{where}: top")
        else:
            base = _vector(row.get("position", row.get("bottom")), f"{where}: position")
            tip = base + (GPD_DEPTH if depth is None else depth) * vectors["approach"][-1]
        vectors["tip"].append(tip)
        score = row.get("score")
        scores.append(_score(score.get("data") if isinstance(score, dict) else score, where))
    approach, closing, tips = (np.array(vectors[name]) for name in ("approach", "binormal", "tip"))
    names = [f"grasp {k + 1}" for k in range(len(rows))]
    return _with_hand(robot, names, (approach, closing, tips), np.array(scores), path)


def _with_hand(
    robot: Robot, names: Sequence[str], hands: _Hands, scores: Float[np.ndarray, " g"], path: Path
) -> _Listed:
    """Return grasps by the robot's hand, with its fingers to either side, also pulled back.

    Args:
        robot: The robot.
        names: Name of each grasp.
        hands: Approach and closing axis of each hand, and the point between its fingertips.
        scores: Score of each grasp.
        path: The file, for messages.

    Raises:
        InputError: The axes are no unit vectors at a right angle.
    """
    count, copies = len(names), 2 * len(PULLED_BACK)
    approach, closing, tips = (np.tile(one, (copies, 1)) for one in hands)
    closing[copies // 2 * count :] *= -1.0
    tips -= np.tile(np.repeat(PULLED_BACK, count), 2)[:, None] * approach
    off = np.abs(np.linalg.norm(approach, axis=1) - 1.0)
    off = np.maximum(off, np.abs(np.linalg.norm(closing, axis=1) - 1.0))
    off = np.maximum(off, np.abs((approach * closing).sum(1)))
    if (off > _UNIT_ERROR).any():
        bad = names[int(np.argmax(off > _UNIT_ERROR))]
        raise InputError(f"{path}: {bad}: its axes are no unit vectors at a right angle")
    hand = hand_of(robot)
    closing = closing - (approach * closing).sum(1, keepdims=True) * approach
    wanted = np.stack([approach, closing, np.cross(approach, closing)], -1)
    wanted /= np.linalg.norm(wanted, axis=1, keepdims=True)
    own = np.stack([hand.approach, hand.closing, np.cross(hand.approach, hand.closing)], -1)
    Ts = np.tile(np.eye(4), (len(tips), 1, 1))
    Ts[:, :3, :3] = wanted @ own.T
    Ts[:, :3, 3] = tips - hand.tip * wanted[:, :, 0]
    return _Listed(Ts, copies * list(names), np.tile(scores, copies))


def _vector(value: Any, where: str) -> Float[np.ndarray, "3"]:
    """Return a vector, as a list or as a message of ROS."""
    if isinstance(value, dict):
        value = [value.get(axis) for axis in "xyz"]
    return finite_array(where, value, (3,))


def _score(value: Any, where: str) -> float:
    if value is None:
        return math.nan
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(f"{where}: score must be a number, not {shown(value)}")
    return float(value)
