"""Laws of tasks on parts with a latch: the hand turns it, holds on, and moves the part."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.cupboards import LATCHES, furniture_room, latched_room, link
from tests.real import check_independently
from tests.shapes import unchecked

from momapos.apps.export.timeline import PhaseKind, phases_of, plan_timeline, write_csv
from momapos.apps.web.playback import Story, values_at_end
from momapos.core.errors import FileFormatError, TaskError
from momapos.core.geometry.transforms import invert
from momapos.model.plan_files.plan_format import read_plan, write_plan
from momapos.model.records.plans import Hold, JointResistance, Latch, Motion
from momapos.model.robots.robot import Grip, Robot
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene, save_scene
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement, plan_tour
from momapos.planning.result import PlacementResult
from momapos.planning.tour import Request
from momapos.verification.exact_check import PlanVerifier
from momapos.verification.plan_check import verify_files

CONFIG = PipelineConfig(timeout=60.0)


def answer_of(scene: Scene, robot: Robot, target: str = "cupboard") -> PlacementResult:
    return plan_base_placement(scene, robot, make_task(scene, "open", target), config=CONFIG)


@pytest.fixture(scope="module")
def lever_room(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """A room with a door that a lever holds."""
    return latched_room(tmp_path_factory.mktemp("lever"), "a lever")


@pytest.fixture(scope="module")
def lever_answer(lever_room: Scene, fetch: Robot) -> PlacementResult:
    """The answer for it."""
    answer = answer_of(lever_room, fetch)
    assert answer.plan.motion is not None
    return answer


def motion_of(answer: PlacementResult) -> Motion:
    assert answer.plan.motion is not None, answer.plan.candidates
    return answer.plan.motion


@pytest.mark.parametrize(
    "kind", [k if k in ("a T-handle", "a sliding bolt") else pytest.param(k, marks=pytest.mark.slow)
             for k in LATCHES],
)  # fmt: skip
def test_the_hand_turns_a_latch_and_holds_on_as_the_part_opens(
    tmp_path: Path, kind: str, fetch: Robot
) -> None:
    scene = latched_room(tmp_path, kind)
    answer = answer_of(scene, fetch)
    motion, item = motion_of(answer), scene.object("cupboard")
    path = tmp_path / "plan.json"
    write_plan(answer.plan, path)
    report = verify_files(path)
    assert report.valid, report.violations
    # It leaves the latch in its place, so the hand that turned with it is in its bar there.
    check_independently(path, but_for="open hand in the part")
    # Two phases: the latch turns while the part rests, then the part moves with the turned latch.
    first = motion.holds[0].first
    assert first > 0
    np.testing.assert_array_equal(motion.object_q[: first + 1], motion.object_q[0])
    np.testing.assert_array_equal(motion.latch_q[first:], LATCHES[kind][1])
    assert motion.latch_q[0] == 0.0
    assert (np.abs(np.diff(motion.latch_q[: first + 1])) > 0).all()
    # One grasp throughout: the tool keeps its pose in the link of the latch, between waypoints to a
    # millimeter.
    held = item.moving_poses(answer.plan.task.joint, motion.object_q, motion.latch_q)["grip"]
    in_latch = invert(held) @ motion.Ts_world_tool
    np.testing.assert_allclose(in_latch, np.broadcast_to(in_latch[0], in_latch.shape), atol=1e-3)
    assert "turn to" in answer.latch


def test_without_a_latch_in_the_scene_nothing_is_turned(
    lever_room: Scene, tmp_path: Path, fetch: Robot
) -> None:
    item = replace(lever_room.object("cupboard"), latch=None)
    answer = answer_of(replace(lever_room, objects=(item,)), fetch)
    motion = motion_of(answer)
    assert motion.latch_q is None
    assert answer.latch == ""
    write_plan(answer.plan, tmp_path / "plan.json")
    assert "latch_q" not in (tmp_path / "plan.json").read_text()


@pytest.mark.parametrize("values", [{"turn": -0.7}, {"hinge": 0.3}])
def test_a_turned_latch_and_one_of_a_part_ajar_are_left_alone(
    lever_room: Scene, values: dict[str, float], fetch: Robot
) -> None:
    answer = answer_of(lever_room.with_joints({"cupboard": values}), fetch)
    assert motion_of(answer).latch_q is None


def test_a_plan_file_keeps_the_values_of_the_latch(
    lever_answer: PlacementResult, tmp_path: Path
) -> None:
    path = tmp_path / "plan.json"
    write_plan(lever_answer.plan, path)
    again = read_plan(path).motion
    assert again == lever_answer.plan.motion
    data = json.loads(path.read_text())
    del data["manipulation"]["latch_q"][0]
    path.write_text(json.dumps(data))
    with pytest.raises(FileFormatError, match="latch_q must have"):
        read_plan(path)


def broken(motion: Motion) -> dict[str, Motion]:
    """Return motions that do not turn the latch as they must, by the check that says so."""
    assert motion.latch_q is not None
    first, latch = motion.holds[0].first, motion.latch_q
    early = np.interp(np.arange(len(motion.q)), [0, len(motion.q) - 1], [0.0, latch[-1]])
    hands_off = np.tile(motion.Ts_world_tool[first], (len(motion.q), 1, 1))
    hands_off[first:] = motion.Ts_world_tool[first:]
    q = motion.q.copy()
    q[:first] = q[first]
    return {
        "the latch is turned first": replace(motion, latch_q=None),
        "one value of the latch for each state": replace(motion, latch_q=latch[1:]),
        "latch starts at the scene's value": replace(motion, latch_q=np.full_like(latch, -0.7)),
        "latch short of its value while the part moves": replace(motion, latch_q=early),
        "latch turns monotonically (largest step back)": replace(
            motion, latch_q=np.append(latch[:-1], -0.5)
        ),
        "latch within its joint limits (excess)": replace(motion, latch_q=2 * latch),
        "grasp slips: rotation in the moved part": replace(
            motion, approach=np.append(motion.approach[:-1], q[:1], axis=0), q=q,
            Ts_world_tool=hands_off,
        ),
    }  # fmt: skip


def test_the_exact_check_wants_the_latch_turned_by_the_hand_before_the_part_moves(
    lever_answer: PlacementResult, lever_room: Scene, fetch: Robot
) -> None:
    plan, motion = lever_answer.plan, motion_of(lever_answer)
    verifier = PlanVerifier(lever_room, fetch, plan.task)
    assert verifier.check(plan.base_pose, motion).valid
    with unchecked():
        wrong_motions = broken(motion)
        reports = {
            name: verifier.check(plan.base_pose, wrong) for name, wrong in wrong_motions.items()
        }
    for name, report in reports.items():
        assert name in {check.name for check in report.violations}, name
    plain = replace(lever_room.object("cupboard"), latch=None)
    other = PlanVerifier(replace(lever_room, objects=(plain,)), fetch, plan.task)
    names = {check.name for check in other.check(plan.base_pose, motion).violations}
    assert "the scene has the latch that the plan turns" in names


def test_what_the_hand_cannot_turn_is_a_no_with_its_reason(tmp_path: Path, fetch: Robot) -> None:
    scene = latched_room(tmp_path, "a lever", {"turn": JointResistance(friction=20.0)})
    answer = answer_of(scene, fetch)
    assert answer.plan.status == "infeasible"
    assert "are needed to turn it" in answer.prepared.motion.refusal


def test_a_latch_too_thick_for_the_hand_is_a_no(tmp_path: Path, fetch: Robot) -> None:
    parts, _ = LATCHES["a lever"]
    thick = [p.replace('size="0.02 0.13 0.02"', 'size="0.14 0.14 0.14"') for p in parts]
    latch = latched_room(tmp_path, "a lever").object("cupboard").latch
    scene = furniture_room(tmp_path, thick, "cupboard")
    item = replace(scene.objects[0], latch=latch)
    scene = save_scene(replace(scene, objects=(item,)), tmp_path / "thick.json")
    answer = answer_of(scene, fetch)
    assert answer.plan.status == "infeasible"
    assert "too thick for the gripper" in answer.prepared.motion.refusal


def test_a_hand_without_fingers_cannot_turn_a_latch(lever_room: Scene, fetch: Robot) -> None:
    cup = replace(fetch, grips=Grip.SUCTION)
    answer = answer_of(lever_room, cup)
    assert answer.plan.status == "infeasible"


def test_a_tour_opens_a_latched_door_and_closes_it_without_the_latch(
    lever_room: Scene, fetch: Robot
) -> None:
    tour = plan_tour(
        lever_room, fetch,
        [Request("open", "cupboard", to="60deg"), Request("close", "cupboard")], config=CONFIG,
    )  # fmt: skip
    assert tour.status == "solved"
    assert [motion_of(step).latch_q is None for step in tour.steps] == [False, True]


def test_exports_and_the_page_turn_the_latch_before_the_part_moves(
    lever_answer: PlacementResult, lever_room: Scene, tmp_path: Path, fetch: Robot
) -> None:
    plan, motion = lever_answer.plan, motion_of(lever_answer)
    phases = phases_of(plan, fetch)
    kinds = [phase.kind for phase in phases]
    assert kinds[-3:] == [PhaseKind.CLOSE, PhaseKind.ARM, PhaseKind.OPEN]
    timeline = plan_timeline(plan, phases, lever_room, fetch)
    samples = timeline.samples
    assert timeline.latch == "turn"
    moved = samples.object_q > 1e-6
    np.testing.assert_allclose(samples.latch_q[moved], -0.7, atol=1e-6)
    assert ((samples.latch_q < -0.1) & (samples.latch_q > -0.6)).any()
    write_csv(timeline, tmp_path / "motion.csv")
    lines = (tmp_path / "motion.csv").read_text().splitlines()
    assert lines[0].endswith("object_q,latch_q")
    assert float(lines[-1].split(",")[-1]) == pytest.approx(-0.7)
    end = Story.of(plan, fetch, lever_room).at(1e9).object_q
    assert end == pytest.approx({"hinge": plan.task.to, "turn": -0.7})
    assert values_at_end(lever_room, plan.task, motion) == pytest.approx(end)


def test_a_motion_without_a_latch_holds_from_where_its_holds_say(
    lever_answer: PlacementResult,
) -> None:
    motion = motion_of(lever_answer)
    last = len(motion.q) - 1
    assert (motion.grasps[0].first, motion.grasps[0].last) == (0, last)
    plain = replace(motion, latch_q=None)
    assert plain.grasps == motion.holds
    assert replace(plain, holds=()).grasps == (Hold(0, last),)


def test_a_saved_scene_answers_as_the_scene_in_memory(
    lever_answer: PlacementResult, lever_room: Scene, fetch: Robot
) -> None:
    again = answer_of(load_scene(lever_room.path or ""), fetch)
    assert again.plan == lever_answer.plan


def test_a_latch_without_a_shape_is_refused(tmp_path: Path, fetch: Robot) -> None:
    parts = [link("grip") if '<link name="grip"' in p else p for p in LATCHES["a lever"][0]]
    scene = furniture_room(tmp_path, parts)
    item = replace(scene.objects[0], latch=Latch("turn", -0.7, "hinge"))
    with pytest.raises(TaskError, match="the latch 'grip' has no shape"):
        answer_of(replace(scene, objects=(item,)), fetch)


def test_a_long_bar_is_a_latch_as_well(tmp_path: Path, fetch: Robot) -> None:
    parts = [p.replace('size="0.02 0.13 0.02"', 'size="0.02 0.4 0.02"')
             for p in LATCHES["a lever"][0]]  # fmt: skip
    scene = furniture_room(tmp_path, parts)
    item = replace(scene.objects[0], latch=Latch("turn", -0.4, "hinge"))
    scene = save_scene(replace(scene, objects=(item,)), tmp_path / "scene.json")
    assert motion_of(answer_of(scene, fetch)).latch_q is not None


def test_a_tour_takes_another_grasp_once_a_latched_door_is_ajar(
    tmp_path: Path, segway: Robot
) -> None:
    scene = latched_room(tmp_path, "a T-handle")
    tour = plan_tour(
        scene, segway,
        [Request("open", "cupboard", to="10deg"), Request("open", "cupboard")], config=CONFIG,
    )  # fmt: skip
    assert tour.status == "solved"
    assert [motion_of(step).latch_q is None for step in tour.steps] == [False, True]
