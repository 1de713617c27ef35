"""Laws of the tolerance of a base pose."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.commands import json_of, output_of
from tests.rooms import Everywhere

from momapos.apps.cli.main import main
from momapos.apps.cli.place import Options
from momapos.apps.cli.tour import _stop_tolerance
from momapos.core.errors import InputError
from momapos.core.geometry.transforms import pose_planar
from momapos.model.plan_files.plan_format import read_plan
from momapos.model.records.outcomes import Tolerance
from momapos.model.records.plans import Motion
from momapos.model.robots.robot import Robot, load_robot
from momapos.model.scene.scene import Scene
from momapos.planning.arm_motion.feasibility import adapt_motion
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import check_base_pose, placement_tolerance, plan_base_placement
from momapos.planning.placement.problem import Search
from momapos.planning.result import PlacementResult
from momapos.planning.robust import unit_offsets
from momapos.planning.tolerance import (
    NUM_FARTHEST,
    RADII,
    SAMPLES,
    TURN_PER_RADIUS,
    Depth,
    NearbyReplanner,
    largest_radius,
    measured_tolerance,
    with_tolerance,
)

QUESTION = ["kitchen_small", "cabinet_right/drawer_middle_slide", "--robot", "segway_ur5e"]


@pytest.fixture(scope="module")
def answer(kitchen: Scene, segway: Robot) -> PlacementResult:
    """Return the plan of a Segway with a UR5e that opens a drawer."""
    task = make_task(kitchen, "open", "cabinet_right", "drawer_middle_slide")
    return plan_base_placement(kitchen, segway, task)


def motion_of(answer: PlacementResult) -> tuple[Robot, np.ndarray, Motion]:
    """Return the robot, the base pose and the motion of an answer."""
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
def test_the_largest_disc_without_a_failure_is_found(radius: float, fails_at: Depth) -> None:
    depths = ("base", "arm", "all")

    def beyond(most: float, turn: float):  # type: ignore[no-untyped-def]
        def failure(offsets: np.ndarray, depth: Depth) -> int | None:
            if depths.index(depth) < depths.index(fails_at):
                return None
            bad = (np.hypot(*offsets[:, :2].T) > most) | (np.abs(offsets[:, 2]) > turn)
            return int(np.flatnonzero(bad)[0]) if bad.any() else None

        return failure

    unit = unit_offsets(2000, np.random.default_rng(3))
    inside = [one for one in RADII if one <= radius]
    # With this many samples some lie in the outermost 1 % of the radius.
    near = (max(inside, default=0.0), *(r for r in RADII if 0 < r - radius < 1e-3))
    assert largest_radius(unit, beyond(radius, np.inf)) in near
    assert largest_radius(unit, beyond(np.inf, 0.02 * TURN_PER_RADIUS)) == 0.02


def test_a_disc_with_a_failed_pose_never_counts() -> None:
    """Not even if all its own samples succeed."""
    unit = unit_offsets(500, np.random.default_rng(4))
    failed: list[float] = []

    def failure(offsets: np.ndarray, depth: Depth) -> int | None:
        """Fail near the center of the largest disc only."""
        if depth != "base" or np.abs(offsets[:, :2]).max() < 0.9 * RADII[-1]:
            return None
        level = np.maximum(np.hypot(*offsets[:, :2].T), np.abs(offsets[:, 2]) / TURN_PER_RADIUS)
        failed.append(float(level.min()))
        return int(level.argmin())

    radius = largest_radius(unit, failure)
    assert failed
    assert radius < failed[0]
    assert radius == max((r for r in RADII if r < failed[0]), default=0.0)


def test_the_arm_is_checked_at_few_poses_before_all() -> None:
    checked: list[tuple[str, int]] = []

    def failure(offsets: np.ndarray, depth: Depth) -> None:
        checked.append((depth, len(offsets)))

    assert largest_radius(unit_offsets(100, np.random.default_rng(0)), failure) == RADII[-1]
    assert {count for depth, count in checked if depth == "arm"} == {NUM_FARTHEST}
    assert checked[-1] == ("all", 100)


def test_an_adapted_motion_keeps_the_tool_poses(answer: PlacementResult) -> None:
    robot, base, motion = motion_of(answer)
    straight, rng = answer.prepared.motion.grasp_step, np.random.default_rng(2)
    for offset in rng.uniform(-1.0, 1.0, (5, 3)) * [0.03, 0.03, 0.03]:
        other = adapt_motion(robot, motion, base, base + offset, straight)
        np.testing.assert_array_equal(other.approach[0], motion.approach[0])
        np.testing.assert_allclose(other.approach[-1], other.q[0], atol=0.1)
        Ts = pose_planar(base + offset) @ robot.chain.tool_poses(
            robot.chain.freedom_values(other.q)
        )
        np.testing.assert_allclose(Ts, motion.Ts_world_tool, atol=1e-4)
        assert np.abs(np.diff(other.q, axis=0)).max() < 0.3


def test_a_motion_that_the_arm_cannot_follow_is_not_adapted(answer: PlacementResult) -> None:
    robot, base, motion = motion_of(answer)
    far = base + np.array([1.5, 0.0, 0.0])
    assert adapt_motion(robot, motion, base, far, answer.prepared.motion.grasp_step) is None


def test_an_adapted_motion_counts_only_if_the_exact_check_accepts_it(
    answer: PlacementResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, base, motion = motion_of(answer)
    replanner = NearbyReplanner.around(answer.query, base, motion)
    nearby = (base + np.array([0.01, 0.0, 0.0]))[None]
    assert replanner.failure(nearby, "all") is None
    assert replanner.replanned == 0
    monkeypatch.setattr(type(replanner.checks.prepared), "violation", lambda *_: "no")
    assert replanner.failure(nearby, "arm") is None
    assert replanner.failure(nearby, "all") == 0
    assert replanner.replanned == 1


def test_a_blocked_base_fails_before_any_arm_is_checked(answer: PlacementResult) -> None:
    _, base, motion = motion_of(answer)
    replanner = NearbyReplanner.around(answer.query, base, motion)
    inside = answer.prepared.scene.object("cabinet_right").T_world_object[:2, 3]
    poses = np.array([base, [*inside, 0.0], base])
    for depth in ("base", "arm", "all"):
        assert replanner.failure(poses, depth) == 1
    assert replanner.replanned == 0


def test_poses_within_the_tolerance_of_an_answer_are_feasible(
    answer: PlacementResult, kitchen: Scene
) -> None:
    assert answer.plan.tolerance is None
    found = answer.tolerance
    assert found.radius in RADII
    assert found.turn == pytest.approx(found.radius * TURN_PER_RADIUS)
    assert found.at_least == pytest.approx(0.97, abs=0.001)
    assert answer.with_tolerance().plan.tolerance == found
    timing = with_tolerance(answer).plan.timing
    assert timing["tolerance"] > 0.0
    assert timing["total"] == answer.plan.timing["total"]
    plan = answer.plan
    size = np.array([found.radius, found.radius, found.turn])
    for offset in unit_offsets(12, np.random.default_rng(7)):
        pose = np.array(plan.base_pose) + offset * size
        there = check_base_pose(
            kitchen, answer.prepared.robot, plan.task, pose, Everywhere(), how_far=False
        )
        assert there.motion is not None, there.reason


def test_an_exception_of_the_clock_ends_the_work(answer: PlacementResult) -> None:
    reads = 0

    def clock() -> float:
        nonlocal reads
        reads += 1
        if reads == 10:
            raise TimeoutError
        return 0.0

    with pytest.raises(TimeoutError):
        with_tolerance(answer, clock=clock)
    assert reads <= 12  # the stopwatch reads the clock as it stops


def test_the_time_limit_ends_the_measurement_and_a_note_says_so(answer: PlacementResult) -> None:
    reads = 0

    def clock() -> float:
        nonlocal reads
        reads += 1
        return 1e9 if reads > 6 else 0.0

    late = with_tolerance(answer, clock=clock).plan
    assert late.tolerance is None
    assert late.notes[-1].startswith("the time limit ended the measurement of the tolerance")
    assert reads <= 10


def test_a_base_pose_accepted_because_time_is_up_is_marked(answer: PlacementResult) -> None:
    _, base, motion = motion_of(answer)
    found = Search(timed_out=True, fallback=(base, motion, 1.0))
    found.accept_fallback()
    assert found.ended_early
    complete = Search(fallback=(base, motion, 1.0))
    complete.accept_fallback()
    assert not complete.ended_early


def test_without_a_motion_there_is_no_tolerance(kitchen: Scene, segway: Robot) -> None:
    task = make_task(kitchen, "open", "cabinet_right", "drawer_middle_slide")
    far = np.array([2.0, -1.0, 0.0])
    assert placement_tolerance(kitchen, segway, task, far, Everywhere()).radius == 0.0


def test_an_answer_of_place_has_a_tolerance_if_it_is_wanted(tmp_path: Path) -> None:
    out = tmp_path / "plan.json"
    few = ["--tolerance", "--tolerance-samples", "12"]
    output = output_of("place", "open", *QUESTION, *few, "--out", str(out))
    plan = read_plan(out)
    assert plan.tolerance.samples == 12
    assert f"tolerance   +-{100 * plan.tolerance.radius:g} cm, +-" in output
    assert "replanning succeeded from 12/12 sampled poses" in output
    assert f", and {1000 * plan.timing['tolerance']:.0f} ms for the tolerance" in output
    x, y, yaw = plan.base_pose or (0.0, 0.0, 0.0)
    again = ["--at", f"{x},{y},{yaw}", *few, "--json"]
    data = json_of("place", "open", *QUESTION, *again)
    assert data["tolerance"]["samples"] == 12
    data = json_of("place", "open", *QUESTION, "--json")
    assert data["tolerance"] is None
    assert "tolerance" not in data["timing"]


def test_a_stop_of_a_tour_has_the_smallest_tolerance_of_its_tasks(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [*QUESTION, "then", "close", QUESTION[1], "--tolerance", "--tolerance-samples", "12"]
    assert main(["place", "open", *words, "--out", str(tmp_path / "tour.json")]) == 0
    found = [read_plan(tmp_path / f"tour_{k}.json").tolerance for k in (1, 2)]
    assert found[0] is not None
    assert found[1] is not None
    least = min(found[0], found[1], key=lambda one: one.radius)
    assert f"; tolerance {least}" in capsys.readouterr().out


def test_the_command_samples_as_many_poses_as_python() -> None:
    assert Options().tolerance_samples == SAMPLES


def test_the_output_states_the_tolerance_of_a_stop(answer: PlacementResult) -> None:
    some, none = Tolerance(0.05, 0.05 * TURN_PER_RADIUS, 12), Tolerance(0.0, 0.0, 12)
    plans = [replace(answer.plan, tolerance=one) for one in (some, none)]
    assert _stop_tolerance(plans) == "; no tolerance"
    assert _stop_tolerance(plans[:1]) == "; tolerance +-5 cm, +-3 deg"
    assert _stop_tolerance([answer.plan]) == ""


@pytest.mark.parametrize("samples", [0, 10**9])
def test_an_unusable_number_of_samples_is_refused(samples: int) -> None:
    with pytest.raises(InputError, match="tolerance-samples must be between 1"):
        Options(tolerance_samples=samples)


def test_samples_of_a_tolerance_that_is_not_measured_are_refused() -> None:
    with pytest.raises(InputError, match="--tolerance-samples needs --tolerance"):
        Options(tolerance_samples=12)


def test_zero_samples_are_refused(answer: PlacementResult) -> None:
    _, base, motion = motion_of(answer)
    with pytest.raises(InputError, match="from 1 to"):
        measured_tolerance(answer.query, base, motion, samples=0)


@pytest.mark.parametrize("name", ["ranger_rm63", "fetch"])
def test_the_known_motion_passes_at_its_own_base_pose(name: str, kitchen: Scene) -> None:
    """The hand's spheres overlap the grasped object, so they must not be checked there."""
    robot = load_robot(name)
    answer = plan_base_placement(kitchen, robot, make_task(kitchen, "open", "microwave"))
    base, motion = np.array(answer.plan.base_pose), answer.plan.motion
    replanner = NearbyReplanner.around(answer.query, base, motion)
    assert replanner.failure(base[None], "all") is None
    assert replanner.replanned == 0
