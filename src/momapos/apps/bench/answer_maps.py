"""Draw some answers: the potential over the floor and the outcome of each candidate."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from momapos.apps.plots import draw_answer
from momapos.model.robots import load_robot
from momapos.model.scene import load_scene
from momapos.planning import plan_by_method
from momapos.planning.grasps import make_task
from momapos.planning.reachability import load_reach

from .bench_records import Protocol, Row, SuiteTask
from .containers import without
from .folder import Contents, scene_path
from .html_report import AnswerMap
from .methods import METHODS, method_config
from .metrics import grouped

OURS = "ours"


def chosen_rows(tasks: Sequence[SuiteTask], rows: Sequence[Row], count: int) -> list[Row]:
    """Select solved rows with one step, of `ours` if it ran, taking the classes in turn.

    Of several protocols the last counts.
    """
    one_step = {task.name for task in tasks if task.inside is None}
    last = rows[-1].protocol if rows else ""
    methods = {row.method for row in rows}
    method = OURS if OURS in methods else next((m for m in METHODS if m in methods), None)
    fit = [
        row
        for row in rows
        if row.task in one_step
        and row.method == method
        and row.protocol == last
        and row.outcome == "solved"
    ]
    by_group = list(grouped(fit, lambda row: row.group).values())
    turns = max(map(len, by_group), default=0)
    return [mine[k] for k in range(turns) for mine in by_group if k < len(mine)][:count]


def draw_maps(folder: Path, found: Contents, rows: Sequence[Row], count: int) -> list[AnswerMap]:
    """Solve some tasks again in the true room, and draw the answers.

    Args:
        folder: The results folder.
        found: Its contents.
        rows: Its rows.
        count: Maximum number of maps.

    Raises:
        MomaposError: A scene or a robot of the folder can't be read any more.
    """
    tasks = {task.name: task for task in found.suite.tasks}
    timeout = found.settings.timeout
    return [
        AnswerMap(
            f"{row.task} by {row.method}", row.key, _drawn(folder, tasks[row.task], row, timeout)
        )
        for row in chosen_rows(found.suite.tasks, rows, count)
    ]


def _drawn(folder: Path, task: SuiteTask, row: Row, timeout: float) -> bytes:
    scene = load_scene(scene_path(folder, task.scene)).with_joints(task.joints)
    scene, robot = without(scene, task.carried), load_robot(task.robot)
    reach = load_reach(robot)
    answer = plan_by_method(
        scene, robot, make_task(scene, task.verb, task.object, task.joint, task.to), reach,
        config=method_config(row.method, timeout, Protocol.of(row.protocol)), seed=task.seed,
        start=None if task.start is None else np.array(task.start),
    )  # fmt: skip
    with tempfile.TemporaryDirectory() as temporary:
        path = Path(temporary) / "answer.png"
        draw_answer(scene, answer, reach, path)
        return path.read_bytes()
