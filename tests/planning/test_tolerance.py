"""Laws of how far beside a base pose the robot may stand."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.rooms import Everywhere

from momapos.apps.cli.main import main
from momapos.apps.cli.place import Options
from momapos.apps.cli.tour import room_beside
from momapos.core.errors import InputError
from momapos.core.geometry.transforms import pose_planar
from momapos.model.plan_files.plan_format import read_plan
from momapos.model.records.outcomes import Tolerance
from momapos.model.records.plans import Motion
from momapos.model.robots.robot import Robot, load_robot
from momapos.model.scene.scene_files import load_scene
from momapos.planning.arm_motion.carried_motion import carried
from momapos.planning.base_pose_check import check_base_pose
from momapos.planning.grasps.tasks import make_task
from momapos.planning.plan import plan_base_placement
from momapos.planning.replan_nearby import Depth, FoundAnew
from momapos.planning.result import PlacementResult
from momapos.planning.robust import unit_offsets
from momapos.planning.tolerance import (
    FIRST,
    RADII,
    SAMPLES,
    TURN,
    largest_radius,
    measured_tolerance,
    placement_tolerance,
    with_tolerance,
)

QUESTION = ["kitchen_small", "cabinet_right/drawer_middle_slide", "--robot", "segway_ur5e"]


@pytest.fixture(scope="module")
def answer() -> PlacementResult:
    """A drawer that a UR5e on a Segway opens."""
    scene, robot = load_scene("kitchen_small"), load_robot("segway_ur5e")
    task = make_task(scene, "open", "cabinet_right", "drawer_middle_slide")
    return plan_base_placement(scene, robot, task)


def motion_of(answer: PlacementResult) -> tuple[Robot, np.ndarray, Motion]:
    """Its robot, its base pose and what the arm does there."""
    assert answer.plan.motion is not None
    return answer.prepared.robot, np.array(answer.plan.base_pose), answer.plan.motion


def test_offsets_fill_the_unit_disc_evenly() -> None:
    offsets = unit_offsets(4000, np.random.default_rng(0))
    radius = np.hypot(offsets[:, 0], offsets[:, 1])
    assert radius.max() <= 1.0
    assert np.abs(offsets[:, 2]).max() <= 1.0
    assert (radius < 0.5).mean() == pytest.approx(0.25, abs=0.03)
    np.testing.assert_allclose(offsets.mean(0), 0.0, atol=0.05)


@pytest.mark.parametrize("radius", [0.0, 0.012, 0.03, 0.2])
@pytest.mark.parametrize("fails_at", ["base", "arm", "all"])
def test_the_disc_is_the_largest_that_holds(radius: float, fails_at: Depth) -> None:
    asks = ("base", "arm", "all")

    def beyond(most: float, turn: float):  # type: ignore[no-untyped-def]
        def failure(offsets: np.ndarray, how: Depth) -> int | None:
            if asks.index(how) < asks.index(fails_at):
                return None
            bad = (np.hypot(*offsets[:, :2].T) > most) | (np.abs(offsets[:, 2]) > turn)
            return int(np.flatnonzero(bad)[0]) if bad.any() else None

        return failure

    unit = unit_offsets(2000, np.random.default_rng(3))
    inside = [one for one in RADII if one <= radius]
    # Of so many samples some lie in the outermost hundredth.
    near = (max(inside, default=0.0), *(r for r in RADII if 0 < r - radius < 1e-3))
    assert largest_radius(unit, beyond(radius, np.inf)) in near
    assert largest_radius(unit, beyond(np.inf, 0.02 * TURN)) == 0.02


def test_no_disc_counts_in_which_a_pose_has_failed() -> None:
    """Not even one that its own poses would let pass."""
    unit = unit_offsets(500, np.random.default_rng(4))
    failed: list[float] = []

    def failure(offsets: np.ndarray, how: Depth) -> int | None:
        """At the largest disc a pose near the middle fails; smaller ones are never to blame."""
        if how != "base" or np.abs(offsets[:, :2]).max() < 0.9 * RADII[-1]:
            return None
        level = np.maximum(np.hypot(*offsets[:, :2].T), np.abs(offsets[:, 2]) / TURN)
        failed.append(float(level.min()))
        return int(level.argmin())

    radius = largest_radius(unit, failure)
    assert failed
    assert radius < failed[0]
    assert radius == max((r for r in RADII if r < failed[0]), default=0.0)


def test_the_arm_is_asked_at_few_poses_before_it_is_asked_at_all() -> None:
    asked: list[tuple[str, int]] = []

    def failure(offsets: np.ndarray, how: Depth) -> None:
        asked.append((how, len(offsets)))

    assert largest_radius(unit_offsets(100, np.random.default_rng(0)), failure) == RADII[-1]
    assert {count for how, count in asked if how == "arm"} == {FIRST}
    assert asked[-1] == ("all", 100)


def test_a_carried_motion_has_the_hand_where_it_was(answer: PlacementResult) -> None:
    robot, base, motion = motion_of(answer)
    straight, rng = answer.prepared.motion.grasp_step, np.random.default_rng(2)
    for offset in rng.uniform(-1.0, 1.0, (5, 3)) * [0.03, 0.03, 0.03]:
        other = carried(robot, motion, base, base + offset, straight)
        assert other is not None
        np.testing.assert_array_equal(other.approach[0], motion.approach[0])
        np.testing.assert_allclose(other.approach[-1], other.q[0], atol=0.1)
        Ts = pose_planar(base + offset) @ robot.chain.tool_poses(
            robot.chain.freedom_values(other.q)
        )
        np.testing.assert_allclose(Ts, motion.Ts_world_tool, atol=1e-4)
        assert np.abs(np.diff(other.q, axis=0)).max() < 0.3


def test_what_the_arm_cannot_follow_is_not_carried(answer: PlacementResult) -> None:
    robot, base, motion = motion_of(answer)
    far = base + np.array([1.5, 0.0, 0.0])
    assert carried(robot, motion, base, far, answer.prepared.motion.grasp_step) is None


def test_what_is_carried_counts_only_where_the_exact_check_accepts_it(
    answer: PlacementResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, base, motion = motion_of(answer)
    assert answer.query is not None
    anew = FoundAnew.around(answer.query, base, motion)
    beside = (base + np.array([0.01, 0.0, 0.0]))[None]
    assert anew.failure(beside, "all") is None
    assert anew.asked == 0
    monkeypatch.setattr(type(anew.checks.prepared), "violation", lambda *_: "no")
    assert anew.failure(beside, "arm") is None
    assert anew.failure(beside, "all") == 0
    assert anew.asked == 1


def test_where_the_base_cannot_stand_no_arm_is_asked(answer: PlacementResult) -> None:
    _, base, motion = motion_of(answer)
    assert answer.query is not None
    anew = FoundAnew.around(answer.query, base, motion)
    inside = answer.prepared.scene.object("cabinet_right").T_world_object[:2, 3]
    poses = np.array([base, [*inside, 0.0], base])
    for how in ("base", "arm", "all"):
        assert anew.failure(poses, how) == 1
    assert anew.asked == 0


def test_the_answer_has_its_tolerance_and_poses_in_it_do(answer: PlacementResult) -> None:
    assert answer.plan.tolerance is None
    found = answer.tolerance
    assert found is not None
    assert found.radius in RADII
    assert found.turn == pytest.approx(found.radius * TURN)
    assert found.at_least == pytest.approx(0.97, abs=0.001)
    assert answer.with_tolerance().plan.tolerance == found
    timing = with_tolerance(answer).plan.timing
    assert timing["tolerance"] > 0.0
    assert timing["total"] == answer.plan.timing["total"]
    plan, scene = answer.plan, load_scene("kitchen_small")
    size = np.array([found.radius, found.radius, found.turn])
    for offset in unit_offsets(12, np.random.default_rng(7)):
        pose = np.array(plan.base_pose) + offset * size
        there = check_base_pose(
            scene, answer.prepared.robot, plan.task, pose, Everywhere(), how_far=False
        )
        assert there.motion is not None, there.reason


def test_what_the_clock_raises_ends_the_work(answer: PlacementResult) -> None:
    looks = 0

    def clock() -> float:
        nonlocal looks
        looks += 1
        if looks == 10:
            raise TimeoutError
        return 0.0

    with pytest.raises(TimeoutError):
        with_tolerance(answer, clock=clock)
    assert looks <= 12  # those of the stopwatch, which counts what was spent


def test_without_a_motion_there_is_no_tolerance() -> None:
    scene, robot = load_scene("kitchen_small"), load_robot("segway_ur5e")
    task = make_task(scene, "open", "cabinet_right", "drawer_middle_slide")
    far = np.array([2.0, -1.0, 0.0])
    assert placement_tolerance(scene, robot, task, far, Everywhere()).radius == 0.0


def test_every_answer_of_place_has_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "plan.json"
    few = ["--tolerance-samples", "12"]
    assert main(["place", "open", *QUESTION, *few, "--out", str(out)]) == 0
    said = capsys.readouterr().out
    plan = read_plan(out)
    assert plan.tolerance is not None
    assert plan.tolerance.samples == 12
    assert f"{100 * plan.tolerance.radius:g} cm and" in said
    assert "found anew from 12 of 12 poses" in said
    x, y, yaw = plan.base_pose or (0.0, 0.0, 0.0)
    again = ["--at", f"{x},{y},{yaw}", *few, "--json"]
    assert main(["place", "open", *QUESTION, *again]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["tolerance"]["samples"] == 12
    assert main(["place", "open", *QUESTION, "--no-tolerance", "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["tolerance"] is None
    assert "tolerance" not in data["timing"]


def test_a_stop_of_a_tour_has_the_least_of_its_tasks(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [*QUESTION, "then", "close", QUESTION[1], "--tolerance-samples", "12"]
    assert main(["place", "open", *words, "--out", str(tmp_path / "tour.json")]) == 0
    found = [read_plan(tmp_path / f"tour_{k}.json").tolerance for k in (1, 2)]
    assert found[0] is not None
    assert found[1] is not None
    least = min(found[0], found[1], key=lambda one: one.radius)
    assert f"{least} beside it" in capsys.readouterr().out


def test_the_command_asks_as_many_poses_as_python() -> None:
    assert Options().tolerance_samples == SAMPLES


def test_a_stop_without_room_says_so(answer: PlacementResult) -> None:
    some, none = Tolerance(0.05, 0.05 * TURN, 12), Tolerance(0.0, 0.0, 12)
    plans = [replace(answer.plan, tolerance=one) for one in (some, none)]
    assert room_beside(plans) == "; no tolerance beside it"
    assert room_beside(plans[:1]) == "; 5 cm and 3 deg beside it"
    assert room_beside([answer.plan]) == ""


@pytest.mark.parametrize("samples", [0, 10**9])
def test_the_number_of_samples_makes_sense(samples: int) -> None:
    with pytest.raises(InputError, match="tolerance-samples must be between 1"):
        Options(tolerance_samples=samples)


def test_there_have_to_be_samples(answer: PlacementResult) -> None:
    _, base, motion = motion_of(answer)
    assert answer.query is not None
    with pytest.raises(InputError, match="at least 1"):
        measured_tolerance(answer.query, base, motion, samples=0)


@pytest.mark.parametrize("name", ["ranger_rm63", "fetch"])
def test_the_motion_that_is_known_is_found_where_it_is(name: str) -> None:
    """A hand holds what its spheres stick into: it is not they that are asked there."""
    scene, robot = load_scene("kitchen_small"), load_robot(name)
    answer = plan_base_placement(scene, robot, make_task(scene, "open", "microwave"))
    base, motion = np.array(answer.plan.base_pose), answer.plan.motion
    assert motion is not None
    assert answer.query is not None
    anew = FoundAnew.around(answer.query, base, motion)
    assert anew.failure(base[None], "all") is None
    assert anew.asked == 0
