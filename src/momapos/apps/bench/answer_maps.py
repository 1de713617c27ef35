"""Pictures of some answers: the potential over the floor, and what became of the candidates."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from momapos.apps.plots import draw_answer
from momapos.core import user_cache
from momapos.model.robots import load_robot
from momapos.model.scene import load_scene
from momapos.planning.baselines import plan_by_method
from momapos.planning.grasps import make_task
from momapos.planning.reachability import load_reach

from .bench_records import Row, SuiteTask
from .containers import without
from .folder import Contents, scene_path
from .html_report import Picture
from .methods import METHODS, method_config
from .metrics import grouped

OURS = "ours"


def chosen_rows(tasks: Sequence[SuiteTask], rows: Sequence[Row], count: int) -> list[Row]:
    """Rows to be drawn: one step, solved, by ours where it was asked; of every class in turn."""
    one_step = {task.name for task in tasks if task.inside is None}
    methods = {row.method for row in rows}
    known = [OURS] if OURS in methods else [m for m in METHODS if m in methods]
    fit = [
        row
        for row in rows
        if row.task in one_step and row.method in known[:1] and row.outcome == "solved"
    ]
    by_group = list(grouped(fit, lambda row: row.group).values())
    turns = max(map(len, by_group), default=0)
    return [mine[k] for k in range(turns) for mine in by_group if k < len(mine)][:count]


def pictures(folder: Path, found: Contents, rows: Sequence[Row], count: int) -> list[Picture]:
    """Ask some tasks again in the room as it is, and draw the answers.

    Args:
        folder: The results folder.
        found: What it holds.
        rows: Its rows.
        count: How many pictures at most.

    Raises:
        MomaposError: A scene or a robot of the folder cannot be read any more.
    """
    tasks = {task.name: task for task in found.suite.tasks}
    timeout = found.settings.timeout
    return [
        Picture(
            f"{row.task} by {row.method}", row.key, _drawn(folder, tasks[row.task], row, timeout)
        )
        for row in chosen_rows(found.suite.tasks, rows, count)
    ]


def _drawn(folder: Path, task: SuiteTask, row: Row, timeout: float) -> bytes:
    """The answer to one task as a PNG."""
    scene = load_scene(scene_path(folder, task.scene), cache=user_cache()).with_joints(task.joints)
    scene, robot = without(scene, task.carried), load_robot(task.robot)
    reach = load_reach(robot, user_cache().folder)
    asked = make_task(scene, task.verb, task.object, task.joint, task.to)
    answer = plan_by_method(
        scene, robot, asked, reach, config=method_config(row.method, timeout), seed=task.seed,
        start=None if task.start is None else np.array(task.start),
    )  # fmt: skip
    with tempfile.TemporaryDirectory() as temporary:
        path = Path(temporary) / "answer.png"
        draw_answer(scene, answer, reach, path)
        return path.read_bytes()
