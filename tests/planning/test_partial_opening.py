"""Laws of the maximum opening: how far a part opens, and from which base pose."""

from __future__ import annotations

import io
import math
from contextlib import redirect_stdout
from dataclasses import replace
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from jaxtyping import Bool, Float
from tests.commands import json_of, output_of
from tests.cupboards import HINGE, carcass, furniture_room, link
from tests.rooms import Everywhere, cabinet_room, kitchen_without_springs
from tests.shapes import unchecked

from momapos.apps.cli.main import main
from momapos.core.stopwatch import Stopwatch
from momapos.model.plan_files.plan_format import read_plan
from momapos.model.records.plans import PlacementPlan
from momapos.model.robots.robot import Robot, load_robot
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene
from momapos.model.scene.scene_object import SceneObject
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import check_base_pose, plan_base_placement
from momapos.planning.max_opening import find_max_opening, last_of_all, last_that_works
from momapos.planning.partial_opening import is_beyond_any_opening, with_max_opening
from momapos.planning.plan import plan_to_value
from momapos.planning.query import PlacementQuery
from momapos.planning.result import PlacementResult
from momapos.verification.exact_check import PlanVerifier
from momapos.verification.plan_check import verify_files

DOOR_WITH_BAR = link(
    "door", ((0.02, 0.59, 0.88), (0, 0.295, 0)), handle=((0.02, 0.02, 0.16), (-0.05, 0.53, 0.1))
)


@pytest.fixture(scope="module")
def kitchen_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return kitchen_without_springs(tmp_path_factory.mktemp("kitchen"))


@pytest.fixture(scope="module")
def lid(kitchen_file: Path) -> list[str]:
    """Return a question: the Fetch blocks the dishwasher's lid before it is fully open."""
    return ["place", "open", str(kitchen_file), "dishwasher/door_hinge", "--robot", "fetch"]


@pytest.fixture(scope="module")
def kitchen(kitchen_file: Path) -> Scene:
    return load_scene(kitchen_file)


@pytest.fixture(scope="module")
def refused_file(lid: list[str], tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Ask for the whole opening of the lid; return the file and the output of the answer."""
    path, out = tmp_path_factory.mktemp("refused") / "plan.json", io.StringIO()
    with redirect_stdout(out):
        assert main([*lid, "--out", str(path)]) == 3
    return path, out.getvalue()


@pytest.fixture(scope="module")
def refused(refused_file: tuple[Path, str]) -> PlacementPlan:
    """Return the plan for the lid, which cannot be opened to 90 degrees."""
    return read_plan(refused_file[0])


def test_an_infeasible_opening_is_answered_with_one_that_works(
    lid: list[str], kitchen: Scene, refused: PlacementPlan
) -> None:
    goal = make_task(kitchen, "open", "dishwasher", "door_hinge").to
    assert 0.2 * goal < refused.feasible_to < 0.8 * goal
    degrees = f"{np.degrees(refused.feasible_to):.0f}"
    assert f"to {degrees} deg: solved" in output_of(*lid, "--to", f"{degrees}deg")


def test_the_output_states_the_feasible_opening_and_its_base_pose(
    refused_file: tuple[Path, str], refused: PlacementPlan
) -> None:
    x, y, yaw = refused.feasible_from
    to = f"{math.degrees(refused.feasible_to):.0f} deg"
    pose = f"({x:.3f}, {y:.3f}, {math.degrees(yaw):.1f} deg)"
    assert f"infeasible  not to 90 deg, but at least to {to} from {pose}\n" in refused_file[1]


def test_a_stated_opening_is_sure_only_where_the_part_itself_is_blocked(
    fetch: Robot, tmp_path: Path
) -> None:
    scene = furniture_room(tmp_path, [carcass(), DOOR_WITH_BAR, HINGE])
    lamp = SceneObject.box("lamp", (0.06, 0.06, 0.1), (0.08, 0.0, 0.84))
    task = make_task(scene, "open", "cupboard", to="80deg")
    for room, sure in ((scene, False), (replace(scene, objects=(*scene.objects, lamp)), True)):
        query = PlacementQuery.of(room, fetch, task)
        values = np.radians(np.arange(1.0, 80.0))
        found, proved = find_max_opening(query, plan_to_value, values, within=7, timeout=60.0)
        assert proved == sure
        beyond = replace(task, to=found.plan.task.to + math.radians(1.0))
        blocked = PlanVerifier(room, fetch, beyond).blocked(0.0)
        assert (blocked is not None) == sure


@pytest.mark.parametrize("known", [-1, 1, 14])
def test_all_values_beyond_a_known_one_are_tried_once(known: int) -> None:
    works = {0, 1, 4, 5, 6, 9, 14, 26}
    tried: list[int] = []

    def evaluate(index: int) -> int | None:
        tried.append(index)
        return index if index in works else None

    assert last_of_all(evaluate, known, 30) == 26
    assert len(set(tried)) == len(tried)
    assert set(tried) >= {27, 28, 29}
    assert all(known < index < 30 for index in tried)
    assert last_of_all(evaluate, 26, 30) is None


@pytest.mark.parametrize("seed", range(20))
def test_no_value_that_is_solved_directly_is_beyond_the_largest_one_found(
    kitchen: Scene, fetch: Robot, seed: int
) -> None:
    """Answers with gaps, as of a search that misses base poses; samples miss more than the grid."""
    rng = np.random.default_rng(seed)
    values = np.radians(np.arange(1.0, 80.0))
    end = int(rng.integers(10, 80))
    thorough = rng.random(len(values)) < np.where(np.arange(len(values)) < end // 2, 1.0, 0.2)
    sampled = thorough & (rng.random(len(values)) < 0.7)
    blocked = np.arange(len(values)) >= end

    def answer(query: PlacementQuery) -> Any:
        index = int(np.abs(values - query.task.to).argmin())
        works = (thorough if query.config.place.grid else sampled)[index] and not blocked[index]
        plan = SimpleNamespace(feasible=works, task=query.task)
        prepared = SimpleNamespace(blocked="a wall" if blocked[index] else "")
        return SimpleNamespace(plan=plan, prepared=prepared)

    task = make_task(kitchen, "open", "dishwasher", "door_hinge")
    query = PlacementQuery(kitchen, fetch, task, Everywhere())
    with unchecked():  # answers and map are stand-ins
        found, sure = find_max_opening(query, answer, values, within=7, timeout=60.0)
    last = np.flatnonzero(thorough & ~blocked)[-1]
    assert found.plan.task.to == pytest.approx(values[last])
    assert sure == (last + 1 == end < len(values))


@pytest.mark.slow
@pytest.mark.parametrize("robot_name", ["fetch", "segway_ur5e", "ranger_rm63", "tiago"])
def test_with_enough_time_nothing_is_solved_beyond_the_stated_opening(
    kitchen: Scene, robot_name: str
) -> None:
    robot = load_robot(robot_name)
    task = make_task(kitchen, "open", "dishwasher", "door_hinge")
    answer = plan_base_placement(kitchen, robot, task, config=PipelineConfig(timeout=600.0))
    if answer.plan.status == "solved":
        return
    stated = with_max_opening(answer).plan.feasible_to or 0.0
    for ahead in (1.0, 2.0, 3.0, 6.0):
        farther = replace(task, to=stated + math.radians(ahead))
        assert plan_base_placement(kitchen, robot, farther).plan.status == "infeasible"


def nowhere(poses: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
    return np.zeros(len(poses), bool)


@pytest.fixture(scope="module")
def excluded(kitchen: Scene, fetch: Robot) -> PlacementResult:
    """Return the answer of a user who allows no base pose."""
    task = make_task(kitchen, "open", "dishwasher", "door_hinge")
    return plan_base_placement(kitchen, fetch, task, keep_poses=nowhere)


def test_the_time_limit_ends_the_search_for_a_smaller_value_and_a_note_says_so(
    excluded: PlacementResult,
) -> None:
    times = count()
    late = with_max_opening(excluded, clock=lambda: 1e6 * next(times)).plan
    assert late.feasible_to is None
    assert late.notes[0].startswith("the time limit ended the search for a smaller value")
    assert not excluded.plan.notes


def test_no_opening_is_stated_from_base_poses_that_the_user_excludes(
    excluded: PlacementResult, refused: PlacementPlan
) -> None:
    assert refused.feasible_to is not None
    assert with_max_opening(excluded).plan.feasible_to is None


@pytest.mark.parametrize(("height", "beyond"), [(0.0, False), (1.6, True)])
def test_only_a_part_out_of_reach_of_an_empty_room_is_beyond_any_opening(
    tmp_path: Path, segway: Robot, height: float, beyond: bool
) -> None:
    # The base does not drive onto the slab around the cabinet.
    slab = (
        ', {"name": "slab", "category": "slab", "pose": {"xyz": [0, 0, 0.02],'
        ' "wxyz": [1, 0, 0, 0]}, "box": [8.0, 7.0, 0.04]}'
    )
    scene = cabinet_room(tmp_path, extra=slab)
    cabinet, other = scene.objects
    T = cabinet.T_world_object.copy()
    T[2, 3] += height
    room = replace(scene, objects=(replace(cabinet, T_world_object=T), other))
    room = replace(room, start=np.array([0.0, -5.0, 1.57]))
    answer = plan_base_placement(room, segway, make_task(room, "open", "cabinet"), seed=0)
    assert answer.plan.status == "infeasible"
    assert is_beyond_any_opening(answer) is beyond
    assert with_max_opening(answer).plan.feasible_to is None


def test_the_stated_base_pose_opens_to_the_stated_value(
    kitchen: Scene, fetch: Robot, refused: PlacementPlan
) -> None:
    assert refused.feasible_from is not None
    task = replace(refused.task, to=refused.feasible_to)
    assert check_base_pose(kitchen, fetch, task, refused.feasible_from).motion is not None


def test_the_maximum_opening_has_a_valid_plan_and_one_degree_more_has_none(
    lid: list[str], tmp_path: Path, kitchen: Scene, fetch: Robot
) -> None:
    path = tmp_path / "plan.json"
    assert "deg (largest found): solved" in output_of(*lid, "--to", "max", "--out", str(path))
    plan = read_plan(path)
    assert plan.task.to == plan.motion.object_q[-1]
    assert not plan.task.farthest
    assert verify_files(path).valid
    beyond = replace(plan.task, to=plan.motion.object_q[-1] + math.radians(1.0), farthest=False)
    assert plan_base_placement(kitchen, fetch, beyond).plan.status == "infeasible"


def test_a_part_that_opens_all_the_way_is_opened_to_its_limit(kitchen: Scene, fetch: Robot) -> None:
    task = make_task(kitchen, "open", "cabinet_left", "drawer_slide", "max")
    plan = plan_base_placement(kitchen, fetch, task).plan
    assert plan.status == "solved"
    assert plan.task.to == kitchen.object("cabinet_left").model.joint("drawer_slide").upper


def test_a_search_for_the_maximum_without_time_finds_nothing(tmp_path: Path, segway: Robot) -> None:
    room = cabinet_room(tmp_path)
    task, config = make_task(room, "open", "cabinet", "hinge"), PipelineConfig()
    watch = Stopwatch(lambda: 0.0)
    query = PlacementQuery(room, segway, task, Everywhere(), config=config, watch=watch)
    values = np.radians([10.0])
    none, sure = find_max_opening(query, plan_to_value, values, within=1, timeout=0.0)
    assert none is None
    assert not sure
    found, _ = find_max_opening(query, plan_to_value, values, within=1, timeout=100.0)
    assert found.plan.task.to == values[0]


def test_the_check_of_a_base_pose_returns_how_far_the_part_opens_from_it(
    kitchen: Scene, fetch: Robot, refused: PlacementPlan
) -> None:
    found = check_base_pose(kitchen, fetch, refused.task, refused.feasible_from)
    assert found.motion is None
    assert found.farthest >= refused.feasible_to - 1e-9
    blocked = check_base_pose(kitchen, fetch, refused.task, (0.6, -0.3, np.pi / 2))
    assert (blocked.motion, blocked.farthest) == (None, None)
    brief = check_base_pose(kitchen, fetch, refused.task, refused.feasible_from, how_far=False)
    assert brief.farthest is None
    assert brief.reason == found.reason


def test_a_given_base_pose_is_answered_with_its_plan_or_the_reason(
    lid: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str], refused: PlacementPlan
) -> None:
    at = ["--at", ",".join(f"{v:.9f}" for v in refused.feasible_from)]
    no = json_of(*lid, *at, "--json", status=3)
    assert tuple(no["base_pose"].values()) == pytest.approx(refused.feasible_from)
    assert no["feasible_to"] >= refused.feasible_to - 1e-9
    assert no["feasible_from"] == no["base_pose"]
    assert list(no["candidates"]["rejections"].values()) == [1]
    to, path = f"{math.degrees(refused.feasible_to):.0f}deg", tmp_path / "plan.json"
    assert main([*lid, *at, "--to", to, "--out", str(path)]) == 0
    assert verify_files(path).valid
    capsys.readouterr()
    assert main([*lid, "--at", "0.6,-0.3,90deg"]) == 3
    line = "from (0.600, -0.300, 90.0 deg): the hand hits the floor in every grasp\n"
    assert line in capsys.readouterr().out


@pytest.mark.parametrize("last", range(-1, 20))
@pytest.mark.parametrize("step", [None, 1, 7])
@pytest.mark.parametrize("within", [1, 7])
def test_the_last_index_that_works_is_found(last: int, step: int | None, within: int) -> None:
    tried: list[int] = []

    def evaluate(index: int) -> str | None:
        tried.append(index)
        return f"{index}" if index <= last else None

    found, answer = last_that_works(evaluate, -1, 20, within=within, first_step=step)
    assert last - within < found <= last
    assert answer == (None if found < 0 else f"{found}")
    assert len(set(tried)) == len(tried)
    assert all(0 <= index < 20 for index in tried)
