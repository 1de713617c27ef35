"""Figures of answers."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jaxtyping import Float
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Text

from momapos.apps.plots.answer_plot import draw_answer
from momapos.core.errors import InputError
from momapos.model.records.outcomes import PoseOutcome, PoseStatus
from momapos.model.records.plans import Motion, PlacementPlan
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.config import MotionConfig
from momapos.planning.grasps.task_motions import task_motion
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.placement.problem import PoseOutcomes, Search
from momapos.planning.result import PlacementResult
from momapos.planning.task_setup import prepare

BASE = np.array([0.55, -1.6, 1.2])
OUTCOMES = (
    PoseOutcome(PoseStatus.BASE_BLOCKED), PoseOutcome(PoseStatus.OUT_OF_REACH),
    PoseOutcome(PoseStatus.ARM_COLLISION, "fridge/door", "waypoint 3"),
    PoseOutcome(PoseStatus.NO_CONTINUOUS_PATH), PoseOutcome(PoseStatus.NOT_TRIED),
    PoseOutcome(PoseStatus.FEASIBLE), PoseOutcome(PoseStatus.FILTERED),
)  # fmt: skip
NOWHERE = PoseOutcome(PoseStatus.OUT_OF_REACH_ANYWHERE)


class Near:
    """A map on which the arm reaches everything nearby."""

    def min_score(
        self, bases: Float[np.ndarray, "n 3"], Ts_world_tool: Float[np.ndarray, "g w 4 4"]
    ) -> Float[np.ndarray, "n g"]:
        away = bases[:, None, :2] - Ts_world_tool[None, 0, :, :2, 3]
        score = np.clip(1.2 - np.linalg.norm(away, axis=-1), 0.0, 1.0).min(1)
        return np.tile(score[:, None], len(Ts_world_tool))


class Broken:
    """A map that raises when queried."""

    def min_score(self, bases: np.ndarray, Ts_world_tool: np.ndarray) -> np.ndarray:
        raise RuntimeError(f"no map for {len(bases)} bases, {len(Ts_world_tool)} grasps")


def answer_of(
    scene: Scene, robot: Robot, verb: str, name: str, joint: str | None
) -> PlacementResult:
    """Return an answer for drawing only: the arm stays at home."""
    task = make_task(scene, verb, name, joint)
    motion = task_motion(scene, robot, task, MotionConfig())
    tools = motion.Ts_world_tool[0, motion.grasp_step :]
    poses = np.random.default_rng(0).uniform([0, -2.5, -3], [2, 0, 3], (70, 3))
    plan = PlacementPlan(
        scene=scene.name, robot_name=robot.name, robot_urdf="", base_link=robot.base_link,
        tool_link=robot.tool_link, task=task, status="solved", joints=robot.arm_joints,
        base_pose=(0.55, -1.6, 1.2), navigation_cost=1.5, timing={"total": 1.25},
        motion=Motion(
            robot.home[None], np.tile(robot.home, (len(tools), 1)),
            motion.object_q[motion.grasp_step :], tools,
        ),
    )  # fmt: skip
    return PlacementResult(
        plan=plan,
        prepared=prepare(scene, robot, task, PipelineConfig(), clearance=0.01),
        search=Search(poses=[poses], outcomes=[PoseOutcomes(OUTCOMES * 10)], base=BASE),
        start=np.array([1.9, -1.6, 1.57]),
    )


def unsolved(answer: PlacementResult, search: Search) -> PlacementResult:
    plan = replace(
        answer.plan, status="infeasible", base_pose=None, motion=None, navigation_cost=None
    )
    return replace(answer, plan=plan, search=search)


def size_of(path: Path) -> tuple[int, int]:
    """Return the width and height in the header of a PNG file."""
    head = path.read_bytes()[:24]
    assert head[:8] == b"\x89PNG\r\n\x1a\n"
    return struct.unpack(">II", head[16:24])


@pytest.mark.parametrize(
    ("verb", "name", "joint"),
    [
        ("open", "fridge", "door_hinge"),
        ("open", "cabinet_right", "drawer_top_slide"),
        ("pick", "cup", None),
    ],
)
def test_an_answer_becomes_a_png_of_1600_by_1200(
    kitchen: Scene, fetch: Robot, tmp_path: Path, verb: str, name: str, joint: str | None
) -> None:
    path = tmp_path / "new" / "plan.png"
    draw_answer(kitchen, answer_of(kitchen, fetch, verb, name, joint), Near(), path)
    assert size_of(path) == (1600, 1200)
    assert list(path.parent.iterdir()) == [path]


def test_equal_answers_give_equal_figures(kitchen: Scene, fetch: Robot, tmp_path: Path) -> None:
    answer = answer_of(kitchen, fetch, "open", "fridge", "door_hinge")
    for name in ("a.png", "b.png"):
        draw_answer(kitchen, answer, Near(), tmp_path / name)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """The figures that a test saves."""
    found, save = [], Figure.savefig

    def keep(figure: Figure, *args: Any, **options: Any) -> None:
        found.append(figure)
        save(figure, *args, **options)

    monkeypatch.setattr(Figure, "savefig", keep)
    return found


def test_the_drive_is_drawn_along_the_path_of_the_base(
    kitchen: Scene, fetch: Robot, tmp_path: Path, drawn: list[Figure]
) -> None:
    answer = answer_of(kitchen, fetch, "open", "fridge", "door_hinge")
    corner = np.array([[2.6, -3.1, 0.0], [1.0, -3.2, 2.0], BASE])
    answer = replace(answer, plan=replace(answer.plan, base_path=corner))
    draw_answer(kitchen, answer, Near(), tmp_path / "a.png")
    lines = [np.asarray(line.get_xydata()) for line in drawn[0].findobj(Line2D)]
    assert any(np.array_equal(line, corner[:, :2]) for line in lines)


def test_all_characters_of_a_figure_are_drawn(
    kitchen: Scene, fetch: Robot, tmp_path: Path, drawn: list[Figure]
) -> None:
    """Where a text could not be shown, it has a question mark."""
    answer = answer_of(kitchen, fetch, "open", "fridge", "door_hinge")
    counted = replace(answer.plan.candidates, sampled=12345)
    answer = replace(answer, plan=replace(answer.plan, candidates=counted))
    draw_answer(kitchen, answer, Near(), tmp_path / "a.png")
    words = [text.get_text() for text in drawn[0].findobj(Text)]
    assert "12,345" in words
    assert not any("?" in text for text in words)


@pytest.mark.parametrize(
    "search",
    [
        Search(),
        Search(poses=[np.zeros((0, 3))], outcomes=[PoseOutcomes([])]),
        Search(poses=[np.zeros((1, 3))], outcomes=[PoseOutcomes([NOWHERE])]),
        Search(poses=[np.ones((2, 3))], outcomes=[PoseOutcomes([OUTCOMES[0]] * 2)]),
    ],
    ids=["nothing", "no candidates", "out of reach at any distance", "all blocked"],
)
def test_an_infeasible_answer_is_drawn_too(
    kitchen: Scene, fetch: Robot, tmp_path: Path, search: Search
) -> None:
    answer = unsolved(answer_of(kitchen, fetch, "open", "fridge", "door_hinge"), search)
    draw_answer(kitchen, answer, Near(), tmp_path / "plan.png")
    assert size_of(tmp_path / "plan.png") == (1600, 1200)


def test_a_room_without_a_floor_is_drawn_too(kitchen: Scene, fetch: Robot, tmp_path: Path) -> None:
    bare = replace(kitchen, floor_polygon=None, objects=kitchen.objects[:3])
    answer = answer_of(bare, fetch, "open", "fridge", "door_hinge")
    draw_answer(bare, answer, Near(), tmp_path / "plan.png")
    assert size_of(tmp_path / "plan.png") == (1600, 1200)


def test_a_failed_figure_leaves_the_old_file_unchanged(
    kitchen: Scene, fetch: Robot, tmp_path: Path
) -> None:
    path = tmp_path / "plan.png"
    path.write_bytes(b"old")
    answer = answer_of(kitchen, fetch, "open", "fridge", "door_hinge")
    with pytest.raises(RuntimeError, match="no map"):
        draw_answer(kitchen, answer, Broken(), path)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_an_unwritable_path_is_reported_and_left_unchanged(
    kitchen: Scene, fetch: Robot, tmp_path: Path
) -> None:
    answer = unsolved(answer_of(kitchen, fetch, "pick", "cup", None), Search())
    folder = tmp_path / "plan.png"
    folder.mkdir()
    with pytest.raises(InputError, match=r"plan\.png: cannot be written"):
        draw_answer(kitchen, answer, Near(), folder)
    assert list(tmp_path.iterdir()) == [folder]
    assert list(folder.iterdir()) == []
