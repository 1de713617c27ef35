"""Map how far a part can be moved from each cell of the floor, at the best yaw of the cell."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib import import_module
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.records import ReachScorer, Task
from momapos.model.robots import Robot
from momapos.model.scene import Scene
from momapos.planning.arm_motion import Feasibility
from momapos.planning.grasps import slides
from momapos.planning.placement import BaseStatus, base_pose_status, reachable_rectangle

from .config import PipelineConfig
from .task_setup import PreparedTask, prepare

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

DEFAULT = PipelineConfig()
YAWS = 16
"""Number of yaws tried in each cell [-]."""
TURNING_GRASP_WEIGHT = 1e-6
"""Factor on the scores of turning grasps, so that they are tried last: they take longer [-]."""
YAW_BATCHES = (1, 4, YAWS)
"""Ends of the batches in which the yaws of a cell are tried, best reached first [-]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class FloorMap:
    """A grid of base positions, each with its best yaw."""

    yaw: Float[np.ndarray, "rows columns"]
    """That yaw [rad]; NaN where there is none."""
    low: Float[np.ndarray, "2"]
    """Corner of cell (0, 0) [m]."""
    cell: float
    """Edge of a cell [m]."""

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Return left, right, bottom and top [m]."""
        rows, columns = self.yaw.shape
        right, top = self.low + self.cell * np.array([columns, rows])
        return (float(self.low[0]), float(right), float(self.low[1]), float(top))

    def corners(self, colored: Bool[np.ndarray, "rows columns"]) -> list[Float[np.ndarray, "2 2"]]:
        """Return the lower and upper corner of each row of colored cells [m]."""
        rows, columns = np.nonzero(colored)
        found = []
        for row in np.unique(rows):
            own = columns[rows == row]
            cells = np.array([[own.min(), row], [own.max() + 1, row + 1]])
            found.append(self.low + self.cell * cells)
        return found


@dataclass(frozen=True, eq=False, kw_only=True)
class OpeningMap(FloorMap):
    """The farthest joint value that works from each cell of the floor."""

    scene: Scene
    task: Task
    begin: float
    """Joint value in the scene [rad] or [m]."""
    farthest: Float[np.ndarray, "rows columns"]
    """Farthest value that works [rad] or [m]; NaN where not even the first one works."""
    values: Float[np.ndarray, " k"]
    """Values that were tried, the nearest to `begin` first [rad] or [m]."""

    def _repr_png_(self) -> bytes:
        """Return the figure that a notebook shows."""
        # By name: figures depend on records.
        png: bytes = import_module("momapos.apps.plots.notebook_images").opening_png(self)
        return png


def opening_map(
    scene: Scene,
    robot: Robot,
    task: Task,
    reach: ReachScorer,
    *,
    cell: float = 0.1,
    config: PipelineConfig = DEFAULT,
    seed: int = 0,
    report: Callable[[float], None] = lambda _: None,
) -> OpeningMap:
    """Find how far a part can be moved from each cell of the floor.

    At the center of a cell, with all objects modeled, values are checked from the farthest down,
    including the arm path from home and the exact check. The base path to the cell is not checked.

    Args:
        scene: The scene.
        robot: The robot.
        task: The task; its value is the farthest that is tried.
        reach: The robot's reachability map.
        cell: Edge of a cell [m].
        config: How to plan.
        seed: The same seed gives the same map.
        report: Called with the completed share, in [0, 1].
    """
    values = waypoint_values(scene, task, config)
    nearest = _prepared(scene, robot, task, float(values[0]), config)
    low, shape = _grid(nearest, cell)
    poses = cell_poses(low, cell, shape)
    farthest, yaw = np.full(len(poses), np.nan), np.full(len(poses), np.nan)
    for done, value in enumerate(values[::-1].tolist()):
        report(done / len(values))
        left = np.flatnonzero(np.isnan(farthest))
        prepared = nearest if value == values[0] else _prepared(scene, robot, task, value, config)
        if prepared.infeasible_reason or not len(left):
            continue
        feasible = prepared.feasibility(config, seed)
        best = _best_yaws(prepared, feasible, reach, poses[left])
        works = best >= 0
        farthest[left[works]] = value
        yaw[left[works]] = poses[0, best[works], 2]
    return OpeningMap(
        yaw=yaw.reshape(shape), low=low, cell=cell, scene=scene, task=task,
        begin=scene.object(task.object).values()[task.joint or ""],
        farthest=farthest.reshape(shape), values=values,
    )  # fmt: skip


def cell_poses(
    low: Float[np.ndarray, "2"], cell: float, shape: tuple[int, int]
) -> Float[np.ndarray, "c y 3"]:
    """Return the base poses of all yaws at the centers of the cells, row by row.

    Args:
        low: Corner of cell (0, 0) [m].
        cell: Edge of a cell [m].
        shape: Number of rows and columns.
    """
    x, y = (low[k] + cell * (np.arange(shape[1 - k]) + 0.5) for k in (0, 1))
    poses = np.empty((shape[0] * shape[1], YAWS, 3))
    poses[..., :2] = np.stack(np.meshgrid(x, y)).reshape(2, -1).T[:, None]
    poses[..., 2] = 2 * np.pi / YAWS * np.arange(YAWS) - np.pi
    return poses


def waypoint_values(scene: Scene, task: Task, config: PipelineConfig) -> Float[np.ndarray, " k"]:
    """Return the values of a task's joint at the spacing of waypoints, excluding its value now."""
    assert task.joint is not None
    assert task.to is not None
    begin = scene.object(task.object).values()[task.joint]
    motion = config.motion
    step = motion.waypoint_slide if slides(scene, task) else np.radians(motion.waypoint_angle)
    count = max(1, int(np.ceil(abs(task.to - begin) / step - 1e-9)))
    return np.linspace(begin, task.to, count + 1)[1:]


def _prepared(
    scene: Scene, robot: Robot, task: Task, value: float, config: PipelineConfig
) -> PreparedTask:
    one = replace(task, to=value, farthest=False)
    return prepare(scene, robot, one, config, clearance=config.place.clearance)


def _grid(prepared: PreparedTask, cell: float) -> tuple[Float[np.ndarray, "2"], tuple[int, int]]:
    """Return the grid's corner [m], and its rows and columns; no cells if nothing is in reach."""
    corners = reachable_rectangle(prepared.geometry)
    if corners is None:
        return np.zeros(2), (0, 0)
    low = np.floor(corners[0] / cell) * cell
    columns, rows = np.ceil((corners[1] - low) / cell).astype(int).tolist()
    return low, (rows, columns)


def _best_yaws(
    prepared: PreparedTask,
    feasible: Feasibility,
    reach: ReachScorer,
    poses: Float[np.ndarray, "c y 3"],
) -> Int[np.ndarray, " c"]:
    """Return for each cell the best-reached of its yaws that works; -1 where none does."""
    flat, geometry = poses.reshape(-1, 3), prepared.geometry
    scores = np.zeros((len(flat), prepared.motion.turning.modes), np.float32)
    clear = np.flatnonzero(base_pose_status(geometry, flat)[0] == BaseStatus.CLEAR)
    scores[clear] = _scores(reach, flat[clear], prepared)
    best = scores.max(1, initial=0.0).reshape(poses.shape[:2])
    order = np.argsort(-best, axis=1, kind="stable")
    found = np.full(len(poses), -1)
    for first, last in zip((0, *YAW_BATCHES[:-1]), YAW_BATCHES, strict=True):
        yaws = order[:, first:last]
        promising = (np.take_along_axis(best, yaws, 1) > 0) & (found < 0)[:, None]
        cells, rank = np.nonzero(promising)
        rows = cells * poses.shape[1] + yaws[cells, rank]
        screened = feasible.screen(flat[rows], scores[rows], None)
        assert screened is not None  # nothing stops it
        for row, cell, one in zip(rows.tolist(), cells.tolist(), screened, strict=True):
            if found[cell] >= 0 or one.q is None:
                continue
            modes = np.argsort(-scores[row], kind="stable")[: int((scores[row] > 0).sum())]
            if feasible(flat[row], one, modes).motion is not None:
                found[cell] = row - cell * poses.shape[1]
    return found


def _scores(
    reach: ReachScorer, poses: Float[np.ndarray, "n 3"], prepared: PreparedTask
) -> Float[np.ndarray, "n h"]:
    """Return the scores of all grasp modes; turning grasps rank after all rigid ones."""
    grasps, *turning = (score(reach, poses).scores for score in prepared.mode_scorers)
    if not turning:
        return grasps
    return np.concatenate([grasps, TURNING_GRASP_WEIGHT * turning[0][:, grasps.shape[1] :]], axis=1)
