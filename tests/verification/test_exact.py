"""The exact check accepts a correct plan and rejects every corruption of it."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np
import pytest
from damaged_plans import MUTATIONS
from door_case import BASE, JOINTS, OPEN, arm_path, make_case, tool_poses
from independent_check import HAND_CHECKS, INDEPENDENT_NAMES, independent_verdicts
from tests.shapes import unchecked

from momapos.core.errors import TaskError, UnknownNameError
from momapos.core.geometry.transforms import pose_planar
from momapos.model.records.plans import Motion, Task
from momapos.model.scene.scene_files import load_scene
from momapos.model.urdf.articulated import Articulated
from momapos.model.urdf.reader import read_urdf
from momapos.verification.exact_check import PlanVerifier
from momapos.verification.link_bodies import bodies_of, body_poses
from momapos.verification.plan_check import UrdfArm, verify_files
from momapos.verification.report import DEFAULT, Limits
from momapos.verification.robot_collision_model import robot_collision_model
from momapos.verification.sweep import deepest


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> PlanVerifier:
    folder = tmp_path_factory.mktemp("toy")
    make_case().write(folder)
    task = Task("open", "cupboard", "hinge", OPEN)
    return PlanVerifier(load_scene(folder / "scene.json"), toy_arm(folder), task)


@pytest.fixture
def motion() -> Motion:
    approach, q, values = arm_path()
    return Motion(approach, q, values, tool_poses(values))


def toy_arm(folder: Path) -> UrdfArm:
    model = Articulated(read_urdf(folder / "robot.urdf"))
    return UrdfArm(model, "base", "tool", JOINTS, frozenset())


def test_links_that_touch_at_rest_are_still_checked_in_other_states(tmp_path: Path) -> None:
    """The arm is folded into itself at rest, and collides with itself again in another state."""
    case = make_case()
    straight = '<child link="wrist"/><origin xyz="0 0 0.4"/>'
    assert straight in case.robot
    case.robot = case.robot.replace(straight, straight.replace("0.4", "-0.35"))
    case.write(tmp_path)
    model = robot_collision_model(toy_arm(tmp_path))
    q = np.zeros((2, 6))
    q[1, JOINTS.index("twist")] = 1.0
    _, _, Ts = model.poses(model.body_poses(BASE, q))
    _, state = deepest(model.arm, Ts, model.arm, Ts, model.arm_arm_pairs, 0.0)
    names = np.array(model.arm.names)[model.arm_arm_pairs[state >= 0]]
    assert {"upper", "palm"} in [set(pair) for pair in names.tolist()]


def test_neighbors_are_no_pair_in_whatever_order_a_file_lists_its_links(tmp_path: Path) -> None:
    """Links of one body and of bodies with a joint between them may always touch."""
    found = []
    for name, order in (("listed", 1), ("reversed", -1)):
        case = make_case()
        links = re.findall(r'<link name="[^\n]*', case.robot)
        rest = "\n".join(line for line in case.robot.splitlines() if line not in links)
        begin, end = rest.split("\n", 1)
        case.robot = "\n".join([begin, *links[::order], end])
        case.write(tmp_path / name)
        model = robot_collision_model(toy_arm(tmp_path / name))
        arm, base = np.array(model.arm.names), np.array(model.base.names)
        (a, b), (c, d) = model.arm_arm_pairs.T, model.arm_base_pairs.T
        pairs = [*zip(arm[a], arm[b], strict=True), *zip(arm[c], base[d], strict=True)]
        found.append({frozenset(pair) for pair in pairs})
    row = ("base", "shoulder", "upper", "fore", "knuckle", "palm")  # the wrist has no shape
    fingers = ("left", "right")
    expected = {frozenset(p) for p in combinations(row, 2)} - {
        frozenset(p) for p in pairwise(row) if p != ("fore", "knuckle")
    }
    expected |= {frozenset((one, finger)) for one in row[:-1] for finger in fingers}
    assert found[0] == found[1] == expected | {frozenset(fingers)}


def test_a_plan_along_the_arc_of_the_handle_is_valid(tmp_path: Path) -> None:
    report = verify_files(make_case().write(tmp_path))
    assert report.valid, report.violations
    assert report.gripper_depth == 0.0


@pytest.mark.parametrize("name", MUTATIONS)
def test_a_corrupted_plan_is_rejected_for_its_reason(name: str, tmp_path: Path) -> None:
    corrupt, reason = MUTATIONS[name]
    case = make_case()
    corrupt(case)
    report = verify_files(case.write(tmp_path))
    assert reason in [check.name for check in report.violations]


def test_the_independent_checker_fails_the_same_checks(tmp_path: Path) -> None:
    plans = {"valid": make_case().write(tmp_path / "valid")}
    for name, (corrupt, _) in MUTATIONS.items():
        case = make_case()
        corrupt(case)
        plans[name] = case.write(tmp_path / name)
    for (name, path), theirs in zip(plans.items(), independent_verdicts(plans), strict=True):
        ours = {INDEPENDENT_NAMES.get(c.name, c.name): c for c in verify_files(path).checks}
        failed = {key for key, check in ours.items() if not check.ok}
        others = {key for key, (ok, _) in theirs.items() if not ok}
        assert others <= failed <= others | HAND_CHECKS, name
        for key, check in ours.items():
            if key in theirs and check.unit and "hand" not in key:
                assert check.value == pytest.approx(theirs[key][1], abs=0.02), name


def test_the_independent_checker_allows_the_same_initial_overlap(tmp_path: Path) -> None:
    """The closed door overlaps a neighbor by `depth` [m], and leaves it or turns deeper into it."""
    plans, collision = {}, "moved part collision with the scene"
    for depth in (-0.001, 0.0, 0.002, 0.008):
        for name, size, x, y in (
            ("leaves", [0.02, 0.3, 0.78], 0.185, 0.44 - depth),
            ("turns into", [0.1, 0.1, 0.78], 0.125 + depth, -0.2),
        ):
            case = make_case()
            case.obstacle(size, [x, y, 0.8])
            plans[name, depth] = case.write(tmp_path / f"{name} {depth}")
    for (key, path), theirs in zip(plans.items(), independent_verdicts(plans), strict=True):
        (ours,) = (check for check in verify_files(path).checks if check.name == collision)
        other = theirs[INDEPENDENT_NAMES[collision]][0]
        assert ours.ok == other == (key[0] == "leaves"), key


def test_non_finite_numbers_are_rejected(world: PlanVerifier, motion: Motion) -> None:
    for key in ("approach", "q", "object_q", "Ts_world_tool"):
        for number in (math.nan, math.inf, 1e300):
            corrupted = getattr(motion, key).copy()
            corrupted.reshape(-1)[3] = number
            report = world.check(BASE, replace(motion, **{key: corrupted}))
            assert [check.name for check in report.violations] == ["numbers are finite"]
    assert not world.check((math.nan, 0.0, 0.0), motion).valid


def test_a_motion_with_fewer_object_values_than_arm_states_is_rejected(
    world: PlanVerifier, motion: Motion
) -> None:
    with unchecked():
        report = world.check(BASE, replace(motion, object_q=motion.object_q[:-1]))
    (found,) = report.violations
    assert found.name == "q, object_q, T_world_tool have equal length >= 2"


def test_a_motion_too_long_to_check_is_rejected(world: PlanVerifier, motion: Motion) -> None:
    there_and_back = np.tile([[0.0] * 6, [9e5] * 6], (50, 1))
    report = world.check(BASE, replace(motion, approach=there_and_back))
    assert [check.name for check in report.violations] == ["states to check"]


def test_one_verifier_checks_many_motions(world: PlanVerifier, motion: Motion) -> None:
    assert world.check(BASE, motion).valid
    assert world.first_violation((BASE[0], BASE[1], BASE[2] + 3.0), motion) is not None
    assert world.first_violation(BASE, motion) is None


def test_a_rejection_names_the_pair_without_numbers(tmp_path: Path, motion: Motion) -> None:
    case = make_case()
    MUTATIONS["an_obstacle_in_the_way_of_the_forearm"][0](case)
    case.write(tmp_path)
    task = Task("open", "cupboard", "hinge", OPEN)
    world = PlanVerifier(load_scene(tmp_path / "scene.json"), toy_arm(tmp_path), task)
    assert world.first_violation(BASE, motion) == "arm collision with the scene: fore and post/box"


def test_a_penetration_below_zero_requires_a_clearance(tmp_path: Path, motion: Motion) -> None:
    make_case().write(tmp_path)
    scene, arm = load_scene(tmp_path / "scene.json"), toy_arm(tmp_path)
    task = Task("open", "cupboard", "hinge", OPEN)

    def clear(distance: float) -> bool:
        limits = Limits(penetration=-distance)
        return PlanVerifier(scene, arm, task, limits).check(BASE, motion).valid

    assert clear(0.0)
    assert not clear(0.3)


def test_an_error_for_an_unknown_name_suggests_the_right_one(tmp_path: Path) -> None:
    case = make_case()
    case.plan["task"]["object"] = "cupbord"
    with pytest.raises(UnknownNameError, match="cupboard"):
        verify_files(case.write(tmp_path))
    case = make_case()
    case.plan["task"]["joint"] = "hinges"
    with pytest.raises(UnknownNameError, match="hinge"):
        verify_files(case.write(tmp_path))
    case = make_case()
    case.plan["robot"]["tool_link"] = "toool"
    with pytest.raises(UnknownNameError, match="tool"):
        verify_files(case.write(tmp_path))


def test_a_task_without_a_value_is_an_error(tmp_path: Path) -> None:
    make_case().write(tmp_path)
    scene = load_scene(tmp_path / "scene.json")
    with pytest.raises(TaskError, match="to must be given"):
        PlanVerifier(scene, toy_arm(tmp_path), Task("open", "cupboard", "hinge"))
    with pytest.raises(TaskError, match="joint must be given"):
        PlanVerifier(scene, toy_arm(tmp_path), Task("open", "cupboard"))


@pytest.mark.parametrize(("length", "depth"), [(0.124, 0.002), (0.16, 0.02)])
def test_an_open_gripper_may_be_in_the_part_by_less_than_its_limit(
    tmp_path: Path, length: float, depth: float
) -> None:
    case = make_case()
    case.robot = case.robot.replace('size="0.08 0.06 0.06"', f'size="0.08 0.06 {length}"')
    report = verify_files(case.write(tmp_path))
    assert report.gripper_depth == pytest.approx(depth, abs=5e-4)
    assert report.valid == (depth <= DEFAULT.hand_depth)


def test_kinematics_agree_with_those_of_the_scene_model(tmp_path: Path) -> None:
    make_case().write(tmp_path)
    model = Articulated(read_urdf(tmp_path / "robot.urdf"))
    bodies = bodies_of(model)
    rng = np.random.default_rng(0)
    values = {name: rng.uniform(-2.0, 2.0, 5) for name in model.joints}
    root = pose_planar(np.array([0.3, -0.2, 1.0]))
    Ts = body_poses(bodies, values, root)
    for state in range(5):
        poses = model.link_poses({name: v[state] for name, v in values.items()})
        for link, T in poses.items():
            ours = Ts[state, bodies.of_link[link]] @ bodies.T_body_link[link]
            np.testing.assert_allclose(ours, root @ T, atol=1e-12)
